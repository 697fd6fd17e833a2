//! Index files: JSON that describes the other files of its folder.

use std::path::Path;

use lumistack_files::MAX_TEXT_BYTES;
use serde::{Deserialize, Serialize};

use crate::{FieldError, atomic};

/// Reads the text of an index.
pub(crate) fn read_index(path: &Path) -> Result<Vec<u8>, FieldError> {
    lumistack_files::read_at_most(path, MAX_TEXT_BYTES).map_err(FieldError::io(path, "read"))
}

pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), FieldError> {
    atomic::write(path, |writer| {
        serde_json::to_writer_pretty(&mut *writer, value)?;
        std::io::Write::write_all(writer, b"\n")
    })
}

pub(crate) fn parse_json<'a, T: Deserialize<'a>>(path: &Path, text: &'a [u8]) -> Result<T, FieldError> {
    serde_json::from_slice(text).map_err(|error| {
        let place = format!("line {}, column {}", error.line(), error.column());
        let text = lumistack_core::config::plain(&error.to_string(), "");
        let text = text.split(" at line ").next().unwrap_or_default();
        match text.strip_prefix("expected ").and_then(|rest| rest.split_once(", found ")) {
            Some((expected, found)) => FieldError::malformed(path, place, expected, found),
            None => FieldError::malformed(path, place, "complete JSON with valid keys", text),
        }
    })
}

pub(crate) fn check_schema(
    path: &Path,
    schema: &str,
    expected_schema: &str,
    version: u32,
    newest: u32,
) -> Result<(), FieldError> {
    if schema != expected_schema {
        return Err(FieldError::malformed(path, "schema", expected_schema, schema));
    }
    if version == 0 || version > newest {
        return Err(FieldError::malformed(path, "version", format!("1 to {newest}"), version.to_string()));
    }
    Ok(())
}
