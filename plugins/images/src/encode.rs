//! Encodes linear values as PNG.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::{Channels, Transfer};
use lumistack_plugin::encoding::{Dither, codes8, codes16, panel_codes};

/// Settings for the codes of a panel.
#[derive(Clone, Copy)]
pub(crate) struct PanelCodes {
    /// Bits per channel of the panel; `None` if unknown. A file with fewer bits per channel limits
    /// this number.
    pub(crate) bits: Option<u32>,
    pub(crate) dither: Dither,
    /// A number that is different for every layer and frame. It shifts the threshold map, so that
    /// the dots of different layers and frames are uncorrelated.
    pub(crate) pattern: usize,
}

/// Returns the 8-bit samples of a PNG, `[row][col][rgb]`, for linear values in 0..1.
pub(crate) fn samples8(transfer: &Transfer, panel: Option<PanelCodes>, size: [usize; 2], rgb: &[f32]) -> Vec<u8> {
    match panel {
        None => codes8(transfer, rgb),
        Some(panel) => {
            let bits = panel.bits.unwrap_or(8).min(8);
            let codes = panel_codes(transfer, bits, panel.dither, size, rgb, panel.pattern);
            codes.into_iter().map(|code| spread(code, bits, 255) as u8).collect()
        }
    }
}

/// Returns the 16-bit samples of a PNG, `[row][col][rgb]`, for linear values in 0..1.
pub(crate) fn samples16(transfer: &Transfer, panel: Option<PanelCodes>, size: [usize; 2], rgb: &[f32]) -> Vec<u16> {
    match panel {
        None => codes16(transfer, rgb),
        Some(panel) => {
            let bits = panel.bits.unwrap_or(16);
            let codes = panel_codes(transfer, bits, panel.dither, size, rgb, panel.pattern);
            codes.into_iter().map(|code| spread(code, bits, 65535) as u16).collect()
        }
    }
}

/// Converts a code of `bits` bits to a sample of a file with no fewer bits, whose largest sample is
/// `top`. The sample is code · top / (2^bits − 1), rounded, so its highest bits are the code.
fn spread(code: u16, bits: u32, top: u32) -> u32 {
    let own = (1u32 << bits) - 1;
    ((u64::from(code) * u64::from(top) + u64::from(own / 2)) / u64::from(own)) as u32
}

/// Encodes samples of 8 bits per channel as PNG. The PNG states most kinds of `transfer`; see
/// [`say_encoding`].
pub(crate) fn png8(samples: &[u8], size: [usize; 2], transfer: &Transfer) -> Result<Vec<u8>, PluginError> {
    png_bytes(samples, size, png::BitDepth::Eight, transfer)
}

/// Encodes samples of 16 bits per channel as PNG. The PNG states most kinds of `transfer`; see
/// [`say_encoding`].
pub(crate) fn png16(samples: &[u16], size: [usize; 2], transfer: &Transfer) -> Result<Vec<u8>, PluginError> {
    let bytes: Vec<u8> = samples.iter().flat_map(|sample| sample.to_be_bytes()).collect();
    png_bytes(&bytes, size, png::BitDepth::Sixteen, transfer)
}

fn png_bytes(
    samples: &[u8],
    [rows, cols]: [usize; 2],
    depth: png::BitDepth,
    transfer: &Transfer,
) -> Result<Vec<u8>, PluginError> {
    let side = |n: usize| u32::try_from(n).map_err(|error| PluginError::failed("PNG encoder", error));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side(cols)?, side(rows)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    say_encoding(&mut encoder, transfer);
    let mut writer = encoder.write_header().map_err(png_error)?;
    writer.write_image_data(samples).map_err(png_error)?;
    writer.finish().map_err(png_error)?;
    Ok(bytes)
}

/// States the transfer function of the codes in the PNG's chunk sRGB or gAMA. These chunks cannot
/// state a measured curve, or different curves for the channels. For such functions no chunk is
/// written.
pub(crate) fn say_encoding<W: std::io::Write>(encoder: &mut png::Encoder<'_, W>, transfer: &Transfer) {
    match transfer {
        Transfer::Srgb => encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric),
        Transfer::Linear => encoder.set_source_gamma(png::ScaledFloat::new(1.0)),
        Transfer::Gamma(Channels::Same(gamma)) => {
            encoder.set_source_gamma(png::ScaledFloat::new((1.0 / gamma) as f32));
        }
        Transfer::Gamma(_) | Transfer::Table(_) => {}
    }
}

/// Converts the error of a PNG encoder that writes to a file of the host.
pub(crate) fn png_error(error: png::EncodingError) -> PluginError {
    match error {
        png::EncodingError::IoError(error) => PluginError::from_io("PNG encoder", error),
        other => PluginError::failed("PNG encoder", other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_bits_of_a_sample_are_the_panel_s_code() {
        for (bits, code) in (1..=8u32).flat_map(|bits| (0..1u16 << bits).map(move |code| (bits, code))) {
            assert_eq!(spread(code, bits, 255) >> (8 - bits), u32::from(code), "{bits} bits");
            assert_eq!(spread(code, bits, 65535) >> (16 - bits), u32::from(code), "{bits} bits");
        }
        assert_eq!([0, 1, 2, 3].map(|code| spread(code, 2, 255)), [0, 85, 170, 255]);
    }
}
