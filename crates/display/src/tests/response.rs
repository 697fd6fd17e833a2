//! Compares the response of a layer's hardware with a sum over all pixels, and the blur with its
//! transpose.

use std::borrow::Cow;

use lumistack_core::Tensor;
use lumistack_core::seed::Stream;

use super::oracle::Effective;
use super::{fill, random_stack};
use crate::config::tests::small_display;
use crate::{Layer, LayerColour, LayerStack, Response};

/// Tolerance for the rounding in single precision: sums of at most 49 × 49 values in 0..1, with
/// weights that add up to 1.
const ROUNDING: f64 = 2e-6;

const SIGMAS_PX: [f64; 8] = [0.0, 0.05, 0.3, 0.5, 1.0, 1.4, 3.0, 8.0];
/// Sizes [rows, cols] of planes. Some are smaller than the point spread, some have fewer columns
/// than one SIMD block, and some are larger than both.
const SIZES: [[usize; 2]; 7] = [[1, 1], [1, 9], [7, 1], [2, 3], [5, 64], [30, 33], [11, 97]];

fn layer([rows, cols]: [usize; 2], blur_px: f64) -> Layer {
    Layer { blur_px, ..Layer::new(0.0, [cols, rows], 1.0) }
}

fn values([rows, cols]: [usize; 2], frames: usize, seed: u64) -> Tensor<4> {
    let mut values = Tensor::zeros(LayerStack::LAYER_AXES, [frames, rows, cols, 3]);
    fill(values.data_mut(), seed);
    values
}

#[test]
fn every_effect_agrees_with_the_sum_over_all_pixels() {
    let crosstalk = [[0.85, 0.1, 0.05], [0.1, 0.6, 0.0], [0.0, 0.2, 0.8]];
    let filters = vec![[1.0, 0.1, 0.0], [0.2, 0.9, 0.1], [0.0, 0.0, 0.7]];
    for (i, size) in SIZES.into_iter().enumerate() {
        for blur_px in SIGMAS_PX {
            let plain = layer(size, blur_px);
            for layer in [
                plain.clone(),
                Layer { crosstalk: Some(crosstalk), ..plain.clone() },
                Layer { colour: LayerColour::Mono, filters: filters.clone(), ..plain.clone() },
                Layer { colour: LayerColour::Mono, filters: filters.clone(), crosstalk: Some(crosstalk), ..plain },
            ] {
                let stored = values(size, 2, i as u64);
                let effective = Effective::of(&layer, &stored);
                let found = layer.response().map_or_else(|| stored.clone(), |response| response.apply(&stored));
                assert_eq!(found.shape(), stored.shape());
                for (found, expected) in found.data().iter().zip(effective.values()) {
                    assert!((f64::from(*found) - expected).abs() < ROUNDING, "{size:?} {layer:?}");
                    assert!((0.0..=1.0 + ROUNDING).contains(&f64::from(*found)));
                }
            }
        }
    }
}

fn blurs() -> impl Iterator<Item = ([usize; 2], Response)> {
    let kinds = SIZES.into_iter().flat_map(|size| SIGMAS_PX.map(|sigma| layer(size, sigma)).map(|layer| (size, layer)));
    // The layers are `mono`, so that they have a response even without blur.
    kinds.filter_map(|(size, layer)| Some((size, Layer { colour: LayerColour::Mono, ..layer }.response()?)))
}

#[test]
fn the_adjoint_is_the_transpose() {
    for (i, ([rows, cols], response)) in blurs().enumerate() {
        let mut random = Stream::new(i as u64);
        let [x, y] = [(); 2].map(|()| (0..rows * cols).map(|_| random.next_f32() - 0.4).collect::<Vec<_>>());
        let [mut ax, mut aty] = [(); 2].map(|()| vec![f32::NAN; rows * cols]);
        let mut scratch = vec![f32::NAN; 3];
        response.blur(rows, cols, &x, &mut ax, &mut scratch);
        response.blur_adjoint(rows, cols, &y, &mut aty, &mut scratch);
        let inner = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let scale = (inner(&x, &x) * inner(&y, &y)).sqrt();
        let difference = (inner(&ax, &y) - inner(&x, &aty)).abs();
        assert!(difference < ROUNDING * scale, "{rows} × {cols}, {} taps: {difference}", response.taps().len());
    }
}

#[test]
fn every_entry_of_the_adjoint_is_that_of_the_transpose() {
    for ([rows, cols], response) in blurs().filter(|([rows, cols], _)| rows * cols < 100) {
        let count = rows * cols;
        let columns = |adjoint: bool| -> Vec<Vec<f32>> {
            let column = |j: usize| {
                let mut unit = vec![0.0; count];
                unit[j] = 1.0;
                let (mut column, mut scratch) = (vec![0.0; count], Vec::new());
                match adjoint {
                    false => response.blur(rows, cols, &unit, &mut column, &mut scratch),
                    true => response.blur_adjoint(rows, cols, &unit, &mut column, &mut scratch),
                }
                column
            };
            (0..count).map(column).collect()
        };
        let (matrix, transpose) = (columns(false), columns(true));
        for (i, j) in (0..count).flat_map(|i| (0..count).map(move |j| (i, j))) {
            assert!(f64::from((matrix[i][j] - transpose[j][i]).abs()) < ROUNDING, "{rows} × {cols}: {i}, {j}");
        }
    }
}

#[test]
fn constants_stay_constant() {
    for ([rows, cols], response) in blurs() {
        for value in [0.0, 0.3, 1.0] {
            let mut blurred = vec![f32::NAN; rows * cols];
            response.blur(rows, cols, &vec![value; rows * cols], &mut blurred, &mut Vec::new());
            assert!(blurred.iter().all(|found| f64::from((found - value).abs()) < ROUNDING));
        }
        assert_eq!(response.taps().len() % 2, 1);
        assert!((response.taps().iter().sum::<f32>() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn the_point_spread_has_the_width_that_was_asked_for() {
    for sigma in [1.0, 2.0, 8.0] {
        let response = layer([100, 100], sigma).response().unwrap();
        let radius = (response.taps().len() / 2) as f64;
        let moments = response.taps().iter().enumerate().map(|(k, w)| f64::from(*w) * (k as f64 - radius).powi(2));
        // The weights end at 3σ. So up to 2.7 % of the variance, 1.4 % of the width, is missing.
        assert!((moments.sum::<f64>().sqrt() / sigma - 1.0).abs() < 0.02, "{sigma}");
        assert!(radius >= 3.0 * sigma);
    }
}

#[test]
fn an_ideal_layer_has_no_response_and_costs_nothing() {
    let mut display = small_display();
    let stack = random_stack(&display, 1);
    assert_eq!(display.layers[0].response(), None);
    assert!(matches!(stack.effective(&display), Cow::Borrowed(_)));
    // The channels of a `mono` layer share one value, so the layer has a response. But rays read
    // the stored values.
    display.layers[0].colour = LayerColour::Mono;
    display.layers[1].crosstalk = Some([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let tied = display.layers[0].response().unwrap();
    assert!(tied.is_tied() && tied.is_identity() && display.layers[1].response().is_none());
    assert!(matches!(stack.effective(&display), Cow::Borrowed(_)));
    display.layers[2].blur_px = 1.0;
    let effective = stack.effective(&display);
    assert_eq!(effective.layers[..2], stack.layers[..2]);
    assert_eq!(effective.layers[2], display.layers[2].response().unwrap().apply(&stack.layers[2]));
    effective.check(&display).unwrap();
}

#[test]
fn filters_are_stripes_of_columns() {
    let filters = vec![[1.0, 0.0, 0.0], [0.0, 0.5, 0.0]];
    let response = Layer { colour: LayerColour::Mono, filters, ..layer([2, 5], 0.0) }.response().unwrap();
    let effective = response.apply(&Tensor::filled(LayerStack::LAYER_AXES, [1, 2, 5, 3], 0.8));
    for (row, col) in [(0, 0), (1, 0), (0, 3), (1, 4)] {
        let expected = if col % 2 == 0 { [0.8, 0.0, 0.0] } else { [0.0, 0.4, 0.0] };
        assert_eq!(effective.block([0, row, col]), expected);
        assert_eq!(response.filter(col), if col % 2 == 0 { [1.0, 0.0, 0.0] } else { [0.0, 0.5, 0.0] });
    }
}
