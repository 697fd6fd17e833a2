//! Reads cameras, the environment, and the lights that have no surface.
//!
//! Sources: KHR_lights_punctual (candela and lux, light along −z of the node), and glTF 2.0,
//! section 3.10 (cameras). Two extras belong to Lumistack: `extras.lumistack.focus_distance` on a
//! camera, and `extras.lumistack.environment` on a scene.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Affine3A, DAffine3, DVec3, Quat, Vec3};
use gltf::json;
use gltf::json::extensions::scene::khr_lights_punctual::{Light as Source, Type};
use gltf::json::validation::Checked;
use lumistack_scene::{Camera, Environment, Light, LightKind, Projection};
use serde_json::Value;

use crate::document::Document;
use crate::error::Fault;
use crate::fields::numbers;
use crate::images::Images;
use crate::nodes::{Nodes, extras, rotation};
use crate::quote::quote;

/// Returns the punctual lights of the scene's nodes.
pub(crate) fn lights(document: &Document<'_>, nodes: &Nodes) -> Result<Vec<Light>, Fault> {
    let mut lights = Vec::new();
    for &node in &nodes.shown {
        let extensions = document.root.nodes[node].extensions.as_ref();
        let Some(reference) = extensions.and_then(|extensions| extensions.khr_lights_punctual.as_ref()) else {
            continue;
        };
        let used_at = format!("/nodes/{node}/extensions/KHR_lights_punctual/light");
        let source = document.get(reference.light, &used_at)?;
        let place = format!("/extensions/KHR_lights_punctual/lights/{}", reference.light.value());
        // check the light even if its node gives it no direction
        let kind = light_kind(document, source, &place)?;
        let intensity = Vec3::from(source.color) * source.intensity;
        if !(intensity.is_finite() && intensity.min_element() >= 0.0) {
            let found = format!("colour {:?} and intensity {}", source.color, source.intensity);
            return Err(Fault::new(place, "a colour and an intensity that are finite and ≥ 0", found));
        }
        // a light shines along −z of its node
        let placement = &nodes.scene_from_node[node];
        let direction = match (placement.transform_vector3(DVec3::NEG_Z).try_normalize(), kind) {
            (Some(direction), _) => direction.as_vec3(),
            (None, LightKind::Point) => Vec3::NEG_Z,
            (None, _) => {
                document.task.warn(
                    format!("/nodes/{node}"),
                    "the node has a scale of zero, so the light has no direction and is left out",
                );
                continue;
            }
        };
        lights.push(Light { position: placement.translation.as_vec3(), direction, intensity, kind });
    }
    Ok(lights)
}

fn light_kind(document: &Document<'_>, source: &Source, place: &str) -> Result<LightKind, Fault> {
    match source.type_ {
        Checked::Valid(Type::Directional) => Ok(LightKind::Directional),
        Checked::Valid(Type::Point) => Ok(LightKind::Point),
        Checked::Valid(Type::Spot) => {
            let place = format!("{place}/spot");
            let Some(spot) = &source.spot else { return Err(Fault::new(place, "cone angles", "nothing")) };
            // An angle that was rounded, such as 1.5708 for π/2, is corrected.
            let within =
                |angle: f32, most: f32| if angle <= most * (1.0 + ANGLE_ROUNDING) { angle.min(most) } else { angle };
            let outer = within(spot.outer_cone_angle, FRAC_PI_2);
            let inner = within(spot.inner_cone_angle, outer);
            if !(outer > 0.0 && outer <= FRAC_PI_2 && inner >= 0.0 && inner <= outer) {
                let expected = "0 ≤ innerConeAngle ≤ outerConeAngle and 0 < outerConeAngle ≤ π/2";
                return Err(Fault::new(place, expected, format!("innerConeAngle {inner} and outerConeAngle {outer}")));
            }
            Ok(LightKind::Spot { inner_cone_rad: inner, outer_cone_rad: outer })
        }
        Checked::Invalid => {
            let place = format!("{place}/type");
            let found = document.quote(&place);
            Err(Fault::new(place, "directional, point or spot", found))
        }
    }
}

/// Largest relative error of a rounded cone angle.
const ANGLE_ROUNDING: f32 = 1e-4;

/// Returns the cameras of the scene's nodes, in the file's order of cameras.
pub(crate) fn cameras(document: &Document<'_>, nodes: &Nodes) -> Result<Vec<Camera>, Fault> {
    let mut cameras = Vec::new();
    for &node in &nodes.shown {
        let Some(index) = document.root.nodes[node].camera else { continue };
        let source = document.get(index, &format!("/nodes/{node}/camera"))?;
        let place = format!("/cameras/{}", index.value());
        let focus_distance = match extras(document, &place, &["focus_distance"]) {
            Some(extras) => focus_distance(extras, &place)?,
            None => None,
        };
        let name = document.root.nodes[node].name.clone().or_else(|| source.name.clone());
        let camera = Camera {
            name: name.unwrap_or_else(|| index.value().to_string()),
            scene_from_camera: affine(&nodes.scene_from_node[node]),
            projection: projection(document, source, &place)?,
            focus_distance,
            near: near(source),
        };
        cameras.push((index.value(), camera));
    }
    cameras.sort_by_key(|&(number, _)| number);
    Ok(cameras.into_iter().map(|(_, camera)| camera).collect())
}

/// Returns the distance of the near plane, in scene units.
fn near(source: &json::Camera) -> Option<f32> {
    match (&source.perspective, &source.orthographic) {
        (Some(perspective), _) => Some(perspective.znear),
        (None, Some(orthographic)) => Some(orthographic.znear),
        (None, None) => None,
    }
}

fn focus_distance(extras: &Value, camera_place: &str) -> Result<Option<f32>, Fault> {
    let Some(value) = extras.get("focus_distance") else { return Ok(None) };
    let distance = value.as_f64().map(|distance| distance as f32);
    match distance.filter(|distance| distance.is_finite() && *distance > 0.0) {
        Some(distance) => Ok(Some(distance)),
        None => {
            let place = format!("{camera_place}/extras/lumistack/focus_distance");
            Err(Fault::new(place, "a distance in scene units above 0", quote(Some(value))))
        }
    }
}

pub(crate) fn projection(document: &Document<'_>, source: &json::Camera, place: &str) -> Result<Projection, Fault> {
    let positive = |value: f32, most: f32, field: &str| {
        if value > 0.0 && value < most {
            return Ok(value);
        }
        let expected =
            if most.is_finite() { format!("a number between 0 and {most}") } else { "a number above 0".to_owned() };
        Err(Fault::new(format!("{place}/{field}"), expected, value))
    };
    use gltf::json::camera::Type::{Orthographic, Perspective};
    match (source.type_, &source.perspective, &source.orthographic) {
        (Checked::Valid(Perspective), Some(perspective), _) => Ok(Projection::Perspective {
            vertical_fov_rad: positive(perspective.yfov, PI, "perspective/yfov")?,
            aspect: match perspective.aspect_ratio {
                Some(aspect) => Some(positive(aspect, f32::INFINITY, "perspective/aspectRatio")?),
                None => None,
            },
        }),
        (Checked::Valid(Orthographic), _, Some(orthographic)) => Ok(Projection::Orthographic {
            half_width: positive(orthographic.xmag.abs(), f32::INFINITY, "orthographic/xmag")?,
            half_height: positive(orthographic.ymag.abs(), f32::INFINITY, "orthographic/ymag")?,
        }),
        _ => {
            let expected = "the type perspective or orthographic, and an object of that name";
            Err(Fault::new(place, expected, document.quote(place)))
        }
    }
}

/// Returns the environment in the scene's extras: the picture `image`; a factor `strength`, one
/// number or three; and a quaternion `rotation`.
pub(crate) fn environment(
    document: &Document<'_>,
    nodes: &Nodes,
    images: &mut Images,
) -> Result<Option<Environment>, Fault> {
    let Some(scene) = &nodes.scene_place else { return Ok(None) };
    let Some(environment) = extras(document, scene, &["environment"]).and_then(|extras| extras.get("environment"))
    else {
        return Ok(None);
    };
    let place = format!("{scene}/extras/lumistack/environment");
    // unknown keys are errors, since a typo must not be silent
    let known = ["image", "strength", "rotation"];
    let object = environment.as_object();
    if object.is_none_or(|object| object.keys().any(|key| !known.contains(&key.as_str()))) {
        let expected = format!("an object with no members but {}", known.join(", "));
        return Err(Fault::new(place, expected, quote(Some(environment))));
    }
    // read the picture, the factor and the rotation
    let Some(uri) = environment.get("image").and_then(Value::as_str) else {
        let place = format!("{place}/image");
        return Err(Fault::new(&place, "the path of a Radiance .hdr picture", document.quote(&place)));
    };
    let strength = match environment.get("strength") {
        None => Vec3::ONE,
        Some(value) => match (value.as_f64(), numbers::<3>(value)) {
            (Some(number), _) => Vec3::splat(number as f32),
            (None, Some(rgb)) => rgb.into(),
            (None, None) => {
                let place = format!("{place}/strength");
                return Err(Fault::new(place, "a number, or three for red, green and blue", quote(Some(value))));
            }
        },
    };
    if !(strength.is_finite() && strength.min_element() >= 0.0) {
        return Err(Fault::new(format!("{place}/strength"), "finite numbers ≥ 0", strength));
    }
    let scene_from_environment = match environment.get("rotation") {
        None => Quat::IDENTITY,
        Some(value) => {
            let place = || format!("{place}/rotation");
            let xyzw = numbers::<4>(value).ok_or_else(|| Fault::new(place(), "four numbers", quote(Some(value))))?;
            rotation(xyzw, place)?.as_quat()
        }
    };
    let image = images.environment(document, uri, &format!("{place}/image"))?;
    Ok(Some(Environment { image, strength, scene_from_environment }))
}

/// Converts a placement to 32-bit numbers, which scenes use.
pub(crate) fn affine(placement: &DAffine3) -> Affine3A {
    placement.as_affine3a()
}
