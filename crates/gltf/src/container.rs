//! The container of a glTF file: the two chunks of a `.glb`, the JSON text, and the structure of
//! the JSON.
//!
//! Source: glTF 2.0 specification, sections 3.2 (JSON) and 4 (GLB).

use gltf::json;
use serde_json::{Number, Value};

use crate::error::Fault;
use crate::typed::{Mistyped, typed};

/// The contents of a file's container.
pub(crate) struct Container<'a> {
    /// The JSON without types, for quotations in messages and for extensions without a type.
    pub(crate) raw: Value,
    /// The JSON as typed values, whose indices are not checked yet.
    pub(crate) root: json::Root,
    /// The binary chunk of a `.glb`, if the file has one.
    pub(crate) bin: Option<&'a [u8]>,
}

impl<'a> Container<'a> {
    /// Reads a `.gltf` or `.glb` file; the first four bytes decide which of the two it is.
    pub(crate) fn open(bytes: &'a [u8]) -> Result<Self, Fault> {
        if bytes.is_empty() {
            return Err(Fault::new("byte 0", "a glTF file", "an empty file"));
        }
        let (text, bin) = if bytes.starts_with(MAGIC) { split_glb(bytes)? } else { (bytes, None) };
        let text = text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text);
        let mut raw: Value = serde_json::from_slice(text).map_err(|error| syntax_fault(text, &error))?;
        write_integers_as_integers(&mut raw);
        let untyped = adapt_to_types(&mut raw);
        let root = typed(&raw).map_err(|Mistyped { place, message }| structure_fault(place, &message))?;
        if let (Some(members), Some(untyped)) = (raw.as_object_mut(), untyped) {
            members.insert(ANIMATIONS.to_owned(), untyped);
        }
        let container = Self { raw, root, bin };
        container.check_version()?;
        Ok(container)
    }

    fn check_version(&self) -> Result<(), Fault> {
        let asset = &self.root.asset;
        let minimum = asset.min_version.as_deref().map(|version| ("/asset/minVersion", version, version == "2.0"));
        let version = ("/asset/version", asset.version.as_str(), asset.version.starts_with("2."));
        let (place, found, supported) = minimum.unwrap_or(version);
        if supported { Ok(()) } else { Err(Fault::new(place, "2.0", format!("{found:?}"))) }
    }
}

const ANIMATIONS: &str = "animations";
const MAGIC: &[u8] = b"glTF";
/// glTF forbids this mark at the start of JSON, but some editors write it.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;

/// Returns the JSON chunk and the binary chunk of a `.glb`.
fn split_glb(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), Fault> {
    let version = word(bytes, 4)?;
    if version != 2 {
        return Err(Fault::new("byte 4", "GLB version 2", version));
    }
    let length = word(bytes, 8)? as usize;
    if length < HEADER_BYTES {
        let expected = format!("a length of at least {HEADER_BYTES} bytes, the size of the header");
        return Err(Fault::new("byte 8", expected, length));
    }
    let Some(file) = bytes.get(..length) else {
        return Err(Fault::new("byte 8", format!("a file of {length} bytes"), bytes.len()));
    };
    let (json, next) = chunk(file, HEADER_BYTES, b"JSON", "a JSON chunk")?;
    let bin = match file.get(next + 4..next + CHUNK_HEADER_BYTES) {
        // a chunk of another type may follow the JSON, and is ignored
        Some(kind) if kind != b"BIN\0" => None,
        None if next >= file.len() => None,
        _ => Some(chunk(file, next, b"BIN\0", "a binary chunk")?.0),
    };
    Ok((json, bin))
}

/// Returns the content of the chunk at `start`, and the start of the next chunk.
fn chunk<'a>(file: &'a [u8], start: usize, kind: &[u8; 4], name: &str) -> Result<(&'a [u8], usize), Fault> {
    let length = word(file, start)? as usize;
    let found = file.get(start + 4..start + CHUNK_HEADER_BYTES).unwrap_or_default();
    if found != kind {
        return Err(Fault::new(format!("byte {}", start + 4), name, found.escape_ascii()));
    }
    let start = start + CHUNK_HEADER_BYTES;
    match start.checked_add(length).and_then(|end| Some((file.get(start..end)?, end))) {
        Some(found) => Ok(found),
        None => Err(Fault::new(
            format!("byte {}", start - CHUNK_HEADER_BYTES),
            format!("{name} of {length} bytes"),
            format!("{} bytes to the end of the file", file.len() - start),
        )),
    }
}

fn word(bytes: &[u8], at: usize) -> Result<u32, Fault> {
    match bytes.get(at..).and_then(|tail| tail.first_chunk()) {
        Some(&word) => Ok(u32::from_le_bytes(word)),
        None => Err(Fault::new(format!("byte {at}"), "four more bytes", "the end of the file")),
    }
}

/// Rewrites integers: glTF allows `1.0` or `1e0` for the integer 1, but the typed reader does not
/// accept them.
fn write_integers_as_integers(value: &mut Value) {
    const EXACT: f64 = 9_007_199_254_740_992.0;
    match value {
        Value::Number(number) if number.is_f64() => {
            if let Some(float) = number.as_f64()
                && float.fract() == 0.0
                && (0.0..EXACT).contains(&float)
                && float.is_sign_positive()
            {
                *number = Number::from(float as u64);
            }
        }
        Value::Array(items) => items.iter_mut().for_each(write_integers_as_integers),
        Value::Object(members) => members.values_mut().for_each(write_integers_as_integers),
        _ => {}
    }
}

/// Adds values that glTF leaves optional but the `gltf` crate's types require: the nodes of a
/// scene. Removes and returns the animations, which are read without types.
fn adapt_to_types(raw: &mut Value) -> Option<Value> {
    let scenes = raw.get_mut("scenes").and_then(Value::as_array_mut);
    for scene in scenes.into_iter().flatten().filter_map(Value::as_object_mut) {
        scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
    }
    raw.as_object_mut()?.remove(ANIMATIONS)
}

fn syntax_fault(text: &[u8], error: &serde_json::Error) -> Fault {
    let start = text.trim_ascii_start();
    if !start.starts_with(b"{") {
        let found = format!("\"{}\"", start[..start.len().min(12)].escape_ascii());
        return Fault::new("byte 0", "a glTF file, which starts with { or glTF", found);
    }
    let message = error.to_string();
    let message = message.split(" at line ").next().unwrap_or_default();
    Fault::new(format!("line {} column {}", error.line(), error.column()), "valid JSON", format!("an error: {message}"))
}

/// Replaces names of Rust types in a message of serde by words.
fn plainly(expected: &str) -> &str {
    match expected {
        "f32" | "f64" => "a number",
        "u32" | "u64" | "usize" => "a whole number ≥ 0",
        "fewer elements in array" => "a shorter list",
        "fewer elements in map" => "an object with fewer members",
        other if other.starts_with("struct ") => "an object",
        other => other,
    }
}

/// Splits the message of serde into the expected and the found part.
fn structure_fault(place: String, message: &str) -> Fault {
    if let Some(field) = message.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        return Fault::new(format!("{place}/{field}"), "a value", "nothing");
    }
    let place = if place.is_empty() { "/".to_owned() } else { place };
    let sentence = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    let sentence = sentence.or_else(|| message.strip_prefix("invalid "));
    match sentence.unwrap_or(message).split_once(", expected ") {
        Some((found, expected)) => Fault::new(place, plainly(expected), found),
        None => Fault::new(place, "the structure of glTF 2.0", message),
    }
}
