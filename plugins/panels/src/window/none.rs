//! The functions of the windows in a build without the feature `window`. They return errors.

use std::sync::Arc;
use std::sync::mpsc::Receiver;

use super::WindowError;
use crate::assign::Output;
use crate::presentation::{Command, Event, Settings};

/// Returns [`WindowError::NotBuilt`].
pub fn present(
    _: Settings,
    _: Receiver<Command>,
    _: &dyn Fn() -> bool,
    _: Arc<dyn Fn(Event) + Send + Sync>,
) -> Result<(), WindowError> {
    Err(WindowError::NotBuilt)
}

/// Returns [`WindowError::NotBuilt`].
pub fn outputs() -> Result<Vec<Output>, WindowError> {
    Err(WindowError::NotBuilt)
}
