//! Normalizes the lines of OBJ and MTL files for the OBJ parser of the crate `tobj`, which accepts
//! fewer forms than programs write.
//!
//! A backslash at the end of a line continues the line, and `#` begins a comment. Names and
//! comments may have any encoding, and `vt` may have a single coordinate. Faces may refer to
//! vertices that do not exist. The parser refuses such faces, but for some of these indices its
//! arithmetic would overflow. So this module replaces these indices by an index that the parser
//! refuses without an overflow.

use std::borrow::Cow;
use std::cell::Cell;
use std::io::{self, BufRead, Read};
use std::rc::Rc;

/// Decodes the text of a file. Lines that are not UTF-8 are decoded as Latin-1, so that different
/// names remain different.
pub(crate) fn decode(bytes: &[u8]) -> Cow<'_, str> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        return Cow::Borrowed(text);
    }
    let line = |line: &[u8]| match std::str::from_utf8(line) {
        Ok(text) => text.to_owned(),
        Err(_) => line.iter().map(|&byte| char::from(byte)).collect(),
    };
    Cow::Owned(bytes.split_inclusive(|&byte| byte == b'\n').map(line).collect())
}

/// Joins every line with the lines that continue it. Each item is the number of the first line and
/// the joined text.
pub(crate) fn joined(text: &str) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    let mut lines = text.lines().enumerate();
    std::iter::from_fn(move || {
        let (number, line) = lines.next()?;
        // A comment may end with a Windows path, whose last backslash does not continue the line.
        if line.trim_start().starts_with('#') {
            return Some((number + 1, Cow::Borrowed(line)));
        }
        let mut line = Cow::Borrowed(line);
        while let Some(before) = line.trim_end().strip_suffix('\\') {
            let Some((_, next)) = lines.next() else { break };
            line = Cow::Owned(format!("{before} {next}"));
        }
        Some((number + 1, line))
    })
}

/// A reader of an OBJ file's normalized lines, for the parser of the crate `tobj`.
/// [`line`](Self::line) returns the number of the current line, for error messages.
pub(crate) struct Shapes<'a> {
    lines: Box<dyn Iterator<Item = (usize, Cow<'a, str>)> + 'a>,
    current: Vec<u8>,
    at: usize,
    line: Rc<Cell<usize>>,
    counts: Counts,
}

/// Counts of the positions, texture coordinates and normals that were read so far. A negative index
/// counts back from the last element read.
type Counts = [i64; 3];

/// The keys of the lines that [`Counts`] counts, in the order of the indices of a face's corner.
const COUNTED: [&str; 3] = ["v", "vt", "vn"];

/// An index that is out of range in every file, so that the parser reports an error.
const NOWHERE: i64 = u32::MAX as i64;

impl<'a> Shapes<'a> {
    pub(crate) fn of(text: &'a str) -> Self {
        Self { lines: Box::new(joined(text)), current: Vec::new(), at: 0, line: Rc::default(), counts: [0; 3] }
    }

    /// Returns the number of the line that was read last.
    pub(crate) fn line(&self) -> Rc<Cell<usize>> {
        self.line.clone()
    }
}

impl Read for Shapes<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(out)?;
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for Shapes<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.at == self.current.len() {
            self.current.clear();
            self.at = 0;
            if let Some((number, line)) = self.lines.next() {
                self.line.set(number);
                write_shape(&line, &mut self.counts, &mut self.current);
                self.current.push(b'\n');
            }
        }
        Ok(&self.current[self.at..])
    }

    fn consume(&mut self, count: usize) {
        self.at += count;
    }
}

fn write_shape(line: &str, counts: &mut Counts, out: &mut Vec<u8>) {
    let line = line.trim();
    let (key, rest) = line.split_once(|c: char| c.is_whitespace()).unwrap_or((line, ""));
    match key {
        "v" | "vt" | "vn" | "f" | "l" | "p" => {
            // In a line of numbers `#` begins a comment. In a line with a name it may be part of
            // the name.
            let numbers = rest.split('#').next().unwrap_or_default().trim();
            out.extend(key.bytes());
            out.push(b' ');
            match key {
                "f" => numbers.split_whitespace().for_each(|corner| write_corner(corner, counts, out)),
                _ => out.extend(numbers.bytes()),
            }
            if let Some(place) = COUNTED.iter().position(|counted| *counted == key) {
                counts[place] += 1;
            }
            if key == "vt" && numbers.split_whitespace().count() == 1 {
                out.extend(b" 0");
            }
        }
        _ => {
            out.extend(key.bytes());
            out.push(b' ');
            out.extend(rest.trim().bytes());
        }
    }
}

/// Writes the indices `v/vt/vn` of a face's corner. An index that counts back too far, or exceeds
/// [`NOWHERE`], becomes [`NOWHERE`].
fn write_corner(corner: &str, counts: &Counts, out: &mut Vec<u8>) {
    for (place, index) in corner.split('/').enumerate() {
        if place > 0 {
            out.push(b'/');
        }
        let count = counts.get(place).copied().unwrap_or(0);
        match index.parse::<i64>() {
            Ok(number) if number < -count || number > NOWHERE => out.extend(NOWHERE.to_string().bytes()),
            _ => out.extend(index.bytes()),
        }
    }
    out.push(b' ');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_brought_into_one_form() {
        let bytes = b"\xEF\xBB\xBFvt 0.5\nvt 0.5 1 # a note\nf 1/1 2/2 \\\n 3/3\nusemtl\tn\xE4me #1\nv 1 2 3\n";
        let text = decode(bytes);
        let mut shapes = Shapes::of(&text);
        let line = shapes.line();
        let mut found = String::new();
        shapes.read_to_string(&mut found).unwrap();
        assert_eq!(found, "vt 0.5 0\nvt 0.5 1\nf 1/1 2/2 3/3 \nusemtl n\u{e4}me #1\nv 1 2 3\n");
        assert_eq!(line.get(), 6);
    }
}
