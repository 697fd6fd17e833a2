//! Environment maps, from files and from splats.

use std::path::Path;
use std::sync::Arc;

use glam::{Quat, Vec3};
use image::ImageFormat;
use lumistack_core::Task;
use lumistack_field_io::picture::Picture;
use lumistack_scene::{Image, Pixels, Scene, SceneParts};
use lumistack_shot::edited;
use lumistack_shot::light::set_environment;

use crate::error::{PipelineError, field_error, read};
use crate::stage::ingest::from_splats;

/// Replaces the scene's environment by a Radiance HDR or EXR file, whose radiance is multiplied by
/// `strength`.
///
/// # Errors
/// If the file has another format, or cannot be read or decoded.
pub fn load_environment(parts: &mut SceneParts, path: &Path, strength: f32) -> Result<(), PipelineError> {
    let bytes = read(path)?;
    let is_exr = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    let (width, height, texels) = if is_exr {
        let picture = Picture::read(path).map_err(field_error)?;
        let [width, height] = picture.size();
        (width, height, picture.into_linear().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect())
    } else {
        let wrong = |found: String| PipelineError::value(path, "environment", "a Radiance HDR or EXR picture", found);
        // Pictures of other formats are encoded for screens, and cannot be brighter than white.
        if let Ok(format) = image::guess_format(&bytes)
            && format != ImageFormat::Hdr
        {
            let extension = format.extensions_str().first().copied().unwrap_or_default();
            return Err(wrong(match format {
                ImageFormat::OpenExr => "an EXR picture whose name does not end with .exr".into(),
                _ => format!("a picture of the format .{extension}, which has no linear light"),
            }));
        }
        let picture = image::load_from_memory_with_format(&bytes, ImageFormat::Hdr);
        let picture = picture.map_err(|error| wrong(error.to_string()))?.into_rgb32f();
        let (width, height) = picture.dimensions();
        (width as usize, height as usize, picture.pixels().map(|p| p.0).collect())
    };
    let image = Image { name: path.display().to_string(), width, height, pixels: Pixels::RgbF32(texels) };
    set_environment(parts, image, Vec3::splat(strength), as_in_blender());
    Ok(())
}

/// Returns the rotation by which Blender and three.js turn an environment map. Before the rotation,
/// the central column of the map is the direction −z. The rotation turns the central column to +x,
/// and the column at a quarter of the width to −z.
fn as_in_blender() -> Quat {
    Quat::from_rotation_y(-std::f32::consts::FRAC_PI_2)
}

/// Adds an environment by which the scene's splats light its meshes. A scene without splats or
/// without meshes does not change. Returns the scene, and true if the environment was added.
///
/// # Errors
/// If cancelled, or the scene becomes invalid.
pub(crate) fn from_splats(scene: Scene, strength: f32, task: Task<'_>) -> Result<(Scene, bool), PipelineError> {
    let scene = Arc::new(scene);
    let panorama = from_splats::panorama(&scene, task)?;
    let scene = Arc::unwrap_or_clone(scene);
    let Some(image) = panorama else {
        let missing = if scene.instances.is_empty() { "meshes" } else { "splats" };
        task.warn("light.from_splats", format!("no effect, since the scene has no {missing}"));
        return Ok((scene, false));
    };
    let lit = edited(scene, task, |parts| {
        set_environment(parts, image, Vec3::splat(strength), Quat::IDENTITY);
        // The map only lights the meshes. The background behind the splats is black, so that the
        // map is not visible.
        parts.backdrop = Some(Vec3::ZERO);
        Ok::<_, PipelineError>(())
    })?;
    Ok((lit, true))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_environment_has_linear_light() {
        let folder = tempfile::tempdir().unwrap();
        let load = |name: &str| {
            let mut parts = SceneParts::default();
            load_environment(&mut parts, &folder.path().join(name), 1.0)
                .map(|()| parts)
                .map_err(|error| error.to_string())
        };
        let picture = image::Rgb32FImage::from_pixel(4, 2, image::Rgb([4.0, 1.0, 0.5]));
        picture.save(folder.path().join("sky.hdr")).unwrap();
        let parts = load("sky.hdr").unwrap();
        let Pixels::RgbF32(texels) = &parts.images[0].pixels else { panic!("linear texels") };
        assert_eq!((texels.len(), texels[0]), (8, [4.0, 1.0, 0.5]));
        let codes = image::DynamicImage::from(picture).to_rgb8();
        for (name, format) in [("sky.png", "png"), ("sky.jpg", "jpg"), ("sky.webp", "webp")] {
            codes.save(folder.path().join(name)).unwrap();
            // the content decides, not the name
            std::fs::copy(folder.path().join(name), folder.path().join("named.hdr")).unwrap();
            for name in [name, "named.hdr"] {
                let error = load(name).unwrap_err();
                let expected = format!(
                    "environment: expected a Radiance HDR or EXR picture, found a picture of the format .{format}"
                );
                assert!(error.contains(&expected), "{error}");
            }
        }
        std::fs::write(folder.path().join("text.hdr"), "no picture").unwrap();
        assert!(load("text.hdr").unwrap_err().contains("expected a Radiance HDR or EXR picture"));
    }

    /// Expected values are from Blender 4.5. A camera of an imported glTF file looks along −z. The
    /// middle of its picture shows the column at 0.25 of the map's width. Columns farther to the
    /// right in the map appear farther to the right.
    #[test]
    fn environment_files_lie_as_in_blender() {
        // Returns the direction of the column at the fraction `u` of the map's width. Before the
        // rotation the central column is −z, and columns to its right turn to +x.
        let column = |u: f32| {
            let azimuth = (u - 0.5) * std::f32::consts::TAU;
            as_in_blender() * Vec3::new(azimuth.sin(), 0.0, -azimuth.cos())
        };
        assert!((column(0.25) - Vec3::NEG_Z).length() < 1e-6);
        assert!((column(0.5) - Vec3::X).length() < 1e-6);
        assert!(column(0.3).x > 0.1, "columns farther to the right in the file are farther right in the scene");
    }
}
