//! Reads `.npy` arrays: a single array, and a light field as an array with a JSON file beside it.
//! The input is the JSON, a separator and the array.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_field_io::{GeometryDefaults, GeometryFlags, npy, open};
use lumistack_fuzz::{folder, parts, reads};

fuzz_target!(|data: &[u8]| {
    let [json, array] = parts(data);
    let with_json: &[(&str, &[u8])] = &[("a.npy", array), ("a.json", json)];
    let path = folder(if json.is_empty() { &with_json[..1] } else { with_json }).join("a.npy");
    reads(|_| npy::read(&path));
    let flags = GeometryFlags { fov_deg: Some([20.0, 20.0]), pitch_mm: Some(0.5), ..GeometryFlags::default() };
    for flags in [GeometryFlags::default(), flags] {
        reads(|task| open(&path, &flags, &GeometryDefaults::default(), task));
    }
});
