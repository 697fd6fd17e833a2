//! Weights w ≥ 0 of the objective Σ w (βL − L̃)², which is linear in w (eq. 27).

use lumistack_core::Tensor;
use thiserror::Error;

use crate::FieldGeometry;

/// Weight of each ray in the objective; all values finite and ≥ 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Weights {
    /// Every ray has weight 1.
    #[default]
    Uniform,
    /// One weight per view, `[view_y][view_x]`.
    PerView(Tensor<2>),
    /// One weight per ray, `[view_y][view_x][row][col]`.
    PerRay(Tensor<4>),
}

/// The error of weights that have a wrong shape or invalid values.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("weights: expected {expected}, found {found}")]
pub struct WeightError {
    /// The expected shape or range of values.
    pub expected: String,
    /// The wrong shape or the invalid value.
    pub found: String,
}

/// A region around a viewer's eye: a Gaussian in the plane through the eye parallel to the display.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeBox {
    /// The eye in display space, millimetres; z > 0.
    pub eye_mm: [f64; 3],
    /// Standard deviation, millimetres, > 0.
    pub sigma_mm: f64,
    /// Weight at the eye, ≥ 0.
    pub weight: f64,
}

impl Weights {
    /// Returns weights that are largest for the rays that pass near viewers' eyes. A ray has the
    /// weight `floor` + Σ weight · exp(−½ (r/σ)²). The distance r of the ray from the eye is
    /// measured in the plane through the eye parallel to the display. `floor` ≥ 0 is the least
    /// weight of a ray. With a floor above 0, directions between eye boxes are solved too.
    ///
    /// # Errors
    /// If the geometry is invalid, or an eye is not in front of the display. Also if σ is not above
    /// 0 or not finite, or if a weight or the floor is negative or not finite. Also if the sum of
    /// the weights and the floor exceeds [`f32::MAX`].
    pub fn eye_boxes(geometry: &FieldGeometry, boxes: &[EyeBox], floor: f32) -> Result<Self, WeightError> {
        let check = |ok: bool, expected: String, found: String| {
            if ok { Ok(()) } else { Err(WeightError { expected, found }) }
        };
        geometry.check().map_err(|error| WeightError {
            expected: format!("a valid geometry ({}: {})", error.what, error.expected),
            found: error.found,
        })?;
        let positive = |value: f64| value.is_finite() && value > 0.0;
        let weight_ok = |value: f64| value.is_finite() && value >= 0.0;
        check(weight_ok(floor.into()), "a floor ≥ 0".into(), floor.to_string())?;
        for (i, eye_box) in boxes.iter().enumerate() {
            let EyeBox { eye_mm, sigma_mm, weight } = eye_box;
            let eye_ok = eye_mm.iter().all(|v| v.is_finite()) && eye_mm[2] > 0.0;
            check(
                eye_ok,
                format!("a position of eye box {i} in front of the display (z > 0)"),
                format!("{eye_mm:?} mm"),
            )?;
            check(positive(*sigma_mm), format!("sigma_mm > 0 for eye box {i}"), sigma_mm.to_string())?;
            check(weight_ok(*weight), format!("a weight ≥ 0 for eye box {i}"), weight.to_string())?;
        }
        let peak = boxes.iter().map(|eye_box| eye_box.weight).sum::<f64>() + f64::from(floor);
        check(peak <= f64::from(f32::MAX), "weights that single precision can hold".into(), peak.to_string())?;

        // add the weights of each eye box to the floor
        let [view_rows, view_cols] = geometry.grid.views();
        let shape = [view_rows, view_cols, geometry.rows, geometry.cols];
        let mut weights = Tensor::filled(["view_y", "view_x", "row", "col"], shape, floor);
        for eye_box in boxes {
            // The Gaussian of a distance is the product of the Gaussians of its components. So
            // compute a factor for each axis.
            let [x, y] = eye_box.falloff(geometry);
            for [view_y, view_x] in geometry.grid.iter() {
                let x = &x[view_x * geometry.cols..(view_x + 1) * geometry.cols];
                for row in 0..geometry.rows {
                    let weight = (eye_box.weight * y[view_y * geometry.rows + row]) as f32;
                    let line = weights.block_mut([view_y, view_x, row]);
                    line.iter_mut().zip(x).for_each(|(sum, &x)| *sum += weight * x as f32);
                }
            }
        }
        Ok(Self::PerRay(weights))
    }

    /// Checks shape and values.
    ///
    /// # Errors
    /// If the weights have another shape than the geometry, a value is negative, infinite or NaN,
    /// or all values are 0.
    pub fn check(&self, geometry: &FieldGeometry) -> Result<(), WeightError> {
        let [view_rows, view_cols] = geometry.grid.views();
        let (shape, expected, data) = match self {
            Self::Uniform => return Ok(()),
            Self::PerView(t) => (t.shape().to_vec(), vec![view_rows, view_cols], t.data()),
            Self::PerRay(t) => (t.shape().to_vec(), vec![view_rows, view_cols, geometry.rows, geometry.cols], t.data()),
        };
        if shape != expected {
            return Err(WeightError { expected: format!("shape {expected:?}"), found: format!("{shape:?}") });
        }
        if let Some(found) = data.iter().find(|w| !(w.is_finite() && **w >= 0.0)) {
            return Err(WeightError { expected: "finite values ≥ 0".into(), found: found.to_string() });
        }
        if data.iter().all(|w| *w == 0.0) {
            let found = format!("0 everywhere (number of weights: {})", data.len());
            return Err(WeightError { expected: "at least one weight above 0".into(), found });
        }
        Ok(())
    }

    /// Returns the weight of one ray; `view` = [view_y, view_x].
    #[inline]
    pub fn at(&self, view: [usize; 2], row: usize, col: usize) -> f32 {
        match self {
            Self::Uniform => 1.0,
            Self::PerView(t) => t.get(view),
            Self::PerRay(t) => t.get([view[0], view[1], row, col]),
        }
    }
}

impl EyeBox {
    /// Returns the Gaussian's factors along x `[view_x][col]` and along y `[view_y][row]`. A ray
    /// that crosses z = 0 at p with slope s crosses the eye's plane at p + z·s.
    fn falloff(&self, geometry: &FieldGeometry) -> [Vec<f64>; 2] {
        let [eye_x, eye_y, z] = self.eye_mm;
        let along = |slopes: &[f64], positions: Vec<f64>, eye: f64| {
            let rays = slopes.iter().flat_map(|&slope| positions.iter().map(move |&p| (slope, p)));
            let passes = rays.map(|(slope, p)| p + z * geometry.grid.projection.slope(slope, p));
            passes.map(|passes| (-0.5 * ((passes - eye) / self.sigma_mm).powi(2)).exp()).collect()
        };
        let x_mm = (0..geometry.cols).map(|col| geometry.x_mm(col)).collect();
        let y_mm = (0..geometry.rows).map(|row| geometry.y_mm(row)).collect();
        [along(&geometry.grid.slope_x, x_mm, eye_x), along(&geometry.grid.slope_y, y_mm, eye_y)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::tests::small_display;
    use crate::{GridError, Projection, ViewGrid};

    /// Tolerance for the rounding of weights near 1 in single precision.
    const ROUNDING: f64 = 1e-6;

    fn at(eye_mm: [f64; 3]) -> EyeBox {
        EyeBox { eye_mm, sigma_mm: 20.0, weight: 2.0 }
    }

    fn perspective() -> Result<FieldGeometry, GridError> {
        let grid = ViewGrid::uniform(Projection::Perspective { distance_mm: 500.0 }, [5, 3], [20.0, 12.0])?;
        Ok(FieldGeometry { grid, rows: 4, cols: 6, pitch_mm: 3.0 })
    }

    #[test]
    fn the_view_from_the_eye_counts_most() {
        let geometry = perspective().unwrap();
        let view = [0, 3];
        let eye = [500.0 * geometry.grid.slope_x[view[1]], 500.0 * geometry.grid.slope_y[view[0]], 500.0];
        let weights = Weights::eye_boxes(&geometry, &[at(eye)], 0.25).unwrap();
        weights.check(&geometry).unwrap();
        for other in geometry.grid.iter() {
            for (row, col) in (0..4).flat_map(|row| (0..6).map(move |col| (row, col))) {
                let weight = f64::from(weights.at(other, row, col));
                assert!(
                    if other == view { (weight - 2.25).abs() < ROUNDING } else { weight < 1.5 },
                    "{other:?} {weight}"
                );
            }
        }
    }

    #[test]
    fn every_ray_counts_by_where_it_passes_the_eyes() {
        let display = small_display();
        let boxes = [at([40.0, -15.0, 300.0]), EyeBox { eye_mm: [-33.0, 8.0, 420.0], sigma_mm: 31.0, weight: 0.7 }];
        for geometry in [display.geometry().unwrap(), perspective().unwrap()] {
            let weights = Weights::eye_boxes(&geometry, &boxes, 0.1).unwrap();
            for view in geometry.grid.iter() {
                for (row, col) in (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| (row, col))) {
                    let p = [geometry.x_mm(col), geometry.y_mm(row)];
                    let slope = geometry.grid.slope_at(view, p);
                    let mut expected = 0.1;
                    for EyeBox { eye_mm: [x, y, z], sigma_mm, weight } in boxes {
                        let distance = (p[0] + z * slope[0] - x).hypot(p[1] + z * slope[1] - y);
                        expected += weight * (-0.5 * (distance / sigma_mm).powi(2)).exp();
                    }
                    assert!((f64::from(weights.at(view, row, col)) - expected).abs() < ROUNDING);
                }
            }
        }
    }

    #[test]
    fn eyes_that_make_no_sense_are_refused() {
        let geometry = perspective().unwrap();
        let good = at([0.0, 0.0, 500.0]);
        for (boxes, floor, message) in [
            (
                vec![at([0.0, 0.0, 0.0])],
                0.0,
                "weights: expected a position of eye box 0 in front of the display (z > 0), found [0.0, 0.0, 0.0] mm",
            ),
            (vec![good, at([f64::NAN, 0.0, 500.0])], 0.0, "weights: expected a position of eye box 1 in front"),
            (vec![EyeBox { sigma_mm: 0.0, ..good }], 0.0, "weights: expected sigma_mm > 0 for eye box 0, found 0"),
            (vec![EyeBox { sigma_mm: f64::INFINITY, ..good }], 0.0, "weights: expected sigma_mm > 0"),
            (vec![EyeBox { weight: -1.0, ..good }], 0.0, "weights: expected a weight ≥ 0 for eye box 0, found -1"),
            (vec![EyeBox { weight: 1e300, ..good }], 0.0, "weights: expected weights that single precision"),
            (vec![good], f32::NAN, "weights: expected a floor ≥ 0, found NaN"),
            (vec![], -0.5, "weights: expected a floor ≥ 0, found -0.5"),
        ] {
            let error = Weights::eye_boxes(&geometry, &boxes, floor).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
        }
        let nowhere = FieldGeometry { rows: 0, ..geometry };
        let error = Weights::eye_boxes(&nowhere, &[good], 0.0).unwrap_err().to_string();
        assert!(error.contains("resolution"), "{error}");
    }

    #[test]
    fn without_eyes_every_ray_is_at_the_floor() {
        let geometry = perspective().unwrap();
        let Weights::PerRay(weights) = Weights::eye_boxes(&geometry, &[], 0.5).unwrap() else { panic!("per ray") };
        assert!(weights.data().iter().all(|weight| *weight == 0.5));
    }
}
