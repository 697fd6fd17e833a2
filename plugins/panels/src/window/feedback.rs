//! When pictures were really shown, as Wayland's presentation-time protocol tells it.
//!
//! Every presentation is asked about before it is committed; the answer comes some refreshes later, with the time of the refresh, or says that the picture was
//! never shown. Answers arrive in a queue of our own. The main thread reads the connection whenever something comes, so nothing here ever blocks.

use wayland_client::protocol::wl_registry::{self, WlRegistry};
use wayland_client::protocol::wl_surface::WlSurface;
use wayland_client::{Connection, Dispatch, EventQueue, Proxy, QueueHandle};
use wayland_protocols::wp::presentation_time::client::wp_presentation::{self, WpPresentation};
use wayland_protocols::wp::presentation_time::client::wp_presentation_feedback::{self, WpPresentationFeedback};

use super::gpu::Screen;
use super::wayland::{connection_of, surface_of};
use crate::{Skew, Tally};

/// Asks and listens.
pub(super) struct Feedback {
    queue: EventQueue<Heard>,
    presentation: WpPresentation,
    surfaces: Vec<WlSurface>,
    heard: Heard,
}

/// What was told so far.
struct Heard {
    presentation: Option<WpPresentation>,
    tallies: Vec<Tally>,
    skew: Skew,
}

/// Which refresh of which surface an answer is about.
struct Asked {
    screen: usize,
    index: u64,
}

impl Feedback {
    /// None where the session is not Wayland or does not tell.
    pub(super) fn new(screens: &[Screen], interval_s: f64) -> Option<Self> {
        let connection = connection_of(&screens.first()?.window)?;
        let surfaces = screens.iter().map(|screen| surface_of(&connection, &screen.window));
        let surfaces = surfaces.collect::<Option<Vec<_>>>()?;
        let mut queue = connection.new_event_queue();
        connection.display().get_registry(&queue.handle(), ());
        let tallies = vec![Tally::new(interval_s); screens.len()];
        let mut heard = Heard { presentation: None, tallies, skew: Skew::new(screens.len()) };
        queue.roundtrip(&mut heard).ok()?;
        let presentation = heard.presentation.clone()?;
        Some(Self { queue, presentation, surfaces, heard })
    }

    /// Asks about the presentation that follows.
    pub(super) fn ask(&mut self, screen: usize, index: u64) {
        self.presentation.feedback(&self.surfaces[screen], &self.queue.handle(), Asked { screen, index });
    }

    /// Takes the answers that are there.
    pub(super) fn listen(&mut self) {
        let _ = self.queue.dispatch_pending(&mut self.heard);
    }

    /// Per surface.
    pub(super) fn tallies(&self) -> &[Tally] {
        &self.heard.tallies
    }

    /// Between surfaces.
    pub(super) fn skew(&self) -> &Skew {
        &self.heard.skew
    }
}

impl Dispatch<WlRegistry, ()> for Heard {
    fn event(
        heard: &mut Self,
        registry: &WlRegistry,
        event: wl_registry::Event,
        _: &(),
        _: &Connection,
        queue: &QueueHandle<Self>,
    ) {
        if let wl_registry::Event::Global { name, interface, .. } = event
            && interface == WpPresentation::interface().name
        {
            heard.presentation = Some(registry.bind(name, 1, queue, ()));
        }
    }
}

impl Dispatch<WpPresentation, ()> for Heard {
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

impl Dispatch<WpPresentationFeedback, Asked> for Heard {
    fn event(
        heard: &mut Self,
        _: &WpPresentationFeedback,
        event: wp_presentation_feedback::Event,
        asked: &Asked,
        _: &Connection,
        _: &QueueHandle<Self>,
    ) {
        if let wp_presentation_feedback::Event::Presented { tv_sec_hi, tv_sec_lo, tv_nsec, .. } = event {
            let seconds = (u64::from(tv_sec_hi) << 32 | u64::from(tv_sec_lo)) as f64 + f64::from(tv_nsec) * 1e-9;
            heard.tallies[asked.screen].came(asked.index, seconds);
            heard.skew.came(asked.index, seconds);
        }
    }
}
