//! Draws by WebGL2: programs and textures.

mod display;
mod parts;

pub(crate) use display::Gpu;
