//! Sends keyboard and pointer events to an X server without input devices. This file implements the
//! needed parts of the X protocol and of its extension XTEST.
//!
//! Source: X Window System Protocol, version 11, encoding; X Test Extension Protocol.

#![allow(dead_code, reason = "every test file uses a part of this")]

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;

/// Keys, as keysyms. The keycode of a key depends on the server.
pub const ESCAPE: u32 = 0xff1b;
pub const TAB: u32 = 0xff09;
pub const S: u32 = 0x73;
pub const UP: u32 = 0xff52;
pub const RIGHT: u32 = 0xff53;
pub const DOWN: u32 = 0xff54;

/// Focus value: no window has the keyboard focus.
pub const NOBODY: u32 = 0;
/// Focus value: the window under the pointer has the keyboard focus.
pub const POINTER_ROOT: u32 = 1;

/// A connection whose requests have the effect of a user's input.
pub struct Poke {
    stream: UnixStream,
    pub root: u32,
    /// First identifier of this connection's resources.
    first: u32,
    xtest: u8,
    /// The keysym of each keycode, from keycode 8 on.
    keys: Vec<u32>,
}

impl Poke {
    /// Connects to the server of a display number.
    pub fn new(display: u32) -> Self {
        let mut stream = UnixStream::connect(format!("/tmp/.X11-unix/X{display}")).unwrap();
        // Set up the connection: little endian, version 11.0 of the protocol, no authorization.
        stream.write_all(&[b'l', 0, 11, 0, 0, 0, 0, 0, 0, 0, 0, 0]).unwrap();
        let mut head = [0; 8];
        stream.read_exact(&mut head).unwrap();
        assert_eq!(head[0], 1, "refused");
        let mut setup = vec![0; 4 * usize::from(u16::from_le_bytes([head[6], head[7]]))];
        stream.read_exact(&mut setup).unwrap();
        let vendor = usize::from(u16::from_le_bytes([setup[16], setup[17]])).next_multiple_of(4);
        // The answer contains the vendor's name, the pixmap formats and then the first screen. A
        // screen begins with the identifier of its root window.
        let at = 32 + vendor + 8 * usize::from(setup[21]);
        let number = |at: usize| u32::from_le_bytes(setup[at..at + 4].try_into().unwrap());
        let (root, first) = (number(at), number(4));
        let mut poke = Self { stream, root, first, xtest: 0, keys: Vec::new() };
        // request QueryExtension: find the extension XTEST
        let answer = poke.ask(&[&[98, 0, 4, 0, 5, 0, 0, 0], &b"XTEST\0\0\0"[..]].concat());
        assert_eq!(answer[8], 1, "no XTEST");
        poke.xtest = answer[9];
        // request GetKeyboardMapping for the keycodes 8 to 255
        let answer = poke.ask(&[101, 0, 2, 0, 8, 248, 0, 0]);
        let mut map = vec![0; 4 * 248 * usize::from(answer[1])];
        poke.stream.read_exact(&mut map).unwrap();
        let first_of = |keysyms: &[u8]| u32::from_le_bytes(keysyms[..4].try_into().unwrap());
        poke.keys = map.chunks_exact(4 * usize::from(answer[1])).map(first_of).collect();
        poke
    }

    /// Moves the pointer to a point of the screen.
    pub fn point(&mut self, [x, y]: [i16; 2]) {
        self.fake(6, 0, [x, y]);
    }

    /// Presses and releases a key.
    pub fn key(&mut self, keysym: u32) {
        let code = 8 + self.keys.iter().position(|known| *known == keysym).expect("a key on the keyboard") as u8;
        self.fake(2, code, [0, 0]);
        self.fake(3, code, [0, 0]);
    }

    /// Sets the keyboard focus to a window. When the window closes, no window has the focus.
    pub fn focus(&mut self, window: u32) {
        self.say(42, 0, &[window, 0]);
    }

    /// Returns the window with the keyboard focus.
    pub fn focused(&mut self) -> u32 {
        // request GetInputFocus
        let answer = self.ask(&[43, 0, 1, 0]);
        u32::from_le_bytes(answer[8..12].try_into().unwrap())
    }

    /// Makes this client the window manager. If `is` is false, this client becomes an ordinary
    /// client again. The window manager receives the requests that concern children of the root
    /// window.
    pub fn manage(&mut self, is: bool) {
        // request ChangeWindowAttributes: set the event mask, with or without SubstructureRedirect
        self.say(2, 0, &[self.root, 1 << 11, u32::from(is) << 20]);
    }

    /// Opens a window of one pixel.
    pub fn window(&mut self) -> u32 {
        // requests CreateWindow (depth and visual of the root, at 0,0, 1 × 1, no border) and
        // MapWindow
        self.say(1, 0, &[self.first, self.root, 0, 0x1_0001, 0, 0, 0]);
        self.say(8, 0, &[self.first]);
        self.first
    }

    /// Closes a window.
    pub fn close(&mut self, window: u32) {
        self.say(4, 0, &[window]);
    }

    /// Sends a request of 32-bit words that has no reply. Returns after the server has processed
    /// the request.
    fn say(&mut self, code: u8, detail: u8, words: &[u32]) {
        let mut request = vec![code, detail, words.len() as u8 + 1, 0];
        request.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        self.stream.write_all(&request).unwrap();
        self.focused();
    }

    /// Sends the request FakeInput, and then a request with a reply. When the reply arrives, the
    /// server has processed the input.
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
        // skip events that every client receives, such as a new keyboard mapping
        while answer[0] > 1 {
            self.stream.read_exact(&mut answer).unwrap();
        }
        assert_eq!(answer[0], 1, "an error: {answer:?}");
        answer
    }
}
