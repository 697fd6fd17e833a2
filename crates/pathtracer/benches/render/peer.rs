//! Other renderers: child processes that answer each request with one line of JSON.
//! `xtask/bench/view.py` describes the requests.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde_json::Value;

use crate::case::Outcome;

/// A renderer's process.
pub struct Peer {
    /// Name and version of the renderer.
    pub name: String,
    /// Names of the samplers that the renderer offers.
    pub samplers: Vec<String>,
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
}

/// A picture of a peer.
pub struct Rendered {
    /// Time of the paths in seconds.
    pub seconds: f64,
    /// Processor time of all threads for the paths, in seconds.
    pub cpu_s: f64,
    /// Radiance `[row][col][rgb]`.
    pub picture: Vec<f32>,
}

impl Peer {
    /// Starts a script on the scene in `folder`.
    pub fn start(python: &Path, script: &Path, folder: &Path) -> Outcome<Self> {
        let mut command = Command::new(python);
        // the child's error output goes to the error output of this program
        command.arg(script).arg(folder).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn()?;
        let requests = child.stdin.take().ok_or("the renderer has no standard input")?;
        let answers = BufReader::new(child.stdout.take().ok_or("the renderer has no standard output")?);
        let mut peer = Self { name: String::new(), samplers: Vec::new(), child, requests, answers };
        let hello = peer.answer()?;
        let samplers = hello["samplers"].as_array().ok_or("expected `samplers` in the renderer's first line")?;
        peer.samplers = samplers.iter().filter_map(|name| name.as_str().map(str::to_owned)).collect();
        peer.name = hello["name"].as_str().ok_or("expected `name` in the renderer's first line")?.to_owned();
        Ok(peer)
    }

    /// Renders the first view; returns seconds and radiance `[row][col][rgb]`.
    pub fn render(&mut self, sampler: &str, samples: u32, seed: u32, file: &Path) -> Outcome<(f64, Vec<f32>)> {
        let Rendered { seconds, picture, .. } = self.render_view(0, sampler, samples, seed, file)?;
        Ok((seconds, picture))
    }

    /// Renders the view with this number in the grid.
    pub fn render_view(
        &mut self,
        view: usize,
        sampler: &str,
        samples: u32,
        seed: u32,
        file: &Path,
    ) -> Outcome<Rendered> {
        writeln!(self.requests, "render\t{sampler}\t{samples}\t{seed}\t{view}\t{}", file.display())?;
        let answer = self.answer()?;
        let number =
            |key: &str| answer[key].as_f64().ok_or(format!("the answer: expected a number `{key}`, found none"));
        let bytes = std::fs::read(file)?;
        let picture = npyz::NpyFile::new(&bytes[..])?.into_vec::<f32>()?;
        Ok(Rendered { seconds: number("seconds")?, cpu_s: number("cpu_s")?, picture })
    }

    fn answer(&mut self) -> Outcome<Value> {
        loop {
            let mut line = String::new();
            if self.answers.read_line(&mut line)? == 0 {
                let name = if self.name.is_empty() { "the renderer" } else { &self.name };
                return Err(format!("{name} ended without an answer").into());
            }
            // a library may print other lines
            if line.starts_with('{') {
                return Ok(serde_json::from_str(&line)?);
            }
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // an error here means that the child has ended already
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
