//! Filtered texture lookups: trilinear, in image pyramids.
//!
//! The finest level is the scene's own image. The coarser levels are made here, by averaging 2 × 2
//! texels (fewer at odd edges) in linear light. Colours keep the depth of their image: 8-bit codes
//! stay 8-bit codes, and 16-bit codes become linear 16-bit values.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use glam::{Vec2, Vec4};
use lumistack_core::colour::{SrgbCodes, srgb_codes, srgb_decode};
use lumistack_scene::{Filter, Image, Pixels, Scene, Texture, TextureUse, Wrap};

/// Encoding of the values that a texture slot reads from an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Encoding {
    /// RGB is sRGB-encoded, alpha linear.
    Srgb,
    /// All channels are linear.
    Linear,
}

/// The pyramids of all images that the scene's materials use.
pub(crate) struct Textures {
    scene: Arc<Scene>,
    /// Coarser levels of each pyramid, level 1 first.
    pyramids: Vec<Vec<Level>>,
    /// Index of the pyramid of an image with an encoding.
    by_image: HashMap<(usize, Encoding), usize>,
}

/// One texture slot of a material, ready for lookups.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    pub(crate) source: TextureUse,
    /// Texels of the finest level per length in the mesh's texture space: the root of the ratio of
    /// the areas.
    pub(crate) texels_per_uv: f32,
    texture: Texture,
    pyramid: usize,
    encoding: Encoding,
}

struct Level {
    width: usize,
    height: usize,
    texels: Texels,
}

enum Texels {
    Codes8(Vec<[u8; 4]>),
    Linear16(Vec<[u16; 4]>),
    Float(Vec<[f32; 4]>),
}

impl Textures {
    /// Prepares textures without pyramids; [`slot`](Self::slot) builds the pyramids at first use.
    pub(crate) fn new(scene: Arc<Scene>) -> Self {
        Self { scene, pyramids: Vec::new(), by_image: HashMap::new() }
    }

    /// Prepares a material's texture.
    pub(crate) fn slot(&mut self, source: TextureUse, encoding: Encoding) -> Slot {
        let texture = self.scene.textures[source.texture];
        let image = &self.scene.images[texture.image];
        let pyramid = *self.by_image.entry((texture.image, encoding)).or_insert_with(|| {
            self.pyramids.push(pyramid(image, encoding));
            self.pyramids.len() - 1
        });
        let texels = (image.width * image.height) as f32;
        let texels_per_uv = (source.texture_from_mesh.matrix2.determinant() * texels).abs().sqrt();
        Slot { source, texels_per_uv, texture, pyramid, encoding }
    }

    /// Returns the bytes of the coarser levels.
    pub(crate) fn bytes(&self) -> usize {
        let level = |level: &Level| match &level.texels {
            Texels::Codes8(texels) => size_of_val(texels.as_slice()),
            Texels::Linear16(texels) => size_of_val(texels.as_slice()),
            Texels::Float(texels) => size_of_val(texels.as_slice()),
        };
        self.pyramids.iter().flatten().map(level).sum()
    }

    /// Returns the texture at the mesh coordinates `uv`, averaged over a footprint whose width is
    /// `texels_wide` texels of the finest level.
    pub(crate) fn lookup(&self, slot: &Slot, uv: Vec2, texels_wide: f32) -> Vec4 {
        let uv = slot.source.texture_from_mesh.transform_point2(uv);
        let coarser = &self.pyramids[slot.pyramid];
        let level = rough_log2(texels_wide.max(1.0)).min(coarser.len() as f32);
        let lower = level as usize;
        let fine = self.level(slot, lower, uv);
        let share = level - lower as f32;
        if share <= 0.0 || lower >= coarser.len() { fine } else { fine.lerp(self.level(slot, lower + 1, uv), share) }
    }

    fn level(&self, slot: &Slot, level: usize, uv: Vec2) -> Vec4 {
        if level > 0 {
            let level = &self.pyramids[slot.pyramid][level - 1];
            let fetch = |x: usize, y: usize| level.fetch(x, y, slot.encoding);
            return interpolate(&slot.texture, level.width, level.height, uv, Filter::Linear, fetch);
        }
        let image = &self.scene.images[slot.texture.image];
        let fetch = |x: usize, y: usize| fetch(image, y * image.width + x, slot.encoding);
        interpolate(&slot.texture, image.width, image.height, uv, slot.texture.filter, fetch)
    }
}

impl Level {
    #[inline]
    fn fetch(&self, x: usize, y: usize, encoding: Encoding) -> Vec4 {
        let index = y * self.width + x;
        match &self.texels {
            Texels::Codes8(texels) => decode8(texels[index], encoding),
            Texels::Linear16(texels) => Vec4::from_array(texels[index].map(|code| f32::from(code) / 65535.0)),
            Texels::Float(texels) => Vec4::from_array(texels[index]),
        }
    }
}

/// Returns one texel of an image, in linear values.
#[inline]
fn fetch(image: &Image, index: usize, encoding: Encoding) -> Vec4 {
    match &image.pixels {
        Pixels::Rgba8(texels) => decode8(texels[index], encoding),
        Pixels::Rgba16(texels) => {
            let [r, g, b, a] = texels[index].map(|code| f32::from(code) / 65535.0);
            match encoding {
                Encoding::Srgb => Vec4::new(srgb_decode(r), srgb_decode(g), srgb_decode(b), a),
                Encoding::Linear => Vec4::new(r, g, b, a),
            }
        }
        Pixels::RgbF32(texels) => {
            let [r, g, b] = texels[index];
            Vec4::new(r, g, b, 1.0)
        }
    }
}

#[inline]
fn decode8(texel: [u8; 4], encoding: Encoding) -> Vec4 {
    let [r, g, b, a] = texel;
    match encoding {
        Encoding::Srgb => {
            let table = srgb_table();
            Vec4::new(table[r as usize], table[g as usize], table[b as usize], f32::from(a) / 255.0)
        }
        Encoding::Linear => Vec4::from_array(texel.map(f32::from)) / 255.0,
    }
}

fn srgb_table() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|code| srgb_decode(code as f32 / 255.0)))
}

/// Looks a texel up, bilinear or nearest; the centres of texels are at half-integers.
#[inline]
fn interpolate(
    texture: &Texture,
    width: usize,
    height: usize,
    uv: Vec2,
    filter: Filter,
    fetch: impl Fn(usize, usize) -> Vec4,
) -> Vec4 {
    if filter == Filter::Nearest {
        let (x, _, _) = neighbours(uv.x, width, texture.wrap_u, 0.0);
        let (y, _, _) = neighbours(uv.y, height, texture.wrap_v, 0.0);
        return fetch(x, y);
    }
    let (left, right, fx) = neighbours(uv.x, width, texture.wrap_u, 0.5);
    let (top, bottom, fy) = neighbours(uv.y, height, texture.wrap_v, 0.5);
    fetch(left, top).lerp(fetch(right, top), fx).lerp(fetch(left, bottom).lerp(fetch(right, bottom), fx), fy)
}

/// Returns the two texels on either side of a position, and the weight of the second. The position
/// is `coordinate` (0..1 over the texture) times `size`, less `shift`, in texels.
#[inline]
fn neighbours(coordinate: f32, size: usize, wrap: Wrap, shift: f32) -> (usize, usize, f32) {
    // The coordinate is folded into one period (two if mirrored) before it is scaled. Then
    // comparisons instead of divisions find the texels.
    let folded = match wrap {
        Wrap::Repeat => coordinate - floor(coordinate),
        Wrap::MirroredRepeat => {
            let folded = coordinate - 2.0 * floor(0.5 * coordinate);
            if folded > 1.0 { 2.0 - folded } else { folded }
        }
        Wrap::ClampToEdge => coordinate.clamp(0.0, 1.0),
    };
    let x = folded * size as f32 - shift;
    let below = floor(x);
    let share = x - below;
    let last = size as i32 - 1;
    let index = (below as i32).clamp(-1, last);
    let (first, second) = if wrap == Wrap::Repeat {
        (if index < 0 { last } else { index }, if index >= last { 0 } else { index + 1 })
    } else {
        (index.max(0), (index + 1).min(last))
    };
    (first as usize, second as usize, share)
}

/// Returns the floor of x without a library call, exact for |x| < 2³¹. The result for a larger |x|
/// has the right sign, so that it becomes texel 0 or the last texel.
#[inline]
fn floor(x: f32) -> f32 {
    let whole = x as i32 as f32;
    if whole > x { whole - 1.0 } else { whole }
}

/// Returns log₂ of a number ≥ 1 to within 0.09. The result is linear between powers of two, and
/// exact at powers of two.
#[inline]
fn rough_log2(x: f32) -> f32 {
    x.to_bits() as f32 * (1.0 / (1u32 << 23) as f32) - 127.0
}

/// Makes the levels 1, 2, ... of an image's pyramid, down to a single texel.
fn pyramid(image: &Image, encoding: Encoding) -> Vec<Level> {
    let mut levels: Vec<Level> = Vec::new();
    loop {
        let (width, height) = levels.last().map_or((image.width, image.height), |level| (level.width, level.height));
        if width == 1 && height == 1 {
            return levels;
        }
        levels.push(match levels.last() {
            Some(finer) => halved(&image.pixels, [width, height], encoding, |x, y| finer.fetch(x, y, encoding)),
            None => halved(&image.pixels, [width, height], encoding, |x, y| fetch(image, y * width + x, encoding)),
        });
    }
}

/// Returns the averages of 2 × 2 texels of a level, or of fewer texels at an odd edge. The result
/// has texels of the same kind as `pixels`, the pixels of the image.
fn halved(
    pixels: &Pixels,
    [width, height]: [usize; 2],
    encoding: Encoding,
    fetch: impl Fn(usize, usize) -> Vec4,
) -> Level {
    let average = |x: usize, y: usize| {
        let (x, y) = (2 * x, 2 * y);
        let (x1, y1) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
        0.25 * (fetch(x, y) + fetch(x1, y) + fetch(x, y1) + fetch(x1, y1))
    };
    let codes = srgb_codes();
    let (width, height) = (width.div_ceil(2), height.div_ceil(2));
    let texels = match pixels {
        Pixels::Rgba8(_) => Texels::Codes8(by_rows([width, height], |x, y| encode8(average(x, y), encoding, codes))),
        Pixels::Rgba16(_) => Texels::Linear16(by_rows([width, height], |x, y| {
            average(x, y).to_array().map(|c| (c * 65535.0 + 0.5) as u16)
        })),
        Pixels::RgbF32(_) => Texels::Float(by_rows([width, height], |x, y| average(x, y).to_array())),
    };
    Level { width, height, texels }
}

/// Evaluates a function at every texel, row by row.
fn by_rows<T>([width, height]: [usize; 2], texel: impl Fn(usize, usize) -> T) -> Vec<T> {
    // Browsers first compile a module to slow code, and later to better code. A running function
    // keeps its slow code until the next call. So each row is a call.
    #[inline(never)]
    fn add_row<T>(texels: &mut Vec<T>, width: usize, texel: impl Fn(usize) -> T) {
        texels.extend((0..width).map(texel));
    }
    let mut texels = Vec::with_capacity(width * height);
    (0..height).for_each(|y| add_row(&mut texels, width, |x| texel(x, y)));
    texels
}

fn encode8(value: Vec4, encoding: Encoding, codes: &SrgbCodes) -> [u8; 4] {
    let [r, g, b, a] = value.to_array();
    let linear = |v: f32| (v * 255.0 + 0.5) as u8;
    match encoding {
        Encoding::Srgb => [codes.code(r), codes.code(g), codes.code(b), linear(a)],
        Encoding::Linear => [linear(r), linear(g), linear(b), linear(a)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: usize, height: usize, texel: impl Fn(usize, usize) -> [u8; 4]) -> Image {
        let pixels = (0..width * height).map(|i| texel(i % width, i / width)).collect();
        Image { name: "t".into(), width, height, pixels: Pixels::Rgba8(pixels) }
    }

    #[test]
    fn a_checkerboard_averages_to_half_in_linear_light() {
        let board = image(6, 4, |x, y| if (x + y) % 2 == 0 { [255; 4] } else { [0; 4] });
        for (encoding, expected) in [(Encoding::Srgb, 188), (Encoding::Linear, 128)] {
            let levels = pyramid(&board, encoding);
            let sizes: Vec<_> = levels.iter().map(|l| (l.width, l.height)).collect();
            assert_eq!(sizes, [(3, 2), (2, 1), (1, 1)]);
            let Texels::Codes8(texels) = &levels[2].texels else { panic!("8-bit image") };
            assert_eq!(texels[0], [expected, expected, expected, 128]);
        }
    }

    #[test]
    fn wrapping_modes_fold_the_plane() {
        let nearest = |texels: [f32; 4], wrap| texels.map(|x| neighbours((x + 0.5) / 4.0, 4, wrap, 0.0).0);
        assert_eq!(nearest([-1.0, 0.0, 4.0, 9.0], Wrap::Repeat), [3, 0, 0, 1]);
        assert_eq!(nearest([-1.0, 3.0, 4.0, 7.0], Wrap::MirroredRepeat), [0, 3, 3, 0]);
        assert_eq!(nearest([-9.0, 0.0, 3.0, 9.0], Wrap::ClampToEdge), [0, 0, 3, 3]);
        for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
            for x in
                [-1.0, 0.0, 1.0, 2.0, 0.5, f32::MAX, -f32::MAX, f32::NAN, f32::INFINITY, 1.0 - f32::EPSILON, -1e-30]
            {
                let (first, second, _) = neighbours(x, 4, wrap, 0.5);
                assert!(first < 4 && second < 4, "{x} {wrap:?}");
            }
        }
        // with repetition, the last texel is to the left of the first texel
        assert_eq!(neighbours(0.0, 4, Wrap::Repeat, 0.5), (3, 0, 0.5));
        assert_eq!(neighbours(1.0, 4, Wrap::MirroredRepeat, 0.5), (3, 3, 0.5));
    }

    #[test]
    fn bilinear_interpolation_stands_at_texel_centres() {
        let texture =
            Texture { image: 0, wrap_u: Wrap::ClampToEdge, wrap_v: Wrap::ClampToEdge, filter: Filter::Linear };
        let fetch = |x: usize, y: usize| Vec4::new(x as f32, y as f32, 0.0, 1.0);
        let at = |u: f32, v: f32, filter| interpolate(&texture, 4, 2, Vec2::new(u, v), filter, fetch);
        assert_eq!(at(0.375, 0.25, Filter::Linear), Vec4::new(1.0, 0.0, 0.0, 1.0));
        assert_eq!(at(0.5, 0.5, Filter::Linear), Vec4::new(1.5, 0.5, 0.0, 1.0));
        assert_eq!(at(0.49, 0.51, Filter::Nearest), Vec4::new(1.0, 1.0, 0.0, 1.0));
    }
}
