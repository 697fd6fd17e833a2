//! Time per update of the paper's main case: 840×525 pixels, 5×5 views, RGB, 3 layers, 6 frames.
//!
//! `cargo run --release -p lumistack-factorizer --example main_case [frames]`
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "this program measures time")]

use std::time::Instant;

use lumistack_core::Cancel;
use lumistack_display::{Display, LightField, Weights};
use lumistack_factorizer::{Problem, random_start, solver};

/// The paper's three-layer display; frames and backlight are filled in.
const DISPLAY: &str = r#"
name = "main case"
brightness = 0.2
frames = FRAMES
[field]
resolution = [840, 525]
pitch_mm = 0.564
views = [5, 5]
fov_deg = [20.0, 20.0]
[[layers]]
d_mm = -40.0
resolution = [840, 525]
pitch_mm = 0.564
[[layers]]
d_mm = 0.0
resolution = [840, 525]
pitch_mm = 0.564
[[layers]]
d_mm = 40.0
resolution = [840, 525]
pitch_mm = 0.564
"#;

/// One layer before the paper's lenslets.
const DIRECTIONAL: &str = r#"
name = "directional"
brightness = 0.2
frames = FRAMES
[field]
resolution = [840, 525]
pitch_mm = 0.564
views = [5, 5]
fov_deg = [48.0, 48.0]
[[layers]]
d_mm = 0.0
resolution = [840, 525]
pitch_mm = 0.564
[backlight]
kind = "lenslets"
d_mm = -8.5
lenslets = [187, 117]
pitch_mm = 2.54
fov_deg = [48.0, 48.0]
views = [5, 5]
"#;

/// Updates that are timed one by one.
const UPDATES: usize = 21;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let frames = std::env::args().nth(1).unwrap_or_else(|| "6".into());
    let only = std::env::args().nth(2);
    for name in ["multiplicative", "block-exact", "extrapolated"]
        .into_iter()
        .filter(|n| only.as_deref().is_none_or(|o| o == *n))
    {
        for (what, text) in [
            ("three layers", DISPLAY.to_owned()),
            ("three layers, bilinear", DISPLAY.replace("[field]", "sampling = \"bilinear\"\n[field]")),
            ("directional", DIRECTIONAL.to_owned()),
        ] {
            if std::env::args().nth(3).is_some_and(|o| o != what) {
                continue;
            }
            let display = Display::from_toml(
                &text
                    .replace("FRAMES", &frames)
                    .replace("525", &std::env::var("ROWS").unwrap_or("525".into()))
                    .replace("840", &std::env::var("COLS").unwrap_or("840".into())),
            )?;
            let mut target = LightField::black(display.geometry()?)?;
            for (i, value) in target.radiance_mut().data_mut().iter_mut().enumerate() {
                *value = 0.5 + 0.4 * (i as f32 * 0.37).sin();
            }
            let problem = Problem { display: &display, target: &target, weights: &Weights::Uniform };
            let begin = Instant::now();
            let mut run = solver(name)?.start(&problem, random_start(&display, 1))?;
            let prepared = begin.elapsed();
            let mut times = Vec::new();
            for _ in 0..UPDATES {
                let begin = Instant::now();
                run.step(&Cancel::default())?;
                times.push(begin.elapsed().as_secs_f64() * 1e3);
            }
            let begin = Instant::now();
            let objective = run.objective();
            let evaluated = begin.elapsed().as_secs_f64() * 1e3;
            times.sort_by(f64::total_cmp);
            println!(
                "{name}: {what}, {frames} frames: update {:.0} ms (fastest {:.0}), objective {evaluated:.0} ms, preparation {:.0} ms; {:.2} dB",
                times[UPDATES / 2],
                times[0],
                prepared.as_secs_f64() * 1e3,
                objective.psnr_view,
            );
        }
    }
    Ok(())
}
