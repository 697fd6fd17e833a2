//! Plans and scenes through the whole pipeline. One program has all files, so that they share the
//! processor. `cargo test -p lumistack-pipeline --test pipeline compose::` runs the tests of one
//! file.

mod captures;
mod compose;
mod farm;
mod live;
#[cfg(target_os = "linux")]
mod memory;
mod splats;
mod tiles;
mod usd;
