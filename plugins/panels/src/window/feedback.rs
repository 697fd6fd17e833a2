//! Collects presentation times by Wayland's presentation-time protocol.
//!
//! A request is sent before each commit of a surface. The answer comes some refreshes later. It
//! states the time at which the frame was presented, or that the frame was discarded. Answers
//! arrive in a separate queue. The main thread reads from the connection whenever data arrive. So
//! of the functions of this file only [`Feedback::new`] blocks.

use wayland_client::protocol::wl_registry::{self, WlRegistry};
use wayland_client::protocol::wl_surface::WlSurface;
use wayland_client::{Connection, Dispatch, EventQueue, Proxy, QueueHandle};
use wayland_protocols::wp::presentation_time::client::wp_presentation::{self, WpPresentation};
use wayland_protocols::wp::presentation_time::client::wp_presentation_feedback::{self, WpPresentationFeedback};

use super::gpu::Screen;
use super::wayland::{connection_of, surface_of};
use crate::{Skew, Tally};

/// Requests presentation times and collects statistics of the answers.
pub(super) struct Feedback {
    queue: EventQueue<FeedbackState>,
    presentation: WpPresentation,
    surfaces: Vec<WlSurface>,
    state: FeedbackState,
}

/// Statistics of the answers so far.
struct FeedbackState {
    presentation: Option<WpPresentation>,
    tallies: Vec<Tally>,
    skew: Skew,
}

/// The surface and the refresh to which a request belongs.
struct Request {
    screen: usize,
    index: u64,
}

impl Feedback {
    /// Begins the statistics. Returns `None` if the session is not Wayland, or if its compositor
    /// lacks the protocol.
    pub(super) fn new(screens: &[Screen], interval_s: f64) -> Option<Self> {
        let connection = connection_of(&screens.first()?.window)?;
        let surfaces = screens.iter().map(|screen| surface_of(&connection, &screen.window));
        let surfaces = surfaces.collect::<Option<Vec<_>>>()?;
        let mut queue = connection.new_event_queue();
        connection.display().get_registry(&queue.handle(), ());
        let tallies = vec![Tally::new(interval_s); screens.len()];
        let mut state = FeedbackState { presentation: None, tallies, skew: Skew::new(screens.len()) };
        queue.roundtrip(&mut state).ok()?;
        let presentation = state.presentation.clone()?;
        Some(Self { queue, presentation, surfaces, state })
    }

    /// Requests the presentation time of the next commit of a surface.
    pub(super) fn request(&mut self, screen: usize, index: u64) {
        self.presentation.feedback(&self.surfaces[screen], &self.queue.handle(), Request { screen, index });
    }

    /// Adds the answers that have arrived to the statistics.
    pub(super) fn dispatch(&mut self) {
        let _ = self.queue.dispatch_pending(&mut self.state);
    }

    /// Returns the statistics of each surface.
    pub(super) fn tallies(&self) -> &[Tally] {
        &self.state.tallies
    }

    /// Returns the statistics of the skew between surfaces.
    pub(super) fn skew(&self) -> &Skew {
        &self.state.skew
    }
}

impl Dispatch<WlRegistry, ()> for FeedbackState {
    fn event(
        state: &mut Self,
        registry: &WlRegistry,
        event: wl_registry::Event,
        _: &(),
        _: &Connection,
        queue: &QueueHandle<Self>,
    ) {
        if let wl_registry::Event::Global { name, interface, .. } = event
            && interface == WpPresentation::interface().name
        {
            state.presentation = Some(registry.bind(name, 1, queue, ()));
        }
    }
}

impl Dispatch<WpPresentation, ()> for FeedbackState {
    fn event(
        _: &mut Self,
        _: &WpPresentation,
        _: wp_presentation::Event,
        _: &(),
        _: &Connection,
        _: &QueueHandle<Self>,
    ) {
    }
}

impl Dispatch<WpPresentationFeedback, Request> for FeedbackState {
    fn event(
        state: &mut Self,
        _: &WpPresentationFeedback,
        event: wp_presentation_feedback::Event,
        request: &Request,
        _: &Connection,
        _: &QueueHandle<Self>,
    ) {
        if let wp_presentation_feedback::Event::Presented { tv_sec_hi, tv_sec_lo, tv_nsec, .. } = event {
            let seconds = (u64::from(tv_sec_hi) << 32 | u64::from(tv_sec_lo)) as f64 + f64::from(tv_nsec) * 1e-9;
            state.tallies[request.screen].came(request.index, seconds);
            state.skew.came(request.index, seconds);
        }
    }
}
