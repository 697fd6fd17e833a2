//! Helpers for WebGL2: programs and textures.

use wasm_bindgen::JsValue;
use web_sys::WebGl2RenderingContext as Gl;
use web_sys::{WebGlProgram, WebGlShader, WebGlTexture, WebGlUniformLocation};

use crate::{Error, err};

/// Shader function for the sRGB encoding (IEC 61966-2-1).
const COLOUR: &str = include_str!("../shaders/colour.glsl");

/// The error of a lost context.
pub(crate) const LOST: &str = "WebGL2: the browser took the graphics context away";

pub(crate) fn message(value: &JsValue) -> Error {
    err(format!("WebGL2: {value:?}"))
}

/// Checks that the context is not lost.
///
/// # Errors
/// If the context is lost; all data must be uploaded to a new context.
pub(crate) fn check(gl: &Gl) -> Result<(), Error> {
    if gl.is_context_lost() { Err(err(LOST)) } else { Ok(()) }
}

/// Makes a texture whose texels are read without interpolation.
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

/// Compiles and links two shaders. `defines` and the sRGB function precede the fragment shader.
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
        Err(err(format!("WebGL2: expected a driver that compiles the shaders, found an error: {log}")))
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
    Err(err(format!("WebGL2: expected a driver that links the shaders, found an error: {log}")))
}
