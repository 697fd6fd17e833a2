//! Importer plugin `splats`: captures as Gaussian splats, as a glTF 2.0 document (`.glb`) with `KHR_gaussian_splatting`.
//!
//! | file | what is read |
//! |---|---|
//! | `.ply` | as the reference trainers write it, and PlayCanvas' compressed form |
//! | `.spz` | versions 1 to 4 |
//! | `.sog`, `meta.json` | SOG, packed or as a folder; versions 1 and 2 |
//!
//! Harmonics to degree 3. A capture has no agreed upward axis: `up` says it where the format's own is wrong.

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Assets, Host, ImporterPlugin, Param, PluginError, Schema, export_plugin};
use lumistack_splats::read::{Axes, Found, read};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin.
pub struct Splats;

/// Parameters; see [`Splats::schema`](ImporterPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct SplatsParams {
    up: Up,
    scale: f64,
}

/// Which axis of the file points upwards.
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
    /// The turn that brings it up, as a quaternion x, y, z, w.
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
    const DOC: &'static str = "Reads captures as Gaussian splats: .ply of trainers and of PlayCanvas, .spz, SOG.";
    const EXTENSIONS: &'static [&'static str] = &["ply", "spz", "sog", "json"];
    type Params = SplatsParams;

    fn schema() -> Schema {
        Schema::new([
            Param::choice(
                "up",
                "auto",
                [
                    ("auto", "As the format says: -y in .ply and SOG, y in .spz."),
                    ("y", "The y axis."),
                    ("-y", "The y axis points downwards, as cameras have it."),
                    ("z", "The z axis, as maps and CAD programs do."),
                    ("-z", "The z axis points downwards."),
                ],
                "Which axis of the file points upwards.",
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
        document.ok_or_else(|| failed(format!("expected splats of less than 4 GiB, found {}", cloud.len())))
    }
}

export_plugin!("splats", Splats as importer);
