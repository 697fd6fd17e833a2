//! Tests of the options of `lumistack render`: scene-linear views, additional channels, selected
//! views, a rotated environment, and a background.

use std::path::Path;
use std::process::Command;

use exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read};
use lumistack_field_io::picture::Picture;
use serde_json::Value;

use crate::common::triangle::write_triangle;
use crate::common::{fail, files, lumistack, root, succeed};

const SMALL: [&str; 6] = ["--resolution", "30x18", "--samples", "4", "--max-bounces", "2"];

fn render(scene: &Path, folder: &Path, options: &[&str]) -> Command {
    let mut command = lumistack();
    command.arg("render").arg(scene).arg("-o").arg(folder).args(SMALL).args(["--views", "5x5"]).args(options);
    command
}

fn still_life(folder: &Path, options: &[&str]) -> Command {
    render(&root().join("scenes/still-life/still-life.gltf"), folder, options)
}

fn index(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("lightfield.json")).unwrap()).unwrap()
}

fn view(folder: &Path, name: &str) -> Vec<f32> {
    Picture::read(&folder.join(name)).unwrap().into_linear()
}

/// Returns a channel of a file with additional channels.
fn channel(file: &Path, name: &str) -> Vec<f32> {
    let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let image = image.all_attributes().from_file(file).unwrap();
    let list = image.layer_data.channel_data.list;
    let found = list.iter().find(|channel| channel.name.to_string() == name);
    let found = found.unwrap_or_else(|| panic!("no channel {name}"));
    match &found.sample_data {
        FlatSamples::F32(values) => values.clone(),
        _ => panic!("{name} is no single float"),
    }
}

#[test]
fn exposed_views_follow_from_linear_views() {
    let folder = tempfile::tempdir().unwrap();
    let (shown, linear) = (folder.path().join("shown"), folder.path().join("linear"));
    succeed(&mut still_life(&shown, &["--tone", "linear", "--exposure-ev", "1"]));
    succeed(&mut still_life(&linear, &["--linear"]));
    let exposure = index(&shown)["info"]["exposure"].as_f64().unwrap();
    assert_eq!(
        (index(&linear)["info"]["tone"].as_str(), index(&linear)["info"]["exposure"].as_f64()),
        (Some("none"), Some(1.0))
    );
    let (mut brightest, mut clipped) = (0.0f32, 0);
    for name in ["view_00_00.exr", "view_02_03.exr"] {
        for (shown, radiance) in view(&shown, name).iter().zip(view(&linear, name)) {
            let expected = (f64::from(radiance) * exposure).clamp(0.0, 1.0) as f32;
            // the files have half floats, whose relative rounding error is at most 2^-11
            assert!((shown - expected).abs() <= 1e-3 * expected + 1e-6, "{shown} is not {expected}");
            brightest = brightest.max(radiance * exposure as f32);
            clipped += usize::from(f64::from(radiance) * exposure > 1.0);
        }
    }
    assert!(clipped > 0 && brightest > 1.01, "nothing was clipped: {brightest}");
    let text = String::from_utf8(still_life(&linear, &["--linear", "--tone", "agx"]).output().unwrap().stderr).unwrap();
    assert!(text.contains("cannot be used with"), "{text}");
}

#[test]
fn layers_agree_with_views() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_triangle(folder.path());
    let views = folder.path().join("views");
    let layers = "depth,normal,albedo,variance,coverage";
    succeed(&mut render(&scene, &views, &["--linear", "--layers", layers]));
    let about = &index(&views)["info"]["layers"];
    assert_eq!((about["depth"]["unit"].as_str(), about["variance"]["unit"].as_str()), (Some("mm"), Some("radiance²")));
    assert!(about["scene_units_per_mm"].as_f64().unwrap() > 0.0);
    let file = views.join("layers_01_03.exr");
    let of = |name: &str| channel(&file, name);
    let (coverage, depth, normal) = (of("coverage.A"), of("depth.Z"), of("normal.Z"));
    let full = |i: &usize| coverage[*i] == 1.0;
    assert!((0..coverage.len()).filter(full).count() > 20 && coverage.contains(&0.0));
    // All channels of a pixel come from the same paths, so they must agree.
    let (mut past, mut absent) = (0, 0);
    for i in 0..coverage.len() {
        if coverage[i] == 1.0 {
            // the triangle faces the display, so its normal is the z axis
            assert!(depth[i].is_finite() && (normal[i] - 1.0).abs() < 1e-5, "{} {}", depth[i], normal[i]);
            assert!((of("albedo.G")[i] - 1.0).abs() < 1e-5);
        } else if coverage[i] == 0.0 {
            past += 1;
            absent += usize::from(depth[i].is_nan() && normal[i] == 0.0 && of("albedo.R")[i] == 0.0);
        }
    }
    assert_eq!(absent, past);
    let flat: Vec<f32> = depth.iter().copied().filter(|z| z.is_finite()).collect();
    assert!(flat.iter().all(|z| (z - flat[0]).abs() < 0.1), "the triangle faces the display");
    let variance = of("variance.R");
    assert!(variance.iter().all(|value| *value >= 0.0) && variance.iter().any(|value| *value > 0.0));
    // sixteen times the samples give a sixteenth of the variance
    let mean = |folder: &Path| -> f64 {
        let values = channel(&folder.join("layers_01_03.exr"), "variance.R");
        values.iter().map(|value| f64::from(*value)).sum()
    };
    let more = folder.path().join("more");
    succeed(&mut render(&scene, &more, &["--layers", "variance", "--samples", "64"]));
    let ratio = mean(&more) / mean(&views);
    assert!((0.03..0.12).contains(&ratio), "a sixteenth: {ratio}");
    let text = fail(&mut render(&scene, &more, &["--layers", "variance", "--samples", "1"]));
    assert!(text.contains("--layers: expected at least 2 paths per pixel and view"), "{text}");
}

/// The additional channels come from the first hits of the paths that make the light. These first
/// hits are cached with the views. If they are deleted, the same rays are traced again and hit the
/// same surfaces.
#[test]
fn surfaces_are_those_of_the_paths_of_the_light() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |folder: &Path| -> Vec<(String, Vec<u8>)> {
        let all = files(folder).into_iter().map(|(path, content)| (path.display().to_string(), content));
        all.filter(|(path, _)| path.starts_with("layers_") || path.starts_with("view_")).collect()
    };
    let layers = ["--layers", "depth,normal,albedo,coverage"];
    for denoise in ["off", "shared", "guided"] {
        let views = folder.path().join(denoise);
        let run = || succeed(still_life(&views, &["--denoise", denoise]).args(layers));
        run();
        let kept = bytes(&views);
        assert_eq!(kept.len(), 50, "a view and its layers for each of 25 views");
        let mut cached = std::fs::read_dir(views.join("cache")).unwrap().map(|entry| entry.unwrap().path());
        let cache = cached.find(|path| path.file_name().unwrap().to_string_lossy().starts_with("target-")).unwrap();
        let (mut dropped, parts) = (0, if denoise == "guided" { 2 } else { 1 });
        for entry in std::fs::read_dir(&cache).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            let is_guide = name.starts_with("guides_");
            if is_guide || name.starts_with("missed_") {
                std::fs::remove_file(&path).unwrap();
            } else if denoise == "guided" && path.is_dir() {
                // Remove the filtered views, too, since the filter used the deleted guides.
                std::fs::remove_dir_all(&path).unwrap();
            }
            dropped += usize::from(is_guide);
        }
        assert_eq!(dropped, 25 * parts);
        run();
        assert!(bytes(&views) == kept, "{denoise}: other surfaces");
    }
}

#[test]
fn some_views_are_those_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    succeed(&mut still_life(&at("all"), &["--linear"]));
    succeed(&mut still_life(&at("row"), &["--linear", "--only-views", "2,*"]));
    let list = |name: &str| -> Vec<String> {
        let names = files(&at(name)).into_iter().map(|(path, _)| path.display().to_string());
        names.filter(|name| name.starts_with("view_")).collect()
    };
    assert_eq!(list("row"), (0..5).map(|x| format!("view_02_{x:02}.exr")).collect::<Vec<_>>());
    for name in list("row") {
        assert!(view(&at("row"), &name) == view(&at("all"), &name), "{name} is another picture");
    }
    // complete rows of views form a light field
    let row = index(&at("row"));
    assert_eq!((&row["slope_x"], row["slope_y"].as_array().unwrap().len()), (&index(&at("all"))["slope_x"], 1));
    assert_eq!(row["info"]["part_of"]["rows"], serde_json::json!([2]));
    let text = succeed(lumistack().arg("info").arg(at("row")));
    assert!(text.contains("views: [5, 1]"), "{text}");
    // views that are not whole rows and columns do not form a light field, and are marked as
    // partial
    succeed(&mut still_life(&at("two"), &["--linear", "--only-views", "0,0", "--only-views", "2,3..4"]));
    assert_eq!((list("two").len(), index(&at("two"))["partial"].as_bool()), (3, Some(true)));
    let text = fail(lumistack().arg("factorize").arg(at("two")).arg("-o").arg(at("run")));
    assert!(
        text.contains("expected all views, or whole rows and columns of views") && text.contains("found 3 of 25"),
        "{text}"
    );
    // a call without `--only-views` renders the missing views, which completes the light field
    succeed(&mut still_life(&at("two"), &["--linear"]));
    assert!(files(&at("two")) == files(&at("all")));
    let text = fail(&mut still_life(&at("two"), &["--only-views", "5,0"]));
    assert!(
        text.contains("--only-views: expected a row from 0 to 4 (the views have 5 rows and 5 columns), found 5"),
        "{text}"
    );
    let text = fail(&mut still_life(&at("two"), &["--only-views", "0,0", "--denoise", "guided"]));
    assert!(text.contains("`--denoise off`"), "{text}");
}

#[test]
fn the_environment_turns_and_hides() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_triangle(folder.path());
    let of = |name: &str, options: &[&str]| {
        let views = folder.path().join(name);
        succeed(&mut render(&scene, &views, &[&["--layers", "coverage"], options].concat()));
        let shown = view(&views, "view_02_02.exr");
        let coverage = channel(&views.join("layers_02_02.exr"), "coverage.A");
        (shown, coverage, index(&views)["info"]["exposure"].as_f64().unwrap())
    };
    let lit = of("lit", &[]);
    let turned = of("turned", &["--environment-rotation", "120", "--linear"]);
    let straight = of("straight", &["--linear"]);
    let dim = of("dim", &["--environment-strength", "0.5", "--linear"]);
    assert!(turned.0 != straight.0, "the studio light turns");
    // compare only pixels on surfaces, since the background may be something else than the
    // environment
    for i in (0..straight.0.len()).filter(|i| straight.1[i / 3] == 1.0) {
        let (dim, straight) = (dim.0[i], straight.0[i]);
        assert!((dim - 0.5 * straight).abs() < 1e-5 * straight.max(1.0), "{dim} is not half of {straight}");
    }
    let ground = of("ground", &["--background", "#204060"]);
    let other = of("other", &["--background", "#ffffff"]);
    assert_eq!(ground.2, other.2, "exposure does not see the background");
    let codes = |rgb: &[f32]| [0, 1, 2].map(|c| lumistack_core::colour::srgb_code(rgb[c]));
    let (mut free, mut surface) = (0, 0);
    for i in 0..ground.1.len() {
        let [here, there, before] = [&ground.0, &other.0, &lit.0].map(|view| &view[3 * i..3 * i + 3]);
        if ground.1[i] == 0.0 {
            assert_eq!((codes(here), codes(there)), ([0x20, 0x40, 0x60], [255; 3]));
            assert!(codes(before) != [0x20, 0x40, 0x60]);
            free += 1;
        } else if ground.1[i] == 1.0 {
            assert_eq!(here, there, "light does not come from the background");
            surface += 1;
        }
    }
    assert!(free > 20 && surface > 20, "{free} {surface}");
    let text = String::from_utf8(render(&scene, folder.path(), &["--background", "sky"]).output().unwrap().stderr);
    assert!(text.unwrap().contains("a colour such as `#202028`"));
}
