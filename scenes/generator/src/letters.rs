//! `letters`: solid words at five depths in front of finely ruled paper and resolution charts.
//!
//! The camera looks along -z, so display axes are world axes. Each word stands on a rail that is
//! wider than the window. A small number next to the word states the depth of its front face in
//! millimetres.

use std::f64::consts::FRAC_PI_6;

use glam::{DQuat, DVec2, DVec3};
use serde_json::{Value, json};

use crate::encode::{Channels, png};
use crate::gltf_document::{Document, Wrap, rounded};
use crate::lettering::solid_text;
use crate::mesh::Mesh;
use crate::paint::rgb;
use crate::sky::{Glow, Sky};
use crate::textures;
use crate::window::{Window, node_at};
use crate::{GeneratorError, SceneFile};

/// Tilt of the window, and distance of the camera.
pub(crate) const WINDOW: Window = Window { pitch_rad: 0.0, focus_distance_m: 1.5 };

/// Depth at which a display shows the wall of ruled paper, metres.
const WALL_DEPTH: f64 = -0.175;
/// Distance from the front of a word to its back, metres.
const LETTER_DEPTH_M: f64 = 0.012;
/// Half the length of a rail, metres.
const RAIL_HALF_WIDTH_M: f64 = 0.45;

/// Colouring of a word.
enum Paint {
    /// One colour for the whole word, stored in the material.
    Plain([f64; 3]),
    /// A vertex colour gradient from bottom to top, stored as 8-bit RGBA.
    Bytes([f64; 3], [f64; 3]),
    /// A vertex colour gradient from left to right, stored as floats.
    Floats([f64; 3], [f64; 3]),
}

/// A word: its text, the bottom left corner of its front face, the size of its dots, and its
/// colours.
struct Word {
    text: &'static str,
    corner: DVec3,
    dot_m: f64,
    paint: Paint,
    metallic: f64,
    roughness: f64,
    /// Position x, in display axes, of the left end of the number that states the word's depth.
    label_x: f64,
}

/// Returns the files of the scene.
pub(crate) fn build() -> Result<Vec<SceneFile>, GeneratorError> {
    let mut document = Document::new("letters");
    WINDOW.add_camera(&mut document);
    add_wall_and_charts(&mut document)?;
    let rail = document.add_material(json!({
        "name": "anodized rail",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.30, 0.31, 0.33, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.45
        }
    }));
    let number = document.add_material(json!({
        "name": "black numbers",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.03, 0.03, 0.035, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.6
        }
    }));
    // each word has its depth in millimetres next to it
    for word in words() {
        add_word(&mut document, &word);
        add_rail(&mut document, &word, rail);
        let depth_mm = (word.corner.z * 1000.0).round();
        let label = if depth_mm == 0.0 { "0".to_string() } else { format!("{depth_mm:+}") };
        let corner = DVec3::new(word.label_x, word.corner.y, word.corner.z);
        document.add_mesh_node(
            &format!("depth {label}"),
            &solid_text(&label, 0.0022, 0.003).translated(corner),
            number,
        );
    }
    add_lights(&mut document);
    document.finish(sky())
}

fn words() -> [Word; 5] {
    let word = |text, corner: [f64; 3], dot_m, paint, metallic, roughness, label_x| Word {
        text,
        corner: DVec3::from_array(corner),
        dot_m,
        paint,
        metallic,
        roughness,
        label_x,
    };
    let red = Paint::Plain([0.78, 0.03, 0.03]);
    let orange = Paint::Bytes([0.80, 0.10, 0.01], [0.95, 0.62, 0.05]);
    let green = Paint::Plain([0.02, 0.50, 0.10]);
    let blue = Paint::Plain([0.02, 0.10, 0.75]);
    let violet = Paint::Floats([0.70, 0.02, 0.45], [0.05, 0.45, 0.80]);
    [
        word("TENSOR", [-0.215, 0.086, -0.150], 0.0072, red, 0.0, 0.35, 0.047),
        word("DISPLAY", [-0.130, 0.030, -0.080], 0.0074, orange, 0.0, 0.30, -0.174),
        word("LUMISTACK", [-0.200, -0.026, 0.000], 0.0075, green, 0.0, 0.25, 0.207),
        word("LAYERS", [-0.206, -0.082, 0.050], 0.0072, blue, 0.0, 0.20, 0.058),
        word("LIGHT", [-0.008, -0.138, 0.090], 0.0074, violet, 0.0, 0.30, -0.056),
    ]
}

fn add_word(document: &mut Document, word: &Word) {
    let mesh = solid_text(word.text, word.dot_m, LETTER_DEPTH_M);
    let plain = if let Paint::Plain(color) = word.paint { color } else { [1.0; 3] };
    let material = document.add_material(json!({
        "name": format!("{} paint", word.text.to_lowercase()),
        "pbrMetallicRoughness": {
            "baseColorFactor": [plain[0], plain[1], plain[2], 1.0],
            "metallicFactor": word.metallic, "roughnessFactor": word.roughness
        }
    }));
    let mut primitive = document.primitive(&mesh, material);
    let blended = |low: [f64; 3], high: [f64; 3], t: f64| -> [f64; 3] {
        std::array::from_fn(|channel| low[channel] + t * (high[channel] - low[channel]))
    };
    // vertex colours are gradients over the texture coordinates, which are 0..1 over the line
    match word.paint {
        Paint::Plain(_) => {}
        Paint::Bytes(bottom, top) => {
            let colors: Vec<[u8; 4]> = mesh
                .texcoords
                .iter()
                .map(|t| {
                    let [r, g, b] = blended(bottom, top, 1.0 - t.y).map(|c| (c * 255.0).round() as u8);
                    [r, g, b, 255]
                })
                .collect();
            primitive["attributes"]["COLOR_0"] = json!(document.add_bytes(&colors));
        }
        Paint::Floats(left, right) => {
            let colors: Vec<[f32; 3]> =
                mesh.texcoords.iter().map(|t| blended(left, right, t.x).map(|c| c as f32)).collect();
            primitive["attributes"]["COLOR_0"] = json!(document.add_floats(&colors, true));
        }
    }
    let index = document.add_mesh(word.text, vec![primitive]);
    let mut node = node_at(word.text, word.corner, DQuat::IDENTITY);
    node["mesh"] = json!(index);
    document.add_node(node);
}

/// Adds the rail below a word. The fronts of rail and word are in one plane.
fn add_rail(document: &mut Document, word: &Word, material: usize) {
    let front = word.corner.z;
    let low = DVec3::new(-RAIL_HALF_WIDTH_M, word.corner.y - 0.004, front - LETTER_DEPTH_M);
    let high = DVec3::new(RAIL_HALF_WIDTH_M, word.corner.y, front);
    document.add_mesh_node(&format!("rail of {}", word.text), &Mesh::cuboid(low, high), material);
}

/// Adds graph paper over the whole wall, two charts, and a slanted card of graph paper. The charts
/// share one texture, and each chart shows a part of it by a texture transform.
fn add_wall_and_charts(document: &mut Document) -> Result<(), GeneratorError> {
    document.use_extension("KHR_texture_transform");
    let paper = textures::graph_paper(rgb(226, 229, 224), rgb(70, 118, 150));
    let paper = document.add_texture(png("graph-paper.png", &paper, Channels::Rgb)?, Wrap::Repeat);
    let charts = textures::resolution_charts();
    let charts = document.add_texture(png("charts.png", &charts, Channels::Gray)?, Wrap::Clamp);
    let transformed = |texture: usize, transform: Value| json!({ "index": texture, "extensions": { "KHR_texture_transform": transform } });
    let matte = |name: &str, texture: Value| {
        json!({
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorTexture": texture, "metallicFactor": 0.0, "roughnessFactor": 0.9
            }
        })
    };
    let (half_width, half_height) = (0.4, 0.32);
    // One repetition of the graph paper's texture is 40 mm wide.
    let wall = document.add_material(matte(
        "graph paper",
        transformed(paper, json!({ "scale": [half_width / 0.02, half_height / 0.02] })),
    ));
    document.add_mesh_node(
        "wall",
        &Mesh::rectangle(
            DVec3::new(-half_width, half_height, WALL_DEPTH),
            DVec3::X * 2.0 * half_width,
            DVec3::NEG_Y * 2.0 * half_height,
        ),
        wall,
    );
    let star = matte("Siemens star", transformed(charts, json!({ "scale": [0.5, 1.0] })));
    let pairs = matte("line pairs", transformed(charts, json!({ "offset": [0.5, 0.0], "scale": [0.5, 1.0] })));
    // The slanted card turns the paper's ruling by 30 degrees about the texture's corner.
    let slanted = matte(
        "slanted graph paper",
        transformed(paper, json!({ "rotation": rounded(FRAC_PI_6), "scale": [1.6, 1.6], "offset": [0.1, 0.2] })),
    );
    for (material, left_top, size, depth) in [
        (star, DVec2::new(0.106, 0.142), DVec2::new(0.125, 0.125), -0.168),
        (pairs, DVec2::new(-0.222, -0.022), DVec2::new(0.120, 0.120), -0.168),
        (slanted, DVec2::new(0.146, -0.024), DVec2::new(0.075, 0.075), -0.170),
    ] {
        let name = format!("{} card", material["name"].as_str().unwrap_or_default());
        let material = document.add_material(material);
        let top_left = DVec3::new(left_top.x, left_top.y, depth);
        let mesh = Mesh::rectangle(top_left, DVec3::X * size.x, DVec3::NEG_Y * size.y);
        document.add_mesh_node(&name, &mesh, material);
    }
    Ok(())
}

/// Adds a point light at the upper left in front of the window, and a spot light from the right.
/// Intensities are in candela.
fn add_lights(document: &mut Document) {
    let eye = DVec3::new(-0.35, 0.45, 0.55);
    let mut point = node_at("point light", eye, DQuat::IDENTITY);
    point["extensions"] = document.add_light(json!({
        "name": "warm bulb", "type": "point", "color": [1.0, 0.86, 0.68], "intensity": 0.5
    }));
    document.add_node(point);
    let position = DVec3::new(0.55, 0.35, 0.60);
    // a spot light points along its node's -z
    let aim = DQuat::from_rotation_arc(DVec3::NEG_Z, (DVec3::new(0.05, -0.02, -0.05) - position).normalize());
    let mut spot = node_at("spot light", position, aim);
    spot["extensions"] = document.add_light(json!({
        "name": "cool spot", "type": "spot", "color": [0.72, 0.85, 1.0], "intensity": 0.55, "range": 5.0,
        "spot": { "innerConeAngle": 0.14, "outerConeAngle": 0.34 }
    }));
    document.add_node(spot);
}

fn sky() -> Sky {
    Sky {
        zenith: DVec3::new(0.66, 0.74, 0.86),
        horizon: DVec3::new(0.58, 0.57, 0.56),
        ground: DVec3::new(0.14, 0.13, 0.12),
        glows: vec![Glow { direction: DVec3::new(0.2, 0.6, 0.8), color: DVec3::new(0.9, 0.85, 0.75), sharpness: 6.0 }],
    }
}
