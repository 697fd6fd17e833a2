//! Writes light fields as folders in the formats of two public archives.
//!
//! * `hci/`: `input_Cam%03d.png`, numbered row by row from the top left, `parameters.cfg` and
//!   `gt_disp_lowres.pfm`. Cameras with shifted sensors are on a plane at the distance D from the
//!   display plane. Neighbouring cameras are b = D·Δs apart, where Δs is the step of slope between
//!   views. Let f = D / pixel pitch. Content at distance Z from the cameras has a disparity of
//!   b·f·(1/Z − 1/D) pixels between neighbouring cameras. In display space this content is at the
//!   depth z = D − Z, and its disparity is Δs·D·z/((D − z)·pitch). For parallel projections the
//!   disparity is Δs·z/pitch. `gt_disp_lowres.pfm` contains the disparities of the central view. If
//!   the host does not know the depth of this view, all these values are NaN. The range of
//!   disparities is then that of the display's depth of field, or 0 to 0 without a depth of field.
//! * `stanford/`: `out_RR_CC_<Y>_<X>.png`, with view row RR, view column CC and the camera's centre
//!   in millimetres, X right, Y down.
//!
//! A light field of parallel projections has no cameras. Its pictures are named and ordered like
//! those of cameras. The distances in its files are computed for cameras at a nominal distance D.

use lumistack_plugin::display::{FieldGeometry, Projection, SeenDepth, Transfer};
use lumistack_plugin::{Host, PluginError};

use crate::encode::{png8, png16, samples8, samples16};
use crate::views::ViewSource;

/// Length of the longer side of the cameras' sensors that `parameters.cfg` states, millimetres. The
/// value is arbitrary, since only its ratio to the focal length matters.
const SENSOR_MM: f64 = 36.0;
/// Largest difference between steps of slope that are regarded as equal, as a fraction of the
/// largest step.
const SAME_STEP: f64 = 1e-3;

/// The format of a public archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Archive {
    Hci,
    Stanford,
}

/// The cameras of a light field.
pub(crate) struct Cameras<'a> {
    pub(crate) geometry: &'a FieldGeometry,
    /// Camera distance for a light field of parallel projections, millimetres.
    pub(crate) nominal_mm: f64,
}

/// Settings of an archive's folder.
pub(crate) struct Settings<'a> {
    /// Camera distance for a light field of parallel projections, millimetres.
    pub(crate) nominal_mm: f64,
    /// True for pictures of 16 bits, false for 8 bits.
    pub(crate) sixteen_bits: bool,
    /// [date, authors, contact] for `parameters.cfg`.
    pub(crate) meta: [&'a str; 3],
    /// The display's depth of field, millimetres.
    pub(crate) shown_mm: Option<[f64; 2]>,
}

impl Cameras<'_> {
    pub(crate) fn distance_mm(&self) -> f64 {
        match self.geometry.grid.projection {
            Projection::Perspective { distance_mm } => distance_mm,
            Projection::Oblique => self.nominal_mm,
        }
    }

    pub(crate) fn is_nominal(&self) -> bool {
        self.geometry.grid.projection == Projection::Oblique
    }

    /// Returns the path of a view's picture in the output's folder.
    pub(crate) fn file(&self, archive: Archive, [y, x]: [usize; 2]) -> String {
        let grid = &self.geometry.grid;
        match archive {
            Archive::Hci => format!("hci/input_Cam{:03}.png", y * grid.slope_x.len() + x),
            Archive::Stanford => {
                let (down, right) = (-grid.slope_y[y] * self.distance_mm(), grid.slope_x[x] * self.distance_mm());
                // The sum with 0.0 removes the sign of a negative zero.
                format!("stanford/out_{y:02}_{x:02}_{:.6}_{:.6}.png", down + 0.0, right + 0.0)
            }
        }
    }

    /// Returns the step of slope between neighbouring views.
    ///
    /// # Errors
    /// If the steps differ, since the HCI format states a single distance between cameras.
    pub(crate) fn step(&self) -> Result<f64, PluginError> {
        let grid = &self.geometry.grid;
        let steps = |slopes: &[f64]| slopes.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect::<Vec<_>>();
        let all: Vec<f64> = steps(&grid.slope_x).into_iter().chain(steps(&grid.slope_y)).collect();
        let (low, high) =
            all.iter().fold((f64::INFINITY, 0.0f64), |(low, high), step| (low.min(*step), high.max(*step)));
        if high - low > SAME_STEP * high {
            return Err(PluginError::Refused(format!(
                "parameter `hci`: expected equal steps of slope between all views, since the format has one distance between cameras, found {low:.6} to {high:.6}. Use `stanford`, which stores the centre of every camera"
            )));
        }
        Ok(if all.is_empty() { 0.0 } else { all.iter().sum::<f64>() / all.len() as f64 })
    }

    /// Returns the disparity of content at `z_mm`, in pixels: the shift to the left between a view
    /// and its right neighbour. `z_mm` = −∞ stands for content at infinite distance.
    fn disparity(&self, step: f64, z_mm: f64) -> f64 {
        let moved_mm = match self.geometry.grid.projection {
            Projection::Oblique => z_mm,
            Projection::Perspective { distance_mm } if z_mm == f64::NEG_INFINITY => -distance_mm,
            Projection::Perspective { distance_mm } if z_mm >= distance_mm => f64::INFINITY,
            Projection::Perspective { distance_mm } => distance_mm * z_mm / (distance_mm - z_mm),
        };
        step * moved_mm / self.geometry.pitch_mm
    }

    /// Returns the disparities of the central view, `[row][col]`. All are NaN if the depth is
    /// unknown. A pixel without a hit is NaN in parallel projections, since content at infinite
    /// distance has an infinite disparity there.
    fn disparities(&self, step: f64, depth: Option<&SeenDepth>) -> Vec<f32> {
        let [rows, cols] = [self.geometry.rows, self.geometry.cols];
        let horizon = self.disparity(step, f64::NEG_INFINITY);
        let at = |row: usize, col: usize| match depth {
            None => f64::NAN,
            Some(depth) => match depth.at(row, col, [rows, cols]) {
                Some(z_mm) => self.disparity(step, f64::from(z_mm)),
                None if horizon.is_finite() => horizon,
                None => f64::NAN,
            },
        };
        (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))).map(|(row, col)| at(row, col) as f32).collect()
    }

    /// Returns the text of `parameters.cfg`.
    fn parameters(&self, step: f64, disparities: &[f32], settings: &Settings<'_>) -> String {
        let grid = &self.geometry.grid;
        let distance_mm = self.distance_mm();
        // The depth of field may reach to infinity or to the cameras, where disparities may be
        // infinite. So limit disparities to the length of a picture's longer side.
        let most = self.geometry.rows.max(self.geometry.cols) as f64;
        let shown = settings.shown_mm.map(|[low, high]| {
            let disparity = |z_mm: f64| {
                let at = self.disparity(step, z_mm);
                if at.is_nan() { 0.0 } else { at.clamp(-most, most) }
            };
            [disparity(low), disparity(high)]
        });
        let known =
            disparities.iter().filter(|value| value.is_finite()).fold(None, |range: Option<[f64; 2]>, value| {
                let value = f64::from(*value);
                Some(range.map_or([value; 2], |[low, high]| [low.min(value), high.max(value)]))
            });
        // Readers of the format require numbers, so an unknown range of disparities is written as 0
        // to 0.
        let [least, largest] = known.or(shown).unwrap_or([0.0; 2]);
        let [shown_least, shown_largest] = shown.unwrap_or([least, largest]);
        let disparity_note = if known.is_some() {
            "# Disparities are those of the surfaces that the central view sees; they are computed, not estimated.\n"
        } else {
            "# The depth of the views is not known: disp_min and disp_max are those of the display's depth of field, and gt_disp_lowres.pfm contains NaN.\n"
        };
        let [date, authors, contact] = settings.meta.map(|text| text.replace(['\n', '\r'], " ").replace('%', "%%"));
        let [rows, cols] = [self.geometry.rows, self.geometry.cols];
        let focal_mm = SENSOR_MM * distance_mm / (self.geometry.pitch_mm * rows.max(cols) as f64);
        let note = if self.is_nominal() {
            "# The views are parallel projections, which no camera takes: distances and focal length are those of cameras at a nominal distance.\n"
        } else {
            ""
        };
        format!(
            "{note}{disparity_note}[intrinsics]\nfocal_length_mm = {focal_mm}\nimage_resolution_x_px = {cols}\nimage_resolution_y_px = {rows}\n\
             sensor_size_mm = {SENSOR_MM}\nfstop = 100\n\n\
             [extrinsics]\nnum_cams_x = {}\nnum_cams_y = {}\nbaseline_mm = {}\nfocus_distance_m = {}\n\
             center_cam_x_m = 0.0\ncenter_cam_y_m = 0.0\ncenter_cam_z_m = {}\ncenter_cam_rx_rad = 0.0\ncenter_cam_ry_rad = 0.0\ncenter_cam_rz_rad = 0.0\noffset = {}\n\n\
             [meta]\nscene = light field\ncategory = other\ndate = {date}\nversion = 1\nauthors = {authors}\ncontact = {contact}\n\
             disp_min = {least}\ndisp_max = {largest}\nfrustum_disp_min = {shown_least}\nfrustum_disp_max = {shown_largest}\n\
             depth_map_scale = 1.0\n",
            grid.slope_x.len(),
            grid.slope_y.len(),
            step * distance_mm,
            distance_mm / 1000.0,
            distance_mm / 1000.0,
            // `offset` is the shift between the sensors of neighbouring cameras, pixels.
            step * distance_mm / self.geometry.pitch_mm,
        )
    }
}

/// Writes the folder of an archive: all views and the other files. Returns the path of every
/// view's picture, with the view [view_y, view_x].
pub(crate) fn write(
    host: &Host,
    archive: Archive,
    folder: &str,
    source: &ViewSource<'_>,
    settings: &Settings<'_>,
) -> Result<Vec<(String, [usize; 2])>, PluginError> {
    let geometry = source.geometry();
    let cameras = Cameras { geometry, nominal_mm: settings.nominal_mm };
    // The HCI format requires equal distances between cameras, so check these before any file of
    // the folder is written.
    let step = match archive {
        Archive::Hci => Some(cameras.step()?),
        Archive::Stanford => None,
    };
    let size = [geometry.rows, geometry.cols];
    let views = geometry.grid.views();
    let stage = host.stage("light-field folder", (views[0] * views[1]) as u64, "views");
    let mut files = Vec::new();
    for view in geometry.grid.iter() {
        host.check_cancelled()?;
        let rgb = source.view(view)?;
        let bytes = if settings.sixteen_bits {
            png16(&samples16(&Transfer::Srgb, None, size, &rgb), size, &Transfer::Srgb)?
        } else {
            png8(&samples8(&Transfer::Srgb, None, size, &rgb), size, &Transfer::Srgb)?
        };
        let file = format!("{folder}{}", cameras.file(archive, view));
        host.write(&file, &bytes)?;
        files.push((file, view));
        stage.advance(1, "");
    }
    // Write the parameters of the cameras and the disparities, which only the HCI format has.
    if let Some(step) = step {
        let disparities = cameras.disparities(step, source.depth());
        let parameters = cameras.parameters(step, &disparities, settings);
        host.write(&format!("{folder}hci/parameters.cfg"), parameters.as_bytes())?;
        host.write(&format!("{folder}hci/gt_disp_lowres.pfm"), &pfm(&disparities, size))?;
    }
    Ok(files)
}

/// Encodes one channel as a portable float map: a header of text, then little-endian `f32` values
/// with the lowest row first.
fn pfm(values: &[f32], [rows, cols]: [usize; 2]) -> Vec<u8> {
    let mut bytes = format!("Pf\n{cols} {rows}\n-1.0\n").into_bytes();
    for row in values.chunks_exact(cols).rev() {
        bytes.extend(row.iter().flat_map(|value| value.to_le_bytes()));
    }
    bytes
}
