//! The description of a plugin's parameters. Help texts, defaults, checks and input forms are
//! derived from this description.

use std::fmt;
use std::ops::RangeInclusive;

use lumistack_core::config::nearest;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use thiserror::Error;

/// All parameters of a plugin, in the order of the help.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Schema {
    /// The parameters; names are unique.
    pub params: Vec<Param>,
}

/// Describes one parameter of a plugin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Param {
    /// Key in job files: lower-case letters, digits and underscores.
    pub name: String,
    /// Type, default and range.
    #[serde(flatten)]
    pub kind: Kind,
    /// Unit of a number, for example `mm`; `1` for a plain number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// The parameter's meaning, one sentence.
    pub help: String,
}

/// Type, default and range of a parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Kind {
    /// The value is true or false.
    Bool {
        /// Value of the parameter if the job does not set it.
        default: bool,
    },
    /// The value is a whole number.
    Int {
        /// Value of the parameter if the job does not set it.
        default: i64,
        /// Smallest allowed value.
        min: i64,
        /// Largest allowed value.
        max: i64,
    },
    /// The value is a finite number.
    Float {
        /// Value of the parameter if the job does not set it.
        default: f64,
        /// Smallest allowed value.
        min: f64,
        /// Largest allowed value.
        max: f64,
    },
    /// The value is one of several words.
    Choice {
        /// Value of the parameter if the job does not set it.
        default: String,
        /// The allowed words.
        options: Vec<Choice>,
    },
    /// The value is any text.
    Text {
        /// Value of the parameter if the job does not set it.
        default: String,
    },
    /// The path of a file that the plugin reads; empty for none. Hosts make the path absolute. A
    /// value that begins with `{` is not a path but the file's content.
    File,
}

/// One word of a [`Kind::Choice`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Choice {
    /// The word that users write.
    pub value: String,
    /// The meaning of the word.
    pub help: String,
}

impl Param {
    /// Makes a parameter that is true or false.
    pub fn bool(name: &str, default: bool, help: &str) -> Self {
        Self::new(name, Kind::Bool { default }, help)
    }

    /// Makes a parameter that is a whole number in a range.
    pub fn int(name: &str, default: i64, range: RangeInclusive<i64>, help: &str) -> Self {
        Self::new(name, Kind::Int { default, min: *range.start(), max: *range.end() }, help)
    }

    /// Makes a parameter that is a number in a range.
    pub fn float(name: &str, default: f64, range: RangeInclusive<f64>, help: &str) -> Self {
        Self::new(name, Kind::Float { default, min: *range.start(), max: *range.end() }, help)
    }

    /// Makes a parameter that is one of several words. `options` has each word with its meaning.
    pub fn choice<'a>(
        name: &str,
        default: &str,
        options: impl IntoIterator<Item = (&'a str, &'a str)>,
        help: &str,
    ) -> Self {
        let options =
            options.into_iter().map(|(value, help)| Choice { value: value.into(), help: help.into() }).collect();
        Self::new(name, Kind::Choice { default: default.into(), options }, help)
    }

    /// Makes a parameter that is any text.
    pub fn text(name: &str, default: &str, help: &str) -> Self {
        Self::new(name, Kind::Text { default: default.into() }, help)
    }

    /// Makes a parameter that is a file which the plugin reads; see [`Kind::File`].
    pub fn file(name: &str, help: &str) -> Self {
        Self::new(name, Kind::File, help)
    }

    /// Sets the unit of a number.
    #[must_use]
    pub fn unit(mut self, unit: &str) -> Self {
        self.unit = Some(unit.into());
        self
    }

    fn new(name: &str, kind: Kind, help: &str) -> Self {
        Self { name: name.into(), kind, unit: None, help: help.into() }
    }

    /// Returns the default value of the parameter.
    pub fn default_value(&self) -> Value {
        match &self.kind {
            Kind::Bool { default } => Value::from(*default),
            Kind::Int { default, .. } => Value::from(*default),
            Kind::Float { default, .. } => Value::from(*default),
            Kind::Choice { default, .. } | Kind::Text { default } => Value::from(default.clone()),
            Kind::File => Value::from(""),
        }
    }

    /// Describes the allowed values for messages, such as `a number from 0 to 1 mm` or `one of
    /// panel, srgb, linear`.
    pub fn expected(&self) -> String {
        let unit = self.unit.as_ref().filter(|unit| *unit != "1").map_or(String::new(), |unit| format!(" {unit}"));
        match &self.kind {
            Kind::Bool { .. } => "true or false".into(),
            Kind::Int { min, max, .. } => format!("a whole number from {min} to {max}{unit}"),
            Kind::Float { min, max, .. } => format!("a number from {min} to {max}{unit}"),
            Kind::Choice { options, .. } => {
                format!("one of {}", options.iter().map(|option| option.value.as_str()).collect::<Vec<_>>().join(", "))
            }
            Kind::Text { .. } => "a text".into(),
            Kind::File => "the path of a file, or a file's text, which begins with {".into(),
        }
    }

    /// Returns the value in the form passed to plugins; `None` if it is of the wrong type or out of
    /// range. For a float parameter, a whole number becomes a float.
    fn accept(&self, value: &Value) -> Option<Value> {
        match &self.kind {
            Kind::Bool { .. } => value.is_boolean().then(|| value.clone()),
            Kind::Int { min, max, .. } => value.as_i64().filter(|n| (min..=max).contains(&n)).map(Value::from),
            Kind::Float { min, max, .. } => value.as_f64().filter(|x| *x >= *min && *x <= *max).map(Value::from),
            Kind::Choice { options, .. } => {
                let word = value.as_str()?;
                options.iter().any(|option| option.value == word).then(|| value.clone())
            }
            Kind::Text { .. } | Kind::File => value.is_string().then(|| value.clone()),
        }
    }
}

/// One line of help: `encode = "panel": Encoding of ... (one of panel, srgb, linear)`.
impl fmt::Display for Param {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {}: {} ({})", self.name, self.default_value(), self.help.trim_end_matches('.'), self.expected())
    }
}

impl Schema {
    /// Makes a schema of `params`.
    pub fn new(params: impl IntoIterator<Item = Param>) -> Self {
        Self { params: params.into_iter().collect() }
    }

    /// Checks the given parameters (an object, or null for none) and fills in the defaults of all
    /// other parameters.
    ///
    /// # Errors
    /// If `given` is neither an object nor null. Also if a parameter does not exist, is of the
    /// wrong type, or is out of range. For an unknown name, the message states the most similar
    /// name. If no name is similar, it lists all names.
    pub fn resolve(&self, given: &Value) -> Result<Map<String, Value>, ParamError> {
        let empty = Map::new();
        let given = match given {
            Value::Object(given) => given,
            Value::Null => &empty,
            other => return Err(ParamError::NotAnObject { found: other.to_string() }),
        };
        if let Some(unknown) = given.keys().find(|name| !self.params.iter().any(|param| param.name == **name)) {
            let names = || self.params.iter().map(|param| param.name.as_str());
            return Err(ParamError::Unknown {
                name: unknown.clone(),
                nearest: nearest(unknown, names()).map(String::from),
                known: names().map(String::from).collect(),
            });
        }
        self.params
            .iter()
            .map(|param| {
                let value = match given.get(&param.name) {
                    None => param.default_value(),
                    Some(value) => param.accept(value).ok_or_else(|| ParamError::Value {
                        name: param.name.clone(),
                        expected: param.expected(),
                        found: value.to_string(),
                    })?,
                };
                Ok((param.name.clone(), value))
            })
            .collect()
    }

    /// Returns the schema as JSON, for a descriptor.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("a schema holds only texts, booleans and numbers")
    }

    /// Checks the schema itself: names must be unique and have the allowed characters, each
    /// parameter needs help, and defaults must be in range.
    ///
    /// # Errors
    /// If a rule is violated. The message is for the plugin's author.
    pub fn check(&self) -> Result<(), String> {
        for (i, param) in self.params.iter().enumerate() {
            let name = &param.name;
            if name.is_empty() || !name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_') {
                return Err(format!(
                    "parameter `{name}`: expected a name of lower-case letters, digits and underscores"
                ));
            }
            if self.params[..i].iter().any(|earlier| earlier.name == *name) {
                return Err(format!("parameter `{name}` is declared twice"));
            }
            if param.help.trim().is_empty() {
                return Err(format!("parameter `{name}` has no help"));
            }
            if param.accept(&param.default_value()).is_none() {
                let (expected, default) = (param.expected(), param.default_value());
                return Err(format!("parameter `{name}`: the default {default} is not {expected}"));
            }
        }
        Ok(())
    }
}

/// The reason why given parameters do not match the schema.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ParamError {
    /// There is no such parameter.
    #[error("unknown parameter `{name}`{}", hint(nearest.as_deref(), known))]
    Unknown {
        /// The given name, which no parameter has.
        name: String,
        /// The name of the most similar parameter.
        nearest: Option<String>,
        /// The names of all parameters of the plugin.
        known: Vec<String>,
    },
    /// The value is of the wrong type or out of range.
    #[error("parameter `{name}`: expected {expected}, found {found}")]
    Value {
        /// The name of the parameter.
        name: String,
        /// The parameter's type and range.
        expected: String,
        /// The value that was given.
        found: String,
    },
    /// The parameters are no JSON object.
    #[error("parameters: expected an object of names and values, found {found}")]
    NotAnObject {
        /// The value that was given.
        found: String,
    },
}

fn hint(nearest: Option<&str>, known: &[String]) -> String {
    match nearest {
        Some(nearest) => format!("; did you mean `{nearest}`?"),
        None if known.is_empty() => "; the plugin has no parameters".into(),
        None => format!("; expected one of {}", known.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn schema() -> Schema {
        Schema::new([
            Param::bool("png8", true, "Write PNG."),
            Param::int("quality", 90, 1..=100, "Quality.").unit("%"),
            Param::float("gap", 0.5, 0.0..=2.0, "Gap.").unit("mm"),
            Param::choice("encode", "panel", [("panel", "The panel's."), ("srgb", "sRGB.")], "Encoding."),
            Param::text("title", "", "Title."),
        ])
    }

    #[test]
    fn defaults_are_filled_in_and_given_values_kept() {
        let resolved = schema().resolve(&json!({"gap": 1, "encode": "srgb"})).unwrap();
        let expected = json!({"png8": true, "quality": 90, "gap": 1.0, "encode": "srgb", "title": ""});
        assert_eq!(Value::Object(resolved), expected);
        assert_eq!(schema().resolve(&Value::Null).unwrap()["quality"], 90);
    }

    #[test]
    fn errors_name_parameter_range_and_value() {
        for (given, message) in [
            (json!({"pgn8": true}), "unknown parameter `pgn8`; did you mean `png8`?"),
            (json!({"zzz": 1}), "unknown parameter `zzz`; expected one of png8, quality, gap, encode, title"),
            (json!({"quality": 101}), "parameter `quality`: expected a whole number from 1 to 100 %, found 101"),
            (json!({"quality": 1.5}), "parameter `quality`: expected a whole number from 1 to 100 %, found 1.5"),
            (json!({"gap": -0.1}), "parameter `gap`: expected a number from 0 to 2 mm, found -0.1"),
            (json!({"encode": "rgb"}), "parameter `encode`: expected one of panel, srgb, found \"rgb\""),
            (json!({"png8": 1}), "parameter `png8`: expected true or false, found 1"),
            (json!({"title": 3}), "parameter `title`: expected a text, found 3"),
            (json!([1]), "parameters: expected an object of names and values, found [1]"),
        ] {
            assert_eq!(schema().resolve(&given).unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn a_schema_survives_json_and_is_checked() {
        let schema = schema();
        schema.check().unwrap();
        assert_eq!(serde_json::from_str::<Schema>(&schema.to_json()).unwrap(), schema);
        let bad = |param: Param| Schema::new([Param::bool("png8", true, "x"), param]).check().unwrap_err();
        assert!(bad(Param::bool("png8", true, "Twice.")).contains("twice"));
        assert!(bad(Param::int("n", 5, 0..=4, "Out of range.")).contains("default 5"));
        assert!(bad(Param::float("x", f64::NAN, 0.0..=4.0, "NaN.")).contains("default"));
        assert!(bad(Param::bool("n", true, " ")).contains("no help"));
        assert!(bad(Param::bool("N n", true, "Odd name.")).contains("lower-case"));
    }

    #[test]
    fn help_is_one_line() {
        let line = schema().params[1].to_string();
        assert_eq!(line, "quality = 90: Quality (a whole number from 1 to 100 %)");
    }
}
