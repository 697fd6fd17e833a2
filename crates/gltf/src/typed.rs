//! Converts JSON to typed values, and reports the place of an error as a JSON pointer.
//!
//! This deserializer is like the one of `serde_json::Value`, but it records the place of an error.
//! Where a type expects a text, a list, an object or a truth value, the deserializer accepts only
//! this kind of JSON. So the compiler leaves out the code that would read other kinds.
//!
//! The alternative is `serde_path_to_error`, a wrapper around the deserializer of `serde_json`.
//! With it, the code that reads each type is compiled once more. In a module for the web, the
//! additional code was a twelfth of the module's size.

use std::fmt::{Display, Write};

use serde::de::value::StrDeserializer;
use serde::de::{
    Deserialize, DeserializeSeed, Deserializer, EnumAccess, Error, Expected, IntoDeserializer, MapAccess, SeqAccess,
    Unexpected, VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;
use serde_json::{Value, map};

/// The error of a JSON value that has another type than expected.
#[derive(Debug)]
pub(crate) struct Mistyped {
    /// JSON pointer to the value.
    pub(crate) place: String,
    /// The description of the error by the library serde.
    pub(crate) message: String,
}

/// Converts a JSON value to a value of type `T`.
pub(crate) fn typed<'v, T: Deserialize<'v>>(value: &'v Value) -> Result<T, Mistyped> {
    T::deserialize(Typed(value))
}

impl Mistyped {
    fn below(mut self, segment: &dyn Display) -> Self {
        self.place = format!("/{segment}{}", self.place);
        self
    }
}

impl Display for Mistyped {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Mistyped {}

impl Error for Mistyped {
    fn custom<T: Display>(message: T) -> Self {
        Self { place: String::new(), message: message.to_string() }
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        let mut message = String::from("invalid type: ");
        // serde names a null "unit value", so its message is replaced
        let written = match found {
            Unexpected::Unit => write!(message, "null, expected {expected}"),
            found => write!(message, "{found}, expected {expected}"),
        };
        written.map_or_else(Self::custom, |()| Self { place: String::new(), message })
    }
}

struct Typed<'v>(&'v Value);

impl Typed<'_> {
    fn unexpected(&self, expected: &dyn Expected) -> Mistyped {
        let found = match self.0 {
            Value::Null => Unexpected::Unit,
            Value::Bool(value) => Unexpected::Bool(*value),
            Value::String(text) => Unexpected::Str(text),
            Value::Array(_) => Unexpected::Seq,
            Value::Object(_) => Unexpected::Map,
            Value::Number(number) => match (number.as_u64(), number.as_i64()) {
                (Some(number), _) => Unexpected::Unsigned(number),
                (None, Some(number)) => Unexpected::Signed(number),
                (None, None) => Unexpected::Float(number.as_f64().unwrap_or(f64::NAN)),
            },
        };
        Mistyped::invalid_type(found, expected)
    }
}

impl<'v> Deserializer<'v> for Typed<'v> {
    type Error = Mistyped;

    fn deserialize_any<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Mistyped> {
        match self.0 {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::String(text) => visitor.visit_borrowed_str(text),
            Value::Number(number) => match (number.as_u64(), number.as_i64(), number.as_f64()) {
                (Some(number), ..) => visitor.visit_u64(number),
                (None, Some(number), _) => visitor.visit_i64(number),
                (None, None, Some(number)) => visitor.visit_f64(number),
                (None, None, None) => Err(Mistyped::custom("a number out of range")),
            },
            Value::Array(_) => self.deserialize_seq(visitor),
            Value::Object(_) => self.deserialize_map(visitor),
        }
    }

    fn deserialize_seq<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Mistyped> {
        let Value::Array(items) = self.0 else { return Err(self.unexpected(&visitor)) };
        let mut list = List { items, next: 0 };
        let value = visitor.visit_seq(&mut list)?;
        list.is_read(value)
    }

    fn deserialize_tuple<V: Visitor<'v>>(self, _: usize, visitor: V) -> Result<V::Value, Mistyped> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'v>>(
        self,
        _: &'static str,
        _: usize,
        visitor: V,
    ) -> Result<V::Value, Mistyped> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_map<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Mistyped> {
        let Value::Object(members) = self.0 else { return Err(self.unexpected(&visitor)) };
        let mut table = Table { left: members.iter(), value: None };
        let value = visitor.visit_map(&mut table)?;
        match table.left.len() {
            0 => Ok(value),
            _ => Err(Mistyped::invalid_length(members.len(), &"fewer elements in map")),
        }
    }

    /// Accepts only an object, as glTF does; serde would also accept an array of the members.
    fn deserialize_struct<V: Visitor<'v>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Mistyped> {
        self.deserialize_map(visitor)
    }

    fn deserialize_str<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Mistyped> {
        match self.0 {
            Value::String(text) => visitor.visit_borrowed_str(text),
            _ => Err(self.unexpected(&visitor)),
        }
    }

    fn deserialize_string<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Mistyped> {
        self.deserialize_str(visitor)
    }

    fn deserialize_bool<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Mistyped> {
        match self.0 {
            Value::Bool(value) => visitor.visit_bool(*value),
            _ => Err(self.unexpected(&visitor)),
        }
    }

    fn deserialize_option<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Mistyped> {
        if self.0.is_null() { visitor.visit_none() } else { visitor.visit_some(self) }
    }

    fn deserialize_newtype_struct<V: Visitor<'v>>(self, name: &'static str, visitor: V) -> Result<V::Value, Mistyped> {
        // Extras keep their JSON text. Only the deserializer of `serde_json` itself can provide the
        // text.
        if name.starts_with("$serde_json") {
            return self.0.deserialize_newtype_struct(name, visitor).map_err(Mistyped::custom);
        }
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'v>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Mistyped> {
        visitor.visit_enum(self)
    }

    fn deserialize_ignored_any<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Mistyped> {
        visitor.visit_unit()
    }

    forward_to_deserialize_any! {
        <V: Visitor<'v>>
        i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char bytes byte_buf unit unit_struct identifier
    }
}

/// Reads a variant of an enum, which is a text, or an object of one member.
impl<'v> EnumAccess<'v> for Typed<'v> {
    type Error = Mistyped;
    type Variant = Content<'v>;

    fn variant_seed<V: DeserializeSeed<'v>>(self, seed: V) -> Result<(V::Value, Content<'v>), Mistyped> {
        let (name, content) = match self.0 {
            Value::String(name) => (name, None),
            Value::Object(members) if members.len() == 1 => {
                let (name, content) = members.iter().next().unzip();
                (name.ok_or_else(|| Mistyped::custom("a variant without a name"))?, content)
            }
            _ => {
                return Err(Mistyped::custom(
                    "invalid type: another value, expected a text or an object of one member",
                ));
            }
        };
        let name: StrDeserializer<'_, Mistyped> = name.as_str().into_deserializer();
        Ok((seed.deserialize(name)?, Content(content)))
    }
}

/// Content of a variant of an enum, if it has content.
struct Content<'v>(Option<&'v Value>);

impl<'v> Content<'v> {
    fn value(self) -> Result<Typed<'v>, Mistyped> {
        self.0.map(Typed).ok_or_else(|| Mistyped::custom("a variant without its content"))
    }
}

impl<'v> VariantAccess<'v> for Content<'v> {
    type Error = Mistyped;

    fn unit_variant(self) -> Result<(), Mistyped> {
        self.0.map_or(Ok(()), |value| Deserialize::deserialize(Typed(value)))
    }

    fn newtype_variant_seed<T: DeserializeSeed<'v>>(self, seed: T) -> Result<T::Value, Mistyped> {
        seed.deserialize(self.value()?)
    }

    fn tuple_variant<V: Visitor<'v>>(self, _: usize, visitor: V) -> Result<V::Value, Mistyped> {
        self.value()?.deserialize_any(visitor)
    }

    fn struct_variant<V: Visitor<'v>>(self, _: &'static [&'static str], visitor: V) -> Result<V::Value, Mistyped> {
        self.value()?.deserialize_any(visitor)
    }
}

struct List<'v> {
    items: &'v [Value],
    next: usize,
}

impl List<'_> {
    fn is_read<T>(&self, value: T) -> Result<T, Mistyped> {
        let count = self.items.len();
        if self.next == count { Ok(value) } else { Err(Mistyped::invalid_length(count, &"fewer elements in array")) }
    }
}

impl<'v> SeqAccess<'v> for &mut List<'v> {
    type Error = Mistyped;

    fn next_element_seed<T: DeserializeSeed<'v>>(&mut self, seed: T) -> Result<Option<T::Value>, Mistyped> {
        let Some(item) = self.items.get(self.next) else { return Ok(None) };
        let index = self.next;
        self.next += 1;
        seed.deserialize(Typed(item)).map(Some).map_err(|error| error.below(&index))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.items.len() - self.next)
    }
}

struct Table<'v> {
    left: map::Iter<'v>,
    /// The member whose key was read last, and whose value comes next.
    value: Option<(&'v str, &'v Value)>,
}

impl<'v> MapAccess<'v> for &mut Table<'v> {
    type Error = Mistyped;

    fn next_key_seed<K: DeserializeSeed<'v>>(&mut self, seed: K) -> Result<Option<K::Value>, Mistyped> {
        let Some((key, value)) = self.left.next() else { return Ok(None) };
        self.value = Some((key.as_str(), value));
        seed.deserialize(serde::de::value::BorrowedStrDeserializer::new(key)).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'v>>(&mut self, seed: V) -> Result<V::Value, Mistyped> {
        let (key, value) = self.value.take().ok_or_else(|| Mistyped::custom("a value before its key"))?;
        seed.deserialize(Typed(value)).map_err(|error| error.below(&key))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left.len())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Deserialize;
    use serde_json::json;

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    enum Kind {
        Plain,
        Sized(u8),
        Boxed { side: f32 },
    }

    #[derive(Debug, PartialEq, Deserialize)]
    struct Root {
        count: u8,
        at: [f32; 2],
        #[serde(default)]
        kinds: Vec<Kind>,
        #[serde(flatten)]
        rest: BTreeMap<String, Value>,
    }

    #[test]
    fn values_are_those_of_the_untyped_reader_and_errors_have_places() {
        let text =
            json!({"count": 3, "at": [1, 2.5], "kinds": ["Plain", {"Sized": 4}, {"Boxed": {"side": 1}}], "more": null});
        assert_eq!(typed::<Root>(&text).unwrap(), serde_json::from_value(text.clone()).unwrap());
        for (pointer, wrong, place) in [
            ("/count", json!("3"), ""),
            ("/count", json!(null), ""),
            ("/count", json!(-3), ""),
            ("/count", json!([3]), ""),
            ("/at", json!("x"), ""),
            ("/at", json!({"0": 1, "1": 2}), ""),
            ("/kinds", json!(2.5), ""),
            ("/count", json!(300), ""),
            ("/at", json!([1.0]), ""),
            ("/at", json!([1.0, 2.0, 3.0]), ""),
            ("/at", json!([1.0, true]), "/1"),
            ("/kinds", json!({"a": 1}), ""),
            ("/kinds/1/Sized", json!("x"), ""),
            ("/kinds/0", json!("Round"), ""),
        ] {
            let mut text = text.clone();
            *text.pointer_mut(pointer).unwrap() = wrong.clone();
            let error = typed::<Root>(&text).unwrap_err();
            let same = serde_json::from_value::<Root>(text).unwrap_err();
            assert_eq!(error.message, same.to_string(), "{pointer} {wrong}");
            let pointer = pointer.trim_end_matches("/Sized");
            assert_eq!(error.place, format!("{pointer}{place}"), "{wrong}");
        }
        let error = typed::<Root>(&json!([3, [1, 2]])).unwrap_err();
        assert_eq!(error.message, "invalid type: sequence, expected struct Root");
        let error = typed::<Root>(&json!({"at": [0, 0]})).unwrap_err();
        assert_eq!((error.place.as_str(), error.message.as_str()), ("", "missing field `count`"));
    }
}
