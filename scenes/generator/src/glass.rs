//! `glass`: mirrors, glass, panes and screens on glazed tiles.
//!
//! The camera looks down by 22 degrees. Together the objects use the features of glTF that plain
//! indexed triangles do not need:
//!
//! * sparse accessors, a triangle strip, a primitive without indices and normals,
//! * shared meshes under a node hierarchy with rotations and nonuniform scale,
//! * the alpha modes MASK and BLEND, normal maps, and transmission.

use glam::{DQuat, DVec2, DVec3};
use serde_json::{Value, json};

use crate::encode::{Channels, jpeg, png};
use crate::glass_meshes::{cut_gem, paper_ribbon, rippled_plate};
use crate::gltf_document::{Document, Wrap, rounded};
use crate::mesh::Mesh;
use crate::paint::rgb;
use crate::sky::{Glow, Sky};
use crate::still_life::{lamp, lamp_material};
use crate::textures;
use crate::window::{Window, node_at, uniform_scale};
use crate::{GeneratorError, SceneFile};

/// Tilt of the window, and distance of the camera.
pub(crate) const WINDOW: Window = Window { pitch_rad: 22.0 * std::f64::consts::PI / 180.0, focus_distance_m: 1.5 };

/// Height of the table, metres.
const TABLE_Y: f64 = -0.09;
/// Depth at which a display shows the edge between table and wall, metres.
const WALL_DEPTH: f64 = -0.18;

/// Returns the files of the scene.
pub(crate) fn build() -> Result<Vec<SceneFile>, GeneratorError> {
    let mut document = Document::new("glass");
    WINDOW.add_camera(&mut document);
    add_table_and_wall(&mut document)?;
    add_mirrors(&mut document);
    add_glass(&mut document)?;
    add_paper_and_screen(&mut document)?;
    add_plate_and_gem(&mut document);
    add_beads(&mut document);
    let material = document.add_material(lamp_material("lamp", [1.0, 0.95, 0.88], 7.0));
    let table = DVec3::new(0.0, TABLE_Y, 0.0);
    document.add_mesh_node("lamp", &lamp(DVec3::new(0.30, 1.0, 0.40), table, 0.55, 0.45), material);
    document.finish(sky())
}

fn sky() -> Sky {
    Sky {
        zenith: DVec3::new(0.50, 0.60, 0.78),
        horizon: DVec3::new(0.78, 0.74, 0.68),
        ground: DVec3::new(0.20, 0.18, 0.16),
        glows: vec![Glow { direction: DVec3::new(-0.9, 0.35, 0.5), color: DVec3::new(1.2, 1.3, 1.6), sharpness: 10.0 }],
    }
}

fn add_table_and_wall(document: &mut Document) -> Result<(), GeneratorError> {
    let color = document.add_texture(jpeg("tiles.jpg", &textures::tile_colors())?, Wrap::Repeat);
    let normals = png("tiles-normal.png", &textures::tile_normals(), Channels::Rgb)?;
    let normals = document.add_texture(normals, Wrap::Repeat);
    let tiles = document.add_material(json!({
        "name": "glazed tiles",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": color }, "metallicFactor": 0.0, "roughnessFactor": 0.22
        },
        "normalTexture": { "index": normals, "scale": 1.0 }
    }));
    let paper = textures::graph_paper(rgb(52, 62, 76), rgb(150, 164, 170));
    let paper = document.add_texture(png("dark-graph-paper.png", &paper, Channels::Rgb)?, Wrap::Repeat);
    let wall = document.add_material(json!({
        "name": "dark graph paper",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": paper }, "metallicFactor": 0.0, "roughnessFactor": 0.8
        }
    }));
    let wall_z = WINDOW.at(0.0, TABLE_Y, WALL_DEPTH).z;
    let (half_width, depth, height) = (0.8, 1.6, 0.55);
    let corner = DVec3::new(-half_width, TABLE_Y, wall_z);
    let table = Mesh::rectangle(corner, DVec3::X * 2.0 * half_width, DVec3::Z * depth)
        .with_texture_scale(DVec2::new(2.0 * half_width, depth) / 0.1);
    // The tangent is +x, along which u rises. With the normal +y and w = 1, the bitangent is -z,
    // which points upwards in the image, as glTF demands.
    let tangents = vec![[1.0f32, 0.0, 0.0, 1.0]; table.positions.len()];
    let mut primitive = document.primitive(&table, tiles);
    primitive["attributes"]["TANGENT"] = json!(document.add_floats(&tangents, true));
    let mesh = document.add_mesh("table", vec![primitive]);
    document.add_node(json!({ "name": "table", "mesh": mesh }));
    let top_left = corner + DVec3::Y * height;
    document.add_mesh_node(
        "wall",
        &Mesh::rectangle(top_left, DVec3::X * 2.0 * half_width, DVec3::NEG_Y * height)
            .with_texture_scale(DVec2::new(2.0 * half_width, height) / 0.04),
        wall,
    );
    Ok(())
}

/// Adds a framed mirror that leans back, and mirror balls.
fn add_mirrors(document: &mut Document) {
    let metal = |name: &str, color: [f64; 3], roughness: f64| {
        json!({
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": [color[0], color[1], color[2], 1.0],
                "metallicFactor": 1.0, "roughnessFactor": roughness
            }
        })
    };
    let silver = document.add_material(metal("silver", [0.95, 0.94, 0.92], 0.02));
    let copper = document.add_material(metal("copper", [0.93, 0.55, 0.40], 0.05));
    let frame = document.add_material(metal("dark frame", [0.32, 0.27, 0.22], 0.5));

    let (width, height, border, thickness) = (0.15, 0.13, 0.006, 0.006);
    let glass = Mesh::rectangle(
        DVec3::new(-0.5 * width + border, height - border, 0.0005),
        DVec3::X * (width - 2.0 * border),
        DVec3::NEG_Y * (height - 2.0 * border),
    );
    let body = Mesh::cuboid(DVec3::new(-0.5 * width, 0.0, -thickness), DVec3::new(0.5 * width, height, 0.0));
    let primitives = vec![document.primitive(&glass, silver), document.primitive(&body, frame)];
    let mesh = document.add_mesh("framed mirror", primitives);
    // a mirror that leans back would have the rear edge of its foot below the table, so lift the
    // mirror until this edge is on the table
    let lean_rad = 3f64.to_radians();
    let lift = thickness * lean_rad.sin();
    let mut node = node_at(
        "framed mirror",
        WINDOW.at(-0.118, TABLE_Y + lift, -0.115),
        DQuat::from_rotation_y(24f64.to_radians()) * DQuat::from_rotation_x(-lean_rad),
    );
    node["mesh"] = json!(mesh);
    document.add_node(node);

    let ball = Mesh::sphere(1.0, 64, 32);
    let silver_ball = document.add_simple_mesh("silver ball", &ball, silver);
    let copper_ball = document.add_simple_mesh("copper ball", &ball, copper);
    for (name, mesh, radius, column, depth) in [
        ("silver ball", silver_ball, 0.034, 0.005, -0.045),
        ("small silver ball", silver_ball, 0.013, -0.028, 0.072),
        ("copper ball", copper_ball, 0.020, -0.095, 0.02),
    ] {
        let mut node = node_at(name, WINDOW.at(column, TABLE_Y + radius, depth), DQuat::IDENTITY);
        node["mesh"] = json!(mesh);
        node["scale"] = uniform_scale(radius);
        document.add_node(node);
    }
}

/// Adds a glass ball (transmission), and panes (alpha mode BLEND) that overlap at three depths.
fn add_glass(document: &mut Document) -> Result<(), GeneratorError> {
    let clear = document.add_material(json!({
        "name": "clear glass",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.96, 0.99, 0.97, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.0
        },
        "extensions": {
            "KHR_materials_transmission": { "transmissionFactor": 1.0 },
            "KHR_materials_ior": { "ior": 1.5 }
        }
    }));
    let ball = document.add_simple_mesh("glass ball", &Mesh::sphere(1.0, 64, 32), clear);
    let radius = 0.027;
    let mut node = node_at("glass ball", WINDOW.at(0.083, TABLE_Y + radius, 0.055), DQuat::IDENTITY);
    node["mesh"] = json!(ball);
    node["scale"] = uniform_scale(radius);
    document.add_node(node);

    let stained =
        document.add_texture(png("stained-glass.png", &textures::stained_glass(), Channels::Rgba)?, Wrap::Clamp);
    let blended = |name: &str, color: [f64; 4], texture: Option<usize>| {
        let mut material = json!({
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": color, "metallicFactor": 0.0, "roughnessFactor": 0.08
            },
            "alphaMode": "BLEND",
            "doubleSided": true
        });
        if let Some(texture) = texture {
            material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": texture });
        }
        material
    };
    // the panes overlap at three depths
    let panes = [
        (blended("stained pane", [1.0; 4], Some(stained)), [0.070, 0.105], [0.170, -0.105], -18.0),
        (blended("amber pane", [0.90, 0.45, 0.02, 0.45], None), [0.050, 0.075], [0.132, -0.045], -8.0),
        (blended("blue pane", [0.02, 0.15, 0.80, 0.40], None), [0.050, 0.060], [0.168, 0.010], 6.0),
    ];
    for (material, [width, height], [column, depth], turn) in panes {
        let name = material["name"].as_str().unwrap_or_default().to_string();
        let material = document.add_material(material);
        let pane = Mesh::rectangle(DVec3::new(-0.5 * width, height, 0.0), DVec3::X * width, DVec3::NEG_Y * height);
        let mesh = document.add_simple_mesh(&name, &pane, material);
        let mut node = node_at(&name, WINDOW.at(column, TABLE_Y, depth), DQuat::from_rotation_y(f64::to_radians(turn)));
        node["mesh"] = json!(mesh);
        document.add_node(node);
    }
    Ok(())
}

/// Adds a ribbon of printed paper (double-sided, one triangle strip), and a screen of leaves (alpha
/// mode MASK).
fn add_paper_and_screen(document: &mut Document) -> Result<(), GeneratorError> {
    let print = document.add_texture(png("sheet-music.png", &textures::sheet_music(), Channels::Rgb)?, Wrap::Clamp);
    let paper = document.add_material(json!({
        "name": "printed paper",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": print }, "metallicFactor": 0.0, "roughnessFactor": 0.85
        },
        "doubleSided": true
    }));
    let ribbon = paper_ribbon(document, [0.16, 0.042, 0.012], paper);
    let mesh = document.add_mesh("paper ribbon", vec![ribbon]);
    let mut node =
        node_at("paper ribbon", WINDOW.at(0.035, TABLE_Y, -0.128), DQuat::from_rotation_y(-6f64.to_radians()));
    node["mesh"] = json!(mesh);
    document.add_node(node);

    let leaves = document.add_texture(png("leaf-screen.png", &textures::leaf_screen(), Channels::Rgba)?, Wrap::Repeat);
    let screen = document.add_material(json!({
        "name": "leaf screen",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": leaves }, "metallicFactor": 0.0, "roughnessFactor": 0.6
        },
        "alphaMode": "MASK",
        "alphaCutoff": 0.5,
        "doubleSided": true
    }));
    // the sheet is twice as wide as high, so the square texture repeats twice along its width
    let (width, height) = (0.096, 0.048);
    let sheet = Mesh::rectangle(DVec3::new(-0.5 * width, height, 0.0), DVec3::X * width, DVec3::NEG_Y * height)
        .with_texture_scale(DVec2::new(2.0, 1.0));
    let mesh = document.add_simple_mesh("leaf screen", &sheet, screen);
    let mut node =
        node_at("leaf screen", WINDOW.at(-0.160, TABLE_Y, 0.075), DQuat::from_rotation_y(12f64.to_radians()));
    node["mesh"] = json!(mesh);
    document.add_node(node);
    Ok(())
}

/// Adds the rippled plate (sparse accessors), and the gem (no indices, no normals).
fn add_plate_and_gem(document: &mut Document) {
    let steel = document.add_material(json!({
        "name": "pressed steel",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.70, 0.72, 0.74, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.18
        },
        "doubleSided": true
    }));
    let plate = rippled_plate(document, steel);
    let mesh = document.add_mesh("rippled plate", vec![plate]);
    let half_width = 0.032;
    let mut node =
        node_at("rippled plate", WINDOW.at(0.0, TABLE_Y + 0.001, 0.028), DQuat::from_rotation_y(30f64.to_radians()));
    node["mesh"] = json!(mesh);
    node["scale"] = uniform_scale(half_width);
    document.add_node(node);

    let ruby = document.add_material(json!({
        "name": "ruby",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.62, 0.01, 0.06, 1.0], "metallicFactor": 0.1, "roughnessFactor": 0.12
        }
    }));
    let gem = cut_gem(document, ruby);
    let mesh = document.add_mesh("cut gem", vec![gem]);
    let radius = 0.017;
    // The gem lies on one of its lower faces. So rotate the outward normal of this face downwards.
    let half_side = std::f64::consts::PI / 8.0;
    let face = DVec3::new(1.1 * half_side.sin(), -half_side.cos(), 1.1 * half_side.cos()).normalize();
    let rest = DQuat::from_rotation_y(2.4) * DQuat::from_rotation_arc(face, DVec3::NEG_Y);
    let mut node = node_at("cut gem", WINDOW.at(0.150, TABLE_Y, 0.085), rest);
    node["mesh"] = json!(mesh);
    node["scale"] = uniform_scale(radius);
    document.add_node(node);
}

/// Adds two rows of stretched beads. All beads share one mesh. The common parent node has a
/// rotation, and the beads' nodes have nonuniform scales.
fn add_beads(document: &mut Document) {
    let jade = document.add_material(json!({
        "name": "jade",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.10, 0.48, 0.33, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.25
        }
    }));
    let mesh = document.add_simple_mesh("bead", &Mesh::sphere(1.0, 32, 16), jade);
    let bead = |name: String, x: f64, z: f64, scale: [f64; 3], turn: f64| -> Value {
        let mut node = node_at(&name, DVec3::new(x, scale[1], z), DQuat::from_rotation_y(turn));
        node["mesh"] = json!(mesh);
        node["scale"] = json!(scale);
        node
    };
    // make three levels of nodes: the beads, the two rows, and the parent of the rows
    let mut rows = Vec::new();
    for row in 0..2 {
        let beads: Vec<usize> = (0..4)
            .map(|k| {
                let (x, grow) = (0.017 * (f64::from(k) - 1.5), 1.0 - 0.12 * f64::from(k));
                let scale = [0.0085 * grow, 0.006 * grow, 0.0045 * grow].map(rounded);
                let node = bead(format!("bead {row}.{k}"), x, 0.0, scale, 0.5 * f64::from(k));
                document.add_child_node(node)
            })
            .collect();
        let mut node = node_at(
            &format!("bead row {row}"),
            DVec3::new(0.0, 0.0, 0.018 * f64::from(row)),
            DQuat::from_rotation_y(0.25 * f64::from(row)),
        );
        node["children"] = json!(beads);
        rows.push(document.add_child_node(node));
    }
    let mut parent = node_at("beads", WINDOW.at(0.084, TABLE_Y, -0.085), DQuat::from_rotation_y(20f64.to_radians()));
    parent["scale"] = json!([1.0, 1.0, 1.25]);
    parent["children"] = json!(rows);
    document.add_node(parent);
}
