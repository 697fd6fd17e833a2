//! Surface appearance: glTF's metallic-roughness model, and the textures of its parameters.

use glam::{Affine2, Vec3, Vec4};

/// Metallic-roughness material (glTF 2.0, section 3.9), with the extensions that the fields name.
/// The texture of a factor multiplies this factor.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name in the file, for messages.
    pub name: String,
    /// Linear RGB reflectance of a dielectric or metal, and alpha, each 0..1.
    pub base_color: Vec4,
    /// Texture of the base colour: RGB is sRGB-encoded, alpha is linear.
    pub base_color_texture: Option<TextureUse>,
    /// 0 for a dielectric, 1 for a metal.
    pub metallic: f32,
    /// Perceptual roughness 0..1; GGX α = roughness².
    pub roughness: f32,
    /// Texture whose green channel is roughness and whose blue channel is metallic; linear.
    pub metallic_roughness_texture: Option<TextureUse>,
    /// Texture of normals in tangent space: xyz = 2·rgb − 1; linear.
    pub normal_texture: Option<TextureUse>,
    /// Factor on the x and y of the normal map.
    pub normal_scale: f32,
    /// Linear RGB radiance in the file's unit, which is W/(sr·m²) up to a factor. It includes the
    /// factor of `KHR_materials_emissive_strength`.
    pub emission: Vec3,
    /// Texture of the emission: RGB is sRGB-encoded.
    pub emission_texture: Option<TextureUse>,
    /// Effect of the base colour's alpha on the surface.
    pub alpha_mode: AlphaMode,
    /// True if back faces are shaded; otherwise they are invisible.
    pub double_sided: bool,
    /// True if the surface shows its base colour under any light (`KHR_materials_unlit`).
    pub unlit: bool,
    /// Marks a surface that represents a light source of the file, visible or invisible to the
    /// viewer.
    pub lamp: Lamp,
    /// Index of refraction (`KHR_materials_ior`), ≥ 1 or 0. With 0, a dielectric reflects the
    /// fraction `specular` · `specular_color` at normal incidence (the specular-glossiness
    /// workflow).
    pub ior: f32,
    /// Factor on the dielectric reflection (`KHR_materials_specular`), 0..1.
    pub specular: f32,
    /// Texture of `specular`, in the alpha channel; linear.
    pub specular_texture: Option<TextureUse>,
    /// Linear RGB factor on the dielectric reflection at normal incidence
    /// (`KHR_materials_specular`), ≥ 0. The reflectance, after multiplication, is at most 1.
    pub specular_color: Vec3,
    /// Texture of `specular_color`: RGB is sRGB-encoded.
    pub specular_color_texture: Option<TextureUse>,
    /// Fraction of a dielectric's unreflected light that passes through it instead of being
    /// scattered (`KHR_materials_transmission`), 0..1.
    pub transmission: f32,
    /// Texture of `transmission`, in the red channel; linear.
    pub transmission_texture: Option<TextureUse>,
    /// True if the surface bounds a solid (`KHR_materials_volume`) and so refracts; otherwise it is
    /// an infinitely thin wall.
    pub solid: bool,
    /// Colour of white light after [`attenuation_distance`](Self::attenuation_distance) inside a
    /// solid, 0..1.
    pub attenuation_color: Vec3,
    /// Distance at which white light has `attenuation_color`, in scene units; infinite if the solid
    /// does not absorb.
    pub attenuation_distance: f32,
    /// 20 / Abbe number of a solid (`KHR_materials_dispersion`), ≥ 0; a solid with 0 does not
    /// disperse.
    pub dispersion: f32,
    /// A clear dielectric layer on top of the surface.
    pub clearcoat: Option<Clearcoat>,
    /// Fibres on top of the surface, as on cloth.
    pub sheen: Option<Sheen>,
    /// A thin film on the base, whose interference changes the colour of reflections.
    pub iridescence: Option<Iridescence>,
    /// Stretches reflections of the base along one direction, as on brushed metal.
    pub anisotropy: Option<Anisotropy>,
}

/// `KHR_materials_clearcoat`: a dielectric layer with index 1.5.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clearcoat {
    /// Fraction of the surface that is coated, 0..1.
    pub factor: f32,
    /// Texture of `factor`, in the red channel; linear.
    pub texture: Option<TextureUse>,
    /// Perceptual roughness of the coat, 0..1.
    pub roughness: f32,
    /// Texture of `roughness`, in the green channel; linear.
    pub roughness_texture: Option<TextureUse>,
    /// Normals of the coat, as [`Material::normal_texture`]; without this texture the coat has the
    /// geometry's normals.
    pub normal_texture: Option<TextureUse>,
    /// Factor on the x and y of the coat's normal map.
    pub normal_scale: f32,
}

/// Fibres on a surface (`KHR_materials_sheen`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sheen {
    /// Colour of the fibres, linear RGB, 0..1.
    pub color: Vec3,
    /// Texture of `color`: RGB is sRGB-encoded.
    pub color_texture: Option<TextureUse>,
    /// Perceptual roughness of the fibres' reflection, 0..1.
    pub roughness: f32,
    /// Texture of `roughness`, in the alpha channel; linear.
    pub roughness_texture: Option<TextureUse>,
}

/// `KHR_materials_iridescence`: interference in a thin film.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iridescence {
    /// Fraction of the surface that has the film, 0..1.
    pub factor: f32,
    /// Texture of `factor`, in the red channel; linear.
    pub texture: Option<TextureUse>,
    /// Index of refraction of the film, ≥ 1.
    pub ior: f32,
    /// Thickness of the film in nanometres: where the thickness texture is 0, and where the texture
    /// is 1. Without a texture the film has the second thickness.
    pub thickness_nm: [f32; 2],
    /// Texture that mixes the two values of `thickness_nm`, in the green channel; linear.
    pub thickness_texture: Option<TextureUse>,
}

impl Default for Iridescence {
    fn default() -> Self {
        Self { factor: 0.0, texture: None, ior: 1.3, thickness_nm: [100.0, 400.0], thickness_texture: None }
    }
}

/// Stretched reflection (`KHR_materials_anisotropy`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Anisotropy {
    /// Strength, 0..1. Along the direction of stretch, GGX α becomes α + (1 − α) strength². Across
    /// it, α stays.
    pub strength: f32,
    /// Angle from the tangent to the direction of stretch, counter-clockwise in tangent space.
    pub rotation_rad: f32,
    /// Texture whose red and green channels are a direction in tangent space, 2·rg − 1, which
    /// `rotation_rad` then rotates. Its blue channel is a factor on the strength. All channels are
    /// linear.
    pub texture: Option<TextureUse>,
}

/// Marks a surface that represents a light source of the file. A glowing object of the scene is an
/// ordinary surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lamp {
    /// An ordinary surface, which represents no light source.
    #[default]
    No,
    /// A light source that the viewer does not see: camera rays pass through it. It is still seen
    /// in mirrors and through panes, and casts shadows.
    Unseen,
    /// A light source that the viewer sees.
    Seen,
}

impl Default for Material {
    /// Returns glTF's default material: white, metallic 1, roughness 1.
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
            lamp: Lamp::No,
            ior: 1.5,
            specular: 1.0,
            specular_texture: None,
            specular_color: Vec3::ONE,
            specular_color_texture: None,
            transmission: 0.0,
            transmission_texture: None,
            solid: false,
            attenuation_color: Vec3::ONE,
            attenuation_distance: f32::INFINITY,
            dispersion: 0.0,
            clearcoat: None,
            sheen: None,
            iridescence: None,
            anisotropy: None,
        }
    }
}

impl Material {
    /// Returns every use of a texture, with glTF's name of its slot.
    pub fn textures(&self) -> impl Iterator<Item = (&'static str, &TextureUse)> {
        let clearcoat = self.clearcoat.as_ref();
        let sheen = self.sheen.as_ref();
        let iridescence = self.iridescence.as_ref();
        [
            ("baseColorTexture", self.base_color_texture.as_ref()),
            ("metallicRoughnessTexture", self.metallic_roughness_texture.as_ref()),
            ("normalTexture", self.normal_texture.as_ref()),
            ("emissiveTexture", self.emission_texture.as_ref()),
            ("specularTexture", self.specular_texture.as_ref()),
            ("specularColorTexture", self.specular_color_texture.as_ref()),
            ("transmissionTexture", self.transmission_texture.as_ref()),
            ("clearcoatTexture", clearcoat.and_then(|coat| coat.texture.as_ref())),
            ("clearcoatRoughnessTexture", clearcoat.and_then(|coat| coat.roughness_texture.as_ref())),
            ("clearcoatNormalTexture", clearcoat.and_then(|coat| coat.normal_texture.as_ref())),
            ("sheenColorTexture", sheen.and_then(|sheen| sheen.color_texture.as_ref())),
            ("sheenRoughnessTexture", sheen.and_then(|sheen| sheen.roughness_texture.as_ref())),
            ("iridescenceTexture", iridescence.and_then(|film| film.texture.as_ref())),
            ("iridescenceThicknessTexture", iridescence.and_then(|film| film.thickness_texture.as_ref())),
            ("anisotropyTexture", self.anisotropy.as_ref().and_then(|stretch| stretch.texture.as_ref())),
        ]
        .into_iter()
        .filter_map(|(slot, texture)| texture.map(|texture| (slot, texture)))
    }

    /// Returns the coordinate set that tangents must follow. It is the set of the normal map, or
    /// else of the coat's normal map, or else of the anisotropy texture. Anisotropy without a
    /// texture has set 0. `None` if the material needs no tangents.
    pub fn tangent_uv_set(&self) -> Option<usize> {
        let coat = self.clearcoat.as_ref().and_then(|coat| coat.normal_texture.as_ref());
        let mapped = self.normal_texture.as_ref().or(coat).map(|texture| texture.uv_set);
        let stretched = self.anisotropy.as_ref().map(|stretch| stretch.texture.map_or(0, |texture| texture.uv_set));
        mapped.or(stretched)
    }

    /// Returns true if the surface can emit light.
    pub fn is_emissive(&self) -> bool {
        self.emission.max_element() > 0.0 || self.unlit
    }
}

/// Meaning of a material's alpha.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    Opaque,
    /// The surface exists where alpha reaches the cutoff, and is absent elsewhere.
    Mask {
        /// Smallest alpha at which the surface exists, 0..1.
        cutoff: f32,
    },
    /// The surface covers the fraction alpha of its area.
    Blend,
}

/// Use of a texture in one slot of a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureUse {
    /// Index into [`SceneParts::textures`](crate::SceneParts::textures).
    pub texture: usize,
    /// Texture coordinate set of the mesh, 0 or 1.
    pub uv_set: usize,
    /// Transform of the mesh's texture coordinates (`KHR_texture_transform`).
    pub texture_from_mesh: Affine2,
}

/// An image with rules for sampling it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Index of the image in [`SceneParts::images`](crate::SceneParts::images).
    pub image: usize,
    /// Rule for texture coordinates u outside 0..1.
    pub wrap_u: Wrap,
    /// Rule for texture coordinates v outside 0..1.
    pub wrap_v: Wrap,
    /// Interpolation between texels where the texture is magnified.
    pub filter: Filter,
}

/// Content of a texture outside its unit square.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// The texture repeats.
    #[default]
    Repeat,
    /// The texture repeats, and every other copy is flipped.
    MirroredRepeat,
    /// The texels of the edge continue outside.
    ClampToEdge,
}

/// Interpolation of a magnified texture; minification always uses the image pyramid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// The four nearest texels are interpolated.
    #[default]
    Linear,
    /// The nearest texel is shown.
    Nearest,
}

/// A decoded picture. Row 0 is the top row, and the texture coordinate v = 0 is its upper edge
/// (glTF).
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Name or path of the image, for messages.
    pub name: String,
    /// Number of columns of the image, ≥ 1.
    pub width: usize,
    /// Number of rows of the image, ≥ 1.
    pub height: usize,
    /// Texels of the image, row by row.
    pub pixels: Pixels,
}

/// Texels of an [`Image`]. The slot that uses the image decides if its codes are sRGB-encoded or
/// linear.
#[derive(Clone, Debug, PartialEq)]
pub enum Pixels {
    /// 8-bit codes of red, green, blue and alpha.
    Rgba8(Vec<[u8; 4]>),
    /// 16-bit codes of red, green, blue and alpha.
    Rgba16(Vec<[u16; 4]>),
    /// Linear radiance, for environment maps and emission.
    RgbF32(Vec<[f32; 3]>),
}

impl Pixels {
    /// Returns the number of texels.
    pub fn len(&self) -> usize {
        match self {
            Self::Rgba8(texels) => texels.len(),
            Self::Rgba16(texels) => texels.len(),
            Self::RgbF32(texels) => texels.len(),
        }
    }

    /// Returns true if there are no texels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
