//! Output plugin `images`: writes layer patterns, backlight patterns and views as pictures, arrays,
//! animations and light-field folders.
//!
//! Files of a layer stack (`L` layer, 0 = rearmost; `MM` frame; `YY`, `XX` view row and column):
//!
//! | file | content |
//! |---|---|
//! | `layer_L_frame_MM.png` | the mask of one layer in one frame. By default its codes drive the panel, from the darkest state (`black_level`) to the brightest (`peak`); see the parameter `encode` |
//! | `backlight_frame_MM.png` | approximate picture of the panel behind the lenslets, with one cell of pixels per lenslet; see [`pictures`] |
//! | `panel_frame_MM.png` | picture for the panel behind the lenslets, in the panel's own pixels; see [`lumistack_plugin::lenslets`] |
//! | `simulated_YY_XX.png` | one view, simulated for an adapted viewer: the emitted radiance, divided by the brightness β |
//! | `atlas.png`, `atlas.json` | the masks of all layers and frames on one sheet, and their positions |
//! | `sheet.png` | contact sheet: reduced pictures of all masks and of the selected views, with captions |
//! | `stack.npz` | the values of all masks and of the emission, the layers' distances, and β |
//! | `images.json` | content and encoding of every picture and NumPy archive |
//!
//! Files of a light field: `view_YY_XX.png` for every view; `views.npz`, the values of all views;
//! `sheet.png`, all views reduced.
//!
//! Files of a layer stack or a light field: `swing.png`, an animation; `views.exr`, all views as
//! one multi-view OpenEXR file; the folders `hci/` and `stanford/`. Views of a layer stack are
//! simulated for an adapted viewer.
//!
//! Names of 16-bit PNGs end in `_16bit.png`, except in `hci/` and `stanford/`. EXR and NPZ files
//! contain the values themselves, linear. If `encode` is `linear`, the codes of masks, the
//! backlight and single views are linear in light, and their PNGs have `_linear` in their names.
//! But `atlas.png` keeps its name, and pictures in `hci/` and `stanford/` stay sRGB. The second
//! time step of a sequence is written to `t0001/`, the third to `t0002/`, and so on.
//!
//! Memory does not grow with the number of frames. `views.exr` needs up to twice the memory of all
//! views.

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

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin `images`.
#[derive(Debug)]
pub struct Images {
    host: Host,
    params: ImagesParams,
    display: Display,
    written: Mutex<Vec<Entry>>,
}

impl OutputPlugin for Images {
    const DOC: &'static str = "Writes layer patterns, backlight patterns and views: PNG and EXR pictures, atlas sheets, NumPy archives, \
        a contact sheet, an animation, HCI and Stanford folders. The file images.json describes every picture and NumPy archive.";
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
