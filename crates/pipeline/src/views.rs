//! Views for other purposes than a display: some of them only, in scene-linear radiance, with layers of what they see.
//!
//! ```text
//! view_YY_XX.exr     R G B                                                   radiance
//! layers_YY_XX.exr   depth.Z  normal.X normal.Y normal.Z  albedo.R albedo.G albedo.B  variance.R variance.G variance.B  coverage.A
//! ```

use std::path::Path;
use std::str::FromStr;

use lumistack_core::Task;
use lumistack_field_io::picture::write_exr_channels;
use serde_json::{Map, Value, json};

use crate::denoise::FEATURE_SAMPLES;
use crate::error::{PipelineError, field_error};
use crate::fit::Placement;
use crate::ingest::Ingested;
use crate::job::{Denoise, Engine, Job};
use crate::render::{Rendered, render_error};

/// What `render_only` writes.
#[derive(Clone, Debug, Default)]
pub struct ViewOptions {
    /// Scene-linear radiance in single floats: neither exposed nor tone-mapped nor clipped, and without a background.
    pub linear: bool,
    /// What else is written of every view.
    pub layers: Vec<ViewLayer>,
    /// Views to render; none for all.
    pub only: Vec<ViewPick>,
}

/// What a view sees, besides its light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewLayer {
    /// z in display space of the first surface on the central ray of a pixel.
    Depth,
    /// Shading normal.
    Normal,
    /// Reflectance.
    Albedo,
    /// Variance of the radiance.
    Variance,
    /// Share of the pixel where a surface is.
    Coverage,
}

/// Views by row and column, as their files are named.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewPick {
    /// First and last row, then first and last column; `None` for all.
    axes: [Option<[usize; 2]>; 2],
}

impl ViewLayer {
    const ALL: [(&str, Self); 5] = [
        ("depth", Self::Depth),
        ("normal", Self::Normal),
        ("albedo", Self::Albedo),
        ("variance", Self::Variance),
        ("coverage", Self::Coverage),
    ];

    /// Channels in the file.
    fn channels(self) -> &'static [&'static str] {
        match self {
            Self::Depth => &["depth.Z"],
            Self::Normal => &["normal.X", "normal.Y", "normal.Z"],
            Self::Albedo => &["albedo.R", "albedo.G", "albedo.B"],
            Self::Variance => &["variance.R", "variance.G", "variance.B"],
            Self::Coverage => &["coverage.A"],
        }
    }

    /// Unit and meaning, for the folder's index.
    fn about(self) -> [&'static str; 2] {
        match self {
            Self::Depth => [
                "mm",
                "z of the first surface on the pixel's central ray in display space: 0 on the display plane, above 0 in front of it; NaN where there is none",
            ],
            Self::Normal => [
                "1",
                "mean shading normal on the viewer's side: x right, y up, z to the viewer; 0 where there is no surface",
            ],
            Self::Albedo => {
                ["1", "mean reflectance of the first surfaces, 0..1: base colour plus a dielectric's few percent"]
            }
            Self::Variance => [
                "radiance²",
                "variance of the view's scene-linear radiance before exposure and denoising: that of its samples over their number",
            ],
            Self::Coverage => ["1", "share of the pixel's samples that meet a surface, 0..1"],
        }
    }
}

impl FromStr for ViewLayer {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(known, _)| *known == name);
        found.map(|&(_, layer)| layer).ok_or_else(|| "expected depth, normal, albedo, variance or coverage".into())
    }
}

impl FromStr for ViewPick {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let axis = |text: &str| -> Option<Option<[usize; 2]>> {
            if text == "*" {
                return Some(None);
            }
            let (first, last) = text.split_once("..").unwrap_or((text, text));
            let range = [first.trim().parse().ok()?, last.trim().parse().ok()?];
            (range[0] <= range[1]).then_some(Some(range))
        };
        text.split_once(',')
            .and_then(|(rows, cols)| Some(Self { axes: [axis(rows.trim())?, axis(cols.trim())?] }))
            .ok_or_else(|| "expected ROW,COL as in view_ROW_COL.exr, each a number, a range such as 0..2, or *".into())
    }
}

impl ViewOptions {
    /// Whether variances are to be rendered.
    pub(crate) fn variance(&self) -> bool {
        self.layers.contains(&ViewLayer::Variance)
    }

    /// Checks that the job can give what is wanted.
    pub(crate) fn check(&self, job: &Job) -> Result<(), PipelineError> {
        let fail =
            |flag: &str, expected: &str, found: String| Err(PipelineError::value("render", flag, expected, found));
        let denoise = job.render.denoise;
        if !self.only.is_empty() && denoise != Denoise::Off {
            let expected = "`--denoise off`, since the denoiser works on all views together";
            return fail("--only-views", expected, format!("`--denoise {}`", denoise.name()));
        }
        if self.variance() {
            if job.render.engine == Engine::Blender {
                return fail("--layers", "`variance` of our own path tracer only", "`--engine blender`".into());
            }
            let least = if denoise == Denoise::Off { 2 } else { 3 };
            if job.render.samples < least {
                let expected = format!("at least {least} samples for `variance`");
                return fail("--layers", &expected, job.render.samples.to_string());
            }
        }
        Ok(())
    }

    /// The views to render, [view_y, view_x], row by row, of `views` = [rows, columns].
    pub(crate) fn chosen(&self, views: [usize; 2]) -> Result<Vec<[usize; 2]>, PipelineError> {
        for ViewPick { axes } in &self.only {
            for (axis, (name, count)) in axes.iter().zip([("row", views[0]), ("column", views[1])]) {
                if let Some([_, last]) = axis
                    && *last >= count
                {
                    let expected =
                        format!("a {name} of 0 to {}, of {} rows × {} columns", count - 1, views[0], views[1]);
                    return Err(PipelineError::value("render", "--only-views", expected, last.to_string()));
                }
            }
        }
        let is_chosen = |view: &[usize; 2]| {
            let holds = |pick: &ViewPick| {
                let of_axis =
                    |axis: usize| pick.axes[axis].is_none_or(|[first, last]| (first..=last).contains(&view[axis]));
                of_axis(0) && of_axis(1)
            };
            self.only.is_empty() || self.only.iter().any(holds)
        };
        Ok((0..views[0]).flat_map(|y| (0..views[1]).map(move |x| [y, x])).filter(is_chosen).collect())
    }
}

/// Writes the layers of every view that was rendered beside it; returns the folder index's account of them.
///
/// # Errors
/// When the scene cannot be rendered, a file cannot be written, or when cancelled.
pub(crate) fn write_layers(
    folder: &Path,
    job: &Job,
    options: &ViewOptions,
    rendered: &Rendered,
    ingested: &Ingested,
    placement: &Placement,
    task: Task<'_>,
) -> Result<Option<Value>, PipelineError> {
    if options.layers.is_empty() {
        return Ok(None);
    }
    let has = |layer| options.layers.contains(&layer);
    let (window, traced, kind) = (&placement.window, &rendered.traced.traced, job.render.denoise);
    let (settings, projection) = (rendered.traced.settings, rendered.target.geometry().grid.projection);
    lumistack_field_io::atomic::create_folder(folder).map_err(field_error)?;
    let renderer = ingested.renderer(task)?;
    task.progress.begin("layers", rendered.views.len() as u64, "views");
    let of_view = |view: [usize; 2]| -> Result<(), PipelineError> {
        let mut channels: Vec<(&str, Vec<f32>)> = Vec::new();
        if has(ViewLayer::Depth) {
            let depth = renderer.depth(window, traced, view, task).map_err(render_error)?;
            let shown = |z: &f32| projection.scaled_depth(f64::from(*z), placement.depth_scale) as f32;
            channels.push((ViewLayer::Depth.channels()[0], depth.data().iter().map(shown).collect()));
        }
        if has(ViewLayer::Normal) || has(ViewLayer::Albedo) {
            let filter = settings.angular_filter;
            let features = renderer.render_features(window, traced, view, FEATURE_SAMPLES, filter, task);
            let features = features.map_err(render_error)?;
            let [rows, cols] = [traced.rows, traced.cols];
            let pixels = || (0..rows).flat_map(move |row| (0..cols).map(move |col| (row, col)));
            for axis in 0..3 {
                if has(ViewLayer::Normal) {
                    let values = pixels().map(|(row, col)| features.at(row, col).normal[axis]).collect();
                    channels.push((ViewLayer::Normal.channels()[axis], values));
                }
                if has(ViewLayer::Albedo) {
                    let values = pixels().map(|(row, col)| features.at(row, col).albedo[axis]).collect();
                    channels.push((ViewLayer::Albedo.channels()[axis], values));
                }
            }
        }
        if has(ViewLayer::Variance) {
            let variance = rendered.traced.variance(view, kind)?;
            for (axis, name) in ViewLayer::Variance.channels().iter().enumerate() {
                channels.push((name, variance.iter().skip(axis).step_by(3).copied().collect()));
            }
        }
        if has(ViewLayer::Coverage) {
            let missed = rendered.traced.missed(view, kind, || Ok(renderer), window, task)?;
            channels.push((ViewLayer::Coverage.channels()[0], missed.iter().map(|missed| 1.0 - missed).collect()));
        }
        let views = rendered.target.geometry().grid.views();
        let name = lumistack_field_io::view_file_name(views, view).replacen("view_", "layers_", 1);
        let channels: Vec<(&str, &[f32])> = channels.iter().map(|(name, values)| (*name, values.as_slice())).collect();
        write_exr_channels(&folder.join(name), [traced.cols, traced.rows], &channels).map_err(field_error)?;
        task.progress.advance(1, "");
        Ok(())
    };
    let result = rendered.views.iter().try_for_each(|&view| of_view(view));
    task.progress.end();
    result?;
    let mut about = Map::new();
    about.insert("files".into(), "layers_YY_XX.exr, beside view_YY_XX.exr".into());
    about.insert("scene_units_per_mm".into(), placement.window.scene_from_display.scale.into());
    for (name, layer) in ViewLayer::ALL.iter().filter(|(_, layer)| has(*layer)) {
        let [unit, meaning] = layer.about();
        about.insert((*name).into(), json!({ "channels": layer.channels(), "unit": unit, "meaning": meaning }));
    }
    Ok(Some(about.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_picked_by_row_and_column() {
        let chosen = |picks: &[&str]| {
            let only = picks.iter().map(|pick| pick.parse().unwrap()).collect();
            ViewOptions { only, ..ViewOptions::default() }.chosen([3, 4])
        };
        assert_eq!(chosen(&[]).unwrap().len(), 12);
        assert_eq!(chosen(&["1,2"]).unwrap(), [[1, 2]]);
        assert_eq!(chosen(&["2,0..1", "0,*", "0,3"]).unwrap(), [[0, 0], [0, 1], [0, 2], [0, 3], [2, 0], [2, 1]]);
        let error = chosen(&["3,0"]).unwrap_err().to_string();
        assert!(error.contains("a row of 0 to 2, of 3 rows × 4 columns, found 3"), "{error}");
        for wrong in ["1", "a,1", "2..1,0", "1,2,3", "-1,0", ""] {
            assert!(wrong.parse::<ViewPick>().is_err(), "{wrong}");
        }
    }
}
