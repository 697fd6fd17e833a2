//! OpenEXR pictures: one RGB picture per file, linear light.

use std::io::{self, BufReader};
use std::panic::AssertUnwindSafe;
use std::path::Path;

use exr::image::write::channels::WritableChannels;
use exr::meta::MetaData;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder,
    ReadChannels, ReadLayers, SmallVec, SpecificChannels, Text, Vec2, WritableImage, f16, read as read_exr,
};

use super::samples::{PIXEL_LIMIT, Picture, Samples};
use crate::{FieldError, atomic};

/// Storage type of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// Half float: 11 significant bits, largest value 65504.
    Half,
    /// Single float: 24 significant bits.
    Float,
}

/// On noisy pictures PIZ takes half the time and half the space of ZIP.
const COMPRESSION: Compression = Compression::PIZ;
/// Smallest number of bytes of a chunk in a file: its entry in the offset table, and its header.
const LEAST_BYTES_PER_CHUNK: u64 = 16;
/// Largest size of decoded pixels, relative to the size of their file. Deflate packs 1032 bytes
/// into one, and PXR24 keeps 24 of 32 bits.
const MOST_EXPANSION: u64 = 1032 * 4 / 3;

/// Writes one RGB picture, `[row][col][rgb]` linear, `size` = [columns, rows]. Equal values produce
/// equal bytes.
///
/// # Errors
/// If writing fails.
///
/// # Panics
/// If the length of `rgb` does not match `size`.
pub fn write_exr(path: &Path, size: [usize; 2], rgb: &[f32], precision: Precision) -> Result<(), FieldError> {
    atomic::write(path, |writer| encode(writer, size, rgb, precision, None))
}

/// Writes like [`write_exr`], but uncompressed and with a text in the header's attribute
/// `comments`, which [`Picture::read_noted`] returns. The file is not compressed, since it is soon
/// read again. Compression of a noisy view with few samples would take half as long as the view's
/// rendering.
///
/// # Errors
/// If writing fails.
///
/// # Panics
/// If the length of `rgb` does not match `size`.
pub fn write_exr_noted(
    path: &Path,
    size: [usize; 2],
    rgb: &[f32],
    precision: Precision,
    note: &str,
) -> Result<(), FieldError> {
    atomic::write(path, |writer| encode(writer, size, rgb, precision, Some(note)))
}

/// Returns the bytes that [`write_exr`] writes.
///
/// # Errors
/// If the picture exceeds the limits of the format.
///
/// # Panics
/// If the length of `rgb` does not match `size`.
pub fn exr_bytes(size: [usize; 2], rgb: &[f32], precision: Precision) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    encode(io::Cursor::new(&mut bytes), size, rgb, precision, None)?;
    Ok(bytes)
}

/// Encodes a picture. The encoder reads pixels from `rgb` one compressed block at a time, so memory
/// never holds a second copy of all pixels.
fn encode(
    writer: impl io::Write + io::Seek,
    size: [usize; 2],
    rgb: &[f32],
    precision: Precision,
    note: Option<&str>,
) -> io::Result<()> {
    assert_eq!(rgb.len(), 3 * size[0] * size[1], "values fill the picture");
    let attributes = LayerAttributes { comments: note.map(Text::from), ..LayerAttributes::default() };
    let compression = if note.is_some() { Compression::Uncompressed } else { COMPRESSION };
    let value = |Vec2(x, y): Vec2<usize>, channel: usize| rgb[3 * (y * size[0] + x) + channel];
    match precision {
        Precision::Half => {
            let half = |at, channel| f16::from_f32(value(at, channel));
            let pixels = |at| (half(at, 0), half(at, 1), half(at, 2));
            write_image(writer, &image(size, attributes, compression, SpecificChannels::rgb(pixels)))
        }
        Precision::Float => {
            let pixels = |at| (value(at, 0), value(at, 1), value(at, 2));
            write_image(writer, &image(size, attributes, compression, SpecificChannels::rgb(pixels)))
        }
    }
}

/// Returns the channels B, G and R of a picture, each named with a prefix.
fn channels(prefix: &str, size: [usize; 2], rgb: &[f32], precision: Precision) -> [AnyChannel<FlatSamples>; 3] {
    assert_eq!(rgb.len(), 3 * size[0] * size[1], "values fill the picture");
    [("B", 2), ("G", 1), ("R", 0)].map(|(name, index)| {
        let values = rgb.iter().skip(index).step_by(3).copied();
        let samples = match precision {
            Precision::Half => FlatSamples::F16(values.map(f16::from_f32).collect()),
            Precision::Float => FlatSamples::F32(values.collect()),
        };
        AnyChannel::new(format!("{prefix}{name}").as_str(), samples)
    })
}

/// Writes one picture of named channels in single floats, each `[row][col]`. `size` is [columns,
/// rows]. Equal values produce equal bytes.
///
/// # Errors
/// If writing fails.
///
/// # Panics
/// If the length of a channel does not match `size`, or there are no channels.
pub fn write_exr_channels(path: &Path, size: [usize; 2], channels: &[(&str, &[f32])]) -> Result<(), FieldError> {
    assert!(!channels.is_empty(), "a picture has channels");
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = channels
        .iter()
        .map(|(name, values)| {
            assert_eq!(values.len(), size[0] * size[1], "values fill the picture");
            AnyChannel::new(*name, FlatSamples::F32(values.to_vec()))
        })
        .collect();
    let image = image(size, LayerAttributes::default(), COMPRESSION, AnyChannels::sort(list));
    atomic::write(path, |writer| write_image(writer, &image))
}

fn image<'a, C: WritableChannels<'a> + 'a>(
    size: [usize; 2],
    attributes: LayerAttributes,
    compression: Compression,
    channels: C,
) -> Image<Layer<C>> {
    let encoding = Encoding { compression, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    Image::from_layer(Layer::new((size[0], size[1]), attributes, encoding, channels))
}

fn write_image<'a, C: WritableChannels<'a>>(
    writer: impl io::Write + io::Seek,
    image: &'a Image<Layer<C>>,
) -> io::Result<()> {
    image.write().non_parallel().to_buffered(writer).map_err(|error| match error {
        exr::error::Error::Io(error) => error,
        other => io::Error::other(other),
    })
}

/// One OpenEXR picture with several views. The header's `multiView` lists their names. The first
/// view is the default: its channels have no prefix. The channels of every other view are `name.R`,
/// `name.G`, `name.B`.
#[derive(Debug)]
pub struct MultiView {
    size: [usize; 2],
    precision: Precision,
    names: Vec<Text>,
    channels: SmallVec<[AnyChannel<FlatSamples>; 4]>,
}

impl MultiView {
    /// Begins a picture of `size` = [columns, rows], without views.
    pub fn new(size: [usize; 2], precision: Precision) -> Self {
        Self { size, precision, names: Vec::new(), channels: SmallVec::new() }
    }

    /// Adds a view, `[row][col][rgb]` linear.
    ///
    /// # Panics
    /// If the length of `rgb` does not match the size, or the name has a dot or is in use.
    pub fn push(&mut self, name: &str, rgb: &[f32]) {
        let text = Text::from(name);
        assert!(!name.contains('.') && !self.names.contains(&text), "view names are different and hold no dots");
        let prefix = if self.names.is_empty() { String::new() } else { format!("{name}.") };
        self.channels.extend(channels(&prefix, self.size, rgb, self.precision));
        self.names.push(text);
    }

    /// Encodes the picture, and returns the bytes of the file.
    ///
    /// # Errors
    /// If the picture has no view or exceeds the limits of the format.
    pub fn into_bytes(self) -> io::Result<Vec<u8>> {
        let attributes = LayerAttributes { multi_view_names: Some(self.names), ..LayerAttributes::default() };
        let mut bytes = Vec::new();
        let image = image(self.size, attributes, COMPRESSION, AnyChannels::sort(self.channels));
        write_image(io::Cursor::new(&mut bytes), &image)?;
        Ok(bytes)
    }
}

/// Reads [columns, rows] of the first layer.
pub(super) fn size(path: &Path) -> Result<[usize; 2], FieldError> {
    header(path).map(|(size, _)| size)
}

/// Returns an upper bound of the memory that [`read`] takes, bytes. The decoder keeps all channels
/// of the layer while the result is made, 12 bytes per pixel. Channels of fewer than 12 bytes count
/// as 12, since blocks of pixels are also in memory.
pub(super) fn bytes(path: &Path) -> Result<u64, FieldError> {
    header(path).map(|([cols, rows], decoded)| {
        let linear = 12 * (cols * rows) as u64;
        linear + decoded.max(linear)
    })
}

/// Reads [columns, rows] of the first layer, and the number of bytes of its decoded channels.
/// Checks that the file is large enough for the pixels that its header declares.
fn header(path: &Path) -> Result<([usize; 2], u64), FieldError> {
    let file = lumistack_files::open(path).map_err(FieldError::io(path, "read"))?;
    let length = lumistack_files::length(&file).map_err(FieldError::io(path, "read"))?;
    let meta = MetaData::read_from_buffered(BufReader::new(file), false).map_err(|error| damaged(path, &error))?;
    let header = meta
        .headers
        .first()
        .ok_or_else(|| FieldError::malformed(path, "header", "at least one OpenEXR layer", "none"))?;
    if header.deep {
        return Err(FieldError::malformed(path, "header", "a flat picture", "deep data"));
    }
    // refuse DWAA and DWAB: the decoder takes sizes of allocations from the compressed data, so a
    // damaged file could end the program
    if matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        let expected = "none, RLE, ZIP, PIZ, PXR24 or B44";
        return Err(FieldError::malformed(path, "compression", expected, header.compression.to_string()));
    }
    let size = [header.layer_size.0, header.layer_size.1];
    if size.contains(&0) || size[0].saturating_mul(size[1]) > PIXEL_LIMIT {
        let expected = format!("1 to {PIXEL_LIMIT} pixels");
        return Err(FieldError::malformed(path, "dataWindow", expected, format!("{} × {}", size[0], size[1])));
    }
    let chunks: u64 = meta.headers.iter().map(|header| header.chunk_count as u64).fold(0, u64::saturating_add);
    if chunks.saturating_mul(LEAST_BYTES_PER_CHUNK) > length {
        let found = format!("{length} bytes: the file is cut short");
        return Err(FieldError::malformed(
            path,
            "content",
            format!("enough bytes for {chunks} blocks of pixels"),
            found,
        ));
    }
    let bytes = (size[0] * size[1]) as u64 * header.channels.bytes_per_pixel as u64;
    if bytes > length.saturating_mul(MOST_EXPANSION) {
        let expected = format!("{} × {} pixels in at least {} bytes", size[0], size[1], bytes.div_ceil(MOST_EXPANSION));
        return Err(FieldError::malformed(path, "content", expected, format!("{length} bytes")));
    }
    Ok((size, bytes))
}

pub(super) fn read(path: &Path) -> Result<Picture, FieldError> {
    read_noted(path).map(|(picture, _)| picture)
}

/// Reads a picture, and the attribute `comments` of its header.
pub(super) fn read_noted(path: &Path) -> Result<(Picture, Option<String>), FieldError> {
    let [cols, rows] = size(path)?;
    let file = lumistack_files::open(path).map_err(FieldError::io(path, "read"))?;
    let decode = AssertUnwindSafe(|| {
        let layer = read_exr().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
        layer.all_attributes().non_parallel().from_buffered(BufReader::new(file))
    });
    // the decoder panics on some damaged files
    let decoded = std::panic::catch_unwind(decode).map_err(|_| {
        FieldError::malformed(path, "content", "a complete OpenEXR picture", "damaged blocks of pixels")
    })?;
    let layer = decoded.map_err(|error| damaged(path, &error))?.layer_data;
    let note = layer.attributes.comments.map(|text| text.to_string());
    let list = layer.channel_data.list;
    let names: Vec<String> = list.iter().map(|channel| channel.name.to_string()).collect();
    let indices = rgb_channels(&names).ok_or_else(|| {
        FieldError::malformed(path, "channels", "R, G and B, or Y", format!("[{}]", names.join(", ")))
    })?;
    let mut data = vec![0.0; 3 * cols * rows];
    for (channel, index) in indices.into_iter().enumerate() {
        let samples = &list[index].sample_data;
        if samples.len() != cols * rows {
            let found = format!("{} samples for {} pixels", samples.len(), cols * rows);
            return Err(FieldError::malformed(path, &names[index], "one sample per pixel", found));
        }
        let targets = data.iter_mut().skip(channel).step_by(3);
        match samples {
            FlatSamples::F16(values) => targets.zip(values).for_each(|(target, value)| *target = value.to_f32()),
            FlatSamples::F32(values) => targets.zip(values).for_each(|(target, value)| *target = *value),
            FlatSamples::U32(values) => targets.zip(values).for_each(|(target, value)| *target = *value as f32),
        }
    }
    Ok((Picture { cols, rows, samples: Samples::Linear(data) }, note))
}

/// Returns the indices of the channels R, G and B. Channels without a prefix are preferred.
/// Otherwise all three have the same prefix, such as `layer.`: the first prefix for which all three
/// exist. If there are no such channels, the index of luminance is returned three times. Colours in
/// OpenEXR are premultiplied by alpha, so they are already composited over black.
fn rgb_channels(names: &[String]) -> Option<[usize; 3]> {
    let find = |prefix: &str, name: &str| {
        names.iter().position(|n| n.strip_prefix(prefix).is_some_and(|rest| rest.eq_ignore_ascii_case(name)))
    };
    let rgb = |prefix: &str| Some([find(prefix, "R")?, find(prefix, "G")?, find(prefix, "B")?]);
    let prefixes = names.iter().filter_map(|name| name.rfind('.').map(|dot| &name[..=dot]));
    std::iter::once("").chain(prefixes).find_map(rgb).or_else(|| find("", "Y").map(|y| [y; 3]))
}

fn damaged(path: &Path, error: &exr::error::Error) -> FieldError {
    FieldError::malformed(path, "content", "a complete OpenEXR picture", error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_precisions_survive_and_bytes_repeat() {
        let folder = tempfile::tempdir().unwrap();
        let rgb: Vec<f32> = (0..3 * 35).map(|i| f16::from_f32(0.013 * i as f32).to_f32()).collect();
        for precision in [Precision::Half, Precision::Float] {
            let paths = ["a.exr", "b.exr"].map(|name| folder.path().join(name));
            for path in &paths {
                write_exr(path, [7, 5], &rgb, precision).unwrap();
            }
            let bytes = paths.each_ref().map(|path| std::fs::read(path).unwrap());
            assert!(bytes[0] == bytes[1]);
            let picture = Picture::read(&paths[0]).unwrap();
            assert_eq!(picture.size(), [7, 5]);
            assert_eq!(picture.into_linear(), rgb);
        }
    }

    #[test]
    fn a_note_comes_back_and_changes_no_pixel() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        write_exr_noted(&path, [2, 1], &[0.5; 6], Precision::Float, "what it is").unwrap();
        let (picture, note) = Picture::read_noted(&path).unwrap();
        assert_eq!((picture.into_linear(), note.as_deref()), (vec![0.5; 6], Some("what it is")));
        write_exr(&path, [2, 1], &[0.5; 6], Precision::Float).unwrap();
        assert_eq!(Picture::read_noted(&path).unwrap().1, None);
    }

    #[test]
    fn a_picture_without_copies_of_its_channels_has_the_bytes_of_one_with_them() {
        let rgb: Vec<f32> = (0..3 * 90 * 70).map(|i| ((i * i) as f32 * 0.001).sin().abs()).collect();
        for precision in [Precision::Half, Precision::Float] {
            let copied: SmallVec<_> = channels("", [90, 70], &rgb, precision).into_iter().collect();
            let mut bytes = Vec::new();
            let layer = LayerAttributes::default();
            let copied = image([90, 70], layer, COMPRESSION, AnyChannels::sort(copied));
            write_image(io::Cursor::new(&mut bytes), &copied).unwrap();
            assert!(exr_bytes([90, 70], &rgb, precision).unwrap() == bytes, "{precision:?}");
        }
    }

    #[test]
    fn the_first_of_several_views_is_the_one_that_plain_readers_see() {
        let rgb = |view: usize| -> Vec<f32> { (0..3 * 6).map(|i| (100 * view + i) as f32).collect() };
        let mut picture = MultiView::new([3, 2], Precision::Half);
        ["centre", "left", "right"].iter().enumerate().for_each(|(view, name)| picture.push(name, &rgb(view)));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        std::fs::write(&path, picture.into_bytes().unwrap()).unwrap();
        let read = Picture::read(&path).unwrap();
        assert_eq!((read.size(), read.into_linear()), ([3, 2], rgb(0)));
        let header = MetaData::read_from_file(&path, false).unwrap().headers.remove(0);
        assert_eq!(header.own_attributes.multi_view_names.unwrap(), ["centre", "left", "right"].map(Text::from));
        let names: Vec<String> = header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
        assert_eq!(names, ["B", "G", "R", "left.B", "left.G", "left.R", "right.B", "right.G", "right.R"]);
    }

    #[test]
    fn other_channel_orders_alpha_and_types_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let write = |compression, channels: Vec<(&str, FlatSamples)>| {
            let list: SmallVec<_> =
                channels.into_iter().map(|(name, samples)| AnyChannel::new(name, samples)).collect();
            let encoding = Encoding { compression, ..Encoding::default() };
            let layer = Layer::new((2, 1), LayerAttributes::default(), encoding, AnyChannels::sort(list));
            Image::from_layer(layer).write().to_file(&path).unwrap();
        };
        write(
            Compression::PIZ,
            vec![
                ("A", FlatSamples::F32(vec![1.0, 0.5])),
                ("R", FlatSamples::U32(vec![1, 2])),
                ("B", FlatSamples::F16(vec![f16::from_f32(0.25); 2])),
                ("G", FlatSamples::F32(vec![0.5, 0.75])),
            ],
        );
        assert_eq!(Picture::read(&path).unwrap().into_linear(), [1.0, 0.5, 0.25, 2.0, 0.75, 0.25]);
        write(Compression::B44, vec![("Y", FlatSamples::F32(vec![0.5, 0.75]))]);
        assert_eq!(Picture::read(&path).unwrap().into_linear(), [0.5, 0.5, 0.5, 0.75, 0.75, 0.75]);
        write(Compression::RLE, vec![("Z", FlatSamples::F32(vec![0.5, 0.75]))]);
        let error = Picture::read(&path).unwrap_err().to_string();
        assert!(error.ends_with("channels: expected R, G and B, or Y, found [Z]"), "{error}");
        write(Compression::DWAA(None), vec![("Y", FlatSamples::F32(vec![0.5, 0.75]))]);
        let error = Picture::read(&path).unwrap_err().to_string();
        assert!(
            error.ends_with("compression: expected none, RLE, ZIP, PIZ, PXR24 or B44, found dwaa compression"),
            "{error}"
        );
        let names = ["view.R", "view.G", "view.B"].map(String::from);
        assert_eq!(rgb_channels(&names), Some([0, 1, 2]));
    }
}
