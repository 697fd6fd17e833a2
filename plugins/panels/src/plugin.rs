//! Output plugin `panels`: shows every layer on its output, or a preview in a window, until the
//! user closes the presentation.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use lumistack_plugin::display::Display;
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::serde_json::{self, Value};
use lumistack_plugin::{Host, Input, OutputPlugin, Param, PluginError, Port, Schema, Time, export_plugin};

use crate::pattern::{PATTERNS, Pattern};
use crate::presentation::{Command, Content, Event, Mode, Settings};
use crate::shows::Shows;
use crate::window;

/// Viewing distance for displays that state none, millimetres. It is the camera distance of the
/// paper's photographs.
const DISTANCE_MM: f64 = 2000.0;

/// The plugin `panels`.
#[derive(Debug)]
pub struct Panels {
    host: Host,
    params: PanelsParams,
    display: Display,
    /// Inputs that arrive before the presentation; `None` after the presentation has taken them.
    pending: Mutex<Option<Pending>>,
    send: Sender<Command>,
}

/// Inputs of a presentation that has not begun.
#[derive(Debug)]
struct Pending {
    /// A test pattern, a 2D picture, or the last submitted layer stack; `None` before the first
    /// submit.
    content: Option<Content>,
    commands: Receiver<Command>,
}

/// Parameters; see [`Panels::schema`](OutputPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct PanelsParams {
    mode: Mode,
    fit: bool,
    hold: i64,
    duration_s: f64,
    from_x_deg: f64,
    from_y_deg: f64,
    pattern: String,
    only: String,
    eye_x_mm: f64,
    eye_y_mm: f64,
    eye_z_mm: f64,
    picture: String,
    layer: i64,
    log: bool,
}

impl OutputPlugin for Panels {
    const DOC: &'static str = "Shows every layer on its own panel, or a preview of the display in a window, until the user closes the presentation. \
        Panels show one frame per refresh. `lumistack show` runs this plugin, in builds that can open windows.";
    const PORTS: &'static [Port] = &[Port::LayerStack];
    const PRESENTS: bool = true;
    type Params = PanelsParams;

    fn schema() -> Schema {
        Schema::new([
            Param::choice(
                "mode",
                "outputs",
                [
                    ("outputs", "One surface per output."),
                    ("span", "One surface across all outputs, so that all layers change their frames together."),
                    (
                        "window",
                        "An ordinary window with a preview of the display; the mouse moves the viewer.",
                    ),
                ],
                "Surfaces that are opened.",
            ),
            Param::bool(
                "fit",
                false,
                "Scale all masks by the same factor, so that they fit the panels. For correct parallax, scale the distances between the layers, too.",
            ),
            Param::int("hold", -1, -1..=1 << 20, "Frame to hold; -1 shows all frames one after another.").unit("1"),
            Param::float("duration_s", 0.0, 0.0..=1e9, "Duration of the presentation; 0 for a presentation that runs until the user closes it.").unit("s"),
            Param::float("from_x_deg", 0.0, -80.0..=80.0, "Initial angle between the viewer's direction and the display's axis, positive to the right; only with the mode `window`.")
                .unit("degrees"),
            Param::float("from_y_deg", 0.0, -80.0..=80.0, "Initial angle between the viewer's direction and the display's axis, positive upwards; only with the mode `window`.").unit("degrees"),
            Param::text("pattern", "", &format!("Test pattern shown in place of the layer stack: {PATTERNS}.")),
            Param::text(
                "only",
                "",
                "The only panel that shows the test pattern: a layer number, or backlight. Empty: all panels.",
            ),
            Param::float(
                "eye_x_mm",
                0.0,
                -1e6..=1e6,
                "Eye position for which the crosshairs coincide, to the right of the display's centre.",
            )
            .unit("mm"),
            Param::float("eye_y_mm", 0.0, -1e6..=1e6, "Eye position for which the crosshairs coincide, upwards from the display's centre.").unit("mm"),
            Param::float(
                "eye_z_mm",
                0.0,
                0.0..=1e6,
                "Eye distance from the display plane; 0 uses the display's viewing distance, or 2000 if it has none.",
            )
            .unit("mm"),
            Param::text(
                "picture",
                "",
                "Path of a picture (PNG, JPEG, WebP) that one layer shows at full resolution; the other layers are clear.",
            ),
            Param::int(
                "layer",
                -1,
                -1..=1 << 10,
                "Layer that shows the picture; 0 is the rearmost layer, -1 the layer nearest to the display plane.",
            )
            .unit("1"),
            Param::bool("log", false, "Include the time of every refresh in reports."),
        ])
    }

    fn open(host: Host, params: PanelsParams, display: Display) -> Result<Self, PluginError> {
        let content = fixed(&params, &display)?;
        let frames = if content.is_some() { 1 } else { display.frames };
        if usize::try_from(params.hold).is_ok_and(|hold| hold >= frames) {
            return Err(refused("hold", format!("-1 to {}", frames - 1), params.hold));
        }
        let (send, commands) = channel();
        Ok(Self { host, params, display, pending: Mutex::new(Some(Pending { content, commands })), send })
    }

    fn submit(&self, _time: Time, data: &Input<'_>) -> Result<(), PluginError> {
        self.host.check_cancelled()?;
        let Input::LayerStack(stack) = data else { return Err(PluginError::unexpected(data)) };
        let stack = stack.to_layer_stack(&self.display)?;
        match &mut *self.pending() {
            // Test patterns and 2D pictures come from the parameters, so a submitted stack does not
            // replace them.
            Some(Pending { content: Some(Content::Pattern { .. } | Content::Flat { .. }), .. }) => {}
            Some(pending) => {
                let from_deg = [self.params.from_x_deg, self.params.from_y_deg];
                pending.content = Some(match self.params.mode {
                    Mode::Window => Content::Preview { stack, from_deg },
                    Mode::Outputs | Mode::Span => Content::Stack(stack),
                });
            }
            // After the end of the presentation there is no receiver, and the stack is not needed.
            None => drop(self.send.send(Command::Stack(stack))),
        }
        Ok(())
    }

    fn run(&self) -> Result<(), PluginError> {
        let pending = self.pending().take();
        let Pending { content, commands } = pending
            .ok_or_else(|| PluginError::Refused("this presentation has already run; open the plugin again".into()))?;
        let settings = Settings {
            display: self.display.clone(),
            content: content.ok_or_else(|| {
                PluginError::Refused(
                    "expected a layer stack, a test pattern or a picture before `run`, found none".into(),
                )
            })?,
            mode: self.params.mode,
            fit: self.params.fit,
            hold: usize::try_from(self.params.hold).ok(),
            duration: (self.params.duration_s > 0.0).then(|| Duration::from_secs_f64(self.params.duration_s)),
            log: self.params.log,
        };
        let host = self.host.clone();
        let emit = Arc::new(move |event: Event| match event {
            Event::Warning(text) => host.warn(&text),
            event => host.tell(&serde_json::to_value(event).expect("events are plain data")),
        });
        window::present(settings, commands, &|| self.host.is_cancelled(), emit)
            .map_err(|error| PluginError::Failed(error.to_string()))
    }

    fn command(&self, command: &Value) -> Result<(), PluginError> {
        let command = Command::deserialize(command)
            .map_err(|error| PluginError::Refused(format!("command {command}: {error}")))?;
        // After the end of the presentation there is no receiver, and the command has no effect.
        let _ = self.send.send(command);
        Ok(())
    }

    fn finish(self) -> Result<(), PluginError> {
        Ok(())
    }
}

impl Panels {
    fn pending(&self) -> MutexGuard<'_, Option<Pending>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn refused(name: &str, expected: impl std::fmt::Display, found: impl std::fmt::Display) -> PluginError {
    PluginError::Refused(format!("`{name}`: expected {expected}, found {found}"))
}

/// Returns the content that the parameters select: a test pattern or a picture. Submitted stacks do
/// not replace this content. Returns `None` if the parameters select neither.
fn fixed(params: &PanelsParams, display: &Display) -> Result<Option<Content>, PluginError> {
    if !params.pattern.is_empty() {
        let pattern: Result<Pattern, _> = params.pattern.parse();
        let checked = pattern.and_then(|pattern| pattern.check(display).map(|()| pattern));
        let pattern = checked.map_err(|error| PluginError::Refused(error.to_string()))?;
        // Read the test pattern, the panel that alone shows it, and the eye for which it is drawn.
        // The eye must be in front of the layers.
        let all = Shows::all(display);
        let only = Some(&params.only).filter(|text| !text.is_empty()).map(|text| {
            let shows = text.parse().ok().filter(|shows| all.contains(shows));
            let names = || all.iter().map(Shows::to_string).collect::<Vec<_>>().join(", ");
            shows.ok_or_else(|| refused("only", format!("one of {}", names()), text))
        });
        let distance = if params.eye_z_mm > 0.0 { Some(params.eye_z_mm) } else { display.field.distance_mm };
        let eye_mm = [params.eye_x_mm, params.eye_y_mm, distance.unwrap_or(DISTANCE_MM)];
        let nearest = display.layers.last().map_or(0.0, |layer| layer.d_mm);
        if eye_mm[2] <= nearest {
            let expected = format!("a distance in front of all layers, above {nearest} mm");
            return Err(refused("eye_z_mm", expected, eye_mm[2]));
        }
        return Ok(Some(Content::Pattern { pattern, only: only.transpose()?, eye_mm }));
    }
    if !params.picture.is_empty() {
        // Read the picture and choose its layer, by default the one nearest to the display plane.
        let nearest = (0..display.layers.len())
            .min_by(|a, b| display.layers[*a].d_mm.abs().total_cmp(&display.layers[*b].d_mm.abs()))
            .unwrap_or(0);
        let layer = usize::try_from(params.layer).unwrap_or(nearest);
        if layer >= display.layers.len() {
            return Err(refused("layer", format!("-1 to {}", display.layers.len() - 1), layer));
        }
        let cannot =
            |error: &dyn std::fmt::Display| PluginError::Refused(format!("`picture`: {}: {error}", params.picture));
        let picture = image::ImageReader::open(&params.picture)
            .and_then(image::ImageReader::with_guessed_format)
            .map_err(|error| cannot(&error))?
            .decode()
            .map_err(|error| cannot(&format!("expected PNG, JPEG or WebP, found other or damaged data ({error})")))?;
        return Ok(Some(Content::Flat { picture: picture.to_rgb8(), layer }));
    }
    Ok(None)
}

export_plugin!("panels", Panels);
