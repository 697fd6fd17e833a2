//! Sends states to the page. A response holds a complete state, so the page never mixes two states.
//!
//! ```text
//! GET /.live?after=NUMBER&edition=NAME&said=NUMBER
//!     waits for a newer state or message; 204 after a timeout
//! u32 length of JSON (little endian) | JSON | files, one after another
//! JSON: {"number", "edition", "files": [bytes, ...], "preview": text or null, "said", "message"}
//!
//! GET /.look?viewer=WORD&x=SLOPE&y=SLOPE
//!     moves a page's viewer, who counts as a tracked head; without x and y the viewer leaves
//! ```
//!
//! An edition is a version of preview.json. WORD is a secret that the page has received. The query
//! of `/.live` describes the content of the page: `after` is the number of the state, `edition` the
//! name of the edition, and `said` the number of the message. In the response, `said` is the number
//! of the newest message. `files` has the length of each file that preview.json lists, in the order
//! of this list. A response with a newer state contains the text of preview.json if the page has
//! another edition. A response without a newer state has neither files nor this text.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use image::ExtendedColorType;
use image::ImageEncoder as _;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use lumistack_core::Task;
use lumistack_display::LayerStack;
use lumistack_live::{Eyes, Mailbox, State};
use lumistack_pipeline::{OutputData, PipelineError, Registry, write_output};
use serde_json::{Map, Value, json};

use super::clock::now;
use super::door::random_word;
use super::messages::Messages;
use super::requests::{Requests, lock};
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
    messages: &'a Messages,
    guest: Option<Guest<'a>>,
    made: Mutex<Option<Made>>,
    stopped: AtomicBool,
}

/// A viewer whose position comes from the page instead of a tracker.
pub(super) struct Guest<'a> {
    /// The secret that requests must contain, so that a page of another origin cannot move the
    /// viewer.
    word: String,
    /// Distance of the head, mm.
    distance_mm: f64,
    requests: &'a Requests,
}

impl<'a> Guest<'a> {
    /// Makes a viewer at this distance from the display, with a new secret.
    ///
    /// # Errors
    /// If the system has no random numbers.
    pub(super) fn new(requests: &'a Requests, distance_mm: f64) -> Result<Self, PipelineError> {
        Ok(Self { word: random_word()?, distance_mm, requests })
    }

    /// Moves the viewer to the slope that a query states. Returns whether the query has the secret
    /// and a valid slope.
    fn look(&self, query: &str) -> bool {
        let Some(slope) = slope_of(query).filter(|_| value(query, "viewer") == Some(&self.word)) else {
            return false;
        };
        let head = slope.map(|[x, y]| [x * self.distance_mm, y * self.distance_mm, self.distance_mm]);
        self.requests.see(head.as_slice(), Eyes::Picture).is_ok()
    }
}

/// A state's files, encoded for the page.
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
    /// Makes a feed. `site` is a folder for the page's own files, `title` the page's title. Without
    /// a guest the page moves no viewer.
    pub(super) fn new(
        states: &'a Mailbox<State>,
        messages: &'a Messages,
        (site, title): (&'a Path, &'a str),
        guest: Option<Guest<'a>>,
        registry: &'a Registry,
        task: Task<'a>,
    ) -> Self {
        let (made, stopped) = (Mutex::default(), AtomicBool::new(false));
        Self { states, site, title, registry, task, messages, guest, made, stopped }
    }

    pub(super) fn root(&self) -> &Path {
        self.site
    }

    /// Ends all waiting requests.
    pub(super) fn stop(&self) {
        self.stopped.store(true, Ordering::SeqCst);
    }

    /// Encodes the newest state, unless it is encoded already. Returns the number of the state that
    /// was encoded last; `None` if no state is encoded.
    pub(super) fn prepare(&self) -> Option<u64> {
        Some(self.newest()?.number)
    }

    fn newest(&self) -> Option<Made> {
        // One thread encodes the state. The lock makes other threads wait until the state is
        // encoded.
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
        let unknown =
            || PipelineError::value(self.site, "preview", "files of layers and of the backlight", "other files");
        Ok(Made { number, edition, files: Arc::new(files.ok_or_else(unknown)?) })
    }

    /// Writes the page for a state's display, and reads the list of the page's pictures.
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
        let asked = Asked::of(query);
        let deadline = now() + PATIENCE;
        while !self.stopped.load(Ordering::SeqCst) && now() < deadline {
            // A page of an earlier run may send a number above the number of the newest state.
            // Every state is then new to the page.
            let known = self.states.after(0).is_some_and(|(newest, _)| newest < asked.number);
            let is_newer = self.states.wait_after(if known { 0 } else { asked.number }, LOOK).is_some();
            let message = self.messages.newest();
            if is_newer || (asked.number > 0 && message.0 != asked.said) {
                return Some(frame_of(&self.newest()?, asked.edition, is_newer, message));
            }
        }
        None
    }

    fn word(&self) -> Option<&str> {
        Some(&self.guest.as_ref()?.word)
    }

    fn look(&self, query: &str) -> bool {
        self.guest.as_ref().is_some_and(|guest| guest.look(query))
    }
}

fn value<'a>(query: &'a str, name: &str) -> Option<&'a str> {
    query.split('&').find_map(|part| part.strip_prefix(name)?.strip_prefix('='))
}

/// A page's request.
struct Asked<'a> {
    /// Number of the page's state; 0 if the page has no state.
    number: u64,
    /// Number of the page's message; 0 if the page has no message.
    said: u64,
    edition: &'a str,
}

impl<'a> Asked<'a> {
    fn of(query: &'a str) -> Self {
        let number = |name| value(query, name).and_then(|number| number.parse().ok()).unwrap_or(0);
        let edition = value(query, "edition").unwrap_or_default();
        Self { number: number("after"), said: number("said"), edition }
    }
}

/// Reads the slope of the viewing direction, to the right and up. `Some(None)`: the viewer leaves.
fn slope_of(query: &str) -> Option<Option<[f64; 2]>> {
    match ["x", "y"].map(|name| value(query, name)) {
        [None, None] => Some(None),
        [Some(x), Some(y)] => {
            let slope = [x.parse().ok()?, y.parse().ok()?];
            slope.iter().all(|part: &f64| part.is_finite()).then_some(Some(slope))
        }
        _ => None,
    }
}

fn frame_of(made: &Made, known: &str, with_files: bool, (said, message): (u64, Arc<String>)) -> Vec<u8> {
    let Made { number, edition, files } = made;
    let files: &[Vec<u8>] = if with_files { files } else { &[] };
    let lengths: Vec<usize> = files.iter().map(Vec::len).collect();
    let preview = (with_files && edition.name != known).then_some(&edition.preview);
    let head = json!({"number": number, "edition": edition.name, "files": lengths, "preview": preview, "said": said,
        "message": *message});
    let head = head.to_string();
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

#[cfg(test)]
mod tests {
    use lumistack_pipeline::{DisplayJob, Job};

    use super::*;

    #[test]
    fn a_page_moves_its_viewer_by_its_word_and_a_slope() {
        let requests = Requests::new(Job::new(DisplayJob::by_name_or_path("fig7-uniform")));
        let guest = Guest::new(&requests, 600.0).unwrap();
        let heads_mm = || requests.tracker().boxes(now(), Duration::ZERO).heads_mm;
        let word = guest.word.clone();
        assert!(word.len() == 32 && word != Guest::new(&requests, 600.0).unwrap().word);
        for wrong in ["&x=0.1", "&y=1", "&x=a&y=1", "&x=inf&y=0", "&x=0&y=NaN", "&x=&y="] {
            assert!(!guest.look(&format!("viewer={word}{wrong}")), "{wrong}");
        }
        for wrong in ["x=0.1&y=0", "viewer=&x=0.1&y=0", "viewer=0&x=0.1&y=0"] {
            assert!(!guest.look(wrong), "{wrong}");
        }
        assert!(heads_mm().is_empty());
        assert!(guest.look(&format!("viewer={word}&x=0.25&y=-0.5")));
        assert_eq!(heads_mm(), [[150.0, -300.0, 600.0]]);
        assert!(guest.look(&format!("viewer={word}")));
        assert!(heads_mm().is_empty());
    }
}
