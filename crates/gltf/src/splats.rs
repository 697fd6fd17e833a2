//! `KHR_gaussian_splatting`: primitives of points that are Gaussian splats, from accessors or from
//! an SPZ stream.

use glam::{DAffine3, DQuat, Quat, Vec3};
use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use lumistack_scene::{Cloud, Encoding};

use crate::accessor::{Accessor, Format, Selection};
use crate::document::Document;
use crate::error::Fault;
use crate::fields::Fields;
use crate::unpack::{self, Unpacked};

use ComponentType::{F32, I8, I16, U8, U16};

const NAME: &str = "KHR_gaussian_splatting";
const SPZ: &str = "KHR_gaussian_splatting_compression_spz_2";

const POSITION: Format = Format {
    types: &[Type::Vec3],
    components: &[F32, I8, U8, I16, U16],
    text: "VEC3 of FLOAT, or of 8- or 16-bit integers (KHR_mesh_quantization)",
};
const ROTATION: Format =
    Format { types: &[Type::Vec4], components: &[F32, I8, I16], text: "VEC4 of FLOAT, or normalized BYTE or SHORT" };
const SCALE: Format = Format {
    types: &[Type::Vec3],
    components: &[F32, U8, U16],
    text: "VEC3 of FLOAT, UNSIGNED_BYTE or UNSIGNED_SHORT",
};
const OPACITY: Format = Format {
    types: &[Type::Scalar],
    components: &[F32, U8, U16],
    text: "SCALAR of FLOAT, or normalized UNSIGNED_BYTE or UNSIGNED_SHORT",
};
const HARMONIC: Format = Format { types: &[Type::Vec3], components: &[F32], text: "VEC3 of FLOAT" };

/// Splats of a primitive, with their placement in the mesh.
pub(crate) struct Splats {
    pub(crate) cloud: Cloud,
    pub(crate) mesh_from_cloud: DAffine3,
}

/// Returns true if the primitive at `place` has splats.
pub(crate) fn is_splats(document: &Document<'_>, place: &str) -> bool {
    document.json(&format!("{place}/extensions/{NAME}")).is_some()
}

/// Reads the splats of a primitive.
pub(crate) fn load(document: &Document<'_>, place: &str) -> Result<Splats, Fault> {
    document.task.cancel.check()?;
    let here = format!("{place}/extensions/{NAME}");
    let mode = document.json(&format!("{place}/mode")).and_then(serde_json::Value::as_u64).unwrap_or(4);
    if mode != 0 {
        return Err(Fault::new(format!("{place}/mode"), "0 (POINTS), as splats have", mode));
    }
    // An unknown value is replaced by the value that the warning names.
    let text = |key: &str| document.json(&format!("{here}/{key}")).and_then(serde_json::Value::as_str);
    let encoding = match text("colorSpace") {
        Some("srgb_rec709_display") => Encoding::Srgb,
        Some("lin_rec709_display") => Encoding::Linear,
        other => {
            let found = other.map_or_else(|| "none".to_owned(), |name| format!("`{name}`"));
            document
                .task
                .warn(&here, format!("expected the colorSpace srgb_rec709_display or lin_rec709_display, found {found}; srgb_rec709_display is used"));
            Encoding::Srgb
        }
    };
    for (key, known) in [("kernel", "ellipse"), ("projection", "perspective"), ("sortingMethod", "cameraDistance")] {
        if let Some(found) = text(key).filter(|found| *found != known) {
            document
                .task
                .warn(format!("{here}/{key}"), format!("expected `{known}`, found `{found}`; `{known}` is used"));
        }
    }
    if let Some(packed) = Fields::at(document, format!("{here}/extensions/{SPZ}"))? {
        let view = document.view(packed.needed_index("bufferView")?, &packed.place("bufferView"))?;
        let packed = unpack::Packed::Spz { bytes: view.bytes, max_bytes: document.affordable_bytes() };
        let found = document.unpack(&view.place, &packed, |unpacked| match unpacked {
            Unpacked::Splats(found) => Some(found),
            _ => None,
        })?;
        document.spend(place, found.cloud.bytes(), 1)?;
        found.left_out.into_iter().for_each(|message| document.task.warn(place, message));
        let cloud = Cloud { place: place.to_owned(), encoding, ..found.cloud };
        // SPZ has x to the right and z to the back, glTF has x to the left and z to the front. A
        // half turn about y converts the axes of SPZ to those of glTF.
        let mesh_from_cloud = DAffine3::from_quat(DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0));
        return Ok(Splats { cloud, mesh_from_cloud });
    }
    from_accessors(document, place, encoding).map(|cloud| Splats { cloud, mesh_from_cloud: DAffine3::IDENTITY })
}

fn from_accessors(document: &Document<'_>, place: &str, encoding: Encoding) -> Result<Cloud, Fault> {
    let at = |name: &str| format!("{place}/attributes/{name}");
    let open = |name: &str, format: &Format, count: Option<usize>| -> Result<Option<Accessor<'_>>, Fault> {
        let place = at(name);
        let Some(value) = document.json(&place) else { return Ok(None) };
        let index = value.as_u64().and_then(|index| u32::try_from(index).ok());
        let index = index.ok_or_else(|| Fault::new(&place, "an index of an accessor", document.quote(&place)))?;
        let accessor = Accessor::open(document, json::Index::new(index), &place, format)?;
        match count {
            Some(count) if count != accessor.count => {
                Err(Fault::new(place, format!("{count} elements, as POSITION has"), accessor.count))
            }
            _ => Ok(Some(accessor)),
        }
    };
    let own = |name: &str| format!("{NAME}:{name}");
    let needed = |name: &str, format: &Format, count: Option<usize>| {
        open(name, format, count)?.ok_or_else(|| Fault::new(at(name), "an attribute that splats need", "none"))
    };
    let positions = needed("POSITION", &POSITION, None)?;
    let count = Some(positions.count);
    let all = &Selection::All;
    // values are not checked here: the validator drops splats that are not finite or out of range
    let positions = positions.floats::<3>(document, all, 0.0)?;
    let rotations = needed(&own("ROTATION"), &ROTATION, count)?.assume_normalized().floats::<4>(document, all, 0.0)?;
    let scales = needed(&own("SCALE"), &SCALE, count)?.floats::<3>(document, all, 0.0)?;
    let opacities = needed(&own("OPACITY"), &OPACITY, count)?.assume_normalized().floats::<1>(document, all, 0.0)?;
    // read the spherical harmonics up to the first degree that is absent; a degree that is present
    // must have all of its coefficients
    let mut harmonics = Vec::new();
    for degree in 0..=lumistack_scene::MAX_DEGREE {
        let mut of_degree = Vec::new();
        for order in 0..2 * degree + 1 {
            let name = own(&format!("SH_DEGREE_{degree}_COEF_{order}"));
            if let Some(accessor) = open(&name, &HARMONIC, count)? {
                of_degree.push(accessor.floats::<3>(document, all, 0.0)?);
            }
        }
        match of_degree.len() {
            0 if degree > 0 => break,
            found if found == 2 * degree + 1 => harmonics.extend(of_degree),
            found => {
                let expected = format!("every coefficient of degree {degree} ({} in all)", 2 * degree + 1);
                return Err(Fault::new(format!("{place}/attributes"), expected, found));
            }
        }
    }
    // `harmonics` is ordered by coefficient, then by splat. A cloud has all coefficients of a splat
    // together, so reorder them.
    let count = positions.len();
    document.spend(place, count, harmonics.len() * size_of::<[f32; 3]>())?;
    let interleaved = (0..count).flat_map(|i| harmonics.iter().flat_map(move |of_all| of_all[i]));
    Ok(Cloud {
        place: place.to_owned(),
        positions: positions.into_iter().map(Vec3::from).collect(),
        rotations: rotations.into_iter().map(Quat::from_array).collect(),
        scales: scales.into_iter().map(Vec3::from).collect(),
        opacities: opacities.into_iter().map(|[opacity]| opacity).collect(),
        degree: (harmonics.len() as f64).sqrt() as usize - 1,
        harmonics: interleaved.collect(),
        encoding,
    })
}
