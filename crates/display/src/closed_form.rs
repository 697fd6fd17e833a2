//! The paper's closed forms of the bound on depth of field, eqs. (23) to (26), with their
//! assumptions about a display.
//!
//! Directions are slopes (the paper's d_r is 1). A layer of pitch p has the highest frequency ω0 =
//! 1/(2p), and neighbouring layers are Δd apart. Lenslets have pitch Δx. The A angular bins of a
//! lenslet together span the angle α; each bin has the width Δs = (2/A) tan(α/2) in slope. The
//! depth is z.
//!
//! ```text
//! (23) lens array               1/(2Δx)          if |z| ≤ Δx/Δs,                  else 1/(2|z|Δs)
//! (24) two layers                ω0 · 2Δd/(Δd + 2|z|)
//! (25) three layers             ω0 · 3Δd/(Δd + |z|)   if |z| ≤ 2Δd,   else ω0 · 2Δd/|z|
//! (26) a layer on a lens array   1/(2Δx) + ω0     if |z| ≤ Δx/(Δs + 2ΔxΔsω0),      else 1/(2|z|Δs)
//! ```
//!
//! [`Display::spatial_cutoff`] is the general form and needs none of the assumptions. If the
//! assumptions hold, the two forms agree.

use crate::{Backlight, Display};

/// A closed form of the bound on depth of field, for one axis of a display.
#[derive(Clone, Debug, PartialEq)]
pub struct ClosedForm {
    /// Number of the equation in the paper, 23 to 26.
    pub equation: u32,
    /// Assumptions of the equation, as text for the user.
    pub assumes: &'static str,
    /// The assumptions that the display violates; empty if the closed form is exact.
    pub broken: Vec<String>,
    form: Form,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Lenses { lenslet_mm: f64, step: f64 },
    Two { gap_mm: f64, own: f64 },
    Three { gap_mm: f64, own: f64 },
    LayerOnLenses { lenslet_mm: f64, step: f64, own: f64 },
}

/// Relative difference up to which two numbers are taken as equal, since files round numbers.
const ROUNDING: f64 = 1e-9;

impl Display {
    /// Returns the closed form for this display's kind of layers and backlight, along one axis (0:
    /// x, 1: y). Returns `None` if the paper has no form for this kind.
    pub fn closed_form(&self, axis: usize) -> Option<ClosedForm> {
        // Check the assumption that the forms share: one pitch. A display that violates an
        // assumption still has a form.
        let own = self.layers.iter().map(|layer| 0.5 / layer.pitch_mm).fold(f64::INFINITY, f64::min);
        let mut broken = Vec::new();
        if self.layers.iter().any(|layer| 0.5 / layer.pitch_mm > own * (1.0 + ROUNDING)) {
            broken.push("the layers' pitches differ (the closed form takes the coarsest pitch)".to_string());
        }
        let d_mm: Vec<f64> = self.layers.iter().map(|layer| layer.d_mm).collect();
        let (first, last) = (*d_mm.first()?, *d_mm.last()?);
        let scale = (last - first).abs().max(1e-9);
        let centred = |broken: &mut Vec<String>| {
            if (first + last).abs() > ROUNDING * scale {
                broken.push(format!("the middle of the stack is at z = {} mm", 0.5 * (first + last)));
            }
        };
        // select the form by the number of layers and the backlight
        let (equation, assumes, form) = match (d_mm.len(), &self.backlight) {
            (2, Backlight::Uniform) => {
                centred(&mut broken);
                let form = Form::Two { gap_mm: last - first, own };
                (24, "two layers of one pitch at −Δd/2 and Δd/2", form)
            }
            (3, Backlight::Uniform) => {
                centred(&mut broken);
                let (rear, front) = (d_mm[1] - first, last - d_mm[1]);
                if (rear - front).abs() > ROUNDING * scale {
                    broken.push(format!(
                        "the gaps are {rear} and {front} mm (the closed form takes the mean of the gaps)"
                    ));
                }
                let form = Form::Three { gap_mm: 0.5 * (last - first), own };
                (25, "three layers of one pitch at −Δd, 0 and Δd", form)
            }
            (1, Backlight::Lenslets(_)) => {
                if first != 0.0 {
                    broken.push(format!("the layer is at z = {first} mm, not at z = 0"));
                }
                let Form::Lenses { lenslet_mm, step } = self.lenses(axis, &mut broken)? else { return None };
                let form = Form::LayerOnLenses { lenslet_mm, step, own };
                (26, "a layer at z = 0 and the lens array in the same plane", form)
            }
            _ => return None,
        };
        Some(ClosedForm { equation, assumes, broken, form })
    }

    /// Returns equation (23) for the display's lens array alone, as if its layers were clear.
    /// `None` without a lens array.
    pub fn lens_array_form(&self, axis: usize) -> Option<ClosedForm> {
        let mut broken = Vec::new();
        let form = self.lenses(axis, &mut broken)?;
        Some(ClosedForm {
            equation: 23,
            assumes: "a display that has only a lens array or barrier at z = 0",
            broken,
            form,
        })
    }

    fn lenses(&self, axis: usize, broken: &mut Vec<String>) -> Option<Form> {
        let Backlight::Lenslets(backlight) = &self.backlight else { return None };
        if backlight.d_mm != 0.0 {
            broken.push(format!("the lens array is at z = {} mm, not at z = 0", backlight.d_mm));
        }
        let step = 2.0 / backlight.views[axis] as f64 * (0.5 * backlight.fov_deg[axis].to_radians()).tan();
        Some(Form::Lenses { lenslet_mm: backlight.pitch_mm, step })
    }
}

impl ClosedForm {
    /// Returns the closed form's cutoff frequency ω at depth `z_mm`, in cycles per millimetre.
    pub fn cutoff(&self, z_mm: f64) -> f64 {
        let far = z_mm.abs();
        let angular = |step: f64| 0.5 / (far * step);
        match self.form {
            Form::Lenses { lenslet_mm, step } if far * step <= lenslet_mm => 0.5 / lenslet_mm,
            Form::Lenses { step, .. } => angular(step),
            Form::Two { gap_mm, own } => own * 2.0 * gap_mm / (gap_mm + 2.0 * far),
            Form::Three { gap_mm, own } if far <= 2.0 * gap_mm => own * 3.0 * gap_mm / (gap_mm + far),
            Form::Three { gap_mm, own } => own * 2.0 * gap_mm / far,
            Form::LayerOnLenses { lenslet_mm, step, own } => {
                if far * step * (1.0 + 2.0 * lenslet_mm * own) <= lenslet_mm {
                    0.5 / lenslet_mm + own
                } else {
                    angular(step)
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;

    use super::*;
    use crate::LensletBacklight;

    /// Largest allowed relative difference between [`Display::spatial_cutoff_along`] and a closed
    /// form.
    const AGREEMENT: f64 = 1e-6;

    /// Returns a random display that satisfies all assumptions of equation `kind`, 23 to 26.
    fn random(kind: u32, stream: &mut Stream) -> Display {
        let mut number = |low: f64, high: f64| low + (high - low) * f64::from(stream.next_f32());
        let (pitch, gap) = (number(0.05, 2.0), number(1.0, 80.0));
        let d_mm: Vec<f64> = match kind {
            24 => vec![-0.5 * gap, 0.5 * gap],
            25 => vec![-gap, 0.0, gap],
            _ => vec![0.0],
        };
        let mut display = Display::uniform([16, 10], pitch, [5, 5], [20.0, 20.0], &d_mm, 1);
        if kind == 23 || kind == 26 {
            let views = [number(2.0, 12.0) as usize, number(2.0, 12.0) as usize];
            let fov = [number(5.0, 80.0), number(5.0, 80.0)];
            let lenses = LensletBacklight::new(0.0, [9, 9], pitch * number(1.0, 20.0), views, fov);
            display.backlight = Backlight::Lenslets(lenses);
        }
        if kind == 23 {
            display.layers.clear();
        }
        display
    }

    #[test]
    fn the_general_form_equals_the_papers_on_random_displays() {
        let mut stream = Stream::new(23);
        for (kind, _) in [23, 24, 25, 26].into_iter().flat_map(|kind| (0..1000).map(move |i| (kind, i))) {
            let display = random(kind, &mut stream);
            for axis in [0, 1] {
                let form = if kind == 23 { display.lens_array_form(axis) } else { display.closed_form(axis) };
                let form = form.unwrap();
                assert_eq!((form.equation, form.broken.len()), (kind, 0), "{form:?}");
                for _ in 0..5 {
                    let z = 400.0 * f64::from(stream.next_f32()) - 200.0;
                    let (general, closed) = (display.spatial_cutoff_along(axis, z), form.cutoff(z));
                    assert!((general / closed - 1.0).abs() < AGREEMENT, "({kind}) at {z}: {general}, {closed}");
                }
            }
        }
    }

    #[test]
    fn what_a_display_breaks_is_named() {
        let display = Display::uniform([16, 10], 0.5, [5, 5], [20.0, 20.0], &[-10.0, 0.0, 30.0], 1);
        let form = display.closed_form(0).unwrap();
        assert_eq!((form.equation, form.broken.len()), (25, 2), "{:?}", form.broken);
        let mut directional = Display::uniform([16, 10], 0.5, [5, 5], [20.0, 20.0], &[0.0], 1);
        assert_eq!(directional.closed_form(0), None, "the paper has no equation for one layer alone");
        directional.backlight = Backlight::Lenslets(LensletBacklight::new(-8.5, [9, 9], 2.5, [5, 5], [48.0, 48.0]));
        let form = directional.closed_form(1).unwrap();
        assert_eq!(form.broken, ["the lens array is at z = -8.5 mm, not at z = 0"]);
        assert_eq!(directional.lens_array_form(1).unwrap().equation, 23);
        let four = Display::uniform([16, 10], 0.5, [5, 5], [20.0, 20.0], &[-3.0, -1.0, 1.0, 3.0], 1);
        assert_eq!(four.closed_form(0), None);
    }

    /// The prototype's lenslets are 8.5 mm behind the layer. Equation (26) assumes no gap. So the
    /// general bound is some 60 % above (26) at a depth of 100 mm, and agrees with (26) within 20 %
    /// in the display plane.
    #[test]
    fn a_gap_before_the_lenses_raises_the_bound() {
        let mut display = Display::uniform([840, 525], 0.5655, [5, 5], [48.0, 48.0], &[0.0], 12);
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-8.5, [187, 117], 2.54, [5, 5], [48.0, 48.0]));
        let form = display.closed_form(0).unwrap();
        let excess = display.spatial_cutoff_along(0, 100.0) / form.cutoff(100.0) - 1.0;
        assert!((0.55..0.65).contains(&excess), "{excess}");
        assert!((display.spatial_cutoff_along(0, 0.0) / form.cutoff(0.0) - 1.0).abs() < 0.2);
    }
}
