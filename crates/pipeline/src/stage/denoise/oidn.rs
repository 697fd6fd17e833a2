//! Intel's Open Image Denoise, if it is installed. Its program `oidnDenoise` runs once per view.
//!
//! The environment variable `LUMISTACK_OIDN` may give the program's path. Otherwise this module
//! searches PATH, and then the Python package `pyoidn`, which includes the program. Pictures are
//! exchanged as PFM files: three little-endian floats per pixel, the lowest row first.

use std::path::{Path, PathBuf};
use std::process::Command;

use lumistack_core::bytes;
use lumistack_pathtracer::Features;

use crate::error::{PipelineError, read};
use crate::store::files::write;

/// Python code that prints the path of the program in the package `pyoidn`.
const ASK_PYTHON: &str = "import importlib.util as u, os; print(os.path.join(os.path.dirname(u.find_spec('pyoidn').origin), 'oidn', 'bin', 'oidnDenoise'))";

/// The program of Open Image Denoise. A successful call has shown that it works.
pub(crate) struct Oidn {
    program: PathBuf,
    /// Version, from the first line of the program's help.
    pub(crate) version: String,
}

impl Oidn {
    /// Searches for the program.
    ///
    /// # Errors
    /// If the program is not found.
    pub(crate) fn find() -> Result<Self, PipelineError> {
        if let Some(given) = std::env::var_os("LUMISTACK_OIDN") {
            let program = PathBuf::from(given);
            return Self::try_program(&program).ok_or_else(|| {
                let found = format!("`{}`, which does not start or is another program", program.display());
                PipelineError::option("LUMISTACK_OIDN", "program", "Open Image Denoise's program `oidnDenoise`", found)
            });
        }
        let in_package = || {
            let output = Command::new("python3").args(["-c", ASK_PYTHON]).output().ok()?;
            let said = String::from_utf8(output.stdout).ok()?;
            Self::try_program(Path::new(said.trim()))
        };
        Self::try_program(Path::new("oidnDenoise")).or_else(in_package).ok_or_else(|| {
            let expected = "Open Image Denoise's program `oidnDenoise` on PATH, in LUMISTACK_OIDN or in the Python package pyoidn";
            let found = "none of them; run `pip install pyoidn` to install the program, or use the filter `guided`, which needs no other program";
            PipelineError::job("render.denoise", expected, found)
        })
    }

    fn try_program(program: &Path) -> Option<Self> {
        let output = Command::new(program).arg("--help").output().ok()?;
        let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        let version = said.lines().next().unwrap_or_default().trim().to_owned();
        said.contains("Open Image Denoise").then(|| Self { program: program.to_owned(), version })
    }

    /// Denoises a picture `[row][col][rgb]`, scene-linear. The exchanged files are in `folder`.
    ///
    /// # Errors
    /// If the program fails or writes no picture of this size, or a file cannot be written.
    pub(crate) fn denoise(
        &self,
        radiance: &[f32],
        features: &Features,
        folder: &Path,
    ) -> Result<Vec<f32>, PipelineError> {
        // The albedo of pixels without a surface is 1, as the program's documentation recommends.
        let [rows, cols] = features.size();
        let path = |name: &str| folder.join(name).with_extension("pfm");
        let guide = |of: &dyn Fn(lumistack_pathtracer::Feature) -> glam::Vec3| -> Vec<f32> {
            (0..rows * cols).flat_map(|i| of(features.at(i / cols, i % cols)).to_array()).collect()
        };
        let albedo = guide(&|feature| feature.covered * feature.albedo + glam::Vec3::splat(1.0 - feature.covered));
        let normal = guide(&|feature| feature.covered * feature.normal);
        // The program reads and writes only files.
        write(&path("colour"), &pfm(radiance, rows, cols))?;
        write(&path("albedo"), &pfm(&albedo, rows, cols))?;
        write(&path("normal"), &pfm(&normal, rows, cols))?;
        let mut command = Command::new(&self.program);
        command.args(["--device", "cpu", "--clean_aux"]);
        for (option, name) in [("--hdr", "colour"), ("--alb", "albedo"), ("--nrm", "normal"), ("-o", "filtered")] {
            command.arg(option).arg(path(name));
        }
        let failed =
            |found: String| PipelineError::value(&self.program, "Open Image Denoise", "a filtered picture", found);
        let output = command.output().map_err(|error| failed(error.to_string()))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default().to_owned();
            return Err(failed(format!("{}: {said}", output.status)));
        }
        let filtered = parse_pfm(&read(&path("filtered"))?).filter(|(size, _)| *size == [rows, cols]);
        filtered
            .map(|(_, values)| values)
            .ok_or_else(|| failed("a file that is not a PFM picture of the view's size".into()))
    }
}

/// Encodes a picture `[row][col][rgb]` as a PFM file.
fn pfm(values: &[f32], rows: usize, cols: usize) -> Vec<u8> {
    let mut bytes = format!("PF\n{cols} {rows}\n-1.0\n").into_bytes();
    for row in values.chunks_exact(3 * cols).rev() {
        bytes::append(&mut bytes, row);
    }
    bytes
}

/// Decodes a little-endian colour PFM file: [rows, columns] and values `[row][col][rgb]`. `None` if
/// the bytes are no such file.
fn parse_pfm(bytes: &[u8]) -> Option<([usize; 2], Vec<f32>)> {
    let mut lines = bytes.splitn(4, |&byte| byte == b'\n');
    let mut line = || std::str::from_utf8(lines.next()?).ok();
    let (kind, size, scale) = (line()?, line()?, line()?);
    let (cols, rows) = size.split_once(' ')?;
    let (cols, rows): (usize, usize) = (cols.parse().ok()?, rows.trim().parse().ok()?);
    let data = lines.next()?;
    let count = cols.checked_mul(rows)?.checked_mul(3)?;
    if kind != "PF" || scale.trim().parse::<f32>().ok()? >= 0.0 || cols == 0 || data.len() != count.checked_mul(4)? {
        return None;
    }
    let values: Vec<f32> = data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    Some(([rows, cols], values.chunks_exact(3 * cols).rev().flatten().copied().collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_survives_its_file() {
        let values: Vec<f32> = (0..18).map(|i| i as f32 - 3.5).collect();
        let bytes = pfm(&values, 3, 2);
        assert!(bytes.starts_with(b"PF\n2 3\n-1.0\n"));
        // A PFM file begins with the lowest row, so its first value is value 12 of the picture.
        assert_eq!(bytes[12..16], values[12].to_le_bytes());
        assert_eq!(parse_pfm(&bytes), Some(([3, 2], values)));
        for cut in 0..bytes.len() {
            assert_eq!(parse_pfm(&bytes[..cut]), None);
        }
        assert_eq!(parse_pfm(b"PF\n99999999999 99999999999\n-1.0\n"), None);
    }
}
