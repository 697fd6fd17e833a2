//! Reads the input as a display file, which may contain the calibration of its panels. If the
//! display is valid, it must stay the same when it is written and read again.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_display::Display;
use lumistack_fuzz::reads;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Some(display) = reads(|_| Display::from_toml(text)) else { return };
    reads(|_| display.geometry());
    _ = (display.flicker_warning(), display.period_hz());
    let again = Display::from_toml(&display.to_toml()).expect("a display that was written can be read");
    assert_eq!(again.to_toml(), display.to_toml());
});
