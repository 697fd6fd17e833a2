//! Parameters of the plugin `images`.

use lumistack_plugin::display::Transfer;
use lumistack_plugin::encoding::Dither;
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Param, PluginError, Schema};

/// Parameters; see [`Images::schema`](lumistack_plugin::OutputPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct ImagesParams {
    pub(crate) png8: bool,
    pub(crate) png16: bool,
    pub(crate) exr: bool,
    pub(crate) exr_depth: ExrDepth,
    pub(crate) exr_multi_view: bool,
    pub(crate) npz: bool,
    pub(crate) atlas: bool,
    pub(crate) sheet: bool,
    pub(crate) encode: Encode,
    pub(crate) bits: u32,
    pub(crate) dither: Dither,
    pub(crate) views: Views,
    pub(crate) animation: Animation,
    pub(crate) animation_pictures: u32,
    pub(crate) animation_rate: u16,
    pub(crate) animation_width: usize,
    pub(crate) hci: bool,
    pub(crate) hci_date: String,
    pub(crate) hci_authors: String,
    pub(crate) hci_contact: String,
    pub(crate) stanford: bool,
    pub(crate) camera_distance_mm: f64,
    pub(crate) lenslet_panel: bool,
    pub(crate) panel_columns: usize,
    pub(crate) panel_rows: usize,
    pub(crate) panel_pitch_mm: f64,
    pub(crate) lens_pitch_mm: f64,
    pub(crate) lens_focal_mm: f64,
    pub(crate) lens_rotation_deg: f64,
    pub(crate) lens_offset_x_mm: f64,
    pub(crate) lens_offset_y_mm: f64,
    pub(crate) lens_samples: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub(crate) enum ExrDepth {
    Half,
    Float,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub(crate) enum Encode {
    Panel,
    Srgb,
    Linear,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub(crate) enum Views {
    None,
    Some,
    All,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub(crate) enum Animation {
    None,
    Side,
    Ellipse,
}

pub(crate) fn schema() -> Schema {
    Schema::new([
        Param::bool("png8", true, "Write PNG pictures of 8 bits per channel."),
        Param::bool("png16", false, "Write PNG pictures of 16 bits per channel."),
        Param::bool("exr", false, "Write OpenEXR pictures of linear values, one per mask and view."),
        Param::choice(
            "exr_depth",
            "half",
            [("half", "11 significant bits, like most renderers."), ("float", "24 significant bits.")],
            "Precision of the OpenEXR pictures.",
        ),
        Param::bool(
            "exr_multi_view",
            false,
            "Write views.exr: all views of the grid in one OpenEXR file with a multiView header. Few tools show more than the first view, which is the central one.",
        ),
        Param::bool("npz", false, "Write NumPy archives of linear float32: stack.npz of a layer stack, views.npz of a light field."),
        Param::bool(
            "atlas",
            false,
            "Write atlas.png, one 8-bit sheet with the masks of all layers (left to right, rear first) and frames (top to bottom). Their positions are in atlas.json.",
        ),
        Param::bool(
            "sheet",
            false,
            "Write sheet.png, a contact sheet: all masks and the selected views, reduced, with captions and a legend.",
        ),
        Param::choice(
            "encode",
            "panel",
            [
                ("panel", "Masks by their panels' transfer functions and ranges; views in sRGB."),
                ("srgb", "All pictures in sRGB."),
                ("linear", "Masks, backlights and single views linear in light; all other pictures in sRGB."),
            ],
            "Encoding of linear values as code values of PNG pictures.",
        ),
        Param::int(
            "bits",
            0,
            0..=16,
            "Bits per channel of the panels, for masks in PNG pictures, if encode is panel. 0 uses the bits that the display file states, or the bits of the picture if the file states none. A code of fewer bits fills the picture's highest bits.",
        )
        .unit("bits"),
        Param::choice(
            "dither",
            "none",
            [
                ("none", "The nearest code."),
                ("ordered", "A regular threshold map of 8 × 8 pixels."),
                ("blue_noise", "A threshold map of 64 × 64 pixels without low frequencies."),
                ("diffusion", "Error diffusion to neighbouring pixels (Floyd and Steinberg)."),
            ],
            "Dithering of masks between two codes of their panel, if encode is panel; dithering preserves the mean light.",
        ),
        Param::choice(
            "views",
            "some",
            [
                ("none", "No view."),
                ("some", "The views at the centre and the corners of the target's grid."),
                ("all", "Every view of the target's grid."),
            ],
            "Views of a layer stack that are simulated, for single pictures and for the contact sheet. This parameter has no effect on a light field, whose views are all used.",
        ),
        Param::choice(
            "animation",
            "none",
            [
                ("none", "No animation."),
                ("side", "From side to side, at the grid's middle height."),
                ("ellipse", "On an ellipse that touches the grid's outermost views."),
            ],
            "Write swing.png, an animated PNG of a viewpoint that swings through the viewing zone. A layer stack is simulated at every position; a light field shows its nearest view.",
        ),
        Param::int("animation_pictures", 48, 2..=1000, "Pictures per period of the animation, which loops.").unit("pictures"),
        Param::int("animation_rate", 24, 1..=120, "Pictures per second of the animation.").unit("Hz"),
        Param::int("animation_width", 640, 0..=16384, "Largest width of the animation; larger views are reduced. 0 keeps the views' width.")
            .unit("px"),
        Param::bool(
            "hci",
            false,
            "Write the folder hci/ in the format of the 4D light field benchmark: input_Cam000.png, ..., parameters.cfg and gt_disp_lowres.pfm.",
        ),
        Param::text("hci_date", "unknown", "Date of the light field in hci/parameters.cfg."),
        Param::text("hci_authors", "unknown", "Authors of the light field, separated by commas, in hci/parameters.cfg."),
        Param::text("hci_contact", "unknown", "Contact for the light field, in hci/parameters.cfg."),
        Param::bool(
            "stanford",
            false,
            "Write the folder stanford/ in the format of the Stanford archive. The name of a picture is out_RR_CC_Y_X.png. RR and CC are the view's row and column. X and Y are the camera's centre in millimetres, X right, Y down.",
        ),
        Param::float(
            "camera_distance_mm",
            1000.0,
            1.0..=1e6,
            "Camera distance in hci/ and stanford/ for views that are parallel projections, which have no cameras. Perspective views keep their own distance.",
        )
        .unit("mm"),
        Param::bool(
            "lenslet_panel",
            false,
            "Write panel_frame_MM.png: for a directional backlight, the picture of the panel behind the lens array, in panel pixels.",
        ),
        Param::int("panel_columns", 0, 0..=32768, "Columns of the panel behind the lenses; 0 uses the value of the display file.").unit("px"),
        Param::int("panel_rows", 0, 0..=32768, "Rows of the panel behind the lenses; 0 uses the value of the display file.").unit("px"),
        Param::float("panel_pitch_mm", 0.0, 0.0..=100.0, "Pixel pitch of the panel behind the lenses; 0 uses the value of the display file.").unit("mm"),
        Param::float("lens_pitch_mm", 0.0, 0.0..=1000.0, "Measured distance between lens axes; 0 uses the value of the display file.").unit("mm"),
        Param::float(
            "lens_focal_mm",
            0.0,
            0.0..=1000.0,
            "Measured focal length of the lenses in air. 0 uses the value of the display file. If the file states none, the focal length is such that the horizontal bins fill the width of the panel behind one lens.",
        )
        .unit("mm"),
        Param::float(
            "lens_rotation_deg",
            0.0,
            -45.0..=45.0,
            "Measured rotation of the lens array against the panel, counterclockwise from the front. This parameter replaces the rotation in the display file, also with the value 0.",
        )
        .unit("°"),
        Param::float("lens_offset_x_mm", 0.0, -1000.0..=1000.0, "Measured shift of the lens array to the right, added to the display file's offset.")
            .unit("mm"),
        Param::float("lens_offset_y_mm", 0.0, -1000.0..=1000.0, "Measured shift of the lens array upwards, added to the display file's offset.")
            .unit("mm"),
        Param::int(
            "lens_samples",
            4,
            1..=16,
            "Number of sample points per pixel and axis. A pixel across a border of bins or lenses is the mean of its points. 1 uses the pixel's centre.",
        )
        .unit("points"),
    ])
}

static SRGB: Transfer = Transfer::Srgb;
static LINEAR: Transfer = Transfer::Linear;

impl Encode {
    /// Returns the transfer function of pictures for a panel whose own transfer function is
    /// `panel`.
    pub(crate) fn of_panel(self, panel: &Transfer) -> &Transfer {
        match self {
            Self::Panel => panel,
            Self::Srgb => &SRGB,
            Self::Linear => &LINEAR,
        }
    }

    /// Returns the transfer function of pictures that drive no panel, such as views.
    pub(crate) fn of_other(self) -> &'static Transfer {
        match self {
            Self::Panel | Self::Srgb => &SRGB,
            Self::Linear => &LINEAR,
        }
    }
}

impl ImagesParams {
    /// Checks that at least one output is requested, and that the picture of `lenslet_panel` has a
    /// format.
    ///
    /// # Errors
    /// If no output is requested, or `lenslet_panel` is set without a format of pictures.
    pub(crate) fn check(&self) -> Result<(), PluginError> {
        if !self.atlas && !self.writes_views() {
            let text = "parameters: expected at least one output, such as `png8`, found none";
            return Err(PluginError::Refused(text.into()));
        }
        if self.lenslet_panel && !self.writes_pictures() {
            let text = "parameter `lenslet_panel`: expected also one of the parameters `png8`, `png16` and `exr`, found none of the three";
            return Err(PluginError::Refused(text.into()));
        }
        Ok(())
    }

    /// Checks that at least one requested output can be made from a light field.
    ///
    /// # Errors
    /// If no requested output can be made from a light field.
    pub(crate) fn check_field(&self) -> Result<(), PluginError> {
        if self.writes_views() {
            return Ok(());
        }
        let text = "parameters: expected at least one output of views, such as `png8`, found only `atlas`, whose masks a light field lacks";
        Err(PluginError::Refused(text.into()))
    }

    /// Returns true if a requested output can be made from a light field. The atlas is no such
    /// output, since it consists of masks.
    fn writes_views(&self) -> bool {
        let others = self.exr_multi_view || self.npz || self.sheet || self.hci || self.stanford;
        self.writes_pictures() || others || self.animation != Animation::None
    }

    /// Returns true if single pictures are requested.
    pub(crate) fn writes_pictures(&self) -> bool {
        self.png8 || self.png16 || self.exr
    }
}
