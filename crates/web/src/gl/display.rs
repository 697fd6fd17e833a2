//! A preview on the GPU: layers as texture arrays with one slice per frame, and the tables of where rays meet them.

use js_sys::Float32Array;
use lumistack_display::{Backlight, Formation, Missing, Projection};
use web_sys::WebGl2RenderingContext as Gl;
use web_sys::{HtmlCanvasElement, WebGlBuffer, WebGlFramebuffer, WebGlProgram, WebGlTexture};

use super::canvas::{Canvas, Picture};
use super::canvas::{location, message, program, texture, upload_rgba};
use crate::colour::{HEAT_TOP, heat_table};
use crate::explode::{Kind, Look, scene};
use crate::preview::Part;
use crate::{Error, Model, err};

/// One triangle that covers everything.
const FULL: &str = include_str!("../shaders/full.vert.glsl");
/// The seen picture at every pixel of the field: the mean over the parts of the pixel of what their rays meet, and over the places on the pupil. Where a ray meets a layer is looked up: the
/// tables are those of `tables.rs`, made by `AreaMap`.
///
/// ```text
/// attenuating    (1/M) Σ_m b ∏_n v        additive    (1/M) Σ_m (b + Σ_n v)        polarization    (1/M) Σ_m b sin²(π/2 Σ_n v)
/// ```
///
/// Defined in front of this text: `DECLARE_LAYERS`, `MEET_LAYERS` (`MEET(n, layer_n)` for every layer), `FORMATION` (0, 1, 2), `DIRECTIONAL`, `LAYERS`. Visitors load the text, so it says little.
const DISPLAY: &str = include_str!("../shaders/display.frag.glsl");
/// Corners come in clip space, computed by `explode.rs`.
const SCENE_VERTEX: &str = include_str!("../shaders/scene.vert.glsl");
/// One layer of the exploded view, the mean of the frames that are shown, or a plain colour.
const SCENE: &str = include_str!("../shaders/scene.frag.glsl");

/// Texture units that are not layers': tables, the emission, the reference.
const OTHER_UNITS: usize = 4;

/// What a canvas needs to show a preview.
pub(crate) struct Gpu {
    canvas: Canvas,
    display: WebGlProgram,
    scene: WebGlProgram,
    layers: Vec<WebGlTexture>,
    emission: WebGlTexture,
    taps: [WebGlTexture; 2],
    reference: WebGlTexture,
    /// Which view of the target the reference holds.
    held: Option<[usize; 2]>,
    picture: WebGlTexture,
    target: WebGlFramebuffer,
    corners: WebGlBuffer,
}

impl Gpu {
    /// Makes everything and uploads what has arrived.
    ///
    /// # Errors
    /// If there is no WebGL2 or it is too small for the preview.
    pub(crate) fn new(canvas: HtmlCanvasElement, model: &Model) -> Result<Self, Error> {
        let canvas = Canvas::new(canvas)?;
        let gl = &canvas.gl;
        check_limits(gl, model)?;
        let display = program(gl, FULL, DISPLAY, &defines(model))?;
        let scene = program(gl, SCENE_VERTEX, SCENE, "")?;
        let frames = model.preview().frames as i32;
        let array = |[rows, cols]: [usize; 2], plain: bool| {
            let texture = texture(gl, Gl::TEXTURE_2D_ARRAY)?;
            let format = if plain { Gl::RGB8 } else { Gl::RGB32F };
            gl.tex_storage_3d(Gl::TEXTURE_2D_ARRAY, 1, format, cols as i32, rows as i32, frames);
            Ok::<_, Error>(texture)
        };
        let preview = model.preview();
        let count = preview.display.layers.len();
        let size = |layer: usize| preview.size_of(Part::Layer { layer, frame: 0 });
        let layers = (0..count).map(|n| array(size(n), model.is_plain(n))).collect::<Result<_, _>>()?;
        let emission = match &preview.display.backlight {
            Backlight::Lenslets(_) => array(preview.size_of(Part::Emission { frame: 0 }), true)?,
            Backlight::Uniform => texture(gl, Gl::TEXTURE_2D_ARRAY)?,
        };
        let taps = [texture(gl, Gl::TEXTURE_2D)?, texture(gl, Gl::TEXTURE_2D)?];
        let reference = texture(gl, Gl::TEXTURE_2D)?;
        upload_rgba(gl, 1, 1, &[0; 4])?;
        let picture = texture(gl, Gl::TEXTURE_2D)?;
        let (rows, cols) = (model.geometry().rows as i32, model.geometry().cols as i32);
        gl.tex_storage_2d(Gl::TEXTURE_2D, 1, Gl::RGBA8, cols, rows);
        let target = gl.create_framebuffer().ok_or_else(|| err("WebGL2: no memory for a picture"))?;
        gl.bind_framebuffer(Gl::FRAMEBUFFER, Some(&target));
        gl.framebuffer_texture_2d(Gl::FRAMEBUFFER, Gl::COLOR_ATTACHMENT0, Gl::TEXTURE_2D, Some(&picture), 0);
        let corners = gl.create_buffer().ok_or_else(|| err("WebGL2: no memory for corners"))?;
        if gl.get_error() == Gl::OUT_OF_MEMORY {
            return Err(err(
                "WebGL2: expected memory for all patterns, found too little; the CPU draws with ?renderer=cpu",
            ));
        }
        let held = None;
        let gpu = Self { display, scene, layers, emission, taps, reference, held, picture, target, corners, canvas };
        for (slot, &frame) in model.complete().iter().enumerate() {
            gpu.upload(model, frame, slot)?;
        }
        Ok(gpu)
    }

    /// Uploads a complete frame into a slice.
    pub(crate) fn upload(&self, model: &Model, frame: usize, slot: usize) -> Result<(), Error> {
        self.canvas.check()?;
        let gl = &self.canvas.gl;
        gl.active_texture(Gl::TEXTURE0);
        let preview = model.preview();
        let bytes = |texture: &WebGlTexture, part: Part| {
            let ([rows, cols], codes) = (preview.size_of(part), model.codes(part));
            gl.bind_texture(Gl::TEXTURE_2D_ARRAY, Some(texture));
            gl.tex_sub_image_3d_with_opt_u8_array(
                Gl::TEXTURE_2D_ARRAY,
                0,
                0,
                0,
                slot as i32,
                cols as i32,
                rows as i32,
                1,
                Gl::RGB,
                Gl::UNSIGNED_BYTE,
                codes,
            )
            .map_err(|error| message(&error))
        };
        for (n, texture) in self.layers.iter().enumerate() {
            let part = Part::Layer { layer: n, frame };
            if model.is_plain(n) {
                bytes(texture, part)?;
                continue;
            }
            let met = model.met(n, &[frame]);
            let [rows, cols] = preview.size_of(part);
            gl.bind_texture(Gl::TEXTURE_2D_ARRAY, Some(texture));
            gl.tex_sub_image_3d_with_opt_array_buffer_view(
                Gl::TEXTURE_2D_ARRAY,
                0,
                0,
                0,
                slot as i32,
                cols as i32,
                rows as i32,
                1,
                Gl::RGB,
                Gl::FLOAT,
                Some(&Float32Array::from(met.data())),
            )
            .map_err(|error| message(&error))?;
        }
        if matches!(preview.display.backlight, Backlight::Lenslets(_)) {
            bytes(&self.emission, Part::Emission { frame })?;
        }
        Ok(())
    }

    /// What the display shows from a slope.
    pub(crate) fn draw(&self, model: &Model, slope: [f64; 2]) -> Result<(), Error> {
        self.picture(model, slope, model.projection(), false)?;
        self.canvas.show(Picture::Texture(&self.picture), None, aspect(model))
    }

    /// The error map of the target's view nearest to a slope.
    pub(crate) fn draw_error(&mut self, model: &Model, slope: [f64; 2]) -> Result<(), Error> {
        let view = model.nearest_view(slope);
        self.hold(model, view)?;
        self.picture(model, model.slope_of(view), model.geometry().grid.projection, true)?;
        self.canvas.show(Picture::Texture(&self.picture), None, aspect(model))
    }

    /// A view of the target.
    pub(crate) fn draw_target(&mut self, model: &Model, view: [usize; 2]) -> Result<(), Error> {
        self.hold(model, view)?;
        self.canvas.show(Picture::Texture(&self.reference), None, aspect(model))
    }

    /// The display left of `split`, the target's nearest view right of it.
    pub(crate) fn draw_split(&mut self, model: &Model, slope: [f64; 2], split: f64) -> Result<(), Error> {
        self.hold(model, model.nearest_view(slope))?;
        self.picture(model, slope, model.projection(), false)?;
        let right = (Picture::Texture(&self.reference), split);
        self.canvas.show(Picture::Texture(&self.picture), Some(right), aspect(model))
    }

    /// A layer's pattern in one frame.
    pub(crate) fn draw_layer(&self, model: &Model, layer: usize, frame: usize) -> Result<(), Error> {
        let rgba = model.render_layer(layer, frame)?;
        let [rows, cols] = model.preview().size_of(Part::Layer { layer, frame });
        self.canvas.show(Picture::Bytes { rows, cols, rgba: &rgba }, None, cols as f64 / rows as f64)
    }

    /// Renders the display into the picture, at the field's size.
    fn picture(&self, model: &Model, slope: [f64; 2], projection: Projection, as_error: bool) -> Result<(), Error> {
        self.canvas.check()?;
        let gl = &self.canvas.gl;
        let tables = model.tables(slope, projection);
        let (rows, cols) = (model.geometry().rows, model.geometry().cols);
        gl.use_program(Some(&self.display));
        let at = |name: &str| location(gl, &self.display, name);
        for (n, layer) in self.layers.iter().enumerate() {
            gl.active_texture(Gl::TEXTURE0 + n as u32);
            gl.bind_texture(Gl::TEXTURE_2D_ARRAY, Some(layer));
            gl.uniform1i(at(&format!("layer_{n}")).as_ref(), n as i32);
        }
        let first = self.layers.len() as u32;
        gl.active_texture(Gl::TEXTURE0 + first);
        gl.bind_texture(Gl::TEXTURE_2D_ARRAY, Some(&self.emission));
        gl.uniform1i(at("emission").as_ref(), first as i32);
        for (i, (name, width, values)) in
            [("taps_x", cols, &tables.x), ("taps_y", rows, &tables.y)].into_iter().enumerate()
        {
            let unit = first + 1 + i as u32;
            gl.active_texture(Gl::TEXTURE0 + unit);
            gl.bind_texture(Gl::TEXTURE_2D, Some(&self.taps[i]));
            self.upload_table(width, values)?;
            gl.uniform1i(at(name).as_ref(), unit as i32);
        }
        gl.active_texture(Gl::TEXTURE0 + first + 3);
        gl.bind_texture(Gl::TEXTURE_2D, Some(&self.reference));
        gl.uniform1i(at("reference").as_ref(), first as i32 + 3);
        let slots = model.slots();
        gl.uniform2i(at("slots").as_ref(), slots.first as i32, slots.count as i32);
        let [parts_x, parts_y] = tables.parts.map(|parts| parts as i32);
        gl.uniform4i(at("places").as_ref(), tables.places as i32, tables.rows_per_part as i32, parts_x, parts_y);
        let on_disc: Vec<f32> = tables.on_disc.iter().map(|on| f32::from(u8::from(*on))).collect();
        gl.uniform1fv_with_f32_array(at("on_disc").as_ref(), &on_disc);
        if let Backlight::Lenslets(backlight) = &model.preview().display.backlight {
            let [cols, rows] = backlight.lenslets;
            gl.uniform2i(at("lenslets").as_ref(), cols as i32, rows as i32);
        }
        gl.uniform1f(at("gain").as_ref(), model.gain());
        gl.uniform1f(at("black").as_ref(), model.options().black_level as f32);
        gl.uniform1i(at("dropped").as_ref(), i32::from(model.preview().display.missing == Missing::Drop));
        gl.uniform1i(at("as_error").as_ref(), i32::from(as_error));
        gl.uniform3fv_with_f32_array(at("heat").as_ref(), &heat_table());
        gl.uniform1f(at("heat_top").as_ref(), HEAT_TOP);
        gl.bind_framebuffer(Gl::FRAMEBUFFER, Some(&self.target));
        gl.disable(Gl::BLEND);
        gl.viewport(0, 0, cols as i32, rows as i32);
        gl.draw_arrays(Gl::TRIANGLES, 0, 3);
        Ok(())
    }

    /// One table into the texture that is bound.
    fn upload_table(&self, width: usize, values: &[f32]) -> Result<(), Error> {
        let rows = values.len() / (4 * width);
        let upload =
            self.canvas.gl.tex_image_2d_with_i32_and_i32_and_i32_and_format_and_type_and_opt_array_buffer_view(
                Gl::TEXTURE_2D,
                0,
                Gl::RGBA32F as i32,
                width as i32,
                rows as i32,
                0,
                Gl::RGBA,
                Gl::FLOAT,
                Some(&Float32Array::from(values)),
            );
        upload.map_err(|error| message(&error))
    }

    /// Makes the reference hold a view of the target.
    fn hold(&mut self, model: &Model, view: [usize; 2]) -> Result<(), Error> {
        if self.held == Some(view) {
            return Ok(());
        }
        let rgba = model.render_target(view)?;
        self.canvas.check()?;
        let gl = &self.canvas.gl;
        gl.active_texture(Gl::TEXTURE0);
        gl.bind_texture(Gl::TEXTURE_2D, Some(&self.reference));
        upload_rgba(gl, model.geometry().rows, model.geometry().cols, &rgba)?;
        self.held = Some(view);
        Ok(())
    }

    /// The layers pulled apart, with rays of a slope.
    pub(crate) fn draw_exploded(
        &self,
        model: &Model,
        slope: [f64; 2],
        [yaw_rad, pitch_rad, spread]: [f64; 3],
    ) -> Result<(), Error> {
        self.canvas.check()?;
        self.canvas.clear(0.0);
        let gl = &self.canvas.gl;
        let [width, height] = self.canvas.size();
        let display = model.options().built(&model.preview().display);
        let look = Look { yaw_rad, pitch_rad, spread, aspect: f64::from(width) / f64::from(height.max(1)) };
        gl.use_program(Some(&self.scene));
        gl.enable(Gl::BLEND);
        // the canvas takes colours that are multiplied by their opacity
        gl.blend_func_separate(Gl::SRC_ALPHA, Gl::ONE_MINUS_SRC_ALPHA, Gl::ONE, Gl::ONE_MINUS_SRC_ALPHA);
        gl.bind_buffer(Gl::ARRAY_BUFFER, Some(&self.corners));
        for (index, size, offset) in [(0, 4, 0), (1, 2, 16)] {
            gl.enable_vertex_attrib_array(index);
            gl.vertex_attrib_pointer_with_i32(index, size, Gl::FLOAT, false, 24, offset);
        }
        gl.active_texture(Gl::TEXTURE0);
        let at = |name: &str| location(gl, &self.scene, name);
        gl.uniform1i(at("layer").as_ref(), 0);
        let slots = model.slots();
        for item in scene(&display, model.geometry(), slope, look) {
            let (texture, tint) = match item.kind {
                Kind::Layer(n) => (Some(&self.layers[n]), [0.0, 0.0, 0.0, 0.86]),
                Kind::Backlight if matches!(display.backlight, Backlight::Lenslets(_)) => {
                    (Some(&self.emission), [0.0, 0.0, 0.0, 1.0])
                }
                Kind::Backlight => (None, [0.93, 0.94, 0.96, 1.0]),
                Kind::Rays => (None, [1.0, 0.78, 0.2, 0.9]),
            };
            // something is bound at all times: the sampler is part of the program
            gl.bind_texture(Gl::TEXTURE_2D_ARRAY, Some(texture.unwrap_or(&self.layers[0])));
            let count = if texture.is_some() { slots.count } else { 0 };
            gl.uniform2i(at("slots").as_ref(), slots.first as i32, count as i32);
            let [r, g, b, a] = tint;
            gl.uniform4f(at("tint").as_ref(), r, g, b, a);
            let flat = Float32Array::from(item.corners.as_flattened());
            gl.buffer_data_with_array_buffer_view(Gl::ARRAY_BUFFER, &flat, Gl::STREAM_DRAW);
            gl.draw_arrays(Gl::TRIANGLES, 0, item.corners.len() as i32);
        }
        gl.disable(Gl::BLEND);
        for index in 0..2 {
            gl.disable_vertex_attrib_array(index);
        }
        Ok(())
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        let gl = &self.canvas.gl;
        let others = [&self.emission, &self.taps[0], &self.taps[1], &self.reference, &self.picture];
        self.layers.iter().chain(others).for_each(|texture| gl.delete_texture(Some(texture)));
        gl.delete_program(Some(&self.display));
        gl.delete_program(Some(&self.scene));
        gl.delete_framebuffer(Some(&self.target));
        gl.delete_buffer(Some(&self.corners));
    }
}

fn aspect(model: &Model) -> f64 {
    model.geometry().cols as f64 / model.geometry().rows as f64
}

/// What the shader is told about the display before it is compiled.
fn defines(model: &Model) -> String {
    let display = &model.preview().display;
    let count = display.layers.len();
    let declared: String = (0..count).map(|n| format!("uniform sampler2DArray layer_{n}; ")).collect();
    let met: String = (0..count).map(|n| format!("MEET({n}, layer_{n}) ")).collect();
    let formation = match display.formation {
        Formation::Attenuating => 0,
        Formation::Additive => 1,
        Formation::Polarization => 2,
    };
    let directional = i32::from(matches!(display.backlight, Backlight::Lenslets(_)));
    format!(
        "#define LAYERS {count}\n#define FORMATION {formation}\n#define DIRECTIONAL {directional}\n\
         #define DECLARE_LAYERS {declared}\n#define MEET_LAYERS {met}\n"
    )
}

/// Whether this graphics driver can hold the preview.
fn check_limits(gl: &Gl, model: &Model) -> Result<(), Error> {
    let limit = |name: u32| gl.get_parameter(name).ok().and_then(|value| value.as_f64()).unwrap_or(0.0) as usize;
    let preview = model.preview();
    let parts = preview.files.iter().flat_map(|file| [file.rows, file.cols]);
    let side = parts.chain([model.geometry().rows, model.geometry().cols]).max().unwrap_or(0);
    for (what, needed, name) in [
        ("textures in use", preview.display.layers.len() + OTHER_UNITS, Gl::MAX_TEXTURE_IMAGE_UNITS),
        ("pixels along a side", side, Gl::MAX_TEXTURE_SIZE),
        ("frames", preview.frames, Gl::MAX_ARRAY_TEXTURE_LAYERS),
    ] {
        if needed > limit(name) {
            let found = limit(name);
            return Err(err(format!(
                "WebGL2: expected room for {needed} {what}, found {found}; the CPU draws with ?renderer=cpu"
            )));
        }
    }
    Ok(())
}
