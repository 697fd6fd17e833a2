//! Formats the analysis of a display as text.

use std::fmt::Write as _;

use super::{Analysis, Closed};

impl Analysis {
    /// Returns the text: a title, and a line per property of the display.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let plural = |count: usize, one: &str| if count == 1 { format!("1 {one}") } else { format!("{count} {one}s") };
        let light = if self.backlight_mm.is_some() { "directional" } else { "uniform" };
        let (layers, frames) = (plural(self.layers, "layer"), plural(self.timing.frames, "frame"));
        let _ = writeln!(
            text,
            "{}: {layers}, {light} backlight, {frames}, {} mm thick",
            self.name,
            number(self.thickness_mm)
        );
        // One line per property, with a column of names.
        let mut line = |name: &str, value: String| {
            let _ = writeln!(text, "  {name:15} {value}");
        };
        line("Depth of field", self.depth_of_field());
        line("Bound", self.bound());
        if !self.bound_holds {
            line(
                "",
                "the light of the layers adds up, so the display reaches the bound on the planes of the layers, but not between the layers"
                    .into(),
            );
        }
        let [x, y] = &self.axes;
        for form in [&x.closed, &x.lens_array].into_iter().flatten() {
            line("Closed form", closed(form));
        }
        if x.closed.is_none() {
            line("Closed form", "the paper has no closed form for this stack".into());
        }
        let footprint = [x.footprint, y.footprint].map(|width| format!("{width:.4}")).join(" × ");
        line(
            "Prefilter",
            format!(
                "the mean of the light over each pixel, and over a range of slopes of {footprint} (the slopes of neighbouring views are {:.4} × {:.4} apart)",
                self.zone.step[0], self.zone.step[1]
            ),
        );
        line("Viewing zone", self.zone_text());
        line("Frame rate", self.rate_text());
        line("Brightness", self.brightness_text());
        if let Some(scene) = &self.scene {
            line("Scene", scene.sentence.clone());
            let depths = scene.percentiles.iter().zip(["2 %", "25 %", "50 %", "75 %", "98 %"]);
            let depths = depths.map(|([z, bound], share)| format!("{bound:.2} at {} mm ({share})", number(*z)));
            line(
                "",
                format!(
                    "bound at percentiles of depth, relative to the finest detail of the pixels: {}",
                    depths.collect::<Vec<_>>().join(", ")
                ),
            );
        }
        text.trim_end().into()
    }

    fn depth_of_field(&self) -> String {
        let own = self.axes[0].own_cutoff;
        match self.depth_of_field_mm {
            Some([low, high]) if high - low < 1e-6 => {
                format!(
                    "only the plane at {} mm, for the finest detail of the pixels ({own:.3} cycles/mm)",
                    number(low)
                )
            }
            Some([low, high]) => {
                let [low, high] = [low, high].map(number);
                format!("{low} to {high} mm, for the finest detail of the pixels ({own:.3} cycles/mm)")
            }
            None => format!("none: the finest detail of the pixels ({own:.3} cycles/mm) is shown at no depth"),
        }
    }

    fn bound(&self) -> String {
        let x = &self.axes[0];
        let reach = x.bound.last().map_or(0.0, |last| last[0]);
        let at = |z: f64| {
            let nearest = x.bound.iter().min_by(|a, b| (a[0] - z).abs().total_cmp(&(b[0] - z).abs()));
            nearest.map_or(f64::NAN, |point| point[1] / x.own_cutoff)
        };
        let values = [0.0, 0.125, 0.25, 0.5, 1.0].map(|share| share * reach);
        let values = values.map(|z| format!("{:.2} at {} mm", at(z), number(z)));
        format!("highest frequency, relative to the finest detail of the pixels: {}", values.join(", "))
    }

    fn zone_text(&self) -> String {
        let zone = &self.zone;
        let [h, v] = zone.fov_deg;
        let step = zone.step[0].atan().to_degrees();
        let [width, height] = zone.width_mm.map(|side| number(side.round()));
        let beside = if zone.repeats {
            "the zone repeats at its sides"
        } else {
            "views outside of the zone are not constrained"
        };
        format!(
            "{h}° × {v}°, {} × {} views {step:.2}° apart; the whole display is visible at distances of {} mm and more; at a distance of {} mm it is visible from an area \
             of {width} × {height} mm; {:.1} views lie between two eyes; {beside}",
            zone.views[0],
            zone.views[1],
            number(zone.whole_from_mm.round()),
            number(zone.at_mm.round()),
            zone.views_between_eyes
        )
    }

    fn rate_text(&self) -> String {
        let timing = &self.timing;
        if timing.subframes == 1 {
            return format!("static: one frame, at any refresh rate (here {} Hz)", number(timing.refresh_hz));
        }
        let wanted = number(timing.wanted_hz);
        let flicker = if timing.flickers {
            format!("so it flickers. At {wanted} Hz it shows 60 periods per second")
        } else {
            "so it does not flicker".into()
        };
        let (refreshes, hz) = (timing.subframes, number(timing.refresh_hz));
        format!(
            "a period of {refreshes} refreshes; at {hz} Hz the display shows {:.1} periods per second, {flicker}",
            timing.period_hz
        )
    }

    fn brightness_text(&self) -> String {
        let light = &self.brightness;
        let mut text =
            format!("β = {}: white has {:.1} % of the backlight's luminance", light.beta, 100.0 * light.beta);
        if light.white < 1.0 {
            let _ = write!(text, "; the layers transmit at most {:.1} %", 100.0 * light.white);
        }
        if light.beta > light.white {
            text.push_str(", so the display cannot reach this β");
        }
        if light.black > 0.0 {
            let _ = write!(text, "; contrast {:.0}:1", light.white / (light.black * light.white));
        }
        text
    }
}

fn closed(form: &Closed) -> String {
    let Closed { equation, assumes, broken, largest_difference, at_mm, difference_far, .. } = form;
    if *equation == 23 {
        let more = 100.0 * difference_far;
        return format!(
            "eq. 23 ({assumes}) is the bound of the lens array without the layers; far from the display, the bound of the whole display is {more:.1} % higher"
        );
    }
    let differs = if *largest_difference < 1e-6 {
        "the closed form equals the bound".into()
    } else {
        let percent = 100.0 * largest_difference;
        format!(
            "the bound differs from the closed form by {percent:.1} % at {} mm, and by {:+.1} % far from the display",
            number(*at_mm),
            100.0 * difference_far
        )
    };
    let because = if broken.is_empty() { String::new() } else { format!(", since {}", broken.join(" and ")) };
    format!("eq. {equation} ({assumes}): {differs}{because}")
}

/// Formats a number with at most two decimals; larger numbers have fewer.
fn number(value: f64) -> String {
    let digits = match value.abs() {
        size if size >= 100.0 || size.fract() == 0.0 => 0,
        size if size >= 10.0 => 1,
        _ => 2,
    };
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.into(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}
