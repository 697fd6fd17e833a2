//! The parts of a scene, as importers fill them.

use glam::{Affine3A, Quat, Vec2, Vec3, Vec4};

use crate::{Cloud, Image, Material, PlacedCloud, Texture};

/// A scene that is not checked yet; see [`SceneParts::validate`].
#[derive(Clone, Debug, Default)]
pub struct SceneParts {
    /// Name or path of the scene, for messages.
    pub name: String,
    /// Triangle meshes, each with one material.
    pub meshes: Vec<Mesh>,
    /// Meshes that are placed in the scene.
    pub instances: Vec<Instance>,
    /// Clouds of Gaussian splats.
    pub clouds: Vec<Cloud>,
    /// Clouds that are placed in the scene.
    pub placed_clouds: Vec<PlacedCloud>,
    /// Materials, to which meshes refer by index.
    pub materials: Vec<Material>,
    /// Textures, to which materials refer by index.
    pub textures: Vec<Texture>,
    /// Images, to which textures and the environment refer by index.
    pub images: Vec<Image>,
    /// Punctual lights. Area lights are emissive meshes.
    pub lights: Vec<Light>,
    /// Cameras, with the file's preferred camera first, if it names one.
    pub cameras: Vec<Camera>,
    /// Light from infinity; without it the scene is surrounded by black.
    pub environment: Option<Environment>,
    /// Linear radiance ≥ 0 that the viewer sees behind the scene, instead of the environment.
    /// Mirrors and refracting surfaces show the environment.
    pub backdrop: Option<Vec3>,
}

/// An indexed triangle mesh. The corners of front faces are counter-clockwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Place in the file ("/meshes/3/primitives/0"), for messages.
    pub place: String,
    /// Vertex positions in mesh space.
    pub positions: Vec<Vec3>,
    /// Unit normals, one per vertex. If the list is empty, the validator generates the normals of
    /// the triangles.
    pub normals: Vec<Vec3>,
    /// Unit tangents. Their w = ±1 is the handedness of the bitangent `w · normal × tangent`. The
    /// list may be empty; the validator then generates tangents if the material has a normal map or
    /// anisotropy.
    pub tangents: Vec<Vec4>,
    /// Texture coordinates of sets 0 and 1. An empty set has the coordinates (0, 0) everywhere.
    pub uvs: [Vec<Vec2>; 2],
    /// Linear RGBA per vertex, which multiplies the base colour; may be empty.
    pub colors: Vec<Vec4>,
    /// Vertex indices of the corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Index of the mesh's material in [`SceneParts::materials`].
    pub material: usize,
}

/// A mesh placed in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Index into [`SceneParts::meshes`].
    pub mesh: usize,
    /// Placement of the mesh: any invertible affine map. A negative determinant reverses the
    /// winding of its triangles.
    pub scene_from_mesh: Affine3A,
}

/// A light without a surface: a light of `KHR_lights_punctual`, or the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Position in the scene; unused by directional and distant lights.
    pub position: Vec3,
    /// Unit direction in which light travels. Point lights do not use it, but it must not be zero.
    pub direction: Vec3,
    /// Linear RGB. For point and spot lights this is the radiant intensity (candela up to a
    /// factor). For directional and distant lights it is the irradiance (lux up to a factor).
    pub intensity: Vec3,
    /// Kind of the light. The kind decides how the light spreads.
    pub kind: LightKind,
}

/// Shape of a punctual light's emission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// The light emits equally in all directions.
    Point,
    /// The light emits into a cone.
    Spot {
        /// Half angle of the cone within which the intensity is full, 0..=`outer_cone_rad`.
        inner_cone_rad: f32,
        /// Half angle of the cone at which the intensity reaches zero, above 0, at most π/2.
        outer_cone_rad: f32,
    },
    /// The light's rays are parallel.
    Directional,
    /// Light from a disc of the sky with uniform radiance, such as the sun. `intensity` is the
    /// irradiance of a surface that faces the disc's centre. This light illuminates surfaces, but
    /// cameras and mirrors do not show the disc.
    Distant {
        /// Angle from the disc's centre to its edge, 0..=π/2.
        half_angle_rad: f32,
    },
}

/// A camera that looks along −z of its space, with y up (glTF's convention).
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Name of the camera in the file, or its number.
    pub name: String,
    /// Placement of the camera. The validator removes its scale.
    pub scene_from_camera: Affine3A,
    /// Perspective or parallel projection.
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
    /// All rays pass through the camera's position.
    Perspective {
        /// Full vertical angle of view of the camera.
        vertical_fov_rad: f32,
        /// Width of the view over its height. With `None` the view has the display's aspect.
        aspect: Option<f32>,
    },
    /// All rays are parallel to the camera's axis.
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
    /// Linear RGB factor on the radiance of the map.
    pub strength: Vec3,
    /// Rotation from the axes of the map to the axes of the scene.
    pub scene_from_environment: Quat,
}
