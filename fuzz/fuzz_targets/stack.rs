//! Reads layer stacks. The input is `stack.json`, a separator, and one array, which is the content
//! of all layers and of the emission.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_field_io::{read_stack, read_stack_index};
use lumistack_fuzz::{folder, parts, reads};

fuzz_target!(|data: &[u8]| {
    let [index, array] = parts(data);
    let folder =
        folder(&[("stack.json", index), ("layer_0.npy", array), ("layer_1.npy", array), ("emission.npy", array)]);
    reads(|_| read_stack_index(folder));
    reads(|_| read_stack(folder));
});
