//! Tests of reading glTF. All files are one program, so that they share the processors; `cargo test
//! -p lumistack-gltf --test gltf animations::` runs the tests of one file.

mod animations;
mod compressed;
mod corpus;
mod errors;
mod features;
mod materials;
mod mutations;
mod splats;
mod support;
