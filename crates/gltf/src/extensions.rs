//! The extensions that are read, and the handling of others. `docs/GLTF.md` has a table of them for
//! users; a test compares this table with the list here.

use crate::document::Document;
use crate::error::Fault;

/// Handling of an extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Handling {
    /// The extension is read, and a file may require it.
    Read,
    /// The extension does not change the picture, and a file may require it.
    WithoutEffect,
    /// The extension is not read. A file that requires it is refused, and a file that uses it is
    /// loaded with a warning. The text is advice for the user, which starts with "; " or is empty.
    NotRead(&'static str),
}

use Handling::{NotRead, Read, WithoutEffect};

const EXTENSIONS: [(&str, Handling); 37] = [
    ("EXT_mesh_gpu_instancing", Read),
    ("EXT_meshopt_compression", Read),
    ("EXT_texture_webp", Read),
    ("KHR_draco_mesh_compression", Read),
    ("KHR_gaussian_splatting", Read),
    ("KHR_gaussian_splatting_compression_spz_2", Read),
    ("KHR_lights_punctual", Read),
    ("KHR_materials_anisotropy", Read),
    ("KHR_materials_clearcoat", Read),
    ("KHR_materials_dispersion", Read),
    ("KHR_materials_emissive_strength", Read),
    ("KHR_materials_ior", Read),
    ("KHR_materials_iridescence", Read),
    ("KHR_materials_pbrSpecularGlossiness", Read),
    ("KHR_materials_sheen", Read),
    ("KHR_materials_specular", Read),
    ("KHR_materials_transmission", Read),
    ("KHR_materials_unlit", Read),
    ("KHR_materials_variants", Read),
    ("KHR_materials_volume", Read),
    ("KHR_mesh_quantization", Read),
    ("KHR_meshopt_compression", Read),
    ("KHR_node_visibility", Read),
    ("KHR_texture_basisu", Read),
    ("KHR_texture_transform", Read),
    ("KHR_node_hoverability", WithoutEffect),
    ("KHR_node_selectability", WithoutEffect),
    ("KHR_xmp", WithoutEffect),
    ("KHR_xmp_json_ld", WithoutEffect),
    ("EXT_lights_image_based", NotRead("; give an environment map in the job instead")),
    ("EXT_texture_avif", NotRead("; `gltf-transform png IN OUT` writes pictures that can be read")),
    ("KHR_animation_pointer", NotRead("")),
    ("KHR_audio_emitter", NotRead("")),
    ("KHR_materials_diffuse_transmission", NotRead("")),
    ("KHR_materials_volume_scatter", NotRead("")),
    (
        "KHR_techniques_webgl",
        NotRead("; its shaders do not describe how surfaces reflect light, so export metallic-roughness materials"),
    ),
    ("MSFT_texture_dds", NotRead("; `gltf-transform png IN OUT` writes pictures that can be read")),
];

/// Refuses a file that requires an extension which is not read. Warns of each extension that a file
/// uses and that is not read.
pub(crate) fn check(document: &Document<'_>) -> Result<(), Fault> {
    let handling =
        |name: &str| EXTENSIONS.iter().find(|(known, _)| *known == name).map_or(NotRead(""), |found| found.1);
    for (i, name) in document.root.extensions_required.iter().enumerate() {
        if let NotRead(advice) = handling(name) {
            let read = EXTENSIONS.iter().filter(|(_, handling)| *handling == Read).map(|(name, _)| *name);
            return Err(Fault::UnsupportedExtension {
                place: format!("/extensionsRequired/{i}"),
                name: name.clone(),
                supported: read.collect::<Vec<_>>().join(", "),
                advice: advice.to_owned(),
            });
        }
    }
    for (i, name) in document.root.extensions_used.iter().enumerate() {
        if let NotRead(advice) = handling(name) {
            let message = format!("{name} is not supported and has no effect{advice}");
            document.task.warn(format!("/extensionsUsed/{i}"), message);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// Returns the rows of the table in `docs/GLTF.md`: extension, handling, and the test that
    /// shows it.
    fn rows() -> Vec<[&'static str; 3]> {
        let text = include_str!("../../../docs/GLTF.md");
        let table = text.split("| extension |").nth(1).expect("a table of extensions");
        let lines = table.lines().skip(2).take_while(|line| line.starts_with('|'));
        let cells = lines.map(|line| line.trim_matches('|').split(" | ").map(str::trim).collect::<Vec<_>>());
        cells.map(|cells| cells.try_into().expect("three columns")).collect()
    }

    #[test]
    fn the_table_for_users_lists_what_is_read() {
        let mut listed: Vec<(&str, bool)> =
            rows().iter().map(|row| (row[0].trim_matches('`'), row[1] == "not read")).collect();
        let mut expected: Vec<(&str, bool)> =
            EXTENSIONS.iter().map(|(name, handling)| (*name, matches!(handling, NotRead(_)))).collect();
        listed.sort_unstable();
        expected.sort_unstable();
        assert_eq!(listed, expected);
    }

    #[test]
    fn every_row_of_the_table_names_a_test() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/gltf");
        let sources: Vec<(String, String)> = std::fs::read_dir(folder)
            .unwrap()
            .filter_map(|entry| {
                let path = entry.unwrap().path();
                let stem = path.extension().is_some_and(|e| e == "rs").then(|| path.file_stem())??;
                Some((stem.to_string_lossy().into_owned(), std::fs::read_to_string(&path).unwrap()))
            })
            .collect();
        for [extension, _, test] in rows() {
            let (file, name) = test.trim_matches('`').split_once("::").unwrap_or_else(|| panic!("{extension}: {test}"));
            let source = &sources.iter().find(|(stem, _)| stem == file).unwrap_or_else(|| panic!("{test}")).1;
            let body = source.split(&format!("#[test]\nfn {name}()")).nth(1);
            let body = body.unwrap_or_else(|| panic!("{extension}: no test {test}")).split("\n}\n").next().unwrap();
            // the file of the test must contain the name of the extension, in the test itself or in
            // a list or helper
            let plain = extension.trim_matches('`');
            assert!(body.contains(plain) || source.contains(plain), "{extension}: {test} does not mention it");
        }
    }
}
