//! The producer thread. It encodes new stacks, nudges (shifts of a panel's picture) and viewer
//! directions into codes. It uploads the codes and puts them into the feed.

use std::sync::Arc;
use std::sync::mpsc::Receiver;

use lumistack_plugin::core::colour::srgb_code;
use lumistack_plugin::display::{ColourSequence, Display, LayerStack, Simulator};

use super::WindowError;
use super::gpu::{FrameSet, Gpu, Viewport};
use super::present_loop::SharedState;
use crate::presentation::{Content, Event};
use crate::{Picture, Shows, flat_codes};

/// Work for the producer.
pub(super) enum Work {
    Stack(LayerStack),
    Nudge(Shows, [f64; 2]),
    Save,
    ViewAngle([f64; 2]),
    /// The preview window changed its size.
    Resized([usize; 2]),
    /// A replaced frame set, which the producer frees.
    Retired(FrameSet),
}

/// The state of the thread that makes the frame sets.
pub(super) struct Producer {
    pub(super) display: Display,
    pub(super) content: Content,
    pub(super) viewports: Vec<Viewport>,
    pub(super) gpu: Arc<Gpu>,
    pub(super) shared: Arc<SharedState>,
    pub(super) work: Receiver<Work>,
    /// The encoders of all outputs. An encoder is made again if its panel's calibration changes.
    pub(super) pictures: Vec<Picture>,
    pub(super) number: u64,
}

impl Producer {
    /// Runs the producer until all senders of work are dropped.
    pub(super) fn run(mut self, emit: &(dyn Fn(Event) + Sync)) {
        if let Err(error) = self.make_frames() {
            emit(Event::Warning(error.to_string()));
        }
        while let Ok(first) = self.work.recv() {
            let mut changed = false;
            // Apply all pending work before frames are encoded, so that only the newest state is
            // encoded.
            for work in
                std::iter::once(first).chain(std::iter::from_fn(|| self.work.try_recv().ok())).collect::<Vec<_>>()
            {
                match self.apply(work, emit) {
                    Ok(change) => changed |= change,
                    Err(error) => emit(Event::Warning(error)),
                }
            }
            if changed && let Err(error) = self.make_frames() {
                emit(Event::Warning(error.to_string()));
            }
        }
    }

    /// Applies one item of work; returns true if the frames must be encoded again.
    fn apply(&mut self, work: Work, emit: &(dyn Fn(Event) + Sync)) -> Result<bool, String> {
        match work {
            Work::Stack(new) => {
                new.check(&self.display)
                    .map_err(|error| format!("the new layer stack does not match the display: {error}"))?;
                match &mut self.content {
                    Content::Stack(stack) | Content::Preview { stack, .. } => *stack = new,
                    Content::Pattern { .. } | Content::Flat { .. } => return Ok(false),
                }
                Ok(true)
            }
            Work::Nudge(shows, by) => {
                let Some(nudge) = nudge_of(&mut self.display, shows) else { return Ok(false) };
                // Round to thousandths of a pixel, since rounding errors of many small shifts
                // accumulate.
                *nudge = [0, 1].map(|axis| ((nudge[axis] + by[axis]) * 1000.0).round() / 1000.0);
                emit(Event::Nudged { panel: shows, nudge_px: *nudge });
                for (viewport, picture) in
                    self.viewports.iter().zip(&mut self.pictures).filter(|(viewport, _)| viewport.shows == shows)
                {
                    *picture = Picture::new(&self.display, shows, viewport.output.size);
                }
                Ok(true)
            }
            Work::Save => {
                emit(Event::Save { display: Box::new(self.display.clone()) });
                Ok(false)
            }
            Work::ViewAngle(from) => {
                let Content::Preview { from_deg, .. } = &mut self.content else { return Ok(false) };
                *from_deg = from;
                emit(Event::Looked { from_deg: from });
                Ok(true)
            }
            Work::Resized(size) => {
                self.viewports.iter_mut().for_each(|viewport| viewport.output.size = size);
                Ok(true)
            }
            Work::Retired(frame_set) => {
                drop(frame_set);
                Ok(false)
            }
        }
    }

    /// Encodes and uploads the frames of a period, and puts them into the feed.
    fn make_frames(&mut self) -> Result<(), WindowError> {
        let mut frame_set = FrameSet { pictures: Vec::new(), number: self.number };
        match &self.content {
            Content::Stack(stack) => {
                // Encode a picture for each frame of the stack. In a colour sequence encode one for
                // each frame and colour.
                let colours: Vec<Option<usize>> = match self.display.colour_sequence {
                    ColourSequence::Simultaneous => vec![None],
                    ColourSequence::Field => self.display.colour_order.0.map(Some).to_vec(),
                };
                for (frame, &colour) in (0..stack.frames()).flat_map(|frame| colours.iter().map(move |c| (frame, c))) {
                    let shown = self.pictures.iter().map(|picture| picture.codes(stack, frame, colour));
                    frame_set.pictures.push(self.load(shown));
                }
            }
            Content::Pattern { pattern, only, eye_mm } => {
                // Encode the test pattern for every panel. It is the only frame of its period.
                let codes = self
                    .viewports
                    .iter()
                    .map(|viewport| pattern.codes(&self.display, viewport.shows, viewport.output.size, *only, *eye_mm));
                let codes = codes.collect::<Result<Vec<_>, _>>()?;
                frame_set.pictures.push(self.load(codes));
            }
            Content::Flat { picture, layer } => {
                let codes = self.viewports.iter().map(|viewport| {
                    let shown = (viewport.shows == Shows::Layer(*layer)).then_some(picture);
                    flat_codes(&self.display, viewport.shows, viewport.output.size, shown)
                });
                frame_set.pictures.push(self.load(codes));
            }
            Content::Preview { stack, from_deg } => {
                // Simulate the view, and divide it by the stack's brightness, to which the viewer
                // is adapted.
                let slope = from_deg.map(|angle| angle.to_radians().tan());
                let preview = Simulator::new(&self.display, stack).from_slope(slope).radiance;
                let [rows, cols, _] = preview.shape();
                let gain = (1.0 / stack.brightness) as f32;
                let codes: Vec<u8> = preview.data().iter().map(|value| srgb_code(gain * value)).collect();
                let windows = self.viewports.iter().map(|viewport| fitted(&codes, [cols, rows], viewport.output.size));
                frame_set.pictures.push(self.load(windows));
            }
        }
        // Put the frame set into the feed. A previous set that was not taken is dropped on this
        // thread, not in the present loop.
        self.number += 1;
        self.shared.places.store(frame_set.pictures.len() as u64, std::sync::atomic::Ordering::Relaxed);
        drop(self.shared.feed.put(frame_set));
        Ok(())
    }

    fn load(&self, codes: impl IntoIterator<Item = Vec<u8>>) -> Vec<wgpu::BindGroup> {
        let viewports = self.viewports.iter().zip(codes);
        viewports.map(|(viewport, codes)| self.gpu.load(&codes, viewport.output.size, viewport.origin)).collect()
    }
}

/// Returns a mutable reference to the shift (nudge) of a panel. Adds a calibration to a panel that
/// has none.
fn nudge_of(display: &mut Display, shows: Shows) -> Option<&mut [f64; 2]> {
    let panel = match (shows, &mut display.backlight) {
        (Shows::Layer(n), _) => &mut display.layers.get_mut(n)?.panel,
        (Shows::Backlight, lumistack_plugin::display::Backlight::Lenslets(backlight)) => &mut backlight.panel,
        (Shows::Backlight, lumistack_plugin::display::Backlight::Uniform) => return None,
    };
    Some(&mut panel.get_or_insert_default().nudge_px)
}

/// Centres a picture `[row][col][rgb]` in a window. The picture is enlarged by the largest whole
/// factor with which it fits; if the window is smaller, it is reduced. Returns
/// `[row][col][red, green, blue, 255]`.
fn fitted(codes: &[u8], [cols, rows]: [usize; 2], [width, height]: [usize; 2]) -> Vec<u8> {
    let fit = (width as f64 / cols as f64).min(height as f64 / rows as f64);
    let scale = if fit >= 1.0 { fit.floor() } else { fit };
    let (left, top) = ((width as f64 - scale * cols as f64) / 2.0, (height as f64 - scale * rows as f64) / 2.0);
    let mut window = Vec::with_capacity(4 * width * height);
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let (col, row) = ((x as f64 + 0.5 - left.floor()) / scale, (y as f64 + 0.5 - top.floor()) / scale);
        let inside = col >= 0.0 && row >= 0.0 && col < cols as f64 && row < rows as f64;
        let rgb = if inside { &codes[3 * (row as usize * cols + col as usize)..][..3] } else { &[0, 0, 0] };
        window.extend_from_slice(&[rgb[0], rgb[1], rgb[2], 255]);
    }
    window
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_stands_in_the_middle_of_its_window() {
        let codes: Vec<u8> = (0..6).flat_map(|i| [i, i, i]).collect();
        let shown: Vec<u8> = fitted(&codes, [3, 2], [8, 5]).chunks_exact(4).map(|rgba| rgba[0]).collect();
        let rows = [
            [0, 0, 0, 1, 1, 2, 2, 0],
            [0, 0, 0, 1, 1, 2, 2, 0],
            [0, 3, 3, 4, 4, 5, 5, 0],
            [0, 3, 3, 4, 4, 5, 5, 0],
            [0; 8],
        ];
        assert_eq!(shown, rows.concat());
        assert_eq!(fitted(&codes, [3, 2], [2, 2]).len(), 16);
    }
}
