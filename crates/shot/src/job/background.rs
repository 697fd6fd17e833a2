//! `light.background`: the background of the views.

use std::borrow::Cow;
use std::str::FromStr;

use lumistack_core::colour::{srgb_code, srgb_decode};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The background of the views, where a ray misses every surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Background {
    /// The environment that lights the scene, or black if there is none.
    #[default]
    Environment,
    /// A linear RGB colour, 0..1, as the display shows it: neither exposure nor tone curve changes
    /// it.
    Colour([f32; 3]),
}

const EXPECTED: &str = "`environment`, a colour such as `#202028`, or three numbers in 0..1 of linear light";

impl FromStr for Background {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "environment" {
            return Ok(Self::Environment);
        }
        let code = |at: usize| text.get(at..at + 2).and_then(|digits| u8::from_str_radix(digits, 16).ok());
        match (text.strip_prefix('#'), code(1), code(3), code(5)) {
            (Some(digits), Some(r), Some(g), Some(b)) if digits.len() == 6 => {
                Ok(Self::Colour([r, g, b].map(|code| srgb_decode(f32::from(code) / 255.0))))
            }
            _ => Err(format!("expected {EXPECTED}")),
        }
    }
}

impl JsonSchema for Background {
    fn schema_name() -> Cow<'static, str> {
        "Background".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "`environment`, a colour such as `#202028`, or [r, g, b] of linear light.",
            "anyOf": [
                { "const": "environment" },
                { "type": "string", "pattern": "^#[0-9a-fA-F]{6}$" },
                { "type": "array", "items": { "type": "number", "minimum": 0, "maximum": 1 }, "minItems": 3, "maxItems": 3 },
            ],
        })
    }
}

/// Writes a code such as `#202028` if it is exact, otherwise `[r, g, b]`, so that no digit is lost.
impl Serialize for Background {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Environment => serializer.serialize_str("environment"),
            Self::Colour(rgb) => {
                let codes = rgb.map(srgb_code);
                let exact = codes.map(|code| srgb_decode(f32::from(code) / 255.0));
                if exact == *rgb {
                    let [r, g, b] = codes;
                    serializer.serialize_str(&format!("#{r:02x}{g:02x}{b:02x}"))
                } else {
                    rgb.serialize(serializer)
                }
            }
        }
    }
}

impl<'de> Deserialize<'de> for Background {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;

        impl<'de> Visitor<'de> for Reader {
            type Value = Background;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(EXPECTED)
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Background, E> {
                text.parse().map_err(|message| E::custom(format!("{message}, found `{text}`")))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Background, A::Error> {
                let mut found: Vec<f32> = Vec::new();
                while let Some(value) = values.next_element()? {
                    found.push(value);
                }
                match <[f32; 3]>::try_from(found.as_slice()) {
                    Ok(rgb) if rgb.iter().all(|value| (0.0..=1.0).contains(value)) => Ok(Background::Colour(rgb)),
                    _ => Err(A::Error::custom(format!("expected {EXPECTED}, found {found:?}"))),
                }
            }
        }

        deserializer.deserialize_any(Reader)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Background, String> {
        #[derive(Debug, Deserialize)]
        struct Table {
            background: Background,
        }
        let table: Result<Table, _> = lumistack_core::config::parse(&format!("background = {text}"));
        table.map(|table| table.background).map_err(|error| error.message)
    }

    #[test]
    fn colours_are_codes_or_linear_numbers() {
        assert_eq!(read("\"environment\""), Ok(Background::Environment));
        assert_eq!(read("\"#000000\""), Ok(Background::Colour([0.0; 3])));
        assert_eq!(read("[0, 0.25, 1.0]"), Ok(Background::Colour([0.0, 0.25, 1.0])));
        let Ok(Background::Colour([r, g, b])) = read("\"#ff8000\"") else { panic!("a colour") };
        assert_eq!((r, b), (1.0, 0.0));
        assert!((g - 0.215_86).abs() < 1e-5, "{g}");
        for wrong in ["\"sky\"", "\"#12345\"", "\"#12345é\"", "[1, 2, 3]", "[0.5, 0.5]", "3"] {
            let error = read(wrong).unwrap_err();
            assert!(error.contains("expected `environment`, a colour such as `#202028`"), "{wrong}: {error}");
        }
        for text in ["environment", "#ff8000", "#202028"] {
            let background: Background = text.parse().unwrap();
            assert_eq!(serde_json::to_value(background).unwrap(), text);
        }
        let fine = Background::Colour([0.1, 0.2, 0.3]);
        assert_eq!(serde_json::from_value::<Background>(serde_json::to_value(fine).unwrap()).unwrap(), fine);
    }
}
