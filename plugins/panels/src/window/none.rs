//! The place of the windows in a build without them.

use std::sync::Arc;
use std::sync::mpsc::Receiver;

use super::WindowError;
use crate::assign::Output;
use crate::presentation::{Command, Event, Settings};

/// Shows nothing.
///
/// # Errors
/// Always.
pub fn present(
    _: Settings,
    _: Receiver<Command>,
    _: &dyn Fn() -> bool,
    _: Arc<dyn Fn(Event) + Send + Sync>,
) -> Result<(), WindowError> {
    Err(WindowError::NotBuilt)
}

/// Finds no outputs.
///
/// # Errors
/// Always.
pub fn outputs() -> Result<Vec<Output>, WindowError> {
    Err(WindowError::NotBuilt)
}
