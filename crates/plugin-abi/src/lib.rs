//! The versioned C boundary between the host and its plugins: repr(C) types only.
