//! Reads splat files of every format; the pictures of the format SOG have one texel. If a file can
//! be read, it must be possible to convert it to a valid glTF file and to render its scene.

#![no_main]

use std::sync::Arc;

use libfuzzer_sys::fuzz_target;
use lumistack_core::{Cancelled, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_fuzz::reads;
use lumistack_gltf::{AssetResolver, LoadOptions, load_with};
use lumistack_scene::{Scene, Window};
use lumistack_splats::read::read;
use lumistack_splats::{Renderer, SplatView, Wanted, glb};

struct NoFiles;

impl AssetResolver for NoFiles {
    fn read(&self, uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
        Err(uri.to_owned())
    }
}

/// A PNG of one texel.
const PICTURE: &[u8] = &[
    0x89, b'P', b'N', b'G', 13, 10, 26, 10, 0, 0, 0, 13, b'I', b'H', b'D', b'R', 0, 0, 0, 1, 0, 0, 0, 1, 8, 0, 0, 0, 0,
    0x3a, 0x7e, 0x9b, 0x55, 0, 0, 0, 10, b'I', b'D', b'A', b'T', 0x78, 0x9c, 0x63, 0x60, 0, 0, 0, 2, 0, 1, 0x48, 0xaf,
    0xa4, 0x71, 0, 0, 0, 0, b'I', b'E', b'N', b'D', 0xae, 0x42, 0x60, 0x82,
];

fuzz_target!(|data: &[u8]| {
    let beside = |_: &str| Ok(PICTURE.to_vec());
    let Some(found) = reads(|_| read(data, &beside)) else { return };
    let document = glb(&found.cloud, found.axes.scene_from_file().to_array(), 1.0).expect("a small cloud");
    let options = LoadOptions { max_decoded_bytes: 256 << 20, ..LoadOptions::default() };
    let Some(scene) = reads(|task| load_with("a.glb", &document, &NoFiles, &options, task)) else { return };
    reads(|task| views(Arc::new(scene), task));
});

fn views(scene: Arc<Scene>, task: Task<'_>) -> Result<(), String> {
    for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 40.0 }] {
        let grid = ViewGrid::single(projection, [0.0; 2]);
        let geometry = FieldGeometry { rows: 20, cols: 24, pitch_mm: 1.0, grid };
        let window = Window::framing(scene.seen_bounds(), geometry.size_mm()).map_err(|error| error.to_string())?;
        let renderer = Renderer::new(scene.clone()).ok_or("no splats")?;
        let done = |_: usize, view: SplatView| {
            assert!(view.light.data().iter().all(|value| value.is_finite()), "a pixel that is not finite");
            Ok::<_, Cancelled>(())
        };
        let slopes = [[-0.2, 0.1], [0.0, 0.0], [0.3, 0.2]];
        let render = renderer.render(&window, &geometry, &slopes, &|_| Ok(None), Wanted::Light, task, done);
        render.map_err(|error| error.to_string())?;
    }
    Ok(())
}
