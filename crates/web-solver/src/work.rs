//! Plans a solve as a queue of small pieces, and computes them one by one.

use std::collections::VecDeque;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Display, LayerStack, LightField, Weights};
use lumistack_factorizer::device::Executor;
use lumistack_factorizer::{FactorizeError, Ongoing, Problem, Processor, has_levels, reoptimize_on_levels};
use lumistack_scene::Scene;
use lumistack_shot::{LightJob, LitScene, light};

use crate::decoders;
use crate::error::Error;
use crate::files::Files;
use crate::settings::Settings;
use crate::views::{Detail, Picked, Views};

/// Largest number of rows of views for which the first patterns are solved. The number of columns
/// of views has the same limit.
const FIRST: usize = 3;
/// Paths per pixel of the first views, if these are coarse. Coarse views have a quarter of the
/// pixels. So two paths per pixel take half of the time of one path per pixel of a full view.
const COARSE_SAMPLES: u32 = 2;
/// Iterations of a solve for unfinished views. Few suffice, since each such solve but the first
/// starts from the current patterns.
const WARM: u32 = 3;
/// For a light field, patterns are shown after each of the first [`WARM`] iterations. Later they
/// are shown after every iteration whose number is a multiple of this number.
const FIELD_SHOWS: u32 = 4;
/// Number of views whose splats one piece renders. The splats are sorted once for all these views.
const SPLAT_VIEWS: usize = 5;
/// Number of parts into which the final rendering of views is divided. After every part except the
/// last, the patterns are solved again.
const REFRESHES: usize = 4;
/// Seed of the solver; the command uses the same seed.
const SEED: u64 = 1;

/// False in the module without WebGPU, which omits the code for devices, so that it is small.
const HAS_DEVICES: bool = cfg!(any(feature = "gpu", not(target_arch = "wasm32")));

/// Progress of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Reads the files, lights the scene, and places the display.
    Scene,
    /// Renders views, and between them solves for unfinished views.
    Views,
    /// Solves for the finished views.
    Patterns,
    /// No work remains.
    Done,
}

/// A piece of work.
enum Piece {
    /// Reads a light field, and adapts the display to it.
    ReadField,
    /// Starts a solve for the light field that was read.
    BeginField,
    Read,
    Light,
    Place,
    Trace {
        view: [usize; 2],
        detail: Detail,
        samples: u32,
    },
    Splats(Vec<[usize; 2]>),
    /// Makes the light field of the picked views, and starts a solve for it from the current
    /// patterns, if there are any.
    Begin(Picked, Detail),
    /// Makes the light field of all views, and starts a solve for it without a warm start, as the
    /// command does.
    BeginAnew,
    /// Starts the current solve again, after its device failed.
    BeginAgain,
    Step,
    /// Copies the patterns of the current solve to `stack`, which the page shows.
    Show,
    Finish,
}

/// A solve in progress. It can be dropped at any time.
pub struct Work {
    settings: Settings,
    display: Display,
    path: String,
    /// Files of a scene. `None` for a light field, whose files are in the module of decoders.
    files: Option<Files>,
    scene: Option<Scene>,
    held: Option<LitScene>,
    views: Option<Views>,
    pieces: VecDeque<Piece>,
    planned: usize,
    /// The device that solves; `None` for the processor.
    device: Option<Box<dyn Executor>>,
    run: Option<Ongoing>,
    begun: Begun,
    target: Option<LightField>,
    stack: Option<LayerStack>,
    /// Number of times that `stack`, the patterns to show, was replaced.
    shown: u32,
    psnr: f64,
    warnings: Collector,
    cancel: Cancel,
}

/// The current solve: the number of planned iterations, the number of finished iterations, and a
/// flag for a start from the patterns of an earlier solve.
#[derive(Clone, Copy, Default)]
struct Begun {
    iterations: u32,
    steps: u32,
    warm: bool,
}

impl Work {
    /// Prepares the work on the scene in the file `path`, one of `files`.
    ///
    /// # Errors
    /// If the settings are invalid.
    pub fn new(files: Files, path: &str, settings: Settings) -> Result<Self, Error> {
        Self::begin(Some(files), path, settings)
    }

    /// Prepares the work on a light field: a file or folder of any kind that the program
    /// `lumistack` reads. In the browser, `path` names files in the memory of
    /// `lumistack-web-decoders`, a separate WebAssembly module.
    ///
    /// # Errors
    /// If the settings are invalid.
    pub fn of_field(path: &str, settings: Settings) -> Result<Self, Error> {
        Self::begin(None, path, settings)
    }

    fn begin(files: Option<Files>, path: &str, settings: Settings) -> Result<Self, Error> {
        let pieces = match &files {
            Some(_) => VecDeque::from([Piece::Read, Piece::Light, Piece::Place]),
            None => VecDeque::from([Piece::ReadField]),
        };
        Ok(Self {
            display: settings.display()?,
            settings,
            path: path.into(),
            files,
            scene: None,
            held: None,
            views: None,
            pieces,
            planned: 0,
            device: None,
            run: None,
            begun: Begun::default(),
            target: None,
            stack: None,
            shown: 0,
            psnr: f64::NAN,
            warnings: Collector::default(),
            cancel: Cancel::default(),
        })
    }

    /// Solves on a device. If the device cannot solve a display, or fails, the processor solves
    /// from then on, and a warning reports this.
    pub fn solve_on(&mut self, device: Box<dyn Executor>) {
        self.device = Some(device);
    }

    /// Returns true if a device solves.
    pub fn is_on_device(&self) -> bool {
        HAS_DEVICES && self.device.is_some()
    }

    /// Restarts with another display. A scene stays in memory; a light field is read again.
    ///
    /// # Errors
    /// If the settings are invalid. The work then continues with the previous settings.
    pub fn change(&mut self, settings: Settings) -> Result<(), Error> {
        self.display = settings.display()?;
        self.settings = settings;
        (self.run, self.target, self.stack, self.psnr, self.planned) = (None, None, None, f64::NAN, 0);
        if let Some(views) = self.views.take() {
            self.held = Some(views.into_held());
        }
        self.pieces = match (&self.files, &self.held, &self.scene) {
            // read the light field again, since its geometry may depend on the display
            (None, ..) => [Piece::ReadField].into(),
            (_, Some(_), _) => [Piece::Place].into(),
            (_, None, Some(_)) => [Piece::Light, Piece::Place].into(),
            (_, None, None) => [Piece::Read, Piece::Light, Piece::Place].into(),
        };
        Ok(())
    }

    /// Returns the chosen display. After a light field is read, the display is adapted to it.
    pub fn display(&self) -> &Display {
        &self.display
    }

    /// Returns the job file by which the command computes the same patterns. The command expects
    /// `display.toml` and the input's files beside the job.
    pub fn job(&self) -> String {
        let resolution = self.files.is_none().then_some(self.display.field.resolution);
        self.settings.job(&self.path, resolution)
    }

    /// Returns the current patterns; `None` before the first patterns.
    pub fn stack(&self) -> Option<&LayerStack> {
        self.stack.as_ref()
    }

    /// Returns the number of times that [`Self::stack`] changed to new patterns.
    pub fn shown(&self) -> u32 {
        self.shown
    }

    /// Returns the PSNR of the current patterns over the views for which they were solved, dB. NaN
    /// before the first patterns.
    pub fn psnr(&self) -> f64 {
        self.psnr
    }

    /// Returns the warnings for the user since the last call. Equal texts are returned only once.
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.take().iter().map(|warning| without_options(&warning.to_string())).collect()
    }

    /// Returns the finished fraction of the planned pieces, 0..1. It is 0 until the display is
    /// placed in the scene, or the light field is read.
    pub fn share(&self) -> f64 {
        if self.planned == 0 { 0.0 } else { 1.0 - self.pieces.len() as f64 / self.planned as f64 }
    }

    /// Returns the current stage.
    pub fn stage(&self) -> Stage {
        let waits = |wanted: fn(&Piece) -> bool| self.pieces.iter().any(wanted);
        match &self.pieces {
            none if none.is_empty() => Stage::Done,
            _ if waits(|piece| matches!(piece, Piece::Place | Piece::ReadField)) => Stage::Scene,
            _ if waits(|piece| matches!(piece, Piece::BeginAnew)) => Stage::Views,
            _ => Stage::Patterns,
        }
    }

    /// Returns the number of a view for another thread to trace; `None` if there is none. Each view
    /// is returned once. The last views are returned first, since this `Work` traces the first
    /// views next.
    pub fn give(&mut self) -> Option<usize> {
        let views = self.views.as_mut()?;
        // this `Work` traces the first piece in any case
        self.pieces.iter().skip(1).rev().find_map(|piece| match piece {
            Piece::Trace { view, detail: Detail::Full, .. } => views.give(*view),
            _ => None,
        })
    }

    /// Traces a view with all its samples for another `Work`, which gave the view's number. The
    /// other `Work` must have the same scene and settings. Returns the values of a
    /// [`lumistack_pathtracer::SplitView`].
    ///
    /// # Errors
    /// If the display is not placed in the scene yet, or there is no such view.
    pub fn trace(&mut self, number: usize) -> Result<Vec<f32>, Error> {
        let task = Task::quiet(&self.warnings, &self.cancel);
        Ok(views(&mut self.views)?.trace_whole(number, task)?.values().data().to_vec())
    }

    /// Takes the values of a view that another thread traced, and does not trace the view itself.
    ///
    /// # Errors
    /// If the display is not placed in the scene yet, there is no such view, or `values` is not as
    /// long as the values of the view.
    pub fn take(&mut self, number: usize, values: Vec<f32>) -> Result<(), Error> {
        let views = views(&mut self.views)?;
        views.keep_values(number, values)?;
        // Drop the pieces that trace this view. Also drop each refresh (a solve for unfinished
        // views) if no view is traced between the previous refresh and this one.
        let (mut has_shown, mut drops) = (false, false);
        self.pieces.retain(|piece| {
            drops = match piece {
                Piece::Trace { view, detail: Detail::Full, .. } if views.number(*view) == number => return false,
                Piece::Begin(..) => has_shown,
                Piece::Step | Piece::Show => drops,
                _ => false,
            };
            has_shown = matches!(piece, Piece::Show);
            !drops
        });
        Ok(())
    }

    /// Computes the next piece.
    ///
    /// # Errors
    /// If a piece fails, for example because the file is damaged, or because scene and display do
    /// not fit each other. The work then ends.
    pub fn advance(&mut self) -> Result<(), Error> {
        let Some(piece) = self.pieces.pop_front() else { return Ok(()) };
        let done = self.work_on(piece);
        if done.is_err() {
            self.pieces.clear();
        }
        done
    }

    fn work_on(&mut self, piece: Piece) -> Result<(), Error> {
        // Each arm moves its results into `self`, so the work can be dropped between two pieces.
        let task = Task::quiet(&self.warnings, &self.cancel);
        match piece {
            Piece::ReadField => {
                let display = self.settings.display()?;
                let field = decoders::field(&self.path, &self.settings.wanted(&display), task)?;
                self.display = self.settings.display_for(field.geometry())?;
                self.target = Some(field);
                self.pieces = plan_field(self.settings.iterations(&self.display));
                self.planned = self.pieces.len();
            }
            Piece::BeginField => {
                self.begun = Begun { iterations: self.settings.iterations(&self.display), ..Begun::default() };
                self.begin_solve()?;
            }
            Piece::Read => {
                let Some(files) = &mut self.files else { return Ok(()) };
                self.scene = Some(files.scene(&self.path, task)?);
                *files = Files::default();
            }
            Piece::Light => {
                let Some(scene) = self.scene.take() else { return Ok(()) };
                let (scene, _) = light::lit(scene, false, &LightJob::default(), task)?;
                self.held = Some(LitScene::new(scene, task)?);
            }
            Piece::Place => {
                let Some(held) = self.held.take() else { return Ok(()) };
                let views = Views::new(held, &self.display, &self.settings, task)?;
                self.pieces = plan(&views, self.settings.iterations(&self.display));
                self.planned = self.pieces.len();
                self.views = Some(views);
            }
            Piece::Trace { view, detail, samples } => {
                let views = views(&mut self.views)?;
                let split = views.trace(view, detail, samples, task)?;
                views.keep(view, detail, samples, &split);
            }
            Piece::Splats(some) => views(&mut self.views)?.render_splats(&some, task)?,
            Piece::Begin(picked, detail) => {
                self.target = Some(views(&mut self.views)?.field(&picked, detail, task)?);
                self.begun = Begun { iterations: WARM, warm: true, ..Begun::default() };
                self.begin_solve()?;
            }
            Piece::BeginAnew => {
                let views = views(&mut self.views)?;
                self.target = Some(views.field(&Picked::all(views.grid()), Detail::Full, task)?);
                self.begun = Begun { iterations: self.settings.iterations(&self.display), ..Begun::default() };
                self.begin_solve()?;
            }
            Piece::BeginAgain => self.begin_solve()?,
            Piece::Step | Piece::Show | Piece::Finish => match self.solve(&piece) {
                Err(error @ FactorizeError::Device { .. }) if self.is_on_device() => {
                    self.leave_device(&error);
                    // The device's results are lost. So plan to start the solve again on the
                    // processor, and to repeat its finished iterations before this piece.
                    let lost = (0..self.begun.steps).map(|_| Piece::Step);
                    let again: Vec<_> = std::iter::once(Piece::BeginAgain).chain(lost).chain([piece]).collect();
                    self.planned += again.len();
                    again.into_iter().rev().for_each(|piece| self.pieces.push_front(piece));
                }
                done => done?,
            },
        }
        Ok(())
    }

    /// Starts a solve for the target.
    fn begin_solve(&mut self) -> Result<(), FactorizeError> {
        let Some(target) = &self.target else { return Ok(()) };
        self.begun.steps = 0;
        let task = Task::quiet(&self.warnings, &self.cancel);
        let problem = Problem { display: &self.display, target, weights: &Weights::Uniform };
        let settings =
            lumistack_factorizer::Settings { iterations: self.begun.iterations, seed: SEED, ..Default::default() };
        let warm = self.stack.as_ref().filter(|_| self.begun.warm);
        let begin = |device: &dyn Executor| Ongoing::begin_on(device, &problem, &settings, warm, task);
        let run = match begin(self.device.as_deref().filter(|_| HAS_DEVICES).unwrap_or(&Processor)) {
            Err(error @ FactorizeError::Device { .. }) if self.is_on_device() => {
                let run = begin(&Processor);
                self.leave_device(&error);
                run
            }
            run => run,
        };
        self.run = Some(run?);
        Ok(())
    }

    /// Computes a piece of the current solve.
    fn solve(&mut self, piece: &Piece) -> Result<(), FactorizeError> {
        match (piece, &mut self.run) {
            (Piece::Step, Some(run)) => {
                run.step(&self.cancel)?;
                self.begun.steps += 1;
            }
            (Piece::Show, Some(run)) => {
                let (psnr, stack) = (run.objective().psnr_view, run.patterns());
                run.check()?;
                (self.psnr, self.stack) = (psnr, Some(stack));
                self.shown += 1;
            }
            (Piece::Finish, run) => {
                let (Some(run), Some(target)) = (run.take(), &self.target) else { return Ok(()) };
                let task = Task::quiet(&self.warnings, &self.cancel);
                let problem = Problem { display: &self.display, target, weights: &Weights::Uniform };
                let (mut stack, objective) = run.finish()?;
                if has_levels(&problem) {
                    stack = reoptimize_on_levels(&problem, stack, task)?;
                }
                (self.psnr, self.stack) = (objective.psnr_view, Some(stack));
                self.shown += 1;
            }
            _ => {}
        }
        Ok(())
    }

    /// Continues on the processor, and reports why.
    fn leave_device(&mut self, why: &FactorizeError) {
        (self.device, self.run) = (None, None);
        let task = Task::quiet(&self.warnings, &self.cancel);
        task.warn("factorize", format!("{why}; the processor solves instead"));
    }
}

fn views(views: &mut Option<Views>) -> Result<&mut Views, Error> {
    views.as_mut().ok_or_else(|| Error("the display is not placed in the scene yet".into()))
}

/// Plans the pieces after a light field is read: a single solve. Its patterns are shown after each
/// of the first [`WARM`] iterations, in which they change most. Later they are shown after every
/// iteration whose number is a multiple of [`FIELD_SHOWS`], and at the end.
fn plan_field(iterations: u32) -> VecDeque<Piece> {
    let mut pieces = VecDeque::from([Piece::BeginField]);
    for iteration in 1..=iterations {
        pieces.push_back(Piece::Step);
        if iteration <= WARM || iteration.is_multiple_of(FIELD_SHOWS) {
            pieces.push_back(Piece::Show);
        }
    }
    pieces.push_back(Piece::Finish);
    pieces
}

/// Plans the pieces after the display is placed in the scene. The first pieces render noisy views
/// of a few directions, coarse unless the scene has splats. Then noisy views of all directions
/// follow, then views with all their samples, and the last solve.
fn plan(views: &Views, iterations: u32) -> VecDeque<Piece> {
    let (first, all) = (Picked::some(views.grid(), FIRST), Picked::all(views.grid()));
    let mut pieces = VecDeque::new();
    let refresh = |pieces: &mut VecDeque<Piece>, picked: &Picked, detail: Detail| {
        pieces.push_back(Piece::Begin(picked.clone(), detail));
        for _ in 0..WARM {
            pieces.extend([Piece::Step, Piece::Show]);
        }
    };
    let traced = views.is_traced();
    let trace = |pieces: &mut VecDeque<Piece>, some: &[[usize; 2]], detail: Detail, samples: u32| {
        if traced {
            pieces.extend(some.iter().map(|&view| Piece::Trace { view, detail, samples }));
        }
    };
    let splat = |pieces: &mut VecDeque<Piece>, some: &[[usize; 2]]| {
        if views.has_splats() {
            pieces.extend(some.chunks(SPLAT_VIEWS).map(|some| Piece::Splats(some.to_vec())));
        }
    };
    // Few views come first, so that the page shows patterns early. Coarse views are quicker. But
    // splats are always rendered with all pixels, and cannot be drawn in front of coarse views.
    let (detail, samples) = if views.has_splats() { (Detail::Full, 1) } else { (Detail::Coarse, COARSE_SAMPLES) };
    let few: Vec<[usize; 2]> = first.views().collect();
    trace(&mut pieces, &few, detail, samples);
    splat(&mut pieces, &few);
    refresh(&mut pieces, &first, detail);
    // Then render noisy views of all directions, except the views that are already rendered.
    let every: Vec<[usize; 2]> = all.views().collect();
    let is_there = |view: &[usize; 2]| detail == Detail::Full && few.contains(view);
    let others: Vec<[usize; 2]> = every.iter().copied().filter(|view| !is_there(view)).collect();
    if !others.is_empty() {
        trace(&mut pieces, &others, Detail::Full, 1);
        splat(&mut pieces, &others);
        refresh(&mut pieces, &all, Detail::Full);
    }
    // Then render all views with all their samples, in parts.
    if traced && views.samples() > 1 {
        // a part contains every REFRESHES-th view, so that its views are spread over the zone
        let parts = (0..REFRESHES).map(|part| every.iter().copied().skip(part).step_by(REFRESHES).collect::<Vec<_>>());
        for (number, part) in parts.enumerate() {
            trace(&mut pieces, &part, Detail::Full, views.samples());
            if number + 1 < REFRESHES {
                refresh(&mut pieces, &all, Detail::Full);
            }
        }
    }
    // The last solve has a fresh start, as in the command, so that it ends with the command's
    // patterns.
    pieces.push_back(Piece::BeginAnew);
    pieces.extend((0..iterations).map(|_| Piece::Step));
    pieces.push_back(Piece::Finish);
    pieces
}

/// Returns a warning without the parentheses that name an option of the command, since a page has
/// no options.
fn without_options(warning: &str) -> String {
    let mut left = warning.to_owned();
    while let Some(start) = left.find(" (--")
        && let Some(length) = left[start..].find(')')
    {
        left.replace_range(start..=start + length, "");
    }
    left
}

#[cfg(test)]
mod tests {
    use super::without_options;

    #[test]
    fn warnings_of_a_page_name_no_options() {
        for (warning, expected) in [
            ("a.npy: 20° × 20° (--fov sets other angles)", "a.npy: 20° × 20°"),
            ("1 mm (--pitch-mm), 2 views (--grid)", "1 mm, 2 views"),
            ("b (c): (--fov", "b (c): (--fov"),
            ("b (c): d", "b (c): d"),
        ] {
            assert_eq!(without_options(warning), expected);
        }
    }
}
