//! Compares the simulation on the CPU with the forward model, and tests missing and damaged input.

use lumistack_core::Tensor;
use lumistack_core::colour::{srgb_code, srgb_decode};
use lumistack_core::metrics::SquaredError;
use lumistack_core::seed::Stream;
use lumistack_display::{
    Backlight, Display, EmittedView, FieldGeometry, Formation, Layer, LayerStack, LensletBacklight, Missing,
    Projection, Sampling, Simulator, ViewGrid,
};
use serde_json::{Value, json};

use crate::preview::{File, Part, Preview, Target};
use crate::{Field, Model};

/// Tolerance for sums of f32 values in different orders.
const SUMMATION: f32 = 1e-5;

pub(crate) fn png(rows: usize, cols: usize, codes: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, cols as u32, rows as u32);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(codes).unwrap();
    writer.finish().unwrap();
    bytes
}

/// A preview of random patterns with a random target, and the bytes of its files. The patterns are
/// already rounded to the codes in the files.
pub(crate) struct Sample {
    pub(crate) json: Value,
    pub(crate) files: Vec<Vec<u8>>,
    pub(crate) display: Display,
    pub(crate) stack: LayerStack,
    pub(crate) geometry: FieldGeometry,
}

impl Sample {
    pub(crate) fn new(display: Display, seed: u64) -> Self {
        let geometry = display.geometry().unwrap();
        let mut random = Stream::new(seed);
        let mut stack = LayerStack::filled(&display, 0.0);
        let (mut entries, mut files) = (Vec::new(), Vec::new());
        let mut codes = |count: usize| (0..count).map(|_| (256.0 * random.next_f32()) as u8).collect::<Vec<u8>>();
        for frame in 0..display.frames {
            for layer in 0..display.layers.len() {
                let [cols, rows] = display.layers[layer].resolution;
                let codes = codes(3 * rows * cols);
                let place = stack.layers[layer].block_mut([frame]);
                place.iter_mut().zip(&codes).for_each(|(value, code)| *value = f32::from(*code) / 255.0);
                files.push(png(rows, cols, &codes));
                let path = format!("stack/layer{layer}_frame{frame}.png");
                let bytes = files.last().unwrap().len() as u64;
                entries.push(File { path, part: Part::Layer { layer, frame }, rows, cols, bytes });
            }
            if let Some(emission) = &mut stack.emission {
                let [_, bins_y, bins_x, rows, cols, _] = emission.shape();
                let codes = codes(3 * bins_y * bins_x * rows * cols);
                // write the pixels of the emission at the places that the format defines
                for y in 0..bins_y * rows {
                    for x in 0..bins_x * cols {
                        for c in 0..3 {
                            let value = f32::from(codes[3 * (y * bins_x * cols + x) + c]) / 255.0;
                            *emission.at_mut([frame, y / rows, x / cols, y % rows, x % cols, c]) = value;
                        }
                    }
                }
                files.push(png(bins_y * rows, bins_x * cols, &codes));
                let (path, part) = (format!("stack/emission_frame{frame}.png"), Part::Emission { frame });
                entries.push(File { path, part, rows: bins_y * rows, cols: bins_x * cols, bytes: 0 });
            }
        }
        for view in geometry.grid.iter() {
            files.push(png(geometry.rows, geometry.cols, &codes(3 * geometry.rows * geometry.cols)));
            let path = format!("stack/target_{:02}_{:02}.png", view[0], view[1]);
            entries.push(File {
                path,
                part: Part::Target { view },
                rows: geometry.rows,
                cols: geometry.cols,
                bytes: 0,
            });
        }
        let preview = Preview {
            schema: Preview::SCHEMA.into(),
            version: Preview::VERSION,
            title: "random".into(),
            brightness: display.brightness,
            frames: display.frames,
            target: Target::from(&geometry),
            files: entries,
            rounding_db: Some(50.0),
            display: display.clone(),
        };
        Self { json: serde_json::to_value(preview).unwrap(), files, display, stack, geometry }
    }

    pub(crate) fn model(&self) -> Model {
        Model::new(&self.json.to_string()).unwrap()
    }

    pub(crate) fn full_model(&self) -> Model {
        let mut model = self.model();
        for (i, bytes) in self.files.iter().enumerate() {
            model.put(i, bytes).unwrap();
        }
        model
    }

    /// Returns the seen picture L̃ that the forward model computes.
    fn emitted(&self, display: &Display, projection: Projection, slope: [f64; 2]) -> Vec<f32> {
        let geometry = self.geometry.with_grid(ViewGrid::single(projection, slope));
        let simulator = Simulator::new(display, &self.stack);
        simulator.seen(&geometry, [0, 0]).radiance.into_data()
    }
}

fn plain() -> Display {
    let plain = Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &[-12.0, 0.0, 12.0], 2);
    Display { brightness: 0.25, ..plain }
}

/// Returns displays that together cover every variant of the shader.
pub(crate) fn displays() -> Vec<Display> {
    let mut directional = plain();
    directional.backlight = Backlight::Lenslets(LensletBacklight::new(-20.0, [4, 3], 4.0, [3, 2], [20.0, 20.0]));
    let mut uneven = plain();
    uneven.sampling = Sampling::Bilinear;
    uneven.layers[0] = Layer::new(-12.0, [7, 5], 2.4);
    uneven.layers[2] = Layer::new(12.0, [33, 21], 0.5);
    let mut perspective = plain();
    perspective.field.projection = lumistack_display::ProjectionKind::Perspective;
    perspective.field.distance_mm = Some(200.0);
    perspective.missing = Missing::Clear;
    let mut hardware = plain();
    hardware.layers[1].blur_px = 0.8;
    hardware.layers[2].crosstalk = Some([[0.9, 0.1, 0.0], [0.05, 0.9, 0.0], [0.0, 0.1, 0.8]]);
    let eight: Vec<f64> = (0..8).map(|n| 3.0 * f64::from(n) - 10.5).collect();
    let eight = Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &eight, 1);
    let additive = Display { formation: Formation::Additive, missing: Missing::Clear, ..plain() };
    let polarization = Display { formation: Formation::Polarization, ..directional.clone() };
    vec![plain(), directional, uneven, perspective, hardware, eight, additive, polarization]
}

const SLOPES: [[f64; 2]; 4] = [[0.0, 0.0], [0.1, -0.05], [-0.31, 0.2], [0.004, 0.117]];

#[test]
fn the_cpu_path_is_the_forward_model() {
    for (i, display) in displays().into_iter().enumerate() {
        let sample = Sample::new(display, 7 + i as u64);
        let (model, projection) = (sample.full_model(), sample.geometry.grid.projection);
        for slope in SLOPES {
            let expected = sample.emitted(&sample.display, projection, slope);
            let gain = (1.0 / sample.display.brightness) as f32;
            let found = model.view_linear(slope);
            assert!(found.iter().any(|v| *v > 0.0) || slope[0] < -0.3, "display {i}: black");
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - gain * expected).abs() <= SUMMATION * gain, "display {i}: {found} {expected}");
            }
            let bytes = model.render(slope);
            for (bytes, linear) in bytes.chunks_exact(4).zip(found.chunks_exact(3)) {
                assert_eq!(bytes, [srgb_code(linear[0]), srgb_code(linear[1]), srgb_code(linear[2]), 255]);
            }
        }
    }
}

#[test]
fn options_change_the_display() {
    let sample = Sample::new(plain(), 3);
    let mut model = sample.full_model();
    let mut check = |options: Value, display: &Display, stack: &LayerStack, projection, scale: f32| {
        model.set_options(&options.to_string()).unwrap();
        let sample = Sample { stack: stack.clone(), ..Sample::new(plain(), 3) };
        let expected = sample.emitted(display, projection, [0.07, 0.02]);
        for (found, expected) in model.view_linear([0.07, 0.02]).iter().zip(&expected) {
            assert!((found - scale * expected).abs() < SUMMATION * scale, "{options}: {found} {expected}");
        }
    };
    let (display, stack, oblique) = (&sample.display, &sample.stack, Projection::Oblique);
    check(json!({"gain": 1.0}), display, stack, oblique, 1.0);
    let mut changed = display.clone();
    (changed.layers[0].d_mm, changed.layers[2].d_mm) = (-14.0, 14.0);
    check(json!({"gap_mm": 2.0}), &changed, stack, oblique, 4.0);
    let mut changed = display.clone();
    changed.layers[2].offset_mm = [1.5, -2.0];
    check(json!({"shift_mm": [1.5, -2.0]}), &changed, stack, oblique, 4.0);
    let mut lifted = stack.clone();
    lifted.layers.iter_mut().flat_map(Tensor::data_mut).for_each(|v| *v = 0.25 + 0.75 * *v);
    check(json!({"black_level": 0.25}), display, &lifted, oblique, 4.0);
    let mut second = stack.clone();
    second.layers.iter_mut().for_each(|layer| {
        let frame = layer.block([1]).to_vec();
        layer.block_mut([0]).copy_from_slice(&frame);
    });
    check(json!({"frame": 1}), display, &second, oblique, 4.0);
    check(json!({"eye_distance_mm": 90.0}), display, stack, Projection::Perspective { distance_mm: 90.0 }, 4.0);
    check(json!({}), display, stack, oblique, 4.0);
}

/// An eye with a pupil is focused on z = 0. It sees a dark point behind this plane blurred, and a
/// dark point on this plane sharp.
#[test]
fn a_pupil_blurs_what_is_off_the_plane() {
    let display = Display::uniform([61, 41], 1.0, [1, 1], [20.0, 20.0], &[-40.0, 0.0], 1);
    for (n, spread) in [(0, true), (1, false)] {
        let mut sample = Sample::new(display.clone(), 1);
        for layer in 0..2 {
            let mut codes = vec![255; 3 * 61 * 41];
            if layer == n {
                codes[3 * (20 * 61 + 30)..][..3].fill(0);
            }
            sample.files[layer] = png(41, 61, &codes);
        }
        let mut model = sample.full_model();
        model.set_options(&json!({"pupil_mm": 6.0, "eye_distance_mm": 60.0}).to_string()).unwrap();
        let linear = model.view_linear([0.0, 0.0]);
        let dark: Vec<usize> = (20..41).filter(|col| linear[3 * (20 * 61 + col)] < 0.999).collect();
        // The point is at −40 mm, and the pupil of 6 mm is at 60 mm. The rays between them cover a
        // width of 2.4 mm at z = 0.
        assert!(if spread { dark.len() >= 2 && dark.len() <= 4 } else { dark == [30] }, "{n}: {dark:?}");
    }
}

#[test]
fn frames_count_once_all_their_parts_are_there() {
    let sample = Sample::new(displays().remove(1), 5);
    let mut model = sample.model();
    assert!(model.view_linear([0.0; 2]).iter().all(|v| *v == 0.0));
    assert_eq!((model.psnr([0.0; 2]), model.frames_ready(), model.targets_ready()), (None, 0, 0));
    // The files of the second frame, three layers and the emission, arrive first. The last file
    // arrives twice. Each pair is the number of a file, and the number of complete frames after
    // this file has arrived.
    for (i, ready) in [(4, 0), (5, 0), (6, 0), (7, 1), (7, 1)] {
        model.put(i, &sample.files[i]).unwrap();
        assert_eq!(model.frames_ready(), ready);
    }
    let second = model.view_linear([0.05, 0.0]);
    for i in 0..4 {
        model.put(i, &sample.files[i]).unwrap();
    }
    assert_eq!((model.complete(), model.frames_ready()), (&[1, 0][..], 2));
    model.set_options(r#"{"frame": 1}"#).unwrap();
    assert_eq!(model.view_linear([0.05, 0.0]), second);
}

#[test]
fn targets_errors_and_scores_belong_to_the_nearest_view() {
    let sample = Sample::new(plain(), 11);
    let mut model = sample.full_model();
    assert_eq!(model.targets_ready(), 9);
    let slope = [sample.geometry.grid.slope_x[2] - 0.01, sample.geometry.grid.slope_y[0] + 0.02];
    assert_eq!(model.nearest_view(slope), [0, 2]);
    let target = model.target([0, 2]).unwrap().to_vec();
    let geometry = &sample.geometry;
    let seen = Simulator::new(&sample.display, &sample.stack).seen(geometry, [0, 2]);
    let emitted = EmittedView::from(seen);
    let linear: Vec<f32> = target.iter().map(|code| srgb_decode(f32::from(*code) / 255.0)).collect();
    let mut error = SquaredError::default();
    for (i, (value, target)) in emitted.radiance.data().iter().zip(&linear).enumerate() {
        if emitted.valid[i / 3] {
            error.add(f64::from(*value) / sample.display.brightness, f64::from(*target));
        }
    }
    assert!((model.psnr(slope).unwrap() - error.psnr()).abs() < 1e-6);
    let map = model.render_error(slope).unwrap();
    let at = |i: usize| {
        let error = |c: usize| (4.0 * emitted.radiance.data()[3 * i + c] - linear[3 * i + c]).abs();
        error(0).max(error(1)).max(error(2))
    };
    let missed = emitted.valid.iter().position(|valid| !valid).unwrap();
    assert_eq!(map[4 * missed..][..4], [0, 0, 0, 255]);
    let worst = (0..linear.len() / 3).find(|i| emitted.valid[*i] && at(*i) > 0.25).unwrap();
    assert_eq!(map[4 * worst..][..4], [252, 255, 214, 255]);
    // a single frame has another PSNR than the mean of all frames; the target does not change
    model.set_options(r#"{"frame": 0}"#).unwrap();
    assert!((model.psnr(slope).unwrap() - error.psnr()).abs() > 1e-3);
    assert_eq!(model.render_target([0, 2]).unwrap()[..3], target[..3]);
    let layer = model.render_layer(1, 0).unwrap();
    assert_eq!((layer.len(), layer[0]), (4 * 160, srgb_code(sample.stack.layers[1].data()[0])));
}

#[test]
fn damaged_input_is_refused_and_changes_nothing() {
    let sample = Sample::new(plain(), 2);
    let mut model = sample.full_model();
    let before = model.view_linear([0.0; 2]);
    let good = &sample.files[0];
    let mut flipped = good.clone();
    let at = flipped.len() / 2;
    flipped[at] ^= 0x55;
    for (bytes, message) in [
        (&good[..good.len() / 2], "layer0_frame0.png: expected a PNG picture, found"),
        (&good[..good.len() - 12], "layer0_frame0.png: expected a PNG picture, found"),
        (&flipped, "layer0_frame0.png: expected a PNG picture, found"),
        (b"<!doctype html>", "layer0_frame0.png: expected a PNG picture, found 15 bytes"),
        (&[], "layer0_frame0.png: expected a PNG picture, found 0 bytes"),
        (&png(10, 15, &[0; 450]), "layer0_frame0.png: expected 16 × 10 pixels, found 15 × 10"),
    ] {
        let error = model.put(0, bytes).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    assert!(model.put(999, good).unwrap_err().to_string().contains("found 999"));
    assert_eq!(model.view_linear([0.0; 2]), before);
    for (options, message) in [
        (r#"{"gian": 2}"#, "unknown field `gian`"),
        (r#"{"gain": 0}"#, "gain: expected a number above 0"),
        (r#"{"black_level": 1.5}"#, "black_level: expected 0 to 1, found 1.5"),
        (r#"{"frame": 2}"#, "frame: expected a frame from 0 to 1"),
        ("", "options: EOF"),
    ] {
        let error = model.set_options(options).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    assert!(model.render_layer(3, 0).is_err() && model.render_target([3, 0]).is_err());
}

#[test]
fn previews_that_make_no_sense_say_where() {
    let sample = Sample::new(plain(), 2);
    let with = |change: &dyn Fn(&mut Value)| {
        let mut json = sample.json.clone();
        change(&mut json);
        Model::new(&json.to_string()).unwrap_err().to_string()
    };
    for (error, message) in [
        (with(&|j| j["version"] = json!(2)), "version: expected 1, found 2"),
        (with(&|j| j["schema"] = json!("x")), "schema: expected \"lumistack-preview\", found \"x\""),
        (with(&|j| j["frames"] = json!(3)), "frames: expected 2, as the display has, found 3"),
        (with(&|j| j["brightness"] = json!(0)), "brightness: expected a number above 0"),
        (with(&|j| j["display"]["layers"][1]["d_mm"] = json!(-99)), "display: layers[1].d_mm"),
        (with(&|j| j["files"][0]["layer"] = json!(9)), "files[0]: expected a layer and a frame of the display"),
        (with(&|j| j["files"][0]["rows"] = json!(9)), "files[0]: expected 16 × 10 pixels, found 16 × 9"),
        (with(&|j| j["files"][0]["rows"] = json!(1u64 << 40)), "files[0]: expected 1 to"),
        (with(&|j| j["files"][0] = j["files"][1].clone()), "files: expected layer 0 of frame 0, found none"),
        (with(&|j| j["files"][6]["view"] = json!([3, 0])), "files[6]: expected a view of the target"),
        (with(&|j| j["target"]["projection"] = json!("perspective")), "target.projection"),
        (with(&|j| *j = json!([])), "schema: expected \"lumistack-preview\", found \"\""),
    ] {
        assert!(error.contains(message), "{error}");
    }
    assert!(Model::new("{").unwrap_err().to_string().starts_with("preview.json: expected a preview"));
}

#[test]
fn a_backlight_is_shown_bin_by_bin() {
    let directional = Sample::new(displays().remove(1), 1);
    let backlight = directional.full_model().render_backlight(0).unwrap();
    assert_eq!((backlight.len(), backlight[0]), (4 * 72, srgb_code(directional.stack.emission.unwrap().data()[0])));
}

/// A function in f64 reads the tables as the shader does. It computes the same picture as the
/// simulator, so the tables contain all geometry that the shader needs.
#[test]
fn tables_hold_the_whole_geometry() {
    for (i, display) in displays().into_iter().enumerate() {
        let sample = Sample::new(display, 20 + i as u64);
        let mut model = sample.full_model();
        for options in
            [json!({}), json!({"pupil_mm": 8.0, "gap_mm": 0.7}), json!({"eye_distance_mm": 150.0, "frame": 0})]
        {
            model.set_options(&options.to_string()).unwrap();
            for slope in SLOPES {
                let expected = model.view_linear(slope);
                let found = as_the_shader_does(&model, slope);
                for (found, expected) in found.iter().zip(&expected) {
                    assert!(
                        (found - expected).abs() < 2e-5 * model.gain(),
                        "display {i} {options}: {found} {expected}"
                    );
                }
            }
        }
    }
}

/// Computes every pixel as display.frag.glsl does, in f64.
fn as_the_shader_does(model: &Model, slope: [f64; 2]) -> Vec<f32> {
    let display = &model.preview().display;
    let tables = model.tables(slope, model.projection());
    let (rows, cols, layers) = (model.geometry().rows, model.geometry().cols, display.layers.len());
    let slots = model.slots();
    let frames = &model.complete()[slots.first..slots.first + slots.count];
    let hits: Vec<_> = (0..layers).map(|n| model.hit_values(n, frames)).collect();
    let texel = |table: &[f32], row: usize, width: usize, i: usize| {
        let at = 4 * (row * width + i);
        [table[at], table[at + 1], table[at + 2], table[at + 3]]
    };
    let black = model.options().black_level;
    let mut picture = vec![0.0f32; 3 * rows * cols];
    for (i, value) in picture.iter_mut().enumerate() {
        let (c, col, row) = (i % 3, i / 3 % cols, i / 3 / cols);
        let (mut sum, mut count) = (0.0f64, 0.0f64);
        for (place, _) in tables.on_disc.iter().enumerate().filter(|(_, on)| **on) {
            let (place_y, place_x) = (place / tables.places, place % tables.places);
            count += 1.0;
            let (mut light, mut area) = (0.0, 0.0);
            for (part_y, part_x) in (0..tables.parts[1]).flat_map(|y| (0..tables.parts[0]).map(move |x| (y, x))) {
                let row_x = (place_x * tables.parts[0] + part_x) * tables.rows_per_part;
                let row_y = (place_y * tables.parts[1] + part_y) * tables.rows_per_part;
                let share = f64::from(texel(&tables.x, row_x, cols, col)[3] * texel(&tables.y, row_y, rows, row)[3]);
                let (mut view, mut counts) = (0.0, true);
                for (m, &frame) in frames.iter().enumerate() {
                    let mut value = f64::from(display.formation.neutral());
                    let combine = |value: &mut f64, v: f64| match display.formation {
                        Formation::Attenuating => *value *= v,
                        _ => *value += v,
                    };
                    for n in 0..layers {
                        let (x, y) = (texel(&tables.x, row_x + n, cols, col), texel(&tables.y, row_y + n, rows, row));
                        if x[0] < 0.0 || y[0] < 0.0 {
                            counts &= display.missing == Missing::Clear;
                            continue;
                        }
                        let at = |r: f32, col: f32| f64::from(hits[n].get([m, r as usize, col as usize, c]));
                        let [tx, ty] = [f64::from(x[2]), f64::from(y[2])];
                        let top = at(y[0], x[0]) * (1.0 - tx) + at(y[0], x[1]) * tx;
                        let bottom = at(y[1], x[0]) * (1.0 - tx) + at(y[1], x[1]) * tx;
                        combine(&mut value, black + (1.0 - black) * (top * (1.0 - ty) + bottom * ty));
                    }
                    if display.formation == Formation::Polarization {
                        value = (std::f64::consts::FRAC_PI_2 * value).sin().powi(2);
                    }
                    if let Backlight::Lenslets(b) = &display.backlight {
                        let x = texel(&tables.x, row_x + layers, cols, col);
                        let y = texel(&tables.y, row_y + layers, rows, row);
                        counts &= x[0] > -1.5 && y[0] > -1.5;
                        let codes = model.codes(Part::Emission { frame }).unwrap();
                        let emitted = if x[0] < 0.0 || y[0] < 0.0 {
                            0.0
                        } else {
                            let line = y[1] as usize * b.lenslets[1] + y[0] as usize;
                            let column = x[1] as usize * b.lenslets[0] + x[0] as usize;
                            f64::from(codes[3 * (line * b.views[0] * b.lenslets[0] + column) + c]) / 255.0
                        };
                        if display.formation == Formation::Additive { value += emitted } else { value *= emitted }
                    }
                    view += value / frames.len() as f64;
                }
                if counts {
                    (light, area) = (light + share * view, area + share);
                }
            }
            // compute the mean over the pixel's area separately for each point of the pupil
            sum += if area > 0.0 { light / area } else { 0.0 };
        }
        *value = (f64::from(model.gain()) * sum / count) as f32;
    }
    picture
}

#[test]
fn light_fields_are_mixed_in_linear_light() {
    let mut field = Field::new([1, 2], [1, 3]).unwrap();
    assert_eq!(field.render(0.5, 0.5), [0, 0, 0, 255, 0, 0, 0, 255]);
    for (view, code) in [0u8, 255, 100].into_iter().enumerate() {
        field.put([0, view], [code, code, code, 255].repeat(2)).unwrap();
    }
    assert_eq!(field.render(0.25, 0.0)[0], srgb_code(0.5));
    assert_eq!((field.render(1.0, 0.7)[0], field.render(-3.0, 9.0)[0], field.render(0.5, 0.0)[0]), (100, 0, 255));
    assert!(field.put([1, 0], vec![0; 8]).is_err() && field.put([0, 0], vec![0; 7]).is_err());
    // a quilt of 2 × 2 tiles of one pixel each; view 0 is the tile at the bottom left
    let tiles: Vec<u8> = [30u8, 40, 10, 20].iter().flat_map(|code| [*code, 0, 0, 255]).collect();
    let quilt = Field::from_quilt(&tiles, [2, 2], [2, 2]).unwrap();
    assert_eq!([0, 1, 2, 3].map(|view| quilt.codes(view).unwrap()[0]), [10, 20, 30, 40]);
    assert!(Field::from_quilt(&tiles, [2, 2], [3, 1]).is_err() && Field::from_quilt(&tiles, [2, 3], [2, 2]).is_err());
    assert!(Field::new([0, 2], [1, 3]).is_err() && Field::new([1 << 31, 1 << 31], [1 << 31, 9]).is_err());
}
