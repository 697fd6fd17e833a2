//! A canvas that shows pictures, side by side where two are given.

use js_sys::{Object, Reflect};
use wasm_bindgen::{JsCast, JsValue};
use web_sys::WebGl2RenderingContext as Gl;
use web_sys::{HtmlCanvasElement, WebGlProgram, WebGlShader, WebGlTexture, WebGlUniformLocation};

use crate::{Error, err};

const FULL: &str = include_str!("../shaders/full.vert.glsl");
/// sRGB encoding (IEC 61966-2-1), and the colours of the error map: the twin of `colour.rs`.
const COLOUR: &str = include_str!("../shaders/colour.glsl");
/// Pictures on the canvas: left of `split` one, right of it the other. Pixels stay sharp where they are enlarged; where the canvas is coarser than the
/// picture, the light of all its pixels under a canvas pixel is averaged.
const PRESENT: &str = include_str!("../shaders/present.frag.glsl");

/// What is said where there is no WebGL2.
const NO_WEBGL: &str = "WebGL2: expected a browser and a graphics driver that offer it, found none; the CPU draws instead with ?renderer=cpu";

/// A canvas and its context.
pub(crate) struct Canvas {
    pub(crate) gl: Gl,
    canvas: HtmlCanvasElement,
    present: WebGlProgram,
    uploaded: WebGlTexture,
}

/// sRGB bytes or a texture that holds them, row 0 the top.
pub(crate) enum Picture<'a> {
    /// `[row][col][rgba]`.
    Bytes { rows: usize, cols: usize, rgba: &'a [u8] },
    /// A texture of the same canvas.
    Texture(&'a WebGlTexture),
}

/// A part of the canvas, pixels from the bottom left.
#[derive(Clone, Copy)]
pub(crate) struct Area {
    pub(crate) x: i32,
    pub(crate) y: i32,
    pub(crate) width: i32,
    pub(crate) height: i32,
}

pub(crate) fn message(value: &JsValue) -> Error {
    err(format!("WebGL2: {value:?}"))
}

impl Canvas {
    /// # Errors
    /// If there is no WebGL2, or the canvas is in use for something else.
    pub(crate) fn new(canvas: HtmlCanvasElement) -> Result<Self, Error> {
        let options = Object::new();
        for (key, value) in [("alpha", true), ("antialias", false), ("depth", false), ("preserveDrawingBuffer", true)] {
            Reflect::set(&options, &key.into(), &value.into()).map_err(|error| message(&error))?;
        }
        let context = canvas.get_context_with_context_options("webgl2", &options).ok().flatten();
        let gl: Gl = context.and_then(|context| context.dyn_into().ok()).ok_or_else(|| err(NO_WEBGL))?;
        if gl.is_context_lost() {
            return Err(err(LOST));
        }
        let present = program(&gl, FULL, PRESENT, "")?;
        let uploaded = texture(&gl, Gl::TEXTURE_2D)?;
        gl.pixel_storei(Gl::UNPACK_ALIGNMENT, 1);
        gl.disable(Gl::DEPTH_TEST);
        gl.disable(Gl::DITHER);
        Ok(Self { gl, canvas, present, uploaded })
    }

    /// # Errors
    /// When the browser has taken the context away; a new one has everything uploaded anew.
    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.gl.is_context_lost() { Err(err(LOST)) } else { Ok(()) }
    }

    /// [width, height] of the drawing buffer.
    pub(crate) fn size(&self) -> [i32; 2] {
        [self.gl.drawing_buffer_width(), self.gl.drawing_buffer_height()]
    }

    /// The largest part of the canvas with a picture's aspect, in its middle.
    pub(crate) fn letterbox(&self, aspect: f64) -> Area {
        let [width, height] = self.size();
        let (w, h) = (f64::from(width), f64::from(height));
        let (w, h) = if w > h * aspect { (h * aspect, h) } else { (w, w / aspect) };
        let (w, h) = ((w.round() as i32).max(1), (h.round() as i32).max(1));
        Area { x: (width - w) / 2, y: (height - h) / 2, width: w, height: h }
    }

    /// Binds the canvas and clears it to black of this opacity.
    pub(crate) fn clear(&self, opacity: f32) {
        let [width, height] = self.size();
        self.gl.bind_framebuffer(Gl::FRAMEBUFFER, None);
        self.gl.viewport(0, 0, width, height);
        self.gl.disable(Gl::BLEND);
        self.gl.clear_color(0.0, 0.0, 0.0, opacity);
        self.gl.clear(Gl::COLOR_BUFFER_BIT);
    }

    /// Shows a picture, right of `split` (0..1) another.
    pub(crate) fn show(&self, left: Picture<'_>, right: Option<(Picture<'_>, f64)>, aspect: f64) -> Result<(), Error> {
        self.check()?;
        let gl = &self.gl;
        self.clear(1.0);
        let area = self.letterbox(aspect);
        gl.viewport(area.x, area.y, area.width, area.height);
        gl.use_program(Some(&self.present));
        let at = |name: &str| location(gl, &self.present, name);
        let (x, y, width, height) = (area.x as f32, area.y as f32, area.width as f32, area.height as f32);
        gl.uniform4f(at("area").as_ref(), x, y, width, height);
        let split = right.as_ref().map_or(2.0, |(_, split)| *split as f32);
        gl.uniform1f(at("split").as_ref(), split);
        self.bind(0, &left)?;
        self.bind(1, right.as_ref().map_or(&left, |(right, _)| right))?;
        gl.uniform1i(at("left").as_ref(), 0);
        gl.uniform1i(at("right").as_ref(), 1);
        gl.draw_arrays(Gl::TRIANGLES, 0, 3);
        Ok(())
    }

    fn bind(&self, unit: u32, picture: &Picture<'_>) -> Result<(), Error> {
        let gl = &self.gl;
        gl.active_texture(Gl::TEXTURE0 + unit);
        match *picture {
            Picture::Texture(texture) => gl.bind_texture(Gl::TEXTURE_2D, Some(texture)),
            Picture::Bytes { rows, cols, rgba } => {
                gl.bind_texture(Gl::TEXTURE_2D, Some(&self.uploaded));
                upload_rgba(gl, rows, cols, rgba)?;
            }
        }
        Ok(())
    }
}

impl Drop for Canvas {
    fn drop(&mut self) {
        self.gl.delete_program(Some(&self.present));
        self.gl.delete_texture(Some(&self.uploaded));
        let _ = &self.canvas;
    }
}

const LOST: &str = "WebGL2: the browser took the graphics context away; attach the canvas again once it has given it back, or draw with ?renderer=cpu";

/// Bytes into the 2D texture that is bound.
pub(crate) fn upload_rgba(gl: &Gl, rows: usize, cols: usize, rgba: &[u8]) -> Result<(), Error> {
    gl.tex_image_2d_with_i32_and_i32_and_i32_and_format_and_type_and_opt_u8_array(
        Gl::TEXTURE_2D,
        0,
        Gl::RGBA8 as i32,
        cols as i32,
        rows as i32,
        0,
        Gl::RGBA,
        Gl::UNSIGNED_BYTE,
        Some(rgba),
    )
    .map_err(|error| message(&error))
}

/// A texture that is only read texel by texel.
pub(crate) fn texture(gl: &Gl, kind: u32) -> Result<WebGlTexture, Error> {
    let texture = gl.create_texture().ok_or_else(|| err(LOST))?;
    gl.bind_texture(kind, Some(&texture));
    for (key, value) in [
        (Gl::TEXTURE_MIN_FILTER, Gl::NEAREST),
        (Gl::TEXTURE_MAG_FILTER, Gl::NEAREST),
        (Gl::TEXTURE_WRAP_S, Gl::CLAMP_TO_EDGE),
        (Gl::TEXTURE_WRAP_T, Gl::CLAMP_TO_EDGE),
    ] {
        gl.tex_parameteri(kind, key, value as i32);
    }
    Ok(texture)
}

pub(crate) fn location(gl: &Gl, program: &WebGlProgram, name: &str) -> Option<WebGlUniformLocation> {
    gl.get_uniform_location(program, name)
}

/// Compiles and links; `defines` stands in front of the fragment shader, which also gets the colour functions.
pub(crate) fn program(gl: &Gl, vertex: &str, fragment: &str, defines: &str) -> Result<WebGlProgram, Error> {
    let precision =
        "precision highp float;\nprecision highp int;\nprecision highp sampler2D;\nprecision highp sampler2DArray;\n";
    let fragment = format!("#version 300 es\n{precision}{defines}\n{COLOUR}\n{fragment}");
    let compiled = |kind: u32, text: &str| -> Result<WebGlShader, Error> {
        let shader = gl.create_shader(kind).ok_or_else(|| err(LOST))?;
        gl.shader_source(&shader, text);
        gl.compile_shader(&shader);
        if gl.get_shader_parameter(&shader, Gl::COMPILE_STATUS).is_truthy() {
            return Ok(shader);
        }
        let log = gl.get_shader_info_log(&shader).unwrap_or_default();
        Err(err(format!("WebGL2: expected a driver that compiles the shaders, found: {log}")))
    };
    let program = gl.create_program().ok_or_else(|| err(LOST))?;
    for shader in [compiled(Gl::VERTEX_SHADER, vertex)?, compiled(Gl::FRAGMENT_SHADER, &fragment)?] {
        gl.attach_shader(&program, &shader);
        gl.delete_shader(Some(&shader));
    }
    gl.link_program(&program);
    if gl.get_program_parameter(&program, Gl::LINK_STATUS).is_truthy() {
        return Ok(program);
    }
    let log = gl.get_program_info_log(&program).unwrap_or_default();
    Err(err(format!("WebGL2: expected a driver that links the shaders, found: {log}")))
}
