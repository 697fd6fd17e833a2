//! Parameters.

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
        Param::bool("exr", false, "Write OpenEXR pictures, one per pattern and view, which hold linear values."),
        Param::choice(
            "exr_depth",
            "half",
            [("half", "11 significant bits, like most renderers."), ("float", "24 significant bits.")],
            "Precision of the OpenEXR pictures.",
        ),
        Param::bool(
            "exr_multi_view",
            false,
            "Write views.exr: all views of the grid in one OpenEXR file with a multiView header. Few tools show more than the first, which is the central view.",
        ),
        Param::bool("npz", false, "Write NumPy archives of linear float32: stack.npz of a layer stack, views.npz of a light field."),
        Param::bool(
            "atlas",
            false,
            "Write atlas.png, the patterns of all layers (left to right, rear first) and frames (top to bottom) on one sheet of 8 bits, and atlas.json, which says where each is.",
        ),
        Param::bool(
            "sheet",
            false,
            "Write sheet.png for people: all patterns and the chosen views, reduced, each under what it is, with a legend.",
        ),
        Param::choice(
            "encode",
            "panel",
            [
                ("panel", "Patterns by their panels' transfer functions and ranges; views sRGB."),
                ("srgb", "Everything sRGB."),
                ("linear", "Codes proportional to light."),
            ],
            "How linear values become the code values of PNG pictures.",
        ),
        Param::int(
            "bits",
            0,
            0..=16,
            "Bits per channel that the panels show of patterns in PNG pictures; 0 for those of the display file, else of the picture. A code of fewer bits than the picture's stands in its highest bits.",
        )
        .unit("bits"),
        Param::choice(
            "dither",
            "none",
            [
                ("none", "The nearest code."),
                ("ordered", "A regular threshold map of 8 × 8 pixels."),
                ("blue_noise", "A threshold map of 64 × 64 pixels without low frequencies."),
                ("diffusion", "The error of a pixel is passed to its neighbours (Floyd and Steinberg)."),
            ],
            "How patterns show values between two codes of their panel; the mean light is kept.",
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
        Param::choice(
            "animation",
            "none",
            [
                ("none", "No animation."),
                ("side", "From side to side, at the grid's middle height."),
                ("ellipse", "On an ellipse that touches the grid's outermost views."),
            ],
            "Write swing.png, an animated PNG of a viewer who swings through the viewing zone. Views of a layer stack are simulated in between, of a light field the nearest are taken.",
        ),
        Param::int("animation_pictures", 48, 2..=1000, "Pictures of the animation, which then begins again.").unit("pictures"),
        Param::int("animation_rate", 24, 1..=120, "Pictures per second of the animation.").unit("Hz"),
        Param::int("animation_width", 640, 0..=16384, "Most columns of the animation; larger views are reduced. 0 keeps the views' own.")
            .unit("px"),
        Param::bool(
            "hci",
            false,
            "Write the folder hci/ as the 4D light field benchmark has it: input_Cam000.png, ..., parameters.cfg and gt_disp_lowres.pfm.",
        ),
        Param::text("hci_date", "unknown", "Date of the light field in hci/parameters.cfg."),
        Param::text("hci_authors", "unknown", "Who made it, names separated by commas, in hci/parameters.cfg."),
        Param::text("hci_contact", "unknown", "Whom to ask about it, in hci/parameters.cfg."),
        Param::bool(
            "stanford",
            false,
            "Write the folder stanford/ as the Stanford archive has it: out_RR_CC_Y_X.png, the camera's centre in millimetres, X right, Y down.",
        ),
        Param::float(
            "camera_distance_mm",
            1000.0,
            1.0..=1e6,
            "Distance of the cameras in hci/ and stanford/ where views are parallel projections, which have none; perspective views keep their own.",
        )
        .unit("mm"),
        Param::bool(
            "lenslet_panel",
            false,
            "Write panel_frame_MM.png: for a directional backlight what its panel shows behind the lens array, pixel by pixel.",
        ),
        Param::int("panel_columns", 0, 0..=32768, "Columns of the panel behind the lenses; 0 for the display file's.").unit("px"),
        Param::int("panel_rows", 0, 0..=32768, "Rows of the panel behind the lenses; 0 for the display file's.").unit("px"),
        Param::float("panel_pitch_mm", 0.0, 0.0..=100.0, "Pixel pitch of the panel behind the lenses; 0 for the display file's.").unit("mm"),
        Param::float("lens_pitch_mm", 0.0, 0.0..=1000.0, "Measured distance of lens axes; 0 for the display file's.").unit("mm"),
        Param::float(
            "lens_focal_mm",
            0.0,
            0.0..=1000.0,
            "Measured focal length of the lenses, as light travels in air; 0 for the one at which a lens fills the horizontal angle of the bins.",
        )
        .unit("mm"),
        Param::float(
            "lens_rotation_deg",
            0.0,
            -45.0..=45.0,
            "Measured turn of the lens array against the panel, counterclockwise seen from the front.",
        )
        .unit("°"),
        Param::float("lens_offset_x_mm", 0.0, -1000.0..=1000.0, "Measured shift of the lens array to the right, beside the display file's offset.")
            .unit("mm"),
        Param::float("lens_offset_y_mm", 0.0, -1000.0..=1000.0, "Measured shift of the lens array upwards, beside the display file's offset.")
            .unit("mm"),
        Param::int(
            "lens_samples",
            4,
            1..=16,
            "Points per pixel and axis over which a pixel that straddles bins or lenses is averaged; 1 takes the pixel's centre.",
        )
        .unit("points"),
    ])
}

static SRGB: Transfer = Transfer::Srgb;
static LINEAR: Transfer = Transfer::Linear;

impl Encode {
    /// The transfer function of a panel's pictures.
    pub(crate) fn of_panel(self, panel: &Transfer) -> &Transfer {
        match self {
            Self::Panel => panel,
            Self::Srgb => &SRGB,
            Self::Linear => &LINEAR,
        }
    }

    /// The transfer function of pictures that belong to no panel.
    pub(crate) fn of_other(self) -> &'static Transfer {
        match self {
            Self::Panel | Self::Srgb => &SRGB,
            Self::Linear => &LINEAR,
        }
    }
}

impl ImagesParams {
    /// # Errors
    /// If parameters contradict one another.
    pub(crate) fn check(&self) -> Result<(), PluginError> {
        if !self.atlas && !self.writes_views() {
            let text =
                "parameters `png8`, `png16`, `exr` and all others that write are false: there is nothing to write";
            return Err(PluginError::Refused(text.into()));
        }
        if self.lenslet_panel && !self.writes_pictures() {
            let text = "parameter `lenslet_panel`: expected one of `png8`, `png16` and `exr` as well, found none";
            return Err(PluginError::Refused(text.into()));
        }
        Ok(())
    }

    /// # Errors
    /// If nothing is wanted that a light field has.
    pub(crate) fn check_field(&self) -> Result<(), PluginError> {
        if self.writes_views() {
            return Ok(());
        }
        let text = "parameters: a light field has neither patterns nor a panel, and nothing else is to be written";
        Err(PluginError::Refused(text.into()))
    }

    /// Whether anything is wanted that is made of views; an atlas is of patterns alone.
    fn writes_views(&self) -> bool {
        let others = self.exr_multi_view || self.npz || self.sheet || self.hci || self.stanford;
        self.writes_pictures() || others || self.animation != Animation::None
    }

    /// Whether single pictures are wanted at all.
    pub(crate) fn writes_pictures(&self) -> bool {
        self.png8 || self.png16 || self.exr
    }
}
