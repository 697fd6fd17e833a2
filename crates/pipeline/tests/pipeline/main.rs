//! Plans and scenes go through the whole pipeline. All test files are one program, so that the
//! tests of all files run in parallel. `cargo test -p lumistack-pipeline --test pipeline compose::`
//! runs the tests of one file.

mod captures;
mod compose;
mod farm;
mod live;
#[cfg(target_os = "linux")]
mod memory;
mod splats;
mod tiles;
mod usd;
