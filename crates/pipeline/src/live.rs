//! A job whose settings and files change while its display is shown (`lumistack live`).
//!
//! [`Studio`] makes light fields of it, whatever of it has changed anew; [`LiveFolder`] keeps what was shown last as a run folder.

mod change;
mod folder;
mod progressive;
mod studio;

pub use folder::LiveFolder;
pub use studio::Studio;
