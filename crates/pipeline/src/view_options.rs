//! Options of a render that writes only views, without patterns: a selection of views, scene-linear
//! radiance, additional channels.

use std::str::FromStr;

use lumistack_display::Display;
use lumistack_pathtracer::Settings;

use crate::error::PipelineError;
use crate::job::{Engine, Job};

/// Options of `render_views`.
#[derive(Clone, Debug, Default)]
pub struct ViewOptions {
    /// If true, the views are scene-linear radiance in 32-bit floats, without exposure, tone curve,
    /// clipping and background.
    pub linear: bool,
    /// Additional channels of every view.
    pub channels: Vec<ExtraChannel>,
    /// Views to render; all if empty.
    pub only: Vec<ViewSelection>,
}

/// An additional channel of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExtraChannel {
    /// Depth z in display space, millimetres. It is the depth of the first hit on the path nearest
    /// to the pixel's centre. In a scene with splats, it is the depth of the first surface or splat
    /// at the pixel's centre.
    Depth,
    /// Mean shading normal of the first hits.
    Normal,
    /// Mean albedo of the first hits.
    Albedo,
    /// Variance of a view's radiance.
    Variance,
    /// Fraction of a pixel's samples that hit a surface.
    Coverage,
}

/// A selection of views by row and column. Rows and columns have the numbers in the names of the
/// views' files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewSelection {
    /// First and last row, then first and last column; `None` selects all rows or columns.
    axes: [Option<[usize; 2]>; 2],
}

impl ExtraChannel {
    pub(crate) const ALL: [(&str, Self); 5] = [
        ("depth", Self::Depth),
        ("normal", Self::Normal),
        ("albedo", Self::Albedo),
        ("variance", Self::Variance),
        ("coverage", Self::Coverage),
    ];

    /// Returns the names of the channels in the file.
    pub(crate) fn channels(self) -> &'static [&'static str] {
        match self {
            Self::Depth => &["depth.Z"],
            Self::Normal => &["normal.X", "normal.Y", "normal.Z"],
            Self::Albedo => &["albedo.R", "albedo.G", "albedo.B"],
            Self::Variance => &["variance.R", "variance.G", "variance.B"],
            Self::Coverage => &["coverage.A"],
        }
    }

    /// Returns the unit and the meaning of the channel, for the folder's `lightfield.json`.
    pub(crate) fn about(self) -> [&'static str; 2] {
        match self {
            Self::Depth => [
                "mm",
                "z of the first surface on the path nearest to the pixel's centre, in display space: 0 on the display plane, above 0 in front of it; NaN without a surface",
            ],
            Self::Normal => {
                ["1", "mean shading normal on the viewer's side: x right, y up, z to the viewer; 0 without a surface"]
            }
            Self::Albedo => {
                ["1", "mean reflectance of the first surfaces, 0..1: base colour plus a dielectric's few percent"]
            }
            Self::Variance => [
                "radiance²",
                "variance of the view's scene-linear radiance before exposure and denoising: the variance of the samples divided by their number",
            ],
            Self::Coverage => ["1", "fraction of the pixel's samples that hit a surface, 0..1"],
        }
    }
}

impl FromStr for ExtraChannel {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(known, _)| *known == name);
        let expected = "expected depth, normal, albedo, variance or coverage";
        found.map(|&(_, layer)| layer).ok_or_else(|| format!("{expected}, found {name}"))
    }
}

impl FromStr for ViewSelection {
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
    /// Returns true if the variance is requested.
    pub(crate) fn variance(&self) -> bool {
        self.channels.contains(&ExtraChannel::Variance)
    }

    /// Returns true if channels of the first hits are requested.
    pub(crate) fn surfaces(&self) -> bool {
        self.channels.iter().any(|channel| *channel != ExtraChannel::Variance)
    }

    /// Checks that a job with this display and number of views can write the selected views and
    /// channels.
    pub(crate) fn check(&self, job: &Job, display: &Display, views: usize) -> Result<(), PipelineError> {
        let fail =
            |flag: &str, expected: &str, found: String| Err(PipelineError::value("render", flag, expected, found));
        let denoise = job.render.denoise;
        if !self.only.is_empty() && denoise.filters() {
            let expected = "`--denoise off`, since the filter works on all views together";
            return fail("--only-views", expected, format!("`--denoise {}`", denoise.name()));
        }
        if self.variance() {
            if job.render.engine == Engine::Blender {
                return fail("--layers", "our path tracer for the layer `variance`", "`--engine blender`".into());
            }
            // A measured number of paths is not known yet; see `least_samples`.
            let (least, samples) = (self.least_samples(job, display), job.render.samples_of_view(views));
            if samples < least && !job.render.samples_are_measured() {
                let expected = format!("at least {least} paths per pixel and view for the layer `variance`");
                return fail("--layers", &expected, samples.to_string());
            }
        }
        Ok(())
    }

    /// Returns the smallest number of paths per pixel and view that the channels need. The variance
    /// of a mean needs two paths, or three if the filter compares two halves of the paths. If paths
    /// are sparse, a pixel gets at least a quarter of the view's paths, so a view needs eight.
    pub(crate) fn least_samples(&self, job: &Job, display: &Display) -> u32 {
        let is_sparse = job.split_settings(Settings::default(), display).sparse_paths;
        match (self.variance(), job.render.denoise.takes_halves()) {
            (false, _) => 1,
            (true, true) => 3,
            (true, false) if is_sparse => 8,
            (true, false) => 2,
        }
    }

    /// Returns the views to render, `[view_y, view_x]`, in row order. `views` is [number of rows,
    /// number of columns].
    pub(crate) fn chosen(&self, views: [usize; 2]) -> Result<Vec<[usize; 2]>, PipelineError> {
        for ViewSelection { axes } in &self.only {
            for (axis, (name, count)) in axes.iter().zip([("row", views[0]), ("column", views[1])]) {
                if let Some([_, last]) = axis
                    && *last >= count
                {
                    let expected = format!(
                        "a {name} from 0 to {} (the views have {} rows and {} columns)",
                        count - 1,
                        views[0],
                        views[1]
                    );
                    return Err(PipelineError::value("render", "--only-views", expected, last.to_string()));
                }
            }
        }
        let is_chosen = |view: &[usize; 2]| {
            let holds = |pick: &ViewSelection| {
                let of_axis =
                    |axis: usize| pick.axes[axis].is_none_or(|[first, last]| (first..=last).contains(&view[axis]));
                of_axis(0) && of_axis(1)
            };
            self.only.is_empty() || self.only.iter().any(holds)
        };
        Ok((0..views[0]).flat_map(|y| (0..views[1]).map(move |x| [y, x])).filter(is_chosen).collect())
    }
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
        assert!(error.contains("a row from 0 to 2 (the views have 3 rows and 4 columns), found 3"), "{error}");
        for wrong in ["1", "a,1", "2..1,0", "1,2,3", "-1,0", ""] {
            assert!(wrong.parse::<ViewSelection>().is_err(), "{wrong}");
        }
    }
}
