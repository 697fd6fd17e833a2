//! Renders photographs of a display by a camera in front of it, with rotation, lens distortion,
//! vignetting and noise.
//!
//! The model has only rays and planes. It has no homography, and shares no code with the
//! calibration that reads the photographs. The model is in this crate, since Cargo optimizes the
//! crate. In the program of the end-to-end tests, which is not optimized, the model would take most
//! of a test's time.

use image::{GrayImage, Luma};

/// A camera in space.
pub struct Camera {
    /// Position in display space, millimetres.
    pub eye_mm: [f64; 3],
    /// Rotations about x, y and z, radians. Without rotation, the camera looks straight at the
    /// display.
    pub turn: [f64; 3],
    /// Focal length, pixels.
    pub focal_px: f64,
    /// Radial distortion: coefficients of r³ and r⁵, with r = 1 at the corner of the picture.
    pub bend: [f64; 2],
    /// [columns, rows].
    pub size: [u32; 2],
}

impl Camera {
    /// Returns the direction in display space of a point of the photograph.
    fn ray(&self, px: [f64; 2]) -> [f64; 3] {
        let centre = self.size.map(|count| (f64::from(count) - 1.0) / 2.0);
        let unit = 0.5 * f64::from(self.size[0]).hypot(f64::from(self.size[1]));
        let bent = [0, 1].map(|axis| (px[axis] - centre[axis]) / unit);
        // compute the undistorted radius by Newton's method
        let wanted = bent[0].hypot(bent[1]);
        let mut r = wanted;
        for _ in 0..5 {
            let (value, slope) = (
                r * (1.0 + self.bend[0] * r * r + self.bend[1] * r.powi(4)),
                1.0 + 3.0 * self.bend[0] * r * r + 5.0 * self.bend[1] * r.powi(4),
            );
            r -= (value - wanted) / slope;
        }
        let factor = if wanted > 0.0 { r / wanted } else { 1.0 };
        let [x, y] = bent.map(|value| value * factor * unit / self.focal_px);
        // the camera looks along −z, and rows increase downwards
        let mut v = [x, -y, -1.0];
        for (axis, angle) in self.turn.iter().enumerate() {
            let (sin, cos) = angle.sin_cos();
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            (v[a], v[b]) = (cos * v[a] - sin * v[b], sin * v[a] + cos * v[b]);
        }
        v
    }

    /// Renders a photograph of the plane at `d_mm`. `light` returns the light (0 to 255) that the
    /// plane emits at a point in millimetres. `noise` is the standard deviation of the noise,
    /// codes. `uniform` returns random numbers in 0..1.
    pub fn photograph(
        &self,
        d_mm: f64,
        light: &dyn Fn([f64; 2]) -> f64,
        noise: f64,
        uniform: &mut dyn FnMut() -> f32,
    ) -> GrayImage {
        let seen = |px: [f64; 2]| {
            let ray = self.ray(px);
            let t = (d_mm - self.eye_mm[2]) / ray[2];
            light([self.eye_mm[0] + t * ray[0], self.eye_mm[1] + t * ray[1]])
        };
        GrayImage::from_fn(self.size[0], self.size[1], |x, y| {
            const SAMPLES: u32 = 3;
            let offset = |i: u32| (f64::from(i) + 0.5) / f64::from(SAMPLES) - 0.5;
            let points = (0..SAMPLES * SAMPLES)
                .map(|i| seen([f64::from(x) + offset(i % SAMPLES), f64::from(y) + offset(i / SAMPLES)]));
            let mean = points.sum::<f64>() / f64::from(SAMPLES * SAMPLES);
            // the sum of twelve uniform numbers, minus 6, is nearly normal with mean 0 and variance
            // 1
            let normal = (0..12).map(|_| f64::from(uniform())).sum::<f64>() - 6.0;
            // vignetting: a lens darkens the edges of a photograph
            let r = (f64::from(x) / f64::from(self.size[0]) - 0.5).hypot(f64::from(y) / f64::from(self.size[1]) - 0.5);
            Luma([(20.0 + 0.8 * mean * (1.0 - 0.4 * r * r) + noise * normal).clamp(0.0, 255.0).round() as u8])
        })
    }
}
