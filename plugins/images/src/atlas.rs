//! Writes one picture with the masks of all layers and frames, for engines that load a single
//! texture.
//!
//! Each mask is a tile. There is one row of tiles per frame, with the rear layer on the left and
//! the front layer on the right. If a tile has fewer pixels in height than the tallest tile, the
//! pixels below it are black. `atlas.json` lists the positions of the tiles. The picture is written
//! row by row, so memory does not grow with the number of frames.

use std::io::{BufWriter, Write};

use lumistack_plugin::display::Transfer;
use lumistack_plugin::serde::Serialize;
use lumistack_plugin::{Host, PluginError, StackInput, serde_json};

use crate::encode::{png_error, say_encoding};

/// The content of `atlas.json`.
#[derive(Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct Index<'a> {
    schema: &'static str,
    version: u32,
    /// File name of the picture, which is in the folder of this index.
    file: &'a str,
    width: usize,
    height: usize,
    tiles: Vec<Tile<'a>>,
}

/// The position of one mask in the picture: columns x..x + width, and rows y..y + height from the
/// top.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct Tile<'a> {
    layer: usize,
    frame: usize,
    x: usize,
    y: usize,
    width: usize,
    height: usize,
    /// Transfer function from light to the tile's code values.
    encoding: &'a Transfer,
}

/// Returns the value that all layers share; `None` if they have different values.
pub(crate) fn shared<T: Copy + PartialEq>(values: &[T]) -> Option<T> {
    let (first, others) = values.split_first()?;
    others.iter().all(|other| other == first).then_some(*first)
}

/// Writes the picture and its index; returns [columns, rows] of the picture. `transfers` has the
/// transfer function of each layer's masks. `samples(layer, frame)` returns a mask's 8-bit samples
/// `[row][col][rgb]`.
pub(crate) fn write(
    host: &Host,
    folder: &str,
    stack: &StackInput<'_>,
    transfers: &[&Transfer],
    mut samples: impl FnMut(usize, usize) -> Result<Vec<u8>, PluginError>,
) -> Result<[usize; 2], PluginError> {
    // Compute the positions of all tiles: one band of rows per frame, with the layers side by side.
    let sizes: Vec<[usize; 2]> = (0..stack.layer_count()).filter_map(|layer| stack.layer_size(layer)).collect();
    let width: usize = sizes.iter().map(|size| size[1]).sum();
    let band = sizes.iter().map(|size| size[0]).max().unwrap_or(0);
    let height = band * stack.frames();
    let tiles = (0..stack.frames()).flat_map(|frame| {
        let mut x = 0;
        let tiles: Vec<Tile<'_>> = sizes
            .iter()
            .enumerate()
            .map(|(layer, &[rows, cols])| {
                x += cols;
                Tile {
                    layer,
                    frame,
                    x: x - cols,
                    y: frame * band,
                    width: cols,
                    height: rows,
                    encoding: transfers[layer],
                }
            })
            .collect();
        tiles
    });
    let index =
        Index { schema: "lumistack/atlas", version: 1, file: "atlas.png", width, height, tiles: tiles.collect() };
    let side = |n: usize| u32::try_from(n).map_err(|error| PluginError::failed("atlas", error));
    // Write the picture row by row, with one frame's masks in memory.
    let mut file = host.create(&format!("{folder}atlas.png"))?;
    let mut writer = BufWriter::new(&mut file);
    let mut encoder = png::Encoder::new(&mut writer, side(width)?, side(height)?);
    encoder.set_color(png::ColorType::Rgb);
    if let Some(transfer) = shared(transfers) {
        say_encoding(&mut encoder, transfer);
    }
    encoder.set_compression(png::Compression::Fast);
    let mut encoder = encoder.write_header().map_err(png_error)?;
    let mut rows = encoder.stream_writer().map_err(png_error)?;
    let stage = host.stage("atlas", (stack.frames() * sizes.len()) as u64, "masks");
    let mut line = vec![0; 3 * width];
    for frame in 0..stack.frames() {
        let mut masks = Vec::new();
        for layer in 0..sizes.len() {
            host.check_cancelled()?;
            masks.push(samples(layer, frame)?);
            stage.advance(1, "");
        }
        for row in 0..band {
            line.fill(0);
            let mut x = 0;
            for (mask, &[layer_rows, cols]) in masks.iter().zip(&sizes) {
                if row < layer_rows {
                    line[3 * x..3 * (x + cols)].copy_from_slice(&mask[3 * row * cols..3 * (row + 1) * cols]);
                }
                x += cols;
            }
            rows.write_all(&line).map_err(|error| PluginError::from_io("atlas", error))?;
        }
    }
    rows.finish().map_err(png_error)?;
    encoder.finish().map_err(png_error)?;
    let flushed = writer.into_inner().map(drop).map_err(|error| error.into_error());
    flushed.map_err(|error| PluginError::from_io("atlas", error))?;
    file.commit()?;
    // Write the index after the picture is complete.
    let text = serde_json::to_string_pretty(&index).expect("JSON can express an index");
    host.write(&format!("{folder}atlas.json"), format!("{text}\n").as_bytes())?;
    Ok([width, height])
}
