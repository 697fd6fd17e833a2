//! The thread that keeps time: one picture per surface and refresh.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use super::gpu::{Deck, Gpu, Part, Screen};
use crate::presentation::{Event, Report};
use crate::{Feed, Tally};

/// What other threads tell the conductor, and it never waits for.
pub(super) struct Baton {
    pub(super) stop: AtomicBool,
    /// Place in the period that is kept, or −1.
    pub(super) hold: AtomicI64,
    /// Frames and colours of a period.
    pub(super) places: AtomicU64,
    /// Somebody wants a report.
    pub(super) report: AtomicBool,
    /// A window has another size.
    pub(super) resized: AtomicBool,
    /// Refreshes and swaps so far; 0 until there are pictures.
    pub(super) beat: AtomicU64,
    /// Screen that is waited for.
    pub(super) waits_for: AtomicUsize,
    pub(super) feed: Feed<Deck>,
}

/// Entries that the log may have.
const LOG_LIMIT: usize = 1 << 20;
/// Pause where no surface gives a picture, as on outputs that sleep.
const NOTHING: Duration = Duration::from_millis(5);

/// What a conductor works with.
pub(super) struct Conductor {
    pub(super) gpu: Arc<Gpu>,
    pub(super) screens: Vec<Screen>,
    pub(super) parts: Vec<Part>,
    pub(super) baton: Arc<Baton>,
    /// Where decks go to be dropped: that may take time.
    pub(super) retired: Sender<Deck>,
    pub(super) interval_s: f64,
    pub(super) interval_from: &'static str,
    pub(super) log: bool,
    #[cfg(all(unix, not(target_os = "macos")))]
    pub(super) feedback: Option<super::feedback::Feedback>,
}

impl Conductor {
    /// Shows pictures until told to stop; `tell` is called for swaps and wanted reports.
    pub(super) fn run(mut self, tell: &(dyn Fn(Event) + Sync)) -> Report {
        let mut report = Report {
            interval_s: self.interval_s,
            interval_from: self.interval_from.into(),
            submitted: Some(Tally::new(self.interval_s)),
            ..Report::default()
        };
        let (mut deck, mut place, mut start): (Option<Deck>, usize, Option<Instant>) = (None, 0, None);
        while !self.baton.stop.load(Ordering::Relaxed) {
            let hold = self.baton.hold.load(Ordering::Relaxed);
            let count = deck.as_ref().map_or(1, |deck| deck.pictures.len());
            if hold >= 0 {
                place = hold as usize % count;
            }
            // new pictures begin with a period; one that is kept begins with every refresh
            if (hold >= 0 || place == 0)
                && let Some(new) = self.baton.feed.take()
            {
                report.swaps += 1;
                self.baton.beat.store(report.swaps + report.refreshes, Ordering::Relaxed);
                tell(Event::Swapped { times: report.swaps, refresh: report.refreshes });
                place = if hold >= 0 { hold as usize % new.pictures.len() } else { 0 };
                if let Some(old) = deck.replace(new) {
                    let _ = self.retired.send(old);
                }
            }
            let Some(showing) = &deck else {
                // the first pictures are not there yet
                std::thread::sleep(NOTHING);
                continue;
            };
            if !self.refresh(&showing.pictures[place], report.refreshes, &mut report.missed) {
                std::thread::sleep(NOTHING);
                continue;
            }
            let start = *start.get_or_insert_with(Instant::now);
            let now_s = start.elapsed().as_secs_f64();
            if let Some(tally) = &mut report.submitted {
                tally.came(report.refreshes, now_s);
            }
            if self.log && report.log.len() < LOG_LIMIT {
                report.log.push((report.refreshes, place, showing.number, now_s));
            }
            report.refreshes += 1;
            self.baton.beat.store(report.swaps + report.refreshes, Ordering::Relaxed);
            report.seconds = now_s;
            report.rate_hz = if now_s > 0.0 { (report.refreshes - 1) as f64 / now_s } else { 0.0 };
            place = (place + 1) % showing.pictures.len();
            self.listen(&mut report);
            if self.baton.report.swap(false, Ordering::Relaxed) {
                tell(Event::Report(Box::new(report.clone())));
            }
        }
        self.last_words(&mut report);
        report
    }

    /// One refresh of all surfaces; false where none could be had.
    fn refresh(&mut self, pictures: &[wgpu::BindGroup], index: u64, missed: &mut u64) -> bool {
        let resized = self.baton.resized.swap(false, Ordering::Relaxed);
        let mut textures = Vec::with_capacity(self.screens.len());
        for (number, screen) in self.screens.iter_mut().enumerate() {
            if resized {
                screen.fit(&self.gpu.device);
            }
            self.baton.waits_for.store(number, Ordering::Relaxed);
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
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        for (number, texture) in &textures {
            let parts = self.parts.iter().zip(pictures).filter(|(part, _)| part.screen == *number);
            self.gpu.draw(&mut encoder, &texture.texture, parts);
        }
        self.gpu.queue.submit([encoder.finish()]);
        for (number, texture) in textures {
            #[cfg(all(unix, not(target_os = "macos")))]
            if let Some(feedback) = &mut self.feedback {
                feedback.ask(number, index);
            }
            #[cfg(not(all(unix, not(target_os = "macos"))))]
            let _ = index;
            self.baton.waits_for.store(number, Ordering::Relaxed);
            self.gpu.queue.present(texture);
        }
        true
    }

    /// Takes what the platform told about past refreshes.
    fn listen(&mut self, report: &mut Report) {
        #[cfg(all(unix, not(target_os = "macos")))]
        if let Some(feedback) = &mut self.feedback {
            feedback.listen();
            if report.refreshes.is_multiple_of(16) {
                self.take_over(report);
            }
        }
        #[cfg(not(all(unix, not(target_os = "macos"))))]
        let _ = report;
    }

    fn last_words(&mut self, report: &mut Report) {
        #[cfg(all(unix, not(target_os = "macos")))]
        {
            if let Some(feedback) = &mut self.feedback {
                std::thread::sleep(Duration::from_secs_f64((4.0 * self.interval_s).min(0.2)));
                feedback.listen();
            }
            self.take_over(report);
        }
        let _ = report;
    }

    #[cfg(all(unix, not(target_os = "macos")))]
    fn take_over(&self, report: &mut Report) {
        let Some(feedback) = &self.feedback else { return };
        let name = |screen: usize| {
            let parts = self.parts.iter().filter(|part| part.screen == screen);
            parts.map(|part| part.output.name.as_str()).collect::<Vec<_>>().join(" + ")
        };
        // what a platform promised and never told is not known
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
