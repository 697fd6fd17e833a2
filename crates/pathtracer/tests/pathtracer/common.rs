//! Scenes in code and renders of them, for all tests of this folder.

use std::sync::Arc;

use glam::{Affine3A, DVec3, Quat, Vec2, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task, Tensor, Warning};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_scene::{Environment, Image, Instance, Material, Mesh, Pixels, SceneParts, Window};
use lumistack_testkit::statistics::Mean;

/// Width of the test window: in millimetres, and equally in scene units, so display space is scene
/// space.
pub const WINDOW_MM: f64 = 2.0;

/// Returns a material that scatters by Lambert's law without any gloss: an index of refraction of 1
/// reflects nothing.
pub fn diffuse(albedo: f32) -> Material {
    Material {
        base_color: Vec4::new(albedo, albedo, albedo, 1.0),
        metallic: 0.0,
        roughness: 1.0,
        ior: 1.0,
        double_sided: true,
        ..Material::default()
    }
}

/// Returns a black material that emits the same radiance from both sides.
pub fn glowing(radiance: Vec3) -> Material {
    Material { emission: radiance, ..diffuse(0.0) }
}

/// A scene under construction.
#[derive(Default)]
pub struct Builder {
    pub parts: SceneParts,
}

impl Builder {
    pub fn add(&mut self, mesh: Mesh, material: Material) -> &mut Self {
        self.parts.materials.push(material);
        self.parts.instances.push(Instance { mesh: self.parts.meshes.len(), scene_from_mesh: Affine3A::IDENTITY });
        self.parts.meshes.push(Mesh { material: self.parts.materials.len() - 1, ..mesh });
        self
    }

    /// Adds light from infinity: a map of one column, with `rows` from +y to −y.
    pub fn sky(&mut self, rows: &[f32]) -> &mut Self {
        let texels = rows.iter().map(|&row| [row; 3]).collect();
        self.parts.images.push(Image {
            name: "sky".into(),
            width: 1,
            height: rows.len(),
            pixels: Pixels::RgbF32(texels),
        });
        self.parts.environment = Some(Environment {
            image: self.parts.images.len() - 1,
            strength: Vec3::ONE,
            scene_from_environment: Quat::IDENTITY,
        });
        self
    }

    pub fn renderer(&self) -> Renderer {
        let (collector, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&collector, &cancel);
        Renderer::new(Arc::new(self.parts.clone().validate(task).unwrap()), task).unwrap()
    }
}

/// Returns a rectangle with the corners centre ± u ± v. Its front faces u × v. Seen from the front,
/// its texture is not mirrored.
pub fn rectangle(centre: Vec3, u: Vec3, v: Vec3) -> Mesh {
    Mesh {
        positions: vec![centre - u - v, centre + u - v, centre + u + v, centre - u + v],
        normals: vec![u.cross(v).normalize(); 4],
        uvs: [vec![Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(1.0, 0.0), Vec2::new(0.0, 0.0)], Vec::new()],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// Returns the six walls of a cube; fronts face outwards.
pub fn cube(centre: Vec3, half: f32) -> Vec<Mesh> {
    let axes = [Vec3::X, Vec3::Y, Vec3::Z];
    (0..6)
        .map(|i| {
            let (u, v) = (axes[(i + 1) % 3], axes[(i + 2) % 3]);
            let (u, v) = if i < 3 { (u, v) } else { (v, u) };
            rectangle(centre + half * u.cross(v), half * u, half * v)
        })
        .collect()
}

/// Returns a sphere with smooth normals. From pole to pole it has `divisions` rows of triangles.
pub fn sphere(centre: Vec3, radius: f32, divisions: usize) -> Mesh {
    let (rows, cols) = (divisions, 2 * divisions);
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        for col in 0..=cols {
            let theta = std::f32::consts::PI * row as f32 / rows as f32;
            let phi = std::f32::consts::TAU * (col % cols) as f32 / cols as f32;
            let normal = Vec3::new(theta.sin() * phi.sin(), theta.cos(), theta.sin() * phi.cos());
            mesh.positions.push(centre + radius * normal);
            mesh.normals.push(normal);
        }
    }
    let at = |row: usize, col: usize| (row * (cols + 1) + col) as u32;
    for row in 0..rows {
        for col in 0..cols {
            let quad = [at(row, col), at(row + 1, col), at(row + 1, col + 1), at(row, col + 1)];
            if row + 1 < rows {
                mesh.triangles.push([quad[0], quad[1], quad[2]]);
            }
            if row > 0 {
                mesh.triangles.push([quad[0], quad[2], quad[3]]);
            }
        }
    }
    mesh
}

/// Returns a window for which display space is scene space.
pub fn window() -> Window {
    Window::given(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, WINDOW_MM, [WINDOW_MM, WINDOW_MM]).unwrap()
}

/// Returns a window of the given width around a point, seen along −z.
pub fn window_at(centre: DVec3, width: f64) -> Window {
    Window::given(centre, DVec3::NEG_Z, DVec3::Y, width, [WINDOW_MM, WINDOW_MM]).unwrap()
}

/// Returns the geometry of `size` × `size` pixels over the window, for one view of the given slope.
pub fn one_view(size: usize, slope: [f64; 2]) -> FieldGeometry {
    FieldGeometry {
        rows: size,
        cols: size,
        pitch_mm: WINDOW_MM / size as f64,
        grid: ViewGrid::single(Projection::Oblique, slope),
    }
}

pub fn render(renderer: &Renderer, window: &Window, geometry: &FieldGeometry, settings: &Settings) -> Tensor<3> {
    render_view(renderer, window, geometry, [0, 0], settings).0
}

pub fn render_view(
    renderer: &Renderer,
    window: &Window,
    geometry: &FieldGeometry,
    view: [usize; 2],
    settings: &Settings,
) -> (Tensor<3>, Vec<Warning>) {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let radiance = renderer.render_view(window, geometry, view, settings, Task::quiet(&collector, &cancel)).unwrap();
    (radiance, collector.take())
}

/// Returns the mean and standard error over pixels, whose estimates are independent.
pub fn mean_of(radiance: &Tensor<3>, channel: usize) -> Mean {
    Mean::of(radiance.data().iter().skip(channel).step_by(3).map(|&v| f64::from(v)))
}

/// Returns settings with this many samples and almost no limit on the length of paths.
pub fn long_paths(samples: u32) -> Settings {
    Settings { samples, max_bounces: 1000, ..Settings::default() }
}
