//! Reads pictures of light fields and environments: OpenEXR, Radiance HDR, PNG, JPEG, WebP. The
//! first bytes select the file's extension. The target `load` reads KTX2.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_field_io::picture::Picture;
use lumistack_fuzz::{folder, reads};

fuzz_target!(|data: &[u8]| {
    let name = match data {
        [0x76, 0x2f, 0x31, 0x01, ..] => "a.exr",
        [b'#', b'?', ..] => "a.hdr",
        [0xff, 0xd8, ..] => "a.jpg",
        [b'R', b'I', b'F', b'F', ..] => "a.webp",
        _ => "a.png",
    };
    let path = folder(&[(name, data)]).join(name);
    let size = reads(|_| Picture::size_of(&path));
    if let Some(picture) = reads(|_| Picture::read(&path)) {
        assert_eq!(Some(picture.size()), size);
        assert_eq!(picture.size().iter().product::<usize>() * 3, picture.into_linear().len());
    }
});
