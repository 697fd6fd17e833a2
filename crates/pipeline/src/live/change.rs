//! Changes of single keys of a job.

use lumistack_core::config::{nearest, plain};
use serde_json::{Map, Value};

use crate::error::PipelineError;
use crate::job::Job;

impl Job {
    /// Returns the job with another value of a key, for example of `display.brightness`. The value
    /// `null` sets the default. Relative paths are relative to the working folder.
    ///
    /// # Errors
    /// If the key does not exist, the value has another type, or the job is wrong with this value.
    pub fn with(&self, key: &str, value: Value) -> Result<Self, PipelineError> {
        self.with_all([(key, value)])
    }

    /// Returns the job with other values of several keys, as [`with`](Self::with). The job with all
    /// these values must be valid. A job with only some of them may be invalid. If a key occurs
    /// several times, its last value counts.
    ///
    /// # Errors
    /// As [`with`](Self::with).
    pub fn with_all<'a>(&self, keys: impl IntoIterator<Item = (&'a str, Value)>) -> Result<Self, PipelineError> {
        let (mut all, mut job) = (self.to_json(), self.clone());
        for (key, value) in keys {
            let found = value.to_string();
            set(&mut all, key, value)?;
            let parsed = serde_json::from_value(all.clone());
            let parsed: Self = parsed.map_err(|error| wrong_value(key, &error.to_string(), found))?;
            job = Self { folder: self.folder.clone(), file: self.file.clone(), ..parsed };
        }
        job.check()?;
        job.display.resolve()?;
        Ok(job)
    }
}

/// Sets a key in a tree of tables; missing tables are created.
fn set(all: &mut Value, key: &str, value: Value) -> Result<(), PipelineError> {
    let mut at = all;
    let mut parts = key.split('.').peekable();
    while let Some(part) = parts.next() {
        let is_last = parts.peek().is_none();
        let Value::Object(table) = at else {
            return Err(PipelineError::job(
                key,
                "a key in a table of the job, such as `display.brightness`",
                "a key in a value that is not a table",
            ));
        };
        if is_last {
            match value {
                Value::Null => drop(table.shift_remove(part)),
                value => drop(table.insert(part.into(), value)),
            }
            return Ok(());
        }
        at = table.entry(part).or_insert_with(|| Value::Object(Map::new()));
    }
    Ok(())
}

/// Converts the parser's message to an error with the known keys, or the expected type.
fn wrong_value(key: &str, message: &str, found: String) -> PipelineError {
    let last = key.rsplit('.').next().unwrap_or(key);
    if let Some((unknown, known)) =
        message.split_once(", expected ").filter(|(text, _)| text.starts_with("unknown field"))
    {
        let names: Vec<&str> = known.split('`').skip(1).step_by(2).collect();
        let hint =
            nearest(last, names.iter().copied()).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
        return PipelineError::job(key, format!("one of the keys {}", names.join(", ")), format!("an {unknown}{hint}"));
    }
    let message = plain(message, last);
    let expected = match message.split_once(", expected ") {
        Some((text, known)) if text.starts_with("unknown variant") => known,
        _ => message
            .strip_prefix("expected ")
            .and_then(|rest| rest.rsplit_once(", found "))
            .map_or(&message[..], |(expected, _)| expected),
    };
    PipelineError::job(key, expected, found)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::DisplayJob;

    /// The key `window.width` is an error without `window.from = "given"`. A change of the two keys
    /// together is valid.
    #[test]
    fn only_the_job_with_all_keys_must_be_right() {
        let job = Job { scene: Some("a.glb".into()), ..Job::new(DisplayJob::by_name_or_path("fig7-uniform")) };
        let keys = [("window.width", json!(2.0)), ("window.from", json!("given"))];
        assert!(job.with("window.width", json!(2.0)).unwrap_err().to_string().contains("window.from"));
        let given = job.with_all(keys).unwrap();
        assert_eq!(given.window.width, Some(2.0));
        assert!(given.with("window.from", Value::Null).is_err());
        assert_eq!(given.with_all([("window.from", Value::Null), ("window.width", Value::Null)]).unwrap(), job);
        let error = job.with_all([("seed", json!(3)), ("window.widht", json!(1))]).unwrap_err().to_string();
        assert!(error.contains("window.widht: expected one of the keys"), "{error}");
    }

    #[test]
    fn keys_change_one_by_one_and_errors_name_them() {
        let job = Job {
            scene: Some("a.glb".into()),
            folder: "there".into(),
            ..Job::new(DisplayJob::by_name_or_path("fig7-uniform"))
        };
        let changed = job.with("display.brightness", json!(0.3)).unwrap();
        assert_eq!((changed.display.brightness, changed.folder.clone()), (Some(0.3), "there".into()));
        assert_eq!(changed.with("display.brightness", Value::Null).unwrap(), job);
        assert_eq!(job.with("pose.time_s", json!(1.5)).unwrap().pose.time_s, Some(1.5));
        let message = |key: &str, value: Value| job.with(key, value).unwrap_err().to_string();
        for (key, value, expected) in [
            ("display.brightnes", json!(0.3), "display.brightnes: expected one of the keys "),
            ("display.brightnes", json!(0.3), "did you mean `brightness`?"),
            ("display.brightness", json!("much"), "display.brightness: expected a number, found \"much\""),
            ("display.brightness", json!(3.0), "brightness"),
            ("seed.x", json!(1), "seed.x: expected a key in a table of the job"),
            ("scene", Value::Null, "scene: expected"),
        ] {
            assert!(message(key, value).contains(expected), "{}", message(key, json!(3.0)));
        }
    }
}
