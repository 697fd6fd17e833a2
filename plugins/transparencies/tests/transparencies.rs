//! Rasterizes the pages of the PDF with poppler's `pdftoppm`, as a printer would, and compares them
//! with the masks.

use std::collections::{BTreeMap, HashMap};
use std::process::Command;

use lumistack_plugin::core::seed::Stream;
use lumistack_plugin::display::{Display, Formation, Layer, LayerStack};
use lumistack_plugin::serde_json::{Value, from_slice, json};
use lumistack_plugin::{PluginError, Time};
use lumistack_plugin_testkit::serve::{LogLevel, Output, OutputData, Plugin};
use lumistack_plugin_testkit::{MemoryHost, conformance};
use lumistack_plugin_transparencies::PLUGIN;
use lumistack_plugin_transparencies::curve::Film;

type Files = BTreeMap<String, Vec<u8>>;

/// Dots per inch of the rasterized pages. Poppler smooths pictures that it enlarges less than four
/// times, even if the file forbids it. At this resolution a mask pixel is at least six dots wide.
const DPI: usize = 300;
/// Pitches of the layers: six dots and eight dots at [`DPI`].
const PITCH_MM: [f64; 2] = [3.0 * 25.4 / 150.0, 4.0 * 25.4 / 150.0];

fn write(display: &Display, stack: &LayerStack, params: Value) -> Result<(Files, Vec<String>), PluginError> {
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN)?);
    let output = Output::open(&plugin, &host, &params, display)?;
    output.submit(Time::default(), OutputData::LayerStack(stack, None))?;
    output.finish()?;
    let warnings = host.messages().into_iter().filter(|(level, _)| *level == LogLevel::Warn).map(|(_, text)| text);
    Ok((host.files(), warnings.collect()))
}

/// Returns a display of two layers of different sizes and positions, and a stack of random values.
fn sample() -> (Display, LayerStack) {
    let mut display = Display::uniform([90, 60], PITCH_MM[0], [3, 3], [10.0, 10.0], &[-3.0, 3.0], 1);
    display.name = "two films".into();
    display.layers[1] = Layer { offset_mm: [2.0, -1.5], peak: 0.8, ..Layer::new(3.0, [61, 47], PITCH_MM[1]) };
    let mut stack = LayerStack::filled(&display, 0.0);
    let mut random = Stream::new(5);
    for (layer, tensor) in display.layers.iter().zip(&mut stack.layers) {
        tensor.data_mut().fill_with(|| layer.peak as f32 * random.next_f32());
    }
    (display, stack)
}

fn has_pdftoppm() -> bool {
    let found = Command::new("pdftoppm").arg("-v").output().is_ok();
    if !found {
        lumistack_testkit::skip::skipped("no pdftoppm (the Debian package poppler-utils has it)");
    }
    found
}

/// Rasterizes a page of the PDF at [`DPI`].
fn render(files: &Files, page: u64) -> image::RgbImage {
    let folder = tempfile::tempdir().unwrap();
    let pdf = folder.path().join("a.pdf");
    if let Ok(path) = std::env::var("KEEP_PDF") {
        std::fs::write(path, &files["transparencies.pdf"]).unwrap();
    }
    std::fs::write(&pdf, &files["transparencies.pdf"]).unwrap();
    let number = page.to_string();
    let output = Command::new("pdftoppm")
        .args(["-r", &DPI.to_string(), "-png", "-f", &number, "-l", &number, "-singlefile"])
        .arg(&pdf)
        .arg(folder.path().join("page"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    image::open(folder.path().join("page.png")).unwrap().into_rgb8()
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

#[test]
fn printed_films_are_the_masks_at_true_size() {
    if !has_pdftoppm() {
        return;
    }
    let (display, stack) = sample();
    let curve = "0 0.08, 64 0.2, 128 0.4, 255 0.8";
    for (mirror, dpi) in [(false, 0), (true, 0), (false, 300)] {
        let params =
            json!({"curve": curve, "mirror": mirror, "dpi": dpi, "paper": if mirror { "letter" } else { "a4" }});
        let (files, warnings) = write(&display, &stack, params).unwrap();
        assert!(warnings.iter().any(|text| text.contains("black_level = 0.100")), "{warnings:?}");
        let manifest: Value = from_slice(&files["transparencies.json"]).unwrap();
        let film = Film::new(curve, 0.0).unwrap();
        for (n, layer) in display.layers.iter().enumerate() {
            let entry = &manifest["files"][n];
            assert_eq!((&entry["layer"], &entry["page"]), (&json!(n), &json!(3 + n)));
            let place: Vec<f64> = (0..4).map(|i| entry["place_mm"][i].as_f64().unwrap()).collect();
            let [cols, rows] = layer.resolution;
            assert!((place[2] - cols as f64 * layer.pitch_mm).abs() < 1e-9, "true size");
            let picture = render(&files, 3 + n as u64);
            let page_mm = &manifest["page_mm"];
            for (side, axis) in [(picture.width(), 0), (picture.height(), 1)] {
                let exact = page_mm[axis].as_f64().unwrap() / 25.4 * DPI as f64;
                assert!((f64::from(side) - exact).abs() <= 1.0, "{side} for {exact}");
            }
            let (codes, _) = film.codes(layer, stack.layers[n].data());
            let page_height = page_mm[1].as_f64().unwrap();
            let mut wrong = 0;
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                let seen = if mirror { cols - 1 - col } else { col };
                let x = place[0] + (seen as f64 + 0.5) * layer.pitch_mm;
                let y = page_height - place[1] - place[3] + (row as f64 + 0.5) * layer.pitch_mm;
                let dot = [x, y].map(|mm| (mm / 25.4 * DPI as f64) as u32);
                let found = picture.get_pixel(dot[0], dot[1]).0;
                let expected = &codes[3 * (row * cols + col)..][..3];
                wrong += usize::from(found != expected);
            }
            println!("mirror {mirror}, dpi {dpi}, layer {n}: {wrong} of {} pixels differ", rows * cols);
            assert_eq!(wrong, 0, "mirror {mirror}, dpi {dpi}, layer {n}");
            assert!(codes.contains(&0) && codes.contains(&255), "the codes 0 and 255 do not both occur");
        }
    }
}

#[test]
fn marks_of_all_films_coincide_and_cut_lines_stand_outside() {
    if !has_pdftoppm() {
        return;
    }
    let (display, stack) = sample();
    let (files, _) = write(&display, &stack, json!({})).unwrap();
    let manifest: Value = from_slice(&files["transparencies.json"]).unwrap();
    let pages = [render(&files, 3), render(&files, 4)];
    let size = |key: &str| [0, 1].map(|axis| manifest[key][axis].as_f64().unwrap());
    let (page, film) = (size("page_mm"), size("film_mm"));
    let dark = |picture: &image::RgbImage, mm: [f64; 2], reach: i64| {
        let dot = mm.map(|mm| (mm / 25.4 * DPI as f64) as i64);
        let near = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| [dot[0] + dx, dot[1] + dy]));
        near.map(|[x, y]| picture.get_pixel(x as u32, y as u32).0[1]).min().unwrap() < 160
    };
    for picture in &pages {
        // Check the cut lines and the marks at the film's corners. Positions are in millimetres
        // from the page's top left, and the marks are 6 mm inside the corners.
        for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let corner = [0.5 * (page[0] + sx * film[0]), 0.5 * (page[1] + sy * film[1])];
            assert!(dark(picture, [corner[0] + 4.0 * sx, corner[1]], 2), "cut line");
            assert!(dark(picture, [corner[0], corner[1] + 4.0 * sy], 2), "cut line");
            assert!(!dark(picture, [corner[0] - 1.0 * sx, corner[1] - 1.0 * sy], 2), "the film's corner is not empty");
            assert!(dark(picture, [corner[0] - 6.0 * sx, corner[1] - 6.0 * sy], 2), "mark");
            assert!(dark(picture, [corner[0] - 8.0 * sx, corner[1] - 6.0 * sy], 2), "arm of the mark");
        }
    }
}

#[test]
fn chart_and_assembly_sheet_are_there() {
    if !has_pdftoppm() {
        return;
    }
    let (display, stack) = sample();
    let (files, _) = write(&display, &stack, json!({"spacer_index": 1.49})).unwrap();
    let manifest: Value = from_slice(&files["transparencies.json"]).unwrap();
    assert!((manifest["spacers_mm"][0].as_f64().unwrap() - 5.9 * 1.49).abs() < 1e-9);
    let chart = render(&files, 2);
    let codes: Vec<u8> = (0..24).map(|i| manifest["chart_codes"][i].as_u64().unwrap() as u8).collect();
    // count the dots of every colour in one pass, since the chart has millions of dots
    let mut dots = HashMap::<[u8; 3], usize>::new();
    for pixel in chart.pixels() {
        *dots.entry(pixel.0).or_default() += 1;
    }
    for code in codes {
        for rgb in [[code; 3], [code, 255, 255], [255, code, 255], [255, 255, code]] {
            let count = dots.get(&rgb).copied().unwrap_or_default();
            assert!(count > 5000, "{rgb:?} on {count} dots");
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pdf");
    std::fs::write(&path, &files["transparencies.pdf"]).unwrap();
    let text = Command::new("pdftotext").args(["-layout", "-l", "1"]).arg(&path).arg("-").output().unwrap();
    let text = String::from_utf8(text.stdout).unwrap();
    for part in [
        "two films",
        "film 0: z = -3 mm, 90 x 60 pixels",
        "spacer of 8.791 mm, a plate of index 1.49",
        "film 1: z = 3 mm",
    ] {
        assert!(text.contains(part), "{part} is not in:\n{text}");
    }
    let (files, _) = write(&display, &stack, json!({"chart": false})).unwrap();
    let manifest: Value = from_slice(&files["transparencies.json"]).unwrap();
    assert_eq!(manifest["files"][0]["page"], 2);
}

#[test]
fn displays_that_cannot_be_printed_are_refused() {
    let (display, stack) = sample();
    let refused = |display: &Display, params: Value| match write(display, &stack, params) {
        Err(PluginError::Refused(text)) => text,
        other => panic!("{other:?}"),
    };
    let moving = Display { frames: 12, ..display.clone() };
    let text = refused(&moving, json!({}));
    assert_eq!(text, "expected a display with frames = 1, since printed layers are static, found frames = 12");
    let text = refused(&Display { formation: Formation::Additive, ..display.clone() }, json!({}));
    assert!(text.starts_with("expected formation = \"attenuating\", since film attenuates light"), "{text}");
    assert!(refused(&display, json!({"film_mm": 7})).contains("`film_mm`"));
    assert!(refused(&display, json!({"curve": "0 1, 255 0"})).contains("`curve`"));
    let mut wall = display.clone();
    wall.layers[1].pitch_mm = 6.0;
    assert!(refused(&wall, json!({})).contains("`paper`"));
    // The masks have values down to 0, so some values are below the film's least transmittance.
    let (_, warnings) = write(&display, &stack, json!({"min_transmittance": 0.05})).unwrap();
    assert!(warnings[0].contains("black_level = 0.050"), "{warnings:?}");
    let mut within = stack.clone();
    for (layer, tensor) in display.layers.iter().zip(&mut within.layers) {
        tensor.data_mut().iter_mut().for_each(|value| *value = value.max(0.05 * layer.peak as f32));
    }
    let (files, warnings) = write(&display, &within, json!({"min_transmittance": 0.05})).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert!(files["transparencies.pdf"].starts_with(b"%PDF-"));
}
