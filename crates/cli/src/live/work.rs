//! The threads that render and solve.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use lumistack_core::Task;
use lumistack_live::{Boxes, Due, Mailbox, Player, Rays, Start, State, Target};
use lumistack_pipeline::{Job, LiveFields, LiveSolver, PipelineError, Registry};
use serde_json::json;

use super::clock::now;
use super::door::Events;
use super::messages::Messages;
use super::requests::{Requests, lock};

/// Time that a thread without work sleeps before it checks for the end.
const IDLE: Duration = Duration::from_millis(20);
/// Time that the renderer sleeps while the solver is busy.
const SHORT: Duration = Duration::from_millis(2);
/// Largest number of iterations for a light field while no viewer moves.
const MOST_UPDATES: u32 = 60;
/// Longest step of the solver, seconds: a good state that comes late looks worse than a fair state
/// that comes soon.
const STEP_S: f64 = 0.3;
/// Motion of a viewer after which the rays to the viewer are computed again, mm.
const TOLERANCE_MM: f64 = 2.0;

/// A light field to solve, and the job, which has the solver's settings.
#[derive(Debug)]
pub(super) struct SolveRequest {
    pub(super) target: Arc<Target>,
    job: Job,
}

/// Values that the threads share.
pub(super) struct Shared {
    pub(super) requests: Arc<Requests>,
    /// Warnings and errors of the newest request, which the page shows.
    pub(super) messages: Messages,
    pub(super) events: Arc<Events>,
    to_solve: Mailbox<SolveRequest>,
    /// States to show.
    pub(super) states: Mailbox<State>,
    /// Number of the newest light field that the solver has finished, with a state or with an
    /// error.
    handled: AtomicU64,
    files: Mutex<(Vec<PathBuf>, SystemTime)>,
    updates: u32,
    sigma_mm: f64,
    stopped: AtomicBool,
}

/// Time steps of a video.
pub(super) struct Rates {
    /// Light fields of the time steps; empty if the input is no video.
    pub(super) times: Vec<PathBuf>,
    pub(super) rate_hz: f64,
    pub(super) most_late: usize,
}

impl Shared {
    pub(super) fn new(requests: Requests, events: Events, updates: u32, sigma_mm: f64) -> Self {
        Self {
            requests: Arc::new(requests),
            messages: Messages::default(),
            events: Arc::new(events),
            to_solve: Mailbox::default(),
            states: Mailbox::default(),
            handled: AtomicU64::new(0),
            files: Mutex::new((Vec::new(), SystemTime::now())),
            updates,
            sigma_mm,
            stopped: AtomicBool::new(false),
        }
    }

    /// Ends all threads.
    pub(super) fn stop(&self) {
        self.stopped.store(true, Ordering::SeqCst);
        self.requests.stop();
        self.requests.cancel_pass();
    }

    /// Does the work of a thread. If the work panics, all threads end.
    pub(super) fn guard<T>(&self, work: impl FnOnce() -> T) -> T {
        let _guard = Guard(self);
        work()
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::SeqCst)
    }

    /// Returns the files of the current light field, and the time at which the pass that first read
    /// these files began.
    pub(super) fn files(&self) -> (Vec<PathBuf>, SystemTime) {
        lock(&self.files).clone()
    }

    /// Stores the files that a pass has read, and the time at which the pass began.
    fn note_files(&self, files: Vec<PathBuf>, begun: SystemTime) {
        let mut noted = lock(&self.files);
        if noted.0 != files {
            *noted = (files, begun);
        }
    }
}

/// Ends all threads if it is dropped by a panic.
struct Guard<'a>(&'a Shared);

impl Drop for Guard<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.stop();
        }
    }
}

/// Makes light fields until the display stops. Returns how many time steps of a video were skipped.
///
/// # Errors
/// When the first light field fails; later errors are reported, and the current state stays.
pub(super) fn render(
    mut live_fields: LiveFields,
    shared: &Shared,
    rates: Rates,
    registry: &Registry,
    task: Task<'_>,
) -> Result<usize, PipelineError> {
    let (requests, is_video) = (&shared.requests, !rates.times.is_empty());
    let mut player = Player::new(rates.times.len(), rates.rate_hz, rates.most_late);
    let (mut seen, mut edition, mut is_new, mut sent) = (0, 0, true, 0);
    while !shared.is_stopped() {
        // Apply the newest request.
        if let Some((number, request)) = requests.newest.after(seen) {
            (seen, is_new) = (number, true);
            shared.messages.say(String::new());
            let mut job = request.job.clone();
            if is_video {
                job.light_field.clone_from(&live_fields.job().light_field);
            }
            if request.edition != edition {
                edition = request.edition;
                live_fields.reload();
            }
            if let Err(error) = live_fields.change(job) {
                task.warn("live", error.to_string());
            }
        }
        // True if the solver has used the last light field that was sent.
        let is_solved = shared.handled.load(Ordering::SeqCst) >= sent;
        if !(is_video || is_new || is_solved) {
            // Wait, since another pass would take processor time from the solver.
            drop(requests.newest.wait_after(seen, SHORT));
            continue;
        }
        if is_video {
            // Time steps are solved in order: the next time step starts when the previous one has
            // patterns.
            match is_solved.then(|| player.next(now())) {
                Some(Due::Time(time)) => {
                    let job = Job { light_field: Some(rates.times[time].clone()), ..live_fields.job().clone() };
                    is_new = live_fields.change(job).is_ok();
                }
                Some(Due::End) => {
                    requests.stop();
                    break;
                }
                Some(Due::Wait(time)) => std::thread::sleep(time.min(IDLE)),
                None => std::thread::sleep(SHORT),
            }
            if !is_new {
                continue;
            }
        }
        // A new request must not cancel the first pass of the previous request, since a series of
        // requests would then show nothing.
        let cancel = if is_new { task.cancel.clone() } else { requests.pass() };
        let begun = SystemTime::now();
        let pass = live_fields.pass(registry, Task { cancel: &cancel, ..task });
        // Files are also watched after an error, since an incomplete file may change again.
        shared.note_files(live_fields.files(), begun);
        let pass = pass
            .map(|made| made.map(|target| SolveRequest { target: Arc::new(target), job: live_fields.job().clone() }));
        // Send the light field to the solver.
        match pass {
            Ok(Some(request)) => {
                sent = shared.to_solve.post(request);
                is_new = false;
            }
            Ok(None) if !is_video => drop(requests.newest.wait_after(seen, IDLE)),
            Ok(None) | Err(PipelineError::Cancelled) => {}
            Err(error) if sent == 0 => {
                requests.stop();
                return Err(error);
            }
            Err(error) => {
                // The error is a warning. The display keeps its current state until a newer
                // request.
                task.warn("live", error.to_string());
                is_new = false;
                while !(is_video || shared.is_stopped() || requests.newest.wait_after(seen, IDLE).is_some()) {}
            }
        }
    }
    Ok(player.dropped)
}

/// Solves the newest light field step by step until the display stops.
///
/// # Errors
/// When the first state fails; later errors are reported, and the current state stays.
pub(super) fn solve(mut solver: LiveSolver, shared: &Shared, task: Task<'_>) -> Result<(), PipelineError> {
    let mut current: Option<Current> = None;
    let (mut seen, mut latency, mut update_s) = (0, Duration::ZERO, 0.0);
    while !(shared.is_stopped() || task.cancel.is_cancelled()) {
        // Take the newest light field, and follow the viewers.
        if let Some((number, request)) = shared.to_solve.after(seen) {
            seen = number;
            if let Err(error) = solver.follow(&request.job) {
                task.warn("live", error.to_string());
            }
            current = Some(Current::new(number, request, current.take()));
        }
        let Some(on) = &mut current else {
            drop(shared.to_solve.wait_after(seen, IDLE));
            continue;
        };
        on.follow(shared.requests.tracker().boxes(now(), latency), shared.sigma_mm, task);
        if on.left == 0 {
            drop(shared.to_solve.wait_after(seen, IDLE));
            continue;
        }
        let (start, target) = (now(), on.request.target.clone());
        // Limit the iterations to [`STEP_S`] seconds, but run at least one.
        let affordable = if update_s > 0.0 { (STEP_S / update_s) as u32 } else { 1 };
        let updates = affordable.clamp(1, shared.updates).min(on.left);
        match solver.step(&target, &on.rays, updates, task) {
            Ok(solved) => {
                on.left -= updates;
                on.updates += updates;
                let step = now() - start;
                if solved.start == Start::Kept {
                    update_s = step.as_secs_f64() / f64::from(updates);
                }
                latency = if latency.is_zero() { step } else { (3 * latency + step) / 4 };
                let state = State {
                    stack: solved.stack,
                    target,
                    boxes: on.boxes.clone(),
                    psnr_view: solved.psnr_view,
                    updates: on.updates,
                };
                let (content, passes) = (state.target.content, state.target.passes);
                let (psnr, updates) = (state.psnr_view, state.updates);
                let number = shared.states.post(state);
                shared.handled.store(on.number, Ordering::SeqCst);
                let psnr = psnr.is_finite().then_some(psnr);
                let start = format!("{:?}", solved.start).to_lowercase();
                shared.events.say(
                    &json!({"event": "state", "number": number, "content": content, "passes": passes, "updates": updates,
                            "start": start, "psnr_view": psnr, "zone": on.boxes.zone, "step_s": step.as_secs_f64()}),
                );
            }
            Err(PipelineError::Cancelled) => {}
            Err(error) if shared.states.after(0).is_none() => {
                shared.requests.stop();
                return Err(error);
            }
            Err(error) => {
                task.warn("live", error.to_string());
                on.left = 0;
                shared.handled.store(on.number, Ordering::SeqCst);
            }
        }
    }
    Ok(())
}

/// The light field that is being solved.
struct Current {
    number: u64,
    request: Arc<SolveRequest>,
    boxes: Boxes,
    rays: Rays,
    /// Number of iterations since the content changed.
    updates: u32,
    /// Number of iterations that the solver will still spend on this light field. A viewer who
    /// moves resets the number.
    left: u32,
}

impl Current {
    fn new(number: u64, request: Arc<SolveRequest>, before: Option<Self>) -> Self {
        let same = before.filter(|before| before.request.target.content == request.target.content);
        let updates = same.map_or(0, |before| before.updates);
        let rays = Rays::Views(request.target.weights.clone());
        Self { number, request, boxes: Boxes::default(), rays, updates, left: MOST_UPDATES }
    }

    /// Computes the rays again if viewers have moved.
    fn follow(&mut self, boxes: Boxes, sigma_mm: f64, task: Task<'_>) {
        if boxes.is_like(&self.boxes, TOLERANCE_MM) {
            return;
        }
        match boxes.rays(&self.request.target, sigma_mm) {
            Ok(rays) => (self.rays, self.left) = (rays, MOST_UPDATES),
            Err(error) => task.warn("viewers", error.to_string()),
        }
        self.boxes = boxes;
    }
}

#[cfg(test)]
mod tests {
    use lumistack_pipeline::DisplayJob;

    use super::*;

    #[test]
    fn a_thread_that_panics_ends_all_threads() {
        let requests = Requests::new(Job::new(DisplayJob::by_name_or_path("fig7-uniform")));
        let shared = Shared::new(requests, Events::new(true), 1, 10.0);
        let (cancel, pass) = (lumistack_core::Cancel::default(), shared.requests.pass());
        let warnings = lumistack_core::Collector::default();
        let solver = LiveSolver::new(&shared.requests.job()).unwrap();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| shared.guard(|| solve(solver, &shared, Task::quiet(&warnings, &cancel))));
            assert_eq!(shared.guard(|| 3), 3);
            assert!(!shared.is_stopped());
            let panics = || shared.guard::<()>(|| std::panic::resume_unwind(Box::new(())));
            scope.spawn(panics).join().unwrap_err();
            assert!(waiting.join().is_ok());
        });
        assert!(shared.is_stopped() && shared.requests.is_stopped() && pass.is_cancelled());
    }
}
