//! Tracked viewers: positions of their heads, predicted positions, and weights of rays. Rays near
//! the viewers have large weights, until the tracker is silent.
//!
//! ```text
//! eye(t) = eye + velocity · (t − seen + latency)
//! w(ray) = s + (1 − s) · (floor + Σ exp(−½ (r/σ)²))
//! ```
//!
//! `seen` is the time of the tracker's last report, and `eye` and `velocity` are the position and
//! the velocity at that time. `latency` is the time from the tracker's measurement to the patterns
//! on the display. `s` is the weight of the whole zone: 0 while viewers are tracked, 1 without
//! viewers. `floor` is [`FLOOR`]. `r` is the distance of the ray from the point midway between a
//! viewer's eyes, measured parallel to the display. σ is `WEIGHT_MM`. The sum runs over the
//! viewers.

use std::time::Duration;

use lumistack_display::{EyeBox, FieldGeometry, WeightError, Weights};
use thiserror::Error;

/// Time without reports of the tracker after which the weight of the whole zone begins to grow.
pub const SILENCE: Duration = Duration::from_secs(1);
/// Time in which the weights change from those for tracked viewers to those for the whole zone.
pub const FADE: Duration = Duration::from_secs(1);
/// Longest time over which a position is predicted. The prediction assumes a constant velocity, so
/// its error grows with time.
const MOST_AHEAD: Duration = Duration::from_millis(250);
/// Time over which a velocity is averaged, since positions of trackers are noisy.
const VELOCITY_TIME: Duration = Duration::from_millis(100);
/// Largest distance between a viewer's positions in two successive reports, mm. A position farther
/// away belongs to another viewer.
const JUMP_MM: f64 = 300.0;
/// Weight of rays far from all viewers while viewers are tracked.
pub const FLOOR: f64 = 0.002;
/// Standard deviation σ of a viewer's weight, mm. A viewer's eyes are some 32 mm away from the
/// midpoint between them, so the rays to the eyes have large weights.
const WEIGHT_MM: f64 = 40.0;

/// The eyes of tracked viewers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Eyes {
    /// Every viewer has two eyes.
    #[default]
    Two,
    /// The viewer looks at a picture of the display in a page or window, from the position of the
    /// head. The picture has the projection of the light field.
    Picture,
}

/// Positions and velocities of the tracked heads.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    heads: Vec<Head>,
    eyes: Eyes,
    seen: Option<Duration>,
}

#[derive(Clone, Copy, Debug)]
struct Head {
    at_mm: [f64; 3],
    velocity_mm_s: [f64; 3],
}

/// The positions of the tracked viewers at one time, and the weight of the whole zone.
#[derive(Clone, Debug, PartialEq)]
pub struct Boxes {
    /// For each viewer, the point midway between the eyes, display space, mm.
    pub heads_mm: Vec<[f64; 3]>,
    /// The viewers' eyes.
    pub eyes: Eyes,
    /// Weight of the whole zone, 0..1.
    pub zone: f64,
}

/// A wrong report of a tracker: a position of a viewer, or a packet.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("viewer: expected {expected}, found {found}")]
pub struct HeadError {
    /// Description of a valid position or packet.
    pub expected: &'static str,
    /// The value as found.
    pub found: String,
}

impl Tracker {
    /// Receives the positions of all viewers: points midway between their eyes, display space, mm
    /// (right, up, to the viewer). An empty list means that there is no viewer.
    ///
    /// # Errors
    /// If a position is not finite or not in front of the display.
    pub fn see(&mut self, heads_mm: &[[f64; 3]], eyes: Eyes, now: Duration) -> Result<(), HeadError> {
        if let Some(found) = heads_mm.iter().find(|at| !(at.iter().all(|v| v.is_finite()) && at[2] > 0.0)) {
            let expected = "three finite numbers [x, y, z] in millimetres, z > 0 in front of the display";
            return Err(HeadError { expected, found: format!("{found:?}") });
        }
        let passed = self.seen.map_or(Duration::ZERO, |seen| now.saturating_sub(seen));
        let heads = heads_mm.iter().enumerate().map(|(number, &at_mm)| {
            let before = self.heads.get(number).filter(|before| passed < SILENCE && near(before.at_mm, at_mm));
            Head { at_mm, velocity_mm_s: before.map_or([0.0; 3], |before| before.velocity_to(at_mm, passed)) }
        });
        self.heads = heads.collect();
        self.eyes = eyes;
        self.seen = (!self.heads.is_empty()).then_some(now).or(self.seen);
        Ok(())
    }

    /// Predicts the positions of the viewers at the time `now` + `latency`. After [`SILENCE`]
    /// without a report, `zone` grows from 0 to 1 within [`FADE`]. After that, or without viewers,
    /// the result has no positions and `zone` is 1.
    pub fn boxes(&self, now: Duration, latency: Duration) -> Boxes {
        let Some(seen) = self.seen else { return Boxes::default() };
        let silent = now.saturating_sub(seen);
        let zone = (silent.saturating_sub(SILENCE).as_secs_f64() / FADE.as_secs_f64()).min(1.0);
        let ahead = (silent + latency).min(MOST_AHEAD).as_secs_f64();
        let at = |head: &Head| {
            let [x, y, z] = [0, 1, 2].map(|i| head.at_mm[i] + ahead * head.velocity_mm_s[i]);
            // a head that approaches the display must not be predicted inside or behind it
            [x, y, z.max(0.5 * head.at_mm[2])]
        };
        if zone == 1.0 || self.heads.is_empty() {
            return Boxes::default();
        }
        Boxes { heads_mm: self.heads.iter().map(at).collect(), eyes: self.eyes, zone }
    }
}

fn near(a: [f64; 3], b: [f64; 3]) -> bool {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt() < JUMP_MM
}

impl Head {
    /// Returns the velocity after a report. It is averaged over [`VELOCITY_TIME`].
    fn velocity_to(&self, at_mm: [f64; 3], passed: Duration) -> [f64; 3] {
        let passed = passed.as_secs_f64();
        if passed <= 0.0 {
            return self.velocity_mm_s;
        }
        let share = 1.0 - (-passed / VELOCITY_TIME.as_secs_f64()).exp();
        [0, 1, 2].map(|i| {
            let now = (at_mm[i] - self.at_mm[i]) / passed;
            self.velocity_mm_s[i] + share * (now - self.velocity_mm_s[i])
        })
    }
}

impl Default for Boxes {
    /// No viewers: the whole zone.
    fn default() -> Self {
        Self { heads_mm: Vec::new(), eyes: Eyes::Two, zone: 1.0 }
    }
}

impl Boxes {
    /// Returns weights of a light field's rays: large near the viewers. `whole` are the weights for
    /// the whole zone.
    ///
    /// # Errors
    /// If the geometry is invalid.
    pub fn weights(&self, geometry: &FieldGeometry, whole: &Weights) -> Result<Weights, WeightError> {
        if self.zone >= 1.0 {
            return Ok(whole.clone());
        }
        let boxes = self.heads_mm.iter().map(|&eye_mm| EyeBox { eye_mm, sigma_mm: WEIGHT_MM, weight: 1.0 - self.zone });
        let floor = self.zone + (1.0 - self.zone) * FLOOR;
        Weights::eye_boxes(geometry, &boxes.collect::<Vec<_>>(), floor as f32)
    }

    /// Returns true if the rays of `other` can be used instead of the rays of `self`. For this, the
    /// weight of the zone, the kind of eyes and the number of viewers must be equal. Every viewer's
    /// position may differ by at most `tolerance_mm` along each axis.
    pub fn is_like(&self, other: &Self, tolerance_mm: f64) -> bool {
        let close = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).all(|i| (a[i] - b[i]).abs() <= tolerance_mm);
        self.zone == other.zone
            && self.eyes == other.eyes
            && self.heads_mm.len() == other.heads_mm.len()
            && self.heads_mm.iter().zip(&other.heads_mm).all(close)
    }
}

/// Bytes of an OpenTrack packet.
const PACKET: usize = 48;

/// Reads the position of the head from an OpenTrack packet ("UDP over network"). The packet has six
/// little-endian doubles: x, y, z in centimetres, then yaw, pitch, roll in degrees. `centre_mm` is
/// the position in display space at which OpenTrack was centred. In the packet, x points to the
/// viewer's right, y up, and z away from the display.
///
/// # Errors
/// If the packet has another length, or its position is not finite.
pub fn head_of_packet(packet: &[u8], centre_mm: [f64; 3]) -> Result<[f64; 3], HeadError> {
    let error = |expected, found: String| Err(HeadError { expected, found });
    if packet.len() != PACKET {
        return error("an OpenTrack packet of 48 bytes", format!("{} bytes", packet.len()));
    }
    let number = |i: usize| f64::from_le_bytes(std::array::from_fn(|k| packet[8 * i + k]));
    let at_cm = [number(0), number(1), number(2)];
    if !at_cm.iter().all(|value| value.is_finite()) {
        return error("a position of finite numbers in an OpenTrack packet", format!("{at_cm:?}"));
    }
    Ok([0, 1, 2].map(|i| centre_mm[i] + 10.0 * at_cm[i]))
}
