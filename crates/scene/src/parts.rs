//! The parts of a scene, as importers fill them.

use glam::{Affine3A, Quat, Vec2, Vec3, Vec4};

use crate::{Cloud, Image, Material, PlacedCloud, Texture};

/// A scene before its check; see [`SceneParts::validate`].
#[derive(Clone, Debug, Default)]
pub struct SceneParts {
    /// Name or path, for messages.
    pub name: String,
    /// Triangle meshes, each with one material.
    pub meshes: Vec<Mesh>,
    /// Placed meshes.
    pub instances: Vec<Instance>,
    /// Clouds of Gaussian splats.
    pub clouds: Vec<Cloud>,
    /// Placed clouds.
    pub placed_clouds: Vec<PlacedCloud>,
    /// Materials; meshes index them.
    pub materials: Vec<Material>,
    /// Textures; materials index them.
    pub textures: Vec<Texture>,
    /// Images; textures and the environment index them.
    pub images: Vec<Image>,
    /// Punctual lights. Area lights are emissive meshes.
    pub lights: Vec<Light>,
    /// Cameras, the file's preferred one first.
    pub cameras: Vec<Camera>,
    /// Light from infinity; `None` is black.
    pub environment: Option<Environment>,
    /// Linear radiance ≥ 0 that the viewer sees past the scene instead of the environment. Mirrors
    /// and bent light show the environment.
    pub backdrop: Option<Vec3>,
}

/// An indexed triangle mesh. Front faces wind counter-clockwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Place in the file ("/meshes/3/primitives/0"), for messages.
    pub place: String,
    /// Vertex positions in mesh space.
    pub positions: Vec<Vec3>,
    /// Unit normals, one per vertex. The validator generates flat ones when empty.
    pub normals: Vec<Vec3>,
    /// Unit tangents, w = ±1 the handedness of the bitangent `w · normal × tangent`; may be empty.
    /// The validator generates them when the material has a normal map or anisotropy and the mesh
    /// has none.
    pub tangents: Vec<Vec4>,
    /// Texture coordinates of set 0 and 1; each may be empty, which reads (0, 0).
    pub uvs: [Vec<Vec2>; 2],
    /// Linear RGBA that multiplies the base colour; may be empty.
    pub colors: Vec<Vec4>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`SceneParts::materials`].
    pub material: usize,
}

/// A mesh placed in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Index into [`SceneParts::meshes`].
    pub mesh: usize,
    /// Any invertible affine map; a negative determinant flips the winding.
    pub scene_from_mesh: Affine3A,
}

/// A light without a surface: those of `KHR_lights_punctual`, and the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Position in the scene; unused by directional lights.
    pub position: Vec3,
    /// Unit direction in which light travels; unused by point lights.
    pub direction: Vec3,
    /// Point and spot: radiant intensity (candela scale); directional: irradiance (lux scale).
    /// Linear RGB.
    pub intensity: Vec3,
    /// Shape of the emission.
    pub kind: LightKind,
}

/// Shape of a punctual light's emission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// The same in all directions.
    Point,
    /// A cone.
    Spot {
        /// Half angle of full intensity.
        inner_cone_rad: f32,
        /// Half angle where intensity reaches zero.
        outer_cone_rad: f32,
    },
    /// Parallel light.
    Directional,
    /// Light from a disc of the sky with one radiance, such as the sun; `intensity` is the
    /// irradiance on a surface that faces its centre. Seen by surfaces alone, not by cameras or
    /// mirrors.
    Distant {
        /// Angle from the centre to the edge, 0..=π/2.
        half_angle_rad: f32,
    },
}

/// A camera that looks along −z of its own space, y up (glTF's convention).
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Name in the file, or its number.
    pub name: String,
    /// Placement. Scale is removed by the validator.
    pub scene_from_camera: Affine3A,
    /// Kind of projection.
    pub projection: Projection,
    /// Distance of the plane of focus, scene units, where the file gives one.
    pub focus_distance: Option<f32>,
    /// Distance of the near plane ≥ 0, scene units, where the file gives one: nothing before it is
    /// seen.
    pub near: Option<f32>,
}

/// Projection of a [`Camera`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Pinhole.
    Perspective {
        /// Full vertical angle of view.
        vertical_fov_rad: f32,
        /// Width over height; `None` adapts to the display.
        aspect: Option<f32>,
    },
    /// Parallel.
    Orthographic {
        /// Half width of the view, scene units.
        half_width: f32,
        /// Half height of the view, scene units.
        half_height: f32,
    },
}

/// Light from infinity: an equirectangular map. Its top row is the environment's +y; the column at
/// the centre of the picture is its −z, and columns to the right turn towards +x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Environment {
    /// Index into [`SceneParts::images`]; an `RgbF32` image of linear radiance.
    pub image: usize,
    /// Factor on the map.
    pub strength: Vec3,
    /// Rotation of the map.
    pub scene_from_environment: Quat,
}
