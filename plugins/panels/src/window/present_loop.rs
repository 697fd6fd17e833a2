//! The present loop, which presents one frame per surface and refresh, on its own thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use super::gpu::{FrameSet, Gpu, Screen, Viewport};
use crate::presentation::{Event, Report};
use crate::{Feed, Tally};

/// State shared with the present loop, which reads it without blocking.
pub(super) struct SharedState {
    pub(super) stop: AtomicBool,
    /// The position in the period that all refreshes show; −1 if all positions are shown one after
    /// another.
    pub(super) hold: AtomicI64,
    /// Number of positions in a period: the number of frames, times three in a colour sequence.
    pub(super) places: AtomicU64,
    /// True if a report is requested.
    pub(super) report: AtomicBool,
    /// True if a window has changed its size.
    pub(super) resized: AtomicBool,
    /// Number of refreshes plus number of swaps; 0 before the first frame set. This sum grows as
    /// long as the loop is not blocked.
    pub(super) progress: AtomicU64,
    /// Index of the screen whose image is being acquired or presented. If the loop stalls, this
    /// screen is reported.
    pub(super) blocked_screen: AtomicUsize,
    pub(super) feed: Feed<FrameSet>,
}

/// Largest number of log entries.
const LOG_LIMIT: usize = 1 << 20;
/// Pause before a retry if no frame set is ready, or if no surface has a free image, as on sleeping
/// outputs.
const RETRY_PAUSE: Duration = Duration::from_millis(5);

/// The data of the present loop.
pub(super) struct PresentLoop {
    pub(super) gpu: Arc<Gpu>,
    pub(super) screens: Vec<Screen>,
    pub(super) viewports: Vec<Viewport>,
    pub(super) shared: Arc<SharedState>,
    /// Channel for replaced frame sets. Another thread frees them, since the release takes time.
    pub(super) retired: Sender<FrameSet>,
    pub(super) interval_s: f64,
    pub(super) interval_from: &'static str,
    pub(super) log: bool,
    #[cfg(all(unix, not(target_os = "macos")))]
    pub(super) feedback: Option<super::feedback::Feedback>,
}

impl PresentLoop {
    /// Presents frames until `stop` is set. Emits an event for each swap and each requested report.
    /// Returns the final report.
    pub(super) fn run(mut self, emit: &(dyn Fn(Event) + Sync)) -> Report {
        let mut report = Report {
            interval_s: self.interval_s,
            interval_from: self.interval_from.into(),
            submitted: Some(Tally::new(self.interval_s)),
            ..Report::default()
        };
        let (mut frame_set, mut place, mut start): (Option<FrameSet>, usize, Option<Instant>) = (None, 0, None);
        while !self.shared.stop.load(Ordering::Relaxed) {
            let hold = self.shared.hold.load(Ordering::Relaxed);
            let count = frame_set.as_ref().map_or(1, |frame_set| frame_set.pictures.len());
            if hold >= 0 {
                place = hold as usize % count;
            }
            // Take a new frame set only at the start of a period, so that no period mixes two
            // stacks. While a frame is held, a new set may be taken at any refresh.
            if (hold >= 0 || place == 0)
                && let Some(new) = self.shared.feed.take()
            {
                report.swaps += 1;
                self.shared.progress.store(report.swaps + report.refreshes, Ordering::Relaxed);
                emit(Event::Swapped { times: report.swaps, refresh: report.refreshes });
                place = if hold >= 0 { hold as usize % new.pictures.len() } else { 0 };
                if let Some(old) = frame_set.replace(new) {
                    let _ = self.retired.send(old);
                }
            }
            let Some(showing) = &frame_set else {
                // The producer has not made the first frame set yet.
                std::thread::sleep(RETRY_PAUSE);
                continue;
            };
            if !self.refresh(&showing.pictures[place], report.refreshes, &mut report.missed) {
                std::thread::sleep(RETRY_PAUSE);
                continue;
            }
            // Record the submission, then advance to the next position of the period.
            let start = *start.get_or_insert_with(Instant::now);
            let now_s = start.elapsed().as_secs_f64();
            if let Some(tally) = &mut report.submitted {
                tally.came(report.refreshes, now_s);
            }
            if self.log && report.log.len() < LOG_LIMIT {
                report.log.push((report.refreshes, place, showing.number, now_s));
            }
            report.refreshes += 1;
            self.shared.progress.store(report.swaps + report.refreshes, Ordering::Relaxed);
            report.seconds = now_s;
            report.rate_hz = if now_s > 0.0 { (report.refreshes - 1) as f64 / now_s } else { 0.0 };
            place = (place + 1) % showing.pictures.len();
            self.collect_feedback(&mut report);
            if self.shared.report.swap(false, Ordering::Relaxed) {
                emit(Event::Report(Box::new(report.clone())));
            }
        }
        self.drain_feedback(&mut report);
        report
    }

    /// Presents one frame on every surface that has an image; returns false if none has one.
    fn refresh(&mut self, pictures: &[wgpu::BindGroup], index: u64, missed: &mut u64) -> bool {
        let resized = self.shared.resized.swap(false, Ordering::Relaxed);
        // Acquire an image of every surface. Each call blocks until the surface has a free image.
        let mut textures = Vec::with_capacity(self.screens.len());
        for (number, screen) in self.screens.iter_mut().enumerate() {
            if resized {
                screen.fit(&self.gpu.device);
            }
            self.shared.blocked_screen.store(number, Ordering::Relaxed);
            match screen.surface.get_current_texture() {
                wgpu::CurrentSurfaceTexture::Success(texture) | wgpu::CurrentSurfaceTexture::Suboptimal(texture) => {
                    textures.push((number, texture));
                }
                wgpu::CurrentSurfaceTexture::Outdated | wgpu::CurrentSurfaceTexture::Lost => {
                    screen.fit(&self.gpu.device);
                    *missed += 1;
                }
                _ => *missed += 1,
            }
        }
        if textures.is_empty() {
            return false;
        }
        // Draw all surfaces in one submission, so that they are ready together.
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        for (number, texture) in &textures {
            let viewports = self.viewports.iter().zip(pictures).filter(|(viewport, _)| viewport.screen == *number);
            self.gpu.draw(&mut encoder, &texture.texture, viewports);
        }
        self.gpu.queue.submit([encoder.finish()]);
        // Present every surface. Request its presentation time before `present`, which commits the
        // surface.
        for (number, texture) in textures {
            #[cfg(all(unix, not(target_os = "macos")))]
            if let Some(feedback) = &mut self.feedback {
                feedback.request(number, index);
            }
            #[cfg(not(all(unix, not(target_os = "macos"))))]
            let _ = index;
            self.shared.blocked_screen.store(number, Ordering::Relaxed);
            self.gpu.queue.present(texture);
        }
        true
    }

    /// Adds the presentation times that have arrived to the report, without blocking.
    fn collect_feedback(&mut self, report: &mut Report) {
        #[cfg(all(unix, not(target_os = "macos")))]
        if let Some(feedback) = &mut self.feedback {
            feedback.dispatch();
            if report.refreshes.is_multiple_of(16) {
                self.copy_feedback(report);
            }
        }
        #[cfg(not(all(unix, not(target_os = "macos"))))]
        let _ = report;
    }

    /// Waits for the presentation times of the last refreshes and adds them to the report.
    fn drain_feedback(&mut self, report: &mut Report) {
        #[cfg(all(unix, not(target_os = "macos")))]
        {
            if let Some(feedback) = &mut self.feedback {
                std::thread::sleep(Duration::from_secs_f64((4.0 * self.interval_s).min(0.2)));
                feedback.dispatch();
            }
            self.copy_feedback(report);
        }
        let _ = report;
    }

    /// Copies statistics of presentation times into the report.
    #[cfg(all(unix, not(target_os = "macos")))]
    fn copy_feedback(&self, report: &mut Report) {
        let Some(feedback) = &self.feedback else { return };
        let name = |screen: usize| {
            let viewports = self.viewports.iter().filter(|viewport| viewport.screen == screen);
            viewports.map(|viewport| viewport.output.name.as_str()).collect::<Vec<_>>().join(" + ")
        };
        // If the platform offers presentation times but has reported none, leave the report without
        // them.
        if feedback.tallies().iter().all(|tally| tally.shown == 0) {
            return;
        }
        report.presented = feedback.tallies().iter().enumerate().map(|(i, tally)| (name(i), tally.clone())).collect();
        if self.screens.len() > 1 {
            report.skew_mean_s = feedback.skew().mean_s();
            report.skew_largest_s = report.skew_mean_s.map(|_| feedback.skew().largest_s);
        }
    }
}
