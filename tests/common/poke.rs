//! Keys and a pointer for an X server that has none: what of the X protocol and its extension XTEST is needed for that, written out.
//!
//! Source: X Window System Protocol, version 11, encoding; X Test Extension Protocol.

#![allow(dead_code, reason = "every test file uses a part of this")]

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;

/// Keycode of Escape on a PC's keyboard.
pub const ESCAPE: u8 = 9;

/// A connection whose requests look like a person.
pub struct Poke {
    stream: UnixStream,
    root: u32,
    xtest: u8,
}

impl Poke {
    /// Connects to a server, by its number.
    pub fn new(display: u32) -> Self {
        let mut stream = UnixStream::connect(format!("/tmp/.X11-unix/X{display}")).unwrap();
        // little endian, protocol 11.0, no authorization
        stream.write_all(&[b'l', 0, 11, 0, 0, 0, 0, 0, 0, 0, 0, 0]).unwrap();
        let mut head = [0; 8];
        stream.read_exact(&mut head).unwrap();
        assert_eq!(head[0], 1, "refused");
        let mut setup = vec![0; 4 * usize::from(u16::from_le_bytes([head[6], head[7]]))];
        stream.read_exact(&mut setup).unwrap();
        let vendor = usize::from(u16::from_le_bytes([setup[16], setup[17]])).next_multiple_of(4);
        // after the vendor's name and the pixmap formats comes the first screen, and its root first
        let at = 32 + vendor + 8 * usize::from(setup[21]);
        let root = u32::from_le_bytes(setup[at..at + 4].try_into().unwrap());
        let mut poke = Self { stream, root, xtest: 0 };
        // QueryExtension
        let answer = poke.ask(&[&[98, 0, 4, 0, 5, 0, 0, 0], &b"XTEST\0\0\0"[..]].concat());
        assert_eq!(answer[8], 1, "no XTEST");
        poke.xtest = answer[9];
        poke
    }

    /// Puts the pointer somewhere on the screen.
    pub fn point(&mut self, [x, y]: [i16; 2]) {
        self.fake(6, 0, [x, y]);
    }

    /// Presses a key and lets it go.
    pub fn key(&mut self, code: u8) {
        self.fake(2, code, [0, 0]);
        self.fake(3, code, [0, 0]);
    }

    /// FakeInput, and a question behind it: when its answer is there, the input has come.
    fn fake(&mut self, kind: u8, detail: u8, [x, y]: [i16; 2]) {
        let mut request = vec![self.xtest, 2, 9, 0, kind, detail, 0, 0, 0, 0, 0, 0];
        request.extend_from_slice(&self.root.to_le_bytes());
        request.extend_from_slice(&[0; 8]);
        request.extend([x, y].into_iter().flat_map(i16::to_le_bytes));
        request.extend_from_slice(&[0; 8]);
        self.stream.write_all(&request).unwrap();
        // GetInputFocus
        self.ask(&[43, 0, 1, 0]);
    }

    fn ask(&mut self, request: &[u8]) -> [u8; 32] {
        self.stream.write_all(request).unwrap();
        let mut answer = [0; 32];
        self.stream.read_exact(&mut answer).unwrap();
        // events that every client gets, such as another map of keys
        while answer[0] > 1 {
            self.stream.read_exact(&mut answer).unwrap();
        }
        assert_eq!(answer[0], 1, "an error: {answer:?}");
        answer
    }
}
