//! Keys and a pointer for an X server that has none: what of the X protocol and its extension XTEST is needed for that, written out.
//!
//! Source: X Window System Protocol, version 11, encoding; X Test Extension Protocol.

#![allow(dead_code, reason = "every test file uses a part of this")]

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;

/// What is written on a key: a keysym, of which every server has its own keycode.
pub const ESCAPE: u32 = 0xff1b;
pub const TAB: u32 = 0xff09;
pub const S: u32 = 0x73;
pub const UP: u32 = 0xff52;
pub const RIGHT: u32 = 0xff53;
pub const DOWN: u32 = 0xff54;

/// The window that has the keys where none has them.
pub const NOBODY: u32 = 0;
/// The same where the one under the pointer gets them.
pub const POINTER_ROOT: u32 = 1;

/// A connection whose requests look like a person.
pub struct Poke {
    stream: UnixStream,
    pub root: u32,
    /// Number of the first resource that this connection may make.
    first: u32,
    xtest: u8,
    /// The keysym of every keycode from 8 on.
    keys: Vec<u32>,
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
        let number = |at: usize| u32::from_le_bytes(setup[at..at + 4].try_into().unwrap());
        let (root, first) = (number(at), number(4));
        let mut poke = Self { stream, root, first, xtest: 0, keys: Vec::new() };
        // QueryExtension
        let answer = poke.ask(&[&[98, 0, 4, 0, 5, 0, 0, 0], &b"XTEST\0\0\0"[..]].concat());
        assert_eq!(answer[8], 1, "no XTEST");
        poke.xtest = answer[9];
        // GetKeyboardMapping of the keycodes 8 to 255
        let answer = poke.ask(&[101, 0, 2, 0, 8, 248, 0, 0]);
        let mut map = vec![0; 4 * 248 * usize::from(answer[1])];
        poke.stream.read_exact(&mut map).unwrap();
        let first_of = |keysyms: &[u8]| u32::from_le_bytes(keysyms[..4].try_into().unwrap());
        poke.keys = map.chunks_exact(4 * usize::from(answer[1])).map(first_of).collect();
        poke
    }

    /// Puts the pointer somewhere on the screen.
    pub fn point(&mut self, [x, y]: [i16; 2]) {
        self.fake(6, 0, [x, y]);
    }

    /// Presses a key and lets it go.
    pub fn key(&mut self, keysym: u32) {
        let code = 8 + self.keys.iter().position(|known| *known == keysym).expect("a key on the keyboard") as u8;
        self.fake(2, code, [0, 0]);
        self.fake(3, code, [0, 0]);
    }

    /// Gives the keys to a window; when that one goes, nobody has them.
    pub fn focus(&mut self, window: u32) {
        self.say(42, 0, &[window, 0]);
    }

    /// Which window has the keys.
    pub fn focused(&mut self) -> u32 {
        // GetInputFocus
        let answer = self.ask(&[43, 0, 1, 0]);
        u32::from_le_bytes(answer[8..12].try_into().unwrap())
    }

    /// Becomes the window manager, or ceases to be: a client that decides about the root window's children.
    pub fn manage(&mut self, is: bool) {
        // ChangeWindowAttributes: the event mask, with or without SubstructureRedirect
        self.say(2, 0, &[self.root, 1 << 11, u32::from(is) << 20]);
    }

    /// Opens a window of one pixel.
    pub fn window(&mut self) -> u32 {
        // CreateWindow of the root's depth and visual, at 0,0, 1 × 1, without a border; MapWindow
        self.say(1, 0, &[self.first, self.root, 0, 0x1_0001, 0, 0, 0]);
        self.say(8, 0, &[self.first]);
        self.first
    }

    /// Closes it.
    pub fn close(&mut self, window: u32) {
        self.say(4, 0, &[window]);
    }

    /// A request of whole words that has no answer; when this returns it was carried out.
    fn say(&mut self, code: u8, detail: u8, words: &[u32]) {
        let mut request = vec![code, detail, words.len() as u8 + 1, 0];
        request.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        self.stream.write_all(&request).unwrap();
        self.focused();
    }

    /// FakeInput, and a question behind it: when its answer is there, the input has come.
    fn fake(&mut self, kind: u8, detail: u8, [x, y]: [i16; 2]) {
        let mut request = vec![self.xtest, 2, 9, 0, kind, detail, 0, 0, 0, 0, 0, 0];
        request.extend_from_slice(&self.root.to_le_bytes());
        request.extend_from_slice(&[0; 8]);
        request.extend([x, y].into_iter().flat_map(i16::to_le_bytes));
        request.extend_from_slice(&[0; 8]);
        self.stream.write_all(&request).unwrap();
        self.focused();
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
