//! Surface appearance: glTF's metallic-roughness model and the textures that feed it.

use glam::{Affine2, Vec3, Vec4};

/// Metallic-roughness material (glTF 2.0, section 3.9), with the extensions named at each field.
/// Every texture multiplies the factor beside it.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name in the file, for messages.
    pub name: String,
    /// Linear RGB reflectance (or metal reflectance) and alpha, each 0..1.
    pub base_color: Vec4,
    /// RGB sRGB-encoded, alpha linear.
    pub base_color_texture: Option<TextureUse>,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness 0..1; GGX α = roughness².
    pub roughness: f32,
    /// Green: roughness, blue: metallic; linear.
    pub metallic_roughness_texture: Option<TextureUse>,
    /// Tangent-space normals, linear, xyz = 2·rgb − 1.
    pub normal_texture: Option<TextureUse>,
    /// Factor on the x and y of the normal map.
    pub normal_scale: f32,
    /// Linear RGB radiance (W/(sr·m²) up to the file's unit), `KHR_materials_emissive_strength` included.
    pub emission: Vec3,
    /// RGB sRGB-encoded.
    pub emission_texture: Option<TextureUse>,
    /// What alpha means.
    pub alpha_mode: AlphaMode,
    /// Whether back faces are shaded; otherwise they are invisible.
    pub double_sided: bool,
    /// Shown with its base colour whatever the light (`KHR_materials_unlit`).
    pub unlit: bool,
    /// Index of refraction (`KHR_materials_ior`), ≥ 1.
    pub ior: f32,
    /// Share of light that enters a dielectric and passes through (`KHR_materials_transmission`), 0..1.
    pub transmission: f32,
    /// Red channel, linear.
    pub transmission_texture: Option<TextureUse>,
    /// Whether the surface bounds a solid (`KHR_materials_volume`) and so refracts; otherwise it is an infinitely thin wall.
    pub solid: bool,
    /// Colour of white light after [`attenuation_distance`](Self::attenuation_distance) inside a solid, 0..1.
    pub attenuation_color: Vec3,
    /// Scene units; infinite when the solid does not absorb.
    pub attenuation_distance: f32,
}

impl Default for Material {
    /// glTF's default material: white, metallic 1, roughness 1.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            emission: Vec3::ZERO,
            emission_texture: None,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
            ior: 1.5,
            transmission: 0.0,
            transmission_texture: None,
            solid: false,
            attenuation_color: Vec3::ONE,
            attenuation_distance: f32::INFINITY,
        }
    }
}

impl Material {
    /// Every texture use with the glTF name of its slot.
    pub fn textures(&self) -> impl Iterator<Item = (&'static str, &TextureUse)> {
        [
            ("baseColorTexture", &self.base_color_texture),
            ("metallicRoughnessTexture", &self.metallic_roughness_texture),
            ("normalTexture", &self.normal_texture),
            ("emissiveTexture", &self.emission_texture),
            ("transmissionTexture", &self.transmission_texture),
        ]
        .into_iter()
        .filter_map(|(slot, texture)| texture.as_ref().map(|texture| (slot, texture)))
    }

    /// Whether the surface can emit light.
    pub fn is_emissive(&self) -> bool {
        self.emission.max_element() > 0.0 || self.unlit
    }
}

/// What a material's alpha means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    Opaque,
    /// Present where alpha reaches the cutoff, absent elsewhere.
    Mask {
        /// Threshold, 0..1.
        cutoff: f32,
    },
    /// Covers the share alpha of the surface.
    Blend,
}

/// A texture as one material slot uses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureUse {
    /// Index into [`SceneParts::textures`](crate::SceneParts::textures).
    pub texture: usize,
    /// Texture coordinate set, 0 or 1.
    pub uv_set: usize,
    /// `KHR_texture_transform`: applied to the mesh's coordinates.
    pub texture_from_mesh: Affine2,
}

/// An image with its sampling rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Index into [`SceneParts::images`](crate::SceneParts::images).
    pub image: usize,
    /// Outside 0..1 in u.
    pub wrap_u: Wrap,
    /// Outside 0..1 in v.
    pub wrap_v: Wrap,
    /// Between texels.
    pub filter: Filter,
}

/// What lies outside the unit square of a texture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Tiles.
    #[default]
    Repeat,
    /// Tiles, every other one flipped.
    MirroredRepeat,
    /// The edge texel.
    ClampToEdge,
}

/// How a magnified texture is interpolated; minification always uses the image pyramid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// Bilinear.
    #[default]
    Linear,
    /// Nearest texel.
    Nearest,
}

/// A decoded picture. Row 0 is the top row; texture coordinate v = 0 is its upper edge (glTF).
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Name or path, for messages.
    pub name: String,
    /// Columns, ≥ 1.
    pub width: usize,
    /// Rows, ≥ 1.
    pub height: usize,
    /// Row-major texels.
    pub pixels: Pixels,
}

/// Texels of an [`Image`]. Whether codes are sRGB-encoded or linear is decided by the slot that uses them.
#[derive(Clone, Debug, PartialEq)]
pub enum Pixels {
    /// 8-bit codes.
    Rgba8(Vec<[u8; 4]>),
    /// 16-bit codes.
    Rgba16(Vec<[u16; 4]>),
    /// Linear radiance; environment maps.
    RgbF32(Vec<[f32; 3]>),
}

impl Pixels {
    /// Number of texels.
    pub fn len(&self) -> usize {
        match self {
            Self::Rgba8(texels) => texels.len(),
            Self::Rgba16(texels) => texels.len(),
            Self::RgbF32(texels) => texels.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
