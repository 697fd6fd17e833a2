//! Output plugin `images`: layer patterns, backlight patterns and views as pictures, arrays, animations and light-field folders.
//!
//! Of a layer stack (`L` layer, 0 = rearmost; `MM` frame; `YY`, `XX` view row and column):
//!
//! | file | what |
//! |---|---|
//! | `layer_L_frame_MM.png` | the pattern of one layer in one frame, in the panel's code values: from the darkest state that `black_level` and `peak` allow to the brightest |
//! | `backlight_frame_MM.png` | what the panel behind the lenslets roughly shows, one cell per lenslet; see [`pictures`] |
//! | `panel_frame_MM.png` | what the panel behind the lenslets shows, pixel by pixel; see [`lumistack_plugin::lenslets`] |
//! | `simulated_YY_XX.png` | what an adapted viewer sees from one place of the target's view grid: emitted radiance / β |
//! | `atlas.png`, `atlas.json` | the patterns of all layers and frames on one sheet, and where each is |
//! | `sheet.png` | all patterns and views for people: reduced, each under what it is |
//! | `stack.npz` | the patterns' values |
//! | `images.json` | for every file: what it shows, encoding, whether it is linear |
//!
//! Of a light field: `view_YY_XX.png` of every view. Of both: `swing.png`, an animation; `views.exr`, all views as one multi-view OpenEXR file;
//! `views.npz`; the folders `hci/` and `stanford/`. Views of a layer stack are what an adapted viewer sees.
//!
//! 16-bit PNGs end in `_16bit.png`, EXR and NPZ files hold the values themselves, linear, and a PNG whose
//! codes are proportional to light because the job asked for it ends in `_linear.png`. Later times of a sequence go to `t0001/`, `t0002/`, ....
//!
//! Memory does not grow with the number of frames; `views.exr` takes that of all views as it stores them, twice.

mod animation;
mod arrays;
mod atlas;
mod encode;
mod folders;
mod manifest;
mod panel;
mod params;
pub mod pictures;
mod sheet;
mod views;
mod write;

use std::sync::{Mutex, PoisonError};

use lumistack_plugin::{Display, Host, Input, OutputPlugin, PluginError, Port, Schema, Time, export_plugin};

use manifest::Entry;
pub use params::ImagesParams;

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin.
#[derive(Debug)]
pub struct Images {
    host: Host,
    params: ImagesParams,
    display: Display,
    written: Mutex<Vec<Entry>>,
}

impl OutputPlugin for Images {
    const DOC: &'static str = "Writes layer patterns, backlight patterns and views: PNG and EXR pictures, atlas sheets, NumPy archives, \
        a sheet for people, an animation, HCI and Stanford folders. A file images.json says what each file is.";
    const PORTS: &'static [Port] = &[Port::LayerStack, Port::LightField];
    type Params = ImagesParams;

    fn schema() -> Schema {
        params::schema()
    }

    fn open(host: Host, params: ImagesParams, display: Display) -> Result<Self, PluginError> {
        params.check()?;
        if host.port() == Some(Port::LightField) {
            params.check_field()?;
        }
        if params.lenslet_panel {
            panel::lenslet_panel(&display, &params)?;
        }
        if params.hci {
            let geometry = &display.geometry().map_err(|error| PluginError::failed("display", error))?;
            folders::Cameras { geometry, nominal_mm: params.camera_distance_mm }.step()?;
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

export_plugin!("images", Images);
