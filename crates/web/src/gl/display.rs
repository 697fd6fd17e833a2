//! Draws a preview on the GPU. Each layer is a texture array with one slice per frame. Tables, also
//! as textures, state where the rays hit the layers.

use js_sys::Float32Array;
use lumistack_display::{Backlight, Formation, Missing};
use web_sys::WebGl2RenderingContext as Gl;
use web_sys::{WebGlProgram, WebGlTexture};

use super::parts::{check, location, message, program, texture};
use crate::preview::Part;
use crate::{Error, Model, err};

/// Vertex shader of one triangle that covers the canvas.
const FULL: &str = include_str!("../shaders/full.vert.glsl");
/// Fragment shader, which computes the seen picture at every pixel of the light field. A pixel is
/// the mean light of its rays. There is a ray for every part of the pixel and every point of the
/// viewer's pupil. The tables of `tables.rs` state where a ray hits each layer. Let M be the number
/// of frames m, b the light of a directional backlight, and v the value that the ray hits on layer
/// n. With a uniform backlight, b is left out. The ray's light is
///
/// ```text
/// attenuating    (1/M) Σ_m b ∏_n v
/// additive       (1/M) Σ_m (b + Σ_n v)
/// polarization   (1/M) Σ_m b sin²(π/2 Σ_n v)
/// ```
///
/// [`defines`] puts macros in front of the text: `DECLARE_LAYERS`, `MEET_LAYERS` (`MEET(n,
/// layer_n)` for every layer), `FORMATION` (0 attenuating, 1 additive, 2 polarization),
/// `DIRECTIONAL` (0 or 1), `LAYERS`. Visitors load the text, so its comments are short.
const DISPLAY: &str = include_str!("../shaders/display.frag.glsl");
/// Number of texture units apart from the layers' units: two tables and the backlight's emission.
const OTHER_UNITS: usize = 3;

/// A WebGL2 context with its objects, which draws a preview.
pub(crate) struct Gpu {
    gl: Gl,
    display: WebGlProgram,
    layers: Vec<WebGlTexture>,
    emission: WebGlTexture,
    taps: [WebGlTexture; 2],
}

impl Gpu {
    /// Creates all objects and uploads the frames that are complete.
    ///
    /// # Errors
    /// If the context is lost, if its limits or its memory are too small for the preview, or if the
    /// shaders do not compile.
    pub(crate) fn new(gl: Gl, model: &Model) -> Result<Self, Error> {
        // Prepare the context.
        check(&gl)?;
        gl.pixel_storei(Gl::UNPACK_ALIGNMENT, 1);
        gl.disable(Gl::DEPTH_TEST);
        gl.disable(Gl::DITHER);
        check_limits(&gl, model)?;
        let display = program(&gl, FULL, DISPLAY, &defines(model))?;
        // Create a texture array per layer and for the backlight.
        let frames = model.preview().frames as i32;
        let array = |[rows, cols]: [usize; 2], plain: bool| {
            let texture = texture(&gl, Gl::TEXTURE_2D_ARRAY)?;
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
            Backlight::Uniform => texture(&gl, Gl::TEXTURE_2D_ARRAY)?,
        };
        let taps = [texture(&gl, Gl::TEXTURE_2D)?, texture(&gl, Gl::TEXTURE_2D)?];
        if gl.get_error() == Gl::OUT_OF_MEMORY {
            return Err(err(
                "WebGL2: expected memory for all patterns, found too little. Add ?renderer=cpu to the page's address, so that the processor draws",
            ));
        }
        let gpu = Self { gl, display, layers, emission, taps };
        // Upload the complete frames.
        for (slot, &frame) in model.complete().iter().enumerate() {
            gpu.upload(model, frame, slot)?;
        }
        Ok(gpu)
    }

    /// Uploads a complete frame to the slice `slot` of the texture arrays.
    pub(crate) fn upload(&self, model: &Model, frame: usize, slot: usize) -> Result<(), Error> {
        let gl = &self.gl;
        check(gl)?;
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
            let values = model.hit_values(n, &[frame]);
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
                Some(&Float32Array::from(values.data())),
            )
            .map_err(|error| message(&error))?;
        }
        if matches!(preview.display.backlight, Backlight::Lenslets(_)) {
            bytes(&self.emission, Part::Emission { frame })?;
        }
        Ok(())
    }

    /// Draws the view from a slope to the canvas, with one canvas pixel for each pixel of the light
    /// field.
    pub(crate) fn draw(&self, model: &Model, slope: [f64; 2]) -> Result<(), Error> {
        let gl = &self.gl;
        check(gl)?;
        let tables = model.tables(slope, model.projection());
        let (rows, cols) = (model.geometry().rows, model.geometry().cols);
        gl.use_program(Some(&self.display));
        let at = |name: &str| location(gl, &self.display, name);
        // Bind the layers, the emission and the tables.
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
        // Set the options.
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
        gl.uniform1i(at("rows").as_ref(), rows as i32);
        gl.uniform1f(at("gain").as_ref(), model.gain());
        gl.uniform1f(at("black").as_ref(), model.options().black_level as f32);
        gl.uniform1i(at("dropped").as_ref(), i32::from(model.preview().display.missing == Missing::Drop));
        gl.viewport(0, 0, cols as i32, rows as i32);
        gl.draw_arrays(Gl::TRIANGLES, 0, 3);
        Ok(())
    }

    /// Uploads a table to the bound texture.
    fn upload_table(&self, width: usize, values: &[f32]) -> Result<(), Error> {
        let rows = values.len() / (4 * width);
        let upload = self.gl.tex_image_2d_with_i32_and_i32_and_i32_and_format_and_type_and_opt_array_buffer_view(
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
}

impl Drop for Gpu {
    fn drop(&mut self) {
        let gl = &self.gl;
        let others = [&self.emission, &self.taps[0], &self.taps[1]];
        self.layers.iter().chain(others).for_each(|texture| gl.delete_texture(Some(texture)));
        gl.delete_program(Some(&self.display));
    }
}

/// Returns the display's properties as macros for the shader.
fn defines(model: &Model) -> String {
    let display = &model.preview().display;
    let count = display.layers.len();
    let declared: String = (0..count).map(|n| format!("uniform sampler2DArray layer_{n}; ")).collect();
    let lookups: String = (0..count).map(|n| format!("MEET({n}, layer_{n}) ")).collect();
    let formation = match display.formation {
        Formation::Attenuating => 0,
        Formation::Additive => 1,
        Formation::Polarization => 2,
    };
    let directional = i32::from(matches!(display.backlight, Backlight::Lenslets(_)));
    format!(
        "#define LAYERS {count}\n#define FORMATION {formation}\n#define DIRECTIONAL {directional}\n\
         #define DECLARE_LAYERS {declared}\n#define MEET_LAYERS {lookups}\n"
    )
}

/// Checks that the limits of the graphics driver suffice for the preview.
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
                "WebGL2: expected a limit of at least {needed} {what}, found a limit of {found}. Add ?renderer=cpu to the page's address, so that the processor draws"
            )));
        }
    }
    Ok(())
}
