//! A naive oracle of the forward model: the equations in double precision, without tables and
//! separable passes.

use lumistack_core::Tensor;

use crate::{
    Backlight, Display, FieldGeometry, Formation, Layer, LayerColour, LayerStack, LensletBacklight, Missing,
    OutsideBins, Sampling,
};

/// Values that rays read on a layer, `[frame][row][col][rgb]`.
pub(super) struct Effective {
    shape: [usize; 4],
    values: Vec<f64>,
}

impl Effective {
    /// Computes F_c = Σ_c' crosstalk[c][c'] · blur(filter_c' · f_c'), with the blur as one sum over
    /// a square of pixels.
    pub(super) fn of(layer: &Layer, stored: &Tensor<4>) -> Self {
        let shape @ [frames, rows, cols, _] = stored.shape();
        let radius = (3.0 * layer.blur_px).ceil() as i64;
        let weight = |dy: i64, dx: i64| match layer.blur_px {
            0.0 => 1.0,
            sigma => (-((dy * dy + dx * dx) as f64) / (2.0 * sigma * sigma)).exp(),
        };
        let filtered = |frame: usize, row: usize, col: usize, c: usize| {
            let stripes = layer.filters.len();
            let filter =
                if layer.colour == LayerColour::Mono && stripes > 0 { layer.filters[col % stripes][c] } else { 1.0 };
            filter * f64::from(stored.get([frame, row, col, c]))
        };
        let mut values = Vec::new();
        for (frame, row, col) in
            (0..frames).flat_map(|m| (0..rows).flat_map(move |r| (0..cols).map(move |c| (m, r, c))))
        {
            let mut blurred = [0.0; 3];
            let mut total = 0.0;
            for (dy, dx) in (-radius..=radius).flat_map(|dy| (-radius..=radius).map(move |dx| (dy, dx))) {
                let (y, x) = (row as i64 + dy, col as i64 + dx);
                if (0..rows as i64).contains(&y) && (0..cols as i64).contains(&x) {
                    total += weight(dy, dx);
                    for (c, sum) in blurred.iter_mut().enumerate() {
                        *sum += weight(dy, dx) * filtered(frame, y as usize, x as usize, c);
                    }
                }
            }
            for c in 0..3 {
                values.push(match layer.crosstalk {
                    Some(matrix) => (0..3).map(|from| matrix[c][from] * blurred[from]).sum::<f64>() / total,
                    None => blurred[c] / total,
                });
            }
        }
        Self { shape, values }
    }

    pub(super) fn values(&self) -> &[f64] {
        &self.values
    }

    fn get(&self, frame: usize, row: usize, col: usize, c: usize) -> f64 {
        self.values[((frame * self.shape[1] + row) * self.shape[2] + col) * 3 + c]
    }
}

/// A ray: the point (x, y) at which it crosses z = 0, and its slope.
#[derive(Clone, Copy)]
struct Ray {
    x: f64,
    y: f64,
    slope: [f64; 2],
}

/// Returns the radiance of the ray through a pixel's centre; `None` for an invalid ray.
pub(super) fn emitted(
    display: &Display,
    effective: &[Effective],
    stack: &LayerStack,
    geometry: &FieldGeometry,
    view: [usize; 2],
    [row, col]: [usize; 2],
) -> Option<[f64; 3]> {
    emitted_at(display, effective, stack, geometry, view, [row as f64, col as f64])
}

/// Divides a pixel into `fine` × `fine` squares, and traces a ray through the centre of each.
/// Returns the mean radiance of the valid rays, and the fraction of rays that is valid.
pub(super) fn seen(
    display: &Display,
    effective: &[Effective],
    stack: &LayerStack,
    geometry: &FieldGeometry,
    view: [usize; 2],
    [row, col]: [usize; 2],
    fine: usize,
) -> ([f64; 3], f64) {
    let display = &Display { sampling: Sampling::Nearest, ..display.clone() };
    let offset = |i: usize| (i as f64 + 0.5) / fine as f64 - 0.5;
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for (y, x) in (0..fine).flat_map(|y| (0..fine).map(move |x| (y, x))) {
        let place = [row as f64 + offset(y), col as f64 + offset(x)];
        if let Some(rgb) = emitted_at(display, effective, stack, geometry, view, place) {
            count += 1.0;
            (0..3).for_each(|c| sum[c] += rgb[c]);
        }
    }
    (sum.map(|sum| if count > 0.0 { sum / count } else { 0.0 }), count / (fine * fine) as f64)
}

/// Returns the radiance of the ray at a fractional row and column; `None` for an invalid ray.
fn emitted_at(
    display: &Display,
    effective: &[Effective],
    stack: &LayerStack,
    geometry: &FieldGeometry,
    view: [usize; 2],
    [row, col]: [f64; 2],
) -> Option<[f64; 3]> {
    let x = (col - (geometry.cols as f64 - 1.0) / 2.0) * geometry.pitch_mm;
    let y = ((geometry.rows as f64 - 1.0) / 2.0 - row) * geometry.pitch_mm;
    let ray = Ray { x, y, slope: geometry.grid.slope_at(view, [x, y]) };
    let mut radiance = [0.0; 3];
    for frame in 0..display.frames {
        let mut layers = Vec::new();
        for (layer, effective) in display.layers.iter().zip(effective) {
            match (read(display.sampling, layer, effective, ray, frame), display.missing) {
                (Some(value), _) => layers.push(value),
                (None, Missing::Clear) => {}
                (None, Missing::Drop) => return None,
            }
        }
        let directional = match (&display.backlight, &stack.emission) {
            (Backlight::Lenslets(lenslets), Some(emission)) => Some(light(lenslets, emission, ray, frame)?),
            _ => None,
        };
        for c in 0..3 {
            let product: f64 = layers.iter().map(|value| value[c]).product();
            let sum: f64 = layers.iter().map(|value| value[c]).sum();
            let light = directional.map(|light| light[c]);
            radiance[c] += match display.formation {
                Formation::Attenuating => light.unwrap_or(1.0) * product,
                Formation::Additive => light.unwrap_or(0.0) + sum,
                Formation::Polarization => light.unwrap_or(1.0) * (sum * std::f64::consts::FRAC_PI_2).sin().powi(2),
            } / display.frames as f64;
        }
    }
    Some(radiance)
}

/// Returns the value that a ray reads on a layer; `None` if the ray misses the layer.
fn read(sampling: Sampling, layer: &Layer, effective: &Effective, ray: Ray, frame: usize) -> Option<[f64; 3]> {
    let [cols, rows] = layer.resolution;
    let x = ray.x + layer.d_mm * ray.slope[0] - layer.offset_mm[0];
    let y = ray.y + layer.d_mm * ray.slope[1] - layer.offset_mm[1];
    let u = x / layer.pitch_mm + (cols as f64 - 1.0) / 2.0;
    let v = (rows as f64 - 1.0) / 2.0 - y / layer.pitch_mm;
    let (nearest_u, nearest_v) = ((u + 0.5).floor(), (v + 0.5).floor());
    let inside = (0.0..cols as f64).contains(&nearest_u) && (0.0..rows as f64).contains(&nearest_v);
    inside.then(|| {
        std::array::from_fn(|c| match sampling {
            Sampling::Nearest => effective.get(frame, nearest_v as usize, nearest_u as usize, c),
            // Each pixel's weight falls linearly with its distance from the ray's position. The
            // position is clamped to the outermost pixel centres.
            Sampling::Bilinear => {
                let (u, v) = (u.clamp(0.0, cols as f64 - 1.0), v.clamp(0.0, rows as f64 - 1.0));
                let tent = |distance: f64| (1.0 - distance.abs()).max(0.0);
                let pixels = (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col)));
                pixels
                    .map(|(row, col)| tent(row as f64 - v) * tent(col as f64 - u) * effective.get(frame, row, col, c))
                    .sum()
            }
        })
    })
}

/// Returns the backlight's emission along a ray, which is 0 outside the bins if they do not repeat.
/// `None` if the ray misses the lenslets.
fn light(backlight: &LensletBacklight, emission: &Tensor<6>, ray: Ray, frame: usize) -> Option<[f64; 3]> {
    let [cols, rows] = backlight.lenslets.map(|n| n as i64);
    let [bins_x, bins_y] = backlight.views.map(|n| n as i64);
    let x = ray.x + backlight.d_mm * ray.slope[0] - backlight.offset_mm[0];
    let y = ray.y + backlight.d_mm * ray.slope[1] - backlight.offset_mm[1];
    let mut col = (cols as f64 / 2.0 + x / backlight.pitch_mm).floor() as i64;
    let mut row = (rows as f64 / 2.0 - y / backlight.pitch_mm).floor() as i64;
    if !(0..cols).contains(&col) || !(0..rows).contains(&row) {
        return None;
    }
    let half_angle = backlight.fov_deg.map(|fov| (fov / 2.0).to_radians().tan());
    let mut bin_x = (bins_x as f64 / 2.0 * (1.0 + ray.slope[0] / half_angle[0])).floor() as i64;
    let mut bin_y = (bins_y as f64 / 2.0 * (1.0 - ray.slope[1] / half_angle[1])).floor() as i64;
    if backlight.outside_bins == OutsideBins::Repeat {
        // A ray outside all bins reads the bins of a neighbouring lenslet.
        for (bin, bins, lenslet) in [(&mut bin_x, bins_x, &mut col), (&mut bin_y, bins_y, &mut row)] {
            while *bin >= bins {
                *bin -= bins;
                *lenslet -= 1;
            }
            while *bin < 0 {
                *bin += bins;
                *lenslet += 1;
            }
        }
    }
    let lit = (0..bins_x).contains(&bin_x)
        && (0..bins_y).contains(&bin_y)
        && (0..cols).contains(&col)
        && (0..rows).contains(&row);
    let index = [frame, bin_y as usize, bin_x as usize, row as usize, col as usize];
    Some(if lit { std::array::from_fn(|c| f64::from(emission.block(index)[c])) } else { [0.0; 3] })
}
