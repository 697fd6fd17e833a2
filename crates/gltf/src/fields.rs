//! Reads members of the JSON objects of extensions and animations, without the types of the
//! external crate `gltf`.

use gltf::json;
use serde_json::Value;

use crate::document::Document;
use crate::error::Fault;
use crate::quote::quote;

/// A JSON object of the file and its place.
pub(crate) struct Fields<'d> {
    place: String,
    members: &'d serde_json::Map<String, Value>,
}

impl<'d> Fields<'d> {
    /// Returns the object at a JSON pointer; `None` if the file has no value there.
    pub(crate) fn at(document: &'d Document<'_>, place: String) -> Result<Option<Self>, Fault> {
        match document.json(&place) {
            None => Ok(None),
            Some(Value::Object(members)) => Ok(Some(Self { place, members })),
            Some(other) => Err(Fault::new(place, "an object", quote(Some(other)))),
        }
    }

    /// Returns the JSON pointer to the object.
    pub(crate) fn here(&self) -> &str {
        &self.place
    }

    /// Returns the JSON pointer to a member.
    pub(crate) fn place(&self, key: &str) -> String {
        format!("{}/{key}", self.place)
    }

    fn read<T>(
        &self,
        key: &str,
        expected: &str,
        parse: impl FnOnce(&'d Value) -> Option<T>,
    ) -> Result<Option<T>, Fault> {
        let Some(value) = self.members.get(key) else { return Ok(None) };
        parse(value).map(Some).ok_or_else(|| Fault::new(self.place(key), expected, quote(Some(value))))
    }

    pub(crate) fn number(&self, key: &str, default: f32) -> Result<f32, Fault> {
        Ok(self.read(key, "a number", |value| value.as_f64().map(|number| number as f32))?.unwrap_or(default))
    }

    pub(crate) fn numbers<const N: usize>(&self, key: &str, default: [f32; N]) -> Result<[f32; N], Fault> {
        Ok(self.read(key, &format!("{N} numbers"), numbers::<N>)?.unwrap_or(default))
    }

    pub(crate) fn text(&self, key: &str) -> Result<Option<&'d str>, Fault> {
        self.read(key, "a text", Value::as_str)
    }

    /// Returns a member that is a whole number; `None` if the member is absent.
    pub(crate) fn count(&self, key: &str) -> Result<Option<u64>, Fault> {
        self.read(key, "a whole number", Value::as_u64)
    }

    /// Returns the index of an object of the file; [`Document::get`] checks it when the object is
    /// read.
    pub(crate) fn index<T>(&self, key: &str) -> Result<Option<json::Index<T>>, Fault> {
        self.read(key, "an index", |value| value.as_u64().map(|index| json::Index::new(index as u32)))
    }

    /// Returns the same as [`index`](Self::index), but an error if the member is absent.
    pub(crate) fn needed_index<T>(&self, key: &str) -> Result<json::Index<T>, Fault> {
        self.index(key)?.ok_or_else(|| Fault::new(self.place(key), "an index", "nothing"))
    }

    /// Returns the number of entries of a list; 0 if the list is absent.
    pub(crate) fn list(&self, key: &str) -> Result<usize, Fault> {
        Ok(self.read(key, "a list", |value| value.as_array().map(Vec::len))?.unwrap_or(0))
    }
}

pub(crate) fn numbers<const N: usize>(value: &Value) -> Option<[f32; N]> {
    let list = value.as_array().filter(|list| list.len() == N)?;
    let mut numbers = [0.0; N];
    for (number, value) in numbers.iter_mut().zip(list) {
        *number = value.as_f64()? as f32;
    }
    Some(numbers)
}
