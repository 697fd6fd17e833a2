//! The designs of a sweep, and the light fields that they need.

use std::path::Path;

use lumistack_design::table::Design;
use lumistack_display::{Display, Variation, Views};

use crate::error::{PipelineError, display_error};
use crate::job::{DisplayJob, FitDepth, Job, SweepJob};
use crate::stage::design::Candidate;

/// Returns all distinct designs, and a job for each light field that they need.
///
/// # Errors
/// If a display cannot be loaded, a combination is invalid, or a job without a scene has
/// `sweep.fov_deg`.
pub(crate) fn all(job: &Job, sweep: &SweepJob) -> Result<(Vec<Candidate>, Vec<Job>), PipelineError> {
    let bases: Vec<(String, DisplayJob)> = if sweep.displays.is_empty() {
        let own = &job.display;
        let stem = |path: &Path| path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let name = own.preset.clone().or_else(|| own.file.as_deref().and_then(stem)).unwrap_or_default();
        vec![(name, own.clone())]
    } else {
        bases(job, &sweep.displays)
    };
    if !sweep.fov_deg.is_empty() && job.scene.is_none() {
        return Err(PipelineError::job(
            "sweep.fov_deg",
            "a job with a scene, which can be rendered with other angles",
            "a job without a scene",
        ));
    }
    // Keep only the first of equal displays. Displays are equal if their combinations differ only
    // in values without effect, for example in the lenslets of a uniform backlight.
    let mut candidates: Vec<Candidate> = Vec::new();
    let mut fields: Vec<(Display, Job)> = Vec::new();
    for (name, display_job) in &bases {
        let base = display_job.resolve()?;
        for variation in variations(sweep) {
            let display =
                variation.applied_to(&base).map_err(|source| display_error(source, &format!("sweep of `{name}`")))?;
            let known = |other: &Candidate| other.design.display == *name && other.display == display;
            if candidates.iter().any(known) {
                continue;
            }
            // Displays with equal `[field]` share a light field.
            let field = match fields.iter().position(|(other, _)| other.field == display.field) {
                Some(field) => field,
                None => {
                    let shown =
                        DisplayJob { fov_deg: variation.fov_deg.or(display_job.fov_deg), ..display_job.clone() };
                    let mut of = Job { display: shown, sweep: None, outputs: Vec::new(), ..job.clone() };
                    of.render.outside = 0;
                    // All designs must show the same depth, so the depth of the scene is not
                    // compressed automatically.
                    if of.window.fit_depth == FitDepth::Auto {
                        of.window.fit_depth = FitDepth::Off;
                    }
                    // Time steps render the pictures for the zone score only if they have reports,
                    // so request reports.
                    of.sequence.iter_mut().for_each(|sequence| sequence.reports = true);
                    fields.push((display.clone(), of));
                    fields.len() - 1
                }
            };
            candidates.push(Candidate { design: Design::of(name, &display), display, field });
        }
    }
    // All displays that share a light field need the same views.
    let mut jobs: Vec<Job> = fields.into_iter().map(|(_, job)| job).collect();
    for (number, job) in jobs.iter_mut().enumerate() {
        choose_views(job, candidates.iter_mut().filter(|candidate| candidate.field == number));
    }
    Ok((candidates, jobs))
}

/// Chooses the same views for all displays whose views are automatic: the views of the display that
/// needs the most views. More views than a display needs only cost time, but fewer views reduce the
/// zone score of the display.
fn choose_views<'a>(job: &mut Job, candidates: impl Iterator<Item = &'a mut Candidate>) {
    let mut choosing: Vec<&mut Candidate> =
        candidates.filter(|candidate| candidate.display.field.views == Views::Auto).collect();
    let chosen = choosing.iter().map(|candidate| {
        let most = job.most_views(&candidate.display);
        candidate.display.clone().with_views_chosen(most)
    });
    let Some(finest) = chosen.max_by_key(|display| display.views().iter().product::<usize>()) else { return };
    job.display.views = Some(finest.field.views);
    for candidate in &mut choosing {
        candidate.display.field.views = finest.field.views;
        candidate.design = Design::of(&candidate.design.display, &candidate.display);
    }
}

/// Returns the name of each preset or display file, and the job's table `[display]` for it. The
/// name of a file is its stem, or the text of the job if another display has the same stem.
fn bases(job: &Job, texts: &[String]) -> Vec<(String, DisplayJob)> {
    let stem = |text: &str| Path::new(text).file_stem().map_or(text.into(), |stem| stem.to_string_lossy().into_owned());
    let one = |text: &String| {
        let is_shared = texts.iter().any(|other| other != text && stem(other) == stem(text));
        let named = DisplayJob::by_name_or_path(text);
        let file = named.file.map(|file| job.folder.join(file));
        let name = if is_shared { text.clone() } else { stem(text) };
        (name, DisplayJob { preset: named.preset, file, ..job.display.clone() })
    };
    texts.iter().map(one).collect()
}

/// Returns all combinations of the values of a sweep; the last parameter varies fastest.
fn variations(sweep: &SweepJob) -> Vec<Variation> {
    let mut all = vec![Variation::default()];
    expand(&mut all, &sweep.layers, |variation, layers| variation.layers = Some(layers));
    expand(&mut all, &sweep.frames, |variation, frames| variation.frames = Some(frames));
    expand(&mut all, &sweep.brightness, |variation, brightness| variation.brightness = Some(brightness));
    expand(&mut all, &sweep.gap_mm, |variation, gap_mm| variation.gap_mm = Some(gap_mm));
    expand(&mut all, &sweep.fov_deg, |variation, fov_deg| variation.fov_deg = Some(fov_deg));
    expand(&mut all, &sweep.lenslets, |variation, lenslets| variation.lenslets = Some(lenslets));
    all
}

fn expand<T: Copy>(all: &mut Vec<Variation>, values: &[T], set: impl Fn(&mut Variation, T)) {
    if values.is_empty() {
        return;
    }
    let old = std::mem::take(all);
    for (variation, &value) in old.iter().flat_map(|variation| values.iter().map(move |value| (variation, value))) {
        let mut variation = variation.clone();
        set(&mut variation, value);
        all.push(variation);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(sweep: SweepJob) -> Job {
        let display = DisplayJob { resolution: Some([16, 10]), ..DisplayJob::by_name_or_path("fig7-uniform") };
        Job { scene: Some("a.glb".into()), sweep: Some(sweep), ..Job::new(display) }
    }

    #[test]
    fn every_combination_comes_once() {
        let sweep = SweepJob {
            displays: vec!["fig7-uniform".into(), "fig7-directional".into()],
            layers: vec![1, 2, 3],
            frames: vec![1, 4],
            gap_mm: vec![40.0],
            lenslets: vec![[4, 3], [8, 6]],
            ..SweepJob::default()
        };
        assert_eq!(sweep.count(), 24);
        let (found, fields) = all(&job(sweep.clone()), &sweep).unwrap();
        // A uniform backlight has no lenslets, so combinations that differ only in lenslets are
        // equal.
        assert_eq!((found.len(), fields.len()), (6 + 12, 1));
        assert_eq!(found[5].design.layers, 3);
        assert!(found.iter().all(|candidate| candidate.field == 0 && candidate.display.field.resolution == [16, 10]));
    }

    #[test]
    fn displays_with_one_stem_have_different_names() {
        let names = |texts: &[&str]| -> Vec<String> {
            let texts: Vec<String> = texts.iter().map(|text| (*text).into()).collect();
            bases(&job(SweepJob::default()), &texts).into_iter().map(|(name, _)| name).collect()
        };
        assert_eq!(names(&["a/my.toml", "other.toml", "fig7-uniform"]), ["my", "other", "fig7-uniform"]);
        assert_eq!(names(&["a/my.toml", "b/my.toml", "my", "c.toml"]), ["a/my.toml", "b/my.toml", "my", "c"]);
        assert_eq!(names(&["a/my.toml", "a/my.toml"]), ["my", "my"], "one display");
    }

    #[test]
    fn every_field_of_view_is_a_light_field() {
        let sweep = SweepJob { fov_deg: vec![[20.0, 20.0], [40.0, 20.0]], frames: vec![1, 2], ..SweepJob::default() };
        let (found, fields) = all(&job(sweep.clone()), &sweep).unwrap();
        assert_eq!((found.len(), fields.len()), (4, 2));
        assert_eq!(fields[1].display.fov_deg, Some([40.0, 20.0]));
        assert!(fields.iter().all(|field| field.window.fit_depth == FitDepth::Off), "no light field compresses depth");
        let read = Job { scene: None, light_field: Some("a.npy".into()), ..job(sweep.clone()) };
        let error = all(&read, &sweep).unwrap_err().to_string();
        assert!(error.contains("sweep.fov_deg"), "{error}");
    }

    #[test]
    fn a_design_that_makes_no_sense_names_the_display() {
        let sweep = SweepJob { displays: vec!["fig7-directional".into()], layers: vec![3], ..SweepJob::default() };
        let error = all(&job(sweep.clone()), &sweep).unwrap_err().to_string();
        assert!(error.starts_with("sweep of `fig7-directional`: gap_mm"), "{error}");
    }
}
