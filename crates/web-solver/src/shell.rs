//! The functions and classes that JavaScript can call. They only call the other modules of this
//! crate, which are tested without a browser.

use js_sys::Uint8Array;
use serde_json::json;
use wasm_bindgen::prelude::*;

use crate::presets as presets_of_the_program;
use crate::{Error, Files, Preset, Settings, Stage, Work, patterns};

impl From<Error> for JsValue {
    fn from(error: Error) -> Self {
        js_sys::Error::new(&error.to_string()).into()
    }
}

type Thrown<T> = Result<T, JsValue>;

/// Returns the presets as JSON: each has its name, its title, and the values for the page's
/// sliders.
#[wasm_bindgen]
pub fn presets() -> String {
    let about = |Preset { name, display }: Preset| json!({"name": name, "title": display.name, "about": patterns::about(&display)});
    json!(presets_of_the_program().unwrap_or_default().into_iter().map(about).collect::<Vec<_>>()).to_string()
}

/// The dropped files of a scene.
#[wasm_bindgen]
#[derive(Default)]
pub struct Dropped(Files);

#[wasm_bindgen]
impl Dropped {
    /// Makes an empty collection; `add` adds files.
    #[wasm_bindgen(constructor)]
    pub fn new() -> Dropped {
        Self::default()
    }

    /// Adds a file.
    pub fn add(&mut self, path: &str, bytes: Vec<u8>) {
        self.0.add(path, bytes);
    }
}

/// A solve in progress.
#[wasm_bindgen]
pub struct Solver {
    work: Work,
}

#[wasm_bindgen]
impl Solver {
    /// Prepares to solve the scene in the file `path`. `settings` is JSON.
    #[wasm_bindgen(constructor)]
    pub fn new(files: Dropped, path: &str, settings: &str) -> Thrown<Solver> {
        Ok(Self { work: Work::new(files.0, path, Settings::from_json(settings)?)? })
    }

    /// Prepares to solve a light field. `path` names it among the files in the memory of the module
    /// of decoders. `settings` is JSON.
    pub fn of_field(path: &str, settings: &str) -> Thrown<Solver> {
        Ok(Self { work: Work::of_field(path, Settings::from_json(settings)?)? })
    }

    /// Restarts with other settings. A scene stays in memory; a light field is read again.
    pub fn change(&mut self, settings: &str) -> Thrown<()> {
        Ok(self.work.change(Settings::from_json(settings)?)?)
    }

    /// Returns the name of the current stage: `scene`, `views`, `patterns` or `done`.
    pub fn stage(&self) -> String {
        match self.work.stage() {
            Stage::Scene => "scene",
            Stage::Views => "views",
            Stage::Patterns => "patterns",
            Stage::Done => "done",
        }
        .into()
    }

    /// Returns the finished fraction of the work, 0..1.
    pub fn share(&self) -> f64 {
        self.work.share()
    }

    /// Returns the number of times that new patterns were ready to show.
    pub fn shown(&self) -> u32 {
        self.work.shown()
    }

    /// Returns the PSNR of the current patterns over the views for which they were solved, dB. NaN
    /// before the first patterns.
    pub fn psnr(&self) -> f64 {
        self.work.psnr()
    }

    /// Returns the warnings since the last call.
    pub fn warnings(&self) -> Vec<String> {
        self.work.warnings()
    }

    /// Returns the number of a view that another thread may trace; `undefined` if there is none.
    pub fn give(&mut self) -> Option<usize> {
        self.work.give()
    }

    /// Traces a view for another thread's solver, which gave the view's number.
    pub fn trace(&mut self, number: usize) -> Thrown<Vec<f32>> {
        Ok(self.work.trace(number)?)
    }

    /// Takes the values of a view that another thread traced.
    pub fn take(&mut self, number: usize, values: Vec<f32>) -> Thrown<()> {
        Ok(self.work.take(number, values)?)
    }

    /// Returns the viewer's `preview.json` for patterns of the current display.
    pub fn preview(&self, title: &str) -> Thrown<String> {
        Ok(patterns::preview(self.work.display(), title)?)
    }

    /// Returns the codes of the current patterns, in the order of the preview's files.
    pub fn codes(&self) -> Uint8Array {
        let codes = self.work.stack().map(|stack| patterns::codes(self.work.display(), stack));
        Uint8Array::from(codes.unwrap_or_default().as_slice())
    }

    /// Returns a run folder of the current patterns as a zip.
    pub fn zip(&self) -> Thrown<Uint8Array> {
        let stack = self.work.stack().ok_or_else(|| Error::value("zip", "patterns", "none yet"))?;
        Ok(Uint8Array::from(patterns::zip(self.work.display(), stack, &self.work.job())?.as_slice()))
    }
}

#[cfg(not(feature = "gpu"))]
#[wasm_bindgen]
impl Solver {
    /// Computes the next piece of work.
    pub fn advance(&mut self) -> Thrown<()> {
        Ok(self.work.advance()?)
    }
}

/// The functions that wait for a graphics processor return promises. While such a promise is
/// pending, all calls of the solver throw.
#[cfg(feature = "gpu")]
// wasm-bindgen marks `jspi` as deprecated only because it is experimental
#[allow(deprecated)]
#[wasm_bindgen]
impl Solver {
    /// Computes the next piece of work.
    #[wasm_bindgen(jspi)]
    pub fn advance(&mut self) -> Thrown<()> {
        Ok(self.work.advance()?)
    }

    /// Returns true if a graphics processor solves.
    pub fn on_device(&self) -> bool {
        self.work.is_on_device()
    }

    /// Opens the browser's graphics processor for this solve. An adapter in software is used only
    /// if `software` is true.
    #[wasm_bindgen(jspi)]
    pub fn open_device(&mut self, software: bool) -> Thrown<()> {
        let device = lumistack_factorizer_gpu::Device::open(software.then_some("")).map_err(Error::from)?;
        self.work.solve_on(Box::new(device));
        Ok(())
    }
}
