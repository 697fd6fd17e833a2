//! Exposure and tone curve. They map scene-linear radiance to display-referred radiance, alike for
//! every ray of every view.
//!
//! ```text
//! L = curve(exposure · radiance)        0..1, linear light
//! ```
//!
//! Exposure and curve are chosen once, from all views together. If each view chose its own, a scene
//! point would change in brightness from view to view, which no diffuse surface does.

use lumistack_core::metrics::percentile;
use lumistack_core::tone::ToneCurve;
use lumistack_display::LightField;
use lumistack_scene::Scene;
#[cfg(feature = "parallel")]
use rayon::prelude::*;

use crate::job::{LightJob, Tone};

/// The brightest hundredth of the surfaces is exposed to this value or above it.
const WHITE: f32 = 0.95;
/// If a few lamps would leave most surfaces dark, half of the surfaces are shown above this value.
const MIDDLE: f32 = 0.22;
/// If more than this fraction of rays is brighter than white, `auto` compresses highlights instead
/// of clipping them.
const HIGHLIGHTS: f64 = 2e-3;
/// The sky is measured too if surfaces fill less than this fraction of the views.
const LEAST_SURFACE: f64 = 0.05;

/// An exposure and a tone curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneMapping {
    /// Factor on scene-linear radiance.
    pub exposure: f64,
    /// Curve from exposed radiance to shown values, 0..1.
    pub curve: ToneCurve,
}

impl ToneMapping {
    /// Leaves radiance in 0..1 unchanged, and clips greater values to 1.
    pub const NONE: Self = Self { exposure: 1.0, curve: ToneCurve::Linear };

    /// Chooses exposure and tone curve of a light field. `brightest` holds the brightest channel of
    /// rays from all views, and whether each ray hits a surface.
    pub fn choose(job: &LightJob, scene: &Scene, brightest: &[(f32, bool)]) -> Self {
        let stops = 2f64.powf(job.exposure_ev);
        let exposure = |curve| {
            if !job.automatic_exposure || is_display_referred(scene) {
                stops
            } else {
                stops * exposure_of(brightest, scene.backdrop.is_some(), curve)
            }
        };
        let fixed = |curve| Self { exposure: exposure(curve), curve };
        match job.tone {
            Tone::Linear => fixed(ToneCurve::Linear),
            Tone::KhronosNeutral => fixed(ToneCurve::KhronosNeutral),
            Tone::Agx => fixed(ToneCurve::Agx),
            Tone::Auto => {
                let linear = fixed(ToneCurve::Linear);
                if !scene.placed_clouds.is_empty() {
                    // a capture was already exposed by its camera, so it gets no other curve
                    return linear;
                }
                let clipped = brightest.iter().filter(|(value, _)| f64::from(*value) * linear.exposure > 1.0).count();
                if clipped as f64 > HIGHLIGHTS * brightest.len() as f64 {
                    fixed(ToneCurve::KhronosNeutral)
                } else {
                    linear
                }
            }
        }
    }

    /// Returns the exposure and tone curve that the job sets for a given light field. `None` if the
    /// job sets neither, so the light field stays unchanged.
    pub fn of_given(job: &LightJob) -> Option<Self> {
        let curve = match job.tone {
            Tone::Auto if job.exposure_ev == 0.0 => return None,
            // `auto` sets no curve here, so values above 1 are clipped, as by `linear`
            Tone::Auto | Tone::Linear => ToneCurve::Linear,
            Tone::KhronosNeutral => ToneCurve::KhronosNeutral,
            Tone::Agx => ToneCurve::Agx,
        };
        Some(Self { exposure: 2f64.powf(job.exposure_ev), curve })
    }

    /// Converts a light field of scene-linear radiance to display-referred radiance.
    pub fn apply(self, field: &mut LightField) {
        self.apply_to(field.radiance_mut().data_mut());
    }

    /// Applies exposure and curve to pixels `[..][rgb]` in place.
    pub fn apply_to(self, rgb: &mut [f32]) {
        let exposure = self.exposure as f32;
        let apply = |pixels: &mut [f32]| {
            for rgb in pixels.chunks_exact_mut(3) {
                let shown = self.curve.apply([0, 1, 2].map(|c| rgb[c] * exposure));
                rgb.copy_from_slice(&shown);
            }
        };
        // each pixel is computed alone, so the number of threads does not change the result
        #[cfg(feature = "parallel")]
        rgb.par_chunks_mut(3 * 4096).for_each(apply);
        #[cfg(not(feature = "parallel"))]
        apply(rgb);
    }
}

/// Chooses exposure and tone curve with the default settings of a job. `brightest` is as in
/// [`ToneMapping::choose`].
pub fn automatic_tone_mapping(scene: &Scene, brightest: &[(f32, bool)]) -> (f64, ToneCurve) {
    let ToneMapping { exposure, curve } = ToneMapping::choose(&LightJob::default(), scene, brightest);
    (exposure, curve)
}

/// Returns true if radiance is display-referred already: every surface is unlit and shows its base
/// colour, or splats bring their own light.
fn is_display_referred(scene: &Scene) -> bool {
    if !scene.placed_clouds.is_empty() {
        return true;
    }
    let material = |mesh: usize| &scene.materials[scene.meshes[mesh].material];
    !scene.instances.is_empty() && scene.instances.iter().all(|instance| material(instance.mesh).unlit)
}

/// Computes the factor that exposes the brightest hundredth of the surfaces to [`WHITE`] or more,
/// before the tone curve.
///
/// If most surfaces would stay dark, the factor is raised until half of them are shown above
/// [`MIDDLE`], or a twentieth above [`WHITE`]. Percentiles ignore single bright samples. Rays that
/// miss all surfaces are used only if surfaces fill too little of the views. In front of the studio
/// light's ground (`on_ground`) such rays are used only if there are no surfaces.
fn exposure_of(brightest: &[(f32, bool)], on_ground: bool, curve: ToneCurve) -> f64 {
    let surfaces = brightest.iter().filter(|(_, surface)| *surface).count();
    let least = if on_ground { f64::MIN_POSITIVE } else { LEAST_SURFACE * brightest.len() as f64 };
    let of_surfaces = surfaces as f64 >= least;
    let chosen = brightest.iter().filter(|(_, surface)| *surface || !of_surfaces);
    let mut values: Vec<f32> = chosen.map(|(value, _)| *value).filter(|value| value.is_finite()).collect();
    let [p50, p95, p99] = [0.50, 0.95, 0.99].map(|share| f64::from(percentile(&mut values, share)));
    let to = |value: f64, level: f32| if value > 0.0 { f64::from(level) / value } else { 0.0 };
    // these exposed radiances are shown as WHITE and as MIDDLE
    let (white, middle) = (curve.grey_shown_as(WHITE), curve.grey_shown_as(MIDDLE));
    let factor = to(p99, WHITE).max(to(p50, middle).min(to(p95, white)));
    if factor.is_finite() && factor > 0.0 { factor } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_core::{Cancel, Collector, Task};
    use lumistack_display::{FieldGeometry, Projection, ViewGrid};
    use lumistack_scene::{Instance, Material, Mesh, SceneParts};

    fn surfaces(values: &[f32]) -> Vec<(f32, bool)> {
        values.iter().map(|value| (*value, true)).collect()
    }

    fn scene(unlit: bool) -> Scene {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let parts = SceneParts {
            meshes: vec![Mesh {
                positions: vec![glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, scene_from_mesh: glam::Affine3A::IDENTITY }],
            materials: vec![Material { unlit, ..Material::default() }],
            ..SceneParts::default()
        };
        parts.validate(Task::quiet(&warnings, &cancel)).unwrap()
    }

    #[test]
    fn exposure_brings_the_brightest_percent_to_white() {
        let values: Vec<f32> = (0..10_000).map(|i| i as f32 / 100.0).collect();
        let factor = exposure_of(&surfaces(&values), false, ToneCurve::Linear);
        assert!((factor * 99.0 - 0.95).abs() < 0.01, "{factor}");
    }

    #[test]
    fn a_lamp_in_the_picture_does_not_darken_the_rest() {
        let mut values = vec![0.5f32; 9_700];
        values.extend([100.0; 300]);
        for (_, curve) in ToneCurve::ALL {
            let shown = curve.apply([(exposure_of(&surfaces(&values), false, curve) * 0.5) as f32; 3]);
            assert!((shown[1] - 0.22).abs() < 0.01, "{curve:?}: {shown:?}");
        }
    }

    #[test]
    fn neither_fireflies_nor_a_bright_sky_change_the_exposure() {
        let values: Vec<f32> = (0..10_000).map(|i| i as f32 / 10_000.0).collect();
        let plain = exposure_of(&surfaces(&values), false, ToneCurve::Linear);
        let mut with = surfaces(&values);
        with.extend([(1e6, true); 3]);
        assert!((exposure_of(&with, false, ToneCurve::Linear) / plain - 1.0).abs() < 2e-3);
        with.extend(vec![(50.0, false); 40_000]);
        assert!((exposure_of(&with, false, ToneCurve::Linear) / plain - 1.0).abs() < 2e-3);
        // Surfaces that fill a tiny fraction of the views do not decide the exposure, since the sky
        // is measured too. In front of the studio's ground they decide it.
        let mut speck = surfaces(&[0.01; 10]);
        speck.extend(vec![(2.0, false); 10_000]);
        assert!((exposure_of(&speck, false, ToneCurve::Linear) * 2.0 - 0.95).abs() < 1e-3);
        assert!((exposure_of(&speck, true, ToneCurve::Linear) * 0.01 - 0.95).abs() < 1e-3);
    }

    #[test]
    fn black_pictures_get_a_finite_factor() {
        for (_, curve) in ToneCurve::ALL {
            for values in [vec![0.0; 10], Vec::new(), vec![f32::NAN; 3], vec![f32::INFINITY]] {
                assert_eq!(exposure_of(&surfaces(&values), false, curve), 1.0);
            }
        }
    }

    #[test]
    fn highlights_are_compressed_and_everything_else_is_left_alone() {
        let job = LightJob::default();
        let mut values = vec![0.3f32; 10_000];
        let plain = ToneMapping::choose(&job, &scene(false), &surfaces(&values));
        assert_eq!(plain.curve, ToneCurve::Linear);
        values[..60].fill(40.0);
        let highlights = ToneMapping::choose(&job, &scene(false), &surfaces(&values));
        assert_eq!(highlights.curve, ToneCurve::KhronosNeutral);
        let fixed = LightJob { automatic_exposure: false, exposure_ev: -1.0, tone: Tone::Agx, ..LightJob::default() };
        let tone_mapping = ToneMapping::choose(&fixed, &scene(false), &surfaces(&values));
        assert_eq!(tone_mapping, ToneMapping { exposure: 0.5, curve: ToneCurve::Agx });
    }

    #[test]
    fn unlit_surfaces_keep_their_colours() {
        let dark = surfaces(&[0.1; 1000]);
        let tone_mapping = ToneMapping::choose(&LightJob::default(), &scene(true), &dark);
        assert_eq!(tone_mapping, ToneMapping { exposure: 1.0, curve: ToneCurve::Linear });
        assert!(ToneMapping::choose(&LightJob::default(), &scene(false), &dark).exposure > 2.0);
    }

    /// A diffuse point must look alike in every view, independent of the pixels around it.
    #[test]
    fn equal_radiance_looks_the_same_in_every_view() {
        let grid = ViewGrid::uniform(Projection::Oblique, [4, 1], [20.0, 1.0]).unwrap();
        let geometry = FieldGeometry { rows: 5, cols: 7, pitch_mm: 1.0, grid };
        for (_, curve) in ToneCurve::ALL {
            let mut field = LightField::black(geometry.clone()).unwrap();
            for (number, view) in geometry.grid.iter().enumerate() {
                // the pixels around the point differ in brightness from view to view
                field.view_mut(view).fill(4f32.powi(number as i32));
                field.view_mut(view)[3 * 10..][..3].copy_from_slice(&[0.7, 0.3, 0.1]);
            }
            ToneMapping { exposure: 1.7, curve }.apply(&mut field);
            let point = |view: [usize; 2]| field.view(view)[3 * 10..][..3].to_vec();
            assert!(geometry.grid.iter().all(|view| point(view) == point([0, 0])), "{curve:?}");
            assert_eq!(point([0, 0]), curve.apply([0.7, 0.3, 0.1].map(|v: f32| v * 1.7)).to_vec());
        }
    }
}
