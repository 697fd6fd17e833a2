//! Checks the ranges of a display's values.

use crate::{Backlight, Display, DisplayError, Layer, LayerColour, Lens, Panel, Views};

/// Tolerance of the row sums of a crosstalk matrix: the program that wrote the file may have
/// rounded the entries.
const ROW_SUM_ROUNDING: f64 = 1e-6;

impl Display {
    /// Checks the range of every value.
    ///
    /// # Errors
    /// If a value is out of range; the error names the first one.
    pub fn check(&self) -> Result<(), DisplayError> {
        let check = |ok: bool, key: &str, expected: &str, found: String| {
            if ok { Ok(()) } else { Err(DisplayError::Value { key: key.into(), expected: expected.into(), found }) }
        };
        let positive =
            |key: &str, value: f64| check(value.is_finite() && value > 0.0, key, "a number above 0", value.to_string());
        let finite = |key: &str, values: &[f64]| {
            check(values.iter().all(|v| v.is_finite()), key, "finite numbers", format!("{values:?}"))
        };
        let pixels = |key: &str, [cols, rows]: [usize; 2]| {
            let ok = (1..=1 << 16).contains(&cols) && (1..=1 << 16).contains(&rows);
            check(ok, key, "1 to 65536 per axis", format!("[{cols}, {rows}]"))
        };
        // Check the values of the display as a whole.
        check(self.schema == Self::SCHEMA, "schema", Self::SCHEMA, self.schema.clone())?;
        check(self.version == 1, "version", "1", self.version.to_string())?;
        check((1..=1000).contains(&self.frames), "frames", "1 to 1000", self.frames.to_string())?;
        positive("refresh_hz", self.refresh_hz)?;
        let brightness_ok = self.brightness > 0.0 && self.brightness <= 1.0;
        check(brightness_ok, "brightness", "a number above 0 and at most 1", self.brightness.to_string())?;
        pixels("field.resolution", self.field.resolution)?;
        match self.field.views {
            Views::Auto => {}
            Views::Fixed(views) => pixels("field.views", views)?,
            Views::Step(step) => {
                let ok = step.iter().all(|step| step.is_finite() && *step >= 0.0);
                check(ok, "field.views.step", "slopes of at least 0", format!("{step:?}"))?;
            }
        }
        self.geometry()?.check()?;
        // Check the layers, each of which must be in front of the previous layer.
        check(!self.layers.is_empty(), "layers", "at least one layer", "none".into())?;
        for (n, layer) in self.layers.iter().enumerate() {
            let key = |name: &str| format!("layers[{n}].{name}");
            finite(&key("d_mm"), &[layer.d_mm])?;
            finite(&key("offset_mm"), &layer.offset_mm)?;
            positive(&key("pitch_mm"), layer.pitch_mm)?;
            pixels(&key("resolution"), layer.resolution)?;
            let black_ok = (0.0..1.0).contains(&layer.black_level);
            check(black_ok, &key("black_level"), "0 to less than 1", layer.black_level.to_string())?;
            let peak_ok = layer.peak > 0.0 && layer.peak <= 1.0;
            check(peak_ok, &key("peak"), "a number above 0 and at most 1", layer.peak.to_string())?;
            if let Some(bits) = layer.bits {
                let expected = format!("1 to {}", Layer::MAX_BITS);
                check((1..=Layer::MAX_BITS).contains(&bits), &key("bits"), &expected, bits.to_string())?;
            }
            let blur_ok = (0.0..=Layer::MAX_BLUR_PX).contains(&layer.blur_px);
            check(blur_ok, &key("blur_px"), &format!("0 to {} pixels", Layer::MAX_BLUR_PX), layer.blur_px.to_string())?;
            for (c, row) in layer.crosstalk.iter().flatten().enumerate() {
                let sum: f64 = row.iter().sum();
                let row_ok = row.iter().all(|share| *share >= 0.0) && sum > 0.0 && sum <= 1.0 + ROW_SUM_ROUNDING;
                let expected = "shares ≥ 0 whose sum is above 0 and at most 1";
                check(row_ok, &key(&format!("crosstalk[{c}]")), expected, format!("{row:?}"))?;
            }
            let filters_ok = layer.filters.is_empty() || layer.colour == LayerColour::Mono;
            check(filters_ok, &key("filters"), "no filters, or colour = \"mono\"", format!("{:?}", layer.filters))?;
            for (j, filter) in layer.filters.iter().enumerate() {
                let filter_ok = filter.iter().all(|factor| (0.0..=1.0).contains(factor));
                check(filter_ok, &key(&format!("filters[{j}]")), "three factors in 0..1", format!("{filter:?}"))?;
            }
            if let Some((place, expected, found)) = layer.transfer.problem() {
                check(false, &key(&format!("transfer.{place}")), expected, found)?;
            }
            if let Some(bits) = layer.bits.filter(|_| layer.transfer.is_per_channel()) {
                let expected =
                    "no `bits`, or a transfer function that all channels share, since all channels have equal levels";
                check(false, &key("bits"), expected, bits.to_string())?;
            }
            if let Some(resolution) = layer.panel_resolution {
                pixels(&key("panel_resolution"), resolution)?;
            }
            if let Some(pitch_mm) = layer.panel_pitch_mm {
                positive(&key("panel_pitch_mm"), pitch_mm)?;
            }
            if let Some((name, expected, found)) = layer.panel.as_ref().and_then(Panel::problem) {
                check(false, &key(&format!("panel.{name}")), expected, found)?;
            }
            if n > 0 {
                let behind = self.layers[n - 1].d_mm;
                let expected =
                    format!("more than layers[{}].d_mm = {behind} (layers are listed from rear to front)", n - 1);
                check(layer.d_mm > behind, &key("d_mm"), &expected, layer.d_mm.to_string())?;
            }
        }
        // Check the directional backlight. No layer may be behind its lenslets.
        if let Backlight::Lenslets(backlight) = &self.backlight {
            finite("backlight.offset_mm", &backlight.offset_mm)?;
            positive("backlight.pitch_mm", backlight.pitch_mm)?;
            pixels("backlight.lenslets", backlight.lenslets)?;
            pixels("backlight.views", backlight.views)?;
            let fov_ok = backlight.fov_deg.iter().all(|fov| *fov > 0.0 && *fov < 180.0);
            check(fov_ok, "backlight.fov_deg", "angles between 0 and 180", format!("{:?}", backlight.fov_deg))?;
            let black_ok = (0.0..1.0).contains(&backlight.black_level);
            check(black_ok, "backlight.black_level", "0 to less than 1", backlight.black_level.to_string())?;
            if let Some((place, expected, found)) = backlight.transfer.problem() {
                check(false, &format!("backlight.transfer.{place}"), expected, found)?;
            }
            if let Some(resolution) = backlight.panel_resolution {
                pixels("backlight.panel_resolution", resolution)?;
            }
            if let Some(pitch_mm) = backlight.panel_pitch_mm {
                positive("backlight.panel_pitch_mm", pitch_mm)?;
            }
            if let Some((name, expected, found)) = backlight.panel.as_ref().and_then(Panel::problem) {
                check(false, &format!("backlight.panel.{name}"), expected, found)?;
            }
            if let Some((name, expected, found)) = backlight.lens.as_ref().and_then(Lens::problem) {
                check(false, &format!("backlight.lens.{name}"), expected, found)?;
            }
            let behind = self.layers[0].d_mm;
            let expected = format!("at most layers[0].d_mm = {behind}");
            check(backlight.d_mm <= behind, "backlight.d_mm", &expected, backlight.d_mm.to_string())?;
        }
        Ok(())
    }
}
