//! Converts the lights of a scene package (UsdLux).
//!
//! A light with a surface has the radiance L = intensity · 2^exposure · colour · colour
//! temperature. If the light is normalized, L is divided by the light's area in the scene. The
//! light becomes a black emitting mesh. Camera rays pass through this mesh, unless the user
//! requests visible lights.
//!
//! * A distant light of angle 2θ has radiance L in a cone, so its irradiance is L π sin²θ. If it is
//!   normalized, or its angle is 0, its irradiance is L.
//! * A sphere that is treated as a point, or that has a cone, has the intensity L π r².
//! * A disc or rectangle with a cone is a spot light of intensity L · area.
//! * A dome is the environment. In USD's picture the centre shows +z, and the right half shows −x,
//!   as in OpenEXR. In the scene's picture the centre shows −z.
//!
//! Source: UsdLux schemas of OpenUSD 25.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Affine3A, DAffine3, DMat3, DMat4, DQuat, DVec3, Quat, Vec2, Vec3, Vec4};
use lumistack_core::Task;
use lumistack_scene::{Environment, Image, Lamp, Light, LightKind, Material, Pixels};
use serde::Deserialize;

use crate::curves::ball;
use crate::geometry::Geometry;
use crate::texture::{Channel, Kind, Source, Textures};

/// Number of sides of the polygon that represents a round light.
const SIDES: usize = 48;
/// Number of segments of each edge of the octahedron that represents a sphere: 288 triangles.
const SPHERE_PARTS: u32 = 6;

/// A light of a scene package, in the form in which the walker (Python) writes it.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
struct Entry {
    place: String,
    kind: String,
    radiance: [f32; 3],
    normalize: bool,
    /// Full angle of a distant light's disc in the sky, degrees.
    angle: f32,
    radius: f32,
    width: f32,
    height: f32,
    length: f32,
    #[serde(rename = "treatAsPoint")]
    as_point: bool,
    shaping: Option<Shaping>,
    image: Option<usize>,
    format: String,
    pole_z: bool,
    /// Matrix from the light's space to the stage, for row vectors as in USD.
    matrix: Option<[f64; 16]>,
}

/// Cone of a light (`UsdLuxShapingAPI`).
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
struct Shaping {
    /// Half angle of the cone, in degrees.
    #[serde(rename = "cone:angle")]
    angle: f32,
    /// Fraction of the cone's angle over which the light decreases to 0.
    #[serde(rename = "cone:softness")]
    softness: f32,
    focus: f32,
}

/// A light that is shown as a mesh with emission.
#[derive(Clone, Debug)]
pub(crate) struct LightMesh {
    pub(crate) place: String,
    pub(crate) geometry: Geometry,
    pub(crate) material: Material,
    pub(crate) scene_from_mesh: Affine3A,
}

/// The converted lights of a scene.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lights {
    pub(crate) surfaces: Vec<LightMesh>,
    pub(crate) points: Vec<Light>,
    pub(crate) environment: Option<Environment>,
}

impl Lights {
    /// Adds the light of an entry. Warns if the light is left out, unless it is black.
    pub(crate) fn add(
        &mut self,
        entry: &serde_json::Value,
        scene_from_stage: &DAffine3,
        textures: &mut Textures<'_>,
        task: Task<'_>,
    ) {
        // Read and check the entry, since packages are not trusted.
        let entry: Entry = match serde_json::from_value(entry.clone()) {
            Ok(entry) => entry,
            Err(error) => {
                let place = entry.get("place").and_then(|place| place.as_str()).unwrap_or("/lights");
                return task.warn(
                    place,
                    format!(
                        "expected a light in the form that lumistack's USD script writes, found data that cannot be read ({error}); the light is left out"
                    ),
                );
            }
        };
        let matrix =
            entry.matrix.map_or(DAffine3::IDENTITY, |matrix| DAffine3::from_mat4(DMat4::from_cols_array(&matrix)));
        let scene_from_light = *scene_from_stage * matrix;
        let sizes = [entry.angle, entry.radius, entry.width, entry.height, entry.length];
        let finite = sizes.iter().chain(&entry.radiance).all(|value| value.is_finite() && *value >= 0.0);
        if !(finite && scene_from_light.is_finite()) {
            return task.warn(
                &entry.place,
                "the light has a size, brightness or placement that is negative or not finite; the light is left out",
            );
        }
        // A black light needs no warning.
        if Vec3::from(entry.radiance) == Vec3::ZERO {
            return;
        }
        match entry.kind.as_str() {
            "distant" => self.distant(&entry, &scene_from_light),
            "dome" => self.dome(&entry, &scene_from_light, textures, task),
            _ => self.surface(&entry, &scene_from_light, textures, task),
        }
    }

    fn distant(&mut self, entry: &Entry, scene_from_light: &DAffine3) {
        let half_angle = (0.5 * entry.angle).to_radians().min(FRAC_PI_2);
        let projected = if entry.normalize || half_angle == 0.0 { 1.0 } else { PI * half_angle.sin().powi(2) };
        let direction = scene_from_light.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Y);
        self.points.push(Light {
            position: Vec3::ZERO,
            direction: direction.as_vec3(),
            intensity: projected * Vec3::from(entry.radiance),
            kind: if half_angle > 0.0 {
                LightKind::Distant { half_angle_rad: half_angle }
            } else {
                LightKind::Directional
            },
        });
    }

    fn dome(&mut self, entry: &Entry, scene_from_light: &DAffine3, textures: &mut Textures<'_>, task: Task<'_>) {
        if self.environment.is_some() {
            return task.warn(&entry.place, "a second dome light is not supported and is left out");
        }
        if !matches!(entry.format.as_str(), "" | "automatic" | "latlong") {
            task.warn(
                &entry.place,
                format!(
                    "the layout {} of the dome light's picture is not supported; the layout latlong is used",
                    entry.format
                ),
            );
        }
        let image = entry.image.and_then(|image| textures.radiance(image));
        let image = image.unwrap_or_else(|| {
            let pixels = Pixels::RgbF32(vec![[1.0; 3]]);
            textures.images.push(Image { name: entry.place.clone(), width: 1, height: 1, pixels });
            textures.images.len() - 1
        });
        let pole = if entry.pole_z { DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2) } else { DQuat::IDENTITY };
        let turn = rotation(scene_from_light) * pole * DQuat::from_rotation_y(std::f64::consts::PI);
        self.environment = Some(Environment {
            image,
            strength: entry.radiance.into(),
            scene_from_environment: Quat::from_array(turn.to_array().map(|part| part as f32)).normalize(),
        });
    }

    /// Adds a light that has a surface. A light with a cone becomes a spot light, except a
    /// cylinder, which is left out. A sphere without a cone that is treated as a point, or has the
    /// radius 0, becomes a point light. Any other light becomes a mesh.
    fn surface(&mut self, entry: &Entry, scene_from_light: &DAffine3, textures: &mut Textures<'_>, task: Task<'_>) {
        // Build the mesh, and compensate for its area, which is a little smaller than the area of
        // the exact shape.
        let (geometry, true_area) = match entry.kind.as_str() {
            "sphere" => (sphere(entry.radius), 4.0 * PI * entry.radius.powi(2)),
            "disk" => (disc(entry.radius), PI * entry.radius.powi(2)),
            "rect" => (rectangle(entry.width, entry.height), entry.width * entry.height),
            "cylinder" => (tube(entry.radius, entry.length), 2.0 * PI * entry.radius * entry.length),
            other => return task.warn(&entry.place, format!("the light {other} is not supported and is left out")),
        };
        let is_sphere = entry.kind == "sphere";
        let [flat_area, scene_area] = [DAffine3::IDENTITY, *scene_from_light]
            .map(|matrix| area(&geometry.positions, &geometry.triangles, &matrix));
        let missing = if flat_area > 0.0 { f64::from(true_area) / flat_area } else { 1.0 };
        let scene_area = (scene_area * missing) as f32;
        let given = Vec3::from(entry.radiance);
        if entry.shaping.is_some_and(|shaping| shaping.focus > 0.0) {
            task.warn(&entry.place, "the light's shaping:focus is not supported and has no effect");
        }
        // A light with a cone becomes a spot. A sphere without a cone becomes a point light if it
        // has the radius 0 or treatAsPoint.
        let cone = entry.shaping.filter(|shaping| shaping.angle < 90.0);
        let small = is_sphere && (entry.as_point || entry.radius == 0.0);
        if cone.is_some() || small {
            if entry.kind == "cylinder" {
                return task.warn(&entry.place, "a cylinder with a cone is not supported and is left out");
            }
            // a sphere's disc, as seen from any side, has a quarter of the sphere's surface area
            let seen = if is_sphere { 0.25 } else { 1.0 };
            let intensity = if entry.normalize { seen * given } else { seen * scene_area * given };
            if entry.image.is_some() {
                task.warn(&entry.place, "a light with a cone is shown with its colour only, without its picture");
            }
            if intensity == Vec3::ZERO {
                return task.warn(&entry.place, "the light has no size and hence no effect");
            }
            let direction = scene_from_light.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Y);
            self.points.push(Light {
                position: scene_from_light.translation.as_vec3(),
                direction: direction.as_vec3(),
                intensity,
                kind: cone.map_or(LightKind::Point, |cone| {
                    let outer = cone.angle.max(0.1);
                    let inner = outer * (1.0 - cone.softness.clamp(0.0, 1.0));
                    LightKind::Spot { inner_cone_rad: inner.to_radians(), outer_cone_rad: outer.to_radians() }
                }),
            });
            return;
        }
        if scene_area.is_nan() || scene_area <= 0.0 {
            return task.warn(&entry.place, "the light has no size and hence no effect");
        }
        // All other lights become meshes with an emitting material.
        let radiance = given * missing as f32 / if entry.normalize { scene_area } else { 1.0 };
        let mut material = Material {
            name: entry.place.clone(),
            base_color: Vec4::W,
            metallic: 0.0,
            roughness: 1.0,
            specular: 0.0,
            emission: radiance,
            lamp: Lamp::Unseen,
            ..Material::default()
        };
        if let Some(image) = entry.image {
            let source = Source::plain(image);
            let channels = [0, 1, 2].map(|k| Channel::Component(&source, k));
            let slot = [channels[0], channels[1], channels[2], Channel::Unused];
            material.emission_texture = textures.slot(slot, Kind::Light, 0, &entry.place);
        }
        let (place, scene_from_mesh) = (entry.place.clone(), scene_from_light.as_affine3a());
        self.surfaces.push(LightMesh { place, geometry, material, scene_from_mesh });
    }
}

/// Returns a copy of a material with the emission of a mesh that is a light (`MeshLightAPI`). With
/// "materialGlowTintsLight" the material's own emission, if any, tints the light. With
/// "noMaterialResponse" the material reflects nothing. `area` is the area of the whole mesh in the
/// scene, which has an effect only if the light [`is_normalized`]. `None` if the entry cannot be
/// read, or if the radiance is 0 or not finite.
pub(crate) fn emissive(entry: &serde_json::Value, material: &Material, area: f32) -> Option<Material> {
    let entry: MeshEntry = serde_json::from_value(entry.clone()).ok()?;
    let mut radiance = Vec3::from(entry.radiance);
    if entry.normalize && area > 0.0 {
        radiance /= area;
    }
    if !(radiance.is_finite() && radiance.max_element() > 0.0) {
        return None;
    }
    let mut emissive = material.clone();
    match entry.sync.as_str() {
        "materialGlowTintsLight" if material.emission != Vec3::ZERO => emissive.emission = material.emission * radiance,
        "materialGlowTintsLight" | "independent" => {
            (emissive.emission, emissive.emission_texture) = (radiance, None);
        }
        _ => {
            emissive = Material {
                emission: radiance,
                base_color: Vec4::W,
                specular: 0.0,
                metallic: 0.0,
                roughness: 1.0,
                ..Material::default()
            };
            emissive.double_sided = material.double_sided;
        }
    }
    Some(emissive)
}

/// Returns true if the radiance of a mesh that is a light is divided by the mesh's area in the
/// scene.
pub(crate) fn is_normalized(entry: &serde_json::Value) -> bool {
    serde_json::from_value::<MeshEntry>(entry.clone()).is_ok_and(|entry| entry.normalize)
}

/// The emission of a mesh that is a light, in the form in which the walker (Python) writes it.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
struct MeshEntry {
    radiance: [f32; 3],
    normalize: bool,
    sync: String,
}

/// Returns the rotation in a matrix. Scale, shear and reflection are left out.
fn rotation(matrix: &DAffine3) -> DQuat {
    let y = matrix.matrix3.y_axis.normalize_or(DVec3::Y);
    let z = matrix.matrix3.z_axis;
    let z = (z - y * y.dot(z)).normalize_or(y.any_orthonormal_vector());
    DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z))
}

/// Returns the area of triangles after the affine map `matrix`.
pub(crate) fn area(positions: &[Vec3], triangles: &[[u32; 3]], matrix: &DAffine3) -> f64 {
    let at = |i: u32| matrix.transform_point3(positions[i as usize].as_dvec3());
    triangles.iter().map(|&[a, b, c]| 0.5 * (at(b) - at(a)).cross(at(c) - at(a)).length()).sum()
}

fn sphere(radius: f32) -> Geometry {
    let mut ball = ball(SPHERE_PARTS);
    ball.positions.iter_mut().for_each(|position| *position *= 2.0 * radius);
    ball
}

/// Returns a rectangle that faces −z. Seen from that side, its picture is upright.
fn rectangle(width: f32, height: f32) -> Geometry {
    let mut geometry = Geometry::default();
    let corners = [(1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(x, y): (f32, f32)| {
        let position = Vec3::new(0.5 * width * x, 0.5 * height * y, 0.0);
        geometry.vertex(position, Vec3::NEG_Z, Vec2::new(0.5 - 0.5 * x, 0.5 - 0.5 * y))
    });
    geometry.quad(corners, 0);
    geometry
}

/// Makes a disc that faces −z.
fn disc(radius: f32) -> Geometry {
    let mut geometry = Geometry::default();
    let centre = geometry.vertex(Vec3::ZERO, Vec3::NEG_Z, Vec2::splat(0.5));
    let rim: Vec<u32> = (0..SIDES)
        .map(|i| {
            let (sine, cosine) = (2.0 * PI * i as f32 / SIDES as f32).sin_cos();
            let uv = Vec2::new(0.5 - 0.5 * cosine, 0.5 - 0.5 * sine);
            geometry.vertex(radius * Vec3::new(cosine, sine, 0.0), Vec3::NEG_Z, uv)
        })
        .collect();
    (0..SIDES).for_each(|i| geometry.triangle([centre, rim[(i + 1) % SIDES], rim[i]], 0));
    geometry
}

/// Makes the side of a cylinder along x.
fn tube(radius: f32, length: f32) -> Geometry {
    let mut geometry = Geometry::default();
    for i in 0..=SIDES {
        let (sine, cosine) = (2.0 * PI * (i % SIDES) as f32 / SIDES as f32).sin_cos();
        let normal = Vec3::new(0.0, cosine, sine);
        for end in [-0.5, 0.5] {
            let uv = Vec2::new(end + 0.5, i as f32 / SIDES as f32);
            geometry.vertex(Vec3::new(end * length, 0.0, 0.0) + radius * normal, normal, uv);
        }
    }
    for i in 0..SIDES as u32 {
        geometry.quad([2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2], 0);
    }
    geometry
}
