//! UsdPreviewSurface, version 2.6.
//!
//! As in the scene's materials, a dielectric reflects F₀ = ((1 − ior)/(1 + ior))² at normal
//! incidence, and F₉₀ = 1 at grazing incidence. In the specular workflow F₀ is `specularColor`. The
//! index of refraction is then set to 0, for which the formula gives 1. So the specular colour
//! alone determines F₀.
//!
//! Opacity is the covered fraction of the surface, as in the `opacityMode` "presence". In the mode
//! "transparent", reflections should not fade with the opacity, but here they do.

use glam::Vec3;

use crate::slots::{Builder, Inputs, Value};

/// Inputs that have no effect here, with their defaults. A warning names each of these inputs that
/// has another value.
const WITHOUT: [(&str, f32); 1] = [("displacement", 0.0)];

pub(crate) fn build(builder: &mut Builder<'_, '_>, inputs: &Inputs) -> &'static [(&'static str, f32)] {
    let opacity = inputs.get("opacity", [1.0]);
    builder.base(&inputs.get("diffuseColor", [0.18; 3]), 1.0, &opacity, inputs.number("opacityThreshold", 0.0));
    builder.emission(&inputs.get("emissiveColor", [0.0; 3]), &Value::Constant([1.0]));
    let metallic = inputs.get("metallic", [0.0]);
    let roughness = inputs.get("roughness", [0.5]);
    let specular = inputs.get("specularColor", [0.0; 3]);
    builder.material.ior = inputs.number("ior", 1.5).max(1.0);
    if inputs.number("useSpecularWorkflow", 0.0) != 0.0 {
        builder.roughness(&roughness, &Value::Constant([0.0]));
        builder.specular(&Value::Constant([1.0]), &specular, 1.5);
        builder.material.ior = 0.0;
        if specular == Value::Constant([0.0; 3]) {
            (builder.material.specular, builder.material.specular_color) = (0.0, Vec3::ONE);
        }
    } else {
        builder.roughness(&roughness, &metallic);
    }
    let (weight, coat_roughness) = (inputs.get("clearcoat", [0.0]), inputs.get("clearcoatRoughness", [0.01]));
    let normal = inputs.get("normal", [0.0, 0.0, 1.0]);
    builder.coat(&weight, &coat_roughness, &normal);
    builder.material.normal_texture = builder.normal(&normal);
    // Read these inputs, so that no warning lists them. The path tracer itself computes occlusion,
    // and the opacity mode has no effect.
    inputs.number("occlusion", 1.0);
    inputs.text("opacityMode");
    &WITHOUT
}
