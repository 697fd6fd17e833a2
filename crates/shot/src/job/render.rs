//! `[render]`: settings of the rendering of views.

use std::borrow::Cow;
use std::fmt;

use lumistack_display::{Display, FieldGeometry, Views};
use lumistack_pathtracer::Settings;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::ShotError;

/// Settings of the rendering of views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RenderJob {
    /// Program that renders the views.
    pub engine: Engine,
    /// Paths per pixel of each view. Without this key, `zone_samples` are divided among the views.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<u32>,
    /// Paths per pixel, summed over all views. The solver averages all rays through a layer's
    /// pixel, so more views need fewer paths each.
    pub zone_samples: ZoneSamples,
    /// Greatest number of views that a display with `views = "auto"` chooses, 9 to 1000000. Fewer
    /// views take less time and memory. If the display has more native slopes, only every second
    /// native slope is used, or every third, and so on. Without this key, only the other limits of
    /// automatic views apply, such as 101 views per axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub most_views: Option<u32>,
    /// Largest memory of the light field while it is rendered, read and solved, MiB. A light field
    /// that needs more is kept in files, and only parts of it are in memory.
    pub field_mib: u64,
    /// Largest number of bounces of a path, the one at the first hit included. 0 shows emission
    /// only.
    pub max_bounces: u32,
    /// Largest value of a single path. Brighter paths are dimmed, which loses light. Without this
    /// key all light is kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clamp: Option<f32>,
    /// `point`: rays at the view's slope. `bin`: rays spread over the view's bin. `display`: rays
    /// spread over a range of slopes. Their average loses no detail that the display can show far
    /// from the display plane.
    pub angular_filter: AngularFilter,
    /// Aperture of a lens that is focused on the display plane: the full angle at which a point of
    /// the plane sees the lens, degrees. 0 is a pinhole. Content off the plane blurs. Above 0,
    /// `angular_filter` must be `point`.
    pub lens_deg: f64,
    /// Filter that removes noise from finished views, at the price of a bias that the report
    /// states.
    pub denoise: Denoise,
    /// Number of views per axis between the views of the light field, rendered for the report only;
    /// 0 for none.
    pub held_out: usize,
    /// Number of additional views to the left of the middle row, and as many to its right, one view
    /// spacing apart. A single column has them above and below instead. They are rendered for the
    /// report only; 0 for none.
    pub outside: usize,
}

/// Paths per pixel, summed over all views: `"auto"` or a number in files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ZoneSamples {
    /// The number above which further paths would hardly improve the display's picture. It is
    /// measured on small sections of the picture; without a measurement, it is 800.
    #[default]
    Auto,
    /// A fixed number, 1 to 2²⁴.
    Count(u32),
}

impl ZoneSamples {
    /// Number of paths if the number is not measured. For example, it is not measured for a fixed
    /// number of views, for filters that compare two halves of the paths, for views that Blender
    /// may render, and for estimates.
    const UNMEASURED: u32 = 800;
    /// Largest allowed number of paths.
    const MOST: u32 = 1 << 24;

    fn count(self) -> u32 {
        match self {
            Self::Auto => Self::UNMEASURED,
            Self::Count(count) => count,
        }
    }
}

impl std::str::FromStr for ZoneSamples {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            _ => text.parse().map(Self::Count).map_err(|_| "expected auto or a number of paths".into()),
        }
    }
}

impl Serialize for ZoneSamples {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::Count(count) => serializer.serialize_u32(*count),
        }
    }
}

impl<'de> Deserialize<'de> for ZoneSamples {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ZoneSamplesForm)
    }
}

impl JsonSchema for ZoneSamples {
    fn schema_name() -> Cow<'static, str> {
        "ZoneSamples".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "Paths per pixel of all views together: a number, or `auto`, which measures how many improve the display's picture.",
            "anyOf": [{ "const": "auto" }, { "type": "integer", "minimum": 1, "maximum": Self::MOST }],
        })
    }
}

/// Reads `"auto"` or a number, so that an error states both forms.
struct ZoneSamplesForm;

impl Visitor<'_> for ZoneSamplesForm {
    type Value = ZoneSamples;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"auto\" or a number from 1 to {}", ZoneSamples::MOST)
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<ZoneSamples, E> {
        if name == "auto" { Ok(ZoneSamples::Auto) } else { Err(E::invalid_value(Unexpected::Str(name), &self)) }
    }

    fn visit_u64<E: Error>(self, count: u64) -> Result<ZoneSamples, E> {
        let found = || E::invalid_value(Unexpected::Unsigned(count), &self);
        u32::try_from(count).map(ZoneSamples::Count).map_err(|_| found())
    }

    fn visit_i64<E: Error>(self, count: i64) -> Result<ZoneSamples, E> {
        let found = || E::invalid_value(Unexpected::Signed(count), &self);
        u64::try_from(count).map_err(|_| found()).and_then(|count| self.visit_u64(count))
    }
}

/// Program that renders the views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Engine {
    /// Lumistack's path tracer. Only a `.blend` file with content that the path tracer does not
    /// support is rendered by Blender, if Blender can render the job.
    #[default]
    Auto,
    /// Lumistack's path tracer.
    Lumistack,
    /// Blender, with the engine and the settings of the `.blend` file.
    Blender,
}

impl std::str::FromStr for Engine {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "auto" => Ok(Self::Auto),
            "lumistack" => Ok(Self::Lumistack),
            "blender" => Ok(Self::Blender),
            _ => Err("expected auto, lumistack or blender".into()),
        }
    }
}

/// Angular filter of a view: the slopes that it averages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AngularFilter {
    /// One slope per view.
    #[default]
    Point,
    /// Slopes spread over the view's bin.
    Bin,
    /// Slopes spread over the range that the display cannot separate far from the display plane,
    /// [`Display::angular_footprint`](lumistack_display::Display::angular_footprint).
    Display,
}

/// Filter that removes noise from finished views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Denoise {
    /// [`Shared`](Self::Shared) if the number of views is automatic and Lumistack's path tracer
    /// renders the views, otherwise [`Off`](Self::Off).
    #[default]
    Auto,
    /// No filter: views are unbiased.
    Off,
    /// For each surface point, averages the light that several views see alike. Diffuse light is
    /// averaged over the nearest views that see the point, and reflections of rough surfaces over
    /// neighbouring views.
    Shared,
    /// Lumistack's own filter, over all views together.
    Guided,
    /// Intel's Open Image Denoise, view by view, if it is installed.
    Oidn,
}

impl Denoise {
    /// All filters, with their names in jobs.
    pub const ALL: [(&str, Self); 5] = [
        ("auto", Self::Auto),
        ("off", Self::Off),
        ("shared", Self::Shared),
        ("guided", Self::Guided),
        ("oidn", Self::Oidn),
    ];

    /// Returns whether a filter changes the views. Callers first replace [`Auto`](Self::Auto) by
    /// the filter that it stands for; the result for `Auto` is false.
    pub fn filters(self) -> bool {
        !matches!(self, Self::Auto | Self::Off)
    }

    /// Returns whether the filter compares two halves of the samples.
    pub fn takes_halves(self) -> bool {
        matches!(self, Self::Guided | Self::Oidn)
    }

    /// Returns the filter's name in jobs.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

impl std::str::FromStr for Denoise {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(known, _)| *known == name);
        found.map(|&(_, kind)| kind).ok_or_else(|| "expected auto, off, shared, guided or oidn".into())
    }
}

impl Default for RenderJob {
    fn default() -> Self {
        Self {
            engine: Engine::Auto,
            samples: None,
            zone_samples: ZoneSamples::Auto,
            most_views: None,
            field_mib: 4096,
            max_bounces: 6,
            clamp: None,
            angular_filter: AngularFilter::Point,
            lens_deg: 0.0,
            denoise: Denoise::Auto,
            held_out: 0,
            outside: 1,
        }
    }
}

impl RenderJob {
    /// Memory of a light field per ray, in bytes, as [`is_held`](Self::is_held) assumes it. A ray
    /// needs less: 28 bytes while light is shared, and two copies of three channels as `f32` while
    /// patterns are solved.
    pub const BYTES_PER_RAY: u64 = 32;
    /// Smallest number of views of a light field whose paths are
    /// [sparse](Settings::sparse_paths). A mean over fewer views would contain too few paths.
    const MANY_VIEWS: usize = 25;
    /// Greatest number of rays for which a display chooses its views: 625 views of 840 × 525
    /// pixels. More would take hours.
    const MOST_RAYS: usize = 625 * 840 * 525;

    /// Returns whether a light field is kept in memory; a larger one is kept in files.
    pub fn is_held(&self, geometry: &FieldGeometry) -> bool {
        let rays = geometry.grid.iter().count() * geometry.rows * geometry.cols;
        Self::BYTES_PER_RAY * rays as u64 <= self.field_mib << 20
    }

    /// For each file of a light field, returns the number of bytes that may be in memory: a quarter
    /// of `field_mib`. At most two files are in use together. The other half of `field_mib` is for
    /// views and rows that are being processed.
    pub fn window_bytes(&self) -> usize {
        (self.field_mib << 18) as usize
    }

    /// Returns the greatest number of views of `pixels` pixels that a display chooses.
    pub fn most_chosen_views(&self, pixels: usize) -> usize {
        let by_time = Self::MOST_RAYS.div_ceil(pixels);
        self.most_views.map_or(by_time, |most| by_time.min(most as usize))
    }

    /// Returns the number of paths for each pixel of a view, if the light field has `views` views
    /// and the number is not measured.
    pub fn samples_of_view(&self, views: usize) -> u32 {
        let spread = (f64::from(self.zone_samples.count()) / views.max(1) as f64).round().clamp(1.0, 65536.0) as u32;
        // a filter that compares two halves of the paths needs at least two paths
        self.samples.unwrap_or(if self.denoise.takes_halves() { spread.max(2) } else { spread })
    }

    /// Adapts the settings of a split view to a display and a filter. All other settings stay. If
    /// views do not share light, they have neither further rays nor further or sparse paths.
    ///
    /// If the display chooses its views, a view with a single path per pixel has a [further
    /// ray](Settings::further_rays). This ray smooths edges and textures, and costs a sixth to a
    /// half of a path. If the display chooses many views, their [paths are
    /// sparse](Settings::sparse_paths). Only fixed views have [further
    /// paths](Settings::further_paths), since users may look at each fixed view alone. If a display
    /// chooses its views, the solver averages the noise that further paths would remove.
    pub fn split_settings(settings: Settings, display: &Display, denoise: Denoise) -> Settings {
        let shares = denoise == Denoise::Shared;
        let is_chosen = !matches!(display.field.views, Views::Fixed(_));
        let views = display.geometry().map_or(0, |geometry| geometry.grid.iter().count());
        Settings {
            further_rays: u32::from(shares && is_chosen && settings.samples == 1),
            further_paths: shares && !is_chosen,
            sparse_paths: shares && is_chosen && views >= Self::MANY_VIEWS,
            ..settings
        }
    }

    /// Returns whether these settings allow a measurement of the number of paths. The measurement
    /// relies on the noise of the views, which filters that compare halves change too much.
    pub fn samples_are_measured(&self) -> bool {
        self.samples.is_none() && self.zone_samples == ZoneSamples::Auto && !self.denoise.takes_halves()
    }

    /// Returns the number of views of `pixels` pixels that fill `field_mib`, rounded up.
    pub fn affordable_views(&self, pixels: usize) -> usize {
        (self.field_mib << 20).div_ceil(Self::BYTES_PER_RAY * pixels as u64) as usize
    }

    /// Makes the path tracer's settings for views of `samples` paths per pixel. With `hidden`,
    /// primary rays that miss all surfaces see black instead of the environment. `footprint` is the
    /// width of the display's prefilter in slopes, before depth is scaled.
    pub fn settings(&self, seed: u64, samples: u32, hidden: bool, depth_scale: f64, footprint: [f64; 2]) -> Settings {
        use lumistack_pathtracer::AngularFilter as Filter;
        Settings {
            samples,
            max_bounces: self.max_bounces,
            seed,
            clamp: self.clamp,
            angular_filter: match self.angular_filter {
                _ if self.lens_deg > 0.0 => Filter::Lens(depth_scale * 2.0 * (0.5 * self.lens_deg.to_radians()).tan()),
                AngularFilter::Point => Filter::Point,
                AngularFilter::Bin => Filter::Bin,
                AngularFilter::Display => Filter::Width(footprint.map(|width| depth_scale * width)),
            },
            hide_environment: hidden,
            ..Settings::default()
        }
    }

    /// Returns whether every setting is supported by renderers other than Lumistack's path tracer.
    pub fn is_plain(&self) -> bool {
        let kind = (self.angular_filter, self.lens_deg);
        kind == (AngularFilter::Point, 0.0) && !self.denoise.filters() && self.clamp.is_none()
    }

    /// Checks the ranges of values, which the parser does not check.
    pub fn check(&self) -> Result<(), ShotError> {
        let fail = |key: &str, expected: &str, found: String| Err(ShotError::job(key, expected, found));
        if let Some(samples) = self.samples.filter(|samples| !(1..=65536).contains(samples)) {
            return fail("render.samples", "1 to 65536", samples.to_string());
        }
        if !(1..=ZoneSamples::MOST).contains(&self.zone_samples.count()) {
            return fail("render.zone_samples", "1 to 16777216", self.zone_samples.count().to_string());
        }
        if let Some(most) = self.most_views.filter(|most| !(9..=1_000_000).contains(most)) {
            return fail("render.most_views", "9 to 1000000", most.to_string());
        }
        if !(1..=1 << 24).contains(&self.field_mib) {
            return fail("render.field_mib", "1 to 16777216", self.field_mib.to_string());
        }
        if self.max_bounces > 1024 {
            return fail("render.max_bounces", "0 to 1024", self.max_bounces.to_string());
        }
        if !(0.0..=90.0).contains(&self.lens_deg) {
            return fail("render.lens_deg", "0 to 90", self.lens_deg.to_string());
        }
        if self.lens_deg > 0.0 && self.angular_filter != AngularFilter::Point {
            return fail("render.lens_deg", "either a lens or `angular_filter`", "both".into());
        }
        if self.engine == Engine::Blender && !self.is_plain() {
            let expected = "`blender` without the keys `angular_filter`, `lens_deg`, `denoise` and `clamp`, since Blender uses the settings of the .blend file";
            return fail("render.engine", expected, "`blender` with at least one of the four keys".into());
        }
        if let Some(limit) = self.clamp.filter(|limit| !(*limit > 0.0 && limit.is_finite())) {
            return fail("render.clamp", "a finite number above 0", limit.to_string());
        }
        for (key, count) in [("render.held_out", self.held_out), ("render.outside", self.outside)] {
            if count > 64 {
                return fail(key, "0 to 64", count.to_string());
            }
        }
        Ok(())
    }
}

/// Returns the settings with a new seed, which is derived from the old seed, `stream` and `part`.
///
/// `stream` numbers the job's light fields; 0 is the target. `part` numbers a part of the light
/// field's work, such as a half of its samples; it is empty for all of the work.
pub fn seeded(settings: Settings, stream: u64, part: &[u64]) -> Settings {
    Settings { seed: lumistack_core::seed::derive(settings.seed, &[&[stream], part].concat()), ..settings }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_the_zone_are_auto_or_a_number() {
        let read = |text: &str| lumistack_core::config::parse::<RenderJob>(text).map(|job| job.zone_samples);
        assert_eq!(read("").ok(), Some(ZoneSamples::Auto));
        assert_eq!(read("zone_samples = \"auto\"").ok(), Some(ZoneSamples::Auto));
        assert_eq!(read("zone_samples = 338").ok(), Some(ZoneSamples::Count(338)));
        for wrong in ["\"some\"", "-1", "5000000000", "1.5", "[3]"] {
            let error = read(&format!("zone_samples = {wrong}")).unwrap_err().to_string();
            assert!(error.contains("\"auto\" or a number"), "{error}");
        }
        assert!(RenderJob { zone_samples: ZoneSamples::Count(0), ..RenderJob::default() }.check().is_err());
        assert_eq!("auto".parse(), Ok(ZoneSamples::Auto));
        assert_eq!("7".parse(), Ok(ZoneSamples::Count(7)));
        assert!("many".parse::<ZoneSamples>().is_err());
    }

    #[test]
    fn denoisers_have_one_name_everywhere() {
        for (name, kind) in Denoise::ALL {
            assert_eq!((kind.name(), name.parse()), (name, Ok(kind)));
            assert_eq!(serde_json::to_value(kind).unwrap(), name);
        }
        assert!("on".parse::<Denoise>().is_err());
    }
}
