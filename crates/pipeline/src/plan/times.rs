//! Time steps of a sequence. Each time step is the job of a still.
//!
//! Time steps differ in one or more of these: the file of the light field, the time of a source,
//! the position of the window, the pose of the scene.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use lumistack_factorizer::AUTO;
use lumistack_scene::{Similarity, Window};
use lumistack_shot::{Placement, ToneMapping};

use crate::error::PipelineError;
use crate::job::{FactorizeJob, FitDepth, Job, Near, NodeJob, PoseJob, SequenceJob, SourceJob, WindowFrom, WindowJob};
use crate::stage::design::Later;
use crate::stage::node::is_factorized;

/// The solver for time steps that start from the patterns of an earlier time step, if the job has
/// the solver `auto`.
///
/// If a solve starts from the patterns of another target and has few iterations, extrapolation
/// overshoots. These values were measured with content that moves 2 pixels per time step (3 layers,
/// 6 frames, 160 × 100 pixels, 5 × 5 views, 5 iterations):
///
/// | β | solver | PSNR (dB) | flicker (dB) |
/// |---|---|---|---|
/// | 0.2 | block-exact | 49.9 | 48.8 |
/// | 0.2 | extrapolated | 47.8 | 46.6 |
/// | 1 | block-exact | 45.3 | 45.8 |
/// | 1 | extrapolated | 45.3 | 45.3 |
///
/// From 8 to 12 iterations on, extrapolation gives a higher PSNR, but no better flicker score.
///
/// Patterns are not moved with the content. Moved patterns would make the start 4 dB better, but
/// the result only 0.1 to 0.4 dB better. This gain is not worth the memory of a second target.
const WARM_SOLVER: &str = "block-exact";

/// Folder in the folder of a sequence. For each time step that begins a chunk, it contains patterns
/// of earlier time steps.
pub(crate) const WARM_UP: &str = "cache/warm-up";
/// Default number of time steps before a chunk that are solved again.
///
/// In a measurement, a window turned by 0.4° per time step (84 × 52 pixels, 25 views, three layers,
/// three frames). One repeated time step was as good as two. Compared with a sequence without
/// chunks, the PSNR differed by at most 0.01 dB, and the flicker score was 0.5 dB lower. Since
/// content that moves faster needs more time steps, the default is 2.
const WARM_UP_TIMES: usize = 2;

/// The time steps of a job.
#[derive(Clone, Debug)]
pub(crate) struct Times {
    pub(crate) sequence: SequenceJob,
    /// Paths of the light fields, one per time step, if the sequence consists of files.
    fields: Vec<PathBuf>,
    count: usize,
}

/// Results of the first time step that all later time steps use.
#[derive(Clone, Copy)]
pub(crate) struct FirstTimeStep {
    /// Window and depth scale of the first time step.
    pub(crate) placement: Placement,
    /// True if automatic studio light was added to the scene.
    pub(crate) studio: bool,
    /// Exposure and tone curve, if the first time step has been exposed.
    pub(crate) tone_mapping: Option<ToneMapping>,
}

impl Times {
    /// Finds the light fields of a folder, or takes the number of time steps from the job.
    ///
    /// # Errors
    /// If the folder of light fields cannot be read, or has too few or too many light fields.
    pub(crate) fn find(job: &Job, sequence: &SequenceJob) -> Result<Self, PipelineError> {
        let fields = match (&job.scene, &job.light_field) {
            (None, Some(folder)) => light_fields(folder, sequence.times)?,
            _ => Vec::new(),
        };
        let count = if fields.is_empty() { sequence.times.unwrap_or(1) } else { fields.len() };
        Ok(Self { sequence: sequence.clone(), fields, count })
    }

    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// Returns the paths of the light fields, one per time step; empty if the sequence does not
    /// consist of files.
    pub(crate) fn into_fields(self) -> Vec<PathBuf> {
        self.fields
    }

    /// Returns true if the scene has the same pose in all time steps.
    pub(crate) fn shares_scene(&self) -> bool {
        self.sequence.duration_s == 0.0
    }

    /// Returns the earlier time steps that are solved again before `time`, if `time` begins a
    /// chunk. Returns an empty range for other time steps.
    pub(crate) fn warm_up(&self, time: usize) -> std::ops::Range<usize> {
        let begins = time > 0 && self.sequence.chunk_times.is_some_and(|chunk| time.is_multiple_of(chunk));
        let count = if begins { self.sequence.warm_up_times.unwrap_or(WARM_UP_TIMES) } else { 0 };
        time.saturating_sub(count)..time
    }

    /// Returns the folder of the patterns that a time step starts from, relative to the folder of
    /// the sequence. `None` for the first time step.
    pub(crate) fn start(&self, time: usize) -> Option<PathBuf> {
        let before = name(time.checked_sub(1)?);
        Some(if self.warm_up(time).is_empty() {
            before.into()
        } else {
            Path::new(WARM_UP).join(name(time)).join(before)
        })
    }

    /// Returns the job of one time step.
    ///
    /// A time step after the first starts from the patterns in `before`, the folder of
    /// [`start`](Self::start). Every time step has the exposure and tone curve of the first time
    /// step. `first_step` is `None` until the window of the first time step is placed.
    pub(crate) fn job(&self, job: &Job, time: usize, before: Option<&Path>, first_step: Option<FirstTimeStep>) -> Job {
        // Replace the light field, or the window and the pose.
        let mut of = Job { sequence: None, sweep: None, name: format!("{} {}", job.name, name(time)), ..job.clone() };
        if let Some(path) = self.fields.get(time) {
            of.light_field = Some(path.clone());
        }
        if let Some(first) = &job.source {
            of.source = Some(self.source_at(first, time));
        }
        if job.scene.is_some() {
            of.pose = pose_at(job, &self.sequence, self.share(time));
            if let Some(FirstTimeStep { placement, studio, .. }) = first_step {
                let window = moved(&placement.window, &self.sequence, self.share(time));
                of.window = WindowJob { depth_scale: placement.depth_scale, ..given(&window) };
                // Studio light is on or off for the whole sequence.
                of.light.automatic &= studio;
            }
            if !self.sequence.reports {
                // Time steps without reports need no views that only reports use.
                (of.render.held_out, of.render.outside, of.report.zone_directions) = (0, 0, 0);
            }
        }
        // A later time step starts from the patterns of the previous one, and has the exposure of
        // the first one.
        let Some(before) = before else { return of };
        for node in of.nodes.iter_mut().filter(|node| is_factorized(Some(node))) {
            let layers = before.join("nodes").join(&node.id).join("layers");
            node.factorize = Some(self.warm(node.factorize.as_ref().unwrap_or(&job.factorize), Some(layers)));
        }
        if of.nodes.is_empty() {
            of.factorize = self.warm(&job.factorize, Some(before.join("layers")));
        }
        if let Some(tone_mapping) =
            first_step.and_then(|first_step| first_step.tone_mapping).filter(|tone_mapping| tone_mapping.exposure > 0.0)
        {
            (of.light.automatic_exposure, of.light.exposure_ev) = (false, tone_mapping.exposure.log2());
            of.light.tone = tone_mapping.curve.into();
        }
        of
    }

    /// Returns the settings of a time step that starts from the patterns in `layers`.
    pub(crate) fn warm(&self, first: &FactorizeJob, layers: Option<PathBuf>) -> FactorizeJob {
        let solver = if first.solver == AUTO { WARM_SOLVER.into() } else { first.solver.clone() };
        let iterations = self.sequence.iterations;
        FactorizeJob { warm_start: layers, iterations: Some(iterations), coarse_levels: None, solver, ..first.clone() }
    }

    /// Returns the settings of a time step without a warm start, for content that differs too much
    /// from the content of the previous time step.
    pub(crate) fn fresh(&self, job: &Job, node: Option<&NodeJob>) -> FactorizeJob {
        let first = node.and_then(|node| node.factorize.as_ref()).unwrap_or(&job.factorize);
        FactorizeJob { warm_start: None, iterations: Some(self.sequence.iterations), ..first.clone() }
    }

    /// Describes the origin of a time step's light field, for the report.
    pub(crate) fn source(&self, job: &Job, time: usize) -> String {
        if let Some(path) = self.fields.get(time) {
            return path.display().to_string();
        }
        if let Some(first) = &job.source {
            return format!("{} at {:.3} s", first.plugin, self.source_at(first, time).time_s);
        }
        let (share, [x, y, z]) = (self.share(time), self.sequence.shift_mm);
        let turn = share * self.sequence.turn_deg;
        let shift = [x, y, z].map(|shift| format!("{:.1}", share * shift)).join(", ");
        let pose_s = pose_at(job, &self.sequence, share).time_s;
        let at = pose_s.map_or(String::new(), |time_s| format!("at {time_s:.3} s, "));
        format!("{at}window turned by {turn:.1}° and moved by ({shift}) mm")
    }

    fn source_at(&self, first: &SourceJob, time: usize) -> SourceJob {
        let time_s = first.time_s + self.share(time) * self.sequence.duration_s;
        SourceJob { time: first.time + time as u64, time_s, ..first.clone() }
    }

    /// Returns the fraction of the movement that is done: 0 at the first time step and 1 at the
    /// last.
    fn share(&self, time: usize) -> f64 {
        time as f64 / self.count.saturating_sub(1).max(1) as f64
    }
}

/// Returns a function for sequences that are solved in memory. It takes the settings of the first
/// time step, and returns the settings of later time steps with and without a warm start.
pub(crate) fn later(job: &Job) -> Later {
    let sequence = job.sequence.clone().unwrap_or_default();
    let times = Times { sequence, fields: Vec::new(), count: 1 };
    Box::new(move |first| {
        let fresh = FactorizeJob { warm_start: None, iterations: Some(times.sequence.iterations), ..first.clone() };
        [times.warm(first, None), fresh]
    })
}

/// Returns the name of a time step's folder.
pub(crate) fn name(time: usize) -> String {
    format!("t{:04}", time + 1)
}

/// Moves the window by a fraction of its whole movement. The window rotates about its vertical
/// axis, and moves along the axes that it has at the first time step.
fn moved(window: &Window, sequence: &SequenceJob, share: f64) -> Window {
    let map = window.scene_from_display;
    let turn = DQuat::from_rotation_y((share * sequence.turn_deg).to_radians());
    let scene_from_display = Similarity {
        rotation: map.rotation * turn,
        translation: map.point(share * DVec3::from_array(sequence.shift_mm)),
        ..map
    };
    Window { scene_from_display, ..*window }
}

/// Returns the pose of the first time step. Without a sequence, it is the pose of the job.
pub(crate) fn first_pose(job: &Job) -> PoseJob {
    job.sequence.as_ref().map_or_else(|| job.pose.clone(), |sequence| pose_at(job, sequence, 0.0))
}

/// Returns the pose after a fraction of the sequence's duration.
fn pose_at(job: &Job, sequence: &SequenceJob, share: f64) -> PoseJob {
    let mut pose = job.pose.clone();
    if sequence.duration_s != 0.0 {
        pose.time_s = Some(pose.time_s.unwrap_or_default() + share * sequence.duration_s);
    }
    pose
}

/// Returns the keys of a job's `[window]` that give this window.
fn given(window: &Window) -> WindowJob {
    let map = window.scene_from_display;
    WindowJob {
        from: WindowFrom::Given,
        centre: Some(map.translation.to_array()),
        forward: Some((map.rotation * DVec3::NEG_Z).to_array()),
        up: Some((map.rotation * DVec3::Y).to_array()),
        width: Some(map.scale * window.size_mm[0]),
        near: window.near_mm.map_or(Near::Off, |near| Near::At(near * map.scale)),
        // The first time step has compressed the depth already.
        fit_depth: FitDepth::Off,
        ..WindowJob::default()
    }
}

/// Returns the path of one light field per time step, sorted by name. The light fields are the
/// subfolders of `folder`. If `folder` has no subfolders, the light fields are its `.npy` files. If
/// `folder` has no `.npy` files either, the light fields are its pictures.
fn light_fields(folder: &Path, times: Option<usize>) -> Result<Vec<PathBuf>, PipelineError> {
    let error = |source| PipelineError::Read { path: folder.to_owned(), source };
    let mut entries = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(error)? {
        entries.push(entry.map_err(error)?.path());
    }
    let hidden = |path: &PathBuf| path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    entries.retain(|path| !hidden(path));
    let has_extension = |path: &Path, wanted: &[&str]| {
        path.extension().is_some_and(|found| wanted.iter().any(|wanted| found.eq_ignore_ascii_case(wanted)))
    };
    // Pictures next to folders or arrays are previews, so only the first kind that exists is used.
    let kinds: [&dyn Fn(&Path) -> bool; 3] = [&|path| path.is_dir(), &|path| has_extension(path, &["npy"]), &|path| {
        has_extension(path, &["png", "jpg", "jpeg", "exr", "hdr"])
    }];
    let found = kinds.iter().map(|kind| entries.iter().filter(|path| kind(path)).cloned().collect::<Vec<_>>());
    let mut paths = found.into_iter().find(|paths| !paths.is_empty()).unwrap_or_default();
    paths.sort_by_cached_key(|path| natural(&path.file_name().unwrap_or_default().to_string_lossy()));
    let wanted = times.unwrap_or(paths.len());
    let expected = match times {
        Some(times) => format!("at least {times} light fields, one per time step"),
        None => format!("1 to {} light fields, one per time step", SequenceJob::MOST),
    };
    if paths.len() < wanted || !(1..=SequenceJob::MOST).contains(&wanted) {
        let found = format!("{} (folders, .npy files and pictures can be light fields)", paths.len());
        return Err(PipelineError::value(folder, "content of the folder", expected, found));
    }
    paths.truncate(wanted);
    Ok(paths)
}

/// Returns a sort key that orders names by the value of their numbers: "t2" before "t10".
fn natural(name: &str) -> Vec<(String, u128, String)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let digits = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, after) = rest.split_at(digits);
        let end = after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len());
        let (number, after) = after.split_at(end);
        // Numbers of more than 128 bits sort last, by their text.
        parts.push((
            text.into(),
            number.parse().unwrap_or(if number.is_empty() { 0 } else { u128::MAX }),
            number.into(),
        ));
        rest = after;
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_sort_by_value() {
        let mut names = ["t10", "t2", "t0001", "a9b12.npy", "a9b2.npy", "t", "a10b1.npy"];
        names.sort_by_cached_key(|name| natural(name));
        assert_eq!(names, ["a9b2.npy", "a9b12.npy", "a10b1.npy", "t", "t0001", "t2", "t10"]);
    }

    #[test]
    fn folders_go_before_arrays_and_arrays_before_pictures() {
        let folder = tempfile::tempdir().unwrap();
        let list = |times| {
            light_fields(folder.path(), times).map(|paths| {
                paths.iter().map(|p| p.file_name().unwrap().to_string_lossy().into_owned()).collect::<Vec<_>>()
            })
        };
        assert!(list(None).unwrap_err().to_string().contains("found 0 (folders"));
        std::fs::write(folder.path().join("notes.txt"), "").unwrap();
        std::fs::write(folder.path().join("a_qs3x3.png"), "").unwrap();
        assert_eq!(list(None).unwrap(), ["a_qs3x3.png"]);
        for name in ["f10.npy", "f9.npy", ".f1.npy", "f9.json"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        assert_eq!(list(None).unwrap(), ["f9.npy", "f10.npy"]);
        assert_eq!(list(Some(1)).unwrap(), ["f9.npy"]);
        assert!(list(Some(3)).unwrap_err().to_string().contains("at least 3 light fields"));
        std::fs::create_dir(folder.path().join("t1")).unwrap();
        assert_eq!(list(None).unwrap(), ["t1"]);
    }

    #[test]
    fn the_pose_goes_from_its_own_time_over_the_duration() {
        let job = Job {
            pose: PoseJob { time_s: Some(0.5), ..PoseJob::default() },
            ..Job::new(crate::job::DisplayJob::by_name_or_path("fig7-uniform"))
        };
        let sequence = SequenceJob { duration_s: 2.0, ..SequenceJob::default() };
        assert_eq!([0.0, 0.25, 1.0].map(|share| pose_at(&job, &sequence, share).time_s), [0.5, 1.0, 2.5].map(Some));
        let still = Job { pose: PoseJob::default(), ..job };
        assert_eq!(pose_at(&still, &sequence, 0.5).time_s, Some(1.0));
        assert_eq!(pose_at(&still, &SequenceJob::default(), 0.5).time_s, None);
    }

    #[test]
    fn a_window_that_turns_lets_the_viewer_walk_to_the_right() {
        let first = Window::given(DVec3::new(1.0, 2.0, 3.0), DVec3::NEG_Z, DVec3::Y, 4.0, [400.0, 250.0]).unwrap();
        let sequence = SequenceJob { turn_deg: 60.0, shift_mm: [100.0, 0.0, -50.0], ..SequenceJob::default() };
        assert_eq!(moved(&first, &sequence, 0.0), first);
        let half = moved(&first, &sequence, 0.5);
        // One millimetre is 0.01 scene units here. Half of the shift (100, 0, −50) mm moves the
        // window from (1, 2, 3) by (0.5, 0, −0.25).
        assert!((half.scene_from_display.translation - DVec3::new(1.5, 2.0, 2.75)).length() < 1e-12);
        let to_viewer = half.scene_from_display.rotation * DVec3::Z;
        assert!((to_viewer - DVec3::new(0.5, 0.0, 0.75f64.sqrt())).length() < 1e-12, "{to_viewer}");
        let job = given(&half);
        let [centre, forward, up] = [job.centre, job.forward, job.up].map(|v| DVec3::from_array(v.unwrap()));
        let again = Window::given(centre, forward, up, job.width.unwrap(), first.size_mm).unwrap();
        let corner = DVec3::new(200.0, 125.0, 10.0);
        assert!(
            (again.scene_from_display.point(corner) - half.scene_from_display.point(corner)).length() < 1e-12,
            "the keys of a job give the same window"
        );
    }
}
