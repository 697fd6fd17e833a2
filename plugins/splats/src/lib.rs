//! Importer plugin `splats`: converts captures of Gaussian splats to a glTF 2.0 document (`.glb`)
//! with `KHR_gaussian_splatting`.
//!
//! | file | forms |
//! |---|---|
//! | `.ply` | the form of the reference training programs, and PlayCanvas' compressed form |
//! | `.spz` | versions 1 to 4 |
//! | `.sog`, `meta.json` | SOG versions 1 and 2, as one packed file or as a folder |
//!
//! Spherical harmonics are read up to degree 3. Every format has its own default for the upward
//! axis, which the parameter `up` can replace.

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Assets, Host, ImporterPlugin, Param, PluginError, Schema, export_plugin};
use lumistack_splats::read::{Axes, Found, read};

/// Hash of this crate's sources, computed at build. It is part of the key of every cached result
/// that depends on this code.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin `splats`.
pub struct Splats;

/// Parameters; see [`Splats::schema`](ImporterPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct SplatsParams {
    up: Up,
    scale: f64,
}

/// The axis of the file that points upwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
enum Up {
    #[serde(rename = "auto")]
    Auto,
    #[serde(rename = "y")]
    Y,
    #[serde(rename = "-y")]
    MinusY,
    #[serde(rename = "z")]
    Z,
    #[serde(rename = "-z")]
    MinusZ,
}

impl Up {
    /// Returns the rotation from the axes of the file to those of the scene. The rotation turns
    /// this axis, the value of the parameter `up`, upwards. `auto` uses `axes`, the axes of the
    /// file's format.
    fn rotation(self, axes: Axes) -> glam::Quat {
        use std::f32::consts::FRAC_PI_2;
        match self {
            Self::Auto => axes.scene_from_file(),
            Self::Y => glam::Quat::IDENTITY,
            Self::MinusY => Axes::RightDownFront.scene_from_file(),
            Self::Z => glam::Quat::from_rotation_x(-FRAC_PI_2),
            Self::MinusZ => glam::Quat::from_rotation_x(FRAC_PI_2),
        }
    }
}

impl ImporterPlugin for Splats {
    const DOC: &'static str =
        "Reads captures as Gaussian splats: .ply of training programs and of PlayCanvas, .spz, SOG.";
    const EXTENSIONS: &'static [&'static str] = &["ply", "spz", "sog", "json"];
    type Params = SplatsParams;

    fn schema() -> Schema {
        Schema::new([
            Param::choice(
                "up",
                "auto",
                [
                    ("auto", "The format's own axis: -y in .ply and SOG, y in .spz."),
                    ("y", "The y axis."),
                    ("-y", "The y axis points downwards, as in camera space."),
                    ("z", "The z axis, as in maps and CAD programs."),
                    ("-z", "The z axis points downwards."),
                ],
                "Axis of the file that points upwards.",
            ),
            Param::float("scale", 1.0, 1e-9..=1e9, "Size of the file's unit.").unit("scene units"),
        ])
    }

    fn import(host: &Host, params: SplatsParams, file: &str, assets: &Assets<'_>) -> Result<Vec<u8>, PluginError> {
        let failed = |error: String| PluginError::Failed(format!("{file}: {error}"));
        let bytes = assets.read(file)?;
        host.check_cancelled()?;
        let beside = |name: &str| assets.read(name).map_err(|error| error.to_string());
        let Found { cloud, axes, left_out } = read(&bytes, &beside).map_err(|error| failed(error.to_string()))?;
        drop(bytes);
        left_out.iter().for_each(|message| host.warn(&format!("{file}: {message}")));
        host.check_cancelled()?;
        let rotation = params.up.rotation(axes);
        if cloud.is_empty() {
            return Err(failed("expected splats, found none".into()));
        }
        let document = lumistack_splats::glb(&cloud, rotation.to_array(), params.scale);
        document.ok_or_else(|| {
            failed(format!(
                "expected splats that take less than 4 GiB as GLB, found {} splats that take more",
                cloud.len()
            ))
        })
    }
}

export_plugin!("splats", Splats as importer);
