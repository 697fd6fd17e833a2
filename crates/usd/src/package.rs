//! Scene packages: a JSON header, and arrays to which the header refers. The walker, which is the
//! Python code that reads a stage, writes the packages.
//!
//! A file consists of the magic `LUMIPKG1`, the header's length as a little-endian u64, the header,
//! and the arrays. Each array starts at a multiple of 64 bytes; `buffers` in the header lists their
//! offsets. Within one process the arrays are passed without a file.
//!
//! Packages are not trusted: every number is checked before its use, and no content can cause a
//! panic.

use serde::Deserialize;

use crate::error::Fault;

/// The first bytes of every package.
const MAGIC: &[u8; 8] = b"LUMIPKG1";
/// Arrays start at multiples of this number of bytes.
const ALIGNMENT: usize = 64;
/// The value that `schema` must have in a package's header.
const SCHEMA: &str = "lumistack.scene-package";

/// A scene as the walker writes it. The walker is the Python program that reads a stage.
pub struct Package<'a> {
    /// The scene, without its arrays.
    pub header: Header,
    /// Raw little-endian arrays; the header refers to them by index.
    pub buffers: Vec<&'a [u8]>,
}

/// The JSON header of a package.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Header {
    /// Always `lumistack.scene-package`.
    pub schema: String,
    /// Always 1.
    pub version: u32,
    /// The reason why the walker has no scene; `None` if it has one.
    pub error: Option<Failure>,
    /// Display name of the stage's root layer.
    pub name: String,
    /// "Y" or "Z": the axis that points up.
    pub up_axis: String,
    /// Metres per unit of length of the stage.
    pub meters_per_unit: f64,
    /// Path of every layer and texture on disk that was read.
    pub files: Vec<String>,
    /// Warnings of the walker for the user.
    pub warnings: Vec<Note>,
    /// The file's variant sets, cameras and time range, and its numbers of prims, meshes and
    /// points.
    pub contents: Contents,
    pub(crate) geometries: Vec<Shape>,
    pub(crate) instances: Vec<Placement>,
    pub(crate) materials: Vec<serde_json::Value>,
    pub(crate) images: Vec<serde_json::Value>,
    pub(crate) lights: Vec<serde_json::Value>,
    pub(crate) cameras: Vec<CameraEntry>,
    /// Offset and length of every array in a file, in bytes. Offsets are relative to the first
    /// multiple of 64 after the header.
    buffers: Vec<[u64; 2]>,
}

/// The reason why the walker has no scene.
#[derive(Clone, Debug, Deserialize)]
pub struct Failure {
    /// `python` (too old), `pxr` (no OpenUSD), `scene` (the file is refused), or `walker` (an error
    /// in the walker).
    pub kind: String,
    /// The reason, for the user. For an error in the walker this is Python's traceback.
    pub message: String,
}

/// A warning that the walker wrote into the package.
#[derive(Clone, Debug, Deserialize)]
pub struct Note {
    /// Path of the prim to which the warning applies.
    pub place: String,
    /// The warning, as one sentence.
    pub message: String,
}

/// The choices that a stage offers, and its numbers of prims, meshes and points.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Contents {
    /// Variant sets, except variant sets inside instances.
    pub variant_sets: Vec<VariantSet>,
    /// Paths of cameras.
    pub cameras: Vec<String>,
    /// First and last time code, if the file has them.
    pub time_range: Option<TimeRange>,
    /// Number of prims that OpenUSD's default traversal visits.
    pub prims: usize,
    /// Number of meshes that OpenUSD's default traversal visits.
    pub meshes: usize,
    /// Number of points of the counted meshes.
    pub points: usize,
}

/// A set of variants of a prim.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct VariantSet {
    /// Place of the set in the stage, `/prim{set}`.
    pub place: String,
    /// Names of the variants in the set.
    pub choices: Vec<String>,
    /// Name of the selected variant; empty if none is selected.
    pub selected: String,
}

/// The time codes of a stage's animation.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct TimeRange {
    /// First and last time code of the animation.
    pub time_codes: [f64; 2],
    /// Number of time codes per second.
    pub time_codes_per_second: f64,
}

impl TimeRange {
    /// Returns the time from the first time code to the last, in seconds.
    pub fn duration_s(&self) -> f64 {
        (self.time_codes[1] - self.time_codes[0]) / self.time_codes_per_second
    }
}

/// A shape, in its own coordinates.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[expect(clippy::large_enum_variant, reason = "nearly all shapes are meshes")]
pub(crate) enum Shape {
    Mesh(MeshEntry),
    Solid(SolidEntry),
    Curves(CurvesEntry),
    Points(PointsEntry),
    Splats(SplatsEntry),
}

impl Shape {
    pub(crate) fn place(&self) -> &str {
        match self {
            Self::Mesh(mesh) => &mesh.place,
            Self::Solid(solid) => &solid.place,
            Self::Curves(curves) => &curves.place,
            Self::Points(points) => &points.place,
            Self::Splats(splats) => &splats.place,
        }
    }
}

/// A polygon mesh or a subdivision surface (`UsdGeomMesh`).
#[derive(Clone, Debug, Default, Deserialize)]
pub(crate) struct MeshEntry {
    pub(crate) place: String,
    pub(crate) points: Option<Array>,
    pub(crate) counts: Option<Array>,
    /// For every corner of a face, the index of its point.
    pub(crate) indices: Option<Array>,
    #[serde(default)]
    pub(crate) left_handed: bool,
    /// True if the file declares that only the front of the mesh is visible.
    #[serde(default)]
    pub(crate) one_sided: bool,
    /// Indices of faces that are holes in the mesh.
    pub(crate) holes: Option<Array>,
    #[serde(default)]
    pub(crate) primvars: Vec<Primvar>,
    #[serde(default)]
    pub(crate) subsets: Vec<Subset>,
    /// Emission of the mesh, if the mesh is a light.
    #[serde(default)]
    pub(crate) light: Option<serde_json::Value>,
    /// Rules of subdivision; `None` for a plain polygon mesh.
    #[serde(default)]
    pub(crate) subdivision: Option<Subdivision>,
}

/// A primvar: values of an attribute over a surface.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Primvar {
    pub(crate) name: String,
    pub(crate) interpolation: String,
    pub(crate) values: Array,
    #[serde(default)]
    pub(crate) indices: Option<Array>,
}

/// A subset of a mesh's faces that has its own material.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Subset {
    pub(crate) place: String,
    pub(crate) faces: Array,
}

/// Parameters of a subdivision surface, in addition to its control mesh.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Subdivision {
    pub(crate) scheme: String,
    #[serde(default)]
    pub(crate) interpolate_boundary: String,
    #[serde(default)]
    pub(crate) face_varying: String,
    #[serde(default)]
    pub(crate) triangle_rule: String,
    #[serde(default)]
    pub(crate) crease_indices: Option<Array>,
    #[serde(default)]
    pub(crate) crease_lengths: Option<Array>,
    #[serde(default)]
    pub(crate) crease_sharpnesses: Option<Array>,
    #[serde(default)]
    pub(crate) corner_indices: Option<Array>,
    #[serde(default)]
    pub(crate) corner_sharpnesses: Option<Array>,
}

/// A shape that a formula describes, for example a sphere (`UsdGeomSphere`).
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct SolidEntry {
    pub(crate) place: String,
    /// Name of the shape: `sphere`, `cube`, `cylinder`, `cone`, `capsule` or `plane`.
    pub(crate) solid: String,
    /// Sizes of the shape: radii before the height, and the width before the length, as in `SOLIDS`
    /// of `python/shapes.py`.
    pub(crate) sizes: Vec<f32>,
    /// Axis of the shape: `x`, `y` or `z`.
    #[serde(default)]
    pub(crate) axis: String,
    #[serde(default)]
    pub(crate) primvars: Vec<Primvar>,
}

/// Curves (`UsdGeomBasisCurves`).
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct CurvesEntry {
    pub(crate) place: String,
    pub(crate) points: Option<Array>,
    pub(crate) counts: Option<Array>,
    pub(crate) curve_type: String,
    pub(crate) curve_basis: String,
    pub(crate) curve_wrap: String,
    pub(crate) widths: Option<Array>,
    #[serde(default)]
    pub(crate) widths_interpolation: String,
    #[serde(default)]
    pub(crate) normals: Option<Array>,
    #[serde(default)]
    pub(crate) normals_interpolation: String,
    #[serde(default)]
    pub(crate) primvars: Vec<Primvar>,
}

/// Points (`UsdGeomPoints`).
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct PointsEntry {
    pub(crate) place: String,
    pub(crate) points: Option<Array>,
    pub(crate) widths: Option<Array>,
    #[serde(default)]
    pub(crate) primvars: Vec<Primvar>,
}

/// Splats: `UsdVolParticleField3DGaussianSplat`, or a `ParticleField` with a Gaussian kernel.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct SplatsEntry {
    pub(crate) place: String,
    #[serde(default)]
    pub(crate) positions: Option<Array>,
    /// Rotations of the splats as quaternions `[n][4]`: i, j, k, real.
    #[serde(default)]
    pub(crate) orientations: Option<Array>,
    #[serde(default)]
    pub(crate) scales: Option<Array>,
    #[serde(default)]
    pub(crate) opacities: Option<Array>,
    /// Coefficients of the spherical harmonics, `[n · (degree + 1)²][3]`.
    #[serde(default)]
    pub(crate) harmonics: Option<Array>,
    pub(crate) degree: i64,
    /// True if splats are flat: discs in their own xy plane.
    #[serde(default)]
    pub(crate) flat: bool,
    /// USD's name of the colour space of the splats' colours; empty if the file names none.
    #[serde(default)]
    pub(crate) colour_space: String,
}

/// Copies of one shape, which one chain of links places.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Placement {
    pub(crate) geometry: usize,
    /// Index of the shape's material, then the index of the material of each subset. `None` stands
    /// for no material.
    pub(crate) materials: Vec<Option<usize>>,
    /// Links from the shape's space to the stage, the innermost first.
    pub(crate) chain: Vec<Link>,
}

/// A link in the chain of transforms from a shape to the stage. For each of its matrices, the link
/// makes one copy of everything that the earlier links place.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Link {
    /// Matrices `[n][4][4]` for row vectors, as in USD: the translation is the last row.
    pub(crate) matrices: Array,
    /// Index of the prototype that each matrix places, `[n]`. Matrices whose index differs from
    /// `prototype` do not apply to this chain. Without this array all matrices apply.
    #[serde(default)]
    pub(crate) prototypes: Option<Array>,
    /// Index of the prototype that this chain places.
    #[serde(default)]
    pub(crate) prototype: i64,
    /// Visibility of each copy, `[n]`: 0 for a hidden copy.
    #[serde(default)]
    pub(crate) mask: Option<Array>,
}

/// A camera (`UsdGeomCamera`).
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct CameraEntry {
    pub(crate) place: String,
    pub(crate) projection: String,
    pub(crate) focal_length: f64,
    /// Width and height of the camera's aperture, in the unit of the focal length.
    pub(crate) aperture: [f64; 2],
    pub(crate) aperture_offset: [f64; 2],
    pub(crate) focus_distance: f64,
    /// Distance of the camera's near plane, if the file sets it.
    #[serde(default)]
    pub(crate) near: Option<f64>,
    /// Matrix from the camera's space to the stage, for row vectors as in USD.
    pub(crate) matrix: [f64; 16],
}

/// A reference to an array of numbers in the package.
#[derive(Clone, Debug, Deserialize)]
pub struct Array {
    /// Index of the array in [`Package::buffers`].
    pub buffer: usize,
    /// Type of the numbers: `f16`, `f32`, `f64`, or an integer type, `i8` to `i64` or `u8` to
    /// `u64`.
    #[serde(rename = "type")]
    pub kind: String,
    /// Length of every axis of the array.
    pub shape: Vec<usize>,
}

impl Header {
    /// Parses the JSON header of a package.
    ///
    /// # Errors
    /// The reason, as a phrase after "found".
    pub fn parse(json: &[u8]) -> Result<Self, String> {
        let header: Self =
            serde_json::from_slice(json).map_err(|error| format!("a scene package with a broken header: {error}"))?;
        if header.schema != SCHEMA || header.version != 1 {
            return Err(format!("a package of the schema {:?}, version {}", header.schema, header.version));
        }
        Ok(header)
    }
}

impl<'a> Package<'a> {
    /// Parses a package: its header, and the range of bytes of every array.
    ///
    /// # Errors
    /// The reason, as a phrase after "found".
    pub fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| match bytes.is_empty() {
            true => "nothing".to_owned(),
            false => "data that is not a scene package".to_owned(),
        })?;
        let truncated = || "a scene package that ends too early".to_owned();
        let (length, rest) = rest.split_first_chunk::<8>().ok_or_else(truncated)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| truncated())?;
        let (header, rest) = rest.split_at_checked(length).ok_or_else(truncated)?;
        let mut header = Header::parse(header)?;
        let padding = (MAGIC.len() + 8 + length).next_multiple_of(ALIGNMENT) - (MAGIC.len() + 8 + length);
        let data = rest.get(padding..).unwrap_or_default();
        let buffer = |[offset, length]: [u64; 2]| {
            let start = usize::try_from(offset).ok()?;
            data.get(start..start.checked_add(usize::try_from(length).ok()?)?)
        };
        let places = std::mem::take(&mut header.buffers);
        let buffers = places.into_iter().map(|place| buffer(place).ok_or_else(truncated)).collect::<Result<_, _>>()?;
        Ok(Self { header, buffers })
    }

    /// Returns the raw bytes of an array and its number of rows. A row has `width` elements.
    fn bytes(&self, array: &Array, width: usize, place: &str) -> Result<(&'a [u8], usize), Fault> {
        let fault = |expected: String, found: String| Fault::new(place, expected, found);
        let size = match array.kind.as_str() {
            "i8" | "u8" => 1,
            "f16" | "i16" | "u16" => 2,
            "f32" | "i32" | "u32" => 4,
            "f64" | "i64" | "u64" => 8,
            other => return Err(fault("numbers of 8 to 64 bits".into(), format!("type {other}"))),
        };
        let rows = array.shape.first().copied().unwrap_or(0);
        let row: Option<usize> = array.shape.iter().skip(1).try_fold(1usize, |product, &n| product.checked_mul(n));
        if row != Some(width) {
            return Err(fault(format!("rows of {width} numbers"), format!("shape {:?}", array.shape)));
        }
        let bytes = self.buffers.get(array.buffer).copied();
        let bytes = bytes
            .ok_or_else(|| fault(format!("a buffer index below {}", self.buffers.len()), array.buffer.to_string()))?;
        let wanted = rows.checked_mul(width).and_then(|count| count.checked_mul(size));
        if wanted != Some(bytes.len()) {
            let found = format!("{} bytes of type {} for shape {:?}", bytes.len(), array.kind, array.shape);
            return Err(fault("the number of bytes that the shape needs".into(), found));
        }
        Ok((bytes, rows))
    }

    /// Returns the rows of an array, converted to `f32`. A row has `N` numbers.
    pub(crate) fn reals<const N: usize>(&self, array: &Array, place: &str) -> Result<Vec<[f32; N]>, Fault> {
        let (bytes, rows) = self.bytes(array, N, place)?;
        let values: Vec<f32> = match array.kind.as_str() {
            "f32" => numbers(bytes, f32::from_le_bytes).collect(),
            "f64" => numbers(bytes, f64::from_le_bytes).map(|value| value as f32).collect(),
            "f16" => numbers(bytes, u16::from_le_bytes).map(from_half).collect(),
            other => return Err(Fault::new(place, "numbers of type f16, f32 or f64", format!("type {other}"))),
        };
        let mut chunks = values.as_chunks::<N>().0.to_vec();
        chunks.truncate(rows);
        Ok(chunks)
    }

    /// Returns the numbers of an array of integers.
    pub(crate) fn integers(&self, array: &Array, place: &str) -> Result<Vec<i64>, Fault> {
        let (bytes, _) = self.bytes(array, 1, place)?;
        Ok(match array.kind.as_str() {
            "i32" => numbers(bytes, i32::from_le_bytes).map(i64::from).collect(),
            "u32" => numbers(bytes, u32::from_le_bytes).map(i64::from).collect(),
            "i64" => numbers(bytes, i64::from_le_bytes).collect(),
            "i8" => bytes.iter().map(|&byte| i64::from(byte as i8)).collect(),
            "u8" => bytes.iter().map(|&byte| i64::from(byte)).collect(),
            other => {
                return Err(Fault::new(place, "integers of type i8, u8, i32, u32 or i64", format!("type {other}")));
            }
        })
    }

    /// Returns the 4 × 4 matrices of an array, each as 16 numbers, row by row.
    pub(crate) fn matrices(&self, array: &Array, place: &str) -> Result<Vec<[f64; 16]>, Fault> {
        let (bytes, _) = self.bytes(array, 16, place)?;
        let values: Vec<f64> = match array.kind.as_str() {
            "f64" => numbers(bytes, f64::from_le_bytes).collect(),
            other => return Err(Fault::new(place, "matrices of type f64", format!("type {other}"))),
        };
        Ok(values.as_chunks::<16>().0.to_vec())
    }
}

fn numbers<'b, T, const N: usize>(bytes: &'b [u8], convert: fn([u8; N]) -> T) -> impl Iterator<Item = T> + 'b
where
    T: 'b,
{
    bytes.as_chunks::<N>().0.iter().map(move |&chunk| convert(chunk))
}

/// Converts an IEEE 754 binary16 number.
fn from_half(bits: u16) -> f32 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    sign * match exponent {
        0 => mantissa * 2f32.powi(-24),
        31 if mantissa == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1024.0 + mantissa) * 2f32.powi(exponent - 25),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Makes a package with one array, for these tests.
    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend((header.len() as u64).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.resize(bytes.len().next_multiple_of(ALIGNMENT), 0);
        bytes.extend(data);
        bytes
    }

    const HEADER: &str = r#"{"schema": "lumistack.scene-package", "version": 1, "buffers": [[0, 24]], "later": 1}"#;

    fn array(kind: &str, shape: &[usize]) -> Array {
        Array { buffer: 0, kind: kind.into(), shape: shape.into() }
    }

    #[test]
    fn arrays_come_back_and_every_cut_is_an_error() {
        let data: Vec<u8> = [1.0f32, 2.0, 3.0, -4.0, 5.5, 6.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let bytes = file(HEADER, &data);
        let package = Package::parse(&bytes).unwrap();
        let rows = package.reals::<3>(&array("f32", &[2, 3]), "a").unwrap();
        assert_eq!(rows, [[1.0, 2.0, 3.0], [-4.0, 5.5, 6.0]]);
        for cut in 0..bytes.len() {
            assert!(Package::parse(&bytes[..cut]).is_err(), "cut at {cut}");
        }
    }

    #[test]
    fn shapes_and_types_that_lie_are_errors() {
        let bytes = file(HEADER, &[0; 24]);
        let package = Package::parse(&bytes).unwrap();
        for (kind, shape) in [
            ("f32", vec![3, 3]),
            ("f32", vec![2, 2]),
            ("f32", vec![]),
            ("f32", vec![usize::MAX, 3]),
            ("f32", vec![2, usize::MAX, usize::MAX]),
            ("i32", vec![2, 3]),
            ("f128", vec![2, 3]),
        ] {
            assert!(package.reals::<3>(&array(kind, &shape), "a").is_err(), "{kind} {shape:?}");
        }
        assert!(package.reals::<3>(&Array { buffer: 1, ..array("f32", &[2, 3]) }, "a").is_err());
        assert!(package.matrices(&array("f64", &[1, 4, 4]), "a").is_err());
        assert_eq!(package.integers(&array("i64", &[3]), "a").unwrap(), [0; 3]);
    }

    #[test]
    fn garbage_and_silence_have_their_own_messages() {
        assert_eq!(Package::parse(b"").err().unwrap(), "nothing");
        assert!(Package::parse(b"Traceback (most recent call last)").err().unwrap().contains("not a scene package"));
        let huge = [MAGIC.as_slice(), &u64::MAX.to_le_bytes()].concat();
        assert!(Package::parse(&huge).err().unwrap().contains("too early"));
        assert!(Package::parse(&file("{]", &[])).err().unwrap().contains("broken header"));
        assert!(Package::parse(&file("{}", &[])).err().unwrap().contains("version 0"));
    }

    #[test]
    fn halves_are_exact() {
        let known = [
            (0x0000, 0.0),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0001, 2f32.powi(-24)),
            (0x3555, 0.333_251_95),
        ];
        for (bits, value) in known {
            assert_eq!(from_half(bits), value);
        }
        assert!(from_half(0x7e00).is_nan() && from_half(0xfc00) == f32::NEG_INFINITY);
    }
}
