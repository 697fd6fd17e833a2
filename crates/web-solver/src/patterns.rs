//! Encodes patterns for the viewer and for the command.

use lumistack_display::{Backlight, Display, LayerStack, Projection, StackIndex};
use serde_json::{Value, json};

use crate::decoders;
use crate::error::Error;

/// Encodes all masks of a stack, and the emission of a directional backlight, in the order of the
/// files of [`preview`]. Each picture is `[row][col][rgb]` with value = code / 255.
pub fn codes(display: &Display, stack: &LayerStack) -> Vec<u8> {
    let code = |value: &f32| (255.0 * value).round() as u8;
    let mut codes = Vec::new();
    for frame in 0..stack.frames() {
        for layer in &stack.layers {
            codes.extend(layer.block([frame]).iter().map(code));
        }
        if let (Some(emission), Backlight::Lenslets(b)) = (&stack.emission, &display.backlight) {
            // the axes of the emission's picture are `[bin_y][lenslet_row][bin_x][lenslet_col]`
            for (bin_y, row) in (0..b.views[1]).flat_map(|bin_y| (0..b.lenslets[1]).map(move |row| (bin_y, row))) {
                for bin_x in 0..b.views[0] {
                    codes.extend(emission.block([frame, bin_y, bin_x, row]).iter().map(code));
                }
            }
        }
    }
    codes
}

/// Returns the viewer's `preview.json` for patterns of a display. The page passes the pictures to
/// the viewer in memory, so the files that `preview.json` names do not exist.
///
/// # Errors
/// If the views of the display are invalid.
pub fn preview(display: &Display, title: &str) -> Result<String, Error> {
    let geometry = display.geometry()?;
    let mut files = Vec::new();
    for frame in 0..display.frames {
        for (layer, [cols, rows]) in display.layers.iter().map(|layer| layer.resolution).enumerate() {
            let path = format!("stack/layer{layer}_frame{frame}.png");
            files.push(json!({"path": path, "kind": "layer", "layer": layer, "frame": frame, "rows": rows, "cols": cols, "bytes": 0}));
        }
        if let Backlight::Lenslets(b) = &display.backlight {
            let (rows, cols) = (b.views[1] * b.lenslets[1], b.views[0] * b.lenslets[0]);
            let path = format!("stack/emission_frame{frame}.png");
            files.push(
                json!({"path": path, "kind": "emission", "frame": frame, "rows": rows, "cols": cols, "bytes": 0}),
            );
        }
    }
    let (projection, distance_mm) = match geometry.grid.projection {
        Projection::Oblique => ("oblique", None),
        Projection::Perspective { distance_mm } => ("perspective", Some(distance_mm)),
    };
    let target = json!({
        "rows": geometry.rows,
        "cols": geometry.cols,
        "pitch_mm": geometry.pitch_mm,
        "projection": projection,
        "distance_mm": distance_mm,
        "slope_x": geometry.grid.slope_x,
        "slope_y": geometry.grid.slope_y,
    });
    let layers = display.layers.len();
    let words = |count: usize, one: &str| if count == 1 { format!("one {one}") } else { format!("{count} {one}s") };
    let caption = format!("{}, {}, solved on this page.", words(layers, "layer"), words(display.frames, "frame"));
    let preview = json!({
        "schema": "lumistack-preview",
        "version": 1,
        "title": title,
        "caption": caption,
        "display": display,
        "brightness": display.brightness,
        "frames": display.frames,
        "target": target,
        "files": files,
    });
    Ok(preview.to_string())
}

/// Packs a run folder of the patterns as a zip: `display.toml`, `layers/` and `job.toml`, whose
/// content is `job`. The command can show this folder, or compute the same patterns again from the
/// job.
///
/// # Errors
/// If the zip becomes too large.
pub fn zip(display: &Display, stack: &LayerStack, job: &str) -> Result<Vec<u8>, Error> {
    let failed = |error: serde_json::Error| Error(format!("zip: {error}"));
    let index = StackIndex::of(display, stack);
    let mut files = vec![("job.toml".to_owned(), job.as_bytes().to_vec())];
    let mut array =
        |name: &str, shape: &[usize], data: &[f32]| files.push((format!("layers/{name}"), npy(shape, data)));
    for (entry, layer) in index.layers.iter().zip(&stack.layers) {
        array(&entry.file, &layer.shape(), layer.data());
    }
    if let Some(emission) = &stack.emission {
        array(StackIndex::EMISSION, &emission.shape(), emission.data());
    }
    let text = serde_json::to_string_pretty(&index).map_err(failed)?;
    files.push((format!("layers/{}", StackIndex::FILE), text.into_bytes()));
    let display = serde_json::to_string(display).map_err(failed)?;
    decoders::pack(&display, &files).map_err(Error)
}

/// Writes a row-major array of `float32` with at least two axes as a NumPy file, format 1.0. A
/// library for arrays of all types would be 5 kB of the compressed module.
fn npy(shape: &[usize], data: &[f32]) -> Vec<u8> {
    let shape = format!("{shape:?}");
    let shape = shape.trim_matches(['[', ']']);
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}), }}");
    // the data begins at byte 128
    let header = format!("{header:117}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(data.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// Returns values of a display as JSON; the page sets its sliders to these values.
pub fn about(display: &Display) -> Value {
    let gaps = display.layers.windows(2).map(|pair| pair[1].d_mm - pair[0].d_mm);
    let count = display.layers.len().saturating_sub(1).max(1);
    json!({
        "layers": display.layers.len(),
        "frames": display.frames,
        "brightness": display.brightness,
        "gap_mm": gaps.sum::<f64>() / count as f64,
        "directional": matches!(display.backlight, Backlight::Lenslets(_)),
        "resolution": display.field.resolution,
        "views": display.views(),
    })
}
