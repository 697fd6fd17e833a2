//! Importer plugin `obj`: converts a Wavefront OBJ file with the materials of its MTL files into a
//! glTF 2.0 document (`.glb`).
//!
//! | OBJ, MTL | glTF |
//! |---|---|
//! | `v`, `vn`, `vt` | positions, normals, texture coordinates (v points downwards in glTF). If only some faces of an object have normals or coordinates, they are left out with a warning |
//! | `v` with six values | positions and vertex colours (sRGB, 0 to 1, or 0 to 255 if a value exceeds 1), which multiply the base colour unless it has a texture. All vertices must have colours, or none |
//! | `f` | triangles; polygons become fans of triangles |
//! | `o`, `g`, `usemtl` | one mesh per object or group and material |
//! | `Kd`, `map_Kd`, `d` | base colour (linear), its texture with scale `-s`, offset `-o` and `-clamp`, alpha |
//! | `Ke` | emission |
//! | `Ns` | roughness = 1 − √(Ns / 1000), as Blender writes it |
//! | `Pr`, `Pm` | roughness and metallic, if the file has them |
//!
//! Lines, points and curves are ignored. All maps except `map_Kd` are ignored with a warning. OBJ
//! files state neither their unit nor their upward axis, so the parameters `scale` and `up` set
//! them.

mod glb;
mod mtl;
mod paths;
mod text;
mod up;

use std::cell::RefCell;
use std::collections::HashMap;
use std::path::Path;

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Assets, Host, ImporterPlugin, Param, PluginError, Schema, export_plugin};
use tobj::{LoadOptions, Material};

use crate::mtl::{Map, MtlMaterial};
use crate::paths::forward;
use crate::up::Up;

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin `obj`.
pub struct Obj;

/// Parameters; see [`Obj::schema`](ImporterPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct ObjParams {
    up: Up,
    scale: f64,
}

impl ImporterPlugin for Obj {
    const DOC: &'static str = "Reads Wavefront OBJ files with the materials of their MTL files.";
    const EXTENSIONS: &'static [&'static str] = &["obj"];
    type Params = ObjParams;

    fn schema() -> Schema {
        Schema::new([
            Param::choice(
                "up",
                "y",
                [
                    ("y", "The y axis, as in the files of most programs."),
                    ("z", "The z axis, as in the files of CAD programs."),
                ],
                "The file's upward axis.",
            ),
            Param::float("scale", 1.0, 1e-9..=1e9, "Size of the file's unit.").unit("scene units"),
        ])
    }

    fn import(host: &Host, params: ObjParams, file: &str, assets: &Assets<'_>) -> Result<Vec<u8>, PluginError> {
        let bytes = assets.read(file)?;
        host.check_cancelled()?;
        let options = LoadOptions { triangulate: true, single_index: true, ignore_points: true, ignore_lines: true };
        let content = text::decode(&bytes);
        let mut shapes = text::Shapes::of(&content);
        let line = shapes.line();
        let collected = RefCell::new(Vec::new());
        let library = |path: &Path| {
            let found = materials(host, assets, file, &forward(path));
            // `tobj`, the parser of OBJ files, needs only the names and the indices of materials.
            let known =
                found.iter().enumerate().map(|(i, material)| (material.name.clone(), i)).collect::<HashMap<_, _>>();
            let nameless = vec![Material::default(); found.len()];
            collected.borrow_mut().extend(found);
            Ok((nameless, known))
        };
        let (models, _) = tobj::load_obj_buf(&mut shapes, &options, library).map_err(|error| {
            // The parser reports an error of a face only at the end of the face's object, so the
            // line may be later than the face.
            PluginError::Failed(format!("{file}: at or before line {}: {error}", line.get()))
        })?;
        host.check_cancelled()?;
        let all = collected.into_inner();
        let models: Vec<_> = models.into_iter().filter(|model| !model.mesh.indices.is_empty()).collect();
        if models.is_empty() {
            return Err(PluginError::Failed(format!("{file}: expected faces, found none")));
        }
        warn_of_missing(host, &models);
        glb::document(&models, &all, params.up, params.scale)
    }
}

/// Reads the materials of the MTL files that a line `mtllib` names. `names` is the name of one
/// file, or the names of several files, separated by spaces. A missing file causes a warning.
fn materials(host: &Host, assets: &Assets<'_>, file: &str, names: &str) -> Vec<MtlMaterial> {
    let read = |name: &str| {
        let bytes = assets.read(name)?;
        let mut warn = |line: usize, message: String| host.warn(&format!("{name}: line {line}: {message}"));
        let mut found = mtl::parse(&text::decode(&bytes), &mut warn);
        // Many materials may share a picture, so each path is tried once.
        let mut known = HashMap::new();
        for material in &mut found {
            let map = material.diffuse_map.take();
            material.diffuse_map = map.and_then(|map| found_map(host, assets, name, map, &mut known));
        }
        Ok::<_, PluginError>(found)
    };
    let warn = |error: PluginError| host.warn(&format!("{file}: materials are missing: {error}"));
    let error = match read(names) {
        Ok(found) => return found,
        Err(error) => error,
    };
    // No file has the whole text as its name, so the text may be several names.
    if !names.contains(char::is_whitespace) {
        warn(error);
        return Vec::new();
    }
    let each = names.split_whitespace().map(|name| {
        read(name).unwrap_or_else(|error| {
            warn(error);
            Vec::new()
        })
    });
    each.flatten().collect()
}

/// Finds the picture of a map: relative to the folder of the MTL file `mtl`, or else to the folder
/// of the OBJ file. Returns the map with the picture's path relative to the OBJ file. A missing
/// picture causes a warning, and the material has no map.
fn found_map(
    host: &Host,
    assets: &Assets<'_>,
    mtl: &str,
    map: Map,
    known: &mut HashMap<String, Option<String>>,
) -> Option<Map> {
    let find = || {
        let own = forward(Path::new(&map.file));
        let beside = mtl.rsplit_once('/').map(|(folder, _)| format!("{folder}/{own}"));
        let mut reason = String::new();
        for file in beside.into_iter().chain([own]) {
            match assets.read(&file) {
                Ok(_) => return Some(file),
                Err(error) => reason = error.to_string(),
            }
        }
        host.warn(&format!("{mtl}: the picture {} is left out: {reason}", map.file));
        None
    };
    let file = known.entry(map.file.clone()).or_insert_with(find).clone()?;
    Some(Map { file, ..map })
}

/// Warns if only some faces of a mesh have normals or texture coordinates, which the mesh then
/// lacks.
fn warn_of_missing(host: &Host, models: &[tobj::Model]) {
    for tobj::Model { mesh, name } in models {
        let vertices = mesh.positions.len() / 3;
        for (what, count) in [("normals", mesh.normals.len() / 3), ("texture coordinates", mesh.texcoords.len() / 2)] {
            if count != 0 && count != vertices {
                host.warn(&format!(
                    "object {name}: only some faces have {what}, so the {what} of the object are left out"
                ));
            }
        }
    }
}

export_plugin!("obj", Obj as importer);
