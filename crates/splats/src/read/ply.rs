//! `.ply` files, as the reference trainers write them, and PlayCanvas' compressed form of them.
//!
//! ```text
//! trainers' form
//! element vertex   x y z  f_dc_0..2  f_rest_0..44 (by channel)  opacity (logit)
//!                  scale_0..2 (logarithms)  rot_0..3 (w x y z)
//!
//! compressed form, with the bits of each component
//! element chunk    min_x ... max_b, the bounds of 256 splats per row
//! element vertex   packed_position (11 10 11)  packed_rotation (2 10 10 10)
//!                  packed_scale (11 10 11)  packed_color (8 8 8 8)
//! element sh       f_rest_0..44 as bytes, −4..4
//! ```

use glam::{Quat, Vec3};

use super::found::{Axes, Found, ReadError, cloud, constant, degree_of, exp, from_smallest_three, sigmoid};

/// Largest size of a header in bytes; the end of the header is searched only within these bytes.
const MAX_HEADER: usize = 1 << 16;
/// Number of splats per chunk of the compressed form.
const CHUNK: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

struct Property {
    name: String,
    kind: Kind,
    offset: usize,
}

/// An element of the file, which is a table of rows with named properties.
struct Element<'a> {
    name: String,
    count: usize,
    stride: usize,
    properties: Vec<Property>,
    rows: &'a [u8],
}

/// One property of an element, in all of its rows.
#[derive(Clone, Copy)]
struct Column<'a> {
    rows: &'a [u8],
    stride: usize,
    offset: usize,
    kind: Kind,
}

impl Column<'_> {
    fn bytes<const N: usize>(&self, row: usize) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.copy_from_slice(&self.rows[row * self.stride + self.offset..][..N]);
        bytes
    }

    fn float(&self, row: usize) -> f32 {
        match self.kind {
            Kind::I8 => f32::from(i8::from_le_bytes(self.bytes(row))),
            Kind::U8 => f32::from(u8::from_le_bytes(self.bytes(row))),
            Kind::I16 => f32::from(i16::from_le_bytes(self.bytes(row))),
            Kind::U16 => f32::from(u16::from_le_bytes(self.bytes(row))),
            Kind::I32 => i32::from_le_bytes(self.bytes(row)) as f32,
            Kind::U32 => u32::from_le_bytes(self.bytes(row)) as f32,
            Kind::F32 => f32::from_le_bytes(self.bytes(row)),
            Kind::F64 => f64::from_le_bytes(self.bytes(row)) as f32,
        }
    }
}

impl<'a> Element<'a> {
    fn find(&self, name: &str) -> Option<Column<'a>> {
        let property = self.properties.iter().find(|property| property.name == name)?;
        Some(Column { rows: self.rows, stride: self.stride, offset: property.offset, kind: property.kind })
    }

    fn column(&self, name: &str) -> Result<Column<'a>, ReadError> {
        self.find(name).ok_or_else(|| {
            let names: Vec<&str> = self.properties.iter().map(|property| property.name.as_str()).take(20).collect();
            // a mesh or a point cloud has x, y and z, so f_dc_0 is the first property that it lacks
            let hint = if name == "f_dc_0" { " (a mesh or a point cloud lacks it)" } else { "" };
            let expected = format!("a property {name}, which this form of splat file requires{hint}");
            ReadError::new(format!("element {}", self.name), expected, names.join(" "))
        })
    }

    fn columns<const N: usize>(&self, names: [&str; N]) -> Result<[Column<'a>; N], ReadError> {
        let found: Vec<_> = names.iter().map(|name| self.column(name)).collect::<Result<_, _>>()?;
        found.try_into().map_err(|_| ReadError::new(&self.name, "columns", "others"))
    }

    fn words(&self, name: &str) -> Result<Column<'a>, ReadError> {
        let column = self.column(name)?;
        if column.kind == Kind::U32 {
            return Ok(column);
        }
        Err(ReadError::new(
            format!("element {}, property {name}", self.name),
            "the type uint",
            "another type of number",
        ))
    }

    /// Returns the columns `f_rest_0`, `f_rest_1`, …, and the degree of the harmonics that they
    /// hold.
    fn rest(&self) -> Result<(Vec<Column<'a>>, usize), ReadError> {
        let rest: Vec<Column<'a>> = (0..).map_while(|i| self.find(&format!("f_rest_{i}"))).take(73).collect();
        let degree = rest.len().is_multiple_of(3).then(|| degree_of(rest.len() / 3)).flatten();
        let degree = degree.ok_or_else(|| {
            ReadError::new(format!("element {}", self.name), "0, 9, 24 or 45 properties f_rest_N", rest.len())
        })?;
        Ok((rest, degree))
    }
}

pub(super) fn read(bytes: &[u8]) -> Result<Found, ReadError> {
    let elements = elements(bytes)?;
    let element = |name: &str| elements.iter().find(|element| element.name == name);
    let vertices = element("vertex").ok_or_else(|| ReadError::new("header", "an element vertex", "none"))?;
    let found = |cloud| Found { cloud, axes: Axes::RightDownFront, left_out: Vec::new() };
    match element("chunk") {
        Some(chunks) if vertices.find("packed_position").is_some() => {
            packed(chunks, vertices, element("sh")).map(found)
        }
        _ => plain(vertices).map(found),
    }
}

fn plain(vertices: &Element<'_>) -> Result<lumistack_scene::Cloud, ReadError> {
    let position = vertices.columns(["x", "y", "z"])?;
    let base = vertices.columns(["f_dc_0", "f_dc_1", "f_dc_2"])?;
    let opacity = vertices.column("opacity")?;
    let scale = vertices.columns(["scale_0", "scale_1"])?;
    // flat splats have only two scales, so the third is optional
    let thickness = vertices.find("scale_2");
    let rotation = vertices.columns(["rot_0", "rot_1", "rot_2", "rot_3"])?;
    let (rest, degree) = vertices.rest()?;
    let mut cloud = cloud("element vertex", vertices.count, degree);
    for i in 0..vertices.count {
        // Read a row per splat. Positions and rotations are stored as they are, scales as
        // logarithms, and opacities as logits.
        cloud.positions.push(Vec3::from(position.map(|column| column.float(i))));
        let [w, x, y, z] = rotation.map(|column| column.float(i));
        cloud.rotations.push(Quat::from_xyzw(x, y, z, w));
        let [a, b] = scale.map(|column| column.float(i));
        let c = thickness.map_or(f32::NEG_INFINITY, |column| column.float(i));
        cloud.scales.push(exp(Vec3::new(a, b, c)));
        cloud.opacities.push(sigmoid(opacity.float(i)));
        cloud.harmonics.extend(base.map(|column| column.float(i)));
        let count = rest.len() / 3;
        for coefficient in 0..count {
            cloud.harmonics.extend([0, 1, 2].map(|channel| rest[channel * count + coefficient].float(i)));
        }
    }
    Ok(cloud)
}

/// Returns `count` bits from bit `shift` on, scaled to 0..1.
fn unit(word: u32, shift: u32, count: u32) -> f32 {
    let most = (1u32 << count) - 1;
    (word >> shift & most) as f32 / most as f32
}

fn packed(
    chunks: &Element<'_>,
    vertices: &Element<'_>,
    sh: Option<&Element<'_>>,
) -> Result<lumistack_scene::Cloud, ReadError> {
    if chunks.count < vertices.count.div_ceil(CHUNK) {
        let expected = format!("at least {}, the number of chunks of {CHUNK} splats", vertices.count.div_ceil(CHUNK));
        return Err(ReadError::new("element chunk", expected, chunks.count));
    }
    // Each chunk holds the bounds of its quantized splats.
    let low = chunks.columns(["min_x", "min_y", "min_z"])?;
    let high = chunks.columns(["max_x", "max_y", "max_z"])?;
    let least = chunks.columns(["min_scale_x", "min_scale_y", "min_scale_z"])?;
    let most = chunks.columns(["max_scale_x", "max_scale_y", "max_scale_z"])?;
    // an older file stores no bounds of colours, which are then 0 and 1
    let dark = ["min_r", "min_g", "min_b"].map(|name| chunks.find(name));
    let bright = ["max_r", "max_g", "max_b"].map(|name| chunks.find(name));
    let [position, rotation] = [vertices.words("packed_position")?, vertices.words("packed_rotation")?];
    let [scale, colour] = [vertices.words("packed_scale")?, vertices.words("packed_color")?];
    let (rest, degree) = match sh {
        Some(sh) if sh.count == vertices.count => sh.rest()?,
        Some(sh) => {
            return Err(ReadError::new("element sh", format!("{} rows, one for each splat", vertices.count), sh.count));
        }
        None => (Vec::new(), 0),
    };
    // Expand the words of each splat. In a position and in a scale, 11, 10 and 11 bits are x, y and
    // z between the chunk's bounds.
    let word = |column: &Column<'_>, i: usize| u32::from_le_bytes(column.bytes(i));
    let three = |word: u32| [unit(word, 21, 11), unit(word, 11, 10), unit(word, 0, 11)];
    let lerp = |low: f32, high: f32, t: f32| low + t * (high - low);
    let mut cloud = cloud("element vertex", vertices.count, degree);
    for i in 0..vertices.count {
        let chunk = i / CHUNK;
        let between = |low: &[Column<'_>; 3], high: &[Column<'_>; 3], t: [f32; 3]| {
            Vec3::from([0, 1, 2].map(|axis| lerp(low[axis].float(chunk), high[axis].float(chunk), t[axis])))
        };
        cloud.positions.push(between(&low, &high, three(word(&position, i))));
        cloud.scales.push(exp(between(&least, &most, three(word(&scale, i)))));
        let bits = word(&rotation, i);
        // The upper two bits of a rotation are the index of its largest component.
        let rest_of = [20, 10, 0].map(|shift| (unit(bits, shift, 10) - 0.5) * std::f32::consts::SQRT_2);
        let [w, x, y, z] = from_smallest_three(rest_of, (bits >> 30) as usize);
        cloud.rotations.push(Quat::from_xyzw(x, y, z, w));
        let bits = word(&colour, i);
        // Colours and opacities are stored directly, so a colour is converted to a coefficient.
        let rgb = [24, 16, 8].map(|shift| unit(bits, shift, 8));
        cloud.harmonics.extend([0, 1, 2].map(|c| {
            let [low, high] =
                [dark[c].map_or(0.0, |col| col.float(chunk)), bright[c].map_or(1.0, |col| col.float(chunk))];
            constant(lerp(low, high, rgb[c]))
        }));
        cloud.opacities.push(unit(bits, 0, 8));
        let count = rest.len() / 3;
        for coefficient in 0..count {
            cloud.harmonics.extend([0, 1, 2].map(|channel| {
                let value = rest[channel * count + coefficient].float(i);
                // A byte represents the middle of its step, except the lowest and the highest byte,
                // which are exact.
                let share = if value <= 0.0 || value >= 255.0 { value / 255.0 } else { (value + 0.5) / 256.0 };
                8.0 * (share - 0.5)
            }));
        }
    }
    Ok(cloud)
}

/// Reads the header, and splits the data into the rows of its elements. The size of each element is
/// checked.
fn elements(bytes: &[u8]) -> Result<Vec<Element<'_>>, ReadError> {
    // The header is text up to the line `end_header`; the rows follow it.
    let header = &bytes[..bytes.len().min(MAX_HEADER)];
    let end = b"end_header";
    let at = header.windows(end.len()).position(|window| window == end);
    let at = at.ok_or_else(|| ReadError::new("header", "a line end_header", "none"))?;
    let line_end = header[at..].iter().position(|byte| *byte == b'\n');
    let mut rest = &bytes[at + line_end.ok_or_else(|| ReadError::new("header", "a line end", "none"))? + 1..];
    let text = std::str::from_utf8(&header[..at]).map_err(|error| ReadError::new("header", "UTF-8 text", error))?;
    // The offset of a property in a row is the sum of the sizes of the properties in front of it.
    let mut elements: Vec<Element<'_>> = Vec::new();
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["format", "binary_little_endian", ..] => {}
            ["format", other, ..] => return Err(ReadError::new("header", "format binary_little_endian", other)),
            ["element", name, count] => {
                let count = count.parse().ok().filter(|count| *count <= u32::MAX as usize);
                let count = count.ok_or_else(|| ReadError::new("header", "a count of elements", line))?;
                let name = (*name).to_owned();
                elements.push(Element { name, count, stride: 0, properties: Vec::new(), rows: &[] });
            }
            ["property", kind, name] => {
                let kind = Kind::parse(kind).ok_or_else(|| ReadError::new("header", "a type of number", line))?;
                let element = elements.last_mut();
                let element =
                    element.ok_or_else(|| ReadError::new("header", "an element before its properties", line))?;
                element.properties.push(Property { name: (*name).to_owned(), kind, offset: element.stride });
                element.stride += kind.bytes();
            }
            ["property", "list", ..] => {
                return Err(ReadError::new("header", "a .ply of splats, which has no lists", line));
            }
            _ => {}
        }
    }
    // Counts come from the file, so they are checked before any memory is allocated for them.
    for element in &mut elements {
        let size = element.count.checked_mul(element.stride).filter(|size| *size <= rest.len());
        let size = size.ok_or_else(|| {
            let expected = format!("{} rows of {} bytes", element.count, element.stride);
            ReadError::new(
                format!("element {}", element.name),
                expected,
                format!("{} bytes to the end of the file", rest.len()),
            )
        })?;
        (element.rows, rest) = rest.split_at(size);
        if element.stride == 0 {
            element.count = 0;
        }
    }
    Ok(elements)
}
