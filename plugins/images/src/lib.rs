//! Output plugin `images`: layer patterns, backlight patterns and views as pictures.
//!
//! Of a layer stack (`L` layer, 0 = rearmost; `MM` frame; `YY`, `XX` view row and column):
//!
//! | file | what |
//! |---|---|
//! | `layer_L_frame_MM.png` | the pattern of one layer in one frame, in the panel's code values: from the darkest state that `black_level` and `peak` allow to the brightest |
//! | `backlight_frame_MM.png` | what the panel behind the lenslets roughly shows, one cell per lenslet; see [`pictures`] |
//! | `simulated_YY_XX.png` | what an adapted viewer sees from one place of the target's view grid: emitted radiance / β |
//! | `images.json` | for every file: layer, frame or view, encoding, whether it is linear |
//!
//! Of a light field: `view_YY_XX.png` of every view. 16-bit PNGs end in `_16bit.png`, EXR files hold the values themselves, linear, and a PNG whose
//! codes are proportional to light because the job asked for it ends in `_linear.png`. Later times of a sequence go to `t0001/`, `t0002/`, ....

mod manifest;
pub mod pictures;
mod write;

use std::sync::{Mutex, PoisonError};

use lumistack_plugin::display::Transfer;
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Display, Host, Input, OutputPlugin, Param, PluginError, Port, Schema, Time, export_plugin};

use manifest::Entry;

/// The plugin.
#[derive(Debug)]
pub struct Images {
    host: Host,
    params: ImagesParams,
    display: Display,
    written: Mutex<Vec<Entry>>,
}

/// Parameters; see [`Images::schema`](OutputPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct ImagesParams {
    png8: bool,
    png16: bool,
    exr: bool,
    exr_depth: ExrDepth,
    encode: Encode,
    views: Views,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
enum ExrDepth {
    Half,
    Float,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
enum Encode {
    Panel,
    Srgb,
    Linear,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
enum Views {
    None,
    Some,
    All,
}

impl OutputPlugin for Images {
    const DOC: &'static str = "Writes layer patterns, backlight patterns and views as PNG and EXR pictures. \
        A file images.json says what each picture is.";
    const PORTS: &'static [Port] = &[Port::LayerStack, Port::LightField];
    type Params = ImagesParams;

    fn schema() -> Schema {
        Schema::new([
            Param::bool("png8", true, "Write PNG pictures of 8 bits per channel."),
            Param::bool("png16", false, "Write PNG pictures of 16 bits per channel."),
            Param::bool("exr", false, "Write OpenEXR pictures, which hold linear values."),
            Param::choice(
                "exr_depth",
                "half",
                [("half", "11 significant bits, like most renderers."), ("float", "24 significant bits.")],
                "Precision of the OpenEXR pictures.",
            ),
            Param::choice(
                "encode",
                "panel",
                [
                    ("panel", "Each layer by its panel's transfer function; backlight and views sRGB."),
                    ("srgb", "Everything sRGB."),
                    ("linear", "Codes proportional to light."),
                ],
                "How linear values become the code values of PNG pictures.",
            ),
            Param::choice(
                "views",
                "some",
                [
                    ("none", "No view."),
                    ("some", "The views at the centre and the corners of the target's grid."),
                    ("all", "Every view of the target's grid."),
                ],
                "Which views of a layer stack are simulated. The views of a light field are always written.",
            ),
        ])
    }

    fn open(host: Host, params: ImagesParams, display: Display) -> Result<Self, PluginError> {
        if !(params.png8 || params.png16 || params.exr) {
            let text = "parameters `png8`, `png16` and `exr` are all false: there is nothing to write";
            return Err(PluginError::Refused(text.into()));
        }
        Ok(Self { host, params, display, written: Mutex::default() })
    }

    fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError> {
        let entries = match data {
            Input::LayerStack(stack) => self.write_stack(time, stack)?,
            Input::LightField(field) => self.write_field(time, field)?,
            other => return Err(PluginError::unexpected(other)),
        };
        self.written.lock().unwrap_or_else(PoisonError::into_inner).extend(entries);
        Ok(())
    }

    fn finish(self) -> Result<(), PluginError> {
        self.host.check_cancelled()?;
        let entries = self.written.into_inner().unwrap_or_else(PoisonError::into_inner);
        self.host.write("images.json", manifest::to_json(entries).as_bytes())
    }
}

impl Encode {
    /// The transfer function of a layer's pictures.
    fn of_layer(self, panel: Transfer) -> Transfer {
        match self {
            Self::Panel => panel,
            Self::Srgb => Transfer::Srgb,
            Self::Linear => Transfer::Linear,
        }
    }

    /// The transfer function of pictures that belong to no panel whose transfer function the display file gives.
    fn of_other(self) -> Transfer {
        self.of_layer(Transfer::Srgb)
    }
}

export_plugin!("images", Images);
