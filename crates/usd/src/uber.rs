//! MaterialX's large surface shaders: standard_surface, open_pbr_surface, gltf_pbr; and
//! surface_unlit, which only emits.
//!
//! The first three have a metal or dielectric base with a diffuse colour, a specular lobe,
//! transmission, coat, sheen, thin film, emission and opacity. Transmission is tinted at the
//! surface, or coloured by absorption over a depth.
//!
//! Subsurface scattering is replaced by the diffuse colour that results from it. A coat has no
//! colour, and has the index of refraction 1.5.

use glam::Vec3;

use crate::slots::{Builder, Inputs, Value, grey};

const WHITE: [f32; 3] = [1.0; 3];
const UP: [f32; 3] = [0.0, 0.0, 1.0];

type Ignored = &'static [(&'static str, f32)];

/// Returns the diffuse colour and its weight. The input `name` is the colour of subsurface
/// scattering, whose weight is `weight`. Two constant colours are mixed. If either colour is a
/// texture, the colour with the larger weight is returned.
fn with_subsurface(
    inputs: &Inputs,
    base: Value<3>,
    base_weight: f32,
    weight: f32,
    name: &'static str,
) -> (Value<3>, f32) {
    let below = inputs.get(name, [0.8; 3]);
    match (base, below) {
        (base, _) if weight <= 0.0 => (base, base_weight),
        (Value::Constant(base), Value::Constant(below)) => {
            let mixed = (base_weight * Vec3::from(base)).lerp(below.into(), weight.clamp(0.0, 1.0));
            (Value::Constant(mixed.to_array()), 1.0)
        }
        (_, below) if weight >= 0.5 => (below, 1.0),
        (base, _) => (base, base_weight),
    }
}

/// Converts the inputs of Autodesk Standard Surface.
pub(crate) fn standard_surface(builder: &mut Builder<'_, '_>, inputs: &Inputs) -> Ignored {
    let (color, weight) = with_subsurface(
        inputs,
        inputs.get("base_color", [0.8; 3]),
        inputs.number("base", 1.0),
        inputs.number("subsurface", 0.0),
        "subsurface_color",
    );
    // Map each parameter to its counterpart in the scene's material.
    let thin = inputs.number("thin_walled", 0.0) != 0.0;
    builder.base(&color, weight, &grey(&inputs.get("opacity", WHITE)), 0.0);
    builder.roughness(&inputs.get("specular_roughness", [0.2]), &inputs.get("metalness", [0.0]));
    let ior = inputs.number("specular_IOR", 1.5);
    builder.specular(&inputs.get("specular", [1.0]), &inputs.get("specular_color", WHITE), ior);
    builder.anisotropy(inputs.number("specular_anisotropy", 0.0), inputs.number("specular_rotation", 0.0));
    let (tint, depth) = (inputs.color("transmission_color", WHITE), inputs.number("transmission_depth", 0.0));
    builder.transmission(&inputs.get("transmission", [0.0]), Some(tint), depth, thin);
    let abbe = inputs.number("transmission_dispersion", 0.0);
    builder.material.dispersion = if abbe > 0.0 { (20.0 / abbe).min(20.0) } else { 0.0 };
    let normal = inputs.get("normal", UP);
    builder.coat(&inputs.get("coat", [0.0]), &inputs.get("coat_roughness", [0.1]), &inputs.get("coat_normal", UP));
    builder.coat_index(inputs.number("coat_IOR", 1.5));
    builder.sheen(
        inputs.number("sheen", 0.0),
        &inputs.get("sheen_color", WHITE),
        &inputs.get("sheen_roughness", [0.3]),
    );
    builder.film(1.0, inputs.number("thin_film_thickness", 0.0), inputs.number("thin_film_IOR", 1.5));
    builder.emission(&inputs.get("emission_color", WHITE), &inputs.get("emission", [0.0]));
    builder.material.normal_texture = builder.normal(&normal);
    // read these inputs, so that no warning lists them; they have no effect
    for name in ["subsurface_radius", "subsurface_scale", "subsurface_anisotropy", "tangent"] {
        inputs.text(name);
    }
    &[
        ("diffuse_roughness", 0.0),
        ("transmission_scatter", 0.0),
        ("transmission_scatter_anisotropy", 0.0),
        ("transmission_extra_roughness", 0.0),
        ("coat_color", 1.0),
        ("coat_anisotropy", 0.0),
        ("coat_rotation", 0.0),
        ("coat_affect_color", 0.0),
        ("coat_affect_roughness", 0.0),
    ]
}

/// Converts the inputs of OpenPBR Surface.
pub(crate) fn open_pbr(builder: &mut Builder<'_, '_>, inputs: &Inputs) -> Ignored {
    let (color, weight) = with_subsurface(
        inputs,
        inputs.get("base_color", [0.8; 3]),
        inputs.number("base_weight", 1.0),
        inputs.number("subsurface_weight", 0.0),
        "subsurface_color",
    );
    // Map each parameter to its counterpart in the scene's material.
    let thin = inputs.number("geometry_thin_walled", 0.0) != 0.0;
    builder.base(&color, weight, &inputs.get("geometry_opacity", [1.0]), 0.0);
    builder.roughness(&inputs.get("specular_roughness", [0.3]), &inputs.get("base_metalness", [0.0]));
    let ior = inputs.number("specular_ior", 1.5);
    builder.specular(&inputs.get("specular_weight", [1.0]), &inputs.get("specular_color", WHITE), ior);
    builder.anisotropy(inputs.number("specular_roughness_anisotropy", 0.0), 0.0);
    let (tint, depth) = (inputs.color("transmission_color", WHITE), inputs.number("transmission_depth", 0.0));
    builder.transmission(&inputs.get("transmission_weight", [0.0]), Some(tint), depth, thin);
    let abbe = inputs.number("transmission_dispersion_abbe_number", 20.0).max(1.0);
    builder.material.dispersion = (20.0 / abbe * inputs.number("transmission_dispersion_scale", 0.0)).clamp(0.0, 20.0);
    let normal = inputs.get("geometry_normal", UP);
    let coat_normal = inputs.get("geometry_coat_normal", UP);
    builder.coat(&inputs.get("coat_weight", [0.0]), &inputs.get("coat_roughness", [0.0]), &coat_normal);
    builder.coat_index(inputs.number("coat_ior", 1.5));
    let fuzz = inputs.number("fuzz_weight", 0.0);
    builder.sheen(fuzz, &inputs.get("fuzz_color", WHITE), &inputs.get("fuzz_roughness", [0.5]));
    // the shader states the thickness in micrometres
    let thickness_nm = 1000.0 * inputs.number("thin_film_thickness", 0.5);
    builder.film(inputs.number("thin_film_weight", 0.0), thickness_nm, inputs.number("thin_film_ior", 1.4));
    builder.emission(&inputs.get("emission_color", WHITE), &inputs.get("emission_luminance", [0.0]));
    builder.material.normal_texture = builder.normal(&normal);
    for name in [
        "subsurface_radius",
        "subsurface_radius_scale",
        "subsurface_scatter_anisotropy",
        "coat_darkening",
        "geometry_tangent",
        "geometry_coat_tangent",
    ] {
        inputs.text(name);
    }
    &[
        ("base_diffuse_roughness", 0.0),
        ("transmission_scatter", 0.0),
        ("transmission_scatter_anisotropy", 0.0),
        ("coat_color", 1.0),
        ("coat_roughness_anisotropy", 0.0),
    ]
}

/// Converts the inputs of the MaterialX shader that has the material model of glTF.
pub(crate) fn gltf_pbr(builder: &mut Builder<'_, '_>, inputs: &Inputs) -> Ignored {
    // the modes are 0 for opaque, 1 for an alpha mask and 2 for blending
    let mode = inputs.number("alpha_mode", 0.0);
    let cutoff = inputs.number("alpha_cutoff", 0.5);
    let opacity = if mode == 0.0 { Value::Constant([1.0]) } else { inputs.get("alpha", [1.0]) };
    builder.base(&inputs.get("base_color", WHITE), 1.0, &opacity, if mode == 1.0 { cutoff } else { 0.0 });
    builder.roughness(&inputs.get("roughness", [1.0]), &inputs.get("metallic", [1.0]));
    let ior = inputs.number("ior", 1.5);
    builder.specular(&inputs.get("specular", [1.0]), &inputs.get("specular_color", WHITE), ior);
    let thin = inputs.number("thickness", 0.0) <= 0.0;
    builder.transmission(&inputs.get("transmission", [0.0]), None, 0.0, thin);
    let distance = inputs.number("attenuation_distance", f32::MAX);
    if !thin && distance < f32::MAX && distance > 0.0 {
        builder.material.attenuation_distance = distance;
        builder.material.attenuation_color = inputs.color("attenuation_color", WHITE);
    }
    let normal = inputs.get("normal", UP);
    let coat_normal = inputs.get("clearcoat_normal", UP);
    builder.coat(&inputs.get("clearcoat", [0.0]), &inputs.get("clearcoat_roughness", [0.0]), &coat_normal);
    let sheen = inputs.get("sheen_color", [0.0; 3]);
    let weight = if sheen == Value::Constant([0.0; 3]) { 0.0 } else { 1.0 };
    builder.sheen(weight, &sheen, &inputs.get("sheen_roughness", [0.0]));
    let thickness_nm = inputs.number("iridescence_thickness", 100.0);
    builder.film(inputs.number("iridescence", 0.0), thickness_nm, inputs.number("iridescence_ior", 1.3));
    builder.emission(&inputs.get("emissive", [0.0; 3]), &inputs.get("emissive_strength", [1.0]));
    builder.material.normal_texture = builder.normal(&normal);
    // read these inputs, so that no warning lists them; they have no effect
    for name in ["occlusion", "tangent"] {
        inputs.text(name);
    }
    &[("anisotropy_strength", 0.0), ("dispersion", 0.0)]
}

/// Converts a shader that has emission and no reflection.
pub(crate) fn unlit(builder: &mut Builder<'_, '_>, inputs: &Inputs) -> Ignored {
    builder.base(&Value::Constant([0.0; 3]), 1.0, &inputs.get("opacity", [1.0]), 0.0);
    builder.roughness(&Value::Constant([1.0]), &Value::Constant([0.0]));
    builder.specular(&Value::Constant([0.0]), &Value::Constant(WHITE), 1.5);
    builder.emission(&inputs.get("emission_color", WHITE), &inputs.get("emission", [1.0]));
    // read this input, so that no warning lists it; it matters only if `transmission` is not 0, and
    // then the warning lists `transmission`
    inputs.text("transmission_color");
    &[("transmission", 0.0)]
}
