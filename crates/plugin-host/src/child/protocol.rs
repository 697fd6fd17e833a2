//! Messages between a program and its plugin process.
//!
//! A message is a frame of four parts. They are the length of the head (u32), the length of the
//! body (u64), the head as JSON, and the body. The lengths are little-endian. The body is bytes of
//! a file, a plane of `f32` in native byte order, or a text that may be invalid UTF-8. Times and
//! the real numbers of requests are sent as their bits, so that NaN, too, arrives unchanged.

use std::io::{self, Read, Write};

use crate::serve::PluginInfo;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Longest head, bytes. This limit is far above the size of parameters, displays and geometries.
const MAX_HEAD: u32 = 64 << 20;
/// Longest body, bytes. A plane of 35 000 × 10 000 pixels fits.
const MAX_BODY: u64 = 4 << 30;
/// Largest piece of a file or a scene in one message of the child, bytes.
pub(super) const PART: usize = 16 << 20;

/// Messages from the program.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum ToChild {
    /// Calls a function of the plugin.
    Call { call: u64, what: Call },
    /// Answers a request; the body is the requested plane or file.
    Answer(Answer),
}

/// A function of the plugin and its text arguments.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Call {
    Import { params: String, file: String },
    MakeField { params: String, display: String, time: Time },
    MakeStack { params: String, display: String, time: Time, data: Data },
    Open { params: String, display: String, port: u32 },
    Submit { time: Time, data: Data },
    Run,
    Command { json: String },
    Finish,
    Close,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Time {
    pub(super) index: u64,
    pub(super) seconds_bits: u64,
}

/// Data lent to a call. A request for a plane of these data states the number of the call.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Data {
    pub(super) port: u32,
    pub(super) description: String,
}

/// The result of a request.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Answer {
    pub(super) request: u64,
    pub(super) status: i32,
    /// Reason of a status other than OK.
    pub(super) text: String,
    /// Handle of the file that was opened.
    pub(super) file: u64,
    /// Rows, columns and channels of the plane, if the message's body is a plane.
    pub(super) shape: [usize; 3],
    /// True if the user has cancelled.
    pub(super) cancelled: bool,
}

/// Messages from the child.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum FromChild {
    /// The first message: the result of loading the library.
    Loaded(Loaded),
    /// A function of the plugin has returned.
    Done { call: u64, status: i32, text: String },
    /// Requests a service and waits for the answer.
    Request { request: u64, what: Request },
    /// A notification without an answer.
    Say(Say),
}

/// Results of loading a library.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Loaded {
    Plugin(PluginInfo),
    /// The system's loader refuses the library.
    Open(String),
    /// The entry function of this name is missing.
    NoEntry(String),
    /// The descriptor is invalid.
    Descriptor(String),
    /// The plugin's id, which differs from the id in the name of the entry function.
    OtherId(String),
}

/// A request of the child. It uses a service of the host, or data or a sink that the program has
/// lent to call number `call`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) enum Request {
    IsCancelled,
    /// Opens a file, whose path is the body.
    FileOpen,
    /// Appends the body to a file.
    FileAppend {
        file: u64,
    },
    FileCommit {
        file: u64,
    },
    FileAbort {
        file: u64,
    },
    LayerPlane {
        call: u64,
        layer: usize,
        frame: usize,
    },
    EmissionPlane {
        call: u64,
        frame: usize,
        bin_y: usize,
        bin_x: usize,
    },
    ViewPlane {
        call: u64,
        view_y: usize,
        view_x: usize,
    },
    WeightPlane {
        call: u64,
        view_y: usize,
        view_x: usize,
    },
    Simulate {
        call: u64,
        kind: u32,
        value_bits: [u64; 3],
    },
    /// Reads a file for an importer; the body is the file's path.
    ReadAsset {
        call: u64,
    },
    /// The body is the next piece of the scene.
    GiveScene {
        call: u64,
    },
    /// The body is the geometry.
    GiveGeometry {
        call: u64,
    },
    /// The body is the plane.
    GiveView {
        call: u64,
        view_y: usize,
        view_x: usize,
        shape: [usize; 3],
    },
    GiveBrightness {
        call: u64,
        bits: u64,
    },
    /// The body is the plane.
    GiveLayer {
        call: u64,
        layer: usize,
        frame: usize,
        shape: [usize; 3],
    },
    /// The body is the plane.
    GiveEmission {
        call: u64,
        frame: usize,
        bin_y: usize,
        bin_x: usize,
        shape: [usize; 3],
    },
    GiveStep {
        call: u64,
        iteration: u32,
        objective_bits: u64,
        psnr_bits: u64,
    },
    /// The body is the solution.
    GiveSolution {
        call: u64,
    },
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Say {
    Log { level: u32, message: String },
    ProgressBegin { stage: String, total: u64, unit: String },
    ProgressAdvance { steps: u64, note: String },
    ProgressEnd,
    Tell { json: String },
}

/// Writes one frame.
pub(super) fn write_frame(to: &mut impl Write, head: &impl Serialize, body: &[u8]) -> io::Result<()> {
    let head = serde_json::to_vec(head)?;
    let length = u32::try_from(head.len()).ok().filter(|length| *length <= MAX_HEAD);
    let length = length
        .ok_or_else(|| io::Error::other("expected a message head of at most 64 MiB, found a longer message head"))?;
    let mut start = Vec::with_capacity(12 + head.len());
    start.extend(length.to_le_bytes());
    start.extend((body.len() as u64).to_le_bytes());
    start.extend(head);
    to.write_all(&start)?;
    to.write_all(body)?;
    to.flush()
}

/// Reads one frame; `None` if the other side has closed the pipe. Memory for the body is allocated
/// as its bytes arrive, so a wrong length cannot exhaust the memory.
pub(super) fn read_frame<T: DeserializeOwned>(from: &mut impl Read) -> io::Result<Option<(T, Vec<u8>)>> {
    let mut start = [0; 12];
    let mut read = 0;
    while read < start.len() {
        match from.read(&mut start[read..]) {
            Ok(0) if read == 0 => return Ok(None),
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => read += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    let head_length = u32::from_le_bytes(start[..4].try_into().expect("four bytes"));
    let body_length = u64::from_le_bytes(start[4..].try_into().expect("eight bytes"));
    if head_length > MAX_HEAD || body_length > MAX_BODY {
        return Err(io::Error::other("expected a message of the plugin protocol, found other bytes"));
    }
    let mut part = |length: u64| {
        let mut bytes = Vec::with_capacity(length.min(PART as u64) as usize);
        from.take(length).read_to_end(&mut bytes)?;
        if (bytes.len() as u64) < length { Err(io::Error::from(io::ErrorKind::UnexpectedEof)) } else { Ok(bytes) }
    };
    let head = serde_json::from_slice(&part(u64::from(head_length))?)?;
    let body = part(body_length)?;
    Ok(Some((head, body)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_arrive_as_they_were_sent() {
        let mut bytes = Vec::new();
        let what = Request::Simulate { call: u64::MAX, kind: 2, value_bits: [f64::NAN.to_bits(), 0, 7] };
        write_frame(&mut bytes, &FromChild::Request { request: 3, what }, b"body").unwrap();
        write_frame(&mut bytes, &FromChild::Say(Say::ProgressEnd), b"").unwrap();
        let mut from = bytes.as_slice();
        let (head, body) = read_frame::<FromChild>(&mut from).unwrap().unwrap();
        let FromChild::Request { request: 3, what: Request::Simulate { call: u64::MAX, kind: 2, value_bits } } = head
        else {
            panic!("{head:?}")
        };
        assert_eq!((value_bits, body.as_slice()), ([f64::NAN.to_bits(), 0, 7], b"body".as_slice()));
        assert!(
            matches!(read_frame(&mut from).unwrap(), Some((FromChild::Say(Say::ProgressEnd), body)) if body.is_empty())
        );
        assert!(read_frame::<FromChild>(&mut from).unwrap().is_none());
    }

    #[test]
    fn nonsense_is_refused_without_taking_the_memory_that_it_names() {
        let mut frame = Vec::new();
        write_frame(&mut frame, &FromChild::Say(Say::ProgressEnd), b"1234").unwrap();
        for cut in 1..frame.len() {
            assert!(read_frame::<FromChild>(&mut &frame[..cut]).is_err(), "{cut}");
        }
        assert!(read_frame::<FromChild>(&mut b"printed into the wrong place, by a library".as_slice()).is_err());
        let mut long = frame.clone();
        long[4..12].copy_from_slice(&(MAX_BODY).to_le_bytes());
        assert!(read_frame::<FromChild>(&mut long.as_slice()).is_err(), "a body of 4 GiB is announced, and not sent");
        long[4..12].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(read_frame::<FromChild>(&mut long.as_slice()).is_err());
    }
}
