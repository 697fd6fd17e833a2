//! How glTF is read. One program for all files, which share the processors;
//! `cargo test -p lumistack-gltf --test gltf animations::` runs the tests of one.

mod animations;
mod compressed;
mod corpus;
mod errors;
mod features;
mod materials;
mod mutations;
mod splats;
mod support;
