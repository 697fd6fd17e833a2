//! The threads that render and solve.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use lumistack_core::Task;
use lumistack_display::Weights;
use lumistack_factorizer::{FactorizeError, Settings};
use lumistack_live::{Boxes, Due, Mailbox, Player, Solver, Start, State, Target};
use lumistack_pipeline::{PipelineError, Registry, Studio};
use serde_json::json;

use super::clock::now;
use super::desk::{Desk, lock};
use crate::console::say;

/// How long a thread without work sleeps before it looks whether all is over.
const IDLE: Duration = Duration::from_millis(20);
/// How long one waits for the solver before it looks again.
const SHORT: Duration = Duration::from_millis(2);
/// Updates of a light field after which patterns stay as they are.
const MOST_UPDATES: u32 = 60;
/// Time that a step of the solver should take, at most, seconds: a display that follows late with good patterns is worse than one that is soon there.
const STEP_S: f64 = 0.3;
/// How far a viewer goes before weights follow, millimetres.
const TOLERANCE_MM: f64 = 2.0;

/// A light field, and settings to solve it with.
#[derive(Debug)]
pub(super) struct Order {
    pub(super) target: Arc<Target>,
    settings: Settings,
}

/// What threads hand each other.
pub(super) struct Stations {
    pub(super) desk: Arc<Desk>,
    orders: Mailbox<Order>,
    /// What is to be shown.
    pub(super) states: Mailbox<State>,
    files: Mutex<Vec<PathBuf>>,
    updates: u32,
    sigma_mm: f64,
    stopped: AtomicBool,
}

/// Times of a video.
pub(super) struct Rates {
    /// None where the input is no video.
    pub(super) times: Vec<PathBuf>,
    pub(super) rate_hz: f64,
    pub(super) most_late: usize,
}

impl Stations {
    pub(super) fn new(desk: Desk, updates: u32, sigma_mm: f64) -> Self {
        Self {
            desk: Arc::new(desk),
            orders: Mailbox::default(),
            states: Mailbox::default(),
            files: Mutex::default(),
            updates,
            sigma_mm,
            stopped: AtomicBool::new(false),
        }
    }

    /// Ends all threads.
    pub(super) fn stop(&self) {
        self.stopped.store(true, Ordering::SeqCst);
        self.desk.stop();
        self.desk.cancel_pass();
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::SeqCst)
    }

    /// Files that the light field on show is made from.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        lock(&self.files).clone()
    }
}

/// Makes light fields until all is over. Returns how many times of a video were left out.
///
/// # Errors
/// When there is nothing to begin with; later errors are told, and what is shown stays.
pub(super) fn render(
    mut studio: Studio,
    stations: &Stations,
    rates: Rates,
    registry: &Registry,
    task: Task<'_>,
) -> Result<usize, PipelineError> {
    let (desk, is_video) = (&stations.desk, !rates.times.is_empty());
    let mut player = Player::new(rates.times.len(), rates.rate_hz, rates.most_late);
    let (mut seen, mut edition, mut is_new, mut sent) = (0, 0, true, 0);
    while !stations.is_stopped() {
        if let Some((number, wish)) = desk.wishes.after(seen) {
            (seen, is_new) = (number, true);
            let mut job = wish.job.clone();
            if is_video {
                job.light_field.clone_from(&studio.job().light_field);
            }
            if wish.edition != edition {
                edition = wish.edition;
                studio.reload();
            }
            if let Err(error) = studio.change(job) {
                task.warn("live", error.to_string());
            }
        }
        let is_solved = sent == 0 || stations.states.after(0).is_some_and(|(_, state)| state.target_number >= sent);
        if !(is_video || is_new || is_solved) {
            // another pass would take the processors that the solver needs for the one before
            drop(desk.wishes.wait_after(seen, SHORT));
            continue;
        }
        if is_video {
            // in order: the next time is taken when the one before has become patterns
            match is_solved.then(|| player.next(now())) {
                Some(Due::Time(time)) => {
                    let job = lumistack_pipeline::Job {
                        light_field: Some(rates.times[time].clone()),
                        ..studio.job().clone()
                    };
                    is_new = studio.change(job).is_ok();
                }
                Some(Due::End) => {
                    desk.stop();
                    break;
                }
                Some(Due::Wait(time)) => std::thread::sleep(time.min(IDLE)),
                None => std::thread::sleep(SHORT),
            }
            if !is_new {
                continue;
            }
        }
        // what is shown first of a change is not stopped by the next one, or nothing would be shown while one follows the other
        let cancel = if is_new { task.cancel.clone() } else { desk.pass() };
        let pass = studio.pass(registry, Task { cancel: &cancel, ..task }).and_then(|made| {
            *lock(&stations.files) = studio.files();
            Ok(match made {
                Some(target) => Some(Order { target: Arc::new(target), settings: studio.settings()? }),
                None => None,
            })
        });
        match pass {
            Ok(Some(order)) => {
                sent = stations.orders.post(order);
                is_new = false;
            }
            Ok(None) if !is_video => drop(desk.wishes.wait_after(seen, IDLE)),
            Ok(None) | Err(PipelineError::Cancelled) => {}
            Err(error) if sent == 0 => {
                desk.stop();
                return Err(error);
            }
            Err(error) => {
                // what was shown before stays; files may be half-written
                *lock(&stations.files) = studio.files();
                task.warn("live", error.to_string());
                is_new = false;
                while !(is_video || stations.is_stopped() || desk.wishes.wait_after(seen, IDLE).is_some()) {}
            }
        }
    }
    Ok(player.dropped)
}

/// Solves the newest light field again and again until all is over.
pub(super) fn solve(stations: &Stations, json: bool, task: Task<'_>) {
    let mut solver: Option<Solver> = None;
    let mut now_on: Option<OnShow> = None;
    let (mut seen, mut latency, mut update_s) = (0, Duration::ZERO, 0.0);
    while !(stations.is_stopped() || task.cancel.is_cancelled()) {
        if let Some((number, order)) = stations.orders.after(seen) {
            seen = number;
            let solver = solver.get_or_insert_with(|| Solver::new(order.settings.clone()));
            solver.set(order.settings.clone());
            now_on = Some(OnShow::new(number, order, now_on.take()));
        }
        let (Some(solver), Some(on)) = (&mut solver, &mut now_on) else {
            drop(stations.orders.wait_after(seen, IDLE));
            continue;
        };
        on.follow(stations.desk.tracker().boxes(now(), latency), stations.sigma_mm, task);
        if on.left == 0 {
            drop(stations.orders.wait_after(seen, IDLE));
            continue;
        }
        let (start, target) = (now(), on.order.target.clone());
        let affordable = if update_s > 0.0 { (STEP_S / update_s) as u32 } else { 1 };
        let updates = affordable.clamp(1, stations.updates).min(on.left);
        match solver.step(&target, &on.weights, updates, task) {
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
                    target_number: on.number,
                    weights: on.weights.clone(),
                    psnr_view: solved.psnr_view,
                    updates: on.updates,
                };
                let (content, passes) = (state.target.content, state.target.passes);
                let (psnr, updates) = (state.psnr_view, state.updates);
                let number = stations.states.post(state);
                if json {
                    let psnr = psnr.is_finite().then_some(psnr);
                    let start = format!("{:?}", solved.start).to_lowercase();
                    say!(
                        "{}",
                        json!({"event": "state", "number": number, "content": content, "passes": passes, "updates": updates,
                            "start": start, "psnr_view": psnr, "zone": on.boxes.zone, "step_s": step.as_secs_f64()})
                    );
                }
            }
            Err(FactorizeError::Cancelled(_)) => {}
            Err(error) => {
                task.warn("live", error.to_string());
                on.left = 0;
            }
        }
    }
}

/// The light field that is solved.
struct OnShow {
    number: u64,
    order: Arc<Order>,
    boxes: Boxes,
    weights: Arc<Weights>,
    /// Updates since the content changed, and those that are left.
    updates: u32,
    left: u32,
}

impl OnShow {
    fn new(number: u64, order: Arc<Order>, before: Option<Self>) -> Self {
        let same = before.filter(|before| before.order.target.content == order.target.content);
        let updates = same.map_or(0, |before| before.updates);
        let boxes = Boxes { heads_mm: Vec::new(), zone: 1.0 };
        let weights = Arc::new(order.target.weights.clone());
        Self { number, order, boxes, weights, updates, left: MOST_UPDATES }
    }

    /// Makes weights follow viewers.
    fn follow(&mut self, boxes: Boxes, sigma_mm: f64, task: Task<'_>) {
        if boxes.is_like(&self.boxes, TOLERANCE_MM) {
            return;
        }
        let target = &self.order.target;
        match boxes.weights(target.field.geometry(), &target.weights, sigma_mm) {
            Ok(weights) => (self.weights, self.left) = (Arc::new(weights), MOST_UPDATES),
            Err(error) => task.warn("viewers", error.to_string()),
        }
        self.boxes = boxes;
    }
}
