//! Reads arrays from Python, and exports arrays to Python, without NumPy.
//!
//! Arrays are read through the buffer protocol, or else through `__array__` or DLPack. Arrays are
//! exported through the buffer protocol. Row-major, aligned `float32` is used without a copy. Other
//! layouts, byte orders, `float16` and `float64` are copied. `uint8` and `uint16` are sRGB codes,
//! as in pictures, and become linear. Other types are refused.
//!
//! An [`Array`] exports its values read-only. The values exist as long as a buffer refers to them.

use std::ffi::{CString, c_int};
use std::sync::Arc;

use lumistack_core::{Lender, Tensor, colour};
use lumistack_display::{LayerStack, LightField};
use pyo3::buffer::PyUntypedBuffer;
use pyo3::exceptions::{PyBufferError, PyImportError, PyTypeError};
use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::types::PySequence;

use crate::own::in_package;

/// Values from Python, row-major.
pub(crate) struct Values {
    pub(crate) shape: Vec<usize>,
    data: Data,
}

enum Data {
    Own(Vec<f32>),
    Lent(Lender),
}

impl Values {
    /// Reads the values of a Python object. Error messages name the object by `what`.
    pub(crate) fn read(object: &Bound<'_, PyAny>, what: &str) -> PyResult<Self> {
        let py = object.py();
        let mut object = object.clone();
        // Find the protocol that the object supports.
        let mut buffer = PyUntypedBuffer::get(&object);
        if buffer.is_err() && object.hasattr("__array__")? {
            object = object.call_method0("__array__")?;
            buffer = PyUntypedBuffer::get(&object);
        } else if buffer.is_err() && object.hasattr("__dlpack__")? {
            object = in_package(py, "_arrays", "from_dlpack", (&object, what), None)?;
            buffer = PyUntypedBuffer::get(&object);
        }
        let Ok(buffer) = buffer else {
            let found = object.get_type().name()?;
            let remedy = if object.cast::<PySequence>().is_ok() { "; numpy.asarray(...) makes an array" } else { "" };
            return Err(PyTypeError::new_err(format!("{what}: expected an array of floats, found {found}{remedy}")));
        };
        // Check type and shape.
        let scalar = Scalar::of(&buffer).ok_or_else(|| {
            let named = object.getattr("dtype").and_then(|dtype| Ok(dtype.str()?.to_string()));
            let found = named.unwrap_or_else(|_| format!("format `{}`", buffer.format().to_string_lossy()));
            let expected = "float32, float64 or float16, or uint8 or uint16 for sRGB code values";
            PyTypeError::new_err(format!("{what}: expected an array of {expected}, found {found}"))
        })?;
        if buffer.suboffsets().is_some() {
            return Err(PyTypeError::new_err(format!(
                "{what}: expected an array without suboffsets, found an array of pointers (with suboffsets)"
            )));
        }
        let shape = buffer.shape().to_vec();
        // Use the memory itself if it has the layout of a tensor, and copy it otherwise.
        if scalar == Scalar::NATIVE && buffer.is_c_contiguous() && buffer.buf_ptr().cast::<f32>().is_aligned() {
            return Ok(Self { shape, data: Data::Lent(Arc::new(Borrowed(buffer))) });
        }
        let data = py.detach(|| copied(&buffer, scalar));
        Ok(Self { shape, data: Data::Own(data) })
    }

    /// Returns the values as a tensor with named axes.
    pub(crate) fn tensor<const N: usize>(self, what: &str, axes: [&'static str; N]) -> PyResult<Tensor<N>> {
        let shape: [usize; N] = self.shape.as_slice().try_into().map_err(|_| {
            let axes = axes.join(", ");
            PyTypeError::new_err(format!(
                "{what}: expected an array with the axes [{axes}], found an array of shape {:?}",
                self.shape
            ))
        })?;
        let tensor = match self.data {
            Data::Own(data) => Tensor::from_vec(axes, shape, data),
            Data::Lent(lender) => Tensor::lent(axes, shape, lender),
        };
        tensor.map_err(|error| PyTypeError::new_err(format!("{what}: {error}")))
    }

    pub(crate) fn into_parts(self) -> (Vec<usize>, Vec<f32>) {
        let data = match self.data {
            Data::Own(data) => data,
            Data::Lent(lender) => lender.values().to_vec(),
        };
        (self.shape, data)
    }
}

/// A buffer of aligned, row-major `f32`.
struct Borrowed(PyUntypedBuffer);

impl AsRef<[f32]> for Borrowed {
    fn as_ref(&self) -> &[f32] {
        if self.0.item_count() == 0 {
            return &[];
        }
        // SAFETY: the exporter keeps memory, shape and address of a buffer while it is held.
        // `Values::read` has checked that its format is `f32`, row-major and aligned. The
        // documentation of `LightField` and `LayerStack` forbids writing to it during that time.
        unsafe { std::slice::from_raw_parts(self.0.buf_ptr().cast::<f32>(), self.0.item_count()) }
    }
}

/// Type of the values, and a flag for a byte order that is the reverse of this machine's.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Scalar {
    kind: Kind,
    swapped: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    F16,
    F32,
    F64,
    U8,
    U16,
}

impl Scalar {
    const NATIVE: Self = Self { kind: Kind::F32, swapped: false };

    fn of(buffer: &PyUntypedBuffer) -> Option<Self> {
        let (order, code) = match buffer.format().to_bytes() {
            [code] => (b'@', *code),
            [order, code] => (*order, *code),
            _ => return None,
        };
        let (kind, bytes) = match code {
            b'e' => (Kind::F16, 2),
            b'f' => (Kind::F32, 4),
            b'd' => (Kind::F64, 8),
            b'B' => (Kind::U8, 1),
            b'H' => (Kind::U16, 2),
            _ => return None,
        };
        let swapped = match order {
            b'@' | b'=' => false,
            b'<' => cfg!(target_endian = "big"),
            b'>' | b'!' => cfg!(target_endian = "little"),
            _ => return None,
        };
        (buffer.item_size() == bytes).then_some(Self { kind, swapped })
    }
}

/// Copies every value in row-major order as `f32`.
fn copied(buffer: &PyUntypedBuffer, scalar: Scalar) -> Vec<f32> {
    let mut out = Vec::with_capacity(buffer.item_count());
    match scalar.kind {
        Kind::F16 => each(buffer, scalar.swapped, |bytes| out.push(half(u16::from_ne_bytes(bytes)))),
        Kind::F32 => each(buffer, scalar.swapped, |bytes| out.push(f32::from_ne_bytes(bytes))),
        Kind::F64 => each(buffer, scalar.swapped, |bytes| out.push(f64::from_ne_bytes(bytes) as f32)),
        Kind::U8 => {
            let light: Vec<f32> = (0..=255u8).map(|code| colour::srgb_decode(f32::from(code) / 255.0)).collect();
            each(buffer, false, |[code]: [u8; 1]| out.push(light[usize::from(code)]));
        }
        Kind::U16 => {
            let light = |code| colour::srgb_decode(f32::from(code) / 65535.0);
            each(buffer, scalar.swapped, |bytes| out.push(light(u16::from_ne_bytes(bytes))));
        }
    }
    out
}

/// Calls `take` with the bytes of every item, in row-major order.
fn each<const BYTES: usize>(buffer: &PyUntypedBuffer, swapped: bool, mut take: impl FnMut([u8; BYTES])) {
    if buffer.item_count() == 0 {
        return;
    }
    // Join axes that are contiguous, so that the innermost loop is long.
    let mut axes: Vec<(usize, isize)> = Vec::new();
    for (&count, &stride) in buffer.shape().iter().zip(buffer.strides()) {
        match axes.last_mut() {
            Some(outer) if outer.1 == count as isize * stride => *outer = (outer.0 * count, stride),
            _ => axes.push((count, stride)),
        }
    }
    walk(buffer.buf_ptr().cast::<u8>(), &axes, &mut |item| {
        // SAFETY: every index of the shape has an item of `BYTES` bytes at the sum of index times
        // stride. The item may be misaligned.
        let mut bytes = unsafe { item.cast::<[u8; BYTES]>().read_unaligned() };
        if swapped {
            bytes.reverse();
        }
        take(bytes);
    });
}

/// Calls `take` with the address of every item of the array that begins at `place` and has these
/// axes (length and stride, outermost first).
fn walk(place: *const u8, axes: &[(usize, isize)], take: &mut impl FnMut(*const u8)) {
    match axes {
        [] => take(place),
        [(count, stride)] => (0..*count as isize).for_each(|i| take(place.wrapping_offset(i * stride))),
        [(count, stride), inner @ ..] => {
            (0..*count as isize).for_each(|i| walk(place.wrapping_offset(i * stride), inner, take));
        }
    }
}

/// Converts a half float (IEEE 754 binary16) exactly.
fn half(bits: u16) -> f32 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    sign * match exponent {
        0 => fraction * 2f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1.0 + fraction / 1024.0) * 2f32.powi(exponent - 15),
    }
}

/// Values to export: an object that owns them, and the part of the object that contains them.
#[derive(Clone)]
pub(crate) enum Part {
    Field(Arc<LightField>),
    Layer(Arc<LayerStack>, usize),
    Emission(Arc<LayerStack>),
    Picture(Arc<Tensor<3>>),
    Weights(Arc<Tensor<4>>),
    /// Values of any shape.
    Values(Vec<usize>, Arc<[f32]>),
    /// Values of any shape that another object also uses.
    Shared(Vec<usize>, Arc<Vec<f32>>),
}

impl Part {
    fn data(&self) -> &[f32] {
        match self {
            Self::Field(field) => field.radiance().data(),
            Self::Layer(stack, n) => stack.layers[*n].data(),
            Self::Emission(stack) => stack.emission.as_ref().map_or(&[], Tensor::data),
            Self::Picture(picture) => picture.data(),
            Self::Weights(weights) => weights.data(),
            Self::Values(_, values) => values,
            Self::Shared(_, values) => values,
        }
    }

    fn shape(&self) -> Vec<usize> {
        match self {
            Self::Field(field) => field.radiance().shape().to_vec(),
            Self::Layer(stack, n) => stack.layers[*n].shape().to_vec(),
            Self::Emission(stack) => stack.emission.as_ref().map_or(vec![0], |emission| emission.shape().to_vec()),
            Self::Picture(picture) => picture.shape().to_vec(),
            Self::Weights(weights) => weights.shape().to_vec(),
            Self::Values(shape, _) | Self::Shared(shape, _) => shape.clone(),
        }
    }
}

/// Read-only values with the buffer protocol: numpy.asarray(a) and memoryview(a) copy nothing.
#[pyclass(frozen, module = "lumistack")]
pub(crate) struct Array {
    part: Part,
    /// Lengths of the axes, in the type of the buffer protocol. Exported buffers point to this
    /// vector and to `strides`.
    shape: Vec<isize>,
    strides: Vec<isize>,
}

impl Array {
    pub(crate) fn new(part: Part) -> Self {
        let shape: Vec<isize> = part.shape().iter().map(|&n| n as isize).collect();
        let mut strides = vec![size_of::<f32>() as isize; shape.len()];
        for axis in (1..shape.len()).rev() {
            strides[axis - 1] = strides[axis] * shape[axis];
        }
        Self { part, shape, strides }
    }

    /// Returns a NumPy array that uses the same memory.
    pub(crate) fn numpy(py: Python<'_>, part: Part) -> PyResult<Bound<'_, PyAny>> {
        let numpy = py.import("numpy").map_err(|error| {
            let message = "expected the package numpy, since results are NumPy arrays, found none; `pip install numpy` installs numpy";
            let new = PyImportError::new_err(message);
            new.set_cause(py, Some(error));
            new
        })?;
        numpy.call_method1("asarray", (Bound::new(py, Self::new(part))?,))
    }
}

#[pymethods]
impl Array {
    /// Lengths of the axes.
    #[getter]
    fn shape(&self) -> Vec<usize> {
        self.part.shape()
    }

    fn __repr__(&self) -> String {
        format!("<lumistack.Array {:?} float32>", self.shape)
    }

    unsafe fn __getbuffer__(slf: Bound<'_, Self>, view: *mut ffi::Py_buffer, flags: c_int) -> PyResult<()> {
        let this = slf.get();
        if view.is_null() {
            return Err(PyBufferError::new_err("the caller provides no `Py_buffer`"));
        }
        if flags & ffi::PyBUF_WRITABLE == ffi::PyBUF_WRITABLE {
            return Err(PyBufferError::new_err("the array is read-only"));
        }
        if flags & ffi::PyBUF_F_CONTIGUOUS == ffi::PyBUF_F_CONTIGUOUS && this.shape.len() > 1 {
            return Err(PyBufferError::new_err("the array is in row-major order"));
        }
        let data = this.part.data();
        let wanted = |flag: c_int| flags & flag == flag;
        let format = if wanted(ffi::PyBUF_FORMAT) { CString::new("f")?.into_raw() } else { std::ptr::null_mut() };
        let strides = this.strides.as_ptr().cast_mut();
        // SAFETY: the caller provides `view`. Values, shape and strides belong to a frozen object,
        // and `obj` keeps it alive until the buffer is released. The protocol forbids writing to
        // them. `__releasebuffer__` frees the format.
        unsafe {
            (*view).buf = data.as_ptr().cast_mut().cast();
            (*view).len = size_of_val(data) as isize;
            (*view).itemsize = size_of::<f32>() as isize;
            (*view).readonly = 1;
            (*view).ndim = this.shape.len() as c_int;
            (*view).format = format;
            (*view).shape = if wanted(ffi::PyBUF_ND) { this.shape.as_ptr().cast_mut() } else { std::ptr::null_mut() };
            (*view).strides = if wanted(ffi::PyBUF_STRIDES) { strides } else { std::ptr::null_mut() };
            (*view).suboffsets = std::ptr::null_mut();
            (*view).internal = std::ptr::null_mut();
            (*view).obj = slf.into_any().into_ptr();
        }
        Ok(())
    }

    unsafe fn __releasebuffer__(&self, view: *mut ffi::Py_buffer) {
        // SAFETY: `__getbuffer__` allocated the format or left it null
        unsafe {
            if !(*view).format.is_null() {
                drop(CString::from_raw((*view).format));
            }
        }
    }
}
