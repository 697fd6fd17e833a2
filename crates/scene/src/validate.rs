//! Validates [`SceneParts`] to a [`Scene`]: defects that prevent rendering are errors; other
//! defects are repaired, most of them with a warning.

use std::f32::consts::{FRAC_PI_2, PI};
use std::ops::Deref;

use glam::{Affine3A, Mat3A, Vec2, Vec3, Vec3A};
use lumistack_core::Task;

use crate::{
    AlphaMode, Bounds, Camera, Instance, Lamp, LightKind, Material, Mesh, Pixels, Projection, SceneError, SceneParts,
    TextureUse,
};

/// Largest number of splats of a scene, copies included. A small file may place one cloud any
/// number of times.
const MOST_SPLATS: usize = 1 << 27;

/// A scene whose indices, numbers and transforms are valid. It dereferences to [`SceneParts`].
#[derive(Clone, Debug)]
pub struct Scene {
    parts: SceneParts,
    bounds: Bounds,
    seen_bounds: Bounds,
}

impl Deref for Scene {
    type Target = SceneParts;

    fn deref(&self) -> &SceneParts {
        &self.parts
    }
}

impl Scene {
    /// Returns the bounds of all placed triangles, and of all splats except faint splats and
    /// floaters, which are far from most splats; never empty.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Returns the same as [`bounds`](Self::bounds), but without [unseen lamps](Lamp::Unseen). If
    /// the scene has nothing else, they are included.
    pub fn seen_bounds(&self) -> Bounds {
        self.seen_bounds
    }

    /// Returns true if the viewer can see an instance. Only an [unseen lamp](Lamp::Unseen) is
    /// invisible.
    pub fn is_seen(&self, instance: &crate::Instance) -> bool {
        self.materials[self.meshes[instance.mesh].material].lamp != Lamp::Unseen
    }

    /// Returns the number of triangles, including the copies that instances make.
    pub fn triangle_count(&self) -> usize {
        self.instances.iter().map(|instance| self.meshes[instance.mesh].triangles.len()).sum()
    }

    /// Returns the number of splats, including the copies that placements make.
    pub fn splat_count(&self) -> usize {
        self.placed_clouds.iter().map(|placed| self.clouds[placed.cloud].len()).sum()
    }

    /// Returns the centres of all placed splats, in scene space.
    pub fn splat_positions(&self) -> impl Iterator<Item = Vec3> {
        self.placed_clouds.iter().flat_map(|placed| {
            self.clouds[placed.cloud].positions.iter().map(|at| placed.scene_from_cloud.transform_point3(*at))
        })
    }

    /// Returns true if views of the scene need paths: if the scene has surfaces, an environment or
    /// a backdrop. Splats alone need no paths.
    pub fn needs_paths(&self) -> bool {
        !self.instances.is_empty() || self.environment.is_some() || self.backdrop.is_some()
    }

    /// Returns true if something lights the scene: an environment, a punctual light, or a surface
    /// that emits more than white (radiance 1). A dimmer surface, such as a label or a display in
    /// the scene, is visible but does not light other objects.
    pub fn is_lit(&self) -> bool {
        // values of a floating-point picture may exceed 1, but codes are at most 1
        let brightest = |texture: &TextureUse| match &self.images[self.textures[texture.texture].image].pixels {
            Pixels::RgbF32(texels) => texels.iter().flatten().copied().fold(0.0, f32::max),
            _ => 1.0,
        };
        let is_lamp = |material: &Material| {
            let factor = material.emission.max_element();
            factor > 0.0 && factor * material.emission_texture.as_ref().map_or(1.0, brightest) > 1.0
        };
        // test every material once, since there may be millions of instances
        let lamps: Vec<bool> = self.materials.iter().map(is_lamp).collect();
        let shows_lamp = |instance: &Instance| lamps[self.meshes[instance.mesh].material];
        self.environment.is_some() || !self.lights.is_empty() || self.instances.iter().any(shows_lamp)
    }

    /// Returns the parts of the scene, so that they can be changed and validated again.
    pub fn into_parts(self) -> SceneParts {
        self.parts
    }
}

impl SceneParts {
    /// Checks everything on which later stages rely, and generates missing normals and tangents.
    /// Drops triangles without area, splats that are not Gaussians, copies whose placement has no
    /// inverse, and cameras without a valid placement, with warnings.
    ///
    /// # Errors
    /// If an index is out of range, if a list has the wrong length, or if a number is not finite or
    /// out of its range and cannot be repaired. Also if the environment's image has no linear
    /// radiance, if too many splats are placed, or if nothing remains to render.
    pub fn validate(mut self, task: Task<'_>) -> Result<Scene, SceneError> {
        self.check_images()?;
        self.check_materials(task)?;
        // check every mesh, and compute the normals and tangents that it lacks
        let tangent_uv_sets: Vec<_> = self.materials.iter().map(crate::Material::tangent_uv_set).collect();
        let material_count = self.materials.len();
        let mut flat: Vec<(String, usize, usize)> = Vec::new();
        for mesh in &mut self.meshes {
            let before = mesh.triangles.len();
            let dropped = check_mesh(mesh, material_count, task)?;
            if dropped > 0 {
                flat.push((mesh.place.clone(), dropped, before));
            }
            if mesh.normals.is_empty() {
                generate_flat_normals(mesh);
            }
            if mesh.tangents.is_empty()
                && let Some(uv_set) = tangent_uv_sets[mesh.material]
            {
                generate_tangents(mesh, uv_set);
            }
        }
        match flat.as_slice() {
            [] => {}
            [(place, dropped, before)] => {
                task.warn(place, format!("triangles without area, which are left out: {dropped} of {before}"));
            }
            // files from CAD often have triangles without area in many meshes, so all of these
            // meshes share one warning
            many => {
                let dropped: usize = many.iter().map(|(_, dropped, _)| dropped).sum();
                let message = format!("triangles without area, which are left out: {dropped} in {} meshes", many.len());
                task.warn("/meshes", message);
            }
        }
        self.check_instances(task)?;
        self.check_lights_and_cameras(task)?;
        // find the bounds of all instances and clouds, and of those that the viewer sees
        let (mut bounds, mut seen_bounds) = (Bounds::EMPTY, Bounds::EMPTY);
        for instance in &self.instances {
            let mesh = &self.meshes[instance.mesh];
            let mut own = Bounds::EMPTY;
            for &index in mesh.triangles.iter().flatten() {
                own.include(instance.scene_from_mesh.transform_point3(mesh.positions[index as usize]));
            }
            bounds.join(own);
            if self.materials[mesh.material].lamp != Lamp::Unseen {
                seen_bounds.join(own);
            }
        }
        self.check_clouds(task)?;
        for placed in &self.placed_clouds {
            let own = self.clouds[placed.cloud].seen_bounds(placed.scene_from_cloud);
            bounds.join(own);
            seen_bounds.join(own);
        }
        if bounds.is_empty() {
            let expected = if self.clouds.is_empty() {
                "at least one triangle with area"
            } else {
                "at least one splat that is a Gaussian"
            };
            return Err(SceneError::new(self.name, expected, "none"));
        }
        if !(bounds.min.is_finite() && bounds.max.is_finite()) {
            return Err(SceneError::new(self.name, "coordinates that a 32-bit float can hold", "larger ones"));
        }
        let seen_bounds = if seen_bounds.is_empty() { bounds } else { seen_bounds };
        Ok(Scene { parts: self, bounds, seen_bounds })
    }

    fn check_clouds(&mut self, task: Task<'_>) -> Result<(), SceneError> {
        for cloud in &mut self.clouds {
            cloud.check(task)?;
        }
        for (i, placed) in self.placed_clouds.iter().enumerate() {
            index(&format!("placed cloud {i}"), placed.cloud, self.clouds.len(), "cloud")?;
            if !placed.scene_from_cloud.is_finite() {
                let place = format!("placed cloud {i} of {}", self.clouds[placed.cloud].place);
                return Err(SceneError::new(place, "a finite transform", "NaN or infinity"));
            }
        }
        let clouds = &self.clouds;
        self.placed_clouds.retain(|placed| {
            let keep = is_invertible(&placed.scene_from_cloud);
            if !keep {
                task.warn(
                    &clouds[placed.cloud].place,
                    "a copy is left out, since its placement has no inverse, as with a scale of zero",
                );
            }
            keep && !clouds[placed.cloud].is_empty()
        });
        let count =
            self.placed_clouds.iter().try_fold(0usize, |sum, placed| sum.checked_add(clouds[placed.cloud].len()));
        if count.is_none_or(|count| count > MOST_SPLATS) {
            let found = format!("more (copies of splat clouds: {})", self.placed_clouds.len());
            return Err(SceneError::new(&self.name, format!("at most {MOST_SPLATS} placed splats"), found));
        }
        Ok(())
    }

    fn check_images(&self) -> Result<(), SceneError> {
        // check the size of each image, and the values of radiance
        for image in &self.images {
            let texels = image.width.checked_mul(image.height);
            if texels != Some(image.pixels.len()) || image.pixels.is_empty() {
                let expected = format!("{} × {} texels, and at least one", image.width, image.height);
                return Err(SceneError::new(&image.name, expected, image.pixels.len().to_string()));
            }
            if let Pixels::RgbF32(texels) = &image.pixels
                && let Some(at) = texels.iter().position(|texel| !texel.iter().all(|v| v.is_finite() && *v >= 0.0))
            {
                let place = format!("{} row {} column {}", image.name, at / image.width, at % image.width);
                return Err(SceneError::new(place, "finite radiance ≥ 0", format!("{:?}", texels[at])));
            }
        }
        // check the textures, the backdrop and the environment
        for (i, texture) in self.textures.iter().enumerate() {
            index(&format!("/textures/{i}/source"), texture.image, self.images.len(), "image")?;
        }
        if let Some(backdrop) = self.backdrop
            && !(backdrop.is_finite() && backdrop.min_element() >= 0.0)
        {
            return Err(SceneError::new("backdrop", "finite radiance ≥ 0", backdrop.to_string()));
        }
        if let Some(environment) = &self.environment {
            index("environment image", environment.image, self.images.len(), "image")?;
            if !(environment.strength.is_finite() && environment.strength.min_element() >= 0.0) {
                return Err(SceneError::new(
                    "environment strength",
                    "finite numbers ≥ 0",
                    environment.strength.to_string(),
                ));
            }
            let rotation = environment.scene_from_environment;
            if !(rotation.is_finite() && rotation.length_squared().is_normal()) {
                let expected = "a finite quaternion of nonzero length";
                return Err(SceneError::new("environment rotation", expected, rotation.to_string()));
            }
            if !matches!(self.images[environment.image].pixels, Pixels::RgbF32(_)) {
                return Err(SceneError::new(
                    &self.images[environment.image].name,
                    "an image of linear radiance (HDR or EXR) for the environment",
                    "8- or 16-bit codes",
                ));
            }
        }
        Ok(())
    }

    fn check_materials(&mut self, task: Task<'_>) -> Result<(), SceneError> {
        for (i, material) in self.materials.iter_mut().enumerate() {
            let place = format!("/materials/{i} ({})", material.name);
            // check the indices of textures
            for (slot, texture) in material.textures() {
                index(&format!("{place} {slot}"), texture.texture, self.textures.len(), "texture")?;
                index(&format!("{place} {slot} texCoord"), texture.uv_set, 2, "texture coordinate set (0 or 1)")?;
                if !texture.texture_from_mesh.is_finite() {
                    return Err(SceneError::new(
                        format!("{place} {slot}"),
                        "a finite texture transform",
                        "NaN or infinity",
                    ));
                }
            }
            // parameters outside of their range are clamped with a warning, since many files exceed
            // the ranges
            let clamp = |name: &str, value: &mut f32, low: f32, high: f32| -> Result<(), SceneError> {
                let range = || match (low > 0.0 && low < 1.0, high < f32::MAX) {
                    (true, _) => "a number above 0".to_owned(),
                    (false, false) => format!("a finite number from {low}"),
                    (false, true) => format!("a number from {low} to {high}"),
                };
                if value.is_nan() {
                    return Err(SceneError::new(format!("{place} {name}"), range(), "NaN"));
                }
                if *value < low || *value > high {
                    let clamped = value.clamp(low, high);
                    task.warn(&place, format!("{name}: expected {}, found {value}; {clamped} is used", range()));
                    *value = clamped;
                }
                Ok(())
            };
            for c in 0..4 {
                clamp("baseColorFactor", &mut material.base_color[c], 0.0, 1.0)?;
            }
            for c in 0..3 {
                clamp("emissiveFactor", &mut material.emission[c], 0.0, f32::MAX)?;
                clamp("attenuationColor", &mut material.attenuation_color[c], 0.0, 1.0)?;
            }
            clamp("metallicFactor", &mut material.metallic, 0.0, 1.0)?;
            clamp("roughnessFactor", &mut material.roughness, 0.0, 1.0)?;
            clamp("normalTexture.scale", &mut material.normal_scale, -1e6, 1e6)?;
            clamp("transmissionFactor", &mut material.transmission, 0.0, 1.0)?;
            if material.ior != 0.0 {
                clamp("ior", &mut material.ior, 1.0, 100.0)?;
            }
            clamp("specularFactor", &mut material.specular, 0.0, 1.0)?;
            for c in 0..3 {
                clamp("specularColorFactor", &mut material.specular_color[c], 0.0, f32::MAX)?;
            }
            clamp("dispersion", &mut material.dispersion, 0.0, 20.0)?;
            if let Some(coat) = &mut material.clearcoat {
                clamp("clearcoatFactor", &mut coat.factor, 0.0, 1.0)?;
                clamp("clearcoatRoughnessFactor", &mut coat.roughness, 0.0, 1.0)?;
                clamp("clearcoatNormalTexture.scale", &mut coat.normal_scale, -1e6, 1e6)?;
            }
            if let Some(sheen) = &mut material.sheen {
                for c in 0..3 {
                    clamp("sheenColorFactor", &mut sheen.color[c], 0.0, 1.0)?;
                }
                clamp("sheenRoughnessFactor", &mut sheen.roughness, 0.0, 1.0)?;
            }
            if let Some(film) = &mut material.iridescence {
                clamp("iridescenceFactor", &mut film.factor, 0.0, 1.0)?;
                clamp("iridescenceIor", &mut film.ior, 1.0, 100.0)?;
                clamp("iridescenceThicknessMinimum", &mut film.thickness_nm[0], 0.0, 1e6)?;
                clamp("iridescenceThicknessMaximum", &mut film.thickness_nm[1], 0.0, 1e6)?;
            }
            if let Some(stretch) = &mut material.anisotropy {
                clamp("anisotropyStrength", &mut stretch.strength, 0.0, 1.0)?;
                clamp("anisotropyRotation", &mut stretch.rotation_rad, -1e6, 1e6)?;
            }
            clamp("attenuationDistance", &mut material.attenuation_distance, f32::MIN_POSITIVE, f32::INFINITY)?;
            if let AlphaMode::Mask { cutoff } = &mut material.alpha_mode {
                clamp("alphaCutoff", cutoff, 0.0, f32::MAX)?;
            }
        }
        Ok(())
    }

    fn check_instances(&mut self, task: Task<'_>) -> Result<(), SceneError> {
        for (i, instance) in self.instances.iter().enumerate() {
            index(&format!("instance {i}"), instance.mesh, self.meshes.len(), "mesh")?;
            if !instance.scene_from_mesh.is_finite() {
                let place = format!("instance {i} of {}", self.meshes[instance.mesh].place);
                return Err(SceneError::new(place, "a finite transform", "NaN or infinity"));
            }
        }
        let meshes = &self.meshes;
        self.instances.retain(|instance| {
            let keep = is_invertible(&instance.scene_from_mesh);
            if !keep {
                task.warn(
                    &meshes[instance.mesh].place,
                    "a copy is left out, since its placement has no inverse, as with a scale of zero",
                );
            }
            keep && !meshes[instance.mesh].triangles.is_empty()
        });
        Ok(())
    }

    fn check_lights_and_cameras(&mut self, task: Task<'_>) -> Result<(), SceneError> {
        for (i, light) in self.lights.iter_mut().enumerate() {
            let place = format!("light {i}");
            if !(light.position.is_finite() && light.intensity.is_finite() && light.intensity.min_element() >= 0.0) {
                return Err(SceneError::new(
                    place,
                    "a finite position, and a finite intensity ≥ 0",
                    format!("position {} and intensity {}", light.position, light.intensity),
                ));
            }
            if let LightKind::Distant { half_angle_rad } = light.kind
                && !(0.0..=FRAC_PI_2).contains(&half_angle_rad)
            {
                return Err(SceneError::new(place, "a half angle from 0 to π/2", half_angle_rad.to_string()));
            }
            if let LightKind::Spot { inner_cone_rad: inner, outer_cone_rad: outer } = light.kind
                && !(0.0 <= inner && inner <= outer && 0.0 < outer && outer <= FRAC_PI_2)
            {
                let expected = "half angles of the cones with 0 ≤ inner ≤ outer ≤ π/2 and outer above 0";
                return Err(SceneError::new(place, expected, format!("inner {inner} and outer {outer}")));
            }
            light.direction = light
                .direction
                .try_normalize()
                .ok_or_else(|| SceneError::new(place, "a direction of nonzero length", light.direction.to_string()))?;
        }
        // A scale of 0 is a common way to hide a camera.
        let is_placed = |camera: &Camera| {
            let axes = camera.scene_from_camera.matrix3;
            let has_axes =
                axes.y_axis.cross(axes.z_axis).try_normalize().is_some() && axes.z_axis.try_normalize().is_some();
            if !has_axes || !camera.scene_from_camera.is_finite() {
                let message = "the camera is left out, since its placement has no three independent axes";
                task.warn(format!("camera {}", camera.name), message);
                return false;
            }
            true
        };
        self.cameras.retain(is_placed);
        for camera in &mut self.cameras {
            let place = format!("camera {}", camera.name);
            let axes = camera.scene_from_camera.matrix3;
            let z = axes.z_axis.try_normalize();
            let x = axes.y_axis.cross(axes.z_axis).try_normalize();
            let (Some(x), Some(z)) = (x, z) else { continue };
            // remove scale and shear from the camera's placement
            camera.scene_from_camera = Affine3A {
                matrix3: Mat3A::from_cols(x, Vec3A::cross(z, x), z),
                translation: camera.scene_from_camera.translation,
            };
            let is_positive = |value: f32| value > 0.0 && value.is_finite();
            let (is_valid, expected) = match camera.projection {
                Projection::Perspective { vertical_fov_rad: fov, aspect } => {
                    let is_valid = fov > 0.0 && fov < PI && aspect.is_none_or(is_positive);
                    (is_valid, "a vertical angle of view between 0 and π, and a finite aspect above 0")
                }
                Projection::Orthographic { half_width, half_height } => {
                    (is_positive(half_width) && is_positive(half_height), "a finite half width and height above 0")
                }
            };
            if !is_valid {
                return Err(SceneError::new(place, expected, format!("{:?}", camera.projection)));
            }
            if let Some(distance) = camera.focus_distance
                && !(distance.is_finite() && distance > 0.0)
            {
                return Err(SceneError::new(place, "a focus distance above 0", distance.to_string()));
            }
            // an invalid near plane is ignored
            camera.near = camera.near.filter(|near| near.is_finite() && *near >= 0.0);
        }
        Ok(())
    }
}

/// Returns true if a placement has an inverse that floats can hold.
fn is_invertible(map: &Affine3A) -> bool {
    let determinant = map.matrix3.determinant();
    determinant != 0.0 && determinant.is_finite() && Mat3A::inverse(&map.matrix3).is_finite()
}

fn index(place: &str, value: usize, count: usize, what: &str) -> Result<(), SceneError> {
    if value < count {
        return Ok(());
    }
    Err(SceneError::new(place, format!("the index of a {what}, below {count}"), value.to_string()))
}

/// Checks and repairs a mesh, and leaves out its triangles without area. Returns the number of
/// these triangles.
fn check_mesh(mesh: &mut Mesh, material_count: usize, task: Task<'_>) -> Result<usize, SceneError> {
    // check positions, lengths of lists, and indices
    let count = mesh.positions.len();
    index(&format!("{} material", mesh.place), mesh.material, material_count, "material")?;
    if let Some(at) = mesh.positions.iter().position(|p| !p.is_finite()) {
        let place = format!("{} POSITION[{at}]", mesh.place);
        return Err(SceneError::new(place, "finite coordinates", mesh.positions[at].to_string()));
    }
    let lengths = [
        ("NORMAL", mesh.normals.len()),
        ("TANGENT", mesh.tangents.len()),
        ("TEXCOORD_0", mesh.uvs[0].len()),
        ("TEXCOORD_1", mesh.uvs[1].len()),
        ("COLOR_0", mesh.colors.len()),
    ];
    for (name, length) in lengths {
        if length != 0 && length != count {
            return Err(SceneError::new(
                format!("{} {name}", mesh.place),
                format!("{count} entries, as POSITION has"),
                length.to_string(),
            ));
        }
    }
    if let Some(at) = mesh.triangles.iter().position(|t| t.iter().any(|&i| i as usize >= count)) {
        let place = format!("{} indices of triangle {at}", mesh.place);
        return Err(SceneError::new(
            place,
            format!("vertex indices below {count}"),
            format!("{:?}", mesh.triangles[at]),
        ));
    }
    // check the numbers of the other attributes
    for (set, uvs) in mesh.uvs.iter().enumerate() {
        if let Some(at) = uvs.iter().position(|uv| !uv.is_finite()) {
            let place = format!("{} TEXCOORD_{set}[{at}]", mesh.place);
            return Err(SceneError::new(place, "finite coordinates", uvs[at].to_string()));
        }
    }
    if let Some(at) = mesh.colors.iter().position(|color| !color.is_finite()) {
        let place = format!("{} COLOR_0[{at}]", mesh.place);
        return Err(SceneError::new(place, "finite colours", mesh.colors[at].to_string()));
    }
    // leave out triangles without area, and repair normals without a direction
    let before = mesh.triangles.len();
    let positions = &mesh.positions;
    mesh.triangles.retain(|&triangle| face_normal(positions, triangle).is_some());
    mend_normals(mesh, task);
    Ok(before - mesh.triangles.len())
}

/// Returns the unit normal of a triangle; `None` for a triangle without area.
fn face_normal(positions: &[Vec3], triangle: [u32; 3]) -> Option<Vec3> {
    // compute in f64, and divide by the largest coordinate of the two edges, so that tiny and huge
    // triangles keep their normals
    let [a, b, c] = triangle.map(|i| positions[i as usize].as_dvec3());
    let (u, v) = (b - a, c - a);
    let scale = u.abs().max_element().max(v.abs().max_element());
    if scale == 0.0 {
        return None;
    }
    (u / scale).cross(v / scale).try_normalize().map(|n| n.as_vec3())
}

/// Replaces normals without a direction by the mean normal of the faces around the vertex, and
/// normalizes all other normals.
fn mend_normals(mesh: &mut Mesh, task: Task<'_>) {
    let broken: Vec<usize> = (0..mesh.normals.len()).filter(|&i| mesh.normals[i].try_normalize().is_none()).collect();
    for normal in &mut mesh.normals {
        *normal = normal.try_normalize().unwrap_or(Vec3::ZERO);
    }
    if broken.is_empty() {
        return;
    }
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    for &triangle in &mesh.triangles {
        if let Some(normal) = face_normal(&mesh.positions, triangle) {
            triangle.iter().for_each(|&i| sums[i as usize] += normal);
        }
    }
    for &i in &broken {
        mesh.normals[i] = sums[i].try_normalize().unwrap_or(Vec3::Z);
    }
    task.warn(
        &mesh.place,
        format!(
            "normals without a direction, each of which is replaced by the mean normal of the faces around its vertex: {}",
            broken.len()
        ),
    );
}

/// Gives every triangle its own vertices and its face normal (glTF: meshes without normals are
/// shaded flat).
fn generate_flat_normals(mesh: &mut Mesh) {
    fn spread<T: Copy>(values: &mut Vec<T>, triangles: &[[u32; 3]]) {
        if !values.is_empty() {
            *values = triangles.iter().flatten().map(|&i| values[i as usize]).collect();
        }
    }
    mesh.normals = mesh
        .triangles
        .iter()
        .flat_map(|&triangle| [face_normal(&mesh.positions, triangle).unwrap_or(Vec3::Z); 3])
        .collect();
    spread(&mut mesh.positions, &mesh.triangles);
    mesh.uvs.iter_mut().for_each(|uvs| spread(uvs, &mesh.triangles));
    spread(&mut mesh.colors, &mesh.triangles);
    mesh.tangents.clear();
    mesh.triangles = (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
}

/// Generates tangents along increasing u, averaged over the triangles around a vertex and made
/// perpendicular to its normal. The bitangent points up in the texture, along decreasing v, since
/// green is up and v is down in glTF's normal maps.
fn generate_tangents(mesh: &mut Mesh, uv_set: usize) {
    // sum the tangents and bitangents of the triangles around each vertex
    let count = mesh.positions.len();
    let uvs = &mesh.uvs[uv_set];
    let mut sums = vec![(Vec3::ZERO, Vec3::ZERO); count];
    if uvs.len() == count {
        for &triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| i as usize);
            let (e1, e2) = (mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]);
            let (d1, d2): (Vec2, Vec2) = (uvs[b] - uvs[a], uvs[c] - uvs[a]);
            let determinant = d1.perp_dot(d2);
            if determinant != 0.0 && determinant.is_finite() {
                let sign = determinant.signum();
                let tangent = ((e1 * d2.y - e2 * d1.y) * sign).normalize_or_zero();
                let bitangent = ((e1 * d2.x - e2 * d1.x) * sign).normalize_or_zero();
                for i in [a, b, c] {
                    sums[i].0 += tangent;
                    sums[i].1 += bitangent;
                }
            }
        }
    }
    // make tangents perpendicular to the normal; a vertex without texture coordinates gets any
    // direction
    mesh.tangents = sums
        .iter()
        .zip(&mesh.normals)
        .map(|(&(tangent, bitangent), &normal)| {
            let perpendicular = (tangent - normal * normal.dot(tangent)).try_normalize();
            let tangent = perpendicular.unwrap_or_else(|| normal.any_orthonormal_vector());
            let handedness = if normal.cross(tangent).dot(bitangent) < 0.0 { -1.0 } else { 1.0 };
            tangent.extend(handedness)
        })
        .collect();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Filter, Image, Texture, Wrap};
    use lumistack_core::{Cancel, Collector};

    fn triangle() -> SceneParts {
        SceneParts {
            name: "test".into(),
            meshes: vec![Mesh {
                place: "/meshes/0/primitives/0".into(),
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, scene_from_mesh: Affine3A::IDENTITY }],
            materials: vec![Material::default()],
            ..SceneParts::default()
        }
    }

    fn validate(parts: SceneParts) -> (Result<Scene, SceneError>, Vec<lumistack_core::Warning>) {
        let (collector, cancel) = (Collector::default(), Cancel::default());
        let result = parts.validate(Task::quiet(&collector, &cancel));
        (result, collector.take())
    }

    #[test]
    fn a_bare_triangle_gets_its_face_normal() {
        let (scene, warnings) = validate(triangle());
        let scene = scene.unwrap();
        assert_eq!(scene.meshes[0].normals, vec![Vec3::Z; 3]);
        assert_eq!(scene.bounds().max, Vec3::new(1.0, 1.0, 0.0));
        assert!(warnings.is_empty() && !scene.is_lit());
    }

    #[test]
    fn a_camera_of_scale_0_is_left_out() {
        let mut parts = triangle();
        let named = |name: &str, scale: f32| Camera {
            name: name.into(),
            scene_from_camera: Affine3A::from_scale(Vec3::splat(scale)),
            projection: crate::Projection::Perspective { vertical_fov_rad: 0.5, aspect: None },
            focus_distance: None,
            near: None,
        };
        parts.cameras = vec![named("hidden", 0.0), named("seen", 2.0)];
        let (scene, warnings) = validate(parts);
        let names: Vec<_> = scene.unwrap().cameras.iter().map(|camera| camera.name.clone()).collect();
        assert_eq!(names, ["seen"]);
        assert!(warnings.len() == 1 && warnings[0].to_string().contains("camera hidden"), "{warnings:?}");
    }

    #[test]
    fn impossible_cameras_and_rotations_are_refused() {
        let refused = |projection| {
            let mut parts = triangle();
            let scene_from_camera = Affine3A::IDENTITY;
            parts.cameras =
                vec![Camera { name: "a".into(), scene_from_camera, projection, focus_distance: None, near: None }];
            validate(parts).0.unwrap_err().to_string()
        };
        for vertical_fov_rad in [0.0, -1.0, PI, f32::NAN] {
            let error = refused(Projection::Perspective { vertical_fov_rad, aspect: None });
            assert!(error.starts_with("camera a: expected a vertical angle of view between 0 and π"), "{error}");
        }
        for value in [0.0, f32::INFINITY] {
            let error = refused(Projection::Perspective { vertical_fov_rad: 1.0, aspect: Some(value) });
            assert!(error.contains("a finite aspect above 0"), "{error}");
            let error = refused(Projection::Orthographic { half_width: 1.0, half_height: value });
            assert!(error.starts_with("camera a: expected a finite half width"), "{error}");
        }
        for turn in [f32::NAN, 0.0] {
            let mut parts = triangle();
            parts.images.push(Image {
                name: "sky".into(),
                width: 1,
                height: 1,
                pixels: Pixels::RgbF32(vec![[1.0; 3]]),
            });
            let scene_from_environment = glam::Quat::from_array([turn; 4]);
            parts.environment = Some(crate::Environment { image: 0, strength: Vec3::ONE, scene_from_environment });
            let error = validate(parts).0.unwrap_err().to_string();
            assert!(error.starts_with("environment rotation: expected a finite quaternion"), "{error}");
        }
    }

    #[test]
    fn a_glowing_label_is_no_lamp() {
        let mut parts = triangle();
        parts.materials[0].emission = Vec3::ONE;
        assert!(!validate(parts.clone()).0.unwrap().is_lit());
        parts.materials[0].emission = Vec3::splat(5.0);
        assert!(validate(parts).0.unwrap().is_lit());
    }

    #[test]
    fn a_lamp_is_known_by_its_picture_as_well_as_by_its_factor() {
        let with = |factor: f32, brightest: f32| {
            let mut parts = triangle();
            let pixels = Pixels::RgbF32(vec![[0.0; 3], [brightest, 0.0, 0.0]]);
            parts.images.push(Image { name: "glow".into(), width: 2, height: 1, pixels });
            let [wrap_u, wrap_v] = [Wrap::Repeat; 2];
            parts.textures.push(Texture { image: 0, wrap_u, wrap_v, filter: Filter::Linear });
            let texture_from_mesh = glam::Affine2::IDENTITY;
            parts.materials[0].emission = Vec3::splat(factor);
            parts.materials[0].emission_texture = Some(TextureUse { texture: 0, uv_set: 0, texture_from_mesh });
            parts.meshes[0].uvs[0] = vec![Vec2::ZERO; 3];
            validate(parts).0.unwrap().is_lit()
        };
        assert!(with(1.0, 5.0), "the picture exceeds white");
        assert!(with(5.0, 1.0));
        assert!(!with(5.0, 0.1) && !with(0.1, 5.0), "their product is below white");
    }

    #[test]
    fn nan_positions_are_refused_with_their_place() {
        let mut parts = triangle();
        parts.meshes[0].positions[1].y = f32::NAN;
        let error = validate(parts).0.unwrap_err().to_string();
        assert!(error.starts_with("/meshes/0/primitives/0 POSITION[1]: expected finite coordinates, found"), "{error}");
    }

    #[test]
    fn triangles_without_area_are_left_out_and_an_empty_scene_is_refused() {
        let mut parts = triangle();
        parts.meshes[0].triangles.push([0, 1, 1]);
        let (scene, warnings) = validate(parts.clone());
        assert_eq!(scene.unwrap().triangle_count(), 1);
        assert_eq!(warnings.len(), 1);
        parts.meshes[0].triangles.remove(0);
        assert!(validate(parts).0.unwrap_err().to_string().contains("at least one triangle"));
        assert!(validate(SceneParts::default()).0.is_err());
    }

    #[test]
    fn a_tiny_triangle_is_not_taken_for_an_empty_one() {
        let mut parts = triangle();
        parts.meshes[0].positions.iter_mut().for_each(|p| *p *= 1e-22);
        assert_eq!(validate(parts).0.unwrap().triangle_count(), 1);
    }

    #[test]
    fn indices_are_checked() {
        let mut parts = triangle();
        parts.meshes[0].triangles[0][2] = 3;
        assert!(validate(parts).0.unwrap_err().to_string().contains("vertex indices below 3"));
        let mut parts = triangle();
        parts.meshes[0].material = 1;
        assert!(validate(parts).0.is_err());
        let mut parts = triangle();
        parts.instances[0].mesh = 9;
        assert!(validate(parts).0.is_err());
    }

    #[test]
    fn generated_tangents_follow_u() {
        let mut parts = triangle();
        parts.materials[0].normal_texture =
            Some(crate::TextureUse { texture: 0, uv_set: 0, texture_from_mesh: glam::Affine2::IDENTITY });
        parts.textures.push(crate::Texture {
            image: 0,
            wrap_u: crate::Wrap::Repeat,
            wrap_v: crate::Wrap::Repeat,
            filter: crate::Filter::Linear,
        });
        parts.images.push(crate::Image { name: "n".into(), width: 1, height: 1, pixels: Pixels::Rgba8(vec![[0; 4]]) });
        // u is along x and v along −y, as in a picture that is not mirrored. So up in the texture
        // is +y, which is normal × tangent.
        parts.meshes[0].uvs[0] = vec![Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(0.0, 0.0)];
        let scene = validate(parts).0.unwrap();
        assert_eq!(scene.meshes[0].tangents[0], Vec3::X.extend(1.0));
    }
}
