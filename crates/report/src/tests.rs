//! Reports of small synthetic displays of every kind, checked as text, as HTML and against the
//! display crate's own score.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use lumistack_core::metrics::Flip;
use lumistack_core::{Cancel, Collector, Task, Tensor, Warning, seed};
use lumistack_display::{Display, LayerStack, LightField, Projection, ViewGrid, Weights, score, view_error};
use serde_json::{Value, json};

mod figures;

use crate::{DenoisedView, Denoising, Iteration, Output, Report, ReportError, ReportInput, Solution, Stage, build};

/// Tolerance of a PSNR in report.json against the PSNR of the display crate, dB. Both computations
/// sum in f64, in the same order.
const SAME_DB: f64 = 1e-9;

/// Returns a display of `layers` layers, `frames` frames and [horizontal, vertical] views.
fn display(layers: usize, frames: usize, views: [usize; 2], resolution: [usize; 2], extra: &str) -> Display {
    let [cols, rows] = resolution;
    let mut text = format!(
        "name = \"small <one> & \\\"only\\\"\"\nframes = {frames}\nbrightness = 0.2\n[field]\nresolution = [{cols}, {rows}]\npitch_mm = 1.0\nviews = {views:?}\nfov_deg = [20.0, 20.0]\n"
    );
    for n in 0..layers {
        let d_mm = 12.0 * n as f64 - 6.0;
        text += &format!("[[layers]]\nd_mm = {d_mm:?}\nresolution = [{cols}, {rows}]\npitch_mm = 1.0\n");
    }
    Display::from_toml(&(text + extra)).unwrap()
}

const LENSLETS: &str = "[backlight]\nkind = \"lenslets\"\nd_mm = -9.0\nlenslets = [5, 4]\npitch_mm = 4.0\nfov_deg = [20.0, 20.0]\nviews = [3, 2]\n";

fn noise(data: &mut [f32], seed: u64, scale: f32) {
    let mut stream = seed::Stream::new(seed);
    data.iter_mut().for_each(|value| *value = scale * stream.next_f32());
}

fn noisy_stack(display: &Display) -> LayerStack {
    let mut stack = LayerStack::filled(display, 0.0);
    stack.layers.iter_mut().enumerate().for_each(|(n, layer)| noise(layer.data_mut(), n as u64, 1.0));
    stack.emission.iter_mut().for_each(|emission| noise(emission.data_mut(), 99, 1.0));
    stack
}

fn noisy_field(display: &Display, grid: Option<ViewGrid>) -> LightField {
    let geometry = display.geometry().unwrap();
    let geometry = grid.map_or(geometry.clone(), |grid| geometry.with_grid(grid));
    let mut field = LightField::black(geometry).unwrap();
    noise(field.radiance_mut().data_mut(), 7, 1.0);
    field
}

fn plain<'a>(display: &'a Display, stack: &'a LayerStack, target: &'a LightField) -> ReportInput<'a> {
    ReportInput {
        title: "plain",
        display,
        stack,
        target,
        weights: &Weights::Uniform,
        held_out: None,
        outside: None,
        zone: None,
        pixels_per_degree: Flip::DEFAULT_PIXELS_PER_DEGREE,
        convergence: &[],
        solution: None,
        stages: &[],
        settings: &Value::Null,
        denoising: None,
        scene: None,
        depth: None,
        warnings: &[],
        outputs: &[],
        command: None,
        version: "0.0.0",
    }
}

fn built(input: &ReportInput) -> Result<Report, ReportError> {
    build(input, Task::quiet(&Collector::default(), &Cancel::default()))
}

/// Checks rules that every page must obey. Returns the number of embedded pictures.
fn check_page(html: &str) -> usize {
    check_balanced(html);
    check_links(html);
    let without_namespace = html.replace("http://www.w3.org/2000/svg", "");
    assert!(!without_namespace.contains("http://") && !without_namespace.contains("https://"), "an outside reference");
    let mut pictures = 0;
    let mut texts = html[..html.find("base64,").unwrap_or(html.len())].to_string();
    for part in html.split("data:image/").skip(1) {
        let (_, rest) = part.split_once(";base64,").unwrap();
        let bytes = STANDARD.decode(&rest[..rest.find('"').unwrap()]).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap();
        assert!(picture.width() > 0 && picture.height() > 0);
        pictures += 1;
        texts += &rest[rest.find('"').unwrap()..];
    }
    assert!(!texts.contains("NaN") && !texts.contains(">inf"), "an unformatted figure");
    pictures
}

/// Checks that all elements are closed in order. Attributes are quoted, so `>` ends a tag.
fn check_balanced(html: &str) {
    const VOID: [&str; 4] = ["meta", "img", "input", "br"];
    let mut open: Vec<String> = Vec::new();
    let mut rest = html;
    while let Some(start) = rest.find('<') {
        rest = &rest[start + 1..];
        if rest.starts_with("!DOCTYPE") {
            continue;
        }
        let name: String = rest.trim_start_matches('/').chars().take_while(char::is_ascii_alphanumeric).collect();
        let end = rest.find('>').expect("a tag ends");
        let (closes, closes_itself) = (rest.starts_with('/'), rest[..end].ends_with('/'));
        rest = &rest[end + 1..];
        assert!(!name.is_empty(), "a stray < before {:?}", &rest[..rest.len().min(40)]);
        if closes {
            assert_eq!(open.pop().as_deref(), Some(name.as_str()));
        } else if !closes_itself && !VOID.contains(&name.as_str()) {
            if name == "style" || name == "script" {
                rest = &rest[rest.find(&format!("</{name}>")).expect("style and script end")..];
            }
            open.push(name);
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
}

/// If a page links to its sections, checks that the links lead to all of them, in order.
fn check_links(html: &str) {
    let names = |before: &str| -> Vec<String> {
        html.split(before).skip(1).map(|rest| rest[..rest.find('"').unwrap()].to_string()).collect()
    };
    let links = names("href=\"#");
    assert!(links.is_empty() || links == names("<section id=\""), "{links:?}");
}

fn json_psnr(value: &Value) -> f64 {
    match value {
        Value::Null => f64::NAN,
        Value::String(text) => text.parse().unwrap(),
        number => number.as_f64().unwrap(),
    }
}

#[test]
fn every_kind_of_display_gets_a_page_whose_figures_are_the_scores() {
    let cases = [
        ("one pixel, one view", display(1, 1, [1, 1], [1, 1], "")),
        ("one view, several frames", display(2, 3, [1, 1], [9, 4], "")),
        ("one row of views", display(2, 2, [4, 1], [16, 5], "")),
        ("one column of views", display(2, 2, [1, 3], [5, 16], "")),
        ("eight layers", display(8, 1, [3, 3], [40, 30], "")),
        ("lenslets", display(1, 2, [3, 2], [20, 16], LENSLETS)),
        ("two layers and lenslets", display(2, 1, [3, 3], [20, 16], LENSLETS)),
    ];
    for (name, display) in cases {
        let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
        let report = built(&plain(&display, &stack, &target)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let pictures = check_page(&report.html);
        let patterns = display.frames * (display.layers.len() + usize::from(stack.emission.is_some()));
        assert!(pictures >= 3 + patterns, "{name}: {pictures} pictures");
        let expected = score(&display, &stack, &target, &Weights::Uniform);
        assert!((json_psnr(&report.json["psnr_view"]) - expected.psnr_view()).abs() < SAME_DB, "{name}");
        assert!((json_psnr(&report.json["psnr_raw"]) - expected.psnr_raw()).abs() < SAME_DB, "{name}");
        assert_eq!((report.psnr_view, report.psnr_raw), (expected.psnr_view(), expected.psnr_raw()), "{name}");
        for view in &expected.views {
            let found = json_psnr(&report.json["views"]["psnr_view"][view.view[0]][view.view[1]]);
            assert!((found - view.error.psnr()).abs() < SAME_DB, "{name} {:?}", view.view);
        }
        let text = report.json.to_string();
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap()["schema"], "lumistack/report", "{name}");
    }
}

#[test]
fn held_out_views_and_weights_are_scored_as_given() {
    let display = display(3, 2, [3, 3], [24, 20], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let held_out = noisy_field(&display, Some(target.geometry().grid.in_between()));
    let mut weights = Tensor::filled(["view_y", "view_x"], [3, 3], 1.0);
    *weights.at_mut([0, 2]) = 0.0;
    let weights = Weights::PerView(weights);
    let input = ReportInput { held_out: Some(&held_out), weights: &weights, ..plain(&display, &stack, &target) };
    let report = built(&input).unwrap();
    check_page(&report.html);
    let expected = score(&display, &stack, &target, &weights);
    assert_eq!(report.psnr_view, expected.psnr_view());
    let expected = score(&display, &stack, &held_out, &Weights::Uniform).psnr_view();
    assert_eq!(report.held_out_psnr_view, Some(expected));
    assert!((json_psnr(&report.json["held_out"]["overall_psnr_view"]) - expected).abs() < SAME_DB);
    assert_eq!(report.json["held_out"]["psnr_view"].as_array().map(Vec::len), Some(2));
    assert!(report.json["views"]["psnr_view"][0][2].is_null(), "a view without weight has no PSNR");
    assert_eq!(report.json["views"]["counted_share"][0][2], 0.0);
    assert!(report.html.contains("In-between view") && report.html.contains("Held-out"));
}

#[test]
fn an_exact_display_is_infinitely_good_and_says_so() {
    let display = display(1, 1, [2, 2], [6, 4], "");
    let stack = LayerStack::filled(&display, 0.0);
    let target = LightField::black(display.geometry().unwrap()).unwrap();
    let report = built(&plain(&display, &stack, &target)).unwrap();
    check_page(&report.html);
    assert_eq!(report.json["psnr_view"], "Infinity");
    assert_eq!(json_psnr(&report.json["psnr_raw"]), f64::INFINITY);
    assert!(report.html.contains("∞ dB"));
}

#[test]
fn a_display_without_hits_has_no_figure() {
    let mut display = display(2, 1, [1, 1], [4, 4], "");
    display.layers[1].offset_mm = [100.0, 0.0];
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let report = built(&plain(&display, &stack, &target)).unwrap();
    check_page(&report.html);
    assert!(report.json["psnr_view"].is_null() && report.html.contains("– dB"));
}

#[test]
fn texts_are_escaped_and_everything_given_is_shown() {
    let display = display(2, 2, [3, 3], [12, 8], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let evil = "</script><img src=x onerror=alert(1)>\"'&";
    let history = [(0, 12.0), (1, 20.0), (2, f64::NAN), (3, 23.5)].map(|(iteration, psnr_view)| Iteration {
        iteration,
        objective: 1.0,
        psnr_view,
        seconds: f64::from(iteration),
    });
    let solution = Solution {
        solver: "extrapolated".into(),
        start: "content".into(),
        coarse_levels: 1,
        kkt_residual: 2.5e-4,
        levels: Some([40.0, 30.0, 36.5]),
    };
    let input = ReportInput {
        title: evil,
        convergence: &history,
        solution: Some(&solution),
        stages: &[
            Stage { name: evil.into(), seconds: 1.5, cached: true },
            Stage { name: "factorize".into(), seconds: 61.0, cached: false },
        ],
        settings: &json!({ evil: { "iterations": 50, "list": [1, 2], "text": evil } }),
        scene: Some(&json!({ "name": evil, "triangles": 12 })),
        warnings: &[Warning { place: evil.into(), message: evil.into() }],
        outputs: &[Output { label: evil.into(), path: format!("javascript:{evil}"), failed: None }],
        command: Some(evil),
        version: evil,
        ..plain(&display, &stack, &target)
    };
    let report = built(&input).unwrap();
    check_page(&report.html);
    assert!(!report.html.contains("<img src=x") && !report.html.contains("\"javascript:"));
    for text in ["from the cache", "iterations", "1 warning", "psnr_view, dB", "12", "62.5 s"] {
        assert!(report.html.contains(text), "{text}");
    }
    assert_eq!(report.json["title"], evil);
    assert_eq!(report.json["convergence"][3]["psnr_view"], 23.5);
    assert_eq!(report.json["solution"]["levels"]["reoptimized"], 36.5);
    assert!(report.html.contains("Solver extrapolated, start content, first at half the resolution."));
    assert!(
        report
            .html
            .contains("30.0 dB with values that are rounded to the levels, and 36.5 dB after another optimization"),
        "{}",
        report.html
    );
    assert!(report.json["convergence"][2]["psnr_view"].is_null());
    assert_eq!(report.json["seconds_total"], 62.5);
    assert_eq!(report.json["warnings"][0]["place"], evil);
}

#[test]
fn a_foreign_grid_is_laid_out_as_the_eye_moves() {
    let display = display(1, 1, [2, 2], [8, 6], "");
    let mut grid = display.geometry().unwrap().grid;
    grid.slope_x.reverse();
    grid.slope_y.reverse();
    let target = noisy_field(&display, Some(grid));
    let stack = noisy_stack(&display);
    let report = built(&plain(&display, &stack, &target)).unwrap();
    // The top left cell of the table is the last view in the report's JSON.
    let cells = report.html.split("class=\"heat\"").nth(1).unwrap();
    let first = cells.split("<td").nth(1).unwrap().split(['>', '<']).nth(1).unwrap();
    let last_view = json_psnr(&report.json["views"]["psnr_view"][1][1]);
    assert_eq!(first, crate::format::decibels(last_view));
}

#[test]
fn unusable_input_is_an_error() {
    let (small, large) = (display(2, 2, [3, 3], [12, 8], ""), display(2, 2, [3, 3], [13, 8], ""));
    let (stack, target) = (noisy_stack(&large), noisy_field(&small, None));
    let error = built(&plain(&small, &stack, &target)).unwrap_err();
    assert!(
        error.to_string().starts_with("layer stack: shape [frame][row][col][rgb] of layer 0: expected [2, 8, 12, 3]"),
        "{error}"
    );
    let stack = noisy_stack(&small);
    let weights = Weights::PerView(Tensor::filled(["view_y", "view_x"], [1, 1], 1.0));
    let error = built(&ReportInput { weights: &weights, ..plain(&small, &stack, &target) }).unwrap_err();
    assert!(matches!(error, ReportError::Weights(_)));
    let cancel = Cancel::default();
    cancel.cancel();
    let error = build(&plain(&small, &stack, &target), Task::quiet(&Collector::default(), &cancel)).unwrap_err();
    assert!(matches!(error, ReportError::Cancelled(_)));
}

#[test]
fn large_displays_stay_small_files() {
    /// Browsers and mail attachments support at least this size, bytes.
    const LARGEST: usize = 15_000_000;
    // The display is the paper's prototype with masks of full size. The masks are noise, which is
    // the worst case for every encoder.
    let display = display(3, 12, [2, 2], [840, 525], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let report = built(&plain(&display, &stack, &target)).unwrap();
    assert!(report.html.len() < LARGEST, "{} bytes", report.html.len());
    assert!(report.html.contains("Shown at 1/3 size") && report.html.contains("close-up: frame 12"));
}

#[test]
fn the_simulated_view_is_divided_by_the_brightness() {
    // A clear pixel at β = 0.2 with a target of 1 must be shown as white, not as 0.2.
    let display = display(1, 1, [1, 1], [1, 1], "");
    let mut target = LightField::black(display.geometry().unwrap()).unwrap();
    target.radiance_mut().data_mut().fill(1.0);
    let stack = LayerStack::filled(&display, 0.2);
    let report = built(&plain(&display, &stack, &target)).unwrap();
    let emitted = lumistack_display::forward::view_from_slope(&display, &stack, [0.0; 2]).into();
    assert!(view_error(&emitted, &[1.0; 3], 0.2, |_| 1.0).psnr() > 60.0);
    assert!(report.psnr_view > 60.0);
    let simulated = report.html.split("alt=\"Simulated: Central view").next().unwrap();
    let uri = simulated.rsplit("base64,").next().unwrap();
    let bytes = STANDARD.decode(&uri[..uri.find('"').unwrap()]).unwrap();
    assert_eq!(image::load_from_memory(&bytes).unwrap().to_rgb8().into_raw(), [255; 3]);
}

#[test]
fn a_denoised_target_is_reported() {
    let display = display(2, 2, [3, 2], [16, 8], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let plain = plain(&display, &stack, &target);
    assert!(!built(&plain).unwrap().html.contains("denoising"));
    let view =
        DenoisedView { mean: 0.5, mean_change: [0.001, 0.0005], mse_before: [2e-3, 1e-5], mse_after: [3e-4, 2e-5] };
    let mut filtered = target.view([0, 1]).to_vec();
    filtered[0] += 0.25;
    let denoising = Denoising {
        name: "a filter",
        overall: view,
        views: vec![view; 6],
        unbiased: target.view([0, 1]),
        filtered: &filtered,
    };
    let report = built(&ReportInput { denoising: Some(&denoising), ..plain }).unwrap();
    check_page(&report.html);
    for text in [
        "Every view was filtered by a filter",
        "2.00e-3 ± 1e-5 before, 3.00e-4 ± 2e-5 after",
        "+0.200 %",
        "href=\"#denoising\"",
    ] {
        assert!(report.html.contains(text), "{text}");
    }
    assert_eq!(report.json["denoising"]["views"].as_array().unwrap().len(), 6);
}

/// A report shows at most seven views per axis. Numbers of all views still have the right places.
#[test]
fn figures_of_many_views_count_all_views() {
    let display = display(2, 2, [3, 2], [16, 8], "");
    let grid = ViewGrid::uniform(Projection::Oblique, [13, 1], [20.0, 0.0]).unwrap();
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, Some(grid)));
    let unknown = DenoisedView { mean: 0.5, mse_before: [f64::NAN; 2], mse_after: [f64::NAN; 2], ..Default::default() };
    let mut views = vec![unknown; 13];
    views[11] = DenoisedView { mse_before: [2e-3, 1e-5], mse_after: [3e-4, 2e-5], ..unknown };
    let denoising = Denoising {
        name: "a filter",
        overall: views[11],
        views,
        unbiased: target.view([0, 6]),
        filtered: target.view([0, 6]),
    };
    let report = built(&ReportInput { denoising: Some(&denoising), ..plain(&display, &stack, &target) }).unwrap();
    assert!(report.html.contains("<td>0, 11</td>"), "the only measured view");
    assert!(!report.html.contains("NaN ±"));
    let limits = report.json["limits"].as_array().unwrap();
    let frames = limits.iter().find(|limit| limit["name"] == "Frames").unwrap();
    assert!(frames["text"].as_str().unwrap().contains("13 views"), "{frames}");
    // more rays than the 7 measured views have
    let of_view = target.view([0, 0]).len() as u64;
    assert!(frames["figures"]["values_of_rays"].as_u64().unwrap() > 12 * of_view, "{frames}");
}
