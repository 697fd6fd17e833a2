//! Importer plugin `obj`: Wavefront OBJ with the materials of its MTL files, as a glTF 2.0 document (`.glb`).
//!
//! | OBJ, MTL | glTF |
//! |---|---|
//! | `v`, `vn`, `vt` | positions, normals, texture coordinates (v turned downwards) |
//! | `f` | triangles; polygons as fans |
//! | `o`, `g`, `usemtl` | one mesh per object or group and material |
//! | `Kd`, `map_Kd`, `d` | base colour (linear), its texture, alpha |
//! | `Ke` | emission |
//! | `Ns` | roughness = 1 − √(Ns / 1000), as Blender writes it |
//! | `Pr`, `Pm` | roughness and metallic, where the file has them |
//!
//! Lines, points, curves and other maps are left out. OBJ has no unit and no agreed upward axis: `scale` and `up` say them.

mod glb;

use std::io::BufReader;
use std::path::Path;

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Assets, Host, ImporterPlugin, Param, PluginError, Schema, export_plugin};
use tobj::{LoadError, LoadOptions};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin.
pub struct Obj;

/// Parameters; see [`Obj::schema`](ImporterPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct ObjParams {
    up: Up,
    scale: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub(crate) enum Up {
    Y,
    Z,
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
                [("y", "The y axis, as most programs write it."), ("z", "The z axis, as CAD programs do.")],
                "Which axis of the file points upwards.",
            ),
            Param::float("scale", 1.0, 1e-9..=1e9, "Size of the file's unit.").unit("scene units"),
        ])
    }

    fn import(host: &Host, params: ObjParams, file: &str, assets: &Assets<'_>) -> Result<Vec<u8>, PluginError> {
        let bytes = assets.read(file)?;
        host.check_cancelled()?;
        let options = LoadOptions { triangulate: true, single_index: true, ignore_points: true, ignore_lines: true };
        let (models, materials) = tobj::load_obj_buf(&mut BufReader::new(&*bytes), &options, |path| {
            let path = forward(path);
            let bytes = assets.read(&path).map_err(|error| {
                host.warn(&format!("{file}: without its materials: {error}"));
                LoadError::OpenFileFailed
            })?;
            tobj::load_mtl_buf(&mut BufReader::new(&*bytes))
        })
        .map_err(|error| PluginError::Failed(format!("{file}: {error}")))?;
        host.check_cancelled()?;
        let materials = materials.unwrap_or_else(|error| {
            if error != LoadError::OpenFileFailed {
                host.warn(&format!("{file}: without its materials: {error}"));
            }
            Vec::new()
        });
        let models: Vec<_> = models.into_iter().filter(|model| !model.mesh.indices.is_empty()).collect();
        if models.is_empty() {
            return Err(PluginError::Failed(format!("{file}: expected faces, found none")));
        }
        glb::document(&models, &materials, params.up, params.scale)
    }
}

/// A path of an OBJ or MTL file, which may come from Windows.
pub(crate) fn forward(path: &Path) -> String {
    path.to_string_lossy().replace('\\', "/").trim_start_matches("./").to_string()
}

export_plugin!("obj", Obj as importer);
