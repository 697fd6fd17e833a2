//! Estimate of the disk space of a plan. Light fields and the pictures for the zone score are
//! counted. Patterns, outputs and the report usually need far less space.

use lumistack_display::{Display, FieldGeometry, ViewGrid};
use lumistack_pathtracer::Settings;
use lumistack_pathtracer::denoise::SharedLight;

use super::steps::StepKind;
use crate::job::{Background, Denoise, Job};
use crate::reader::is_capture;
use crate::store::space::{GUIDES, SPLATS, VIEW, traced};

/// Bytes of a ray in a light field that a run writes.
const WRITTEN: u64 = 3 * size_of::<u16>() as u64;
/// Bytes of a ray in a file that marks the rays that hit nothing.
const MISSED: u64 = size_of::<f32>() as u64;

/// Disk space of a part's light fields, bytes.
#[derive(Clone, Copy)]
pub(super) struct Disk {
    /// Rays of the target, and of the light fields for the report.
    rays: u64,
    /// Rays of the target, if it is not in memory; otherwise 0.
    in_files: u64,
    /// Rays of all pictures for the score.
    scored: u64,
    /// The filter of the traced views, and the settings of their paths.
    filter: (Denoise, Settings),
    /// Bytes of a ray in two kinds of files: splats, and marks of the rays that hit nothing.
    other: u64,
    /// Bytes of a ray in two files: the target, and the solver's copy of the target.
    solved: u64,
}

impl Disk {
    pub(super) fn of(job: &Job, display: &Display, geometry: &FieldGeometry, others: &[Option<ViewGrid>; 2]) -> Self {
        let pixels = (geometry.rows * geometry.cols) as u64;
        let rays = |grid: &ViewGrid| grid.iter().count() as u64 * pixels;
        let target = rays(&geometry.grid);
        let is_capture = job.scene.as_deref().is_some_and(is_capture);
        let is_hidden = job.light.background != Background::Environment;
        // If a run will measure the number of paths, assume one path per pixel. Such a pixel also
        // has a further ray, which makes the files larger.
        let views = geometry.grid.iter().count();
        let samples = if job.render.samples_are_measured() { 1 } else { job.render.samples_of_view(views) };
        let settings = job.split_settings(Settings { samples, ..Settings::default() }, display);
        Self {
            rays: target + others.iter().flatten().map(rays).sum::<u64>(),
            in_files: if job.render.is_held(geometry) { 0 } else { target },
            scored: 2 * job.report.zone_directions as u64 * pixels,
            filter: (job.denoise_for(display), settings),
            other: if is_capture { SPLATS } else { 0 } + if is_hidden { MISSED } else { 0 },
            // The solver's copy has half floats, unless the values of a given light field need
            // single floats.
            solved: if job.light_field.is_some() { 2 * VIEW } else { VIEW + WRITTEN },
        }
    }

    /// Returns the bytes that a step leaves in the run folder, and the bytes of its temporary
    /// files.
    pub(super) fn of_step(&self, kind: StepKind) -> [u64; 2] {
        let (filter, settings) = self.filter;
        let traced = traced(filter, &settings);
        match (kind, filter) {
            // both halves of every view, and their guides
            (StepKind::Trace, Denoise::Guided | Denoise::Oidn) => [(2 * (traced + GUIDES) + self.other) * self.rays, 0],
            (StepKind::Trace, Denoise::Auto | Denoise::Off) => [(traced + self.other) * self.rays, 0],
            // the split views are temporary: the filter removes them
            (StepKind::Trace, Denoise::Shared) => [self.other * self.rays, 0],
            (StepKind::Denoise, Denoise::Shared) => {
                [VIEW * self.rays, traced * self.rays + SharedLight::BYTES_PER_RAY * self.in_files]
            }
            (StepKind::Denoise, Denoise::Guided | Denoise::Oidn) => [VIEW * self.rays, 0],
            (StepKind::Expose | StepKind::Read | StepKind::Source, _) => [WRITTEN * self.rays, 0],
            (StepKind::Score, _) => [VIEW * self.scored, 0],
            (StepKind::Patterns | StepKind::Design(_) | StepKind::Search, _) => [0, self.solved * self.in_files],
            _ => [0, 0],
        }
    }
}

/// Returns the disk space that steps need together, bytes: the files that all steps leave, and the
/// temporary files of the step that has the most.
pub(super) fn together(steps: impl Iterator<Item = [u64; 2]>) -> u64 {
    let [kept, temporary] = steps.fold([0, 0], |[kept, most], [left, own]| [kept + left, most.max(own)]);
    kept + temporary
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::DisplayJob;

    fn disk_of(change: impl FnOnce(&mut Job)) -> (Disk, u64) {
        let mut job = Job::new(DisplayJob::by_name_or_path("paper-three-layer"));
        job.scene = Some("a.glb".into());
        change(&mut job);
        let job = job.with_automatic_settings();
        let display = job.resolve_display().unwrap();
        let geometry = display.geometry().unwrap();
        let rays = geometry.grid.iter().count() * geometry.rows * geometry.cols;
        (Disk::of(&job, &display, &geometry, &[None, None]), rays as u64)
    }

    /// The filter of split views needs the most space: split views, shared light and filtered
    /// views. The split views are gone when the solver begins.
    #[test]
    fn the_largest_temporary_files_count_once() {
        let (disk, rays) = disk_of(|_| {});
        assert_eq!(rays, 625 * 840 * 525);
        let kinds = [StepKind::Trace, StepKind::Denoise, StepKind::Expose, StepKind::Score, StepKind::Patterns];
        let score = 2 * 32 * 840 * 525 * 12;
        assert_eq!(together(kinds.map(|kind| disk.of_step(kind)).into_iter()), (32 + 28 + 12 + 6) * rays + score);
        // a light field in memory needs no files but its views
        let (disk, rays) = disk_of(|job| job.display.resolution = Some([84, 53]));
        assert_eq!(disk.of_step(StepKind::Denoise), [12 * rays, 32 * rays]);
        assert_eq!(disk.of_step(StepKind::Patterns), [0, 0]);
        let (disk, rays) = disk_of(|job| job.render.denoise = Denoise::Off);
        assert_eq!([StepKind::Trace, StepKind::Denoise].map(|kind| disk.of_step(kind)), [[12 * rays, 0], [0, 0]]);
    }
}
