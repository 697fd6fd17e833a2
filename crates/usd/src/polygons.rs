//! A checked polygon mesh of a scene package: indices of points and of values are in range, and
//! every attribute has a value for each of its elements.

use crate::error::Fault;
use crate::package::{MeshEntry, Package, Primvar};

/// A polygon mesh: its points, faces, and attributes over them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Polygons {
    pub(crate) points: Vec<[f32; 3]>,
    /// Number of corners of each face, ≥ 0. The sum of these numbers is the length of
    /// [`corners`](Self::corners).
    pub(crate) counts: Vec<i32>,
    /// For every corner of a face, the index of its point.
    pub(crate) corners: Vec<i32>,
    pub(crate) left_handed: bool,
    /// Indices of faces that are holes; an index may be out of range.
    pub(crate) holes: Vec<i32>,
    pub(crate) normals: Option<Attribute<3>>,
    pub(crate) uvs: [Option<Attribute<2>>; 2],
    pub(crate) colors: Option<Attribute<3>>,
    pub(crate) opacities: Option<Attribute<1>>,
}

/// A primvar of the mesh: its values, and the elements to which they belong.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Attribute<const N: usize> {
    pub(crate) values: Vec<[f32; N]>,
    pub(crate) interpolation: Interpolation,
    /// For each element that has a value, the index of the value. Without this list, element i has
    /// value i.
    pub(crate) indices: Option<Vec<u32>>,
}

/// States which elements of a mesh have values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Interpolation {
    /// The whole mesh has one value.
    Constant,
    /// Every face has a value.
    Uniform,
    /// Every point has a value. Subdivision does not smooth these values.
    Varying,
    /// Every point has a value.
    Vertex,
    /// Every corner of every face has a value.
    FaceVarying,
}

/// A corner of a face: the index of the face, of the point, and of the corner among all corners.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corner {
    pub(crate) face: usize,
    pub(crate) point: usize,
    pub(crate) corner: usize,
}

impl<const N: usize> Attribute<N> {
    /// Returns the index of the value that applies at a corner.
    pub(crate) fn index(&self, at: Corner) -> usize {
        let element = match self.interpolation {
            Interpolation::Constant => 0,
            Interpolation::Uniform => at.face,
            Interpolation::Varying | Interpolation::Vertex => at.point,
            Interpolation::FaceVarying => at.corner,
        };
        self.indices.as_ref().map_or(element, |indices| indices[element] as usize)
    }

    pub(crate) fn at(&self, at: Corner) -> [f32; N] {
        self.values[self.index(at)]
    }

    /// Returns true if the interpolation gives all corners at a point the same value.
    pub(crate) fn is_smooth(&self) -> bool {
        matches!(self.interpolation, Interpolation::Constant | Interpolation::Varying | Interpolation::Vertex)
    }
}

/// Names of the primvars that become the texture coordinate sets 0 and 1.
pub(crate) type UvNames<'a> = [Option<&'a str>; 2];

/// Reads a mesh; `warn` receives a message for each primvar that is left out.
///
/// # Errors
/// If an array cannot be read, if the topology is inconsistent, or if a coordinate is not finite.
pub(crate) fn read(
    package: &Package<'_>,
    entry: &MeshEntry,
    uv_names: UvNames<'_>,
    warn: &mut dyn FnMut(String),
) -> Result<Polygons, Fault> {
    let place = entry.place.as_str();
    let list = |array: &Option<crate::package::Array>, name: &str| match array {
        Some(array) => package.integers(array, &format!("{place}.{name}")),
        None => Ok(Vec::new()),
    };
    // Check the topology, since later steps use indices without checks.
    let points = match &entry.points {
        Some(array) => package.reals::<3>(array, &format!("{place}.points"))?,
        None => Vec::new(),
    };
    if let Some(at) = points.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
        return Err(Fault::new(format!("{place}.points[{at}]"), "finite coordinates", format!("{:?}", points[at])));
    }
    let counts = list(&entry.counts, "faceVertexCounts")?;
    let corners = list(&entry.indices, "faceVertexIndices")?;
    if let Some(at) = counts.iter().position(|&count| count < 0) {
        return Err(Fault::new(format!("{place}.faceVertexCounts[{at}]"), "0 or more corners", counts[at]));
    }
    let wanted: i64 = counts.iter().fold(0, |sum, &count| sum.saturating_add(count));
    if wanted != corners.len() as i64 {
        let expected = format!("{wanted} indices, the sum of faceVertexCounts");
        return Err(Fault::new(format!("{place}.faceVertexIndices"), expected, corners.len()));
    }
    if let Some(at) = corners.iter().position(|&point| !(0..points.len() as i64).contains(&point)) {
        let expected = format!("the index of a point, below {}", points.len());
        return Err(Fault::new(format!("{place}.faceVertexIndices[{at}]"), expected, corners[at]));
    }
    // Read the primvars that the scene supports.
    let sizes = Sizes { faces: counts.len(), points: points.len(), corners: corners.len() };
    let find = |name: &str| entry.primvars.iter().find(|primvar| primvar.name == name);
    let mut reader = Reader { package, place, sizes, warn };
    let mut polygons = Polygons {
        normals: reader.attribute(find("normals")),
        uvs: uv_names.map(|name| reader.attribute(name.and_then(find))),
        colors: reader.attribute(find("displayColor")),
        opacities: reader.attribute(find("displayOpacity")),
        left_handed: entry.left_handed,
        ..Polygons::default()
    };
    // the conversions cannot fail, since the checks above limit all values
    polygons.counts = counts.into_iter().map(|count| count as i32).collect();
    polygons.corners = corners.into_iter().map(|point| point as i32).collect();
    polygons.holes = list(&entry.holes, "holeIndices")?.into_iter().filter_map(|face| face.try_into().ok()).collect();
    polygons.points = points;
    Ok(polygons)
}

/// Number of faces, points and corners of a mesh.
struct Sizes {
    faces: usize,
    points: usize,
    corners: usize,
}

struct Reader<'a, 'w> {
    package: &'a Package<'a>,
    place: &'a str,
    sizes: Sizes,
    warn: &'w mut dyn FnMut(String),
}

impl Reader<'_, '_> {
    /// Reads a primvar. A primvar whose values do not match the mesh is left out with a warning.
    fn attribute<const N: usize>(&mut self, primvar: Option<&Primvar>) -> Option<Attribute<N>> {
        let primvar = primvar?;
        let attribute = self.fitting(primvar);
        if let Err(reason) = &attribute {
            (self.warn)(format!("the primvar {} is left out, since it has {reason}", primvar.name));
        }
        attribute.ok()
    }

    fn fitting<const N: usize>(&self, primvar: &Primvar) -> Result<Attribute<N>, String> {
        let place = format!("{}.primvars:{}", self.place, primvar.name);
        let text = |fault: Fault| match fault {
            Fault::Malformed { found, .. } => found,
            Fault::Cancelled(_) => String::new(),
        };
        let values = self.package.reals::<N>(&primvar.values, &place).map_err(text)?;
        // Find the number of elements that need a value.
        let (interpolation, elements) = match primvar.interpolation.as_str() {
            "constant" => (Interpolation::Constant, 1),
            "uniform" => (Interpolation::Uniform, self.sizes.faces),
            "varying" => (Interpolation::Varying, self.sizes.points),
            "vertex" => (Interpolation::Vertex, self.sizes.points),
            "faceVarying" => (Interpolation::FaceVarying, self.sizes.corners),
            other => return Err(format!("the unknown interpolation {other:?}")),
        };
        if values.iter().flatten().any(|value| !value.is_finite()) {
            return Err("values that are not finite".into());
        }
        // Read the indices, and check them and the number of values.
        let indices = match &primvar.indices {
            None => None,
            Some(array) => {
                let indices = self.package.integers(array, &place).map_err(text)?;
                if let Some(index) = indices.iter().find(|&&index| !(0..values.len() as i64).contains(&index)) {
                    return Err(format!("the index {index}, which is outside the list of {} values", values.len()));
                }
                Some(indices.into_iter().map(|index| index as u32).collect::<Vec<_>>())
            }
        };
        let found = indices.as_ref().map_or(values.len(), Vec::len);
        // a list for a constant may have more values, of which the first is used
        if found < elements || (found > elements && interpolation != Interpolation::Constant) {
            return Err(format!(
                "a list of length {found}, but its interpolation \"{}\" needs length {elements}",
                primvar.interpolation
            ));
        }
        Ok(Attribute { values, interpolation, indices })
    }
}
