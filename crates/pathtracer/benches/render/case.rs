//! The scene that all renderers get: Lambert surfaces with base-colour textures, one rectangle
//! light, a constant sky, one perspective view.
//!
//! Unless a case keeps the materials of its file, they become diffuse, opaque and two-sided, with
//! face normals. So every renderer can express the scene exactly. The light faces the scene, and
//! its back is out of view.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use glam::{Affine3A, DVec3, Quat, Vec2, Vec3, Vec4};
use lumistack_core::{Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_gltf::AssetResolver;
use lumistack_scene::{Environment, Image, Instance, Material, Mesh, Pixels, Scene, SceneParts, Window};
use lumistack_usd::LoadOptions;
use npyz::WriterBuilder;
use serde_json::json;

pub type Outcome<T = ()> = Result<T, Box<dyn Error>>;

/// Width of the window in display space, in millimetres; only its ratio to the distance matters.
const WIDTH_MM: f64 = 400.0;
/// Distance of the eye divided by the height of the window; the vertical angle of view is 23°.
const DISTANCE_PER_HEIGHT: f64 = 2.5;
/// Radiance of the sky.
const SKY: f32 = 0.4;
/// Radiance of the light.
const LIGHT: f32 = 40.0;
/// Name of the light's material.
const LIGHT_NAME: &str = "rectangle light";

/// A scene with a rectangle light, its window, and the geometry of its view.
pub struct Case {
    pub name: String,
    pub scene: Arc<Scene>,
    pub window: Window,
    pub geometry: FieldGeometry,
    /// A corner of the rectangle light, and the two edges from this corner.
    light: [Vec3; 3],
}

struct Folder<'a>(&'a Path);

impl AssetResolver for Folder<'_> {
    fn read(&self, uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
        std::fs::read(self.0.join(uri)).map_err(|error| error.to_string())
    }
}

impl Case {
    /// Loads a glTF or USD file. Keeps its materials if `own_materials` is true, and makes them
    /// diffuse otherwise. With `copies` > 1, the copies of the scene are arranged in a square, and
    /// have no cameras. A scene without a camera also gets a floor.
    pub fn load(
        path: &Path,
        copies: usize,
        [cols, rows]: [usize; 2],
        own_materials: bool,
        task: Task<'_>,
    ) -> Outcome<Self> {
        // Warnings are discarded: they are about content that a diffuse scene leaves out.
        let unread = Collector::default();
        let quiet = Task { warnings: &unread, ..task };
        let extension = path.extension().unwrap_or_default().to_string_lossy();
        let scene = if lumistack_usd::EXTENSIONS.contains(&&*extension) {
            lumistack_usd::load(path, &LoadOptions::default(), quiet)?.scene
        } else {
            let bytes = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
            let folder = Folder(path.parent().unwrap_or(Path::new(".")));
            lumistack_gltf::load(&path.display().to_string(), &bytes, &folder, quiet)?
        };
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let bounds = scene.bounds();
        let mut parts = scene.into_parts();
        if copies > 1 {
            repeat(&mut parts, copies, bounds);
        }
        Self::new(
            if copies > 1 { format!("{copies} × {name}") } else { name },
            parts,
            [cols, rows],
            own_materials,
            task,
        )
    }

    /// Prepares a scene. Keeps its materials if `own_materials` is true, and makes them diffuse
    /// otherwise.
    pub fn new(
        name: String,
        parts: SceneParts,
        [cols, rows]: [usize; 2],
        own_materials: bool,
        task: Task<'_>,
    ) -> Outcome<Self> {
        // choose the height of the window from the bounds of the scene
        let unread = Collector::default();
        let bounds = parts.clone().validate(Task { warnings: &unread, ..task })?.bounds();
        let mut parts = if own_materials { unlit(parts) } else { diffuse(unlit(parts)) };
        let size = bounds.max - bounds.min;
        let centre = bounds.centre();
        let height = f64::from(size.y).max(f64::from(size.length()) * 0.5) * 1.15;

        // place the eye and the window
        let pitch_mm = WIDTH_MM / cols as f64;
        let distance_mm = DISTANCE_PER_HEIGHT * pitch_mm * rows as f64;
        let grid = ViewGrid::single(Projection::Perspective { distance_mm }, [0.0, 0.0]);
        let geometry = FieldGeometry { rows, cols, pitch_mm, grid };
        let size_mm = geometry.size_mm();
        let window = match parts.cameras.first() {
            Some(camera) => Window::from_camera(camera, bounds, size_mm)?,
            None => {
                let forward = -DVec3::new(0.35, 0.25, 1.0);
                Window::given(centre.as_dvec3(), forward, DVec3::Y, height * size_mm[0] / size_mm[1], size_mm)?
            }
        };
        // add a floor, so that a scene without a camera has a surface that receives shadows
        if parts.cameras.is_empty() {
            let at = Vec3::new(centre.x, bounds.min.y, centre.z);
            let half = 4.0 * size.length();
            add(&mut parts, rectangle(at, half * Vec3::X, half * Vec3::NEG_Z), diffuse_material(Vec4::splat(0.5)));
        }
        // the light is above and to the right of the viewer, and faces the scene
        let toward = Vec3::new(0.6, 1.0, 0.7).normalize();
        let (u, v) = toward.any_orthonormal_pair();
        let half = 0.3 * size.length();
        let at = centre + 2.5 * size.length() * toward;
        let (u, v) = (half * u, half * v);
        let (u, v) = if u.cross(v).dot(toward) > 0.0 { (v, u) } else { (u, v) };
        let emitting =
            Material { name: LIGHT_NAME.into(), emission: Vec3::splat(LIGHT), ..diffuse_material(Vec4::ZERO) };
        add(&mut parts, rectangle(at, u, v), emitting);

        // a constant sky lights what the light does not reach
        parts.images.push(Image { name: "sky".into(), width: 1, height: 1, pixels: Pixels::RgbF32(vec![[SKY; 3]]) });
        parts.environment = Some(Environment {
            image: parts.images.len() - 1,
            strength: Vec3::ONE,
            scene_from_environment: Quat::IDENTITY,
        });
        Ok(Self {
            name,
            scene: Arc::new(parts.validate(task)?),
            window,
            geometry,
            light: [at - u - v, 2.0 * u, 2.0 * v],
        })
    }

    /// Returns the number of pixels.
    pub fn pixels(&self) -> f64 {
        (self.geometry.rows * self.geometry.cols) as f64
    }

    /// Returns the length of the diagonal of the scene's bounds.
    pub fn size(&self) -> f32 {
        let bounds = self.scene.bounds();
        (bounds.max - bounds.min).length()
    }

    /// Returns a point of the rectangle light, for `u` in [0, 1)².
    pub fn point_of_light(&self, u: [f32; 2]) -> Vec3 {
        let [corner, across, up] = self.light;
        corner + u[0] * across + u[1] * up
    }

    /// Writes the scene for the peers: `scene.json` names the arrays and pictures next to it.
    /// Meshes are in world space. With `exact`, peers render exactly this scene. Otherwise a peer
    /// may replace a light by a kind that it samples better. The peers render the views of
    /// `geometry`, which are perspective.
    pub fn export(&self, geometry: &FieldGeometry, folder: &Path, exact: bool) -> Outcome {
        std::fs::create_dir_all(folder)?;
        // write the arrays of every mesh except the light, which peers make themselves
        let mut meshes = Vec::new();
        for (index, instance) in self.scene.instances.iter().enumerate() {
            let mesh = &self.scene.meshes[instance.mesh];
            let material = &self.scene.materials[mesh.material];
            if material.name == LIGHT_NAME {
                continue;
            }
            let to_world = instance.scene_from_mesh;
            let positions = mesh.positions.iter().flat_map(|&p| to_world.transform_point3(p).to_array());
            write_npy(&folder.join(format!("{index}_positions.npy")), [mesh.positions.len(), 3], positions)?;
            let triangles = mesh.triangles.iter().flatten().map(|&i| i as i32);
            write_npy(&folder.join(format!("{index}_triangles.npy")), [mesh.triangles.len(), 3], triangles)?;
            let texture = material.base_color_texture.as_ref();
            let uvs = texture.map(|texture| (&mesh.uvs[texture.uv_set], texture.texture_from_mesh));
            let uvs: Vec<Vec2> = match uvs {
                Some((uvs, map)) if !uvs.is_empty() => uvs.iter().map(|&uv| map.transform_point2(uv)).collect(),
                _ => vec![Vec2::ZERO; mesh.positions.len()],
            };
            write_npy(
                &folder.join(format!("{index}_uvs.npy")),
                [uvs.len(), 2],
                uvs.iter().flat_map(|uv| uv.to_array()),
            )?;
            meshes.push(json!({
                "files": index,
                "color": material.base_color.truncate().to_array(),
                "image": texture.map(|texture| self.scene.textures[texture.texture].image),
            }));
        }
        // write the textures as pictures, without alpha
        for (index, image) in self.scene.images.iter().enumerate() {
            if let Pixels::Rgba8(texels) = &image.pixels {
                let rgb = texels.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
                let picture = image::RgbImage::from_raw(image.width as u32, image.height as u32, rgb);
                picture.ok_or("expected 3 bytes per pixel")?.save(folder.join(format!("image_{index}.png")))?;
            }
        }
        // describe the camera of every view, and the scene
        let map = &self.window.scene_from_display;
        let Projection::Perspective { distance_mm } = geometry.grid.projection else {
            return Err("expected perspective views, found oblique views".into());
        };
        let axis = |v: DVec3| (map.rotation * v).to_array();
        let camera = |[y, x]: [usize; 2]| {
            // All eyes look straight ahead. The lens is shifted, so that the picture is the window.
            let [eye_x, eye_y] = [geometry.grid.slope_x[x] * distance_mm, geometry.grid.slope_y[y] * distance_mm];
            json!({
                "eye": map.point(DVec3::new(eye_x, eye_y, distance_mm)).to_array(),
                "right": axis(DVec3::X),
                "up": axis(DVec3::Y),
                "backward": axis(DVec3::Z),
                "fov_x_rad": 2.0 * (0.5 * WIDTH_MM / distance_mm).atan(),
                "shift": [-eye_x / WIDTH_MM, -eye_y / WIDTH_MM],
            })
        };
        let about = json!({
            "meshes": meshes,
            "sky": SKY,
            "light": {
                "corner": self.light[0].to_array(),
                "edges": [self.light[1].to_array(), self.light[2].to_array()],
                "radiance": LIGHT,
            },
            "cameras": geometry.grid.iter().map(camera).collect::<Vec<_>>(),
            "pixels": [self.geometry.cols, self.geometry.rows],
            "exact": exact,
        });
        std::fs::write(folder.join("scene.json"), about.to_string())?;
        Ok(())
    }
}

/// Arranges copies of the scene side by side, and mirrors every second copy.
fn repeat(parts: &mut SceneParts, copies: usize, bounds: lumistack_scene::Bounds) {
    parts.cameras.clear();
    let across = (copies as f64).sqrt().ceil() as usize;
    let step = (bounds.max - bounds.min) * 1.2;
    let one = std::mem::take(&mut parts.instances);
    for copy in 0..copies {
        let (row, col) = (copy / across, copy % across);
        let at = Vec3::new(col as f32 * step.x, 0.0, row as f32 * step.z);
        let mirror = Vec3::new(if copy % 2 == 0 { 1.0 } else { -1.0 }, 1.0, 1.0);
        let place = Affine3A::from_translation(at) * Affine3A::from_scale(mirror);
        parts.instances.extend(one.iter().map(|i| Instance { scene_from_mesh: place * i.scene_from_mesh, ..*i }));
    }
}

/// Returns the parts of a scene, without its lights and environment.
fn unlit(mut parts: SceneParts) -> SceneParts {
    parts.lights.clear();
    parts.environment = None;
    parts
}

/// Returns the scene with every material made diffuse, with face normals.
fn diffuse(mut parts: SceneParts) -> SceneParts {
    for material in &mut parts.materials {
        let texture = material.base_color_texture;
        // the peers' format has a colour or a texture for each material, and no alpha
        let color = if texture.is_some() { Vec4::ONE } else { material.base_color.truncate().extend(1.0) };
        *material = Material { base_color_texture: texture, ..diffuse_material(color) };
    }
    for mesh in &mut parts.meshes {
        let corners: Vec<usize> = mesh.triangles.iter().flatten().map(|&i| i as usize).collect();
        mesh.positions = corners.iter().map(|&i| mesh.positions[i]).collect();
        for uvs in &mut mesh.uvs {
            *uvs = if uvs.is_empty() { Vec::new() } else { corners.iter().map(|&i| uvs[i]).collect() };
        }
        mesh.triangles = (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        (mesh.normals, mesh.tangents, mesh.colors) = (Vec::new(), Vec::new(), Vec::new());
    }
    parts
}

fn diffuse_material(color: Vec4) -> Material {
    // an index of refraction of 1 reflects nothing
    Material { base_color: color, metallic: 0.0, roughness: 1.0, ior: 1.0, double_sided: true, ..Material::default() }
}

fn add(parts: &mut SceneParts, mesh: Mesh, material: Material) {
    parts.materials.push(material);
    parts.instances.push(Instance { mesh: parts.meshes.len(), scene_from_mesh: Affine3A::IDENTITY });
    parts.meshes.push(Mesh { material: parts.materials.len() - 1, ..mesh });
}

fn rectangle(centre: Vec3, u: Vec3, v: Vec3) -> Mesh {
    Mesh {
        positions: vec![centre - u - v, centre + u - v, centre + u + v, centre - u + v],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

fn write_npy<T: npyz::AutoSerialize>(path: &Path, shape: [usize; 2], values: impl Iterator<Item = T>) -> Outcome {
    let file = std::io::BufWriter::new(std::fs::File::create(path)?);
    let shape = shape.map(|n| n as u64);
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd()?;
    writer.extend(values)?;
    Ok(writer.finish()?)
}
