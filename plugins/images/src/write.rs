//! Writes the requested files of a layer stack or light field.

use std::borrow::Cow;

use lumistack_plugin::display::{Layer, LensletBacklight, Transfer};
use lumistack_plugin::encoding::Dither;
use lumistack_plugin::field_io::picture::{MultiView, Precision, exr_bytes};
use lumistack_plugin::{FieldInput, PluginError, StackInput, Stage, Time};

use crate::animation::Swing;
use crate::encode::{PanelCodes, png8, png16, samples8, samples16};
use crate::folders::{self, Archive};
use crate::manifest::{Content, Entry, Format, NamedView, Size};
use crate::params::{Animation, Encode, ExrDepth, Views};
use crate::pictures::{backlight_picture, centre_and_corners};
use crate::sheet::Cell;
use crate::views::{ViewSource, nearest, slope_at};
use crate::{Images, arrays, atlas, panel, sheet};

/// Linear values that are written in every requested format.
struct Picture<'a> {
    /// Path of the file without the suffixes that state the format.
    stem: String,
    content: Content,
    /// [rows, cols] of the picture.
    size: [usize; 2],
    /// The linear values, `[row][col][rgb]`.
    rgb: Cow<'a, [f32]>,
    transfer: &'a Transfer,
    /// The panel that the codes drive; `None` if the codes encode the values themselves.
    panel: Option<Panel<'a>>,
}

/// The panel that a picture's codes drive. Codes span the range from the panel's darkest state to
/// its brightest.
#[derive(Clone, Copy)]
struct Panel<'a> {
    kind: PanelKind<'a>,
    codes: PanelCodes,
}

#[derive(Clone, Copy)]
enum PanelKind<'a> {
    Layer(&'a Layer),
    Backlight(&'a LensletBacklight),
}

impl Panel<'_> {
    fn driven(&self, rgb: &[f32]) -> Vec<f32> {
        match self.kind {
            PanelKind::Layer(layer) => rgb.iter().map(|&value| layer.drive(value)).collect(),
            PanelKind::Backlight(backlight) => rgb.iter().map(|&value| backlight.drive(value)).collect(),
        }
    }
}

impl Images {
    /// Writes all requested files of a layer stack.
    pub(crate) fn write_stack(&self, time: Time, stack: &StackInput<'_>) -> Result<Vec<Entry>, PluginError> {
        let mut entries = Vec::new();
        if self.params.writes_pictures() {
            self.write_patterns(time, stack, &mut entries)?;
            self.write_simulated(time, stack, &mut entries)?;
        }
        let folder = folder(time);
        if self.params.atlas {
            let samples = |layer, frame| self.layer_samples(stack, layer, frame);
            let layers = &self.display.layers;
            let transfers: Vec<&Transfer> =
                layers.iter().map(|layer| self.params.encode.of_panel(&layer.transfer)).collect();
            let [width, height] = atlas::write(&self.host, &folder, stack, &transfers, samples)?;
            let content = Content::Atlas { index: format!("{folder}atlas.json") };
            // Each tile is encoded by the transfer function of its own panel, which the index
            // states. The entry states the function, and likewise the bits of the panels, only if
            // all tiles share them.
            let encoding = atlas::shared(&transfers);
            let codes_of = |layer| self.panel(PanelKind::Layer(layer), 0).map(|panel| panel.codes);
            let bits: Vec<_> = layers.iter().map(|layer| codes_of(layer)?.bits.map(|bits| bits.min(8))).collect();
            let codes = layers.first().and_then(codes_of);
            let codes = codes.map(|codes| PanelCodes { bits: atlas::shared(&bits).flatten(), ..codes });
            let format = self.png_format(8, encoding, codes);
            let linear = encoding == Some(&Transfer::Linear);
            entries.push(entry(format!("{folder}atlas.png"), content, format, linear, Some([height, width]), time));
        }
        if self.params.sheet {
            entries.push(self.write_sheet(time, &ViewSource::Stack(stack))?);
        }
        if self.params.npz {
            let file = format!("{folder}stack.npz");
            arrays::write_stack(&self.host, &file, &self.display, stack)?;
            let layers = (0..stack.layer_count()).map(|layer| format!("layer_{layer}"));
            let emission = stack.emission_shape().map(|_| "emission".to_string());
            let names = layers.chain(["d_mm".into()]).chain(emission).chain(["brightness".into()]).collect();
            entries.push(entry(file, Content::Arrays { names }, Format::Npz, true, None, time));
        }
        self.write_from_views(time, &ViewSource::Stack(stack), &mut entries)?;
        Ok(entries)
    }

    /// Writes all requested files of a light field.
    pub(crate) fn write_field(&self, time: Time, field: &FieldInput<'_>) -> Result<Vec<Entry>, PluginError> {
        self.params.check_field()?;
        let grid = &field.geometry().grid;
        let views = grid.views();
        let mut entries = Vec::new();
        if self.params.writes_pictures() {
            let stage = self.host.stage("images", (views[0] * views[1]) as u64, "pictures");
            for view in grid.iter() {
                self.host.check_cancelled()?;
                let plane = field.view(view)?;
                let picture = Picture {
                    stem: format!("{}view_{}", folder(time), view_name(view, views)),
                    content: Content::View { view, slope: [grid.slope_x[view[1]], grid.slope_y[view[0]]] },
                    size: [plane.rows(), plane.cols()],
                    rgb: plane.values(),
                    transfer: self.params.encode.of_other(),
                    panel: None,
                };
                self.write_picture(time, &picture, &stage, &mut entries)?;
            }
        }
        // Write the files that each contain all views.
        let source = ViewSource::Field(field);
        if self.params.sheet {
            entries.push(self.write_sheet(time, &source)?);
        }
        if self.params.npz {
            let file = format!("{}views.npz", folder(time));
            arrays::write_views(&self.host, &file, &source)?;
            let names = ["radiance", "slope_x", "slope_y"].map(String::from).to_vec();
            entries.push(entry(file, Content::Arrays { names }, Format::Npz, true, None, time));
        }
        self.write_from_views(time, &source, &mut entries)?;
        Ok(entries)
    }

    /// Writes pictures of all masks, and of the backlight in all frames.
    fn write_patterns(&self, time: Time, stack: &StackInput<'_>, entries: &mut Vec<Entry>) -> Result<(), PluginError> {
        let (layers, frames) = (stack.layer_count(), stack.frames());
        let folder = folder(time);
        let lenses =
            if self.params.lenslet_panel { Some(panel::lenslet_panel(&self.display, &self.params)?) } else { None };
        // Write a picture per layer and frame.
        let per_frame = layers + usize::from(stack.emission_shape().is_some()) + usize::from(lenses.is_some());
        let stage = self.host.stage("patterns", (frames * per_frame) as u64, "pictures");
        let (layer_digits, frame_digits) = (digits(layers, 1), digits(frames, 2));
        for (layer, frame) in (0..layers).flat_map(|layer| (0..frames).map(move |frame| (layer, frame))) {
            self.host.check_cancelled()?;
            let own = self.layer_of(layer)?;
            let plane = stack.layer(layer, frame)?;
            let picture = Picture {
                stem: format!("{folder}layer_{layer:0layer_digits$}_frame_{frame:0frame_digits$}"),
                content: Content::Layer { layer, frame, d_mm: own.d_mm },
                size: [plane.rows(), plane.cols()],
                rgb: plane.values(),
                transfer: self.params.encode.of_panel(&own.transfer),
                panel: self.panel(PanelKind::Layer(own), layer + layers * frame),
            };
            self.write_picture(time, &picture, &stage, entries)?;
        }
        // Write the emission as the solver computed it: each lenslet is a cell with one pixel per
        // angular bin.
        if let Some([bins_y, bins_x, rows, cols]) = stack.emission_shape() {
            let (bins, lenslets) = ([bins_y, bins_x], [rows, cols]);
            for frame in 0..frames {
                self.host.check_cancelled()?;
                let bin = |y, x| Ok::<_, PluginError>(stack.emission(frame, y, x)?.to_vec());
                let picture = Picture {
                    stem: format!("{folder}backlight_frame_{frame:0frame_digits$}"),
                    content: Content::Backlight { frame, bins, lenslets },
                    size: [rows * bins_y, cols * bins_x],
                    rgb: backlight_picture(bins, lenslets, bin)?.into(),
                    transfer: self.params.encode.of_other(),
                    panel: None,
                };
                self.write_picture(time, &picture, &stage, entries)?;
            }
        }
        // Write the picture for the panel behind the lenslets. The lens in front of a pixel sends
        // the pixel's light into one direction. The pixel gets the lens's emission into this
        // direction.
        let Some((backlight, lenses)) = lenses else { return Ok(()) };
        for frame in 0..frames {
            self.host.check_cancelled()?;
            let picture = Picture {
                stem: format!("{folder}panel_frame_{frame:0frame_digits$}"),
                content: Content::LensletPanel {
                    frame,
                    panel_pitch_mm: lenses.pitch_mm,
                    lens_pitch_mm: lenses.lens_pitch_mm,
                    focal_mm: lenses.focal_mm,
                    rotation_deg: lenses.rotation_deg,
                    offset_mm: lenses.offset_mm,
                    pixels_per_lens: lenses.lens_pitch_mm / lenses.pitch_mm,
                },
                size: [lenses.resolution[1], lenses.resolution[0]],
                rgb: panel::picture(&self.host, &lenses, stack, frame, self.params.lens_samples)?.into(),
                transfer: self.params.encode.of_panel(&backlight.transfer),
                panel: self.panel(PanelKind::Backlight(backlight), layers * frames + frame),
            };
            self.write_picture(time, &picture, &stage, entries)?;
        }
        Ok(())
    }

    /// Writes the simulated views that the parameter `views` selects.
    fn write_simulated(&self, time: Time, stack: &StackInput<'_>, entries: &mut Vec<Entry>) -> Result<(), PluginError> {
        let grid = &stack.target().grid;
        let views = match self.params.views {
            Views::None => return Ok(()),
            Views::Some => centre_and_corners(grid.views()),
            Views::All => grid.iter().collect(),
        };
        let stage = self.host.stage("simulated views", views.len() as u64, "pictures");
        for view in views {
            self.host.check_cancelled()?;
            let slope = [grid.slope_x[view[1]], grid.slope_y[view[0]]];
            let picture = Picture {
                stem: format!("{}simulated_{}", folder(time), view_name(view, grid.views())),
                content: Content::SimulatedView { view, slope, divided_by: stack.brightness() },
                size: [stack.target().rows, stack.target().cols],
                rgb: ViewSource::Stack(stack).view(view)?.into(),
                transfer: self.params.encode.of_other(),
                panel: None,
            };
            self.write_picture(time, &picture, &stage, entries)?;
        }
        Ok(())
    }

    /// Writes the contact sheet.
    fn write_sheet(&self, time: Time, source: &ViewSource<'_>) -> Result<Entry, PluginError> {
        let (geometry, path) = (source.geometry(), format!("{}sheet.png", folder(time)));
        let grid = &geometry.grid;
        let mut bands: Vec<Vec<Cell<'_>>> = Vec::new();
        let mut legend = format!("{}\n", self.display.name);
        // Rows of masks come first, then rows of views.
        let (chosen, across) = match source {
            ViewSource::Stack(stack) => {
                bands.extend((0..stack.frames()).map(|frame| sheet::patterns(&self.display, stack, frame)));
                legend += "Patterns: one row per frame, layers from rear (left) to front; a pixel's transmittance (or emission, or rotation), 0 to 1, \
                           shown in sRGB.\n";
                legend += &format!(
                    "Views: the emitted light divided by the brightness {:.3}, to which a viewer's eyes adapt, in sRGB.",
                    stack.brightness()
                );
                let chosen = match self.params.views {
                    Views::None => Vec::new(),
                    Views::Some => centre_and_corners(grid.views()),
                    Views::All => grid.iter().collect(),
                };
                (chosen, stack.layer_count().max(3))
            }
            ViewSource::Field(_) => {
                legend += "Views of the light field, from the upper left one to the lower right one, shown in sRGB.";
                (grid.iter().collect(), grid.views()[1])
            }
        };
        for views in chosen.chunks(across) {
            bands.push(views.iter().map(|view| sheet::view(source, *view)).collect());
        }
        let [width, height] = sheet::write(&self.host, &path, &legend, &bands)?;
        let format = Format::Png { bits: 8, encoding: Some(Transfer::Srgb), panel_bits: None, dither: None };
        Ok(entry(path, Content::Sheet, format, false, Some([height, width]), time))
    }

    /// Writes the multi-view OpenEXR file, the animation and the folders of public archives, for a
    /// stack or a light field.
    fn write_from_views(
        &self,
        time: Time,
        source: &ViewSource<'_>,
        entries: &mut Vec<Entry>,
    ) -> Result<(), PluginError> {
        let (params, folder, geometry) = (&self.params, folder(time), source.geometry());
        let grid = &geometry.grid;
        let size = [geometry.rows, geometry.cols];
        let divided_by = source.divided_by();
        // Write the multi-view OpenEXR file. The central view is first, since readers show the
        // first view by default.
        if params.exr_multi_view {
            let (precision, name) = params.exr_depth.precision();
            let centre = grid.views().map(|count| (count - 1) / 2);
            let mut file = MultiView::new([size[1], size[0]], precision);
            let mut views = Vec::new();
            let stage = self.host.stage("multi-view picture", (grid.views()[0] * grid.views()[1]) as u64, "views");
            for view in [centre].into_iter().chain(grid.iter().filter(|view| *view != centre)) {
                self.host.check_cancelled()?;
                let name = format!("view_{}", view_name(view, grid.views()));
                file.push(&name, &source.view(view)?);
                views.push(NamedView { name, view, slope: [grid.slope_x[view[1]], grid.slope_y[view[0]]] });
                stage.advance(1, "");
            }
            let bytes = file.into_bytes().map_err(|error| PluginError::failed("OpenEXR encoder", error))?;
            let path = format!("{folder}views.exr");
            self.host.write(&path, &bytes)?;
            let content = Content::Views { views, divided_by };
            entries.push(entry(path, content, Format::Exr { precision: name }, true, Some(size), time));
        }
        // Write the animation, whose viewpoint moves through the views. A light field shows the
        // view nearest to the viewpoint.
        if params.animation != Animation::None {
            let swing = Swing {
                pictures: params.animation_pictures,
                pictures_per_second: params.animation_rate,
                ellipse: params.animation == Animation::Ellipse,
                width: params.animation_width,
            };
            let path = format!("{folder}swing.png");
            swing.write(&self.host, &path, source)?;
            let is_nearest = matches!(source, ViewSource::Field(_));
            let slope = |at: [f64; 2]| {
                let at = if is_nearest { nearest(geometry, at).map(|view| view as f64) } else { at };
                [slope_at(&grid.slope_x, at[1]), slope_at(&grid.slope_y, at[0])]
            };
            let content = Content::Animation {
                slopes: swing.path(grid.views()).into_iter().map(slope).collect(),
                nearest: is_nearest,
                pictures_per_second: params.animation_rate,
                divided_by,
            };
            let [width, height] = swing.size(size);
            let format = Format::Apng { bits: 8, encoding: Transfer::Srgb };
            entries.push(entry(path, content, format, false, Some([height, width]), time));
        }
        // Write folders in the formats of public archives.
        let archives = [(params.hci, Archive::Hci, "hci"), (params.stanford, Archive::Stanford, "stanford")];
        for (_, archive, name) in archives.into_iter().filter(|(wanted, ..)| *wanted) {
            let sixteen = params.png16 && !params.png8;
            let settings = folders::Settings {
                nominal_mm: params.camera_distance_mm,
                sixteen_bits: sixteen,
                meta: [params.hci_date.as_str(), &params.hci_authors, &params.hci_contact],
                shown_mm: self.display.depth_of_field(geometry.pitch_mm),
            };
            let files = folders::write(&self.host, archive, &folder, source, &settings)?;
            let bits = if sixteen { 16 } else { 8 };
            for (file, view) in files {
                let slope = [grid.slope_x[view[1]], grid.slope_y[view[0]]];
                let content = Content::ArchiveView { archive: name, view, slope, divided_by };
                let format = self.png_format(bits, Some(&Transfer::Srgb), None);
                entries.push(entry(file, content, format, false, Some(size), time));
            }
        }
        Ok(())
    }

    /// Writes one picture in every requested format.
    fn write_picture(
        &self,
        time: Time,
        picture: &Picture<'_>,
        stage: &Stage,
        entries: &mut Vec<Entry>,
    ) -> Result<(), PluginError> {
        let (params, transfer, size) = (&self.params, picture.transfer, picture.size);
        let mut write = |suffix: String, format: Format, linear: bool, bytes: Vec<u8>| {
            let file = format!("{}{suffix}", picture.stem);
            self.host.write(&file, &bytes)?;
            entries.push(entry(file, picture.content.clone(), format, linear, Some(size), time));
            Ok::<_, PluginError>(())
        };
        let linear = if params.encode == Encode::Linear { "_linear" } else { "" };
        let proportional = *transfer == Transfer::Linear;
        let codes = picture.panel.map(|panel| panel.codes);
        // Write PNGs, whose codes may drive a panel, and OpenEXR files, which contain the linear
        // values.
        if params.png8 || params.png16 {
            let driven: Cow<'_, [f32]> = match picture.panel {
                Some(panel) => panel.driven(&picture.rgb).into(),
                None => Cow::Borrowed(&picture.rgb),
            };
            if params.png8 {
                let bytes = png8(&samples8(transfer, codes, size, &driven), size, transfer)?;
                write(format!("{linear}.png"), self.png_format(8, Some(transfer), codes), proportional, bytes)?;
            }
            if params.png16 {
                let bytes = png16(&samples16(transfer, codes, size, &driven), size, transfer)?;
                write(format!("{linear}_16bit.png"), self.png_format(16, Some(transfer), codes), proportional, bytes)?;
            }
        }
        if params.exr {
            let (precision, name) = params.exr_depth.precision();
            let bytes = exr_bytes([size[1], size[0]], &picture.rgb, precision)
                .map_err(|error| PluginError::failed("OpenEXR encoder", error))?;
            write(".exr".into(), Format::Exr { precision: name }, true, bytes)?;
        }
        stage.advance(1, "");
        Ok(())
    }

    /// Returns the 8-bit samples of a mask for the atlas, `[row][col][rgb]`.
    fn layer_samples(&self, stack: &StackInput<'_>, layer: usize, frame: usize) -> Result<Vec<u8>, PluginError> {
        let own = self.layer_of(layer)?;
        let plane = stack.layer(layer, frame)?;
        let (size, rgb) = ([plane.rows(), plane.cols()], plane.values());
        let panel = self.panel(PanelKind::Layer(own), layer + stack.layer_count() * frame);
        let driven = panel.map_or_else(|| rgb.clone(), |panel| panel.driven(&rgb).into());
        Ok(samples8(self.params.encode.of_panel(&own.transfer), panel.map(|panel| panel.codes), size, &driven))
    }

    fn layer_of(&self, layer: usize) -> Result<&Layer, PluginError> {
        let layers = &self.display.layers;
        layers.get(layer).ok_or_else(|| {
            PluginError::Refused(format!("layer: expected an index below {}, found {layer}", layers.len()))
        })
    }

    fn panel<'a>(&self, kind: PanelKind<'a>, pattern: usize) -> Option<Panel<'a>> {
        let own = match kind {
            PanelKind::Layer(layer) => layer.bits,
            PanelKind::Backlight(_) => None,
        };
        let bits = if self.params.bits > 0 { Some(self.params.bits) } else { own };
        let codes = PanelCodes { bits, dither: self.params.dither, pattern };
        (self.params.encode == Encode::Panel).then_some(Panel { kind, codes })
    }

    fn png_format(&self, bits: u32, transfer: Option<&Transfer>, codes: Option<PanelCodes>) -> Format {
        let panel_bits = codes.and_then(|codes| codes.bits).map(|panel| panel.min(bits));
        let dither = codes.and_then(|codes| match codes.dither {
            Dither::None => None,
            Dither::Ordered => Some("ordered"),
            Dither::BlueNoise => Some("blue_noise"),
            Dither::Diffusion => Some("diffusion"),
        });
        Format::Png { bits, encoding: transfer.cloned(), panel_bits, dither }
    }
}

impl ExrDepth {
    fn precision(self) -> (Precision, &'static str) {
        match self {
            Self::Half => (Precision::Half, "half"),
            Self::Float => (Precision::Float, "float"),
        }
    }
}

/// Makes the description of a file; `size` is [rows, cols] of a picture.
fn entry(file: String, content: Content, format: Format, linear: bool, size: Option<[usize; 2]>, time: Time) -> Entry {
    let size = size.map(|[height, width]| Size { width, height });
    Entry { file, content, format, linear, size, time: time.index, time_seconds: time.seconds }
}

/// Returns the folder of a time step, empty for the first one, whose files are next to
/// `images.json`.
fn folder(time: Time) -> String {
    if time.index == 0 { String::new() } else { format!("t{:04}/", time.index) }
}

fn view_name([y, x]: [usize; 2], [rows, cols]: [usize; 2]) -> String {
    format!("{y:0y_digits$}_{x:0x_digits$}", y_digits = digits(rows, 2), x_digits = digits(cols, 2))
}

/// Returns the number of digits, at least `least`, that the numbers of `count` items need. Names
/// whose numbers have equally many digits sort in the order of the numbers.
fn digits(count: usize, least: usize) -> usize {
    count.saturating_sub(1).to_string().len().max(least)
}
