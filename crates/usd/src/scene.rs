//! Converts a scene package to a scene.
//!
//! A shape is converted to meshes once per combination of materials. Its copies are instances of
//! these meshes, at any depth of nested prototypes. A stage whose z axis points up is rotated by
//! −90° about x.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use glam::{DAffine3, Vec4};
use lumistack_core::{Task, Warning, Warnings};
use lumistack_scene::{AlphaMode, Cloud, Instance, Material, Mesh, PlacedCloud, Scene, SceneParts};

use crate::UsdError;
use crate::camera::camera;
use crate::error::Fault;
use crate::geometry::Geometry;
use crate::lights::{self, LightMesh, Lights};
use crate::material::{self, Loaded};
use crate::package::{Link, MeshEntry, Package, Placement, Shape, SplatsEntry};
use crate::placing::{affine, expand};
use crate::polygons::{self, Corner, Interpolation, Polygons, UvNames};
use crate::texture::Textures;
use crate::{mesh, refine, shapes, splats};

/// Largest number of instances of meshes and clouds. Nested copies in a small file could request
/// any number, so the number is limited.
const MOST_INSTANCES: usize = 1 << 26;
/// Relative difference of areas at which copies of a light with `normalize` get different radiance.
const AREA_STEP: f64 = 1e-3;
/// Largest relative deviation of a matrix from a rotation with a uniform scale.
const UNIFORM: f64 = 1e-6;
/// Albedo of a surface without a material and without a display colour, as in UsdPreviewSurface.
const GREY: f32 = 0.18;

/// Converts a scene package to a scene; `name` is the file's name in messages.
///
/// # Errors
/// If the package is inconsistent, if nothing in it can be rendered, or if the task is cancelled.
pub fn scene_from_package(name: &str, package: &Package<'_>, task: Task<'_>) -> Result<Scene, UsdError> {
    let warnings = InFile { name, inner: task.warnings };
    let task = Task { warnings: &warnings, ..task };
    for note in &package.header.warnings {
        task.warn(&note.place, &note.message);
    }
    assemble(name, package, task).map_err(|fault| fault.in_file(name))
}

/// A receiver of warnings that adds the file's name in front of each warning's place.
struct InFile<'a> {
    name: &'a str,
    inner: &'a dyn Warnings,
}

impl Warnings for InFile<'_> {
    fn warn(&self, warning: Warning) {
        self.inner.warn(Warning { place: format!("{}: {}", self.name, warning.place), message: warning.message });
    }
}

fn assemble(name: &str, package: &Package<'_>, task: Task<'_>) -> Result<Scene, Fault> {
    let header = &package.header;
    let scene_from_stage = match header.up_axis.as_str() {
        "Z" => DAffine3::from_rotation_x(-std::f64::consts::FRAC_PI_2),
        other => {
            if other != "Y" {
                task.warn("upAxis", format!("expected Y or Z, found {other:?}; Y is used"));
            }
            DAffine3::IDENTITY
        }
    };
    // Convert materials first, since they determine the primvars that become texture coordinates of
    // meshes.
    let mut assembly = Assembly {
        package,
        task,
        parts: SceneParts { name: name.to_owned(), ..SceneParts::default() },
        materials: Vec::new(),
        plain: HashMap::new(),
        one_sided: HashMap::new(),
        shown: HashMap::new(),
        lit: HashMap::new(),
    };
    let mut textures = Textures::new(package, task);
    assembly.load_materials(&mut textures)?;
    for placement in &header.instances {
        task.cancel.check()?;
        assembly.place(placement, &scene_from_stage)?;
    }
    assembly.light(&mut textures, &scene_from_stage);
    (assembly.parts.images, assembly.parts.textures) = (textures.images, textures.textures);
    // Convert the cameras, and leave out cameras that show nothing.
    for entry in &header.cameras {
        if entry.aperture_offset != [0.0, 0.0] {
            task.warn(&entry.place, "the offset of the camera's aperture is not supported; the aperture is centred");
        }
        let camera = camera(entry, &header.cameras, &scene_from_stage);
        match camera {
            Ok(camera) => assembly.parts.cameras.push(camera),
            Err(reason) => task.warn(&entry.place, format!("the camera is left out, since it has {reason}")),
        }
    }
    let parts = assembly.parts;
    parts.validate(task).map_err(|mut error| {
        // The message begins with the file's name already. If this name is also the place of the
        // error, the root becomes the place.
        if error.place == name {
            error.place = "/".into();
        }
        error.into()
    })
}

/// A material that was converted, with its index in the scene.
struct Bound {
    /// Index of the material in the scene.
    material: usize,
    /// Names of the primvars that the material's textures read as coordinate sets 0 and 1.
    uv_names: [Option<String>; 2],
    /// True if vertex colours multiply the material's base colour.
    reads_colors: bool,
}

struct Assembly<'a> {
    package: &'a Package<'a>,
    task: Task<'a>,
    parts: SceneParts,
    /// Materials by their index in the package; `None` if a material could not be converted, so
    /// that the display colour applies.
    materials: Vec<Option<Bound>>,
    /// Indices of materials for display colours. The key has the bits of the colour, and true if
    /// the material blends.
    plain: HashMap<([u32; 4], bool), usize>,
    /// Indices of one-sided copies of materials; the key is the index of the original.
    one_sided: HashMap<usize, usize>,
    /// Indices of the meshes or of the cloud of a shape. The key is the shape and its materials.
    shown: HashMap<(usize, Vec<Option<usize>>), Vec<usize>>,
    /// The lights with `normalize` among the shapes in `shown`. The key is the first mesh of the
    /// shape.
    lit: HashMap<usize, Lit>,
}

/// The meshes of a light with `normalize`. The radiance of a copy depends on its area in the scene.
struct Lit {
    /// Area of all meshes together, before they are placed.
    area: f64,
    /// The materials of the meshes without the light's emission.
    materials: Vec<usize>,
    /// Meshes with the emission for an area. The key is the logarithm of this area, in steps of
    /// `AREA_STEP`.
    of_area: HashMap<i64, Vec<usize>>,
}

impl<'a> Assembly<'a> {
    fn load_materials(&mut self, textures: &mut Textures<'a>) -> Result<(), Fault> {
        for entry in &self.package.header.materials {
            self.task.cancel.check()?;
            let loaded = material::load(entry, textures, self.task);
            self.materials.push(loaded.map(|Loaded { material, uv_names, reads_colors }| {
                self.parts.materials.push(material);
                Bound { material: self.parts.materials.len() - 1, uv_names, reads_colors }
            }));
        }
        Ok(())
    }

    /// Adds the lights of the scene package to the scene: meshes with emission, lights without a
    /// surface, and the environment.
    fn light(&mut self, textures: &mut Textures<'_>, scene_from_stage: &DAffine3) {
        let mut lights = Lights::default();
        for entry in &self.package.header.lights {
            lights.add(entry, scene_from_stage, textures, self.task);
        }
        for LightMesh { place, geometry, material, scene_from_mesh } in lights.surfaces {
            self.parts.materials.push(material);
            let mesh = self.mesh(place, geometry, self.parts.materials.len() - 1);
            self.parts.meshes.push(mesh);
            self.parts.instances.push(Instance { mesh: self.parts.meshes.len() - 1, scene_from_mesh });
        }
        self.parts.lights = lights.points;
        self.parts.environment = lights.environment;
    }

    fn mesh(&self, place: String, geometry: Geometry, material: usize) -> Mesh {
        let Geometry { positions, normals, uvs, colors, triangles, .. } = geometry;
        Mesh { place, positions, normals, tangents: Vec::new(), uvs, colors, triangles, material }
    }

    /// Makes the meshes of an implicit shape, of curves or of points. Such a shape has one
    /// material.
    fn other(&mut self, shape: &Shape, materials: &[Option<usize>]) -> Result<Vec<Mesh>, Fault> {
        let bound = materials.first().copied().flatten().and_then(|index| self.materials[index].as_ref());
        let uv_names = bound.map_or([None, None], |bound| bound.uv_names.clone());
        let bound = bound.map(|bound| (bound.material, bound.reads_colors));
        let (mut geometry, primvars) = match shape {
            Shape::Mesh(_) | Shape::Splats(_) => return Ok(Vec::new()),
            Shape::Solid(entry) => (shapes::solid(entry)?, &entry.primvars),
            Shape::Curves(entry) => {
                let names = uv_names.each_ref().map(|name| name.as_deref());
                (shapes::curves(self.package, entry, names, self.task)?, &entry.primvars)
            }
            Shape::Points(entry) => (shapes::balls(self.package, entry, self.task)?, &entry.primvars),
        };
        // Read a constant display colour of the whole shape, which applies if the vertices have no
        // colours.
        let constant = primvars.iter().filter(|primvar| primvar.interpolation == "constant").cloned().collect();
        let whole = MeshEntry { place: shape.place().to_owned(), primvars: constant, ..MeshEntry::default() };
        let whole = polygons::read(self.package, &whole, [None, None], &mut |_| {})?;
        // Select the material: the bound one, or a new one that shows the display colour.
        let (material, colors) = match bound {
            Some((_, true)) if geometry.colors.is_empty() => {
                if let Some(&[r, g, b]) = whole.colors.as_ref().and_then(|colors| colors.values.first()) {
                    let color = Vec4::new(r, g, b, 1.0).clamp(Vec4::ZERO, Vec4::ONE);
                    geometry.colors = vec![color; geometry.positions.len()];
                }
                bound.unwrap_or_default()
            }
            Some(bound) => bound,
            None if geometry.colors.is_empty() => self.plain(&whole),
            None => {
                self.parts.materials.push(plain(Vec4::ONE, false));
                (self.parts.materials.len() - 1, true)
            }
        };
        if !colors {
            geometry.colors.clear();
        }
        Ok(vec![self.mesh(shape.place().to_owned(), geometry, material)])
    }

    /// Adds the meshes or the cloud of a placement if they are new, and an instance for every copy.
    fn place(&mut self, placement: &Placement, scene_from_stage: &DAffine3) -> Result<(), Fault> {
        let shapes = &self.package.header.geometries;
        let shape = shapes.get(placement.geometry);
        let shape = shape.ok_or_else(|| {
            Fault::new("instances", format!("the index of a geometry, below {}", shapes.len()), placement.geometry)
        })?;
        let place = shape.place();
        if let Some(&material) = placement.materials.iter().flatten().find(|&&index| index >= self.materials.len()) {
            return Err(Fault::new(
                place,
                format!("the index of a material, below {}", self.materials.len()),
                material,
            ));
        }
        // Convert a shape only once per combination of materials.
        let shown = match self.shown.entry((placement.geometry, placement.materials.clone())) {
            Entry::Occupied(entry) => entry.into_mut().clone(),
            Entry::Vacant(_) => {
                let numbers: Vec<usize> = if let Shape::Splats(entry) = shape {
                    let cloud = self.cloud(entry)?;
                    let first = self.parts.clouds.len();
                    self.parts.clouds.extend(cloud);
                    (first..self.parts.clouds.len()).collect()
                } else {
                    let made = self.meshes(shape, &placement.materials)?;
                    let first = self.parts.meshes.len();
                    self.parts.meshes.extend(made);
                    (first..self.parts.meshes.len()).collect()
                };
                self.shown.insert((placement.geometry, placement.materials.clone()), numbers.clone());
                numbers
            }
        };
        if shown.is_empty() {
            return Ok(());
        }
        // Compute the number of copies before any copy is made, since nested prototypes multiply
        // it.
        let links = placement.chain.iter().map(|link| self.link(link, place)).collect::<Result<Vec<_>, _>>()?;
        let copies = links.iter().try_fold(1usize, |product, link| product.checked_mul(link.len()));
        let there = self.parts.instances.len() + self.parts.placed_clouds.len();
        let total = copies.and_then(|copies| copies.checked_mul(shown.len())?.checked_add(there));
        if total.is_none_or(|total| total > MOST_INSTANCES) {
            let found =
                format!("more (transforms in the chain: {}); use fewer copies or fewer nested instancers", links.len());
            return Err(Fault::new(place, format!("at most {MOST_INSTANCES} instances and splat clouds"), found));
        }
        // Add an instance for every combination of one matrix from each link.
        let is_cloud = matches!(shape, Shape::Splats(_));
        let light = match shape {
            Shape::Mesh(entry) => entry.light.as_ref().filter(|light| lights::is_normalized(light)),
            _ => None,
        };
        let mut left_out = 0;
        expand(scene_from_stage, &links, &mut |scene_from_shape| {
            let scene_from_mesh = scene_from_shape.as_affine3a();
            if !scene_from_shape.is_finite() {
                left_out += 1;
            } else if is_cloud {
                let placed = shown.iter().map(|&cloud| PlacedCloud { cloud, scene_from_cloud: scene_from_mesh });
                self.parts.placed_clouds.extend(placed);
            } else {
                let lit = light.map(|light| self.lit(light, &shown, &scene_from_shape));
                let meshes = lit.as_ref().unwrap_or(&shown);
                self.parts.instances.extend(meshes.iter().map(|&mesh| Instance { mesh, scene_from_mesh }));
            }
        });
        if left_out > 0 {
            self.task.warn(place, format!("copies with a placement that is not finite are left out: {left_out}"));
        }
        Ok(())
    }

    /// Returns the meshes of a copy of a light with `normalize`, with the emission for the copy's
    /// area. For the first area these are the meshes `shown`, for other areas new meshes.
    fn lit(&mut self, light: &serde_json::Value, shown: &[usize], scene_from_mesh: &DAffine3) -> Vec<usize> {
        let parts = &mut self.parts;
        let area = |matrix: &DAffine3| -> f64 {
            let meshes = shown.iter().map(|&mesh| &parts.meshes[mesh]);
            meshes.map(|mesh| lights::area(&mesh.positions, &mesh.triangles, matrix)).sum()
        };
        let lit = self.lit.entry(shown[0]).or_insert_with(|| Lit {
            area: area(&DAffine3::IDENTITY),
            materials: shown.iter().map(|&mesh| parts.meshes[mesh].material).collect(),
            of_area: HashMap::new(),
        });
        // Only a scale that is not uniform needs the area of every triangle.
        let area =
            uniform_scale(scene_from_mesh).map_or_else(|| area(scene_from_mesh), |scale| lit.area * scale * scale);
        let step = (area.ln() / AREA_STEP).round() as i64;
        if let Some(known) = lit.of_area.get(&step) {
            return known.clone();
        }
        let is_first = lit.of_area.is_empty();
        let mut numbers = shown.to_vec();
        for (number, &plain) in numbers.iter_mut().zip(&lit.materials) {
            if !is_first {
                parts.meshes.push(parts.meshes[*number].clone());
                *number = parts.meshes.len() - 1;
            }
            parts.meshes[*number].material = plain;
            if let Some(emissive) = lights::emissive(light, &parts.materials[plain], area as f32) {
                parts.materials.push(emissive);
                parts.meshes[*number].material = parts.materials.len() - 1;
            }
        }
        lit.of_area.insert(step, numbers.clone());
        numbers
    }

    /// Converts a field of splats to a cloud. `None` if it has no splats, or after a warning if its
    /// arrays are inconsistent.
    fn cloud(&mut self, entry: &SplatsEntry) -> Result<Option<Cloud>, Fault> {
        match splats::cloud(self.package, entry, self.task) {
            Ok(cloud) => Ok((!cloud.is_empty()).then_some(cloud)),
            Err(Fault::Malformed { place, expected, found }) => {
                self.task.warn(place, format!("expected {expected}, found {found}; the splats are left out"));
                Ok(None)
            }
            Err(other) => Err(other),
        }
    }

    /// Returns the matrices of a link, except matrices of hidden copies and of other prototypes.
    fn link(&self, link: &Link, place: &str) -> Result<Vec<DAffine3>, Fault> {
        let matrices = self.package.matrices(&link.matrices, place)?;
        let column = |array: &Option<crate::package::Array>| -> Result<Option<Vec<i64>>, Fault> {
            let Some(array) = array else { return Ok(None) };
            let values = self.package.integers(array, place)?;
            if values.len() != matrices.len() {
                return Err(Fault::new(place, format!("one entry per copy ({})", matrices.len()), values.len()));
            }
            Ok(Some(values))
        };
        let (prototypes, mask) = (column(&link.prototypes)?, column(&link.mask)?);
        let is_shown = |i: usize| {
            prototypes.as_ref().is_none_or(|prototypes| prototypes[i] == link.prototype)
                && mask.as_ref().is_none_or(|mask| mask[i] != 0)
        };
        Ok((0..matrices.len()).filter(|&i| is_shown(i)).map(|i| affine(&matrices[i])).collect())
    }

    /// Makes the meshes of a shape: one for each subset that has faces, and one for all other
    /// faces.
    fn meshes(&mut self, shape: &Shape, materials: &[Option<usize>]) -> Result<Vec<Mesh>, Fault> {
        let Shape::Mesh(entry) = shape else {
            return match self.other(shape, materials) {
                Err(Fault::Malformed { place, expected, found }) => {
                    self.task.warn(place, format!("expected {expected}, found {found}; the shape is left out"));
                    Ok(Vec::new())
                }
                other => other,
            };
        };
        if materials.len() != 1 + entry.subsets.len() {
            let expected = format!("{} materials, one for the mesh and one for each subset", 1 + entry.subsets.len());
            return Err(Fault::new(&entry.place, expected, materials.len()));
        }
        match self.mesh_parts(entry, materials) {
            Err(Fault::Malformed { place, expected, found }) => {
                // warn only, so that one broken mesh does not prevent other meshes
                self.task.warn(place, format!("expected {expected}, found {found}; the mesh is left out"));
                Ok(Vec::new())
            }
            other => other,
        }
    }

    fn mesh_parts(&mut self, entry: &MeshEntry, materials: &[Option<usize>]) -> Result<Vec<Mesh>, Fault> {
        let slot_of_face = self.slots(entry)?;
        // List the materials that faces use, so that no mesh is empty.
        let mut used: Vec<usize> = Vec::new();
        match &slot_of_face {
            None => used.push(0),
            Some(slots) => {
                let mut seen = vec![false; materials.len()];
                slots.iter().for_each(|&slot| seen[slot as usize] = true);
                used.extend((0..materials.len()).filter(|&slot| seen[slot]));
            }
        }
        let mut made: Vec<([Option<String>; 2], Polygons, Geometry)> = Vec::new();
        let mut meshes = Vec::new();
        // Convert the polygons once for each pair of primvars with texture coordinates. Then select
        // the faces of each material.
        for slot in used {
            let bound = materials[slot].and_then(|material| self.materials[material].as_ref());
            let uv_names = bound.map_or([None, None], |bound| bound.uv_names.clone());
            if !made.iter().any(|(names, ..)| *names == uv_names) {
                let names: UvNames<'_> = uv_names.each_ref().map(|name| name.as_deref());
                let task = self.task;
                let mut warn = |message: String| task.warn(&entry.place, message);
                let polygons = polygons::read(self.package, entry, names, &mut warn)?;
                // a bilinear surface consists of the polygons themselves, so do not refine it
                let smooth = entry.subdivision.as_ref().filter(|subdivision| subdivision.scheme != "bilinear");
                let (polygons, parents) = match smooth {
                    Some(subdivision) => {
                        let (refined, parents) = refine::refined(self.package, entry, subdivision, polygons, task);
                        (refined, Some(parents))
                    }
                    None => (polygons, None),
                };
                let mut geometry = mesh::triangulate(&polygons);
                if let Some(parents) = parents {
                    geometry.face_of_triangle.iter_mut().for_each(|face| *face = parents[*face as usize]);
                }
                made.push((uv_names.clone(), polygons, geometry));
            }
            let position = made.iter().position(|(names, ..)| *names == uv_names).unwrap_or_default();
            let (_, polygons, geometry) = &made[position];
            let (material, colors) = match bound {
                Some(bound) => (bound.material, bound.reads_colors),
                None => self.plain(polygons),
            };
            let material = if entry.one_sided { self.one_sided(material) } else { material };
            let mut geometry = match &slot_of_face {
                None => geometry.clone(),
                Some(slots) => part(geometry, |face| slots[face as usize] as usize == slot),
            };
            if !colors {
                geometry.colors.clear();
            }
            let mut material = material;
            // [`Self::place`] adds the emission of a light with `normalize`, since this emission
            // depends on the area of each copy.
            if let Some(light) = entry.light.as_ref().filter(|light| !lights::is_normalized(light))
                && let Some(emissive) = lights::emissive(light, &self.parts.materials[material], 1.0)
            {
                self.parts.materials.push(emissive);
                material = self.parts.materials.len() - 1;
            }
            meshes.push(self.mesh(entry.place.clone(), geometry, material));
        }
        Ok(meshes)
    }

    /// Returns the index of a copy of a material, for surfaces that are visible only from the
    /// front.
    fn one_sided(&mut self, material: usize) -> usize {
        let materials = &mut self.parts.materials;
        *self.one_sided.entry(material).or_insert_with(|| {
            materials.push(Material { double_sided: false, ..materials[material].clone() });
            materials.len() - 1
        })
    }

    /// Returns, for every face, 1 + the index of its subset, or 0 for a face without a subset.
    /// Returns `None` if the mesh has no subsets. If subsets overlap, the first one applies.
    fn slots(&self, entry: &MeshEntry) -> Result<Option<Vec<u32>>, Fault> {
        if entry.subsets.is_empty() {
            return Ok(None);
        }
        let faces = entry.counts.as_ref().and_then(|counts| counts.shape.first().copied()).unwrap_or(0);
        let mut slots = vec![0; faces.min(self.package.buffers.iter().map(|buffer| buffer.len()).max().unwrap_or(0))];
        for (number, subset) in (1..).zip(&entry.subsets) {
            // A subset of a changed mesh may list a million faces that the mesh lacks, so one
            // warning reports all of them.
            let mut missing = Vec::new();
            for face in self.package.integers(&subset.faces, &subset.place)? {
                match usize::try_from(face).ok().and_then(|face| slots.get_mut(face)) {
                    Some(slot) if *slot == 0 => *slot = number,
                    Some(_) => {}
                    None => missing.push(face),
                }
            }
            if let Some(first) = missing.first() {
                let (count, most) = (missing.len(), slots.len());
                self.task.warn(
                    &subset.place,
                    format!(
                        "expected indices of faces below {most}, found others, such as {first}; the subset is used without these faces (count: {count})"
                    ),
                );
            }
        }
        Ok(Some(slots))
    }

    /// Returns the index of a material for a shape that has no material, or whose material could
    /// not be converted. The `bool` is true if vertex colours multiply the material's colour.
    fn plain(&mut self, polygons: &Polygons) -> (usize, bool) {
        let constant = |interpolation| interpolation == Interpolation::Constant;
        let color = polygons.colors.as_ref();
        let opacity = polygons.opacities.as_ref();
        let varies = color.is_some_and(|color| !constant(color.interpolation))
            || opacity.is_some_and(|opacity| !constant(opacity.interpolation));
        let first = Corner { face: 0, point: 0, corner: 0 };
        let blends = opacity.is_some_and(|opacity| opacity.values.iter().any(|value| value[0] < 1.0));
        let value = if varies {
            match color {
                Some(_) => Vec4::ONE,
                None => Vec4::new(GREY, GREY, GREY, 1.0),
            }
        } else {
            let [r, g, b] = color.map_or([GREY; 3], |color| color.at(first));
            Vec4::new(r, g, b, opacity.map_or(1.0, |opacity| opacity.at(first)[0])).clamp(Vec4::ZERO, Vec4::ONE)
        };
        let parts = &mut self.parts;
        let material = *self.plain.entry((value.to_array().map(f32::to_bits), blends)).or_insert_with(|| {
            parts.materials.push(plain(value, blends));
            parts.materials.len() - 1
        });
        (material, varies)
    }
}

/// Returns the factor by which a matrix scales lengths; `None` if it depends on the direction.
fn uniform_scale(matrix: &DAffine3) -> Option<f64> {
    let [x, y, z] = [matrix.matrix3.x_axis, matrix.matrix3.y_axis, matrix.matrix3.z_axis];
    let square = x.length_squared();
    let deviations = [y.length_squared() - square, z.length_squared() - square, x.dot(y), y.dot(z), z.dot(x)];
    deviations.iter().all(|deviation| deviation.abs() <= UNIFORM * square).then(|| square.sqrt())
}

/// Makes a material with this base colour. Its other values are the defaults of UsdPreviewSurface.
fn plain(base_color: Vec4, blends: bool) -> Material {
    Material {
        name: "displayColor".into(),
        base_color,
        metallic: 0.0,
        roughness: 0.5,
        alpha_mode: if blends { AlphaMode::Blend } else { AlphaMode::Opaque },
        double_sided: true,
        ..Material::default()
    }
}

/// Returns the triangles of the faces for which `takes` is true, with the vertices that they use.
fn part(geometry: &Geometry, takes: impl Fn(u32) -> bool) -> Geometry {
    const NONE: u32 = u32::MAX;
    let mut new = vec![NONE; geometry.positions.len()];
    let mut taken = Vec::new();
    let mut part = Geometry::default();
    for (triangle, &face) in geometry.triangles.iter().zip(&geometry.face_of_triangle) {
        if takes(face) {
            let corners = triangle.map(|vertex| {
                let new = &mut new[vertex as usize];
                if *new == NONE {
                    *new = taken.len() as u32;
                    taken.push(vertex as usize);
                }
                *new
            });
            part.triangle(corners, face);
        }
    }
    fn pick<T: Copy>(list: &[T], taken: &[usize]) -> Vec<T> {
        if list.is_empty() { Vec::new() } else { taken.iter().map(|&vertex| list[vertex]).collect() }
    }
    part.positions = pick(&geometry.positions, &taken);
    part.normals = pick(&geometry.normals, &taken);
    part.uvs = geometry.uvs.each_ref().map(|uvs| pick(uvs, &taken));
    part.colors = pick(&geometry.colors, &taken);
    part
}
