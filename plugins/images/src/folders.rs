//! Light fields as the folders of two public archives.
//!
//! * `hci/`: `input_Cam%03d.png`, numbered row by row from the top left, and `parameters.cfg`. Cameras stand at distance D on a plane, b = D·Δs apart, with
//!   shifted sensors: disparity = b·f·(1/Z − 1/D) pixels a camera, f = D / pixel pitch.
//! * `stanford/`: `out_RR_CC_<Y>_<X>.png`, the camera's centre in millimetres, X right, Y down.
//!
//! A light field of parallel projections has no cameras at a distance. Its pictures are the same and so is their order; distances are then
//! those of cameras on a plane at a nominal D.

use lumistack_plugin::display::{FieldGeometry, Projection, Transfer};
use lumistack_plugin::{Host, PluginError};

use crate::encode::{png8, png16, samples8, samples16};
use crate::views::ViewSource;

/// Width or height of the sensor that is written, whichever is larger; any would do, since only its ratio to the focal length counts.
const SENSOR_MM: f64 = 36.0;
/// Largest relative difference of steps that count as equal.
const SAME_STEP: f64 = 1e-3;

/// Which archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Archive {
    Hci,
    Stanford,
}

/// What goes into the folders.
pub(crate) struct Cameras<'a> {
    pub(crate) geometry: &'a FieldGeometry,
    /// Distance of the cameras of a light field of parallel projections, millimetres.
    pub(crate) nominal_mm: f64,
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

    /// Name of a view's picture inside the output.
    pub(crate) fn file(&self, archive: Archive, [y, x]: [usize; 2]) -> String {
        let grid = &self.geometry.grid;
        match archive {
            Archive::Hci => format!("hci/input_Cam{:03}.png", y * grid.slope_x.len() + x),
            Archive::Stanford => {
                let (down, right) = (-grid.slope_y[y] * self.distance_mm(), grid.slope_x[x] * self.distance_mm());
                // without the sign of a zero
                format!("stanford/out_{y:02}_{x:02}_{:.6}_{:.6}.png", down + 0.0, right + 0.0)
            }
        }
    }

    /// `parameters.cfg`.
    ///
    /// # Errors
    /// If steps between views are not all the same: the format has one baseline.
    pub(crate) fn parameters(&self) -> Result<String, PluginError> {
        let grid = &self.geometry.grid;
        let steps = |slopes: &[f64]| slopes.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect::<Vec<_>>();
        let all: Vec<f64> = steps(&grid.slope_x).into_iter().chain(steps(&grid.slope_y)).collect();
        let (low, high) =
            all.iter().fold((f64::INFINITY, 0.0f64), |(low, high), step| (low.min(*step), high.max(*step)));
        if high - low > SAME_STEP * high {
            return Err(PluginError::Refused(format!(
                "parameter `hci`: the format has one distance between cameras, expected equal steps of slope between all views, found {low:.6} to {high:.6}; `stanford` has the centre of every camera"
            )));
        }
        let distance_mm = self.distance_mm();
        let step = if all.is_empty() { 0.0 } else { all.iter().sum::<f64>() / all.len() as f64 };
        let [rows, cols] = [self.geometry.rows, self.geometry.cols];
        let focal_mm = SENSOR_MM * distance_mm / (self.geometry.pitch_mm * rows.max(cols) as f64);
        let note = if self.is_nominal() {
            "# The views are parallel projections, which no camera takes: distances and focal length are those of cameras at a nominal distance.\n"
        } else {
            ""
        };
        Ok(format!(
            "{note}[intrinsics]\nfocal_length_mm = {focal_mm}\nimage_resolution_x_px = {cols}\nimage_resolution_y_px = {rows}\n\
             sensor_size_mm = {SENSOR_MM}\nfstop = 100\n\n\
             [extrinsics]\nnum_cams_x = {}\nnum_cams_y = {}\nbaseline_mm = {}\nfocus_distance_m = {}\n\
             center_cam_x_m = 0.0\ncenter_cam_y_m = 0.0\ncenter_cam_z_m = {}\ncenter_cam_rx_rad = 0.0\ncenter_cam_ry_rad = 0.0\ncenter_cam_rz_rad = 0.0\noffset = 0\n\n\
             [meta]\nscene = light field\ncategory = other\nversion = 1\n",
            grid.slope_x.len(),
            grid.slope_y.len(),
            step * distance_mm,
            distance_mm / 1000.0,
            distance_mm / 1000.0,
        ))
    }
}

/// Writes all views of a folder, and what belongs to them.
pub(crate) fn write(
    host: &Host,
    archive: Archive,
    folder: &str,
    source: &ViewSource<'_>,
    nominal_mm: f64,
    sixteen_bits: bool,
) -> Result<Vec<(String, [usize; 2])>, PluginError> {
    let geometry = source.geometry();
    let cameras = Cameras { geometry, nominal_mm };
    let parameters = match archive {
        Archive::Hci => Some(cameras.parameters()?),
        Archive::Stanford => None,
    };
    let size = [geometry.rows, geometry.cols];
    let views = geometry.grid.views();
    let stage = host.stage("light-field folder", (views[0] * views[1]) as u64, "views");
    let mut files = Vec::new();
    for view in geometry.grid.iter() {
        host.check_cancelled()?;
        let rgb = source.view(view)?;
        let bytes = if sixteen_bits {
            png16(samples16(&Transfer::Srgb, None, size, &rgb), size)?
        } else {
            png8(&samples8(&Transfer::Srgb, None, size, &rgb), size)?
        };
        let file = format!("{folder}{}", cameras.file(archive, view));
        host.write(&file, &bytes)?;
        files.push((file, view));
        stage.advance(1, "");
    }
    if let Some(parameters) = parameters {
        host.write(&format!("{folder}hci/parameters.cfg"), parameters.as_bytes())?;
    }
    Ok(files)
}
