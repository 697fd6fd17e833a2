//! Layer stacks: `stack.json`, `layer_L.npy` (`float32`, `[frame][row][col][rgb]`, layer 0
//! rearmost) and, for a directional backlight, `emission.npy`
//! (`[frame][bin_y][bin_x][lenslet_row][lenslet_col][rgb]`). All values are linear, 0..1. The index
//! `stack.json` is written last, so a folder with an index is complete.

use std::path::Path;

use lumistack_core::Tensor;
use lumistack_display::{Display, LayerStack, StackIndex};
use lumistack_files::{Folder, Refusal};

use crate::index::{check_schema, parse_json, read_index, write_json};
use crate::{FieldError, atomic, mapped, npy};

const INDEX: &str = StackIndex::FILE;
/// Largest number of layers and of frames. An index with more is regarded as damaged.
const COUNT_LIMIT: usize = 1000;

/// Writes a stack into a folder, which is created if missing.
///
/// # Errors
/// If the stack does not match the display, or the files cannot be written.
pub fn write_stack(folder: &Path, display: &Display, stack: &LayerStack) -> Result<(), FieldError> {
    stack.check(display).map_err(|source| FieldError::Stack { path: folder.to_path_buf(), source })?;
    let index = StackIndex::of(display, stack);
    atomic::create_folder(folder)?;
    atomic::remove(&folder.join(INDEX))?;
    for (entry, layer) in index.layers.iter().zip(&stack.layers) {
        npy::write(&folder.join(&entry.file), &layer.shape(), layer.data())?;
    }
    match &stack.emission {
        Some(emission) => npy::write(&folder.join(StackIndex::EMISSION), &emission.shape(), emission.data())?,
        None => atomic::remove(&folder.join(StackIndex::EMISSION))?,
    }
    write_json(&folder.join(INDEX), &index)
}

/// Reads a stack's index without its arrays.
///
/// # Errors
/// If the index is missing or malformed.
pub fn read_stack_index(folder: &Path) -> Result<StackIndex, FieldError> {
    let path = folder.join(INDEX);
    let text = read_index(&path)?;
    let index: StackIndex = parse_json(&path, &text)?;
    check_schema(&path, &index.schema, StackIndex::SCHEMA, index.version, StackIndex::VERSION)?;
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
        // A link that leads outside of the folder is an error. A missing file is an error only when
        // it is read.
        if let Err(refusal @ Refusal::Outside { .. }) = inside.resolve(file) {
            check(false, "file", "a name inside the folder", format!("{file}: {refusal}"))?;
        }
    }
    Ok(index)
}

/// Reads a stack.
///
/// Arrays of a gigabyte and more stay in their files, and the system reads the pages in use. Until
/// the stack is dropped, these files may be replaced, but not changed in place.
///
/// # Errors
/// If a file is missing, damaged or of another shape than the index declares, or a value is not in
/// 0..1.
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
        return Err(FieldError::malformed(path, place, "a number from 0 to 1", part.data()[index].to_string()));
    }
    Ok(part)
}
