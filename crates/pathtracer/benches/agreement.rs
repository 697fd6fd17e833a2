//! Renders the scenes of `cargo xtask bench agreement` in independent batches. Writes the pictures,
//! and the scenes for another renderer.
//!
//! ```text
//! cargo bench -p lumistack-pathtracer --bench agreement --
//!     FOLDER [--batches N] [--samples N] [--size N]
//! ```
//!
//! Every scene gets a folder with `scene.json`, `floor.f32`, `mesh_K.f32` and `ours.f32`, and, if
//! it has an environment map, `sky.f32`. The camera is orthographic, looks along −z, and sees the
//! square −1..1. A mesh has 15 numbers per triangle: xyz and texture uv of each corner. `ours.f32`
//! is `[batch][row][col][rgb]`. Surfaces are flat, so that the renderers' interpolation of normals
//! makes no difference. Microfacets scatter once, as in the other renderer.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use glam::{Affine2, Affine3A, DVec3, Mat3, Quat, Vec2, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_scene::{
    Environment, Filter, Image, Instance, Material, Mesh, Pixels, SceneParts, Texture, TextureUse, Window, Wrap,
};

/// Size of an environment map at which the error of bilinear interpolation is negligible.
const SKY: [usize; 2] = [1024, 512];
/// Largest number of scattering events of a path; the event at the first hit is included.
const MAX_BOUNCES: u32 = 6;
/// Number of texels per edge of the floor's texture. Each texel is several pixels wide, so that no
/// renderer filters the texture.
const TEXELS: usize = 6;

/// A surface, in terms that all renderers have.
#[derive(Clone, Copy)]
enum Surface {
    Diffuse(Vec3),
    /// Diffuse, with the picture of [`floor_texels`].
    Textured,
    /// A white metal of this GGX α.
    Conductor(f32),
    /// Clear glass of index 1.5 and this GGX α.
    Dielectric(f32),
    /// A black surface that emits this radiance from its front.
    Light(Vec3),
}

#[derive(Clone, Copy, PartialEq)]
enum Sky {
    Dark,
    Constant(f32),
    /// The function [`sky`].
    Map,
}

struct SceneSpec {
    name: &'static str,
    sky: Sky,
    parts: Vec<(Mesh, Surface)>,
}

fn main() -> ExitCode {
    match arguments().and_then(|arguments| run(&arguments).map_err(|error| error.to_string())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

struct Arguments {
    folder: PathBuf,
    batches: u32,
    samples: u32,
    size: usize,
}

fn arguments() -> Result<Arguments, String> {
    let mut parsed = Arguments { folder: PathBuf::new(), batches: 32, samples: 64, size: 40 };
    // cargo adds `--bench`
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = words.next() {
        let mut number = || words.next().and_then(|word| word.parse().ok()).ok_or(format!("{word} needs a number"));
        match word.as_str() {
            "--batches" => parsed.batches = number()?,
            "--samples" => parsed.samples = number()?,
            "--size" => parsed.size = number()? as usize,
            _ => parsed.folder = word.into(),
        }
    }
    if parsed.folder.as_os_str().is_empty() { Err("expected a folder, found none".into()) } else { Ok(parsed) }
}

fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    for spec in scenes() {
        let folder = arguments.folder.join(spec.name);
        std::fs::create_dir_all(&folder)?;
        describe(&spec, arguments, &folder)?;
        render(&spec, arguments, &folder)?;
        println!("{} rendered", spec.name);
    }
    Ok(())
}

/// Returns the light from infinity in a direction: a gradient and a soft sun.
fn sky(direction: Vec3) -> Vec3 {
    let sun = Vec3::new(0.5, 0.6, 0.62).normalize();
    let glow = (40.0 * (direction.dot(sun) - 1.0)).exp();
    Vec3::new(0.3, 0.35, 0.5) * (1.2 + direction.y) + Vec3::new(8.0, 7.0, 5.0) * glow
}

fn floor_texels() -> Vec<[f32; 3]> {
    let value = |k: usize, prime: usize| 0.1 + 0.8 * ((k * prime + 3) % 11) as f32 / 10.0;
    (0..TEXELS * TEXELS).map(|k| [value(k, 7), value(k, 5), value(k, 3)]).collect()
}

fn scenes() -> Vec<SceneSpec> {
    let white = Vec3::splat(0.8);
    // The camera is on +z. The floor is a panel that leans back by 40°.
    let lean = Mat3::from_rotation_x(-0.7);
    let floor = |surface| (panel(Vec3::new(0.0, 0.0, -0.6), lean * Vec3::X * 2.5, lean * Vec3::Y * 2.5), surface);
    // The lamp's front, u × v, faces down and away from the camera. A black panel right behind the
    // lamp hides the lamp's back, since renderers disagree on the light from a back.
    let (lamp_u, lamp_v) = (Vec3::X * 0.6, Vec3::new(0.0, -0.42, 0.42));
    let lamp_at = Vec3::new(0.3, 1.1, 1.2);
    let lamp = |radiance| (panel(lamp_at, lamp_u, lamp_v), Surface::Light(radiance));
    let shade = || {
        let behind = lamp_at - 0.01 * lamp_u.cross(lamp_v).normalize();
        (panel(behind, 1.02 * lamp_u, 1.02 * lamp_v), Surface::Diffuse(Vec3::ZERO))
    };
    let lamp_light = Vec3::new(6.0, 5.0, 4.0);
    let block = |surface| (block(Vec3::new(-0.2, -0.1, 0.2), 0.4, Mat3::from_rotation_y(0.5)), surface);
    let slab = |surface| {
        let mut mesh = self::block(Vec3::new(0.1, 0.05, 0.55), 1.0, Mat3::from_rotation_x(-0.5));
        let (scale, turn) = (Vec3::new(0.7, 0.6, 0.12), Mat3::from_rotation_x(-0.5));
        let centre = Vec3::new(0.1, 0.05, 0.55);
        mesh.positions.iter_mut().for_each(|p| *p = centre + turn * (scale * (turn.transpose() * (*p - centre))));
        (mesh, surface)
    };
    // each scene tests one kind of light or of surface
    let grey = Sky::Constant(0.4);
    vec![
        SceneSpec {
            name: "diffuse, area light",
            sky: Sky::Dark,
            parts: vec![
                floor(Surface::Diffuse(white)),
                block(Surface::Diffuse(Vec3::new(0.8, 0.3, 0.1))),
                lamp(lamp_light),
                shade(),
            ],
        },
        SceneSpec {
            name: "diffuse, constant sky",
            sky: grey,
            parts: vec![floor(Surface::Diffuse(white)), block(Surface::Diffuse(Vec3::new(0.8, 0.3, 0.1)))],
        },
        SceneSpec {
            name: "diffuse, environment map",
            sky: Sky::Map,
            parts: vec![floor(Surface::Diffuse(white)), block(Surface::Diffuse(Vec3::new(0.2, 0.5, 0.7)))],
        },
        SceneSpec {
            name: "texture, area light and sky",
            sky: grey,
            parts: vec![floor(Surface::Textured), block(Surface::Diffuse(white)), lamp(lamp_light), shade()],
        },
        SceneSpec {
            name: "rough conductor",
            sky: Sky::Map,
            parts: vec![floor(Surface::Conductor(0.1)), block(Surface::Diffuse(white)), lamp(lamp_light), shade()],
        },
        SceneSpec {
            name: "mirror",
            sky: Sky::Map,
            parts: vec![floor(Surface::Conductor(0.0)), block(Surface::Diffuse(white)), lamp(lamp_light), shade()],
        },
        SceneSpec {
            name: "rough dielectric",
            sky: Sky::Map,
            parts: vec![floor(Surface::Textured), slab(Surface::Dielectric(0.1)), lamp(lamp_light), shade()],
        },
        SceneSpec {
            name: "clear dielectric",
            sky: grey,
            parts: vec![floor(Surface::Textured), slab(Surface::Dielectric(0.0))],
        },
    ]
}

/// Returns a rectangle with the corners centre ± u ± v, whose front faces u × v.
fn panel(centre: Vec3, u: Vec3, v: Vec3) -> Mesh {
    Mesh {
        positions: vec![centre - u - v, centre + u - v, centre + u + v, centre - u + v],
        normals: vec![u.cross(v).normalize(); 4],
        uvs: [vec![Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(1.0, 0.0), Vec2::new(0.0, 0.0)], Vec::new()],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// Returns a closed cube whose fronts face outwards.
fn block(centre: Vec3, half: f32, turn: Mat3) -> Mesh {
    let axes = [turn.x_axis, turn.y_axis, turn.z_axis];
    let mut all = Mesh::default();
    for i in 0..6 {
        let (u, v) = (axes[(i + 1) % 3], axes[(i + 2) % 3]);
        let (u, v) = if i < 3 { (u, v) } else { (v, u) };
        let side = panel(centre + half * u.cross(v), half * u, half * v);
        let first = all.positions.len() as u32;
        all.positions.extend(side.positions);
        all.normals.clear();
        all.uvs[0].extend(&side.uvs[0]);
        all.triangles.extend(side.triangles.iter().map(|t| t.map(|index| index + first)));
    }
    all
}

fn material(surface: Surface) -> Material {
    let diffuse = |color: Vec3| Material {
        base_color: color.extend(1.0),
        metallic: 0.0,
        ior: 1.0,
        double_sided: true,
        ..Material::default()
    };
    match surface {
        Surface::Diffuse(color) => diffuse(color),
        Surface::Textured => Material {
            base_color_texture: Some(TextureUse { texture: 0, uv_set: 0, texture_from_mesh: Affine2::IDENTITY }),
            ..diffuse(Vec3::ONE)
        },
        Surface::Conductor(alpha) => {
            Material { metallic: 1.0, roughness: alpha.sqrt(), ior: 1.5, ..diffuse(Vec3::ONE) }
        }
        Surface::Dielectric(alpha) => Material {
            roughness: alpha.sqrt(),
            ior: 1.5,
            transmission: 1.0,
            solid: true,
            base_color: Vec4::ONE,
            ..diffuse(Vec3::ONE)
        },
        Surface::Light(radiance) => Material { emission: radiance, double_sided: false, ..diffuse(Vec3::ZERO) },
    }
}

fn render(spec: &SceneSpec, arguments: &Arguments, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    // build the scene: a mesh and a material per part, the floor's texture, and the sky
    let mut parts = SceneParts { name: spec.name.into(), ..SceneParts::default() };
    for (index, (mesh, surface)) in spec.parts.iter().enumerate() {
        parts.materials.push(material(*surface));
        parts.meshes.push(Mesh { material: index, ..mesh.clone() });
        parts.instances.push(Instance { mesh: index, scene_from_mesh: Affine3A::IDENTITY });
    }
    let pixels = Pixels::RgbF32(floor_texels());
    parts.images.push(Image { name: "floor".into(), width: TEXELS, height: TEXELS, pixels });
    let [wrap_u, wrap_v] = [Wrap::Repeat; 2];
    parts.textures.push(Texture { image: 0, wrap_u, wrap_v, filter: Filter::Linear });
    let map = match spec.sky {
        Sky::Dark => None,
        Sky::Constant(value) => Some((1, 1, vec![[value; 3]])),
        Sky::Map => {
            let [width, height] = SKY;
            let texel = |k: usize| {
                let (u, v) = (
                    (k % width) as f32 / width as f32 + 0.5 / width as f32,
                    ((k / width) as f32 + 0.5) / height as f32,
                );
                let (phi, theta) = (std::f32::consts::TAU * (u - 0.5), std::f32::consts::PI * v);
                sky(Vec3::new(theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos())).to_array()
            };
            Some((width, height, (0..width * height).map(texel).collect()))
        }
    };
    if let Some((width, height, texels)) = map {
        parts.images.push(Image { name: "sky".into(), width, height, pixels: Pixels::RgbF32(texels) });
        let scene_from_environment = Quat::IDENTITY;
        parts.environment = Some(Environment { image: 1, strength: Vec3::ONE, scene_from_environment });
    }
    // render independent batches, from whose differences the comparison estimates the noise
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let renderer = Renderer::new(Arc::new(parts.validate(task)?), task)?.single_scattering();
    let window = Window::given(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, 2.0, [2.0, 2.0])?;
    let grid = ViewGrid::single(Projection::Oblique, [0.0, 0.0]);
    let geometry =
        FieldGeometry { rows: arguments.size, cols: arguments.size, pitch_mm: 2.0 / arguments.size as f64, grid };
    let mut bytes = Vec::new();
    for batch in 0..arguments.batches {
        let settings = Settings {
            samples: arguments.samples,
            max_bounces: MAX_BOUNCES,
            seed: u64::from(batch) + 1,
            ..Settings::default()
        };
        let view = renderer.render_view(&window, &geometry, [0, 0], &settings, task)?;
        bytes.extend(view.data().iter().flat_map(|value| value.to_le_bytes()));
    }
    Ok(std::fs::write(folder.join("ours.f32"), bytes)?)
}

/// Writes the scene for the other renderer.
fn describe(spec: &SceneSpec, arguments: &Arguments, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let Arguments { batches, samples, size, .. } = arguments;
    // write the surfaces, and one file with the triangles of each part
    let mut text = format!(
        "{{\"size\": {size}, \"batches\": {batches}, \"samples\": {samples}, \"max_bounces\": {MAX_BOUNCES}, \"parts\": ["
    );
    for (index, (mesh, surface)) in spec.parts.iter().enumerate() {
        let numbers = |v: Vec3| format!("[{}, {}, {}]", v.x, v.y, v.z);
        let (kind, value) = match surface {
            Surface::Diffuse(color) => ("diffuse", numbers(*color)),
            Surface::Textured => ("textured", "null".into()),
            Surface::Conductor(alpha) => ("conductor", alpha.to_string()),
            Surface::Dielectric(alpha) => ("dielectric", alpha.to_string()),
            Surface::Light(radiance) => ("light", numbers(*radiance)),
        };
        let comma = if index == 0 { "" } else { ", " };
        write!(text, "{comma}{{\"kind\": \"{kind}\", \"value\": {value}}}")?;
        let corner = |&k: &u32| {
            let (p, uv) = (mesh.positions[k as usize], mesh.uvs[0][k as usize]);
            [p.x, p.y, p.z, uv.x, uv.y]
        };
        let numbers = mesh.triangles.iter().flatten().flat_map(corner);
        let bytes: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
        std::fs::write(folder.join(format!("mesh_{index}.f32")), bytes)?;
    }
    // write the light from infinity, and the texels of the floor
    match spec.sky {
        Sky::Dark => text += "], \"sky\": null}",
        Sky::Constant(value) => write!(text, "], \"sky\": {value}}}")?,
        Sky::Map => {
            text += "], \"sky\": \"sky.f32\"}";
            // Rows go from +y to −y, with both ends included. Columns have equal angles, from −z
            // towards +x. `xtask/bench/agreement.py`, which reads them, has the same order.
            let [width, height] = SKY;
            let texel = |k: usize| {
                let phi = std::f32::consts::TAU * ((k % width) as f32 + 0.5) / width as f32;
                let theta = std::f32::consts::PI * (k / width) as f32 / (height - 1) as f32;
                sky(Vec3::new(theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos())).to_array()
            };
            let bytes: Vec<u8> = (0..width * height).flat_map(texel).flat_map(f32::to_le_bytes).collect();
            std::fs::write(folder.join("sky.f32"), bytes)?;
        }
    }
    let texels: Vec<u8> = floor_texels().into_iter().flatten().flat_map(f32::to_le_bytes).collect();
    std::fs::write(folder.join("floor.f32"), texels)?;
    Ok(std::fs::write(folder.join("scene.json"), text)?)
}
