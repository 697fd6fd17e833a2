//! Sends states to the page. A response holds a complete state, so the page never mixes two.
//!
//! ```text
//! GET /.live?after=NUMBER&edition=NAME      waits for a newer state; 204 after a timeout
//! u32 length of JSON (little endian) | JSON | files, one after another
//! JSON: {"number", "edition", "files": [bytes, ...], "preview": text or null}
//! ```
//!
//! The files are those that preview.json lists, in its order. An edition is a version of
//! preview.json. The response contains its text if the page has another edition.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use image::ExtendedColorType;
use image::ImageEncoder as _;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use lumistack_core::Task;
use lumistack_display::LayerStack;
use lumistack_live::{Mailbox, State};
use lumistack_pipeline::{OutputData, PipelineError, Registry, write_output};
use serde_json::{Map, Value, json};

use super::clock::now;
use super::requests::lock;
use crate::server::Feed;

/// The page's script, which requests states.
const SCRIPT: &str = include_str!("../../dist/live.js");
/// Longest time that a request waits for a response.
const PATIENCE: Duration = Duration::from_secs(5);
/// Interval at which a waiting request checks whether the display has ended.
const LOOK: Duration = Duration::from_millis(50);

/// Makes responses from the newest state.
pub(super) struct PageFeed<'a> {
    states: &'a Mailbox<State>,
    site: &'a Path,
    title: &'a str,
    registry: &'a Registry,
    task: Task<'a>,
    made: Mutex<Option<Made>>,
    stopped: AtomicBool,
}

/// The files of a state.
#[derive(Clone)]
struct Made {
    number: u64,
    edition: Arc<Edition>,
    files: Arc<Vec<Vec<u8>>>,
}

/// A version of preview.json.
struct Edition {
    key: String,
    name: String,
    preview: String,
    entries: Vec<Value>,
}

impl<'a> PageFeed<'a> {
    /// Makes a feed. `site` is a folder for the page's own files, `title` the page's title.
    pub(super) fn new(
        states: &'a Mailbox<State>,
        (site, title): (&'a Path, &'a str),
        registry: &'a Registry,
        task: Task<'a>,
    ) -> Self {
        Self { states, site, title, registry, task, made: Mutex::default(), stopped: AtomicBool::new(false) }
    }

    pub(super) fn root(&self) -> &Path {
        self.site
    }

    /// Ends all waiting requests.
    pub(super) fn stop(&self) {
        self.stopped.store(true, Ordering::SeqCst);
    }

    /// Encodes the newest state, once, and returns its number. `None` if there is no state, or if
    /// its files cannot be made.
    pub(super) fn prepare(&self) -> Option<u64> {
        Some(self.newest()?.number)
    }

    fn newest(&self) -> Option<Made> {
        // one thread encodes, and the lock makes the others wait
        let mut made = lock(&self.made);
        let known = made.as_ref().map_or(0, |made| made.number);
        if let Some((number, state)) = self.states.after(known) {
            match self.make(number, &state, made.as_ref()) {
                Ok(new) => *made = Some(new),
                Err(error) => self.task.warn("page", error.to_string()),
            }
        }
        made.clone()
    }

    fn make(&self, number: u64, state: &State, before: Option<&Made>) -> Result<Made, PipelineError> {
        let key = format!("{}{:?}", state.target.display.to_toml(), state.target.field.geometry());
        let edition = match before.filter(|before| before.edition.key == key) {
            Some(before) => before.edition.clone(),
            None => Arc::new(self.edition(number, key, state)?),
        };
        let files = edition.entries.iter().map(|entry| picture_of(&state.stack, entry)).collect::<Option<Vec<_>>>();
        let unknown = || PipelineError::value(self.site, "preview", "files of layers and backlight", "others");
        Ok(Made { number, edition, files: Arc::new(files.ok_or_else(unknown)?) })
    }

    /// Writes the page for a state's display, and reads the list of its pictures.
    fn edition(&self, number: u64, key: String, state: &State) -> Result<Edition, PipelineError> {
        let title = ("title".into(), json!(self.title));
        let params = Map::from_iter([title, ("target".into(), json!(false)), ("single_file".into(), json!(false))]);
        let data = OutputData::LayerStack(&state.stack, Some(&state.target.field));
        write_output(self.registry, "web_simulator", params, &state.target.display, data, self.site, self.task)?;
        let path: PathBuf = self.site.join("stack/preview.json");
        let read = |source| PipelineError::Read { path: path.clone(), source };
        let preview = std::fs::read_to_string(&path).map_err(read)?;
        let parsed: Value = serde_json::from_str(&preview).map_err(|error| read(error.into()))?;
        let entries = parsed["files"].as_array().cloned().unwrap_or_default();
        Ok(Edition { key, name: format!("{number}-{}", now().as_nanos()), preview, entries })
    }
}

impl Feed for PageFeed<'_> {
    fn script(&self) -> &'static str {
        SCRIPT
    }

    fn frame(&self, query: &str) -> Option<Vec<u8>> {
        let (seen, edition) = asked(query);
        let deadline = now() + PATIENCE;
        while !self.stopped.load(Ordering::SeqCst) && now() < deadline {
            // a page of an earlier run may send a number above the newest
            let known = self.states.after(0).is_some_and(|(newest, _)| newest < seen);
            if self.states.wait_after(if known { 0 } else { seen }, LOOK).is_some() {
                let made = self.newest()?;
                return Some(frame_of(&made, edition));
            }
        }
        None
    }
}

/// Reads the state number and the edition from a page's request.
fn asked(query: &str) -> (u64, &str) {
    let value = |name: &str| query.split('&').find_map(|part| part.strip_prefix(name)?.strip_prefix('='));
    (value("after").and_then(|number| number.parse().ok()).unwrap_or(0), value("edition").unwrap_or_default())
}

fn frame_of(made: &Made, known: &str) -> Vec<u8> {
    let Made { number, edition, files } = made;
    let lengths: Vec<usize> = files.iter().map(Vec::len).collect();
    let preview = (edition.name != known).then_some(&edition.preview);
    let head = json!({"number": number, "edition": edition.name, "files": lengths, "preview": preview}).to_string();
    let mut frame = Vec::with_capacity(4 + head.len() + lengths.iter().sum::<usize>());
    frame.extend((head.len() as u32).to_le_bytes());
    frame.extend(head.as_bytes());
    files.iter().for_each(|file| frame.extend(file));
    frame
}

/// Encodes the PNG of an entry of preview.json: a mask, or the angular bins of a backlight side by
/// side. `None` for other entries.
fn picture_of(stack: &LayerStack, entry: &Value) -> Option<Vec<u8>> {
    let number = |key: &str| entry[key].as_u64().map(|number| number as usize);
    let (frame, code) = (number("frame")?, |value: &f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
    match entry["kind"].as_str()? {
        "layer" => {
            let layer = stack.layers.get(number("layer")?)?;
            let [frames, rows, cols, _] = layer.shape();
            (frame < frames).then(|| png([cols, rows], layer.block([frame]).iter().map(code).collect()))?
        }
        "emission" => {
            let emission = stack.emission.as_ref()?;
            let [frames, bins_y, bins_x, rows, cols, _] = emission.shape();
            if frame >= frames {
                return None;
            }
            let mut codes = Vec::with_capacity(3 * bins_y * rows * bins_x * cols);
            for line in 0..bins_y * rows {
                for bin_x in 0..bins_x {
                    codes.extend(emission.block([frame, line / rows, bin_x, line % rows]).iter().map(code));
                }
            }
            png([bins_x * cols, bins_y * rows], codes)
        }
        _ => None,
    }
}

fn png([cols, rows]: [usize; 2], codes: Vec<u8>) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub);
    encoder.write_image(&codes, cols as u32, rows as u32, ExtendedColorType::Rgb8).ok()?;
    Some(bytes)
}
