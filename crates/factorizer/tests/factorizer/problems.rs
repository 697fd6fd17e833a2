//! Random small problems of every kind.

use lumistack_core::Tensor;
use lumistack_core::seed::{Stream, derive};
use lumistack_display::{
    Backlight, Display, Formation, LayerColour, LensletBacklight, LightField, Missing, OutsideBins, ProjectionKind,
    Sampling, Weights,
};

use lumistack_factorizer::Problem;

/// The property by which a random problem differs from a plain one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Plain,
    OnePixel,
    OneView,
    OneFrame,
    OneLayer,
    EightLayers,
    ManyFrames,
    Wide,
    WideBilinear,
    CoarseLayers,
    LensletsDark,
    LensletsRepeat,
    ViewWeights,
    RayWeights,
    Bilinear,
    Perspective,
    Clear,
    MixedLayers,
    /// A black level and a peak transmittance per layer.
    Floors,
    /// Blur, crosstalk, tied channels, colour filters.
    Responses,
    Additive,
    Polarization,
    /// Everything is random: sampling, projection, the rule for missed layers, layers, backlight
    /// and weights.
    Anything,
}

impl Kind {
    pub(crate) const ALL: [Self; 23] = [
        Self::Plain,
        Self::OnePixel,
        Self::OneView,
        Self::OneFrame,
        Self::OneLayer,
        Self::EightLayers,
        Self::ManyFrames,
        Self::Wide,
        Self::WideBilinear,
        Self::CoarseLayers,
        Self::LensletsDark,
        Self::LensletsRepeat,
        Self::ViewWeights,
        Self::RayWeights,
        Self::Bilinear,
        Self::Perspective,
        Self::Clear,
        Self::MixedLayers,
        Self::Floors,
        Self::Responses,
        Self::Additive,
        Self::Polarization,
        Self::Anything,
    ];
}

/// A problem that owns its parts.
pub(crate) struct Owned {
    pub(crate) display: Display,
    pub(crate) target: LightField,
    pub(crate) weights: Weights,
}

impl Owned {
    pub(crate) fn problem(&self) -> Problem<'_> {
        Problem { display: &self.display, target: &self.target, weights: &self.weights }
    }

    /// Returns a problem with a constant target on this display.
    pub(crate) fn constant(display: Display, value: f32) -> Self {
        let mut target = LightField::black(display.geometry().unwrap()).unwrap();
        target.radiance_mut().data_mut().fill(value);
        Self { display, target, weights: Weights::Uniform }
    }
}

/// Returns a display whose layers have the pixels and the pitch of the light field.
pub(crate) fn display(resolution: [usize; 2], views: [usize; 2], d_mm: &[f64], frames: usize) -> Display {
    Display {
        name: "random".into(),
        refresh_hz: 120.0,
        brightness: 0.4,
        ..Display::uniform(resolution, 1.0, views, [20.0, 16.0], d_mm, frames)
    }
}

/// Returns a random problem; equal arguments give equal problems.
pub(crate) fn random(kind: Kind, seed: u64) -> Owned {
    let mut random = Stream::new(derive(seed, &[kind as u64]));
    let mut below = |n: usize| (random.next_u64() % n as u64) as usize;
    let any = kind == Kind::Anything;
    // choose the resolution, and the numbers of views, frames and layers
    let resolution = match kind {
        Kind::OnePixel => [1, 1],
        Kind::Wide | Kind::WideBilinear => [70 + below(30), 3],
        Kind::CoarseLayers => [16, 12],
        _ => [5 + below(9), 4 + below(7)],
    };
    let views = if kind == Kind::OneView { [1, 1] } else { [1 + below(4), 1 + below(3)] };
    let frames = match kind {
        Kind::OneFrame => 1,
        Kind::ManyFrames => 9 + below(5),
        Kind::Wide => 1 + below(8),
        _ => 2 + below(4),
    };
    let layers = match kind {
        Kind::OneLayer => 1,
        Kind::EightLayers => 8,
        _ => 1 + below(4),
    };
    // choose the properties that the kind fixes or leaves to chance
    let formed = matches!(kind, Kind::Additive | Kind::Polarization);
    let lenslets = matches!(kind, Kind::LensletsDark | Kind::LensletsRepeat) || (any || formed) && below(2) == 0;
    let responses = kind == Kind::Responses;
    let bilinear = matches!(kind, Kind::Bilinear | Kind::WideBilinear) || (any || responses || formed) && below(2) == 0;
    let perspective = kind == Kind::Perspective || any && below(2) == 0;
    let clear = kind == Kind::Clear || (any || formed) && below(2) == 0;
    let mixed = kind == Kind::MixedLayers || any && below(2) == 0;
    let repeat = kind == Kind::LensletsRepeat || any && below(2) == 0;
    let weights = match kind {
        Kind::ViewWeights => 1,
        Kind::RayWeights => 2,
        Kind::Anything => below(3),
        _ => 0,
    };
    let mut unit = || f64::from(random.next_f32());
    // Distances that are not round numbers keep ray positions away from half pixels, where rounding
    // would decide which pixel a ray reads.
    let mut d_mm = -7.3 - unit();
    let distances: Vec<f64> = (0..layers)
        .map(|_| {
            d_mm += 2.1 + 5.0 * unit();
            d_mm
        })
        .collect();
    // build the display
    let mut display = display(resolution, views, &distances, frames);
    display.brightness = 0.2 + 0.8 * unit();
    display.missing = if clear { Missing::Clear } else { Missing::Drop };
    if bilinear {
        display.sampling = Sampling::Bilinear;
    }
    if perspective {
        display.field.projection = ProjectionKind::Perspective;
        display.field.distance_mm = Some(60.0 + 100.0 * unit());
    }
    if mixed {
        for layer in &mut display.layers {
            layer.resolution = layer.resolution.map(|n| n + (unit() * 5.0) as usize);
            layer.pitch_mm = 0.6 + unit();
            layer.offset_mm = [unit() - 0.5, unit() - 0.5];
        }
    }
    if kind == Kind::CoarseLayers {
        // layers are so coarse that very many rays read every pixel
        for layer in &mut display.layers {
            layer.resolution = [3, 2];
            layer.pitch_mm = 5.0 + unit();
        }
    }
    if kind == Kind::Additive {
        display.formation = Formation::Additive;
    }
    if kind == Kind::Polarization {
        display.formation = Formation::Polarization;
    }
    if matches!(kind, Kind::Floors | Kind::Anything) {
        for layer in &mut display.layers {
            layer.peak = 0.6 + 0.4 * unit();
            layer.black_level = 0.1 * unit();
        }
    }
    if responses {
        for layer in &mut display.layers {
            if unit() < 0.5 {
                layer.blur_px = 0.3 + unit();
            }
            if unit() < 0.5 {
                let row =
                    |own: usize, leak: f64| [0, 1, 2].map(|c: usize| if c == own { 0.9 - leak } else { leak / 2.0 });
                layer.crosstalk = Some([row(0, 0.2 * unit()), row(1, 0.2 * unit()), row(2, 0.2 * unit())]);
            }
            if unit() < 0.5 {
                layer.colour = LayerColour::Mono;
                if unit() < 0.5 {
                    layer.filters = vec![[1.0, 0.2, 0.1], [0.2, 0.9, 0.3]];
                }
            }
        }
    }
    if lenslets {
        display.backlight = Backlight::Lenslets(LensletBacklight {
            d_mm: distances[0] - 2.0 * unit(),
            lenslets: resolution.map(|n| n.div_ceil(3)),
            pitch_mm: 2.6 + unit(),
            fov_deg: [11.0, 13.0],
            views: [1 + (unit() * 4.0) as usize, 1 + (unit() * 3.0) as usize],
            offset_mm: [unit() - 0.5, unit() - 0.5],
            black_level: 0.0,
            outside_bins: if repeat { OutsideBins::Repeat } else { OutsideBins::Dark },
            transfer: Default::default(),
            panel_resolution: None,
            panel_pitch_mm: None,
            panel: None,
            lens: None,
        });
    }
    // target and weights
    let mut owned = Owned::constant(display, 0.0);
    owned.target.radiance_mut().data_mut().iter_mut().for_each(|value| *value = unit() as f32);
    // some weights are 0
    let mut weight = || ((unit() * 1.3 - 0.3).max(0.0) * 7.0) as f32;
    let [view_cols, view_rows] = views;
    // make at least one weight greater than 0
    let some = |mut values: Vec<f32>| {
        if values.iter().all(|w| *w == 0.0) {
            values[0] = 1.0;
        }
        values
    };
    owned.weights = match weights {
        0 => Weights::Uniform,
        1 => {
            let values = some((0..view_rows * view_cols).map(|_| weight()).collect());
            Weights::PerView(Tensor::from_vec(["view_y", "view_x"], [view_rows, view_cols], values).unwrap())
        }
        _ => {
            let shape = [view_rows, view_cols, resolution[1], resolution[0]];
            let values = some((0..shape.iter().product()).map(|_| weight()).collect());
            Weights::PerRay(Tensor::from_vec(["view_y", "view_x", "row", "col"], shape, values).unwrap())
        }
    };
    owned
}
