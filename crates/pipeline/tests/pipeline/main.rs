//! Plans and scenes through the whole pipeline. One program for all files, which share the processors; `cargo test -p lumistack-pipeline --test pipeline compose::` runs the tests of one.

mod captures;
mod compose;
mod farm;
mod live;
mod splats;
mod tiles;
mod usd;
