//! `[render]`: settings of the path tracer.

use serde::{Deserialize, Serialize};

use crate::error::PipelineError;

/// How views are rendered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderJob {
    /// Who renders them.
    pub engine: Engine,
    /// Paths per pixel and view.
    pub samples: u32,
    /// Bounces after the first hit.
    pub max_bounces: u32,
    /// Largest value of a single path, which dims brighter ones and so loses light; none keeps all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clamp: Option<f32>,
    /// `point`: rays at the view's slope; `bin`: spread over the view's bin; `display`: over what the display cannot tell apart far from itself.
    pub angular_filter: AngularFilter,
    /// Full angle under which a lens focused on the window is seen from it, degrees; 0 for a pinhole. Instead of `angular_filter`.
    pub lens_deg: f64,
    /// What takes noise out of finished views, at the price of a bias that the report tells.
    pub denoise: Denoise,
    /// In-between views per axis that are rendered for the report only; 0 for none.
    pub held_out: usize,
    /// Views on either side beyond the outermost ones, one view spacing apart, that are rendered for the report only; 0 for none.
    pub outside: usize,
}

/// What renders the views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Engine {
    /// Our path tracer, unless the scene is a `.blend` file with what it cannot show.
    #[default]
    Auto,
    /// Our path tracer.
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

/// Angular extent of a view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AngularFilter {
    /// One slope per view.
    #[default]
    Point,
    /// Slopes spread over the view's bin.
    Bin,
    /// Slopes spread over [`Display::angular_footprint`](lumistack_display::Display::angular_footprint): the display's own prefilter.
    Display,
}

/// What takes noise out of finished views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Denoise {
    /// Nothing: views are unbiased.
    #[default]
    Off,
    /// Our own filter, over all views together.
    Guided,
    /// Intel's Open Image Denoise, view by view, where it is installed.
    Oidn,
}

impl Denoise {
    /// All of them, by the names that jobs use.
    pub const ALL: [(&str, Self); 3] = [("off", Self::Off), ("guided", Self::Guided), ("oidn", Self::Oidn)];

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

impl std::str::FromStr for Denoise {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(known, _)| *known == name);
        found.map(|&(_, kind)| kind).ok_or_else(|| "expected off, guided or oidn".into())
    }
}

impl Default for RenderJob {
    fn default() -> Self {
        Self {
            engine: Engine::Auto,
            samples: 32,
            max_bounces: 6,
            clamp: None,
            angular_filter: AngularFilter::Point,
            lens_deg: 0.0,
            denoise: Denoise::Off,
            held_out: 0,
            outside: 1,
        }
    }
}

impl RenderJob {
    /// Whether nothing is asked for that our path tracer alone does.
    pub(crate) fn is_plain(&self) -> bool {
        let kind = (self.angular_filter, self.lens_deg, self.denoise);
        kind == (AngularFilter::Point, 0.0, Denoise::Off) && self.clamp.is_none()
    }

    /// Checks values that no parser checks.
    pub(super) fn check(&self) -> Result<(), PipelineError> {
        let fail = |key: &str, expected: &str, found: String| Err(PipelineError::job(key, expected, found));
        if !(1..=65536).contains(&self.samples) {
            return fail("render.samples", "1 to 65536", self.samples.to_string());
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
            let expected =
                "neither `angular_filter` nor `lens_deg`, `denoise` or `clamp`: the file has settings of its own";
            return fail("render.engine", expected, "`blender` and one of them".into());
        }
        if let Some(limit) = self.clamp.filter(|limit| !(*limit > 0.0 && limit.is_finite())) {
            return fail("render.clamp", "a number above 0", limit.to_string());
        }
        for (key, count) in [("render.held_out", self.held_out), ("render.outside", self.outside)] {
            if count > 64 {
                return fail(key, "0 to 64", count.to_string());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn denoisers_have_one_name_everywhere() {
        for (name, kind) in Denoise::ALL {
            assert_eq!((kind.name(), name.parse()), (name, Ok(kind)));
            assert_eq!(serde_json::to_value(kind).unwrap(), name);
        }
        assert!("on".parse::<Denoise>().is_err());
    }
}
