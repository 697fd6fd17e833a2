//! Reports that a scene's file lacks a camera or lights. Many exporters omit cameras and lights by
//! default, so a user may not expect the view and the light that replace them.

use std::path::Path;

/// Returns a sentence for a missing camera and a sentence for missing lights. Each sentence states
/// the replacement and the option that changes it. If a glTF file lacks a camera or lights, a last
/// sentence names the settings of Blender's export.
pub fn lacking(path: &Path, no_camera: bool, no_lights: bool) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    if no_camera {
        lines.push(
            "no camera in the file, so the window shows the front of the scene, or a side with more content; --look-from AZ,EL chooses the direction".into(),
        );
    }
    if no_lights {
        lines.push(
            "no lights in the file, so the studio light lights the scene; --environment FILE replaces the studio light"
                .into(),
        );
    }
    let extension = path.extension().unwrap_or_default();
    if !lines.is_empty() && ["gltf", "glb"].iter().any(|gltf| extension.eq_ignore_ascii_case(gltf)) {
        let text = "if the file comes from Blender, tick Include > Cameras and Include > Punctual Lights in Blender's glTF export; \
                    Lumistack also reads .blend files";
        lines.push(text.into());
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lacking_cameras_and_lights_are_reported_with_a_remedy() {
        let text = lacking(Path::new("model.GLB"), true, true).join("\n");
        for part in ["no camera", "--look-from", "no lights", "studio light", "Punctual Lights"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let of_usd = lacking(Path::new("model.usda"), true, false);
        assert!(of_usd.len() == 1 && of_usd[0].contains("no camera"), "{of_usd:?}");
        assert!(lacking(Path::new("model.glb"), false, false).is_empty());
    }
}
