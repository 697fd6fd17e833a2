//! Rasterizes SVGs. Text is drawn with a font that the program contains.

use std::sync::{Arc, OnceLock};

use resvg::{tiny_skia, usvg};

use crate::PlotError;

/// A subset of DejaVu Sans.
const FONT: &[u8] = include_bytes!("../fonts/DejaVuSans-subset.ttf");

/// Rasterizes an SVG at `scale` pixels per unit.
///
/// # Errors
/// If the text is not an SVG, or the picture is too large.
pub fn png(svg: &str, scale: f32) -> Result<Vec<u8>, PlotError> {
    raster(svg, scale)?.encode_png().map_err(PlotError::new)
}

/// Rasterizes an opaque SVG of [width, height] units at one pixel per unit. Returns the codes
/// `[row][col][rgb]`.
///
/// # Errors
/// If the text is not an SVG, or has another size.
pub fn codes(svg: &str, size: [usize; 2]) -> Result<Vec<u8>, PlotError> {
    let picture = raster(svg, 1.0)?;
    if [picture.width() as usize, picture.height() as usize] != size {
        return Err(PlotError::new("expected a picture of the requested size, found another size"));
    }
    Ok(picture.pixels().iter().flat_map(|p| [p.red(), p.green(), p.blue()]).collect())
}

fn raster(svg: &str, scale: f32) -> Result<tiny_skia::Pixmap, PlotError> {
    static FONTS: OnceLock<Arc<usvg::fontdb::Database>> = OnceLock::new();
    let fontdb = FONTS.get_or_init(|| {
        let mut fonts = usvg::fontdb::Database::new();
        fonts.load_font_data(FONT.to_vec());
        fonts.set_sans_serif_family("DejaVu Sans");
        Arc::new(fonts)
    });
    let options = usvg::Options { fontdb: fontdb.clone(), font_family: "DejaVu Sans".into(), ..Default::default() };
    let tree = usvg::Tree::from_str(svg, &options).map_err(PlotError::new)?;
    let size = tree.size();
    let [width, height] = [size.width(), size.height()].map(|side| (side * scale).ceil() as u32);
    let mut picture = tiny_skia::Pixmap::new(width, height)
        .ok_or_else(|| PlotError::new("expected a picture that fits into memory, found a larger one"))?;
    resvg::render(&tree, tiny_skia::Transform::from_scale(scale, scale), &mut picture.as_mut());
    Ok(picture)
}
