//! `still-life`: a glossy teapot on a checkerboard that runs through the display plane.
//!
//! The camera looks down by 24 degrees. On the display, depths are from -0.17 m at the foot of the
//! wall to about +0.1 m on the floor at the window's lower edge.

use glam::{DMat4, DQuat, DVec2, DVec3};
use serde_json::json;

use crate::encode::{Channels, jpeg, png};
use crate::gltf_document::{Document, Wrap};
use crate::mesh::Mesh;
use crate::sky::{Glow, Sky};
use crate::teapot::teapot;
use crate::textures::{self, CHECKS_PER_TILE};
use crate::window::{Window, node_at, uniform_scale};
use crate::{GeneratorError, SceneFile};

/// Tilt of the window, and distance of the camera.
pub(crate) const WINDOW: Window = Window { pitch_rad: 24.0 * std::f64::consts::PI / 180.0, focus_distance_m: 1.5 };

/// Height of the floor, metres.
const FLOOR_Y: f64 = -0.09;
/// Depth at which a display shows the edge between floor and wall, metres.
const WALL_DEPTH: f64 = -0.17;
/// Side of one check of the floor, metres.
const CHECK_M: f64 = 0.032;

/// Returns the files of the scene.
pub(crate) fn build() -> Result<Vec<SceneFile>, GeneratorError> {
    let mut document = Document::new("still-life");
    WINDOW.add_camera(&mut document);
    add_room(&mut document)?;
    add_teapot(&mut document)?;
    add_balls(&mut document)?;
    add_pins(&mut document);
    add_card(&mut document)?;
    add_lights(&mut document);
    document.finish(sky())
}

fn sky() -> Sky {
    Sky {
        zenith: DVec3::new(0.55, 0.68, 0.90),
        horizon: DVec3::new(0.80, 0.78, 0.74),
        ground: DVec3::new(0.22, 0.19, 0.16),
        glows: vec![
            Glow { direction: DVec3::new(-0.8, 0.5, 0.6), color: DVec3::new(2.2, 2.0, 1.7), sharpness: 12.0 },
            Glow { direction: DVec3::new(0.9, 0.3, 0.4), color: DVec3::new(0.5, 0.7, 1.1), sharpness: 8.0 },
        ],
    }
}

/// Adds floor and back wall. They are so large that no view with slopes up to 0.357 along both
/// axes shows their outer edges.
fn add_room(document: &mut Document) -> Result<(), GeneratorError> {
    let checks = document.add_texture(jpeg("checkerboard.jpg", &textures::checkerboard())?, Wrap::Repeat);
    let paper = document.add_texture(jpeg("wallpaper.jpg", &textures::wallpaper())?, Wrap::Repeat);
    let floor = document.add_material(json!({
        "name": "stone checks",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": checks }, "metallicFactor": 0.0, "roughnessFactor": 0.45
        }
    }));
    let wall = document.add_material(json!({
        "name": "wallpaper",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": paper }, "metallicFactor": 0.0, "roughnessFactor": 0.9
        }
    }));
    // floor and wall share an edge, which begins at `corner`
    let wall_z = WINDOW.at(0.0, FLOOR_Y, WALL_DEPTH).z;
    let (half_width, depth) = (0.8, 1.6);
    let corner = DVec3::new(-half_width, FLOOR_Y, wall_z);
    let tile = f64::from(CHECKS_PER_TILE) * CHECK_M;
    document.add_mesh_node(
        "floor",
        &Mesh::rectangle(corner, DVec3::X * 2.0 * half_width, DVec3::Z * depth)
            .with_texture_scale(DVec2::new(2.0 * half_width, depth) / tile),
        floor,
    );
    let height = 0.55;
    document.add_mesh_node(
        "wall",
        &Mesh::rectangle(corner + DVec3::Y * height, DVec3::X * 2.0 * half_width, DVec3::NEG_Y * height)
            .with_texture_scale(DVec2::new(2.0 * half_width, height) / 0.36),
        wall,
    );
    let skirting = document.add_material(json!({
        "name": "painted wood",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.62, 0.58, 0.50, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.4
        }
    }));
    document.add_mesh_node(
        "skirting board",
        &Mesh::cuboid(corner, corner + DVec3::new(2.0 * half_width, 0.014, 0.005)),
        skirting,
    );
    Ok(())
}

fn add_teapot(document: &mut Document) -> Result<(), GeneratorError> {
    let brushed =
        document.add_texture(png("brushed-metal.png", &textures::brushed_metal(), Channels::Rgb)?, Wrap::Repeat);
    let gold = document.add_material(json!({
        "name": "gold",
        "pbrMetallicRoughness": {
            "baseColorFactor": [1.0, 0.74, 0.32, 1.0],
            "metallicRoughnessTexture": { "index": brushed }
        },
        "doubleSided": true
    }));
    let mesh = document.add_simple_mesh("Utah teapot", &teapot(12, 0.038), gold);
    let mut node = node_at("Utah teapot", WINDOW.at(0.0, FLOOR_Y, -0.055), DQuat::from_rotation_y(-28f64.to_radians()));
    node["mesh"] = json!(mesh);
    document.add_node(node);
    Ok(())
}

/// Adds balls in front of, in and behind the display plane. There is one mesh for each material,
/// and a ball's node scales it.
fn add_balls(document: &mut Document) -> Result<(), GeneratorError> {
    let stripes =
        document.add_texture(png("striped-ball.png", &textures::striped_ball(), Channels::Rgb)?, Wrap::Repeat);
    let plastic = |name: &str, color: [f64; 3], roughness: f64| {
        json!({
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": [color[0], color[1], color[2], 1.0],
                "metallicFactor": 0.0, "roughnessFactor": roughness
            }
        })
    };
    let striped = json!({
        "name": "striped rubber",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": stripes }, "metallicFactor": 0.0, "roughnessFactor": 0.5
        }
    });
    let mirror = json!({
        "name": "polished steel",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.86, 0.87, 0.88, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.06
        }
    });
    // Each ball has a material, a radius, the position x and the depth z of its centre, and a
    // rotation. Lengths are metres in display axes. The rotation is about the vertical axis, in
    // degrees; all balls also have the same tilt.
    let balls = [
        (plastic("red plastic", [0.75, 0.06, 0.03], 0.25), 0.017, -0.115, 0.078, 0.0),
        (plastic("blue plastic", [0.04, 0.14, 0.62], 0.3), 0.023, -0.178, 0.015, 0.0),
        (plastic("green plastic", [0.07, 0.42, 0.10], 0.35), 0.02, 0.085, -0.135, 0.0),
        (plastic("yellow plastic", [0.85, 0.55, 0.04], 0.3), 0.012, 0.055, 0.082, 0.0),
        (striped, 0.03, 0.158, -0.105, 25.0),
        (mirror, 0.03, 0.152, 0.03, 0.0),
    ];
    let sphere = Mesh::sphere(1.0, 40, 20);
    for (material, radius, column, depth, turn) in balls {
        let name = format!("{} ball", material["name"].as_str().unwrap_or_default());
        let material = document.add_material(material);
        let mesh = document.add_simple_mesh(&name, &sphere, material);
        let mut node = node_at(
            &name,
            WINDOW.at(column, FLOOR_Y + radius, depth),
            DQuat::from_euler(glam::EulerRot::YXZ, f64::to_radians(turn), 0.35, 0.2),
        );
        node["mesh"] = json!(mesh);
        node["scale"] = uniform_scale(radius);
        document.add_node(node);
    }
    Ok(())
}

/// Adds thin pins in a line from front to back. They are wires of 2 mm with a bead on top, and
/// share one mesh.
fn add_pins(document: &mut Document) {
    let brass = document.add_material(json!({
        "name": "brass wire",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.86, 0.62, 0.30, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.3
        }
    }));
    let enamel = document.add_material(json!({
        "name": "white enamel",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.85, 0.83, 0.80, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.2
        }
    }));
    let height = 0.075;
    let wire = Mesh::lathe(&[(0.001, height), (0.001, 0.002), (0.006, 0.002), (0.006, 0.0)], 16);
    let bead = Mesh::sphere(0.0035, 20, 10).translated(DVec3::Y * height);
    let primitives = vec![document.primitive(&wire, brass), document.primitive(&bead, enamel)];
    let mesh = document.add_mesh("pin", primitives);
    for (k, depth) in [0.085, 0.045, 0.005, -0.035, -0.075, -0.115].into_iter().enumerate() {
        let name = format!("pin at {:+} mm", (depth * 1000.0f64).round());
        let mut node = node_at(&name, WINDOW.at(0.212 - 0.004 * k as f64, FLOOR_Y, depth), DQuat::IDENTITY);
        node["mesh"] = json!(mesh);
        document.add_node(node);
    }
}

/// Adds a printed card that leans against the wall, far behind the display plane.
fn add_card(document: &mut Document) -> Result<(), GeneratorError> {
    let print = document.add_texture(png("text-card.png", &textures::text_card(), Channels::Rgb)?, Wrap::Clamp);
    let card = document.add_material(json!({
        "name": "printed card",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": print }, "metallicFactor": 0.0, "roughnessFactor": 0.7
        }
    }));
    let board = document.add_material(json!({
        "name": "grey board",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.45, 0.43, 0.40, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8
        }
    }));
    let (width, height, thickness) = (0.150, 0.100, 0.0015);
    let face = Mesh::rectangle(DVec3::new(-0.5 * width, height, 0.0), DVec3::X * width, DVec3::NEG_Y * height);
    let body = Mesh::cuboid(DVec3::new(-0.5 * width, 0.0, -thickness), DVec3::new(0.5 * width, height, -1e-4));
    let lean = DMat4::from_rotation_x(-9f64.to_radians());
    let primitives =
        vec![document.primitive(&face.transformed(lean), card), document.primitive(&body.transformed(lean), board)];
    let mesh = document.add_mesh("card", primitives);
    // lift the leaning card, so that the lower edge of its back is not below the floor
    let lift = thickness * 9f64.to_radians().sin();
    let mut node =
        node_at("card", WINDOW.at(-0.142, FLOOR_Y + lift, -0.132), DQuat::from_rotation_y(8f64.to_radians()));
    node["mesh"] = json!(mesh);
    document.add_node(node);
    Ok(())
}

/// Adds two lamps, which no view shows: a large warm lamp and a narrow cool lamp.
fn add_lights(document: &mut Document) {
    for (name, color, strength, centre, width, height) in [
        ("large lamp", [1.0, 0.93, 0.82], 7.0, DVec3::new(-0.30, 1.00, 0.38), 0.55, 0.45),
        ("strip lamp", [0.75, 0.87, 1.0], 5.0, DVec3::new(0.85, 0.5, 0.5), 0.12, 0.5),
    ] {
        let material = document.add_material(lamp_material(name, color, strength));
        document.add_mesh_node(name, &lamp(centre, DVec3::new(0.0, FLOOR_Y, 0.0), width, height), material);
    }
}

/// Returns a black material with emission, so that a lamp emits light and reflects none.
pub(crate) fn lamp_material(name: &str, color: [f64; 3], strength: f64) -> serde_json::Value {
    json!({
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.0, 0.0, 0.0, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0
        },
        "emissiveFactor": color,
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": strength } }
    })
}

/// Makes a rectangle around `centre` that faces `target`.
pub(crate) fn lamp(centre: DVec3, target: DVec3, width: f64, height: f64) -> Mesh {
    let outward = (target - centre).normalize();
    let right = DVec3::Y.cross(outward).normalize();
    let down = right.cross(outward) * height;
    let right = right * width;
    Mesh::rectangle(centre - 0.5 * right - 0.5 * down, right, down)
}
