//! Layer stacks: `stack.json`, `layer_L.npy` (`float32`, `[frame][row][col][rgb]`, layer 0 rearmost) and, for a directional backlight,
//! `emission.npy` (`[frame][bin_y][bin_x][lenslet_row][lenslet_col][rgb]`). All values are linear, 0..1. The index is written last.

use std::path::Path;

use lumistack_core::Tensor;
use lumistack_display::{Backlight, Display, LayerStack};
use lumistack_files::{Folder, Refusal};
use serde::{Deserialize, Serialize};

use crate::index::{check_schema, parse_json, read_index, write_json};
use crate::{FieldError, atomic, mapped, npy};

pub(crate) const INDEX: &str = "stack.json";
pub(crate) const EMISSION: &str = "emission.npy";
const SCHEMA: &str = "lumistack/stack";
const VERSION: u32 = 1;
/// Most layers and frames of one stack; more means that the index is damaged.
const COUNT_LIMIT: usize = 1000;

/// `stack.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StackIndex {
    /// `lumistack/stack`.
    pub schema: String,
    /// 1.
    pub version: u32,
    /// Name of the display.
    pub display: String,
    /// Axes of each layer's array.
    pub layer_axes: Vec<String>,
    /// Axes of the backlight's array.
    pub emission_axes: Vec<String>,
    /// Values are amounts of light, not code values.
    pub linear: bool,
    /// Frames M of one period; the display emits the mean of its frames.
    pub frames: usize,
    /// β: the display emits β times the target.
    pub brightness: f64,
    /// Rear to front.
    pub layers: Vec<LayerEntry>,
    /// The directional backlight, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backlight: Option<BacklightEntry>,
}

/// One layer of `stack.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LayerEntry {
    /// Array beside the index.
    pub file: String,
    /// Signed distance from z = 0.
    pub d_mm: f64,
    /// [columns, rows].
    pub resolution: [usize; 2],
    /// Pixel pitch.
    pub pitch_mm: f64,
    /// [x, y] of the centre.
    #[serde(default)]
    pub offset_mm: [f64; 2],
}

/// The backlight of `stack.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BacklightEntry {
    /// Array beside the index.
    pub file: String,
    /// Signed distance of the lenslets from z = 0.
    pub d_mm: f64,
    /// [columns, rows] of lenslets.
    pub lenslets: [usize; 2],
    /// Lenslet pitch.
    pub pitch_mm: f64,
    /// [horizontal, vertical] full angle of the bins.
    pub fov_deg: [f64; 2],
    /// [horizontal, vertical] angular bins.
    pub views: [usize; 2],
    /// [x, y] of the grid's centre.
    #[serde(default)]
    pub offset_mm: [f64; 2],
}

/// Writes a stack into a folder, which is made where it is missing.
///
/// # Errors
/// If the stack does not fit the display, or the files cannot be written.
pub fn write_stack(folder: &Path, display: &Display, stack: &LayerStack) -> Result<(), FieldError> {
    stack.check(display).map_err(|source| FieldError::Stack { path: folder.to_path_buf(), source })?;
    let index = index_of(display, stack.frames(), stack.brightness);
    atomic::create_folder(folder)?;
    atomic::remove(&folder.join(INDEX))?;
    for (entry, layer) in index.layers.iter().zip(&stack.layers) {
        npy::write(&folder.join(&entry.file), &layer.shape(), layer.data())?;
    }
    match &stack.emission {
        Some(emission) => npy::write(&folder.join(EMISSION), &emission.shape(), emission.data())?,
        None => atomic::remove(&folder.join(EMISSION))?,
    }
    write_json(&folder.join(INDEX), &index)
}

/// Reads a stack's index without its arrays.
///
/// # Errors
/// If it is missing or malformed.
pub fn read_stack_index(folder: &Path) -> Result<StackIndex, FieldError> {
    let path = folder.join(INDEX);
    let text = read_index(&path)?;
    let index: StackIndex = parse_json(&path, &text)?;
    check_schema(&path, &index.schema, SCHEMA, index.version, VERSION)?;
    let check = |ok: bool, place: &str, expected: &str, found: String| {
        if ok { Ok(()) } else { Err(FieldError::malformed(&path, place, expected, found)) }
    };
    check(index.linear, "linear", "true", "false".into())?;
    let axes = [(&index.layer_axes, "layer_axes", &LayerStack::LAYER_AXES[..])];
    for (found, key, expected) in
        axes.into_iter().chain([(&index.emission_axes, "emission_axes", &LayerStack::EMISSION_AXES[..])])
    {
        check(found == expected, key, &format!("{expected:?}"), format!("{found:?}"))?;
    }
    let in_limit = |count: usize| (1..=COUNT_LIMIT).contains(&count);
    check(in_limit(index.frames), "frames", "1 to 1000", index.frames.to_string())?;
    check(in_limit(index.layers.len()), "layers", "1 to 1000", index.layers.len().to_string())?;
    let brightness_ok = index.brightness > 0.0 && index.brightness <= 1.0;
    check(brightness_ok, "brightness", "above 0, at most 1", index.brightness.to_string())?;
    let files = index.layers.iter().map(|layer| &layer.file).chain(index.backlight.iter().map(|b| &b.file));
    let inside = Folder::around(&path).map_err(FieldError::io(&path, "read"))?;
    for file in files {
        let plain = Path::new(file).file_name().is_some_and(|name| name.to_str() == Some(file));
        check(plain, "file", "a name inside the folder", file.clone())?;
        // a link may still lead out; a file that is missing is an error when it is read
        if let Err(refusal @ Refusal::Outside { .. }) = inside.resolve(file) {
            check(false, "file", "a name inside the folder", format!("{file}: {refusal}"))?;
        }
    }
    Ok(index)
}

/// Reads a stack. Arrays of a gigabyte and more stay in their files, which the system reads where values are asked for; such a file must not be changed in its
/// place meanwhile, only replaced.
///
/// # Errors
/// If a file is missing, damaged or of another shape than the index says, or a value is not in 0..1.
pub fn read_stack(folder: &Path) -> Result<LayerStack, FieldError> {
    let index = read_stack_index(folder)?;
    let mut layers = Vec::new();
    for layer in &index.layers {
        let shape = [index.frames, layer.resolution[1], layer.resolution[0], 3];
        layers.push(read_part(&folder.join(&layer.file), LayerStack::LAYER_AXES, shape)?);
    }
    let emission = match &index.backlight {
        None => None,
        Some(b) => {
            let shape = [index.frames, b.views[1], b.views[0], b.lenslets[1], b.lenslets[0], 3];
            Some(read_part(&folder.join(&b.file), LayerStack::EMISSION_AXES, shape)?)
        }
    };
    Ok(LayerStack { layers, emission, brightness: index.brightness })
}

pub(crate) fn index_of(display: &Display, frames: usize, brightness: f64) -> StackIndex {
    let digits = (display.layers.len() - 1).to_string().len();
    let layer = |(n, layer): (usize, &lumistack_display::Layer)| LayerEntry {
        file: format!("layer_{n:0digits$}.npy"),
        d_mm: layer.d_mm,
        resolution: layer.resolution,
        pitch_mm: layer.pitch_mm,
        offset_mm: layer.offset_mm,
    };
    let backlight = match &display.backlight {
        Backlight::Uniform => None,
        Backlight::Lenslets(b) => Some(BacklightEntry {
            file: EMISSION.into(),
            d_mm: b.d_mm,
            lenslets: b.lenslets,
            pitch_mm: b.pitch_mm,
            fov_deg: b.fov_deg,
            views: b.views,
            offset_mm: b.offset_mm,
        }),
    };
    StackIndex {
        schema: SCHEMA.into(),
        version: VERSION,
        display: display.name.clone(),
        layer_axes: LayerStack::LAYER_AXES.map(String::from).to_vec(),
        emission_axes: LayerStack::EMISSION_AXES.map(String::from).to_vec(),
        linear: true,
        frames,
        brightness,
        layers: display.layers.iter().enumerate().map(layer).collect(),
        backlight,
    }
}

fn read_part<const N: usize>(
    path: &Path,
    axes: [&'static str; N],
    expected: [usize; N],
) -> Result<Tensor<N>, FieldError> {
    let file = npy::NpyFile::open(path)?;
    if file.shape() != expected {
        return Err(FieldError::malformed(
            path,
            "shape",
            format!("{expected:?}, as in {INDEX}"),
            format!("{:?}", file.shape()),
        ));
    }
    let part = match file.lent(mapped::FROM) {
        Some(values) => Tensor::lent(axes, expected, values),
        None => Tensor::from_vec(axes, expected, npy::read(path)?.1),
    };
    let part =
        part.map_err(|error| FieldError::malformed(path, "shape", format!("{expected:?}"), error.to_string()))?;
    if let Some(index) = part.data().iter().position(|value| !(0.0..=1.0).contains(value)) {
        let place = format!("value {index} in row-major order");
        return Err(FieldError::malformed(path, place, "a number in 0..1", part.data()[index].to_string()));
    }
    Ok(part)
}
