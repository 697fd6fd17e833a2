//! The multiplicative update in other libraries. Each library runs in a child process, which
//! answers each request by one line of JSON. `xtask/bench/worker.py` describes the requests.

use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use lumistack_core::Tensor;
use lumistack_display::LayerStack;
use npyz::WriterBuilder;
use serde_json::{Value, json};

use crate::cases::Case;

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

/// Time to wait after each timed update. Threads of a library may spin after their work, and would
/// slow the next timing.
const PAUSE: Duration = Duration::from_millis(30);

/// The process of a library.
pub struct Peer {
    /// Name and version of the library.
    pub name: String,
    pub threads: u64,
    /// Variants of the update.
    pub variants: Vec<String>,
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Peer {
    /// Starts a script on the problem in `folder`.
    pub fn start(python: &Path, script: &Path, folder: &Path) -> Outcome<Self> {
        let mut command = Command::new(python);
        // errors of the child go to this program's stderr
        command.arg(script).arg(folder).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn()?;
        let requests = child.stdin.take().ok_or("the child has no standard input")?;
        let answers = BufReader::new(child.stdout.take().ok_or("the child has no standard output")?);
        let mut peer = Self { name: String::new(), threads: 0, variants: Vec::new(), child, requests, answers };
        let hello = peer.answer()?;
        let variants =
            hello["variants"].as_array().ok_or("expected the list `variants` in the first answer, found none")?;
        peer.variants = variants.iter().filter_map(|name| name.as_str().map(str::to_owned)).collect();
        peer.name =
            hello["name"].as_str().ok_or("expected the text `name` in the first answer, found none")?.to_owned();
        peer.threads =
            hello["threads"].as_u64().ok_or("expected the number `threads` in the first answer, found none")?;
        Ok(peer)
    }

    /// Computes one update from the start and writes the masks to `folder`; later updates continue
    /// from these masks.
    pub fn save(&mut self, variant: &str, folder: &Path) -> Outcome {
        writeln!(self.requests, "save\t{variant}\t{}", folder.display())?;
        self.answer().map(|_| ())
    }

    /// Returns the seconds of one further update.
    pub fn update(&mut self, variant: &str) -> Outcome<f64> {
        writeln!(self.requests, "update\t{variant}")?;
        let answer = self.answer()?;
        std::thread::sleep(PAUSE);
        Ok(answer["seconds"].as_f64().ok_or("expected the number `seconds` in the answer, found none")?)
    }

    fn answer(&mut self) -> Outcome<Value> {
        let mut line = String::new();
        if self.answers.read_line(&mut line)? == 0 {
            return Err(
                format!("{} ended without an answer", if self.name.is_empty() { "peer" } else { &self.name }).into()
            );
        }
        Ok(serde_json::from_str(&line)?)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // an error here means that the child has ended already
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Writes a case and its start to the files that peers read.
pub fn write_problem(folder: &Path, case: &Case, start: &LayerStack) -> Outcome {
    std::fs::create_dir_all(folder)?;
    let field = &case.display.field;
    let about = json!({
        "resolution": field.resolution,
        "pitch_mm": field.pitch_mm,
        "views": case.display.views(),
        "fov_deg": field.fov_deg,
        "d_mm": case.display.layers.iter().map(|layer| layer.d_mm).collect::<Vec<_>>(),
        "frames": case.display.frames,
        "brightness": case.display.brightness,
    });
    std::fs::write(folder.join("problem.json"), about.to_string())?;
    write_tensor(&folder.join("target.npy"), case.target.radiance())?;
    for (n, layer) in start.layers.iter().enumerate() {
        write_tensor(&layer_path(folder, n), layer)?;
    }
    Ok(())
}

/// Returns the largest difference between the masks in the files of `folder` and the masks of
/// `stack`.
pub fn largest_difference(folder: &Path, stack: &LayerStack) -> Outcome<f32> {
    let mut largest = 0.0f32;
    for (n, layer) in stack.layers.iter().enumerate() {
        let bytes = std::fs::read(layer_path(folder, n))?;
        let file = npyz::NpyFile::new(&bytes[..])?;
        let shape: Vec<usize> = file.shape().iter().map(|&count| count as usize).collect();
        if shape != layer.shape() {
            return Err(format!("layer {n}: expected the shape {:?}, found {shape:?}", layer.shape()).into());
        }
        for (theirs, ours) in file.into_vec::<f32>()?.iter().zip(layer.data()) {
            let difference = (theirs - ours).abs();
            // NaN is taken as the largest difference
            largest = if difference.is_nan() { f32::INFINITY } else { largest.max(difference) };
        }
    }
    Ok(largest)
}

fn layer_path(folder: &Path, n: usize) -> PathBuf {
    folder.join(format!("layer_{n}.npy"))
}

fn write_tensor<const N: usize>(path: &Path, tensor: &Tensor<N>) -> Outcome {
    let shape: Vec<u64> = tensor.shape().iter().map(|&count| count as u64).collect();
    let file = std::io::BufWriter::new(std::fs::File::create(path)?);
    let options = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file);
    let mut writer = options.begin_nd()?;
    writer.extend(tensor.data().iter().copied())?;
    Ok(writer.finish()?)
}
