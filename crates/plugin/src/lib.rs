//! What a plugin author depends on: safe traits, parameter schema, export macro.
