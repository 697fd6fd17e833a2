//! Animations sampled at one time: transforms of nodes and weights of morph targets.
//!
//! Key k has the time t_k and the value v_k. For a time t between keys k and k+1, let u = (t − t_k)
//! / (t_{k+1} − t_k) and Δ = t_{k+1} − t_k, in seconds:
//!
//! * STEP gives v_k.
//! * LINEAR gives (1−u)·v_k + u·v_{k+1}; rotations follow the shorter arc (slerp).
//! * CUBICSPLINE gives the Hermite spline with in-tangents a and out-tangents b:
//!
//! ```text
//! (2u³−3u²+1)·v_k + Δ(u³−2u²+u)·b_k + (3u²−2u³)·v_{k+1} + Δ(u³−u²)·a_{k+1}
//! ```
//!
//! Before the first key and after the last key the values are constant (glTF 2.0, section 3.11 and
//! appendix C).

use std::collections::{HashMap, HashSet};

use glam::{DQuat, DVec3};
use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use serde_json::Value;

use crate::LoadOptions;
use crate::accessor::{Accessor, Format, Selection};
use crate::document::Document;
use crate::error::Fault;
use crate::fields::Fields;
use crate::options::{choose, label};

use ComponentType::{F32, I8, I16, U8, U16};

const TIMES: Format = Format { types: &[Type::Scalar], components: &[F32], text: "SCALAR of FLOAT" };
const VECTORS: Format = Format { types: &[Type::Vec3], components: &[F32], text: "VEC3 of FLOAT" };
const ROTATIONS: Format = Format {
    types: &[Type::Vec4],
    components: &[F32, I8, U8, I16, U16],
    text: "VEC4 of FLOAT or of normalized 8- or 16-bit integers",
};
const WEIGHTS: Format = Format {
    types: &[Type::Scalar],
    components: &[F32, I8, U8, I16, U16],
    text: "SCALAR of FLOAT or of normalized 8- or 16-bit integers",
};

/// Values that an animation gives a node, which replace the node's own values.
#[derive(Clone, Debug, Default)]
pub(crate) struct NodePose {
    pub(crate) translation: Option<DVec3>,
    pub(crate) rotation: Option<DQuat>,
    pub(crate) scale: Option<DVec3>,
    pub(crate) weights: Option<Vec<f32>>,
}

/// The animated property of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Property {
    Translation,
    Rotation,
    Scale,
    Weights,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Interpolation {
    Step,
    Linear,
    CubicSpline,
}

struct Channel {
    node: usize,
    property: Property,
    /// JSON pointer to the sampler, `/animations/I/samplers/J`.
    sampler: String,
    input: json::Index<json::Accessor>,
    output: json::Index<json::Accessor>,
    interpolation: Interpolation,
}

/// Returns the names of the file's animations, in the file's order.
pub(crate) fn names<'d>(document: &'d Document<'_>) -> Vec<Option<&'d str>> {
    let list = document.json("/animations").and_then(Value::as_array);
    list.into_iter().flatten().map(|animation| animation.get("name").and_then(Value::as_str)).collect()
}

/// Returns the time in seconds from 0 to the last key of an animation.
pub(crate) fn duration_s(document: &Document<'_>, number: usize) -> Result<f32, Fault> {
    let mut end_s = 0.0f32;
    let mut seen = HashSet::new();
    for channel in channels(document, number)? {
        if seen.insert(channel.input.value()) {
            end_s = end_s.max(times(document, &channel)?.last().copied().unwrap_or_default());
        }
    }
    Ok(end_s)
}

/// Returns every node that the chosen animations move, with the values at the chosen time.
pub(crate) fn sample(document: &Document<'_>, options: &LoadOptions) -> Result<HashMap<usize, NodePose>, Fault> {
    let names = names(document);
    let chosen = match &options.animation {
        Some(wanted) => vec![channels(document, choose("scene animation", wanted, &names)?)?],
        None if names.is_empty() => {
            if options.time_s.is_some() {
                document.task.warn("/animations", "the file has no animations; the time has no effect");
            }
            Vec::new()
        }
        None if options.time_s.is_none() => {
            let message =
                "the file is animated; its nodes keep their own values, since neither a time nor an animation is given";
            document.task.warn("/animations", message);
            Vec::new()
        }
        None => together(document, &names)?,
    };
    let time_s = options.time_s.unwrap_or_default();
    let mut poses: HashMap<usize, NodePose> = HashMap::new();
    for channel in chosen.iter().flatten() {
        let pose = poses.entry(channel.node).or_default();
        match channel.property {
            Property::Translation => pose.translation = Some(vector(document, channel, time_s)?),
            Property::Scale => pose.scale = Some(vector(document, channel, time_s)?),
            Property::Rotation => pose.rotation = Some(rotation(document, channel, time_s)?),
            Property::Weights => pose.weights = weights(document, channel, time_s)?,
        }
    }
    Ok(poses)
}

/// Returns all animations if no two of them move the same property of a node, otherwise the first
/// animation of the file.
fn together(document: &Document<'_>, names: &[Option<&str>]) -> Result<Vec<Vec<Channel>>, Fault> {
    let mut all = Vec::new();
    let mut moved = HashSet::new();
    for number in 0..names.len() {
        let channels = channels(document, number)?;
        let fresh = channels.iter().all(|channel| moved.insert((channel.node, channel.property)));
        if !fresh {
            let list: Vec<String> = names.iter().enumerate().map(|(i, name)| label(i, *name)).collect();
            let message = format!(
                "two or more animations move the same property of a node; only the first of the file's animations is played. The animations are {}",
                list.join(", ")
            );
            document.task.warn("/animations", message);
            all.truncate(1);
            return Ok(all);
        }
        all.push(channels);
    }
    Ok(all)
}

/// Returns the channels of an animation that move a node; warns of channels that are not supported.
fn channels(document: &Document<'_>, number: usize) -> Result<Vec<Channel>, Fault> {
    let place = format!("/animations/{number}");
    let expected = |place: String, expected: &str| {
        let found = document.quote(&place);
        Fault::new(place, expected, found)
    };
    let Some(animation) = Fields::at(document, place.clone())? else { return Err(expected(place, "an animation")) };
    let sampler_count = animation.list("samplers")? as u64;
    let mut channels: Vec<Channel> = Vec::new();
    let mut moved = HashSet::new();
    for i in 0..animation.list("channels")? {
        let channel_place = format!("{place}/channels/{i}");
        let target_place = format!("{channel_place}/target");
        let Some(channel) = Fields::at(document, channel_place.clone())? else {
            return Err(expected(channel_place, "a channel"));
        };
        let Some(target) = Fields::at(document, target_place.clone())? else {
            return Err(expected(target_place, "a target"));
        };
        // read the target: a node, and one of its properties
        let property = match target.text("path")? {
            Some("translation") => Property::Translation,
            Some("rotation") => Property::Rotation,
            Some("scale") => Property::Scale,
            Some("weights") => Property::Weights,
            _ => {
                let path = target.place("path");
                let message = format!("{} is not supported; the property keeps its value", document.quote(&path));
                document.task.warn(path, message);
                continue;
            }
        };
        // targets without a node belong to extensions
        let Some(node) = target.index::<json::Node>("node")? else { continue };
        document.get(node, &target.place("node"))?;
        if !moved.insert((node.value(), property)) {
            return Err(Fault::new(target_place, "one channel for each node and property", "a second channel"));
        }
        // read the sampler: keys, values, and the interpolation between them
        let Some(sampler) = channel.count("sampler")?.filter(|&sampler| sampler < sampler_count) else {
            let expected = format!("an index below {sampler_count}");
            return Err(Fault::new(channel.place("sampler"), expected, document.quote(&channel.place("sampler"))));
        };
        let sampler = format!("{place}/samplers/{sampler}");
        let Some(fields) = Fields::at(document, sampler.clone())? else { return Err(expected(sampler, "a sampler")) };
        let interpolation = match fields.text("interpolation")? {
            None | Some("LINEAR") => Interpolation::Linear,
            Some("STEP") => Interpolation::Step,
            Some("CUBICSPLINE") => Interpolation::CubicSpline,
            Some(_) => return Err(expected(fields.place("interpolation"), "LINEAR, STEP or CUBICSPLINE")),
        };
        let (input, output) = (fields.needed_index("input")?, fields.needed_index("output")?);
        channels.push(Channel { node: node.value(), property, sampler, input, output, interpolation });
    }
    Ok(channels)
}

/// Returns the times of the keys, which increase; there is at least one.
fn times(document: &Document<'_>, channel: &Channel) -> Result<Vec<f32>, Fault> {
    let place = format!("{}/input", channel.sampler);
    let accessor = Accessor::open(document, channel.input, &place, &TIMES)?;
    let times = accessor.finite::<1>(document, &Selection::All, 0.0)?.into_flattened();
    match times.windows(2).position(|pair| pair[0] >= pair[1]) {
        None => Ok(times),
        Some(at) => Err(Fault::new(place, "times that increase", format!("{} before {}", times[at], times[at + 1]))),
    }
}

/// The last key at or before a time, or the first key if the time is before it. The interval to the
/// next key is `gap_s` seconds long, and its fraction `share` (u) has passed. Before the first key,
/// and from the last key on, `gap_s` and `share` are 0.
struct KeyInterval {
    key: usize,
    share: f64,
    gap_s: f64,
}

fn key_interval(times: &[f32], time_s: f64) -> KeyInterval {
    let after = times.partition_point(|&time| f64::from(time) <= time_s);
    if after == 0 || after == times.len() {
        return KeyInterval { key: after.saturating_sub(1), share: 0.0, gap_s: 0.0 };
    }
    let [before_s, after_s] = [after - 1, after].map(|key| f64::from(times[key]));
    let gap_s = after_s - before_s;
    KeyInterval { key: after - 1, share: (time_s - before_s) / gap_s, gap_s }
}

/// Values of a channel before and after a time, with the factors that blend them. A value is a list
/// of elements of `N` numbers, such as the weights of all morph targets of a node.
enum Values<const N: usize> {
    Held(Vec<[f64; N]>),
    Linear {
        values: [Vec<[f64; N]>; 2],
        share: f64,
    },
    /// The four terms v_k, b_k, a_{k+1} and v_{k+1} of a cubic spline, and their factors. Key k is
    /// the last key before the time, v are values, b are out-tangents, and a are in-tangents.
    Cubic {
        values: [Vec<[f64; N]>; 4],
        factors: [f64; 4],
    },
}

fn values<const N: usize>(
    document: &Document<'_>,
    channel: &Channel,
    format: &Format,
    group: usize,
    time_s: f64,
) -> Result<Values<N>, Fault> {
    let times = times(document, channel)?;
    let place = format!("{}/output", channel.sampler);
    let accessor = Accessor::open(document, channel.output, &place, format)?.assume_normalized();
    // every key has one group of elements, or three groups for a cubic spline
    let is_cubic = channel.interpolation == Interpolation::CubicSpline;
    let per_key = if is_cubic { 3 * group } else { group };
    if times.len().checked_mul(per_key) != Some(accessor.count) {
        let expected = format!("{} × {per_key} elements (keys of the input × elements per key)", times.len());
        return Err(Fault::new(place, expected, accessor.count));
    }
    // `part` selects one group of the values at a key; the three groups of a cubic spline are
    // in-tangent, value and out-tangent
    let read = |key: usize, part: usize| -> Result<Vec<[f64; N]>, Fault> {
        let first = key * per_key + part * group;
        let selection = Selection::Some((first as u32..(first + group) as u32).collect());
        let read = accessor.finite::<N>(document, &selection, 0.0)?;
        Ok(read.into_iter().map(|element| element.map(f64::from)).collect())
    };
    let KeyInterval { key, share: u, gap_s } = key_interval(&times, time_s);
    Ok(match channel.interpolation {
        Interpolation::CubicSpline if u == 0.0 => Values::Held(read(key, 1)?),
        _ if u == 0.0 => Values::Held(read(key, 0)?),
        Interpolation::Step => Values::Held(read(key, 0)?),
        Interpolation::Linear => Values::Linear { values: [read(key, 0)?, read(key + 1, 0)?], share: u },
        Interpolation::CubicSpline => {
            let (u2, u3) = (u * u, u * u * u);
            let factors =
                [2.0 * u3 - 3.0 * u2 + 1.0, gap_s * (u3 - 2.0 * u2 + u), gap_s * (u3 - u2), 3.0 * u2 - 2.0 * u3];
            let values = [read(key, 1)?, read(key, 2)?, read(key + 1, 0)?, read(key + 1, 1)?];
            Values::Cubic { values, factors }
        }
    })
}

/// Blends values component by component.
fn blend<const N: usize>(values: Values<N>) -> Vec<[f64; N]> {
    fn sum<const N: usize, const K: usize>(values: &[Vec<[f64; N]>; K], factors: [f64; K]) -> Vec<[f64; N]> {
        let element = |i: usize| std::array::from_fn(|c| (0..K).map(|k| factors[k] * values[k][i][c]).sum());
        (0..values[0].len()).map(element).collect()
    }
    match values {
        Values::Held(held) => held,
        Values::Linear { values, share } => sum(&values, [1.0 - share, share]),
        Values::Cubic { values, factors } => sum(&values, factors),
    }
}

fn vector(document: &Document<'_>, channel: &Channel, time_s: f64) -> Result<DVec3, Fault> {
    Ok(blend(values::<3>(document, channel, &VECTORS, 1, time_s)?)[0].into())
}

fn rotation(document: &Document<'_>, channel: &Channel, time_s: f64) -> Result<DQuat, Fault> {
    let unit = |xyzw: [f64; 4]| {
        let quaternion = DQuat::from_array(xyzw);
        let length = quaternion.length();
        let place = format!("{}/output", channel.sampler);
        if length > 0.0 {
            Ok(quaternion / length)
        } else {
            Err(Fault::new(place, "quaternions that are not zero", quaternion))
        }
    };
    match values::<4>(document, channel, &ROTATIONS, 1, time_s)? {
        Values::Linear { values: [from, to], share } => Ok(unit(from[0])?.slerp(unit(to[0])?, share)),
        other => unit(blend(other)[0]),
    }
}

/// Returns the weights of the node's morph targets; `None`, with a warning, if the node has none.
fn weights(document: &Document<'_>, channel: &Channel, time_s: f64) -> Result<Option<Vec<f32>>, Fault> {
    let node = channel.node;
    let targets = match document.root.nodes[node].mesh {
        Some(mesh) => {
            let mesh = document.get(mesh, &format!("/nodes/{node}/mesh"))?;
            mesh.primitives.iter().flat_map(|primitive| &primitive.targets).map(Vec::len).max().unwrap_or(0)
        }
        None => 0,
    };
    if targets == 0 {
        let place = format!("/nodes/{node}");
        document.task.warn(place, "the node has no morph targets; animated weights have no effect");
        return Ok(None);
    }
    let values = blend(values::<1>(document, channel, &WEIGHTS, targets, time_s)?);
    Ok(Some(values.into_iter().map(|[weight]| weight as f32).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_segment_of_a_time() {
        let times = [1.0, 2.0, 4.0];
        let found = |time_s| {
            let KeyInterval { key, share, gap_s } = key_interval(&times, time_s);
            (key, share, gap_s)
        };
        assert_eq!(found(-5.0), (0, 0.0, 0.0));
        assert_eq!(found(1.0), (0, 0.0, 1.0));
        assert_eq!(found(1.25), (0, 0.25, 1.0));
        assert_eq!(found(2.0), (1, 0.0, 2.0));
        assert_eq!(found(3.5), (1, 0.75, 2.0));
        assert_eq!(found(4.0), (2, 0.0, 0.0));
        assert_eq!(found(1e30), (2, 0.0, 0.0));
    }
}
