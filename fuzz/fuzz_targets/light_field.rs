//! Reads folders of light fields. The first byte selects the kind of folder; a text, a separator
//! and a picture follow. All views are this picture. In a folder of Lumistack's own kind the text
//! is `lightfield.json`, in a folder of HCI's kind `parameters.cfg`. In the third kind of folder
//! the text lists the names of the pictures.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_field_io::{GeometryDefaults, GeometryFlags, describe, open};
use lumistack_fuzz::{folder, parts, reads};

fuzz_target!(|data: &[u8]| {
    let Some((kind, data)) = data.split_first() else { return };
    let [index, picture] = parts(data);
    let folder = match kind % 3 {
        0 => folder(&[
            ("lightfield.json", index),
            ("view_00_00.exr", picture),
            ("view_00_01.exr", picture),
            ("view_01_00.png", picture),
            ("view_01_01.hdr", picture),
        ]),
        1 => folder(&[
            ("parameters.cfg", index),
            ("input_Cam000.png", picture),
            ("input_Cam001.png", picture),
            ("input_Cam002.png", picture),
            ("input_Cam003.png", picture),
        ]),
        _ => {
            // in a folder of pictures, the text lists the names of the pictures
            let names = String::from_utf8_lossy(index);
            let names = names.lines().take(16).filter(|name| !name.is_empty() && name.len() < 100);
            let names: Vec<String> = names.map(|name| format!("{}.png", name.replace(['/', '\0'], "_"))).collect();
            folder(&names.iter().map(|name| (name.as_str(), picture)).collect::<Vec<_>>())
        }
    };
    let flags = GeometryFlags { fov_deg: Some([20.0, 20.0]), pitch_mm: Some(0.5), ..GeometryFlags::default() };
    for flags in [GeometryFlags::default(), flags] {
        reads(|task| describe(folder, &flags, task));
        reads(|task| open(folder, &flags, &GeometryDefaults::default(), task));
    }
});
