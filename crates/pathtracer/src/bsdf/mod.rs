//! Scattering at a surface: glTF's metallic-roughness model with its extensions. The model
//! conserves energy.
//!
//! The base has the colour c, the metallic fraction m and the transmission t. F is the reflectance
//! of [`fresnel`], K the compensation of [`albedo`], and D V the microfacet term of [`ggx`]:
//!
//! ```text
//! f     = κ f_coat + (1 − κ E_coat(o)) [σ f_fibres + (1 − max(σ) E_fibres(o)) f_base]
//! f_base, opaque or thin-walled:
//!        = m K F(c) D V + (1 − m) [K F(f0) D V + (1 − E_d(o)) ((1 − t) c/π + t c T)]
//! f_base, solid:
//!        = m K F(c) D V + (1 − m) [(1 − t) (K F(f0) D V + (1 − E_d(o)) c/π) + t glass]
//! ```
//!
//! E_coat and E_fibres are the albedos of the coat and of the fibres. E_d is the largest channel of
//! the albedo of the dielectric's reflection lobe. The diffuse lobe gets the light that the
//! reflection lobe does not reflect. So a white dielectric neither gains nor loses energy.
//!
//! * The clear coat (factor κ, index 1.5, own normal) and the fibres (colour σ, [`sheen`]) dim all
//!   lobes below them (`KHR_materials_clearcoat`, `KHR_materials_sheen`).
//! * T is the reflection lobe mirrored to the far side (`KHR_materials_transmission`: thin wall).
//! * [`glass`] computes the term `glass`, and [`fresnel`] thin films (`KHR_materials_iridescence`).
//! * f0 = min(((n − 1)/(n + 1))² colour, 1) specular, and f90 = specular. Here n is the index, and
//!   `colour` and `specular` are the specular colour and factor (`KHR_materials_specular`).
//! * Anisotropy stretches α of the base's microfacets (`KHR_materials_anisotropy`).
//!
//! Lobes with α < [`MIRROR_ALPHA`] are perfect mirrors: they can only be sampled, not evaluated.
//!
//! Each lobe has a file, with its parameters, its textures and its albedo. It also has a row in the
//! table in [`lobes`].

mod albedo;
mod appearance;
mod coat;
mod cosine;
mod diffuse;
mod frame;
mod fresnel;
mod ggx;
mod glass;
mod lobe;
mod lobes;
mod point;
mod reflection;
mod sheen;
mod spectrum;
mod table;
mod thin;

pub(crate) use self::appearance::{Appearance, Extras};
pub(crate) use self::cosine::cosine_directions;
pub(crate) use self::frame::Frame;
pub(crate) use self::fresnel::Film;
pub(crate) use self::lobe::MIRROR_ALPHA;
pub(crate) use self::lobes::{LayerSlots, Layers};
pub(crate) use self::point::{Bsdf, Scatter};

#[cfg(test)]
mod tests;
