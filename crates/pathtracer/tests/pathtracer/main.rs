//! The renderer against what is known of light. One program for all files, which share the
//! processors; `cargo test -p lumistack-pathtracer --test pathtracer denoise::` runs the tests of
//! one.

mod common;
mod denoise;
mod features;
mod furnace;
mod lights;
mod radiance;
mod unseen;
mod views;
