//! Converts shader textures to textures of the scene.
//!
//! A slot of a [`Material`](lumistack_scene::Material) reads fixed channels in a fixed encoding. A
//! USD shader may read any channel of any picture, with scale and bias.
//!
//! The slot uses the codes of the picture if all channels are where the slot reads them, unscaled,
//! and in the slot's encoding. Otherwise a new picture is computed (baked): v = scale · texel +
//! bias per channel, in linear light, then encoded for the slot. USD's colour space "auto" is sRGB
//! for 8-bit pictures in slots of colour, and raw elsewhere.

use std::collections::HashMap;
use std::path::Path;
use std::rc::Rc;

use glam::{Affine2, Vec2};
use lumistack_core::Task;
use lumistack_core::colour::{srgb_code, srgb_decode, srgb_encode};
use lumistack_scene::{Filter, Image, Pixels, Texture, TextureUse, Wrap};
use serde::Deserialize;

use crate::package::{Array, Package};
use crate::picture::{Picture, Texels};

/// A shader's use of a picture. Component k is scale\[k\] · texel\[channels\[k\]\] + bias\[k\].
#[derive(Clone, Debug, Deserialize, PartialEq)]
pub(crate) struct Source {
    pub(crate) image: usize,
    pub(crate) channels: Vec<usize>,
    pub(crate) scale: Vec<f32>,
    pub(crate) bias: Vec<f32>,
    /// Value of each component if the picture cannot be read.
    pub(crate) fallback: Vec<f32>,
    /// Rules for coordinates outside 0..1, for u and for v: `repeat`, `clamp`, `mirror` or `black`.
    pub(crate) wrap: [String; 2],
    pub(crate) color_space: String,
    /// Name of the primvar with the texture coordinates.
    pub(crate) primvar: String,
    /// Affine map of the texture coordinates: u' = t₀ u + t₂ v + t₄, v' = t₁ u + t₃ v + t₅, where v
    /// points up.
    pub(crate) transform: [f32; 6],
}

impl Source {
    /// Returns true if the source has one to four channels with indices below 4, lists of this
    /// length, and finite numbers.
    pub(crate) fn is_sound(&self) -> bool {
        let count = self.channels.len();
        let finite = |list: &[f32]| list.iter().all(|value| value.is_finite());
        (1..=4).contains(&count)
            && self.channels.iter().all(|&channel| channel < 4)
            && [&self.scale, &self.bias, &self.fallback].iter().all(|list| list.len() == count && finite(list))
            && finite(&self.transform)
    }

    /// Returns a source with the unchanged colours of a picture.
    pub(crate) fn plain(image: usize) -> Self {
        Self {
            image,
            channels: vec![0, 1, 2],
            scale: vec![1.0; 3],
            bias: vec![0.0; 3],
            fallback: vec![0.0; 3],
            wrap: ["repeat".into(), "clamp".into()],
            color_space: "auto".into(),
            primvar: "st".into(),
            transform: Affine2::IDENTITY.to_cols_array(),
        }
    }

    /// Maps texture coordinates of the scene's mesh, in which v points down, to coordinates of the
    /// texture.
    fn texture_from_mesh(&self) -> Affine2 {
        let flip = Affine2::from_cols(Vec2::X, Vec2::NEG_Y, Vec2::Y);
        flip * Affine2::from_cols_array(&self.transform) * flip
    }
}

/// The values of one channel of a texture that a material reads.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Channel<'s> {
    /// The scene does not read this channel, so its value does not matter.
    Unused,
    /// The channel has the same value at all texels.
    Constant(f32),
    /// The channel is the component with this index of a shader's texture.
    Component(&'s Source, usize),
}

/// The meaning of the values of a texture that a material reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Kind {
    /// Reflectance 0..1: RGB is sRGB-encoded, alpha is linear.
    Color,
    /// Radiance: as `Color`, but values above 1 are kept.
    Light,
    /// Linear values, 0..1.
    Data,
    /// Linear values −1..1, stored as (1 + n)/2.
    Normal,
}

/// An image of a scene package, in the form in which the walker (Python) writes it.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
struct Entry {
    place: String,
    name: String,
    path: Option<String>,
    bytes: Option<Array>,
}

/// The textures of the scene that were made so far, and the pictures that they use.
pub(crate) struct Textures<'a> {
    package: &'a Package<'a>,
    task: Task<'a>,
    pictures: HashMap<usize, Option<Rc<Picture>>>,
    made: HashMap<String, usize>,
    pub(crate) images: Vec<Image>,
    pub(crate) textures: Vec<Texture>,
}

impl<'a> Textures<'a> {
    pub(crate) fn new(package: &'a Package<'a>, task: Task<'a>) -> Self {
        let (pictures, made) = Default::default();
        Self { package, task, pictures, made, images: Vec::new(), textures: Vec::new() }
    }

    /// Returns a picture of the scene package, which is decoded at first use; `None`, after a
    /// warning, if it cannot be read.
    pub(crate) fn picture(&mut self, image: usize) -> Option<Rc<Picture>> {
        if let Some(known) = self.pictures.get(&image) {
            return known.clone();
        }
        let entry = self.package.header.images.get(image).cloned();
        let entry: Entry = entry.and_then(|entry| serde_json::from_value(entry).ok()).unwrap_or_default();
        let read = match (&entry.path, &entry.bytes) {
            (Some(path), _) => lumistack_files::read(Path::new(path))
                .map_err(|error| format!("not readable ({error})"))
                .and_then(|bytes| Picture::decode(path, &bytes)),
            (None, Some(array)) => match self.package.buffers.get(array.buffer) {
                Some(bytes) => Picture::decode(&entry.name, bytes),
                None => Err("in no buffer of the package".into()),
            },
            (None, None) => Err("neither a file nor data of the package".into()),
        };
        let picture = match read {
            Ok(picture) => Some(Rc::new(picture)),
            Err(reason) => {
                let message = format!("{} is {reason}; the texture's fallback value is used", entry.name);
                self.task.warn(&entry.place, message);
                None
            }
        };
        self.pictures.insert(image, picture.clone());
        picture
    }

    fn name(&self, image: usize) -> String {
        let entry = self.package.header.images.get(image);
        let name = entry.and_then(|entry| entry.get("name")).and_then(|name| name.as_str());
        name.unwrap_or("picture").to_owned()
    }

    /// Returns a texture with these channels, for the coordinate set `uv_set`. `None` if no channel
    /// has a picture, or if a picture cannot be read; the slot then has no texture. All channels
    /// use the primvar, transform and wrap rules of the first component; other channels that differ
    /// cause a warning.
    pub(crate) fn slot(
        &mut self,
        channels: [Channel<'_>; 4],
        kind: Kind,
        uv_set: usize,
        place: &str,
    ) -> Option<TextureUse> {
        let first = channels.iter().find_map(|channel| match channel {
            Channel::Component(source, _) => Some(*source),
            _ => None,
        })?;
        // Decode every picture. Warn if channels differ in primvar, transform or wrap rules.
        for channel in &channels {
            if let Channel::Component(source, _) = channel {
                self.picture(source.image)?;
                let differs =
                    source.primvar != first.primvar || source.transform != first.transform || source.wrap != first.wrap;
                if differs {
                    let message = "a texture whose channels have different placements is not supported; all channels get the placement of the first one";
                    self.task.warn(place, message);
                }
            }
        }
        let image = self.image(channels, kind)?;
        // Set the rules for coordinates outside 0..1, and the filter.
        let [wrap_u, wrap_v] = first.wrap.each_ref().map(|mode| match mode.as_str() {
            "clamp" => Wrap::ClampToEdge,
            "mirror" => Wrap::MirroredRepeat,
            "black" => {
                self.task.warn(place, "the wrap mode black of a texture is not supported; outside of the picture the colours of the picture's edge are used");
                Wrap::ClampToEdge
            }
            _ => Wrap::Repeat,
        });
        let texture = Texture { image, wrap_u, wrap_v, filter: Filter::Linear };
        let index = self.textures.iter().position(|known| *known == texture).unwrap_or_else(|| {
            self.textures.push(texture);
            self.textures.len() - 1
        });
        Some(TextureUse { texture: index, uv_set, texture_from_mesh: first.texture_from_mesh() })
    }

    /// Returns the index of the image with these channels. Equal requests share an image.
    fn image(&mut self, channels: [Channel<'_>; 4], kind: Kind) -> Option<usize> {
        let key = format!(
            "{kind:?} {:?}",
            channels.map(|channel| match channel {
                Channel::Unused => None,
                Channel::Constant(value) => Some((usize::MAX, 0, value.to_bits(), 0, "")),
                Channel::Component(s, k) => {
                    Some((s.image, s.channels[k], s.scale[k].to_bits(), s.bias[k].to_bits(), s.color_space.as_str()))
                }
            })
        );
        if let Some(&known) = self.made.get(&key) {
            return Some(known);
        }
        // Collect the pictures of all channels.
        let mut names: Vec<String> = Vec::new();
        let mut pictures: Vec<Option<Rc<Picture>>> = Vec::new();
        for channel in channels {
            pictures.push(match channel {
                Channel::Component(source, _) => {
                    let name = self.name(source.image);
                    if !names.contains(&name) {
                        names.push(name);
                    }
                    Some(self.picture(source.image)?)
                }
                _ => None,
            });
        }
        // Use the codes of the picture if they fit the slot as they are. Otherwise compute a new
        // picture.
        let made = match direct(&channels, kind, &pictures) {
            Some(pixels) => {
                let picture = pictures.iter().flatten().next()?;
                Image { name: names.join(" + "), width: picture.width, height: picture.height, pixels }
            }
            None => {
                let readers: Vec<Reader<'_>> = channels
                    .iter()
                    .zip(&pictures)
                    .map(|(channel, picture)| Reader::new(*channel, picture.as_deref(), kind, self.task))
                    .collect();
                let mut image = bake(&readers, kind);
                image.name = names.join(" + ");
                image
            }
        };
        self.images.push(made);
        self.made.insert(key, self.images.len() - 1);
        Some(self.images.len() - 1)
    }

    /// Converts a picture to linear radiance, for the environment. Returns the index of the image,
    /// or `None` if the picture cannot be read.
    pub(crate) fn radiance(&mut self, image: usize) -> Option<usize> {
        let source = Source::plain(image);
        let key = format!("radiance {image}");
        if let Some(&known) = self.made.get(&key) {
            return Some(known);
        }
        let picture = self.picture(image)?;
        let readers =
            [0, 1, 2].map(|k| Reader::new(Channel::Component(&source, k), Some(&*picture), Kind::Light, self.task));
        let texel = |i: usize| {
            readers
                .each_ref()
                .map(|reader| reader.at(i % picture.width, i / picture.width, picture.width, picture.height).max(0.0))
        };
        let pixels = Pixels::RgbF32((0..picture.width * picture.height).map(texel).collect());
        self.images.push(Image { name: self.name(image), width: picture.width, height: picture.height, pixels });
        self.made.insert(key, self.images.len() - 1);
        Some(self.images.len() - 1)
    }
}

/// Colour space of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Space {
    Srgb,
    Linear,
    /// Linear, with the primaries of ACEScg.
    AcesCg,
}

impl Space {
    /// Finds the colour space with this name. `None` if the name is unknown.
    fn of(name: &str, kind: Kind, picture: &Picture) -> Option<Self> {
        let data = matches!(kind, Kind::Data | Kind::Normal);
        match name {
            "auto" | "" if data => Some(Self::Linear),
            "auto" | "" => Some(if matches!(picture.texels, Texels::Codes8(_)) { Self::Srgb } else { Self::Linear }),
            "sRGB" | "srgb_texture" | "srgb_rec709_scene" | "srgb_rec709_display" | "g22_rec709" | "gamma22" => {
                Some(Self::Srgb)
            }
            "raw" | "none" | "data" | "linear" | "lin_rec709" | "lin_rec709_scene" | "lin_srgb" => Some(Self::Linear),
            "acescg" | "ACEScg" | "lin_ap1" | "lin_ap1_scene" => Some(Self::AcesCg),
            _ => None,
        }
    }
}

/// Converts ACEScg to linear Rec. 709: from the primaries AP1, with the white adapted to D65 by
/// Bradford's method.
const REC709_FROM_ACESCG: [[f32; 3]; 3] =
    [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]];

/// Reads the values of one channel of a texture.
struct Reader<'p> {
    picture: Option<(&'p Picture, Space)>,
    channel: usize,
    scale: f32,
    bias: f32,
}

impl<'p> Reader<'p> {
    fn new(channel: Channel<'_>, picture: Option<&'p Picture>, kind: Kind, task: Task<'_>) -> Self {
        match (channel, picture) {
            (Channel::Component(source, k), Some(picture)) => {
                let space = Space::of(&source.color_space, kind, picture).unwrap_or_else(|| {
                    let message = format!(
                        "the colour space {} of a texture is unknown; linear Rec. 709 is used",
                        source.color_space
                    );
                    task.warn("/textures", message);
                    Space::Linear
                });
                Self {
                    picture: Some((picture, space)),
                    channel: source.channels[k],
                    scale: source.scale[k],
                    bias: source.bias[k],
                }
            }
            (Channel::Constant(value), _) => Self { picture: None, channel: 0, scale: 0.0, bias: value },
            _ => Self { picture: None, channel: 0, scale: 0.0, bias: 1.0 },
        }
    }

    /// Returns the linear value at a texel of a grid that covers the picture. The grid may have
    /// another size than the picture.
    fn at(&self, x: usize, y: usize, width: usize, height: usize) -> f32 {
        let Some((picture, space)) = self.picture else { return self.bias };
        let texel = if (picture.width, picture.height) == (width, height) {
            linear(picture.texel(y * width + x), space)
        } else {
            let place = |i: usize, count: usize, size: usize| {
                let at = ((i as f32 + 0.5) / count as f32 * size as f32 - 0.5).clamp(0.0, (size - 1) as f32);
                (at as usize, (at as usize + 1).min(size - 1), at.fract())
            };
            let ((x0, x1, fx), (y0, y1, fy)) = (place(x, width, picture.width), place(y, height, picture.height));
            let texel = |x: usize, y: usize| linear(picture.texel(y * picture.width + x), space);
            let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
            std::array::from_fn(|k| (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy)
        };
        self.scale * texel[self.channel] + self.bias
    }
}

fn linear([r, g, b, a]: [f32; 4], space: Space) -> [f32; 4] {
    match space {
        Space::Linear => [r, g, b, a],
        Space::Srgb => [srgb_decode(r), srgb_decode(g), srgb_decode(b), a],
        Space::AcesCg => {
            let [r, g, b] = REC709_FROM_ACESCG.map(|row| row[0] * r + row[1] * g + row[2] * b);
            [r, g, b, a]
        }
    }
}

/// Returns the codes of the decoded picture, if every channel is where the slot reads it, unscaled,
/// and in the slot's encoding. `None` otherwise, and for pictures of floats.
fn direct(channels: &[Channel<'_>; 4], kind: Kind, pictures: &[Option<Rc<Picture>>]) -> Option<Pixels> {
    let picture = pictures.iter().flatten().next()?;
    for (place, channel) in channels.iter().enumerate() {
        let fits = match channel {
            Channel::Unused => true,
            Channel::Constant(_) => false,
            Channel::Component(source, k) => {
                let own = match (kind, place) {
                    (Kind::Data, _) | (_, 3) => Space::Linear,
                    (Kind::Normal, _) => Space::Linear,
                    (Kind::Color | Kind::Light, _) => Space::Srgb,
                };
                let space = Space::of(&source.color_space, kind, picture)?;
                let (scale, bias) = if kind == Kind::Normal { (2.0, -1.0) } else { (1.0, 0.0) };
                source.channels[*k] == place
                    && (source.scale[*k], source.bias[*k]) == (scale, bias)
                    && (space == own || place == 3)
                    && pictures[place].as_ref().is_some_and(|other| Rc::ptr_eq(other, picture))
            }
        };
        if !fits {
            return None;
        }
    }
    match &picture.texels {
        Texels::Codes8(texels) => Some(Pixels::Rgba8(texels.clone())),
        Texels::Codes16(texels) => Some(Pixels::Rgba16(texels.clone())),
        Texels::Float(_) => None,
    }
}

/// Computes the image of a texture from its channels. The image is as wide as the widest picture
/// and as high as the highest picture.
fn bake(readers: &[Reader<'_>], kind: Kind) -> Image {
    let sizes = readers.iter().filter_map(|reader| reader.picture);
    let (width, height) =
        sizes.fold((1, 1), |(width, height), (picture, _)| (width.max(picture.width), height.max(picture.height)));
    let values = (0..width * height).map(|i| {
        let value = |reader: &Reader<'_>| reader.at(i % width, i / width, width, height);
        [value(&readers[0]), value(&readers[1]), value(&readers[2]), value(&readers[3])]
    });
    // Find the depth of the sources, and whether a scale or bias may raise values above 1.
    let all: Vec<&Texels> = readers.iter().filter_map(|reader| Some(&reader.picture?.0.texels)).collect();
    let is_float = all.iter().any(|texels| matches!(texels, Texels::Float(_)));
    let is_deep = all.iter().any(|texels| !matches!(texels, Texels::Codes8(_)));
    let scaled = readers.iter().any(|reader| reader.picture.is_some() && (reader.scale > 1.0 || reader.bias != 0.0));
    let pixels = match kind {
        // lights do not read alpha, so leave it out
        Kind::Light if is_float || scaled => {
            Pixels::RgbF32(values.map(|[r, g, b, _]| [r, g, b].map(|value| value.max(0.0))).collect())
        }
        Kind::Color | Kind::Light if is_deep => Pixels::Rgba16(
            values
                .map(|[r, g, b, a]| [code16(srgb_encode(r)), code16(srgb_encode(g)), code16(srgb_encode(b)), code16(a)])
                .collect(),
        ),
        Kind::Color | Kind::Light => {
            Pixels::Rgba8(values.map(|[r, g, b, a]| [srgb_code(r), srgb_code(g), srgb_code(b), code8(a)]).collect())
        }
        Kind::Normal => Pixels::Rgba16(
            values
                .map(|[x, y, z, _]| {
                    let n = glam::Vec3::new(x, y, z);
                    // a scaled vector may be longer than 1, but only its direction matters
                    let n = if n.length() > 1.0 { n.normalize() } else { n };
                    [code16(0.5 + 0.5 * n.x), code16(0.5 + 0.5 * n.y), code16(0.5 + 0.5 * n.z), u16::MAX]
                })
                .collect(),
        ),
        Kind::Data if is_deep => Pixels::Rgba16(values.map(|texel| texel.map(code16)).collect()),
        Kind::Data => Pixels::Rgba8(values.map(|texel| texel.map(code8)).collect()),
    };
    Image { name: String::new(), width, height, pixels }
}

fn code8(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

fn code16(value: f32) -> u16 {
    (value.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16
}
