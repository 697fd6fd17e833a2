//! The example `patterns`, on a model without light.

#[allow(dead_code, reason = "the example's `main` reads arguments, which a test has not")]
#[path = "../examples/patterns.rs"]
mod patterns;

use std::path::Path;

/// The model is `letters.gltf` without lamps and environment, so only studio light lights it.
#[test]
fn the_example_makes_patterns_of_a_model_without_light() {
    let folder = tempfile::tempdir().unwrap();
    let letters = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/letters");
    for name in ["letters.bin", "charts.png", "graph-paper.png"] {
        std::fs::copy(letters.join(name), folder.path().join(name)).unwrap();
    }
    let text = std::fs::read_to_string(letters.join("letters.gltf")).unwrap();
    let mut file: serde_json::Value = serde_json::from_str(&text.replace("KHR_lights_punctual", "NONE_lamps")).unwrap();
    // the extras name the environment map
    file["scenes"][0].as_object_mut().unwrap().remove("extras").unwrap();
    let model = folder.path().join("dark.gltf");
    std::fs::write(&model, file.to_string()).unwrap();
    patterns::patterns(&model, folder.path()).unwrap();
    let seen = image::open(folder.path().join("seen.png")).unwrap().to_rgb8();
    assert_eq!(seen.dimensions(), (160, 100));
    // bright paper with darker letters
    let mut greens: Vec<u8> = seen.pixels().map(|pixel| pixel.0[1]).collect();
    greens.sort_unstable();
    let [low, high] = [greens[160], greens[greens.len() - 160]];
    assert!(low < 140 && high > 200, "hundredths of the green codes: {low} {high}");
    assert!(folder.path().join("layer_2_frame_1.png").is_file());
}

/// The page for Rust developers shows the example that this program compiles.
#[test]
fn the_page_shows_the_example_as_it_is() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap().replace("\r\n", "\n");
    let shown = format!("```rust\n{}```\n", read("crates/shot/examples/patterns.rs"));
    let page = "docs/start/RUST.md";
    assert!(read(page).contains(&shown), "{page} does not show crates/shot/examples/patterns.rs as it is");
}
