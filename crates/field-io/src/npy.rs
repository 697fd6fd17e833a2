//! NumPy's array files: `.npy`, C order.
//!
//! Files are written with little-endian `float32`, which `numpy.load` reads directly. Files with
//! `float16/32/64` and `uint8/16` of either byte order are read. Ranges of values can be read, so a
//! large array need not fit into memory.

use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use exr::prelude::f16;
use lumistack_core::bytes::append;
use npyz::{DType, Endianness, NpyHeader, Order, TypeChar, WriteOptions, WriterBuilder};

use crate::{FieldError, atomic};

/// Longest header, bytes; NumPy's own limit is 10,000 characters.
const HEADER_LIMIT: usize = 1 << 16;
/// Largest number of digits in a header, so that the product of its numbers fits into 64 bits.
const DIGIT_LIMIT: usize = 18;
/// Number of values that are converted together.
const CHUNK: usize = 1 << 14;

/// An array file, open for reading.
#[derive(Debug)]
pub struct NpyFile {
    path: PathBuf,
    shape: Vec<usize>,
    scalar: Scalar,
    big_endian: bool,
    data_start: u64,
    file: BufReader<lumistack_files::File>,
}

/// Type of the values of an array file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// Half floats.
    F16,
    /// Floats.
    F32,
    /// Doubles.
    F64,
    /// Code values 0..255; they are read as 0..1.
    U8,
    /// Code values 0..65535; they are read as 0..1.
    U16,
}

/// Writes a row-major array of `f32`.
///
/// # Errors
/// If writing fails.
///
/// # Panics
/// If the length of `data` differs from the number of values in `shape`.
pub fn write(path: &Path, shape: &[usize], data: &[f32]) -> Result<(), FieldError> {
    assert_eq!(shape.iter().product::<usize>(), data.len(), "values fill the shape");
    atomic::write(path, |writer| {
        write_header(&mut *writer, shape)?;
        write_values(writer, data)
    })
}

/// Writes the header of a row-major array of little-endian `float32`.
pub(crate) fn write_header(writer: impl Write, shape: &[usize]) -> io::Result<()> {
    let shape: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
    let dtype = DType::new_scalar("<f4".parse().map_err(|_| io::Error::other("no float32 type"))?);
    WriteOptions::new_header_only().dtype(dtype).shape(&shape).writer(writer).write_header_only().map(drop)
}

/// Writes values that follow a header.
pub(crate) fn write_values(mut writer: impl Write, data: &[f32]) -> io::Result<()> {
    let mut bytes = Vec::with_capacity(4 * CHUNK);
    for chunk in data.chunks(CHUNK) {
        bytes.clear();
        append(&mut bytes, chunk);
        writer.write_all(&bytes)?;
    }
    Ok(())
}

/// Reads a whole array as `f32`, and its shape.
///
/// # Errors
/// The errors of [`NpyFile::open`]. Also if there is too little memory, or reading fails.
pub fn read(path: &Path) -> Result<(Vec<usize>, Vec<f32>), FieldError> {
    let mut array = NpyFile::open(path)?;
    let count = array.len();
    let mut data = zeros(path, count)?;
    array.read_values(0, &mut data)?;
    Ok((array.shape, data))
}

impl NpyFile {
    /// Opens an array and checks the file's length against its header.
    ///
    /// # Errors
    /// If the file cannot be read or is too short, the header is malformed, or the type of the
    /// values is not supported. Also if an array of several axes has Fortran's order.
    pub fn open(path: &Path) -> Result<Self, FieldError> {
        let mut file = BufReader::new(lumistack_files::open(path).map_err(FieldError::io(path, "read"))?);
        let file_length = lumistack_files::length(file.get_ref()).map_err(FieldError::io(path, "read"))?;
        let (header, data_start) = read_header(path, &mut file)?;
        let (scalar, big_endian) = scalar_type(path, &header.dtype())?;
        if header.order() != Order::C && header.shape().len() > 1 {
            return Err(FieldError::malformed(
                path,
                "fortran_order",
                "False (numpy.ascontiguousarray makes an array in this order)",
                "True",
            ));
        }
        // In WebAssembly `usize` has 32 bits, so compute with 64 bits, which suffice by
        // [`DIGIT_LIMIT`].
        let expected = header.shape().iter().product::<u64>() * scalar.bytes() as u64;
        if file_length - data_start.min(file_length) < expected {
            return Err(FieldError::malformed(
                path,
                format!("values of shape {:?}", header.shape()),
                format!("{expected} bytes"),
                format!("{}: the file is cut short", file_length - data_start.min(file_length)),
            ));
        }
        let shape = header.shape().iter().map(|&n| n as usize).collect();
        Ok(Self { path: path.to_path_buf(), shape, scalar, big_endian, data_start, file })
    }

    /// Returns the lengths of the axes, outermost first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Returns the type of the file's values.
    pub fn scalar(&self) -> Scalar {
        self.scalar
    }

    /// Returns the number of values.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Returns true if the array has no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Lends the values directly from the file. `None` if the file stores them differently from
    /// this machine, the values take less than `least_bytes`, or the file cannot be mapped.
    pub(crate) fn lent(&self, least_bytes: u64) -> Option<lumistack_core::Lender> {
        let is_plain = self.scalar == Scalar::F32 && !self.big_endian;
        let is_large = 4 * self.len() as u64 >= least_bytes;
        (is_plain && is_large).then(|| crate::mapped::lend(self.file.get_ref(), self.data_start, self.len())).flatten()
    }

    /// Reads `values.len()` values from index `start` on; code values are scaled to 0..1.
    ///
    /// # Errors
    /// If the file cannot be read or is too short.
    pub fn read_values(&mut self, start: usize, values: &mut [f32]) -> Result<(), FieldError> {
        self.fill(start, values).map_err(FieldError::io(&self.path, "read"))
    }

    fn fill(&mut self, start: usize, values: &mut [f32]) -> io::Result<()> {
        let width = self.scalar.bytes();
        self.file.seek(SeekFrom::Start(self.data_start + (start * width) as u64))?;
        let mut bytes = vec![0; width * CHUNK.min(values.len())];
        for chunk in values.chunks_mut(CHUNK) {
            let bytes = &mut bytes[..width * chunk.len()];
            self.file.read_exact(bytes)?;
            for (value, bytes) in chunk.iter_mut().zip(bytes.chunks_exact_mut(width)) {
                if self.big_endian {
                    bytes.reverse();
                }
                *value = self.scalar.value(bytes);
            }
        }
        Ok(())
    }
}

impl Scalar {
    /// Returns the number of bytes of one value.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::F16 | Self::U16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Returns true for code values of pictures, false for linear light.
    pub fn is_code(self) -> bool {
        matches!(self, Self::U8 | Self::U16)
    }

    fn value(self, le: &[u8]) -> f32 {
        match (self, le) {
            (Self::U8, &[a]) => f32::from(a) / 255.0,
            (Self::U16, &[a, b]) => f32::from(u16::from_le_bytes([a, b])) / 65535.0,
            (Self::F16, &[a, b]) => f16::from_le_bytes([a, b]).to_f32(),
            (Self::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
            (Self::F64, &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]) as f32,
            _ => f32::NAN,
        }
    }
}

/// Returns `count` zeros, or an error if there is too little memory for them.
pub(crate) fn zeros(path: &Path, count: usize) -> Result<Vec<f32>, FieldError> {
    let mut data = reserved(path, count)?;
    data.resize(count, 0.0);
    Ok(data)
}

/// Returns an empty vector with a capacity of `count` values, or an error if there is too little
/// memory.
pub(crate) fn reserved(path: &Path, count: usize) -> Result<Vec<f32>, FieldError> {
    let mut data = Vec::new();
    if data.try_reserve_exact(count).is_err() {
        let found = format!("{:.1} GB", count as f64 * 4e-9);
        return Err(FieldError::malformed(path, "size", "an array that fits in memory", found));
    }
    Ok(data)
}

/// Parses a header. First checks properties that the parser of the library assumes: lengths, depth
/// of brackets, and no overflow.
fn read_header(path: &Path, file: &mut impl Read) -> Result<(NpyHeader, u64), FieldError> {
    let bad = |expected: &str, found: String| FieldError::malformed(path, "header", expected, found);
    let short = |_| bad("a NumPy array (.npy)", "a file that ends within the header".into());
    let mut bytes = vec![0; 10];
    file.read_exact(&mut bytes).map_err(short)?;
    if !bytes.starts_with(b"\x93NUMPY") {
        return Err(bad("a NumPy array (.npy)", "a file of another format".into()));
    }
    let mut length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    if bytes[6] > 1 {
        let mut upper = [0; 2];
        file.read_exact(&mut upper).map_err(short)?;
        bytes.extend(upper);
        length |= usize::from(u16::from_le_bytes(upper)) << 16;
    }
    if length > HEADER_LIMIT {
        return Err(bad(&format!("at most {HEADER_LIMIT} bytes"), format!("{length} bytes")));
    }
    let text_start = bytes.len();
    bytes.resize(text_start + length, 0);
    file.read_exact(&mut bytes[text_start..]).map_err(short)?;
    let text = &bytes[text_start..];
    let count = |wanted: fn(&u8) -> bool| text.iter().copied().filter(wanted).count();
    if count(u8::is_ascii_digit) > DIGIT_LIMIT || count(|byte| b"([{".contains(byte)) > 4 {
        let expected = "one plain array of numbers that fits in memory";
        return Err(bad(expected, String::from_utf8_lossy(text).trim().chars().take(120).collect()));
    }
    let header = NpyHeader::from_reader(bytes.as_slice()).map_err(|error| bad("a NumPy header", error.to_string()))?;
    Ok((header, bytes.len() as u64))
}

fn scalar_type(path: &Path, dtype: &DType) -> Result<(Scalar, bool), FieldError> {
    let found = match dtype {
        DType::Plain(plain) => {
            let scalar = match (plain.type_char(), plain.size_field()) {
                (TypeChar::Float, 2) => Some(Scalar::F16),
                (TypeChar::Float, 4) => Some(Scalar::F32),
                (TypeChar::Float, 8) => Some(Scalar::F64),
                (TypeChar::Uint, 1) => Some(Scalar::U8),
                (TypeChar::Uint, 2) => Some(Scalar::U16),
                _ => None,
            };
            if let Some(scalar) = scalar {
                return Ok((scalar, plain.endianness() == Endianness::Big));
            }
            plain.to_string()
        }
        other => other.descr(),
    };
    Err(FieldError::malformed(path, "descr", "float16, float32, float64, uint8 or uint16", found))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn read_bytes(bytes: &[u8]) -> Result<(Vec<usize>, Vec<f32>), FieldError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        std::fs::write(&path, bytes).unwrap();
        read(&path)
    }

    #[test]
    fn every_type_and_byte_order_is_read() {
        for (descr, data) in [
            ("<f2", f16::from_f32(0.5).to_le_bytes().to_vec()),
            (">f2", f16::from_f32(0.5).to_be_bytes().to_vec()),
            ("<f4", 0.5f32.to_le_bytes().to_vec()),
            (">f4", 0.5f32.to_be_bytes().to_vec()),
            ("<f8", 0.5f64.to_le_bytes().to_vec()),
            (">f8", 0.5f64.to_be_bytes().to_vec()),
        ] {
            let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (1, 1), }}\n");
            assert_eq!(read_bytes(&file(&header, &data)).unwrap(), (vec![1, 1], vec![0.5]), "{descr}");
        }
        let codes = file("{'descr': '|u1', 'fortran_order': False, 'shape': (2,), }", &[0, 255]);
        assert_eq!(read_bytes(&codes).unwrap().1, [0.0, 1.0]);
        let codes = file("{'descr': '>u2', 'fortran_order': False, 'shape': (2,), }", &[255, 255, 0, 0]);
        assert_eq!(read_bytes(&codes).unwrap().1, [1.0, 0.0]);
    }

    #[test]
    fn hostile_headers_are_errors() {
        let header = |descr: &str, order: &str, shape: &str| {
            file(&format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}"), &[0; 64])
        };
        for (bytes, message) in [
            (header("'<f4'", "True", "(2, 2)"), "fortran_order: expected False"),
            (header("'<i4'", "False", "(2, 2)"), "descr: expected float16"),
            (header("'|O'", "False", "(2, 2)"), "descr: expected float16"),
            (header("[('a', '<f4')]", "False", "(2, 2)"), "descr: expected float16"),
            (header("'<f4'", "False", "(4294967296, 4294967296)"), "header: expected one plain array"),
            (header("'<f4'", "False", "(99999999, 99999999)"), "expected 39999999200000004 bytes"),
            (header("'<f4'", "False", "(((((((2,)))))))"), "header: expected one plain array"),
            (header("'<f4'", "False", "(-2, 2)"), "header: expected a NumPy header"),
            (header("'<f4'", "False", "(5, 5)"), "expected 100 bytes, found 64"),
            (b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec(), "header: expected at most 65536 bytes"),
            (b"PK\x03\x04 not an array".to_vec(), "header: expected a NumPy array"),
            (vec![], "found a file that ends within the header"),
        ] {
            let error = read_bytes(&bytes).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
