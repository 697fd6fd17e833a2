//! Reads the inputs of surface shaders, and fills the slots of a [`Material`].

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use glam::{Vec3, Vec4};
use lumistack_core::Task;
use lumistack_core::colour::luminance;
use lumistack_scene::{AlphaMode, Anisotropy, Clearcoat, Iridescence, Material, Sheen, TextureUse};
use serde::Deserialize;

use crate::texture::{Channel, Kind, Source, Textures};

/// An input of a shader. At most one field is set; without any, the input has its default.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct Input {
    pub(crate) value: Option<Vec<f32>>,
    pub(crate) text: Option<String>,
    pub(crate) primvar: Option<String>,
    pub(crate) texture: Option<Source>,
}

/// A shader's value: a number, colour or vector of `N` components.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a material has about twenty values, and only while it is read")]
pub(crate) enum Value<const N: usize> {
    /// The value is constant.
    Constant([f32; N]),
    /// The value comes from a texture.
    Texture(Source),
    /// The value is the vertex colour.
    Colors,
}

impl Value<1> {
    /// Returns the number, or `None` if it comes from a texture or from the vertex colour.
    pub(crate) fn number(&self) -> Option<f32> {
        match self {
            Self::Constant([value]) => Some(*value),
            _ => None,
        }
    }

    fn channel(&self) -> Channel<'_> {
        match self {
            Self::Constant([value]) => Channel::Constant(*value),
            Self::Texture(source) => Channel::Component(source, 0),
            Self::Colors => Channel::Constant(1.0),
        }
    }
}

/// Index of refraction that every clearcoat has in this renderer.
const COAT_INDEX: f32 = 1.5;

/// The inputs of a shader. `read` has the names of inputs that were read; inputs that were never
/// read have no effect.
pub(crate) struct Inputs {
    inputs: BTreeMap<String, Input>,
    read: RefCell<BTreeSet<&'static str>>,
}

impl Inputs {
    pub(crate) fn new(inputs: BTreeMap<String, Input>) -> Self {
        Self { inputs, read: RefCell::default() }
    }

    /// Reads an input of `N` components. A single number is used for all components.
    pub(crate) fn get<const N: usize>(&self, name: &'static str, default: [f32; N]) -> Value<N> {
        self.read.borrow_mut().insert(name);
        let Some(input) = self.inputs.get(name) else { return Value::Constant(default) };
        if let Some(values) = &input.value {
            let at = |k: usize| values.get(k).or(if values.len() == 1 { values.first() } else { None }).copied();
            return Value::Constant(std::array::from_fn(|k| at(k).unwrap_or(default[k])));
        }
        if let Some(source) = &input.texture {
            let mut source = source.clone();
            if source.channels.len() == 1 && N > 1 {
                source.channels = vec![source.channels[0]; N];
                for list in [&mut source.scale, &mut source.bias, &mut source.fallback] {
                    *list = vec![list[0]; N];
                }
            }
            if source.channels.len() >= N {
                return Value::Texture(source);
            }
        }
        match &input.primvar {
            Some(name) if name == "displayColor" && N == 3 => Value::Colors,
            _ => Value::Constant(default),
        }
    }

    /// Returns an input that must be a constant number. Any other input is replaced by `default`.
    pub(crate) fn number(&self, name: &'static str, default: f32) -> f32 {
        self.get(name, [default]).number().unwrap_or(default)
    }

    /// Returns a colour that must be constant. Any other input is replaced by `default`.
    pub(crate) fn color(&self, name: &'static str, default: [f32; 3]) -> Vec3 {
        match self.get(name, default) {
            Value::Constant(color) => color.into(),
            _ => default.into(),
        }
    }

    pub(crate) fn text(&self, name: &'static str) -> Option<&str> {
        self.read.borrow_mut().insert(name);
        self.inputs.get(name)?.text.as_deref()
    }

    /// Returns the names of inputs that have no effect although the file sets them. `known` lists
    /// inputs that `Material` cannot represent, with the default of their components. A listed
    /// input is returned if it differs from its default, or is a texture or primvar. Any other
    /// input is returned if it has a value or texture that was not read.
    pub(crate) fn ignored(&self, known: &[(&'static str, f32)]) -> Vec<String> {
        let read = self.read.borrow();
        let matters = |name: &str, input: &Input| {
            let default = known.iter().find(|(known, _)| *known == name).map(|(_, default)| *default);
            match (default, &input.value, read.contains(name)) {
                (Some(default), Some(values), _) => values.iter().any(|value| (value - default).abs() > 1e-6),
                (Some(_), None, _) => input.texture.is_some() || input.primvar.is_some(),
                (None, _, true) => false,
                (None, value, false) => value.is_some() || input.texture.is_some(),
            }
        };
        self.inputs.iter().filter(|(name, input)| matters(name, input)).map(|(name, _)| name.clone()).collect()
    }
}

/// A material that is being built from a shader: its methods fill the material's slots.
pub(crate) struct Builder<'b, 'a> {
    pub(crate) place: String,
    pub(crate) textures: &'b mut Textures<'a>,
    pub(crate) task: Task<'a>,
    pub(crate) uv_names: [Option<String>; 2],
    pub(crate) reads_colors: bool,
    pub(crate) material: Material,
}

impl<'a> Builder<'_, 'a> {
    pub(crate) fn warn(&self, message: impl Into<String>) {
        self.task.warn(&self.place, message);
    }

    /// Returns the index of the texture coordinate set that holds a primvar.
    fn uv_set(&mut self, name: &str) -> usize {
        for set in 0..2 {
            match &self.uv_names[set] {
                Some(known) if known == name => return set,
                Some(_) => {}
                None => {
                    self.uv_names[set] = Some(name.to_owned());
                    return set;
                }
            }
        }
        self.warn(format!(
            "expected at most two primvars as texture coordinates, found a third one, {name}; the first primvar is used instead of {name}"
        ));
        0
    }

    fn slot(&mut self, channels: [Channel<'_>; 4], kind: Kind) -> Option<TextureUse> {
        let primvar = channels.iter().find_map(|channel| match channel {
            Channel::Component(source, _) => Some(source.primvar.clone()),
            _ => None,
        })?;
        let set = self.uv_set(&primvar);
        self.textures.slot(channels, kind, set, &self.place)
    }

    /// Converts a colour to a factor and a texture.
    pub(crate) fn color(&mut self, value: &Value<3>, kind: Kind) -> (Vec3, Option<TextureUse>) {
        match value {
            Value::Constant(color) => ((*color).into(), None),
            Value::Colors => {
                self.warn("the primvar displayColor can be used for the base colour alone; inputs for another colour that read displayColor get white");
                (Vec3::ONE, None)
            }
            Value::Texture(source) => {
                let (factor, source) = factored(source, kind);
                let channels = [0, 1, 2].map(|k| Channel::Component(&source, k));
                (factor, self.slot([channels[0], channels[1], channels[2], Channel::Unused], kind))
            }
        }
    }

    /// Converts a number to a factor and a texture. The slot reads the texture's channel `channel`:
    /// 0 for red to 3 for alpha.
    pub(crate) fn data(&mut self, value: &Value<1>, channel: usize) -> (f32, Option<TextureUse>) {
        match value {
            Value::Constant([value]) => (*value, None),
            Value::Colors => (1.0, None),
            Value::Texture(source) => {
                let (factor, source) = factored(source, Kind::Data);
                let mut channels = [Channel::Unused; 4];
                channels[channel] = Channel::Component(&source, 0);
                (factor.x, self.slot(channels, Kind::Data))
            }
        }
    }

    /// Sets the base colour, scaled by a weight, and the opacity. If `threshold` is above 0,
    /// opacity is an alpha mask, otherwise it is blended.
    pub(crate) fn base(&mut self, color: &Value<3>, weight: f32, opacity: &Value<1>, threshold: f32) {
        // Split the colour into a factor and the channels of a texture.
        let opaque = opacity.number() == Some(1.0);
        let mut factor = Vec3::splat(weight);
        let scaled;
        let mut channels = match color {
            Value::Constant(color) => color.map(|value| Channel::Constant((value * weight).clamp(0.0, 1.0))),
            Value::Colors => {
                self.reads_colors = true;
                [Channel::Constant(weight); 3]
            }
            Value::Texture(source) => {
                let (own, source) = factored(source, Kind::Color);
                factor *= own;
                scaled = source;
                [0, 1, 2].map(|k| Channel::Component(&scaled, k))
            }
        };
        let textured = |channel: &Channel<'_>| matches!(channel, Channel::Component(..));
        if !channels.iter().any(textured) {
            // The colour is constant. If opacity needs a texture, the texture's colour is white.
            let constant = |channel: &Channel<'_>| if let Channel::Constant(value) = channel { *value } else { 1.0 };
            factor = Vec3::new(constant(&channels[0]), constant(&channels[1]), constant(&channels[2]));
            channels = [Channel::Constant(1.0); 3];
        }
        // Opacity is the texture's alpha channel, or the alpha of the factor.
        let alpha = opacity.number().unwrap_or(1.0).clamp(0.0, 1.0);
        let alpha_channel = match opacity.channel() {
            component @ Channel::Component(..) => component,
            _ => Channel::Unused,
        };
        self.material.base_color = factor.extend(alpha).clamp(Vec4::ZERO, Vec4::ONE);
        let [r, g, b] = channels;
        if textured(&r) || textured(&alpha_channel) {
            self.material.base_color_texture = self.slot([r, g, b, alpha_channel], Kind::Color);
        }
        self.material.alpha_mode = match (opaque, threshold > 0.0) {
            (true, _) => AlphaMode::Opaque,
            (false, true) => AlphaMode::Mask { cutoff: threshold },
            (false, false) => AlphaMode::Blend,
        };
        // an alpha mask hides nothing if the opacity is constant and at least the threshold
        if alpha_channel_is_unused(&alpha_channel) && !opaque && threshold > 0.0 && alpha >= threshold {
            self.material.alpha_mode = AlphaMode::Opaque;
        }
    }

    /// Sets roughness and metallic, which share a texture.
    pub(crate) fn roughness(&mut self, roughness: &Value<1>, metallic: &Value<1>) {
        let (material, constant) = (&mut self.material, [roughness.number(), metallic.number()]);
        (material.roughness, material.metallic) = (constant[0].unwrap_or(1.0), constant[1].unwrap_or(1.0));
        let channel = |value: &Value<1>| match value {
            Value::Texture(source) => Some(factored(source, Kind::Data)),
            _ => None,
        };
        let (rough, metal) = (channel(roughness), channel(metallic));
        let part = |found: &Option<(Vec3, Source)>| found.as_ref().map(|(factor, _)| factor.x);
        material.roughness = part(&rough).unwrap_or(material.roughness);
        material.metallic = part(&metal).unwrap_or(material.metallic);
        fn place(found: &Option<(Vec3, Source)>) -> Channel<'_> {
            // the constant is in the material's factor, so the texture's channel is 1
            found.as_ref().map_or(Channel::Constant(1.0), |(_, source)| Channel::Component(source, 0))
        }
        if rough.is_some() || metal.is_some() {
            let unused_metal = metal.is_none() && material.metallic == 0.0;
            let metal_channel = if unused_metal { Channel::Unused } else { place(&metal) };
            let channels = [Channel::Unused, place(&rough), metal_channel, Channel::Unused];
            self.material.metallic_roughness_texture = self.slot(channels, Kind::Data);
        }
    }

    /// Returns a normal map. The shader's vector is in tangent space, and already decoded.
    pub(crate) fn normal(&mut self, value: &Value<3>) -> Option<TextureUse> {
        let Value::Texture(source) = value else { return None };
        let channels = [0, 1, 2].map(|k| Channel::Component(source, k));
        self.slot([channels[0], channels[1], channels[2], Channel::Unused], Kind::Normal)
    }

    /// Sets the emission, which is a colour times a weight. Either the colour or the weight may be
    /// a texture, but not both.
    pub(crate) fn emission(&mut self, color: &Value<3>, weight: &Value<1>) {
        let (color, factor) = match (color, weight) {
            (color, Value::Constant([factor])) => (color.clone(), *factor),
            // multiply the texture of the weight by the constant colour
            (Value::Constant(color), Value::Texture(source)) => (Value::Texture(tinted(source, *color)), 1.0),
            (color, Value::Texture(source)) => {
                self.warn("an emission whose colour and weight are both pictures is not supported; the weight's fallback is used");
                (color.clone(), source.fallback[0])
            }
            (color, Value::Colors) => (color.clone(), 1.0),
        };
        if factor <= 0.0 {
            return;
        }
        let (color, texture) = self.color(&color, Kind::Light);
        self.material.emission = (color * factor).max(Vec3::ZERO);
        if self.material.emission != Vec3::ZERO {
            self.material.emission_texture = texture;
        }
    }

    /// Sets the clearcoat's weight, roughness and normal map. A constant weight of 0 sets no
    /// clearcoat.
    pub(crate) fn coat(&mut self, weight: &Value<1>, roughness: &Value<1>, normal: &Value<3>) {
        if weight.number().is_some_and(|weight| weight <= 0.0) {
            return;
        }
        let (factor, texture) = self.data(weight, 0);
        let (roughness, roughness_texture) = self.data(roughness, 1);
        let normal_texture = self.normal(normal);
        let coat = Clearcoat { factor, texture, roughness, roughness_texture, normal_texture, normal_scale: 1.0 };
        self.material.clearcoat = Some(coat);
    }

    /// Warns if the coat's index of refraction is not [`COAT_INDEX`].
    pub(crate) fn coat_index(&self, ior: f32) {
        if self.material.clearcoat.is_some() && (ior - COAT_INDEX).abs() > 1e-3 {
            self.warn(format!("the coat's index of refraction, {ior}, is not supported; {COAT_INDEX} is used"));
        }
    }

    /// Sets the sheen's colour and roughness. A weight of 0 sets no sheen.
    pub(crate) fn sheen(&mut self, weight: f32, color: &Value<3>, roughness: &Value<1>) {
        if weight <= 0.0 {
            return;
        }
        let (color, color_texture) = self.color(color, Kind::Color);
        let (roughness, roughness_texture) = self.data(roughness, 3);
        self.material.sheen = Some(Sheen { color: weight * color, color_texture, roughness, roughness_texture });
    }

    /// Sets a thin film, which has a constant thickness.
    pub(crate) fn film(&mut self, weight: f32, thickness_nm: f32, ior: f32) {
        if weight > 0.0 && thickness_nm > 0.0 {
            let thickness_nm = [thickness_nm; 2];
            self.material.iridescence =
                Some(Iridescence { factor: weight, ior, thickness_nm, ..Iridescence::default() });
        }
    }

    /// Sets anisotropic reflections; `rotation` is in turns.
    pub(crate) fn anisotropy(&mut self, strength: f32, rotation: f32) {
        if strength > 0.0 {
            let rotation_rad = rotation * std::f32::consts::TAU;
            self.material.anisotropy = Some(Anisotropy { strength, rotation_rad, texture: None });
        }
    }

    /// Sets the transmission. The mesh encloses a solid, unless `thin` is true. In a solid with a
    /// `depth` above 0, absorption gives transmitted light the `color`; otherwise the surface does.
    /// Without a `color`, the base colour tints transmitted light.
    pub(crate) fn transmission(&mut self, weight: &Value<1>, color: Option<Vec3>, depth: f32, thin: bool) {
        let (factor, texture) = self.data(weight, 0);
        if factor <= 0.0 {
            return;
        }
        let material = &mut self.material;
        (material.transmission, material.transmission_texture, material.solid) = (factor, texture, !thin);
        let Some(color) = color else { return };
        let mut tint = color;
        if depth > 0.0 && !thin {
            (material.attenuation_color, material.attenuation_distance) = (color, depth);
            tint = Vec3::ONE;
        }
        // The base colour of the scene's material tints diffuse and transmitted light alike. So the
        // base colour becomes a mix of the shader's diffuse colour and of its transmission colour.
        let base = material.base_color.truncate().lerp(tint, factor.clamp(0.0, 1.0));
        material.base_color = base.extend(material.base_color.w);
        if factor >= 1.0 {
            let opaque = material.alpha_mode == AlphaMode::Opaque;
            material.base_color_texture = material.base_color_texture.filter(|_| !opaque);
        }
    }

    /// Sets the weight and colour of the dielectric reflection, and the index of refraction.
    pub(crate) fn specular(&mut self, weight: &Value<1>, color: &Value<3>, ior: f32) {
        (self.material.specular, self.material.specular_texture) = self.data(weight, 3);
        (self.material.specular_color, self.material.specular_color_texture) = self.color(color, Kind::Color);
        self.material.ior = ior.max(1.0);
    }
}

fn alpha_channel_is_unused(channel: &Channel<'_>) -> bool {
    matches!(channel, Channel::Unused)
}

/// Multiplies a texture of one channel by a colour.
fn tinted(source: &Source, color: [f32; 3]) -> Source {
    let times = |list: &[f32]| color.iter().map(|part| part * list[0]).collect();
    Source {
        channels: vec![source.channels[0]; 3],
        scale: times(&source.scale),
        bias: times(&source.bias),
        fallback: times(&source.fallback),
        ..source.clone()
    }
}

/// Splits a texture into its scale, which becomes a factor, and a texture without scale. If there
/// is a bias, or the scale is not in 0..1, the factor is 1 and the texture is unchanged. Emission
/// may have any scale ≥ 0.
fn factored(source: &Source, kind: Kind) -> (Vec3, Source) {
    let largest = if kind == Kind::Light { f32::MAX } else { 1.0 };
    let plain =
        source.bias.iter().all(|&bias| bias == 0.0) && source.scale.iter().all(|scale| (0.0..=largest).contains(scale));
    if !plain {
        return (Vec3::ONE, source.clone());
    }
    let at = |k: usize| source.scale.get(k).or(source.scale.first()).copied().unwrap_or(1.0);
    let factor = Vec3::new(at(0), at(1), at(2));
    (factor, Source { scale: vec![1.0; source.scale.len()], ..source.clone() })
}

/// Converts a colour to one number, for opacity: a constant to its luminance, a texture to its
/// first component.
pub(crate) fn grey(value: &Value<3>) -> Value<1> {
    match value {
        Value::Constant(color) => Value::Constant([luminance(*color)]),
        Value::Texture(source) => {
            let first = |list: &[f32]| list.iter().take(1).copied().collect();
            Value::Texture(Source {
                channels: source.channels.iter().take(1).copied().collect(),
                scale: first(&source.scale),
                bias: first(&source.bias),
                fallback: first(&source.fallback),
                ..source.clone()
            })
        }
        Value::Colors => Value::Constant([1.0]),
    }
}
