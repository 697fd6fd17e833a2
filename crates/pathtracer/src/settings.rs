//! Settings of a render.

use thiserror::Error;

/// Quality and reproducibility of a render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Paths per pixel and view, 1..=65536. Powers of two stratify best. Default 32.
    pub samples: u32,
    /// Scattering events after the first hit, 0..=1024; 0 shows emission only. Longer paths are cut
    /// off, which is the only systematic error of the renderer. Default 8.
    pub max_bounces: u32,
    /// Bounce after which Russian roulette may end a path, 0..=1024; the estimate stays unbiased.
    /// Default 3.
    pub roulette_start: u32,
    /// Every random number derives from this. Default 0.
    pub seed: u64,
    /// Range of slopes that a view averages. Default [`AngularFilter::Point`].
    pub angular_filter: AngularFilter,
    /// Largest value, > 0, of any channel of a single path; brighter ones are dimmed to it, which
    /// loses light and is reported as a warning. Default `None`: the estimate stays unbiased.
    pub clamp: Option<f32>,
    /// Primary rays that miss all surfaces see black instead of the environment, which lights the
    /// scene all the same. Default false.
    pub hide_environment: bool,
}

/// Directions that a view averages.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AngularFilter {
    /// Only the slope of the view itself.
    #[default]
    Point,
    /// All slopes of the view's bin: a box as wide as the spacing of the grid, centred on the view.
    /// An axis with a single view has no spacing and stays a point.
    Bin,
    /// A box of so wide slopes (x, y), each ≥ 0, centred on the view: for views between the views
    /// of a grid or outside of it.
    Width([f64; 2]),
    /// A thin lens focused on z = 0: a disc of slopes of this diameter, ≥ 0, centred on the view.
    /// At an eye at distance D the lens has D times this diameter. In parallel projections a point
    /// at depth z blurs to a disc of z times the diameter, in millimetres of z = 0.
    Lens(f64),
}

/// A setting outside its range.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{name}: expected {expected}, found {found}")]
pub struct SettingsError {
    /// Name of the setting.
    pub name: &'static str,
    /// Its range.
    pub expected: &'static str,
    /// The value found.
    pub found: String,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            samples: 32,
            max_bounces: 8,
            roulette_start: 3,
            seed: 0,
            angular_filter: AngularFilter::Point,
            clamp: None,
            hide_environment: false,
        }
    }
}

impl Settings {
    /// Checks every range.
    ///
    /// # Errors
    /// On the first value outside its range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let check = |name, value: u32, range: std::ops::RangeInclusive<u32>, expected| {
            if range.contains(&value) {
                Ok(())
            } else {
                Err(SettingsError { name, expected, found: value.to_string() })
            }
        };
        check("samples", self.samples, 1..=65536, "1 to 65536")?;
        check("max_bounces", self.max_bounces, 0..=1024, "0 to 1024")?;
        check("roulette_start", self.roulette_start, 0..=1024, "0 to 1024")?;
        match self.clamp {
            Some(limit) if !(limit > 0.0 && limit.is_finite()) => {
                Err(SettingsError { name: "clamp", expected: "a number above 0", found: limit.to_string() })
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_outside_their_range_are_named() {
        assert!(Settings::default().check().is_ok());
        let error = Settings { samples: 0, ..Settings::default() }.check().unwrap_err();
        assert_eq!(error.to_string(), "samples: expected 1 to 65536, found 0");
        assert!(Settings { clamp: Some(0.0), ..Settings::default() }.check().is_err());
        assert!(Settings { max_bounces: 2000, ..Settings::default() }.check().is_err());
    }
}
