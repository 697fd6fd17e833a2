//! Tests the forward model for every formation, sampling, backlight and projection, and for both
//! values of [`Missing`].

use lumistack_core::seed::{Stream, derive};

use super::oracle::{Effective, emitted, seen};
use super::random_stack;
use crate::{
    Backlight, Display, FieldGeometry, Formation, LayerColour, LayerStack, LensletBacklight, Missing, OutsideBins,
    ProjectionKind, RayMap, Sampling, Simulator,
};

/// Allowed difference in radiance between the model in single precision and the oracle in double
/// precision.
const AGREEMENT: f64 = 1e-5;

const FORMATIONS: [Formation; 3] = [Formation::Attenuating, Formation::Additive, Formation::Polarization];

/// Returns a display whose layers have random pitches and offsets. `formation` and `choices` select
/// the display's other properties. If `seed` is a multiple of 3, the backlight is uniform.
fn random_display(formation: Formation, choices: [bool; 5], seed: u64) -> Display {
    let [bilinear, clear, perspective, limited, repeat] = choices;
    let mut random = Stream::new(derive(seed, &[]));
    let mut unit = || f64::from(random.next_f32());
    // Distances that are not round numbers keep rays away from pixel borders, where rounding would
    // decide which pixel they read.
    let mut display = Display {
        formation,
        sampling: if bilinear { Sampling::Bilinear } else { Sampling::Nearest },
        missing: if clear { Missing::Clear } else { Missing::Drop },
        ..Display::uniform([9, 7], 1.0, [3, 2], [24.0, 17.0], &[-7.31, -0.43, 6.17], 2)
    };
    if perspective {
        display.field.projection = ProjectionKind::Perspective;
        display.field.distance_mm = Some(50.0 + 40.0 * unit());
    }
    for (n, layer) in display.layers.iter_mut().enumerate() {
        layer.resolution = [8 + n, 6 + n];
        layer.pitch_mm = 0.9 + 0.2 * unit();
        layer.offset_mm = [unit() - 0.5, unit() - 0.5];
    }
    if limited {
        display.layers[0].blur_px = 0.4 + unit();
        display.layers[1].crosstalk = Some([[0.8, 0.1, 0.1], [0.0, 0.7, 0.1], [0.05, 0.05, 0.9]]);
        display.layers[2].colour = LayerColour::Mono;
        display.layers[2].filters = vec![[1.0, 0.1, 0.0], [0.2, 0.9, 0.1]];
    }
    if !seed.is_multiple_of(3) {
        display.backlight = Backlight::Lenslets(LensletBacklight {
            offset_mm: [unit() - 0.5, unit() - 0.5],
            outside_bins: if repeat { OutsideBins::Repeat } else { OutsideBins::Dark },
            ..LensletBacklight::new(-9.3, [4, 3], 2.3 + unit(), [3, 2], [13.0, 19.0])
        });
    }
    display
}

/// Compares every ray of every view with the oracle.
fn assert_agrees(display: &Display, stack: &LayerStack, geometry: &FieldGeometry, what: &str) {
    let effective: Vec<Effective> =
        display.layers.iter().zip(&stack.layers).map(|(layer, values)| Effective::of(layer, values)).collect();
    let (simulator, map) = (Simulator::new(display, stack), RayMap::new(display, geometry));
    for view in geometry.grid.iter() {
        let found = simulator.view(&map, geometry, view);
        for (i, pixel) in found.radiance.data().chunks_exact(3).enumerate() {
            let expected = emitted(display, &effective, stack, geometry, view, [i / geometry.cols, i % geometry.cols]);
            assert_eq!(found.valid[i], expected.is_some(), "{what}: ray {i} of view {view:?}");
            for (found, expected) in pixel.iter().zip(expected.unwrap_or_default()) {
                let error = (f64::from(*found) - expected).abs();
                assert!(error < AGREEMENT, "{what}: ray {i} of view {view:?} is {found}, expected {expected}");
            }
        }
    }
}

#[test]
fn every_kind_of_display_agrees_with_the_oracle() {
    for (f, formation) in FORMATIONS.into_iter().enumerate() {
        for kind in 0..32u64 {
            let choices = [0, 1, 2, 3, 4].map(|bit| kind >> bit & 1 == 1);
            for seed in 0..3 {
                let seed = derive(seed, &[kind, f as u64]) / 3 * 3 + seed;
                let display = random_display(formation, choices, seed);
                display.check().unwrap();
                let stack = random_stack(&display, seed);
                let what = format!("{formation:?}, choices {choices:?}, seed {seed}");
                assert_agrees(&display, &stack, &display.geometry().unwrap(), &what);
            }
        }
    }
}

#[test]
fn layers_that_are_not_there_change_nothing() {
    for formation in FORMATIONS {
        let mut display = Display { formation, missing: Missing::Clear, ..random_display(formation, [false; 5], 3) };
        let stack = random_stack(&display, 1);
        for layer in &mut display.layers {
            layer.offset_mm = [1e6, -1e6];
        }
        let view = Simulator::new(&display, &stack).from_slope([0.05, 0.0]);
        assert!(view.share.iter().all(|share| (share - 1.0).abs() < 1e-6));
        // Without layers, an attenuating display shows its backlight, of radiance 1. In the other
        // formations it is black, since no layer emits or rotates light.
        let expected = if formation == Formation::Attenuating { 1.0 } else { 0.0 };
        assert!(view.radiance.data().iter().all(|value| (value - expected).abs() < 1e-6), "{formation:?}");
        display.missing = Missing::Drop;
        let view = Simulator::new(&display, &stack).from_slope([0.05, 0.0]);
        assert!(view.share.iter().all(|share| *share == 0.0) && view.radiance.data().iter().all(|value| *value == 0.0));
    }
}

#[test]
fn one_pixel_and_extreme_values_stay_in_range() {
    for formation in FORMATIONS {
        for value in [0.0, 1.0] {
            let display = Display { formation, ..Display::uniform([1, 1], 1.0, [1, 1], [10.0, 10.0], &[-1.0, 1.0], 3) };
            let stack = LayerStack::filled(&display, value);
            let view = Simulator::new(&display, &stack).from_eye([0.0, 0.0, 500.0]);
            let expected = match formation {
                Formation::Attenuating => value,
                Formation::Additive => 2.0 * value,
                // Two rotations by 90° add up to 180°, which crossed polarizers block.
                Formation::Polarization => 0.0,
            };
            assert!(view.share[0] > 0.5);
            assert!(view.radiance.data().iter().all(|found| (found - expected).abs() < 1e-6), "{formation:?} {value}");
        }
    }
}

#[test]
fn two_quarter_turns_of_half_a_right_angle_are_bright() {
    let mut display = Display::uniform([4, 3], 1.0, [1, 1], [10.0, 10.0], &[-1.0, 1.0], 1);
    display.formation = Formation::Polarization;
    let bright = Simulator::new(&display, &LayerStack::filled(&display, 0.5)).from_slope([0.0; 2]);
    assert!(bright.radiance.data().iter().all(|value| (value - 1.0).abs() < 1e-6));
    let half = Simulator::new(&display, &LayerStack::filled(&display, 0.25)).from_slope([0.0; 2]);
    assert!(half.radiance.data().iter().all(|value| (value - 0.5).abs() < 1e-6));
}

/// In these oblique views, all edges of layer pixels lie on sixteenths of a field pixel. So the
/// mean over 16 × 16 rays per pixel is exact, and the seen picture must equal it.
#[test]
fn seen_pictures_are_exact_means_over_pixels() {
    for (seed, formation) in FORMATIONS.into_iter().enumerate() {
        for missing in [Missing::Drop, Missing::Clear] {
            let mut display = Display {
                formation,
                missing,
                // Seen pictures treat layer pixels as squares, also if the solver interpolates
                // between them.
                sampling: Sampling::Bilinear,
                ..Display::uniform([8, 6], 1.0, [1, 1], [30.0, 30.0], &[-3.0, 0.0, 2.0], 2)
            };
            display.layers[0].pitch_mm = 0.75;
            display.layers[0].resolution = [11, 9];
            display.layers[1].offset_mm = [0.125, -0.25];
            display.layers[2].pitch_mm = 1.25;
            let mut lenslets = LensletBacklight::new(-4.0, [4, 3], 2.0, [3, 2], [20.0, 20.0]);
            lenslets.outside_bins = OutsideBins::Repeat;
            for backlight in [Backlight::Uniform, Backlight::Lenslets(lenslets)] {
                display.backlight = backlight;
                let stack = random_stack(&display, seed as u64);
                for slope in [[0.0, 0.0], [0.125, -0.0625], [-0.25, 0.1875], [0.5, 0.5]] {
                    let grid = crate::ViewGrid::single(crate::Projection::Oblique, slope);
                    let worst = compare_seen(&display, &stack, &display.field_pixels().with_grid(grid), 16);
                    assert!(worst < AGREEMENT, "{formation:?} {missing:?} {slope:?}: {worst}");
                }
            }
        }
    }
}

/// For random displays, oblique and perspective, the seen picture agrees with the mean over 150 ×
/// 150 rays per pixel. The tolerance is the error of this mean, which misses edges between two
/// rays.
#[test]
fn seen_pictures_of_any_display_are_means_over_pixels() {
    const SPACING: f64 = 0.03;
    for seed in 0..12 {
        let choices = [0, 1, 2, 3, 4].map(|bit| (5 * seed + 3) >> bit & 1 == 1);
        let display = random_display(FORMATIONS[seed as usize % 3], choices, seed);
        let stack = random_stack(&display, seed);
        let mut geometry = display.geometry().unwrap();
        (geometry.rows, geometry.cols) = (4, 5);
        let worst = compare_seen(&display, &stack, &geometry, 150);
        assert!(worst < SPACING, "seed {seed}: {worst}");
    }
}

/// Compares the seen picture of the last view with the oracle's picture. Returns the largest
/// difference of the pixels' shares, and of their radiance where the share exceeds a tenth.
fn compare_seen(display: &Display, stack: &LayerStack, geometry: &FieldGeometry, fine: usize) -> f64 {
    display.check().unwrap();
    let effective: Vec<Effective> =
        display.layers.iter().zip(&stack.layers).map(|(layer, values)| Effective::of(layer, values)).collect();
    let view = geometry.grid.iter().last().unwrap();
    let found = Simulator::new(display, stack).seen(geometry, view);
    let mut worst = 0.0f64;
    for (i, (pixel, share)) in found.radiance.data().chunks_exact(3).zip(&found.share).enumerate() {
        let place = [i / geometry.cols, i % geometry.cols];
        let (expected, expected_share) = seen(display, &effective, stack, geometry, view, place, fine);
        worst = worst.max((f64::from(*share) - expected_share).abs());
        if expected_share > 0.1 {
            (0..3).for_each(|c| worst = worst.max((f64::from(pixel[c]) - expected[c]).abs()));
        }
    }
    worst
}

/// At slopes that shift all layers by whole pixels, the ray through a pixel's centre has the mean
/// value of the pixel's area.
#[test]
fn whole_shifts_are_seen_as_their_centre_rays_are() {
    let display = Display::uniform([20, 14], 1.0, [5, 5], [20.0, 20.0], &[-40.0, 0.0, 40.0], 3);
    let stack = random_stack(&display, 5);
    let step = crate::native_step(&display)[0].unwrap();
    let simulator = Simulator::new(&display, &stack);
    for shifts in [[0.0, 0.0], [3.0, -2.0], [-1.0, 5.0]] {
        let slope = shifts.map(|shift: f64| shift * step);
        let geometry = display.field_pixels().with_grid(crate::ViewGrid::single(crate::Projection::Oblique, slope));
        let centre = simulator.view(&crate::RayMap::new(&display, &geometry), &geometry, [0, 0]);
        let seen = simulator.from_slope(slope);
        for (i, (share, valid)) in seen.share.iter().zip(&centre.valid).enumerate() {
            assert!((share - f32::from(*valid)).abs() < 1e-6, "{shifts:?} {i}");
        }
        let worst = seen.radiance.data().iter().zip(centre.radiance.data()).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f32::max) < 1e-6, "{shifts:?}");
    }
}
