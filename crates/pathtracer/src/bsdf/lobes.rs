//! The table of lobes: every lobe is a file next to this one, and a row of the table.

use glam::{Vec3, Vec4};
use lumistack_scene::{Material, TextureUse};

use super::coat::Coat;
use super::diffuse::Diffuse;
use super::glass::Glass;
use super::lobe::{Facet, Layer, Light, Lobe, Sample, Surface};
use super::reflection::Reflection;
use super::sheen::Sheen;
use super::thin::Thin;
use crate::texture::{Encoding, Slot};

/// Makes the layers from the top down. The last layer of the list is the topmost.
macro_rules! layers_from_the_top {
    ($parameters:ident, $surface:ident, $below:ident;) => {};
    ($parameters:ident, $surface:ident, $below:ident; $layer:ident: $Layer:ident, $($above:tt)*) => {
        layers_from_the_top!($parameters, $surface, $below; $($above)*);
        let $layer = $parameters.and_then(|all| all.$layer.as_ref()).map(|own| $Layer::new(own, $surface, &mut $below));
    };
}

/// Makes the types and functions of all lobes. A lobe's index is its position in the list. Random
/// numbers select lobes by their chances, in this order.
macro_rules! lobes {
    (base { $($base:ident: $Base:ident,)* } layers { $($layer:ident: $Layer:ident,)* }) => {
        /// The lobes of a point.
        pub(crate) struct Lobes {
            $($base: Option<$Base>,)*
            $($layer: Option<$Layer>,)*
        }

        /// Number of lobes.
        pub(crate) const LOBES: usize = [$(stringify!($base),)* $(stringify!($layer),)*].len();

        /// Parameters of the layers at a point.
        #[derive(Clone, Copy, Debug, Default)]
        pub(crate) struct Layers {
            $(pub(crate) $layer: Option<<$Layer as Layer>::Parameters>,)*
        }

        /// Textures of the layers.
        pub(crate) struct LayerSlots {
            $(pub(crate) $layer: <$Layer as Layer>::Slots,)*
        }

        impl LayerSlots {
            /// Prepares the textures of all layers; `slot` prepares one texture.
            pub(crate) fn new(
                material: &Material,
                slot: &mut impl FnMut(&Option<TextureUse>, Encoding) -> Option<Slot>,
            ) -> Self {
                Self { $($layer: $Layer::slots(material, slot),)* }
            }
        }

        impl Layers {
            /// Returns true if the material names any layer, even if the layer has no effect.
            pub(crate) fn are_named(material: &Material) -> bool {
                false $(|| $Layer::is_named(material))*
            }

            /// Returns true if any layer has an effect.
            pub(crate) fn are_seen(material: &Material) -> bool {
                false $(|| $Layer::is_seen(material))*
            }

            /// Looks the layers' parameters up at a point; `texel` returns 1 if there is no
            /// texture.
            pub(crate) fn new(
                material: &Material,
                slots: &LayerSlots,
                texel: impl Fn(&Option<Slot>) -> Vec4,
            ) -> Self {
                Self { $($layer: $Layer::parameters(material, &slots.$layer, &texel),)* }
            }

            /// Returns the fraction of the light that passes from the base to a viewer at this
            /// cosine.
            pub(crate) fn passed(&self, cosine: f32) -> f32 {
                let mut passed = 1.0;
                $(if let Some(own) = &self.$layer { passed *= $Layer::passed(own, cosine); })*
                passed
            }
        }

        impl Lobes {
            /// Makes the lobes at a point. `layers` has the parameters of the layers. It is `None`
            /// if the appearance has no extras, or if the viewer is inside a solid.
            #[inline]
            pub(crate) fn new(surface: &Surface<'_>, layers: Option<&Layers>) -> Self {
                let mut below = 1.0;
                layers_from_the_top!(layers, surface, below; $($layer: $Layer,)*);
                Self { $($base: $Base::new(surface, below),)* $($layer,)* }
            }

            /// Returns the albedo of every lobe.
            #[inline]
            pub(crate) fn albedos(&self) -> [f32; LOBES] {
                [$(self.$base.as_ref().map_or(0.0, Lobe::albedo),)* $(self.$layer.as_ref().map_or(0.0, Lobe::albedo),)*]
            }

            /// Returns two lists over the lobes: true if the lobe can be evaluated, and true if it
            /// also transmits light from behind.
            #[inline]
            pub(crate) fn rough(&self, facet: &Facet) -> [[bool; LOBES]; 2] {
                let rough = [
                    $(self.$base.as_ref().is_some_and(|lobe| lobe.is_rough(facet)),)*
                    $(self.$layer.as_ref().is_some_and(|lobe| lobe.is_rough(facet)),)*
                ];
                let transmits = [$($Base::TRANSMITS,)* $($Layer::TRANSMITS,)*];
                [rough, std::array::from_fn(|lobe| rough[lobe] && transmits[lobe])]
            }

            /// Returns true if light that crosses the surface enters or leaves a solid.
            #[inline]
            pub(crate) fn refracts(&self) -> bool {
                false $(|| $Base::REFRACTS && self.$base.is_some())* $(|| $Layer::REFRACTS && self.$layer.is_some())*
            }

            /// Returns the fraction of the light that passes without a change of direction.
            pub(crate) fn straight(&self, facet: &Facet) -> Vec3 {
                let mut sum = Vec3::ZERO;
                $(if let Some(lobe) = &self.$base { sum += lobe.straight(facet); })*
                $(if let Some(lobe) = &self.$layer { sum += lobe.straight(facet); })*
                sum
            }

            /// Adds Σ f |cos| to `value`, and Σ chance · density to `pdf`. If `OWN_FRAME` is true,
            /// the sums are over the lobes with their own frame or horizon, otherwise over all
            /// other lobes.
            #[inline]
            pub(crate) fn evaluate<const OWN_FRAME: bool>(
                &self,
                chances: &[f32; LOBES],
                facet: &Facet,
                light: &Light,
                (value, pdf): (&mut Vec3, &mut f32),
            ) {
                let mut chances = chances.iter();
                let mut add = |chance: Option<&f32>, own: (Vec3, f32)| {
                    *value += own.0;
                    *pdf += chance.copied().unwrap_or(0.0) * own.1;
                };
                $(
                    let chance = chances.next();
                    if $Base::OWN_FRAME == OWN_FRAME && let Some(lobe) = &self.$base {
                        add(chance, lobe.evaluate(facet, light));
                    }
                )*
                $(
                    let chance = chances.next();
                    if $Layer::OWN_FRAME == OWN_FRAME && let Some(lobe) = &self.$layer {
                        add(chance, lobe.evaluate(facet, light));
                    }
                )*
            }

            /// Samples a direction of the lobe with the index `chosen`.
            #[inline]
            pub(crate) fn sample(
                &self,
                chosen: usize,
                facet: &Facet,
                chance: f32,
                u: [f32; 2],
                u_fresnel: f32,
            ) -> Option<Sample> {
                let mut lobe = 0..;
                $(if lobe.next() == Some(chosen) { return self.$base.as_ref()?.sample(facet, chance, u, u_fresnel); })*
                $(if lobe.next() == Some(chosen) { return self.$layer.as_ref()?.sample(facet, chance, u, u_fresnel); })*
                None
            }
        }
    };
}

lobes! {
    base {
        reflection: Reflection,
        diffuse: Diffuse,
        thin: Thin,
        glass: Glass,
    }
    // Layers stand in the order from the lowest to the topmost.
    layers {
        sheen: Sheen,
        coat: Coat,
    }
}

impl Lobes {
    /// Returns the lobe that scatters alike to all viewers.
    pub(crate) fn diffuse(&self) -> Option<&Diffuse> {
        self.diffuse.as_ref()
    }
}
