//! The opened file: checked access to its objects, the bytes of its buffers and files, and the
//! memory that is left for decoding it.

use std::borrow::Cow;
use std::cell::{Cell, OnceCell, RefCell};
use std::collections::HashMap;

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use gltf::json;
use gltf::json::root::Get;
use lumistack_core::Task;
use percent_encoding::percent_decode_str;
use serde_json::Value;

use crate::container::Container;
use crate::error::Fault;
use crate::quote::{quote, shorten};
use crate::unpack::{Packed, Unpacked, Unsound};
use crate::{AssetResolver, LoadOptions};

/// An opened glTF file, with the buffers and files that have been read.
pub(crate) struct Document<'a> {
    pub(crate) root: json::Root,
    pub(crate) task: Task<'a>,
    /// Index of the chosen variant of materials.
    pub(crate) variant: Option<usize>,
    raw: Value,
    bin: Option<&'a [u8]>,
    /// Content of every buffer's file or data URI. Buffers with the same URI share one entry, which
    /// has the index of the first of these buffers.
    buffers: Vec<OnceCell<Cow<'a, [u8]>>>,
    /// For every buffer, the index of the first buffer with the same URI.
    first_buffer: Vec<usize>,
    /// For every image, the index of the first image with the same URI.
    pub(crate) first_image: Vec<usize>,
    /// Unpacked content of the buffer views that the file holds compressed.
    pub(crate) unpacked_views: Vec<OnceCell<Vec<u8>>>,
    resolver: &'a dyn AssetResolver,
    max_decoded_bytes: u64,
    decoded_bytes: Cell<u64>,
    max_picture_bytes: u64,
    picture_bytes: Cell<u64>,
    /// Primitives that were left out: the reason and the place of the first one, and the number of
    /// all.
    pub(crate) left_out: RefCell<(Option<String>, usize)>,
}

impl<'a> Document<'a> {
    pub(crate) fn new(
        container: Container<'a>,
        resolver: &'a dyn AssetResolver,
        options: &LoadOptions,
        task: Task<'a>,
    ) -> Self {
        let Container { raw, root, bin } = container;
        let first_buffer = firsts(root.buffers.iter().map(|buffer| buffer.uri.as_deref()));
        let first_image = firsts(root.images.iter().map(|image| image.uri.as_deref()));
        let buffers = root.buffers.iter().map(|_| OnceCell::new()).collect();
        let unpacked_views = root.buffer_views.iter().map(|_| OnceCell::new()).collect();
        Self {
            root,
            task,
            variant: None,
            raw,
            bin,
            buffers,
            first_buffer,
            first_image,
            unpacked_views,
            resolver,
            max_decoded_bytes: options.max_decoded_bytes,
            decoded_bytes: Cell::new(0),
            max_picture_bytes: options.max_picture_bytes,
            picture_bytes: Cell::new(0),
            left_out: RefCell::default(),
        }
    }

    /// Returns the JSON value at a pointer.
    pub(crate) fn json(&self, place: &str) -> Option<&Value> {
        self.raw.pointer(place)
    }

    /// Returns the JSON value at a pointer, as text for messages.
    pub(crate) fn quote(&self, place: &str) -> String {
        quote(self.json(place))
    }

    /// Returns the object that the index at `place` refers to.
    pub(crate) fn get<T>(&self, index: json::Index<T>, place: &str) -> Result<&T, Fault>
    where
        json::Root: Get<T> + AsRef<[T]>,
    {
        // the typed reader keeps only 32 bits of an index, so check that the number in the file
        // equals the index
        let written = self.json(place).and_then(Value::as_u64);
        match self.root.get(index) {
            // a caller that iterates over a list gives a place without a number, so there is
            // nothing to compare
            Some(item) if written.is_none_or(|written| written == index.value() as u64) => Ok(item),
            _ => {
                let count = AsRef::<[T]>::as_ref(&self.root).len();
                let expected = match count {
                    0 => "no index, since the file has nothing to which the index could refer".to_owned(),
                    _ => format!("an index below {count}"),
                };
                Err(Fault::new(place, expected, self.quote(place)))
            }
        }
    }

    /// Adds bytes of decoded content to the sum of all such bytes. Fails if the sum exceeds the
    /// limit.
    pub(crate) fn spend(&self, place: &str, elements: usize, element_bytes: usize) -> Result<(), Fault> {
        let bytes = elements as u64 * element_bytes as u64;
        let total = self.decoded_bytes.get().saturating_add(bytes);
        if total > self.max_decoded_bytes {
            let expected = format!("a scene that decodes to at most {} MiB", self.max_decoded_bytes >> 20);
            return Err(Fault::new(
                place,
                expected,
                format!("a larger scene, since {place} needs {bytes} bytes in addition to the parts decoded before"),
            ));
        }
        self.decoded_bytes.set(total);
        Ok(())
    }

    /// Adds the bytes of a decoded picture to the sum of all pictures. Fails if the sum exceeds the
    /// limit. `size` describes the picture.
    pub(crate) fn spend_on_picture(&self, place: &str, bytes: u64, size: &str) -> Result<(), Fault> {
        let before = self.picture_bytes.get();
        let total = before.saturating_add(bytes);
        if total > self.max_picture_bytes {
            let most = self.max_picture_bytes >> 20;
            let expected = format!("pictures that decode to at most {most} MiB together (the picture budget)");
            let found = format!(
                "a picture of {size}, which needs {} MiB in addition to the {} MiB of earlier pictures",
                bytes.div_ceil(1 << 20),
                before >> 20
            );
            return Err(Fault::new(place, expected, found));
        }
        self.picture_bytes.set(total);
        Ok(())
    }

    /// Warns that a primitive is left out, and stores the first reason.
    pub(crate) fn leave_out(&self, place: &str, reason: String) {
        let mut left_out = self.left_out.borrow_mut();
        left_out.0.get_or_insert_with(|| format!("{place}: {reason}"));
        left_out.1 += 1;
        self.task.warn(place, reason);
    }

    /// Returns the number of bytes that may still be allocated.
    pub(crate) fn affordable_bytes(&self) -> u64 {
        self.max_decoded_bytes.saturating_sub(self.decoded_bytes.get())
    }

    /// Decodes the packed content at `place`. `wanted` extracts the value from a result of the
    /// expected kind, and returns `None` for every other kind.
    pub(crate) fn unpack<T>(
        &self,
        place: &str,
        packed: &Packed<'_>,
        wanted: impl FnOnce(Unpacked) -> Option<T>,
    ) -> Result<T, Fault> {
        let unpacked = self.resolver.unpack(packed).and_then(|unpacked| wanted(unpacked).ok_or(packed.stopped()));
        unpacked.map_err(|Unsound { place: within, expected, found }| {
            let place = if within.is_empty() { place.to_owned() } else { format!("{place}: {within}") };
            Fault::new(place, expected, found)
        })
    }

    /// Returns a part of a buffer. `place` is the object with the fields `buffer` and `byteLength`.
    pub(crate) fn range(
        &self,
        buffer: json::Index<json::Buffer>,
        offset: u64,
        length: u64,
        place: &str,
    ) -> Result<&[u8], Fault> {
        let bytes = self.buffer(buffer, &format!("{place}/buffer"))?;
        let range = offset.checked_add(length).and_then(|end| {
            let (start, end) = (usize::try_from(offset).ok()?, usize::try_from(end).ok()?);
            bytes.get(start..end)
        });
        range.ok_or_else(|| {
            let room = (bytes.len() as u64).saturating_sub(offset);
            let expected = format!("at most {room} bytes, which buffer {} has after byteOffset", buffer.value());
            Fault::new(format!("{place}/byteLength"), expected, length)
        })
    }

    /// Returns the bytes of a buffer, read on first use.
    pub(crate) fn buffer(&self, index: json::Index<json::Buffer>, place: &str) -> Result<&[u8], Fault> {
        let buffer = self.get(index, place)?;
        let cell = &self.buffers[self.first_buffer[index.value()]];
        let place = format!("/buffers/{}", index.value());
        let bytes = match (cell.get(), &buffer.uri, self.bin) {
            (Some(bytes), ..) => bytes,
            (None, Some(uri), _) => {
                let place = format!("{place}/uri");
                let bytes = self.read_uri(uri, &place, self.affordable_bytes())?;
                self.spend(&place, bytes.len(), 1)?;
                cell.get_or_init(|| Cow::Owned(bytes))
            }
            (None, None, Some(bin)) if index.value() == 0 => cell.get_or_init(|| Cow::Borrowed(bin)),
            (None, None, _) => {
                let expected = "a file, a data URI or the binary chunk of a .glb";
                return Err(Fault::new(format!("{place}/uri"), expected, "none"));
            }
        };
        // the binary chunk is padded, and a file may be longer than its buffer, so use only the
        // buffer's own length
        usize::try_from(buffer.byte_length.0).ok().and_then(|length| bytes.get(..length)).ok_or_else(|| {
            let expected = format!("at most {} bytes, the length of the buffer's data", bytes.len());
            Fault::new(format!("{place}/byteLength"), expected, buffer.byte_length.0)
        })
    }

    /// Returns the content of a URI: the bytes of a data URI, or of a file relative to the glTF
    /// file.
    pub(crate) fn read_uri(&self, uri: &str, place: &str, max_bytes: u64) -> Result<Vec<u8>, Fault> {
        self.task.cancel.check()?;
        if let Some(data) = uri.strip_prefix("data:") {
            return decode_data_uri(data, place);
        }
        let scheme = uri.split_once(':').map(|(scheme, _)| scheme);
        // a scheme of one letter is a Windows drive, so the resolver decides about it
        if scheme.is_some_and(|scheme| {
            scheme.len() > 1 && scheme.bytes().all(|b| b.is_ascii_alphanumeric() || b"+-.".contains(&b))
        }) {
            return Err(Fault::new(place, "a path relative to the file, or a data URI", shorten(uri)));
        }
        let path = percent_decode_str(uri).decode_utf8();
        let path = path.map_err(|_| Fault::new(place, "percent-encoded UTF-8", shorten(uri)))?;
        let read = self.resolver.read(&path, max_bytes);
        read.map_err(|reason| Fault::new(place, "a readable file", format!("{path}: {reason}")))
    }
}

/// Returns, for every entry, the index of the first entry with the same URI; for an entry without a
/// URI, its own index.
fn firsts<'u>(uris: impl Iterator<Item = Option<&'u str>>) -> Vec<usize> {
    let mut known = HashMap::new();
    uris.enumerate().map(|(i, uri)| uri.map_or(i, |uri| *known.entry(uri).or_insert(i))).collect()
}

/// Base64 decoder that accepts data without padding, which some writers leave out.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// Decodes the content of `data:<data>` (RFC 2397).
fn decode_data_uri(data: &str, place: &str) -> Result<Vec<u8>, Fault> {
    let Some((kind, content)) = data.split_once(',') else {
        return Err(Fault::new(place, "a comma before the content of the data URI", shorten(data)));
    };
    if !kind.ends_with(";base64") {
        return Ok(percent_decode_str(content).collect());
    }
    BASE64.decode(content).map_err(|error| Fault::new(place, "base64", error))
}
