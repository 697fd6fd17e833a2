//! The parts of a scene, as importers fill them.

use glam::{Affine3A, Quat, Vec2, Vec3, Vec4};

use crate::{Cloud, Image, Material, PlacedCloud, Texture};

/// A scene that is not checked yet; see [`SceneParts::validate`].
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
    /// Materials, to which meshes refer by index.
    pub materials: Vec<Material>,
    /// Textures, to which materials refer by index.
    pub textures: Vec<Texture>,
    /// Images, to which textures and the environment refer by index.
    pub images: Vec<Image>,
    /// Punctual lights. Area lights are emissive meshes.
    pub lights: Vec<Light>,
    /// Cameras, the file's preferred camera first.
    pub cameras: Vec<Camera>,
    /// Light from infinity; without it the scene is surrounded by black.
    pub environment: Option<Environment>,
    /// Linear radiance ≥ 0 that the viewer sees past the scene, instead of the environment. Mirrors
    /// and refracting surfaces show the environment.
    pub backdrop: Option<Vec3>,
}

/// An indexed triangle mesh. The corners of front faces are counter-clockwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Place in the file ("/meshes/3/primitives/0"), for messages.
    pub place: String,
    /// Vertex positions in mesh space.
    pub positions: Vec<Vec3>,
    /// Unit normals, one per vertex. If there are none, the validator generates flat ones.
    pub normals: Vec<Vec3>,
    /// Unit tangents. Their w = ±1 is the handedness of the bitangent `w · normal × tangent`. May
    /// be empty: the validator generates tangents if the material has a normal map or anisotropy.
    pub tangents: Vec<Vec4>,
    /// Texture coordinates of sets 0 and 1. Each may be empty; the mesh then has (0, 0) everywhere.
    pub uvs: [Vec<Vec2>; 2],
    /// Linear RGBA per vertex, which multiplies the base colour; may be empty.
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
    /// Any invertible affine map. A negative determinant reverses the winding.
    pub scene_from_mesh: Affine3A,
}

/// A light without a surface: a light of `KHR_lights_punctual`, or the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Position in the scene; unused by directional lights.
    pub position: Vec3,
    /// Unit direction in which light travels; unused by point lights.
    pub direction: Vec3,
    /// Linear RGB. For points and spots it is the radiant intensity (scale of candela), for
    /// directional lights the irradiance (scale of lux).
    pub intensity: Vec3,
    /// Shape of the emission.
    pub kind: LightKind,
}

/// Shape of a punctual light's emission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Equal in all directions.
    Point,
    /// A cone.
    Spot {
        /// Half angle within which the intensity is full.
        inner_cone_rad: f32,
        /// Half angle at which the intensity reaches zero.
        outer_cone_rad: f32,
    },
    /// Parallel light.
    Directional,
    /// Light from a disc of the sky with one radiance, such as the sun. `intensity` is the
    /// irradiance of a surface that faces the disc's centre. It lights surfaces, but cameras and
    /// mirrors do not show it.
    Distant {
        /// Angle from the centre to the edge, 0..=π/2.
        half_angle_rad: f32,
    },
}

/// A camera that looks along −z of its space, with y up (glTF's convention).
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Name in the file, or its number.
    pub name: String,
    /// Placement. The validator removes its scale.
    pub scene_from_camera: Affine3A,
    /// Kind of projection.
    pub projection: Projection,
    /// Distance of the plane of focus, in scene units, if the file gives one.
    pub focus_distance: Option<f32>,
    /// Distance of the near plane, ≥ 0, in scene units, if the file gives one. Objects in front of
    /// the plane are not seen.
    pub near: Option<f32>,
}

/// Projection of a [`Camera`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Projection through a point.
    Perspective {
        /// Full vertical angle of view.
        vertical_fov_rad: f32,
        /// Width over height; with `None` the view is as wide as the display's.
        aspect: Option<f32>,
    },
    /// Parallel projection.
    Orthographic {
        /// Half width of the view, scene units.
        half_width: f32,
        /// Half height of the view, scene units.
        half_height: f32,
    },
}

/// Light from infinity: an equirectangular map. Its top row shows the environment's +y, and the
/// middle of its columns shows −z. Columns to the right of the middle turn towards +x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Environment {
    /// Index into [`SceneParts::images`], of an `RgbF32` image with linear radiance.
    pub image: usize,
    /// Factor on the map.
    pub strength: Vec3,
    /// Rotation of the map.
    pub scene_from_environment: Quat,
}
