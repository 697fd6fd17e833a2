//! Compares the renderer with closed forms and long renders.
//!
//! All files are one program, so that they share the processors.
//! `cargo test -p lumistack-pathtracer --test pathtracer denoise::` runs the tests of one file.

mod common;
mod denoise;
mod features;
mod furnace;
mod lights;
mod radiance;
mod unseen;
mod views;
