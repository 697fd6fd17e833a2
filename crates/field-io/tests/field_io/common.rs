//! Fixtures shared by several test files.

use std::path::{Path, PathBuf};

use lumistack_core::seed::Stream;
use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, LightField, Projection, ViewGrid};
use lumistack_field_io::{FieldError, GeometryDefaults, GeometryFlags};

/// Returns a light field of random multiples of 1/1024 in 0..1, which half floats represent
/// exactly.
pub fn random_field(views: [usize; 2], size: [usize; 2], projection: Projection, seed: u64) -> LightField {
    let geometry = FieldGeometry {
        rows: size[1],
        cols: size[0],
        pitch_mm: 0.731,
        grid: ViewGrid::uniform(projection, views, [23.0, 17.0]).unwrap(),
    };
    let shape = LightField::shape_of(&geometry);
    let mut stream = Stream::new(seed);
    let data = (0..shape.iter().product()).map(|_| (stream.next_u64() % 1025) as f32 / 1024.0).collect();
    LightField::new(geometry, Tensor::from_vec(LightField::AXES, shape, data).unwrap()).unwrap()
}

/// Opens a light field; also returns the texts of warnings.
pub fn open(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
) -> (Result<LightField, FieldError>, Vec<String>) {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let result = lumistack_field_io::open(path, flags, defaults, Task::quiet(&warnings, &cancel));
    (result, warnings.take().iter().map(ToString::to_string).collect())
}

/// Opens a light field for a display with a footprint of `width` [x, y]; also returns the texts of
/// warnings.
pub fn open_for(path: &Path, flags: &GeometryFlags, width: [f64; 2]) -> (Result<LightField, FieldError>, Vec<String>) {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let result = {
        let reading = lumistack_field_io::Reading { footprint: Some(&|_| width), ..Default::default() };
        lumistack_field_io::open_for(path, flags, &defaults(), reading, task)
    };
    (result.map(|(field, _)| field), warnings.take().iter().map(ToString::to_string).collect())
}

/// Defaults of a display with a field of view of 20° × 20° and a width of 400 mm.
pub fn defaults() -> GeometryDefaults {
    GeometryDefaults { width_mm: Some(400.0), fov_deg: Some([20.0, 20.0]) }
}

/// Returns the path `below` in a folder of third-party files. The environment variable `variable`
/// names the folder; the default is `../shared/` followed by `default`. If the path is missing, the
/// test is reported as skipped, and the result is `None`.
pub fn assets(variable: &str, default: &str, below: &str) -> Option<PathBuf> {
    let path = lumistack_testkit::skip::folder(variable, &format!("../shared/{default}"))?.join(below);
    if path.exists() {
        return Some(path);
    }
    lumistack_testkit::skip::skipped(&format!("{} is not here ({variable} names the folder)", path.display()));
    None
}

/// Saves an 8-bit picture of code values.
pub fn save_png(path: &Path, size: [usize; 2], rgb: impl Fn(usize, usize) -> [u8; 3]) {
    image::RgbImage::from_fn(size[0] as u32, size[1] as u32, |x, y| image::Rgb(rgb(x as usize, y as usize)))
        .save(path)
        .unwrap();
}
