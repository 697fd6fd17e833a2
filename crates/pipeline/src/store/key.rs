//! Keys of results. A key is a hash of everything that a result depends on: code, settings, and the
//! content of files. The number of threads is not part of a key.

use std::path::Path;

use lumistack_core::bytes;
use lumistack_display::LightField;
use serde::Serialize;

use super::code::Code;

/// Returns the BLAKE3 hash of bytes, hexadecimal.
pub(crate) fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Returns the hash of a file's content.
pub(crate) fn content_hash(path: &Path) -> std::io::Result<String> {
    let mut hash = blake3::Hasher::new();
    hash.update_reader(std::fs::File::open(path)?)?;
    Ok(hash.finalize().to_hex().to_string())
}

/// Collects everything that a result depends on, in a hash.
#[derive(Clone)]
pub(crate) struct KeyBuilder(blake3::Hasher);

impl KeyBuilder {
    /// Begins the key of a stage whose results depend on `code`.
    pub(crate) fn new(stage: &str, code: Code) -> Self {
        let mut builder = Self(blake3::Hasher::new());
        builder.add("stage", stage.as_bytes());
        for fingerprint in code {
            builder.add("code", fingerprint.as_bytes());
        }
        builder
    }

    /// Adds a value with a label. Their lengths are hashed too. Otherwise two different pairs of
    /// label and value could give the same bytes.
    pub(crate) fn add(&mut self, label: &str, bytes: &[u8]) -> &mut Self {
        for part in [label.as_bytes(), bytes] {
            self.0.update(&(part.len() as u64).to_le_bytes());
            self.0.update(part);
        }
        self
    }

    /// Adds a value as JSON.
    pub(crate) fn add_json(&mut self, label: &str, value: &impl Serialize) -> &mut Self {
        let text = serde_json::to_string(value).expect("settings serialize");
        self.add(label, text.as_bytes())
    }

    /// Adds the bits of floating-point values.
    pub(crate) fn add_f32(&mut self, label: &str, values: &[f32]) -> &mut Self {
        self.add_count(label, values.len()).add_values(values)
    }

    /// Adds the values of a light field, view by view, since the light field may be in a file.
    pub(crate) fn add_field(&mut self, label: &str, field: &LightField) -> &mut Self {
        self.add_count(label, field.radiance().data().len());
        for view in field.geometry().grid.iter() {
            self.add_values(field.view(view));
        }
        self
    }

    fn add_count(&mut self, label: &str, count: usize) -> &mut Self {
        self.0.update(&(label.len() as u64).to_le_bytes());
        self.0.update(label.as_bytes());
        self.0.update(&(count as u64).to_le_bytes());
        self
    }

    fn add_values(&mut self, values: &[f32]) -> &mut Self {
        // BLAKE3 hashes several blocks of a long piece of data together, by vector instructions.
        // With pieces of 16 KB, it hashed the blocks one by one.
        const PIECE: usize = 1 << 18;
        let mut buffer = Vec::with_capacity(4 * PIECE.min(values.len()));
        for chunk in values.chunks(PIECE) {
            buffer.clear();
            bytes::append(&mut buffer, chunk);
            self.0.update(&buffer);
        }
        self
    }

    /// Returns the key.
    pub(crate) fn bytes(&self) -> [u8; 32] {
        self.0.finalize().into()
    }

    /// Returns the key, hexadecimal.
    pub(crate) fn finish(&self) -> String {
        self.0.finalize().to_hex().to_string()
    }
}
