//! Makes a display from the parts of a built device: equal panels, the gaps between them, and an
//! optional lens array.

use crate::{Backlight, Display, DisplayError, Lens, LensletBacklight, Panel, Transfer};

/// The data of a display that is built of equal panels, one behind another.
#[derive(Clone, Debug, PartialEq)]
pub struct PanelStack {
    /// Name, as shown to the user.
    pub name: String,
    /// Gaps between neighbouring layers, rear to front, millimetres. N layers have N − 1 gaps.
    pub gaps_mm: Vec<f64>,
    /// [columns, rows] of a panel.
    pub panel_resolution: [usize; 2],
    /// Pixel pitch of a panel, millimetres.
    pub panel_pitch_mm: f64,
    /// Number of panel pixels per pixel of the masks and of the light field, per axis; at least 1.
    pub panel_pixels: usize,
    /// Names of the outputs that drive the panels, rear to front, the panel of a directional
    /// backlight included. If the list is empty, panels take the outputs from left to right.
    pub outputs: Vec<String>,
    /// [horizontal, vertical] views of the light field.
    pub views: [usize; 2],
    /// [horizontal, vertical] full angles of view, degrees.
    pub fov_deg: [f64; 2],
    /// Number of time-multiplexed frames M.
    pub frames: usize,
    /// Refresh rate of the panels, hertz.
    pub refresh_hz: f64,
    /// Brightness scale β.
    pub brightness: f64,
    /// Transfer function of a panel, from transmittance to code values.
    pub transfer: Transfer,
    /// Transmittance of black, relative to white.
    pub black_level: f64,
    /// A lens array in front of an additional panel, which is the rearmost one. `None` for a
    /// uniform backlight.
    pub lenses: Option<LensArray>,
}

/// Lenslets in front of a panel; together they form a directional backlight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensArray {
    /// Distance between the axes of neighbouring lenslets, millimetres.
    pub pitch_mm: f64,
    /// Focal length in air, millimetres.
    pub focal_mm: f64,
    /// Distance to the layer in front of the lenslets, millimetres.
    pub gap_mm: f64,
}

impl LensArray {
    /// Returns the full angle into which a lenslet emits light, degrees: 2 atan(p / 2f) for lens
    /// pitch p and focal length f.
    pub fn fov_deg(&self) -> f64 {
        2.0 * (0.5 * self.pitch_mm / self.focal_mm).atan().to_degrees()
    }
}

impl PanelStack {
    /// Returns the largest number of frames with which a display does not flicker at the refresh
    /// rate `refresh_hz`; at least 1.
    pub fn steady_frames(refresh_hz: f64) -> usize {
        whole(refresh_hz / Display::FLICKER_HZ).max(1)
    }

    /// Makes the display. The plane of zero parallax is the middle layer or, for an even number of
    /// layers, the middle between the rearmost and the frontmost layer.
    ///
    /// # Errors
    /// If a value is invalid.
    pub fn display(&self) -> Result<Display, DisplayError> {
        let &Self { panel_resolution: resolution, panel_pitch_mm: pitch_mm, panel_pixels: scale, .. } = self;
        // Place the middle of the stack at z = 0. If the number of layers is odd, move the middle
        // layer there.
        let depth_mm: f64 = self.gaps_mm.iter().sum();
        let mut d_mm = vec![-depth_mm / 2.0];
        self.gaps_mm.iter().for_each(|gap| d_mm.push(d_mm[d_mm.len() - 1] + gap));
        if d_mm.len() % 2 == 1 {
            let middle = d_mm[d_mm.len() / 2];
            d_mm.iter_mut().for_each(|d| *d -= middle);
        }
        // make layers with one mask pixel for every `scale` × `scale` panel pixels
        let mask = resolution.map(|count| (count / scale).max(1));
        let plain = Display::uniform(mask, pitch_mm * scale as f64, self.views, self.fov_deg, &d_mm, self.frames);
        let (refresh_hz, brightness) = (self.refresh_hz, self.brightness);
        let mut display = Display { name: self.name.clone(), refresh_hz, brightness, ..plain };
        // Assign outputs from rear to front. The panel of a directional backlight is the rearmost
        // one.
        let mut names = self.outputs.iter().cloned().map(Some).chain(std::iter::repeat(None));
        let mut panel = || Some(Panel { output: names.next().flatten(), ..Panel::default() });
        if let Some(lenses) = &self.lenses {
            let count = resolution.map(|count| whole(count as f64 * pitch_mm / lenses.pitch_mm).max(1));
            let (z_mm, fov_deg) = (d_mm[0] - lenses.gap_mm, [lenses.fov_deg(); 2]);
            let mut backlight = LensletBacklight::new(z_mm, count, lenses.pitch_mm, self.views, fov_deg);
            (backlight.transfer, backlight.black_level) = (self.transfer.clone(), self.black_level);
            (backlight.panel_resolution, backlight.panel_pitch_mm) = (Some(resolution), Some(pitch_mm));
            backlight.panel = panel();
            backlight.lens = Some(Lens { focal_mm: Some(lenses.focal_mm), ..Lens::default() });
            display.backlight = Backlight::Lenslets(backlight);
        }
        for layer in &mut display.layers {
            (layer.transfer, layer.black_level) = (self.transfer.clone(), self.black_level);
            (layer.panel_resolution, layer.panel_pitch_mm) = (Some(resolution), Some(pitch_mm));
            layer.panel = panel();
        }
        display.check()?;
        Ok(display)
    }
}

/// Returns the largest whole number that is at most `quotient`. A quotient that misses a whole
/// number only by rounding counts as this number.
fn whole(quotient: f64) -> usize {
    /// Tolerance of the quotient, since its terms are decimal numbers of a file.
    const ROUNDING: f64 = 1e-6;
    (quotient + ROUNDING).floor() as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn three() -> PanelStack {
        PanelStack {
            name: "three".into(),
            gaps_mm: vec![10.0, 30.0],
            panel_resolution: [1680, 1050],
            panel_pitch_mm: 0.25,
            panel_pixels: 2,
            outputs: ["a", "b", "c"].map(String::from).into(),
            views: [5, 5],
            fov_deg: [20.0, 20.0],
            frames: 2,
            refresh_hz: 120.0,
            brightness: 0.2,
            transfer: Transfer::Srgb,
            black_level: 0.001,
            lenses: None,
        }
    }

    #[test]
    fn the_middle_layer_is_the_plane_of_the_display() {
        let display = three().display().unwrap();
        assert_eq!(display.layers.iter().map(|layer| layer.d_mm).collect::<Vec<_>>(), [-10.0, 0.0, 30.0]);
        let layer = &display.layers[2];
        assert_eq!((layer.resolution, layer.pitch_mm, layer.black_level), ([840, 525], 0.5, 0.001));
        assert_eq!(layer.panel.as_ref().unwrap().output.as_deref(), Some("c"));
        let two = PanelStack { gaps_mm: vec![40.0], outputs: Vec::new(), ..three() }.display().unwrap();
        assert_eq!(two.layers.iter().map(|layer| layer.d_mm).collect::<Vec<_>>(), [-20.0, 20.0]);
        assert_eq!((PanelStack::steady_frames(120.0), PanelStack::steady_frames(50.0)), (2, 1));
    }

    #[test]
    fn lenses_stand_behind_the_layers_on_a_panel_of_their_own() {
        let lenses = Some(LensArray { pitch_mm: 2.0, focal_mm: 5.0, gap_mm: 7.0 });
        let outputs = ["back", "front"].map(String::from).into();
        let display = PanelStack { gaps_mm: Vec::new(), outputs, lenses, ..three() }.display().unwrap();
        let Backlight::Lenslets(backlight) = &display.backlight else { panic!("{:?}", display.backlight) };
        assert_eq!(backlight.lenslets, [210, 131]);
        assert!((backlight.fov_deg[0] - 2.0 * 0.2f64.atan().to_degrees()).abs() < 1e-12);
        // 1920 · 0.29/0.1 is 5567.999999999999 in floating point
        let lenses = Some(LensArray { pitch_mm: 0.1, focal_mm: 5.0, gap_mm: 7.0 });
        let exact = PanelStack { panel_resolution: [1920, 1080], panel_pitch_mm: 0.29, lenses, ..three() };
        let Backlight::Lenslets(exact) = exact.display().unwrap().backlight else { panic!("no lenslets") };
        assert_eq!(exact.lenslets, [5568, 3132]);
        let output = |panel: &Option<Panel>| panel.as_ref().unwrap().output.clone().unwrap();
        assert_eq!((output(&backlight.panel), output(&display.layers[0].panel)), ("back".into(), "front".into()));
        assert!(PanelStack { brightness: 2.0, ..three() }.display().is_err());
    }
}
