//! Frames, colours and flicker over time.

use crate::{ColourSequence, Display};

impl Display {
    /// Rate below which eyes see flicker, periods per second.
    pub const FLICKER_HZ: f64 = 60.0;

    /// Returns the number of refreshes of one period: M, or 3·M if colours are shown in turn.
    pub fn subframes(&self) -> usize {
        self.frames * self.colour_sequence.fields()
    }

    /// Returns the number of periods that the display shows per second.
    pub fn period_hz(&self) -> f64 {
        self.refresh_hz / self.subframes() as f64
    }

    /// Returns a warning to the user if the display flickers; `None` if it does not.
    pub fn flicker_warning(&self) -> Option<String> {
        // A rounding error must not cause a warning for a display with exactly 60 periods per
        // second.
        const ROUNDING: f64 = 1e-9;
        if self.subframes() <= 1 || self.period_hz() >= Self::FLICKER_HZ * (1.0 - ROUNDING) {
            return None;
        }
        let frames = match (self.frames, self.colour_sequence) {
            (1, ColourSequence::Field) => "3 colours in turn".into(),
            (frames, ColourSequence::Field) => format!("{frames} frames of 3 colours in turn"),
            (frames, ColourSequence::Simultaneous) => format!("{frames} frames"),
        };
        Some(format!(
            "at {} Hz the display shows {frames} {:.1} times per second, so the display flickers. To show all frames {} times per second, the panels need a refresh rate of {} Hz",
            self.refresh_hz,
            self.period_hz(),
            Self::FLICKER_HZ,
            Self::FLICKER_HZ * self.subframes() as f64
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::tests::small_display;

    #[test]
    fn colours_in_turn_take_three_times_as_long() {
        let mut display = Display { frames: 6, refresh_hz: 120.0, ..small_display() };
        assert_eq!((display.subframes(), display.period_hz()), (6, 20.0));
        display.colour_sequence = ColourSequence::Field;
        assert_eq!(display.subframes(), 18);
        assert!((display.period_hz() - 120.0 / 18.0).abs() < 1e-12);
    }

    #[test]
    fn the_warning_says_which_refresh_rate_would_do() {
        let mut display = Display { frames: 6, refresh_hz: 120.0, ..small_display() };
        let warning = display.flicker_warning().unwrap();
        assert!(warning.starts_with("at 120 Hz the display shows 6 frames 20.0 times per second"), "{warning}");
        assert!(warning.ends_with("refresh rate of 360 Hz"), "{warning}");
        display.refresh_hz = 360.0;
        assert_eq!(display.flicker_warning(), None);
        display.colour_sequence = ColourSequence::Field;
        let warning = display.flicker_warning().unwrap();
        assert!(
            warning.starts_with("at 360 Hz the display shows 6 frames of 3 colours in turn")
                && warning.ends_with("1080 Hz"),
            "{warning}"
        );
        // A display of one frame shows the same image at every refresh, so it cannot flicker at any
        // refresh rate.
        let still = Display { frames: 1, refresh_hz: 30.0, ..small_display() };
        assert_eq!(still.flicker_warning(), None);
        let coloured = Display { colour_sequence: ColourSequence::Field, ..still };
        assert!(coloured.flicker_warning().unwrap().starts_with("at 30 Hz the display shows 3 colours in turn"));
    }
}
