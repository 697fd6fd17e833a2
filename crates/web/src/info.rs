//! What the page is told about a preview.

use lumistack_display::{Backlight, FieldGeometry, Formation, Projection};
use serde::Serialize;

use crate::colour::{HEAT_TOP, heat_stops};
use crate::preview::{File, Part, Preview};

/// Everything that the page shows or needs.
#[derive(Serialize)]
pub(crate) struct Info<'a> {
    title: &'a str,
    field: Field,
    layers: Vec<LayerInfo>,
    directional: bool,
    /// Size of a frame's emission, bins side by side.
    #[serde(skip_serializing_if = "Option::is_none")]
    backlight: Option<Size>,
    frames: usize,
    refresh_hz: f64,
    brightness: f64,
    formation: Formation,
    views: Views,
    zone: Zone,
    heat: Heat,
    rounding_db: Option<f64>,
    files: &'a [File],
}

#[derive(Serialize)]
struct Size {
    rows: usize,
    cols: usize,
}

#[derive(Serialize)]
struct Field {
    rows: usize,
    cols: usize,
    width_mm: f64,
    height_mm: f64,
}

#[derive(Serialize)]
struct LayerInfo {
    rows: usize,
    cols: usize,
    width_mm: f64,
    height_mm: f64,
    d_mm: f64,
    pitch_mm: f64,
    black_level: f64,
}

#[derive(Serialize)]
struct Views {
    rows: usize,
    cols: usize,
    /// [s_x, s_y], row by row.
    slopes: Vec<[f64; 2]>,
    projection: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance_mm: Option<f64>,
}

/// Half angles.
#[derive(Serialize)]
struct Zone {
    x_rad: f64,
    y_rad: f64,
}

/// Scale of the error map.
#[derive(Serialize)]
struct Heat {
    max: f32,
    stops: Vec<String>,
}

impl<'a> Info<'a> {
    pub(crate) fn of(preview: &'a Preview, geometry: &FieldGeometry) -> Self {
        let (display, grid) = (&preview.display, &geometry.grid);
        let directional = matches!(display.backlight, Backlight::Lenslets(_));
        let layers = display.layers.iter().map(|layer| {
            let [cols, rows] = layer.resolution;
            let [width_mm, height_mm] = [cols, rows].map(|count| count as f64 * layer.pitch_mm);
            let (d_mm, pitch_mm, black_level) = (layer.d_mm, layer.pitch_mm, layer.black_level);
            LayerInfo { rows, cols, width_mm, height_mm, d_mm, pitch_mm, black_level }
        });
        let [rows, cols] = grid.views();
        let (projection, distance_mm) = match grid.projection {
            Projection::Oblique => ("oblique", None),
            Projection::Perspective { distance_mm } => ("perspective", Some(distance_mm)),
        };
        let slopes = grid.iter().map(|[y, x]| [grid.slope_x[x], grid.slope_y[y]]).collect();
        // one view promises nothing beside it
        let half =
            |axis: usize, views: usize| if views == 1 { 0.0 } else { 0.5 * display.field.fov_deg[axis].to_radians() };
        let [width_mm, height_mm] = geometry.size_mm();
        Self {
            title: &preview.title,
            field: Field { rows: geometry.rows, cols: geometry.cols, width_mm, height_mm },
            layers: layers.collect(),
            directional,
            backlight: directional.then(|| {
                let [rows, cols] = preview.size_of(Part::Emission { frame: 0 });
                Size { rows, cols }
            }),
            frames: preview.frames,
            refresh_hz: display.refresh_hz,
            brightness: preview.brightness,
            formation: display.formation,
            views: Views { rows, cols, slopes, projection, distance_mm },
            zone: Zone { x_rad: half(0, cols), y_rad: half(1, rows) },
            heat: Heat { max: HEAT_TOP, stops: heat_stops().to_vec() },
            rounding_db: preview.rounding_db,
            files: &preview.files,
        }
    }
}
