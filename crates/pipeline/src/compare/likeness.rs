//! Similarity of pictures, and the files that comparisons read and write.

use std::path::Path;

use lumistack_core::Tensor;
use lumistack_core::metrics::{Flip, Mean, SquaredError, ssim};
use lumistack_display::{EmittedView, FieldGeometry, LightField, RayMap, Simulator, ViewGrid, spread};
use serde::Serialize;

use crate::error::{PipelineError, field_error};
use crate::simulate::simulate_to_file;

/// Similarity of two pictures or light fields.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Likeness {
    /// Peak signal-to-noise ratio, dB; `None` if the compared pixels are equal, or no pixel is
    /// compared.
    pub psnr_db: Option<f64>,
    /// Structural similarity, at most 1.
    pub ssim: f64,
    /// FLIP error, 0 to 1.
    pub flip: f64,
}

/// Zone score of a run, from its report.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ZoneLikeness {
    /// PSNR of seen pictures over the viewing zone, dB.
    pub psnr_db: f64,
    /// PSNR of seen pictures over the worst tenth of the directions, dB.
    pub worst_tenth_db: f64,
}

/// Reads the zone score from the report of a run, if there is one.
pub(super) fn zone_of(run: &Path) -> Option<ZoneLikeness> {
    let report = std::fs::read(run.join("report.json")).ok()?;
    let report: serde_json::Value = serde_json::from_slice(&report).ok()?;
    let number = |key: &str| report[key].as_f64();
    Some(ZoneLikeness { psnr_db: number("psnr_zone")?, worst_tenth_db: number("psnr_zone_worst_tenth")? })
}

/// Maximum number of compared views of a target, per axis.
const MOST_VIEWS: usize = 5;

/// Returns a selection of a grid's views, evenly spread, including the outermost views.
pub(super) fn some_views(grid: &ViewGrid) -> Vec<[usize; 2]> {
    let [rows, cols] = grid.views().map(|count| spread(count, MOST_VIEWS));
    rows.iter().flat_map(|&row| cols.iter().map(move |&col| [row, col])).collect()
}

/// Returns the left, the middle and the right view of a grid's middle row.
pub(super) fn middle_views(grid: &ViewGrid) -> Vec<[usize; 2]> {
    let [rows, cols] = grid.views();
    let mut views: Vec<[usize; 2]> = [0, cols / 2, cols - 1].map(|col| [rows / 2, col]).into();
    views.dedup();
    views
}

/// Returns the seen picture of a view, and for each pixel, true if the display shows the pixel.
pub(super) fn seen(
    simulator: &Simulator<'_>,
    brightness: f64,
    geometry: &FieldGeometry,
    view: [usize; 2],
) -> (Vec<f32>, Vec<bool>) {
    adapted(simulator.seen(geometry, view).into(), brightness)
}

/// Returns the emitted light along the rays of a view, L̃/β, and for each ray, true if it goes
/// through the display.
pub(super) fn along_rays(
    simulator: &Simulator<'_>,
    map: &RayMap,
    brightness: f64,
    geometry: &FieldGeometry,
    view: [usize; 2],
) -> (Vec<f32>, Vec<bool>) {
    adapted(simulator.view(map, geometry, view), brightness)
}

/// Divides emitted light by β.
fn adapted(emitted: EmittedView, brightness: f64) -> (Vec<f32>, Vec<bool>) {
    let scale = (1.0 / brightness) as f32;
    (emitted.radiance.data().iter().map(|value| value * scale).collect(), emitted.valid)
}

/// Sums of the scores over views.
pub(super) struct Sums {
    error: SquaredError,
    ssim: Mean,
    flip: Mean,
    filter: Flip,
}

impl Sums {
    pub(super) fn new() -> Self {
        let filter = Flip::new(Flip::DEFAULT_PIXELS_PER_DEGREE);
        Self { error: SquaredError::default(), ssim: Mean::default(), flip: Mean::default(), filter }
    }

    /// Adds a picture. Pixels that are not `valid` are excluded. They get the values of the
    /// reference, so that they do not change the filtered values of their neighbours.
    pub(super) fn add(&mut self, reference: &[f32], test: &[f32], shape: [usize; 2], valid: &[bool]) {
        let counted = |i: usize| valid[i];
        let mut test = test.to_vec();
        for (i, (test, reference)) in test.chunks_exact_mut(3).zip(reference.chunks_exact(3)).enumerate() {
            if valid[i] {
                for c in 0..3 {
                    self.error.add(f64::from(test[c]), f64::from(reference[c]));
                }
            } else {
                test.copy_from_slice(reference);
            }
        }
        self.ssim = self.ssim.merged(ssim(reference, &test, shape).mean_where(counted));
        self.flip = self.flip.merged(self.filter.compare(reference, &test, shape).mean_where(counted));
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.error = self.error.merged(other.error);
        self.ssim = self.ssim.merged(other.ssim);
        self.flip = self.flip.merged(other.flip);
    }

    /// Returns the PSNR as text, with `place` after a number. The text is `exact` if the compared
    /// pixels are equal, and `not compared` if no pixel is compared.
    pub(super) fn psnr_text(&self, place: &str) -> String {
        match self.error.psnr() {
            psnr if psnr.is_nan() => "not compared".into(),
            psnr if psnr.is_infinite() => "exact".into(),
            psnr => format!("{psnr:.1} dB{place}"),
        }
    }

    pub(super) fn likeness(&self) -> Likeness {
        let psnr = self.error.psnr();
        Likeness { psnr_db: psnr.is_finite().then_some(psnr), ssim: self.ssim.value(), flip: self.flip.value() }
    }
}

/// Reads the target of a run. The folder of a node has no target, so the target is read from the
/// run folder around it.
pub(super) fn target_of(run: &Path) -> Result<Option<LightField>, PipelineError> {
    // The folder of a node is nodes/ID in its run. The path may be relative, such as `.`, so it is
    // resolved first.
    let whole = std::fs::canonicalize(run).unwrap_or_else(|_| run.to_owned());
    let nodes = whole.parent().filter(|parent| parent.file_name().is_some_and(|name| name == "nodes"));
    let around = nodes.and_then(Path::parent).map(|around| around.join("target"));
    for folder in [Some(run.join("target")), around].into_iter().flatten() {
        if folder.join("lightfield.json").is_file() {
            return Ok(Some(lumistack_field_io::read_field_folder(&folder).map_err(field_error)?.0));
        }
    }
    Ok(None)
}

/// Returns `second` minus `first`, added to middle grey.
pub(super) fn difference(first: &[f32], second: &[f32]) -> Vec<f32> {
    // Middle grey is ½ after sRGB encoding, and 0.214 in linear light.
    first.iter().zip(second).map(|(a, b)| (0.214 + (b - a)).clamp(0.0, 1.0)).collect()
}

/// Writes pictures of the same shape `[row][col][rgb]` next to each other.
pub(super) fn save(path: &Path, panes: Vec<Vec<f32>>, [rows, cols]: [usize; 2]) -> Result<(), PipelineError> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
    }
    let mut sheet = Tensor::zeros(["row", "col", "rgb"], [rows, cols * panes.len(), 3]);
    for (number, pane) in panes.iter().enumerate() {
        for row in 0..rows {
            sheet.block_mut([row])[3 * cols * number..][..3 * cols]
                .copy_from_slice(&pane[3 * cols * row..][..3 * cols]);
        }
    }
    simulate_to_file(&sheet, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_compared_pixels_can_be_exact() {
        let picture = [0.5f32, 0.25, 1.0].repeat(256);
        let text = |test: &[f32], valid: bool| {
            let mut sums = Sums::new();
            sums.add(&picture, test, [16, 16], &[valid; 256]);
            sums.psnr_text(" here")
        };
        assert_eq!(text(&picture, true), "exact");
        assert_eq!(text(&picture, false), "not compared");
        assert_eq!(text(&picture.iter().map(|value| value - 0.1).collect::<Vec<_>>(), true), "20.0 dB here");
    }

    /// A node finds the target of its run two folders above. For other folders, a folder `target`
    /// two levels above must not be read. The test damages the target's index, so an error shows
    /// that the target was read.
    #[test]
    fn only_a_node_has_the_target_of_the_run_around_it() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["target", "nodes/a", "runs/a"] {
            std::fs::create_dir_all(folder.path().join(name)).unwrap();
        }
        std::fs::write(folder.path().join("target/lightfield.json"), "{").unwrap();
        assert!(target_of(&folder.path().join("nodes/a")).is_err(), "the target is read");
        assert!(target_of(&folder.path().join("runs/a")).unwrap().is_none());
    }
}
