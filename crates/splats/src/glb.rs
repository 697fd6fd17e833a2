//! Writes a cloud as a binary glTF file with `KHR_gaussian_splatting`.

use lumistack_scene::{Cloud, Encoding};
use serde_json::{Map, Value, json};

const FLOAT: u32 = 5126;
const POINTS: u32 = 0;

/// Returns a `.glb` file with one cloud. The cloud's node has `rotation` (x, y, z, w) and a uniform
/// `scale`.
///
/// `None` if the cloud exceeds the 32-bit lengths of the container.
pub fn glb(cloud: &Cloud, rotation: [f32; 4], scale: f64) -> Option<Vec<u8>> {
    let coefficients = cloud.coefficients();
    let size = 4 * cloud.len() * (3 + 4 + 3 + 1 + 3 * coefficients);
    // refuse before the buffer is built; 64 KiB are enough for the header, chunks and JSON
    u32::try_from(size + (1 << 16)).ok()?;
    // Each attribute becomes a buffer view with an accessor.
    let mut bytes = Vec::with_capacity(size);
    let (mut views, mut accessors, mut attributes) = (Vec::new(), Vec::new(), Map::new());
    let mut add = |name: &str, kind: &str, values: &mut dyn Iterator<Item = f32>| {
        let start = bytes.len();
        values.for_each(|value| bytes.extend(value.to_le_bytes()));
        views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": bytes.len() - start}));
        let view = views.len() - 1;
        accessors.push(json!({"bufferView": view, "componentType": FLOAT, "count": cloud.len(), "type": kind}));
        attributes.insert(name.to_owned(), (accessors.len() - 1).into());
    };
    let own = |name: &str| format!("KHR_gaussian_splatting:{name}");
    add("POSITION", "VEC3", &mut cloud.positions.iter().flat_map(|v| v.to_array()));
    add(&own("ROTATION"), "VEC4", &mut cloud.rotations.iter().flat_map(|q| q.to_array()));
    add(&own("SCALE"), "VEC3", &mut cloud.scales.iter().flat_map(|v| v.to_array()));
    add(&own("OPACITY"), "SCALAR", &mut cloud.opacities.iter().copied());
    for degree in 0..=cloud.degree {
        for order in 0..2 * degree + 1 {
            let first = 3 * (degree * degree + order);
            let of_all = cloud.harmonics.chunks_exact(3 * coefficients);
            let mut values = of_all.flat_map(|of_one| of_one[first..first + 3].iter().copied());
            add(&own(&format!("SH_DEGREE_{degree}_COEF_{order}")), "VEC3", &mut values);
        }
    }
    // glTF requires the bounds of positions.
    let (mut least, mut most) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in &cloud.positions {
        for axis in 0..3 {
            (least[axis], most[axis]) = (least[axis].min(position[axis]), most[axis].max(position[axis]));
        }
    }
    if least.iter().chain(&most).all(|value| value.is_finite()) {
        accessors[0]["min"] = json!(least);
        accessors[0]["max"] = json!(most);
    }
    let space = match cloud.encoding {
        Encoding::Srgb => "srgb_rec709_display",
        Encoding::Linear => "lin_rec709_display",
    };
    let root: Value = json!({
        "asset": {"version": "2.0", "generator": "lumistack"},
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": rotation, "scale": [scale, scale, scale]}],
        "meshes": [{"primitives": [{
            "mode": POINTS,
            "attributes": attributes,
            "extensions": {"KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": space}},
        }]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": bytes.len()}],
    });
    // Write the GLB container: header, JSON padded to four bytes, then the binary chunk.
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut file = Vec::with_capacity(28 + text.len() + bytes.len());
    let word = |value: usize| u32::try_from(value).ok().map(u32::to_le_bytes);
    file.extend(b"glTF");
    file.extend(2u32.to_le_bytes());
    file.extend(word(28 + text.len() + bytes.len())?);
    for (kind, chunk) in [(b"JSON", text), (b"BIN\0", bytes)] {
        file.extend(word(chunk.len())?);
        file.extend(kind);
        file.extend(chunk);
    }
    Some(file)
}
