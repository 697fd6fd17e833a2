//! Settings of a render.

use thiserror::Error;

use crate::bvh::BEAM;

/// With sparse paths, one of every `FEWER` paths continues on smooth surfaces.
pub(crate) const FEWER: u32 = 4;

/// Quality and reproducibility of a render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Paths per pixel and view, 1..=65536. Powers of two stratify best. Default 32.
    pub samples: u32,
    /// Number of further rays per pixel of a [split view](crate::Renderer::render_split),
    /// 0..=65536. They end at the first surface, so they cost a sixth to a half of a path. They
    /// smooth edges and textures; the light of the surfaces comes from the paths. Edges of mirrors
    /// and glass in front of a visible environment become noisier, since views share no light of
    /// mirrors or glass. Functions that render no split view ignore this setting. Default 0.
    pub further_rays: u32,
    /// Gives further rays and paths to the noisy pixels of a [split
    /// view](crate::Renderer::render_split): at edges, in mirrored light and inside textures. This
    /// setting is for views that are seen one by one. Functions that render no split view ignore
    /// it. Default false. On wasm32 it has no effect, since web pages would load its code without
    /// need.
    pub further_paths: bool,
    /// Gives a [split view](crate::Renderer::render_split) only a quarter of its paths where it
    /// sees smooth surfaces whose light other views share. The other rays end at the first surface.
    /// This setting is for views whose light is averaged over hundreds of views. Pixels with more
    /// than 16 rays keep all paths. Functions that render no split view ignore this setting.
    /// Default false.
    pub sparse_paths: bool,
    /// Largest number of scattering events of a path, 0..=1024. The event at the first hit is
    /// included, so 0 shows emission only. Longer paths are cut off. Unless [`clamp`](Self::clamp)
    /// is set, this cut is the renderer's only systematic error. Default 8.
    pub max_bounces: u32,
    /// Index of the first bounce after which Russian roulette may end a path, 0..=1024. The bounce
    /// at the first hit has the index 0. The estimate stays unbiased. Default 3.
    pub roulette_start: u32,
    /// Seed of all random numbers. Default 0.
    pub seed: u64,
    /// Range of slopes that a view averages. Default [`AngularFilter::Point`].
    pub angular_filter: AngularFilter,
    /// Largest value of any channel of a single path, > 0. Brighter paths are dimmed to it, which
    /// loses light and is reported as a warning. Default `None`: the estimate stays unbiased.
    pub clamp: Option<f32>,
    /// True if primary rays that miss all surfaces see black instead of the environment or the
    /// backdrop. The environment lights the scene in either case. Default false.
    pub hide_environment: bool,
    /// Pixels that [`render_view`](crate::Renderer::render_view) and
    /// [`render_misses`](crate::Renderer::render_misses) render; the values of all other pixels
    /// are 0. Other functions ignore this setting. Default [`PixelSet::All`].
    pub pixels: PixelSet,
}

/// Pixels of a view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelSet {
    /// All pixels.
    #[default]
    All,
    /// One of six sets of pixels, with a number 0..6 (larger numbers modulo 6). Each set is spread
    /// evenly. The six sets together are all pixels, and have no pixel in common.
    Sixth(usize),
}

impl PixelSet {
    /// Number of sets of the kind [`Sixth`](Self::Sixth).
    pub const SIXTHS: usize = 6;

    /// Returns true if a pixel [row, column] is in the set.
    pub fn contains(self, [row, col]: [usize; 2]) -> bool {
        match self {
            Self::All => true,
            // Between successive rows, the columns of a set move by two. So the nearest pixels of
            // a set are √5 pixels apart.
            Self::Sixth(number) => (col + 2 * row + number) % Self::SIXTHS == 0,
        }
    }
}

/// Directions that a view averages.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AngularFilter {
    /// Only the slope of the view itself.
    #[default]
    Point,
    /// All slopes of the view's bin: a box centred on the view, as wide as the mean difference of
    /// neighbouring views' slopes. An axis with a single view stays a point.
    Bin,
    /// A box of slopes with these widths (x, y), each ≥ 0, centred on the view. It is for views
    /// between or outside the views of a grid.
    Width([f64; 2]),
    /// A thin lens focused on z = 0: a disc of slopes of this diameter, ≥ 0, centred on the view.
    /// For an eye at distance D from the display plane, the lens has D times this diameter. In
    /// parallel projections a point at depth z blurs to a disc on z = 0, whose diameter is |z|
    /// times the diameter of slopes.
    Lens(f64),
}

/// A setting outside its range.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{name}: expected {expected}, found {found}")]
pub struct SettingsError {
    /// Name of the setting.
    pub name: &'static str,
    /// Range of the setting.
    pub expected: &'static str,
    /// The value found.
    pub found: String,
}

impl Settings {
    /// Returns true if split views get further rays and paths.
    pub(crate) fn has_further_paths(&self) -> bool {
        !cfg!(target_arch = "wasm32") && self.further_paths
    }

    /// Returns true if pixels of a split view may have more rays than paths.
    pub fn has_further_rays(&self) -> bool {
        self.further_rays > 0 || self.sparse_paths || self.has_further_paths()
    }

    /// Returns true if pixels on smooth surfaces have fewer paths. A pixel with more than [`BEAM`]
    /// rays keeps all paths, since each of its beams would have to know the hits of the other
    /// beams.
    pub(crate) fn has_sparse_paths(&self) -> bool {
        self.sparse_paths && self.rays()[1] <= BEAM as u32
    }

    /// Returns the number of paths of a pixel on a smooth surface.
    pub(crate) fn paths_on_surface(&self) -> u32 {
        if self.has_sparse_paths() { self.samples.div_ceil(FEWER) } else { self.samples }
    }

    /// Returns the number of paths and the number of all rays of a pixel of a split view. With
    /// further paths, some pixels have more paths and rays; with sparse paths, some have fewer
    /// paths.
    pub(crate) fn rays(&self) -> [u32; 2] {
        [self.samples, self.samples + self.further_rays]
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            samples: 32,
            further_rays: 0,
            further_paths: false,
            sparse_paths: false,
            max_bounces: 8,
            roulette_start: 3,
            seed: 0,
            angular_filter: AngularFilter::Point,
            clamp: None,
            hide_environment: false,
            pixels: PixelSet::All,
        }
    }
}

impl Settings {
    /// Checks the ranges of all settings except [`angular_filter`](Self::angular_filter).
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
        check("further_rays", self.further_rays, 0..=65536, "0 to 65536")?;
        check("max_bounces", self.max_bounces, 0..=1024, "0 to 1024")?;
        check("roulette_start", self.roulette_start, 0..=1024, "0 to 1024")?;
        match self.clamp {
            Some(limit) if !(limit > 0.0 && limit.is_finite()) => {
                Err(SettingsError { name: "clamp", expected: "a finite number above 0", found: limit.to_string() })
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixths_divide_the_pixels_evenly() {
        let number =
            |at: [usize; 2]| (0..PixelSet::SIXTHS).filter(|n| PixelSet::Sixth(*n).contains(at)).collect::<Vec<_>>();
        for (row, col) in (0..12).flat_map(|row| (0..12).map(move |col| (row, col))) {
            let own = number([row, col]);
            assert!(own.len() == 1 && PixelSet::All.contains([row, col]));
            // no neighbour, diagonal ones included, is in the same set
            for (row, col) in [(row, col + 1), (row + 1, col), (row + 1, col + 1), (row + 1, col.wrapping_sub(1))] {
                assert!(col == usize::MAX || number([row, col]) != own);
            }
        }
    }

    #[test]
    fn values_outside_their_range_are_named() {
        assert!(Settings::default().check().is_ok());
        let error = Settings { samples: 0, ..Settings::default() }.check().unwrap_err();
        assert_eq!(error.to_string(), "samples: expected 1 to 65536, found 0");
        assert!(Settings { clamp: Some(0.0), ..Settings::default() }.check().is_err());
        assert!(Settings { max_bounces: 2000, ..Settings::default() }.check().is_err());
    }
}
