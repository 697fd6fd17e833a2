//! Reads a light field of another renderer, applies the exposure and tone curve of the job, and
//! warns about values out of range.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, LightField};
use lumistack_field_io::{LeftOut, Reading};
use lumistack_shot::ToneMapping;
use rayon::prelude::*;

use super::field::field_defaults;
use crate::error::{PipelineError, field_error};
use crate::job::Job;

/// Reads the light field at `path` for a display. A light field that is larger than the job allows
/// in memory is kept in an unnamed file in `folder`. Also returns views at `path` that the light
/// field leaves out, at most `report.zone_directions`.
///
/// # Errors
/// If the light field cannot be read, or its geometry is incomplete.
pub(crate) fn run(
    path: &Path,
    job: &Job,
    display: &Display,
    folder: Option<&Path>,
    task: Task<'_>,
) -> Result<(LightField, Vec<LeftOut>), PipelineError> {
    let footprint = |geometry: &FieldGeometry| adapted_footprint(display, geometry);
    let defaults = field_defaults(display);
    // The folder `target/` has half floats, but values in memory are not rounded. So the report
    // compares the display with the values at `path`, after exposure and tone curve.
    let tone_mapping = ToneMapping::of_given(&job.light);
    let change = |view: &mut [f32]| tone_mapping.iter().for_each(|tone_mapping| tone_mapping.apply_to(view));
    let paging = |geometry: &FieldGeometry| {
        folder.filter(|_| !job.render.is_held(geometry)).map(|folder| (folder, job.render.window_bytes()))
    };
    let reading = Reading {
        footprint: Some(&footprint),
        most_left_out: job.report.zone_directions,
        paging: Some(&paging),
        change: Some(&change),
    };
    let read = lumistack_field_io::open_for(path, &job.geometry, &defaults, reading, task);
    let (field, left_out) = read.map_err(field_error)?;
    if let Some(out_of_range) = OutOfRange::of(&field) {
        task.warn(path.display().to_string(), out_of_range.message(REMEDY_IN_COMMAND));
    }
    Ok((field, left_out))
}

/// Remedies for values outside 0..1, as options of the command.
pub(crate) const REMEDY_IN_COMMAND: &str = "--exposure-ev STOPS scales all values, --tone linear clips values, and --tone khronos-neutral or agx compresses values";
/// Remedies for values outside 0..1, as functions of the Python package.
pub(crate) const REMEDY_IN_PYTHON: &str = "light_field.exposed(stops) scales and clips all values; with tone=\"khronos-neutral\" or \"agx\" this method compresses values instead of clipping";

/// Returns the angular footprint of a display that is adapted to a light field. It is the width of
/// the range of slopes that the display cannot separate. If the display cannot be adapted, returns
/// its footprint without adaptation.
pub(crate) fn adapted_footprint(display: &Display, geometry: &FieldGeometry) -> [f64; 2] {
    display.adapted_to(geometry).as_ref().unwrap_or(display).angular_footprint()
}

/// Statistics of values outside 0..1, which a display cannot show.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct OutOfRange {
    values: u64,
    above: u64,
    largest: f32,
    below: u64,
    smallest: f32,
    not_finite: u64,
}

impl OutOfRange {
    /// Counts the values outside 0..1; `None` if there are none.
    pub(crate) fn of(field: &LightField) -> Option<Self> {
        let views: Vec<[usize; 2]> = field.geometry().grid.iter().collect();
        let parts = views.par_iter().map(|&view| {
            let values = field.view(view);
            let mut part = Self { values: values.len() as u64, ..Self::default() };
            for &value in values.iter().filter(|value| !(0.0..=1.0).contains(*value)) {
                part.above += u64::from(value.is_finite() && value > 1.0);
                part.below += u64::from(value.is_finite() && value < 0.0);
                part.not_finite += u64::from(!value.is_finite());
                if value.is_finite() {
                    part.largest = part.largest.max(value);
                    part.smallest = part.smallest.min(value);
                }
            }
            part
        });
        let all = parts.reduce(Self::default, |a, b| Self {
            values: a.values + b.values,
            above: a.above + b.above,
            largest: a.largest.max(b.largest),
            below: a.below + b.below,
            smallest: a.smallest.min(b.smallest),
            not_finite: a.not_finite + b.not_finite,
        });
        (all.above + all.below + all.not_finite > 0).then_some(all)
    }

    /// Describes the values outside 0..1: their fraction, their extremes, and the remedy.
    pub(crate) fn message(&self, offer: &str) -> String {
        let share = |count: u64| {
            let percent = 100.0 * count as f64 / self.values as f64;
            if percent >= 0.01 {
                format!("{percent:.2} % of all values")
            } else {
                format!("{count} of {} values", self.values)
            }
        };
        let mut parts = Vec::new();
        if self.above > 0 {
            let stops = -f64::from(self.largest).log2();
            parts.push(format!(
                "values above 1: {}; the largest value is {} (an exposure of {stops:.2} stops reduces this value to 1)",
                share(self.above),
                self.largest
            ));
        }
        if self.below > 0 {
            parts.push(format!("values below 0: {}; the smallest value is {}", share(self.below), self.smallest));
        }
        if self.not_finite > 0 {
            parts.push(format!("values that are not finite: {}", share(self.not_finite)));
        }
        format!(
            "{}. A display shows only values from 0 to 1, so all other values lower the PSNR. Remedies: {offer}",
            parts.join("; ")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_display::{Projection, ViewGrid};

    #[test]
    fn values_beyond_the_range_are_counted_and_named() {
        let grid = ViewGrid::uniform(Projection::Oblique, [3, 2], [20.0, 20.0]).unwrap();
        let mut field = LightField::black(FieldGeometry { rows: 100, cols: 100, pitch_mm: 1.0, grid }).unwrap();
        field.radiance_mut().data_mut().fill(1.0);
        assert_eq!(OutOfRange::of(&field), None);
        let data = field.radiance_mut().data_mut();
        data[17] = 1e4;
        let message = OutOfRange::of(&field).unwrap().message("nothing");
        let expected = "values above 1: 1 of 180000 values; the largest value is 10000 (an exposure of -13.29 stops reduces this value to 1)";
        assert!(message.starts_with(expected), "{message}");
        let data = field.radiance_mut().data_mut();
        data[..18_000].fill(2.0);
        data[18_000..18_900].fill(-0.5);
        data[20_000] = f32::NAN;
        let message = OutOfRange::of(&field).unwrap().message("nothing");
        for part in [
            "values above 1: 10.00 % of all values; the largest value is 2 ",
            "values below 0: 0.50 % of all values; the smallest value is -0.5",
            "values that are not finite: 1 of 180000 values",
        ] {
            assert!(message.contains(part), "{message}");
        }
    }
}
