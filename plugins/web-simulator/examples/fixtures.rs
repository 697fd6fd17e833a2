//! `fixtures FOLDER` writes fixtures for the tests of the page: previews of small random stacks,
//! and views that the forward model computes from the unrounded patterns.
//!
//! Every case has a file `references.json` with nine slopes and the names of nine files. Each file
//! contains L̃/β at one slope, `[row][col][rgb]` as little-endian `f32`.

use std::path::Path;

use lumistack_plugin::Time;
use lumistack_plugin::core::seed::Stream;
use lumistack_plugin::display::{
    Backlight, Display, Layer, LayerStack, LensletBacklight, LightField, Missing, RayMap, Sampling, Simulator, ViewGrid,
};
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin_testkit::MemoryHost;
use lumistack_plugin_testkit::serve::{Output, OutputData, Plugin};
use lumistack_plugin_web_simulator::PLUGIN;

/// Brightness of every case. The front layer transmits at most this fraction, so L̃/β is at most 1
/// for rays that hit this layer. So hardly any value is clipped, and most errors are visible.
const BRIGHTNESS: f64 = 0.8;
/// [columns, rows] of every case.
const SIZE: [usize; 2] = [60, 40];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: fixtures FOLDER")?;
    for (name, display) in cases() {
        write_case(&Path::new(&folder).join(name), &display)?;
    }
    Ok(())
}

fn cases() -> [(&'static str, Display); 4] {
    let layers = |d_mm: &[f64], frames: usize| {
        let plain = Display::uniform(SIZE, 1.0, [5, 5], [20.0, 20.0], d_mm, frames);
        Display { brightness: BRIGHTNESS, missing: Missing::Clear, ..plain }
    };
    let uniform = layers(&[-12.0, 0.0, 12.0], 3);
    let mut directional = layers(&[-6.0, 6.0], 2);
    let lenslets = LensletBacklight::new(-24.0, [34, 24], 2.0, [5, 5], [20.0, 20.0]);
    directional.backlight = Backlight::Lenslets(lenslets);
    let mut mixed = layers(&[-12.0, 0.0, 12.0], 2);
    mixed.sampling = Sampling::Bilinear;
    mixed.layers[0] = Layer::new(-12.0, [23, 16], 2.75);
    mixed.layers[2] = Layer { blur_px: 0.7, ..Layer::new(12.0, [131, 90], 0.5) };
    let eight: Vec<f64> = (0..8).map(|n| 4.0 * f64::from(n) - 14.0).collect();
    [("uniform3", uniform), ("directional", directional), ("mixed", mixed), ("layers8", layers(&eight, 2))]
}

/// Makes smooth patterns with a little noise. They are so bright that even eight layers together
/// transmit light.
fn random_stack(display: &Display) -> LayerStack {
    let mut stack = LayerStack::filled(display, 1.0);
    let mut random = Stream::new(17);
    let least = 1.0 - 1.0 / display.layers.len() as f32;
    let parts = stack.layers.iter_mut().map(|layer| layer.data_mut());
    for values in parts.chain(stack.emission.as_mut().map(|emission| emission.data_mut())) {
        let (a, b) = (0.05 + 0.2 * random.next_f32(), 0.01 + 0.03 * random.next_f32());
        for (i, value) in values.iter_mut().enumerate() {
            let wave = 0.5 + 0.5 * (a * i as f32).sin() * (b * i as f32).cos();
            *value = least + (1.0 - least) * (0.7 * wave + 0.3 * random.next_f32());
        }
    }
    let front = stack.layers.iter_mut().last().into_iter().flat_map(|layer| layer.data_mut());
    front.for_each(|value| *value *= BRIGHTNESS as f32);
    stack
}

fn write_case(folder: &Path, display: &Display) -> Result<(), Box<dyn std::error::Error>> {
    let stack = random_stack(display);
    let geometry = display.geometry()?;
    let (simulator, map) = (Simulator::new(display, &stack), RayMap::new(display, &geometry));
    // Make a target that is a little darker than the display's views, so that the error map is not
    // black.
    let mut target = LightField::black(geometry.clone())?;
    for view in geometry.grid.iter() {
        let emitted = simulator.view(&map, &geometry, view).radiance;
        let scale = (0.9 / stack.brightness) as f32;
        target.view_mut(view).iter_mut().zip(emitted.data()).for_each(|(value, l)| *value = (scale * l).min(1.0));
    }
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN)?);
    let output = Output::open(&plugin, &host, &json!({}), display)?;
    output.submit(Time::default(), OutputData::LayerStack(&stack, Some(&target)))?;
    output.finish()?;
    for (path, bytes) in host.files() {
        write(&folder.join(path), &bytes)?;
    }
    // Choose nine slopes, as fractions of half the field of view. They are the centre, points near
    // the four corners and near the middles of two edges, and two other points.
    let half = (10f64.to_radians()).tan();
    let shares = [
        [0.0, 0.0],
        [0.8, 0.8],
        [-0.8, 0.8],
        [0.8, -0.8],
        [-0.8, -0.8],
        [0.8, 0.05],
        [0.03, -0.8],
        [0.21, -0.33],
        [-0.47, 0.61],
    ];
    let slopes = shares.map(|share| share.map(|share| share * half));
    let mut names = Vec::new();
    for (i, slope) in slopes.into_iter().enumerate() {
        let geometry = geometry.with_grid(ViewGrid::single(geometry.grid.projection, slope));
        let view = simulator.seen(&geometry, [0, 0]).radiance;
        let bytes = view.data().iter().flat_map(|value| (value / stack.brightness as f32).to_le_bytes());
        names.push(format!("ref{i}.f32"));
        write(&folder.join(&names[i]), &bytes.collect::<Vec<u8>>())?;
    }
    let references: Value = json!({
        "slopes": slopes, "rows": geometry.rows, "cols": geometry.cols, "brightness": stack.brightness, "files": names,
    });
    write(&folder.join("references.json"), references.to_string().as_bytes())
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(path.parent().ok_or("no folder")?)?;
    Ok(std::fs::write(path, bytes)?)
}
