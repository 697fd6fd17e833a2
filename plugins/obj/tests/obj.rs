//! Imports OBJ files through the plugin's C function, and reads the result with this project's glTF
//! reader.

use std::collections::BTreeMap;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_gltf::AssetResolver;
use lumistack_plugin::PluginError;
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin_obj::PLUGIN;
use lumistack_plugin_testkit::serve::{LogLevel, Plugin, import, resolved};
use lumistack_plugin_testkit::{MemoryHost, conformance, import_conformance};

/// A file with a quad and a triangle of two materials, in the form that modelling programs write.
const OBJ: &str = "mtllib looks.mtl\no Card\nv 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n\
    usemtl red\nf 1/1/1 2/2/1 3/3/1 4/4/1\no Roof\nv 0 1 -3\nusemtl lamp\nf 3//1 4//1 5//1\n";
const MTL: &str = "newmtl red\nKd 0.5 0.25 0.125\nNs 250\nnewmtl lamp\nKd 0 0 0\nKe 4 2 1\nPr 0.75\n";

struct Files(BTreeMap<&'static str, &'static str>);

impl AssetResolver for Files {
    fn read(&self, uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
        self.0.get(uri).map(|text| text.as_bytes().to_vec()).ok_or_else(|| "no such file".into())
    }
}

fn files() -> Files {
    Files(BTreeMap::from([("a.obj", OBJ), ("looks.mtl", MTL)]))
}

fn document(files: &Files, params: &Value, host: &MemoryHost) -> Result<Vec<u8>, PluginError> {
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    let read = |path: &str| files.read(path, u64::MAX).map_err(|error| PluginError::Failed(format!("{path}: {error}")));
    import(&plugin, host, &resolved(&plugin, params)?, "a.obj", &read)
}

fn scene(params: &Value) -> lumistack_scene::Scene {
    let (files, warnings, cancel) = (files(), Collector::default(), Cancel::default());
    let bytes = document(&files, params, &MemoryHost::new()).unwrap();
    let scene = lumistack_gltf::load("a.glb", &bytes, &files, Task::quiet(&warnings, &cancel)).unwrap();
    let texts: Vec<String> = warnings.take().iter().map(ToString::to_string).collect();
    assert!(texts.is_empty(), "{texts:?}");
    scene
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    import_conformance(&plugin, "a.obj", &[("a.obj", OBJ.as_bytes()), ("looks.mtl", MTL.as_bytes())]).unwrap();
}

#[test]
fn meshes_and_materials_arrive() {
    let scene = scene(&json!({}));
    assert_eq!(scene.triangle_count(), 3);
    let bounds = scene.bounds();
    assert_eq!((bounds.min.to_array(), bounds.max.to_array()), ([0.0, 0.0, -3.0], [2.0, 1.0, 0.0]));
    let red = scene.materials.iter().find(|material| material.base_color[0] == 0.5).expect("the red material");
    assert_eq!(red.base_color.to_array(), [0.5, 0.25, 0.125, 1.0]);
    assert!((red.roughness - 0.5).abs() < 1e-6, "Ns 250 is a roughness of 1 − √0.25");
    let lamp = scene.materials.iter().find(|material| material.emission[0] == 4.0).expect("the lamp");
    assert_eq!((lamp.emission.to_array(), lamp.roughness), ([4.0, 2.0, 1.0], 0.75));
}

#[test]
fn the_axis_and_the_unit_are_the_user_s() {
    let bounds = scene(&json!({"up": "z", "scale": 10.0})).bounds();
    // If z is up, the point (x, y, z) becomes (x, z, −y).
    let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
    for (found, expected) in min.iter().chain(&max).zip([0.0, -30.0, -10.0, 20.0, 0.0, 0.0]) {
        assert!((found - expected).abs() < 1e-4, "{min:?} to {max:?}");
    }
}

#[test]
fn a_missing_material_file_is_a_warning() {
    let host = MemoryHost::new();
    document(&Files(BTreeMap::from([("a.obj", OBJ)])), &json!({}), &host).unwrap();
    let messages = host.messages();
    assert_eq!(messages.len(), 1, "{messages:?}");
    assert_eq!(messages[0], (LogLevel::Warn, "a.obj: materials are missing: looks.mtl: no such file".into()));
}

#[test]
fn files_that_make_no_sense_are_named() {
    for (text, expected) in [
        ("", "expected faces, found none"),
        ("v 1 2\nf 1 2 3\n", "a.obj: at or before line 1: "),
        ("f 1 2 3\n", "a.obj: at or before line 1: "),
        // The parser's arithmetic would overflow for these indices, so they must not reach it.
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//-2 2//1 3//1\n",
            "a.obj: at or before line 5: face normal index out of bounds",
        ),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\nf 1/9223372036854775807 2/1 3/1\n", "face texcoord index out of bounds"),
    ] {
        let error = document(&Files(BTreeMap::from([("a.obj", text)])), &json!({}), &MemoryHost::new()).unwrap_err();
        assert!(matches!(&error, PluginError::Failed(message) if message.contains(expected)), "{text:?}: {error:?}");
    }
    let error = document(&Files(BTreeMap::new()), &json!({}), &MemoryHost::new()).unwrap_err();
    assert_eq!(error.to_string(), "a.obj: no such file");
}

/// A file with forms that other programs write and read: one value for a grey, a single texture
/// coordinate, and options before a picture's name. It also has continued lines, comments after
/// numbers, several libraries in one line, and bytes that are not UTF-8.
#[test]
fn legal_files_of_other_programs_load() {
    let obj = b"# \xE4\nmtllib one.mtl two.mtl\no K\xE4se\nv 0 0 0 # corner\nv 1 0 0\nv 0 1 0\nvt 0.5\nvt 1\nvt 0\n\
        usemtl grey\nf 1/1 2/2 \\\n3/3\nusemtl placed\nf 1/1 2/2 3/3\n";
    let placed = b"newmtl placed\nmap_Kd -s 2 3 1 -o 0.25 0.5 a picture.png\nmap_Bump b.png\n";
    let png = {
        let mut bytes = Vec::new();
        let picture = image::RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 0]));
        picture.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
        bytes
    };
    let read = |path: &str| match path {
        "a.obj" => Ok(obj.to_vec()),
        "one.mtl" => Ok(b"newmtl grey\nKd 0.5\n".to_vec()),
        "two.mtl" => Ok(placed.to_vec()),
        "a picture.png" => Ok(png.clone()),
        _ => Err(PluginError::Failed(format!("{path}: no such file"))),
    };
    struct Of<F>(F);
    impl<F: Fn(&str) -> Result<Vec<u8>, PluginError>> AssetResolver for Of<F> {
        fn read(&self, uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
            self.0(uri).map_err(|error| error.to_string())
        }
    }
    let (plugin, host) = (Plugin::compiled_in(&PLUGIN).unwrap(), MemoryHost::new());
    let bytes = import(&plugin, &host, &resolved(&plugin, &json!({})).unwrap(), "a.obj", &read).unwrap();
    assert_eq!(
        host.messages(),
        [(LogLevel::Warn, "two.mtl: line 3: `map_Bump` is not supported and has no effect".into())]
    );
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let scene = lumistack_gltf::load("a.glb", &bytes, &Of(read), Task::quiet(&warnings, &cancel)).unwrap();
    assert!(warnings.take().is_empty());
    assert_eq!(scene.triangle_count(), 2);
    assert_eq!(scene.materials[0].base_color.to_array(), [0.5, 0.5, 0.5, 1.0]);
    // The map's scale and offset must move the corner (0.5, 0) to (2 · 0.5 + 0.25, 3 · 0 + 0.5).
    // Since v points downwards in glTF, the second coordinate becomes 1 − 0.5.
    let texture = scene.materials[1].base_color_texture.expect("a picture");
    let mesh = scene.meshes.iter().find(|mesh| mesh.material == 1).unwrap();
    let corner = mesh.positions.iter().position(|position| position.to_array() == [0.0; 3]).unwrap();
    let at = texture.texture_from_mesh.transform_point2(mesh.uvs[texture.uv_set][corner]);
    assert!((at.x - 1.25).abs() < 1e-6 && (at.y - 0.5).abs() < 1e-6, "{at}");
}

/// The picture of an MTL file is searched in the folder of this file, then in the folder of the OBJ
/// file. A missing picture, and a comment that ends with a backslash, do not refuse the scene.
#[test]
fn pictures_are_found_beside_their_material_file() {
    let obj = "# exported from C:\\scenes\\\nmtllib mat/m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/1 2/2 3/3\nusemtl c\nf 1/1 2/2 3/3\nf 1 2 3\n";
    let mtl = "newmtl a\nmap_Kd tex/a.png\nnewmtl b\nmap_Kd b.png\nnewmtl c\nmap_Kd C:\\Users\\me\\wood.png\n";
    let files = BTreeMap::from([("a.obj", obj), ("mat/m.mtl", mtl), ("mat/tex/a.png", ""), ("b.png", "")]);
    let host = MemoryHost::new();
    let bytes = document(&Files(files), &json!({}), &host).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let root: Value = lumistack_plugin::serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let images: Vec<_> = root["images"].as_array().unwrap().iter().map(|image| &image["uri"]).collect();
    assert_eq!(images, ["mat/tex/a.png", "b.png"]);
    let texts: Vec<String> = host.messages().into_iter().map(|(_, text)| text).collect();
    let all = texts.join("\n");
    assert!(all.contains("the picture C:\\Users\\me\\wood.png is left out"), "{all}");
    assert!(all.contains("only some faces have texture coordinates"), "{all}");
}

/// Six values after `v` are a position and an sRGB colour, as MeshLab, trimesh and Blender write
/// them. The colours of the mesh are linear. Colours up to 255 are divided by 255. A mesh with a
/// texture gets no colours.
#[test]
fn colours_of_vertices_arrive() {
    let colours = |text: &'static str| {
        let files = Files(BTreeMap::from([("a.obj", text), ("a.mtl", "newmtl m\nmap_Kd a.png\n"), ("a.png", "none")]));
        let bytes = document(&files, &json!({}), &MemoryHost::new()).unwrap();
        let json = String::from_utf8_lossy(&bytes).into_owned();
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let scene = lumistack_gltf::load("a.glb", &bytes, &files, Task::quiet(&warnings, &cancel));
        (json.contains("COLOR_0"), scene.map(|scene| scene.meshes[0].colors.clone()).unwrap_or_default())
    };
    let expected = [[1.0, 0.214_041, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.003_095_98, 1.0, 1.0]];
    for text in [
        "v 0 0 0 1 0.5 0\nv 1 0 0 0 0 1\nv 0 1 0 -1 0.04 1\nf 1 2 3\n",
        "v 0 0 0 255 127.5 0\nv 1 0 0 0 0 255\nv 0 1 0 -1 10.2 255\nf 1 2 3\n",
    ] {
        let (_, found) = colours(text);
        for (color, expected) in found.iter().zip(expected) {
            assert!(color.abs_diff_eq(expected.into(), 1e-6), "{color} {expected:?}");
        }
        assert_eq!(found.len(), 3);
    }
    let textured = "mtllib a.mtl\nusemtl m\nv 0 0 0 1 1 1\nv 1 0 0 1 1 1\nv 0 1 0 1 1 1\nvt 0 0\nf 1/1 2/1 3/1\n";
    assert!(!colours(textured).0);
}
