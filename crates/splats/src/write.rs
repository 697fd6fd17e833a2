//! Writers of clouds: `.ply` as trainers write it, `.spz`, and SOG. These formats state no colour
//! space, and readers take colours for sRGB. The writers do not convert colours.

mod sog;

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;
use glam::{Quat, Vec3};
use lumistack_scene::Cloud;

pub use sog::sog;

/// Returns a `.ply` file of the cloud: binary, little endian, without a change of axes.
pub fn ply(cloud: &Cloud) -> Vec<u8> {
    let rest = 3 * (cloud.coefficients() - 1);
    let mut names: Vec<String> =
        ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(String::from).to_vec();
    names.extend((0..rest).map(|i| format!("f_rest_{i}")));
    names.extend(["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(String::from));
    let mut file = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", cloud.len()).into_bytes();
    names.iter().for_each(|name| file.extend(format!("property float {name}\n").bytes()));
    file.extend(b"end_header\n");
    let values = 3 * cloud.coefficients();
    for i in 0..cloud.len() {
        let harmonics = &cloud.harmonics[i * values..][..values];
        let mut row: Vec<f32> = cloud.positions[i].to_array().to_vec();
        row.extend([0.0; 3]);
        row.extend(&harmonics[..3]);
        (0..3).for_each(|channel| row.extend(harmonics.iter().skip(3 + channel).step_by(3)));
        let opacity = cloud.opacities[i];
        row.push((opacity / (1.0 - opacity)).ln());
        row.extend(cloud.scales[i].to_array().map(f32::ln));
        let [x, y, z, w] = cloud.rotations[i].to_array();
        row.extend([w, x, y, z]);
        row.iter().for_each(|value| file.extend(value.to_le_bytes()));
    }
    file
}

/// Number of fractional bits of positions in an `.spz` file.
const FRACTION: u32 = 12;

/// Returns an `.spz` file of version 3: quantized, and compressed with gzip.
///
/// Positions have steps of 2⁻¹² and are within ±2048. The caller scales clouds that need other
/// steps or bounds.
///
/// # Errors
/// If the compressor fails, which does not happen when it writes into memory.
pub fn spz(cloud: &Cloud) -> std::io::Result<Vec<u8>> {
    let mut file = GzEncoder::new(Vec::new(), Compression::best());
    file.write_all(b"NGSP")?;
    file.write_all(&3u32.to_le_bytes())?;
    file.write_all(&(cloud.len() as u32).to_le_bytes())?;
    file.write_all(&[cloud.degree as u8, FRACTION as u8, 0, 0])?;
    // Write each attribute for all splats, then the next one. `read/spz.rs` lists their
    // quantization.
    let byte = |value: f32| value.round().clamp(0.0, 255.0) as u8;
    for value in cloud.positions.iter().flat_map(|at| at.to_array()) {
        let most = (1 << 23) as f32 - 1.0;
        let fixed = (value * (1u32 << FRACTION) as f32).round().clamp(-most, most) as i32;
        file.write_all(&fixed.to_le_bytes()[..3])?;
    }
    let opacities: Vec<u8> = cloud.opacities.iter().map(|opacity| byte(255.0 * opacity)).collect();
    file.write_all(&opacities)?;
    let values = 3 * cloud.coefficients();
    for harmonics in cloud.harmonics.chunks_exact(values) {
        file.write_all(&[0, 1, 2].map(|c| byte(255.0 * (0.15 * harmonics[c] + 0.5))))?;
    }
    for scale in &cloud.scales {
        let log = |value: f32| byte(16.0 * (value.ln() + 10.0));
        file.write_all(&Vec3::to_array(scale).map(log))?;
    }
    for rotation in &cloud.rotations {
        file.write_all(&smallest_three(rotation.normalize()).to_le_bytes())?;
    }
    for harmonics in cloud.harmonics.chunks_exact(values) {
        let bytes: Vec<u8> = harmonics[3..].iter().map(|value| byte(128.0 * value + 128.0)).collect();
        file.write_all(&bytes)?;
    }
    file.finish()
}

/// Packs a rotation. The upper two bits are the index of the largest component; then ten bits
/// follow for each other component, with the sign first.
fn smallest_three(rotation: Quat) -> u32 {
    let parts = rotation.to_array();
    let largest = (0..4).fold(0, |best, i| if parts[i].abs() > parts[best].abs() { i } else { best });
    let sign = parts[largest] < 0.0;
    let mut word = largest as u32;
    for (i, part) in parts.into_iter().enumerate() {
        if i != largest {
            let size = (511.0 * part.abs() * std::f32::consts::SQRT_2).round().min(511.0) as u32;
            word = word << 10 | u32::from((part < 0.0) != sign) << 9 | size;
        }
    }
    word
}
