//! From lent planes to files.

use std::borrow::Cow;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use lumistack_field_io::picture::{Precision, exr_bytes};
use lumistack_plugin::display::{Layer, Transfer};
use lumistack_plugin::encoding::{codes8, codes16};
use lumistack_plugin::{FieldInput, PluginError, StackInput, Stage, Time, ViewPoint};

use crate::manifest::{Content, Entry, Format};
use crate::pictures::{backlight_picture, centre_and_corners};
use crate::{Encode, ExrDepth, Images, Views};

/// Linear values on their way to a file.
struct Picture<'a> {
    /// Path without suffixes.
    stem: String,
    content: Content,
    /// [rows, cols].
    size: [usize; 2],
    /// `[row][col][rgb]`.
    rgb: Vec<f32>,
    transfer: Transfer,
    /// The panel that the codes drive, from its darkest state to its brightest; none for codes that stand for the values themselves.
    panel: Option<&'a Layer>,
}

impl Images {
    /// Writes all layers and frames, the backlight's frames, and the chosen views.
    pub(crate) fn write_stack(&self, time: Time, stack: &StackInput<'_>) -> Result<Vec<Entry>, PluginError> {
        let (layers, frames) = (stack.layer_count(), stack.frames());
        let views = match self.params.views {
            Views::None => Vec::new(),
            Views::Some => centre_and_corners(stack.target().grid.views()),
            Views::All => stack.target().grid.iter().collect(),
        };
        let pictures = layers * frames + stack.emission_shape().map_or(0, |_| frames) + views.len();
        let stage = self.host.stage("images", pictures as u64, "pictures");
        let folder = folder(time);
        let (layer_digits, frame_digits) = (digits(layers, 1), digits(frames, 2));
        let mut entries = Vec::new();
        for (layer, frame) in (0..layers).flat_map(|layer| (0..frames).map(move |frame| (layer, frame))) {
            self.host.check_cancelled()?;
            let panel = self.display.layers.get(layer).ok_or_else(|| {
                PluginError::Refused(format!("layer {layer}: the display has {}", self.display.layers.len()))
            })?;
            let plane = stack.layer(layer, frame)?;
            let picture = Picture {
                stem: format!("{folder}layer_{layer:0layer_digits$}_frame_{frame:0frame_digits$}"),
                content: Content::Layer { layer, frame, d_mm: panel.d_mm },
                size: [plane.rows(), plane.cols()],
                rgb: plane.to_vec(),
                transfer: self.params.encode.of_layer(panel.transfer),
                panel: (self.params.encode == Encode::Panel).then_some(panel),
            };
            self.write_picture(time, &picture, &stage, &mut entries)?;
        }
        if let Some([bins_y, bins_x, rows, cols]) = stack.emission_shape() {
            let (bins, lenslets) = ([bins_y, bins_x], [rows, cols]);
            for frame in 0..frames {
                self.host.check_cancelled()?;
                let bin = |y, x| Ok::<_, PluginError>(stack.emission(frame, y, x)?.to_vec());
                let picture = Picture {
                    stem: format!("{folder}backlight_frame_{frame:0frame_digits$}"),
                    content: Content::Backlight { frame, bins, lenslets },
                    size: [rows * bins_y, cols * bins_x],
                    rgb: backlight_picture(bins, lenslets, bin)?,
                    transfer: self.params.encode.of_other(),
                    panel: None,
                };
                self.write_picture(time, &picture, &stage, &mut entries)?;
            }
        }
        for view in views {
            self.host.check_cancelled()?;
            let grid = &stack.target().grid;
            let plane = stack.simulate(ViewPoint::of_view(stack.target(), view))?;
            let adapted = (1.0 / stack.brightness()) as f32;
            let slope = [grid.slope_x[view[1]], grid.slope_y[view[0]]];
            let picture = Picture {
                stem: format!("{folder}simulated_{}", view_name(view, grid.views())),
                content: Content::SimulatedView { view, slope, divided_by: stack.brightness() },
                size: [plane.rows(), plane.cols()],
                rgb: plane.to_vec().into_iter().map(|value| value * adapted).collect(),
                transfer: self.params.encode.of_other(),
                panel: None,
            };
            self.write_picture(time, &picture, &stage, &mut entries)?;
        }
        Ok(entries)
    }

    /// Writes every view.
    pub(crate) fn write_field(&self, time: Time, field: &FieldInput<'_>) -> Result<Vec<Entry>, PluginError> {
        let grid = &field.geometry().grid;
        let views = grid.views();
        let stage = self.host.stage("images", (views[0] * views[1]) as u64, "pictures");
        let mut entries = Vec::new();
        for view in grid.iter() {
            self.host.check_cancelled()?;
            let plane = field.view(view)?;
            let picture = Picture {
                stem: format!("{}view_{}", folder(time), view_name(view, views)),
                content: Content::View { view, slope: [grid.slope_x[view[1]], grid.slope_y[view[0]]] },
                size: [plane.rows(), plane.cols()],
                rgb: plane.to_vec(),
                transfer: self.params.encode.of_other(),
                panel: None,
            };
            self.write_picture(time, &picture, &stage, &mut entries)?;
        }
        Ok(entries)
    }

    /// Writes one picture in every chosen format.
    fn write_picture(
        &self,
        time: Time,
        picture: &Picture,
        stage: &Stage,
        entries: &mut Vec<Entry>,
    ) -> Result<(), PluginError> {
        let [height, width] = picture.size;
        let (params, transfer) = (&self.params, picture.transfer);
        let mut write = |suffix: String, format: Format, linear: bool, bytes: Vec<u8>| {
            let file = format!("{}{suffix}", picture.stem);
            self.host.write(&file, &bytes)?;
            let content = picture.content.clone();
            let (index, time_seconds) = (time.index, time.seconds);
            entries.push(Entry { file, content, format, linear, width, height, time: index, time_seconds });
            Ok::<_, PluginError>(())
        };
        let linear = if params.encode == Encode::Linear { "_linear" } else { "" };
        let png = |bits| Format::Png { bits, encoding: transfer };
        let proportional = transfer == Transfer::Linear;
        let driven: Cow<[f32]> = match picture.panel {
            Some(panel) => picture.rgb.iter().map(|&value| panel.drive(value)).collect(),
            None => Cow::Borrowed(&picture.rgb),
        };
        if params.png8 {
            let codes = codes8(transfer, &driven);
            let bytes = png_bytes(&codes, picture.size, ExtendedColorType::Rgb8)?;
            write(format!("{linear}.png"), png(8), proportional, bytes)?;
        }
        if params.png16 {
            // the encoder takes 16-bit samples in native byte order
            let codes: Vec<u8> = codes16(transfer, &driven).into_iter().flat_map(u16::to_ne_bytes).collect();
            let bytes = png_bytes(&codes, picture.size, ExtendedColorType::Rgb16)?;
            write(format!("{linear}_16bit.png"), png(16), proportional, bytes)?;
        }
        if params.exr {
            let (precision, name) = match params.exr_depth {
                ExrDepth::Half => (Precision::Half, "half"),
                ExrDepth::Float => (Precision::Float, "float"),
            };
            let bytes = exr_bytes([width, height], &picture.rgb, precision)
                .map_err(|error| PluginError::failed("OpenEXR encoder", error))?;
            write(".exr".into(), Format::Exr { precision: name }, true, bytes)?;
        }
        stage.advance(1, "");
        Ok(())
    }
}

fn png_bytes(samples: &[u8], [rows, cols]: [usize; 2], colour: ExtendedColorType) -> Result<Vec<u8>, PluginError> {
    let failed = |error: String| PluginError::failed("PNG encoder", error);
    let side = |n: usize| u32::try_from(n).map_err(|error| failed(error.to_string()));
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(samples, side(cols)?, side(rows)?, colour)
        .map_err(|error| failed(error.to_string()))?;
    Ok(bytes)
}

/// The first time of a sequence, or a still, stands beside the manifest.
fn folder(time: Time) -> String {
    if time.index == 0 { String::new() } else { format!("t{:04}/", time.index) }
}

fn view_name([y, x]: [usize; 2], [rows, cols]: [usize; 2]) -> String {
    format!("{y:0y_digits$}_{x:0x_digits$}", y_digits = digits(rows, 2), x_digits = digits(cols, 2))
}

/// Digits that number `count` things from 0, so that names sort.
fn digits(count: usize, least: usize) -> usize {
    count.saturating_sub(1).to_string().len().max(least)
}
