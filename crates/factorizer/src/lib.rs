//! Weighted nonnegative tensor factorization of a light field into layer patterns.
