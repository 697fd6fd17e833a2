//! Reads the input as the calibration of a lenticular display (JSON), and as the curve of a
//! printer's film (text).

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_fuzz::reads;
use lumistack_plugin::serde_json::{Value, from_slice};
use lumistack_plugin_quilt::weave::Calibration;
use lumistack_plugin_transparencies::curve::Film;

fuzz_target!(|data: &[u8]| {
    if let Ok(json) = from_slice::<Value>(data) {
        reads(|_| Calibration::from_json(&json));
    }
    if let Ok(text) = std::str::from_utf8(data)
        && let Some(film) = reads(|_| Film::new(text, 0.02))
    {
        for channel in 0..3 {
            let values = (0..=255).map(|code| film.transmittance(channel, code));
            assert!(values.into_iter().all(|value| (0.0..=1.0).contains(&value)));
        }
    }
});
