//! Makes triangle meshes from primitives: indices, topology, attributes, morph targets.
//!
//! Source: glTF 2.0, section 3.7.2, and KHR_mesh_quantization.

use glam::{Vec2, Vec3, Vec4};
use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::{Mode, Semantic};
use gltf::json::validation::Checked;
use lumistack_scene::{Material, Mesh};

use crate::accessor::{Accessor, Format, Selection};
use crate::attributes::Attributes;
use crate::document::Document;
use crate::draco;
use crate::error::Fault;
use crate::skin::Pose;

use ComponentType::{F32, I8, I16, U8, U16, U32};

const INDICES: Format = Format {
    types: &[Type::Scalar],
    components: &[U8, U16, U32],
    text: "SCALAR of UNSIGNED_BYTE, UNSIGNED_SHORT or UNSIGNED_INT",
};
const POSITION: Format = Format {
    types: &[Type::Vec3],
    components: &[F32, I8, U8, I16, U16],
    text: "VEC3 of FLOAT, or of 8- or 16-bit integers (KHR_mesh_quantization)",
};
const NORMAL: Format = Format {
    types: &[Type::Vec3],
    components: &[F32, I8, I16],
    text: "VEC3 of FLOAT, or of BYTE or SHORT (KHR_mesh_quantization)",
};
const TANGENT: Format = Format {
    types: &[Type::Vec4],
    components: &[F32, I8, I16],
    text: "VEC4 of FLOAT, or of BYTE or SHORT (KHR_mesh_quantization)",
};
const TEXCOORD: Format = Format {
    types: &[Type::Vec2],
    components: &[F32, I8, U8, I16, U16],
    text: "VEC2 of FLOAT or of 8- or 16-bit integers",
};
const COLOR: Format = Format {
    types: &[Type::Vec3, Type::Vec4],
    components: &[F32, U8, U16],
    text: "VEC3 or VEC4 of FLOAT, UNSIGNED_BYTE or UNSIGNED_SHORT",
};

/// The primitive to read, with everything that determines its mesh.
pub(crate) struct Request<'a> {
    /// JSON pointer to the primitive, `/meshes/I/primitives/J`.
    pub(crate) place: String,
    pub(crate) primitive: &'a json::mesh::Primitive,
    /// Index of the primitive's material in the scene.
    pub(crate) material: usize,
    pub(crate) appearance: &'a Material,
    /// The texture coordinate sets of the file that the material uses as sets 0 and 1.
    pub(crate) uv_sets: [u32; 2],
    /// Weights of the mesh's morph targets.
    pub(crate) weights: &'a [f32],
    /// Joint matrices of the skin, if the node that shows the mesh has one.
    pub(crate) pose: Option<&'a Pose>,
}

/// Reads a primitive. `None`, with a warning, if it consists of points or lines, or has no
/// positions.
pub(crate) fn load(document: &Document<'_>, request: &Request<'_>) -> Result<Option<Mesh>, Fault> {
    document.task.cancel.check()?;
    let Request { place, primitive, .. } = request;
    let Checked::Valid(mode) = primitive.mode else {
        let place = format!("{place}/mode");
        let found = document.quote(&place);
        return Err(Fault::new(place, "a primitive mode (0 to 6)", found));
    };
    if matches!(mode, Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
        let kind = if mode == Mode::Points { "points" } else { "lines" };
        document.leave_out(place, format!("a primitive of {kind} has no surface and is left out"));
        return Ok(None);
    }
    let decoded = draco::decode(document, place)?;
    let attributes = Attributes { document, place, primitive, decoded: decoded.as_ref() };
    let Some(positions) = attributes.open(Semantic::Positions, &POSITION, None)? else {
        document.leave_out(place, "a primitive without POSITION is left out".into());
        return Ok(None);
    };
    // make the triangles: from the Draco stream, or from the indices as the primitive's mode states
    let count = positions.count;
    let (mut triangles, left_over) = match &decoded {
        Some(decoded) if decoded.vertices == count => {
            document.spend(place, decoded.triangles.len(), size_of::<[u32; 3]>())?;
            (decoded.triangles.clone(), 0)
        }
        Some(decoded) => {
            let place = format!("{place}/extensions/KHR_draco_mesh_compression/attributes");
            return Err(Fault::new(place, format!("POSITION of {} vertices", decoded.vertices), count));
        }
        None => {
            let indices = indices(document, request, count)?;
            // there is at most one triangle per index
            document.spend(place, indices.len(), size_of::<[u32; 3]>())?;
            triangles(mode, &indices)
        }
    };
    if left_over > 0 {
        document.task.warn(place, format!("vertices at the end that make no triangle are left out: {left_over}"));
    }
    // read the attributes of used vertices only
    let selection = select_used_vertices(&mut triangles, count);

    let mut mesh = Mesh {
        place: place.clone(),
        positions: vec3s(positions.finite::<3>(document, &selection, 0.0)?),
        triangles,
        material: request.material,
        ..Mesh::default()
    };
    // a normal or tangent may have no direction; the scene's validator mends normals, and
    // `mend_tangents` mends tangents
    if let Some(normals) = attributes.open(Semantic::Normals, &NORMAL, Some(count))? {
        mesh.normals = vec3s(normals.assume_normalized().floats::<3>(document, &selection, 0.0)?);
        if let Some(tangents) = attributes.open(Semantic::Tangents, &TANGENT, Some(count))? {
            let tangents = tangents.assume_normalized().floats::<4>(document, &selection, 0.0)?;
            mesh.tangents = tangents.into_iter().map(Vec4::from).collect();
        }
    }
    for (slot, set) in request.uv_sets.into_iter().enumerate() {
        if let Some(uvs) = attributes.open(Semantic::TexCoords(set), &TEXCOORD, Some(count))? {
            mesh.uvs[slot] = uvs.finite::<2>(document, &selection, 0.0)?.into_iter().map(Vec2::from).collect();
        }
    }
    for (slot, texture) in request.appearance.textures() {
        if mesh.uvs.get(texture.uv_set).is_some_and(Vec::is_empty) {
            let set = request.uv_sets[texture.uv_set];
            let message = format!(
                "the material's {slot} uses TEXCOORD_{set}, which the mesh lacks; the texture is read at (0, 0)"
            );
            document.task.warn(place, message);
        }
    }
    if let Some(colors) = attributes.open(Semantic::Colors(0), &COLOR, Some(count))? {
        let colors = colors.assume_normalized().finite::<4>(document, &selection, 1.0)?;
        mesh.colors = clamp_colors(document, place, colors);
    }
    // deform the mesh: morph targets first, then the skin
    morph(&attributes, request.weights, &mut mesh, &selection, count)?;
    if let Some(pose) = request.pose {
        pose.apply(document, &attributes, &mut mesh, &selection, count)?;
    }
    mend_tangents(document, &mut mesh);
    Ok(Some(mesh))
}

/// Returns the vertex indices in drawing order, all below `count`.
fn indices(document: &Document<'_>, request: &Request<'_>, count: usize) -> Result<Vec<u32>, Fault> {
    let Some(index) = request.primitive.indices else {
        document.spend(&request.place, count, size_of::<u32>())?;
        return Ok((0..count as u32).collect());
    };
    let place = format!("{}/indices", request.place);
    let accessor = Accessor::open(document, index, &place, &INDICES)?;
    let indices = accessor.integers::<1>(document, &Selection::All)?.into_flattened();
    match indices.iter().position(|&index| index as usize >= count) {
        None => Ok(indices),
        Some(at) => {
            let found = format!("{} in element {at}", indices[at]);
            Err(Fault::new(place, format!("vertex indices below {count}"), found))
        }
    }
}

/// Makes the triangles of a list, strip or fan, all with the same orientation. Also returns the
/// number of vertices at the end that make no triangle.
fn triangles(mode: Mode, v: &[u32]) -> (Vec<[u32; 3]>, usize) {
    match mode {
        Mode::TriangleStrip => {
            let pairs = v.windows(3).enumerate();
            let strip = pairs.map(|(i, t)| if i % 2 == 0 { [t[0], t[1], t[2]] } else { [t[0], t[2], t[1]] });
            (strip.collect(), if v.len() < 3 { v.len() } else { 0 })
        }
        Mode::TriangleFan => {
            let (hub, rim) = v.split_first().map_or((0, v), |(&hub, rim)| (hub, rim));
            let fan = rim.windows(2).map(|pair| [pair[0], pair[1], hub]);
            (fan.collect(), if v.len() < 3 { v.len() } else { 0 })
        }
        _ => {
            let (list, rest) = v.as_chunks::<3>();
            (list.to_vec(), rest.len())
        }
    }
}

/// Selects the vertices that the triangles use, and renumbers the triangles' corners. Primitives
/// often share one long list of vertices, of which each uses only a few.
fn select_used_vertices(triangles: &mut [[u32; 3]], count: usize) -> Selection {
    let corners = triangles.as_flattened_mut();
    let used: Vec<u32> = if corners.len() < count / 16 {
        let mut used = corners.to_vec();
        used.sort_unstable();
        used.dedup();
        used
    } else {
        let mut is_used = vec![false; count];
        corners.iter().for_each(|&vertex| is_used[vertex as usize] = true);
        (0..count as u32).filter(|&vertex| is_used[vertex as usize]).collect()
    };
    if used.len() == count {
        return Selection::All;
    }
    for vertex in corners {
        // the search succeeds, since `used` holds every vertex of the corners
        *vertex = used.binary_search(vertex).unwrap_or_default() as u32;
    }
    Selection::Some(used)
}

/// Adds the offsets of the morph targets, times their weights, to the mesh.
fn morph(
    attributes: &Attributes<'_, '_>,
    weights: &[f32],
    mesh: &mut Mesh,
    selection: &Selection,
    count: usize,
) -> Result<(), Fault> {
    let document = attributes.document;
    let targets = attributes.primitive.targets.iter().flatten();
    for (i, (target, &weight)) in targets.zip(weights).enumerate() {
        if weight == 0.0 {
            continue;
        }
        // read the offsets of this target, and add them to the values of the mesh
        let place = |name: &str| format!("{}/targets/{i}/{name}", attributes.place);
        let read = |index: Option<json::Index<json::Accessor>>, name: &str, format: &Format| {
            let Some(index) = index else { return Ok(None) };
            let accessor = attributes.open_index(index, &place(name), format, Some(count))?;
            accessor.finite::<3>(document, selection, 0.0).map(Some)
        };
        let add = |deltas: Option<Vec<[f32; 3]>>, values: &mut [Vec3]| {
            for (value, delta) in values.iter_mut().zip(deltas.unwrap_or_default()) {
                *value += weight * Vec3::from(delta);
            }
        };
        add(read(target.positions, "POSITION", &POSITION)?, &mut mesh.positions);
        add(read(target.normals, "NORMAL", &NORMAL)?, &mut mesh.normals);
        if let Some(deltas) = read(target.tangents, "TANGENT", &NORMAL)? {
            for (tangent, delta) in mesh.tangents.iter_mut().zip(deltas) {
                *tangent += (weight * Vec3::from(delta)).extend(0.0);
            }
        }
    }
    Ok(())
}

fn clamp_colors(document: &Document<'_>, place: &str, colors: Vec<[f32; 4]>) -> Vec<Vec4> {
    let mut any = false;
    let clamp = |color: [f32; 4]| {
        let color = Vec4::from(color);
        let clamped = color.clamp(Vec4::ZERO, Vec4::ONE);
        any |= clamped != color;
        clamped
    };
    let clamped = colors.into_iter().map(clamp).collect();
    if any {
        document.task.warn(format!("{place}/attributes/COLOR_0"), "colours outside 0..1 are clamped");
    }
    clamped
}

/// Makes tangents unit vectors with handedness ±1. If any tangent has no direction, all are
/// dropped, and the validator generates tangents where they are needed.
fn mend_tangents(document: &Document<'_>, mesh: &mut Mesh) {
    let mended: Option<Vec<Vec4>> = mesh
        .tangents
        .iter()
        .map(|tangent| {
            let direction = tangent.truncate().try_normalize()?;
            Some(direction.extend(if tangent.w < 0.0 { -1.0 } else { 1.0 }))
        })
        .collect();
    mesh.tangents = mended.unwrap_or_else(|| {
        document.task.warn(&mesh.place, "some tangents have no direction; all tangents of the primitive are replaced by generated ones where a material needs them");
        Vec::new()
    });
}

fn vec3s(values: Vec<[f32; 3]>) -> Vec<Vec3> {
    values.into_iter().map(Vec3::from).collect()
}
