//! Calls across the C interface, in both directions. A result is passed as a status and a text, and
//! becomes a result again on the other side. A panic becomes an error.

use std::any::Any;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

use lumistack_plugin_abi::{Bytes, ErrorSink, Status, Str};

use crate::PluginError;

/// Calls a function of the other side of the interface, with a sink for its error text.
///
/// # Errors
/// The status that the other side returns, with the text that it wrote to the sink.
pub fn call(function: impl FnOnce(*const ErrorSink) -> Status) -> Result<(), PluginError> {
    let mut text = String::new();
    let status = function(&keeping(&mut text));
    if text.is_empty() {
        text = format!("expected an error text, found only the status {}", status.0);
    }
    match status {
        Status::OK => Ok(()),
        Status::CANCELLED => Err(PluginError::Cancelled),
        Status::REFUSED => Err(PluginError::Refused(text)),
        Status::PANICKED => Err(PluginError::Panicked(text)),
        _ => Err(PluginError::Failed(text)),
    }
}

/// Runs a function that the other side has called. Returns its status, and copies its error text or
/// its panic's message to the sink.
///
/// # Safety
/// `error` is null or a valid sink.
pub unsafe fn answer(error: *const ErrorSink, function: impl FnOnce() -> Result<(), PluginError>) -> Status {
    // `AssertUnwindSafe` is right, since no later call sees inconsistent state. After a panic the
    // plugin's instance refuses calls, and locks protect all other state.
    let outcome = catch_unwind(AssertUnwindSafe(function))
        .unwrap_or_else(|payload| Err(PluginError::Panicked(panic_text(payload))));
    let (status, text) = match outcome {
        Ok(()) => return Status::OK,
        Err(PluginError::Cancelled) => (Status::CANCELLED, "cancelled".to_string()),
        Err(PluginError::Refused(text)) => (Status::REFUSED, text),
        Err(PluginError::Failed(text)) => (Status::FAILED, text),
        Err(PluginError::Panicked(text)) => (Status::PANICKED, text),
    };
    // SAFETY: guaranteed by the caller.
    unsafe { write_error(error, &text) };
    status
}

/// Copies an error text to a sink.
///
/// # Safety
/// `error` is null or a valid sink.
pub unsafe fn write_error(error: *const ErrorSink, text: &str) {
    // SAFETY: guaranteed by the caller.
    if let Some(sink) = unsafe { error.as_ref() }
        && !text.is_empty()
    {
        // SAFETY: the sink's function takes its own context and copies the text.
        unsafe { (sink.write)(sink.context, Str::new(text)) };
    }
}

/// Makes a sink that stores the written text in `text`. The sink is valid as long as `text` is.
pub fn keeping(text: &mut String) -> ErrorSink {
    ErrorSink { size: size_of::<ErrorSink>(), context: (&raw mut *text).cast(), write: keep_text }
}

/// Returns the message of a panic. Also drops the payload, and catches a panic of the payload's
/// destructor.
pub(crate) fn panic_text(payload: Box<dyn Any + Send>) -> String {
    let text = match payload.downcast_ref::<&str>() {
        Some(text) => (*text).to_string(),
        None => payload.downcast_ref::<String>().cloned().unwrap_or_else(|| "a value that is not text".into()),
    };
    if let Err(second) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
        std::mem::forget(second);
    }
    text
}

/// Returns a text that the other side lends; `what` names the text in errors.
///
/// # Errors
/// If the text is at a null pointer, longer than an array can be, or not UTF-8.
///
/// # Safety
/// `text` points to `len` readable bytes (or `len` is 0) as long as the result is used.
pub unsafe fn lent_text<'a>(text: Str, what: &str) -> Result<&'a str, PluginError> {
    // SAFETY: guaranteed by the caller.
    let bytes = unsafe { lent_bytes(Bytes { ptr: text.ptr, len: text.len }, what)? };
    std::str::from_utf8(bytes).map_err(|error| PluginError::failed(what, error))
}

/// Returns a text that the other side lends, with invalid UTF-8 replaced. If the text is at a null
/// pointer or longer than an array can be, the result is empty.
///
/// # Safety
/// As for [`lent_text`].
pub unsafe fn lent_lossy<'a>(text: Str) -> std::borrow::Cow<'a, str> {
    // SAFETY: guaranteed by the caller.
    String::from_utf8_lossy(unsafe { lent_bytes(Bytes { ptr: text.ptr, len: text.len }, "text") }.unwrap_or_default())
}

/// Returns bytes that the other side lends; `what` names the bytes in errors.
///
/// # Errors
/// If the bytes are at a null pointer, or more than an array can hold.
///
/// # Safety
/// `bytes` points to `len` readable bytes (or `len` is 0) as long as the result is used.
pub unsafe fn lent_bytes<'a>(bytes: Bytes, what: &str) -> Result<&'a [u8], PluginError> {
    if bytes.len == 0 {
        return Ok(&[]);
    }
    if bytes.ptr.is_null() || isize::try_from(bytes.len).is_err() {
        let place = if bytes.ptr.is_null() { " at a null pointer" } else { ", more than an array can hold" };
        return Err(PluginError::Refused(format!("{what}: expected readable bytes, found {} bytes{place}", bytes.len)));
    }
    // SAFETY: guaranteed by the caller; the length was checked.
    Ok(unsafe { std::slice::from_raw_parts(bytes.ptr, bytes.len) })
}

/// Copies an error text into the string of the sink that [`keeping`] makes. This function is the
/// sink's [`ErrorSink::write`].
unsafe extern "C" fn keep_text(context: *mut c_void, text: Str) {
    // SAFETY: the callee lends the text for this call; `context` is the string of `keeping`, whose
    // owner waits for the callee.
    unsafe { *context.cast::<String>() = lent_lossy(text).into_owned() };
}

/// Appends bytes to the `Vec<u8>` to which `context` points. In a sink that collects bytes, this
/// function is [`ByteSink::write`](lumistack_plugin_abi::ByteSink::write).
///
/// # Safety
/// `context` points to a vector without other users during the call; the bytes are lent for the
/// call; `error` is null or a valid sink.
pub unsafe extern "C" fn append(context: *mut c_void, bytes: Bytes, error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the caller.
    unsafe {
        answer(error, || {
            (*context.cast::<Vec<u8>>()).extend_from_slice(lent_bytes(bytes, "bytes")?);
            Ok(())
        })
    }
}

/// Refuses a struct of an older version of the interface, which has fewer than `least` bytes.
pub(crate) fn needs(size: usize, least: usize) -> Result<(), PluginError> {
    if size < least {
        let text = format!(
            "the host's interface is older than the plugin's: expected a struct of at least {least} bytes, found {size}"
        );
        return Err(PluginError::Refused(text));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_and_panics_arrive_as_they_were_sent() {
        for error in [
            PluginError::Cancelled,
            PluginError::Refused("no".into()),
            PluginError::Failed("disk full".into()),
            PluginError::Panicked("index 3 of 2".into()),
        ] {
            // SAFETY: the sink comes from `call`.
            let received = call(|sink| unsafe { answer(sink, || Err(error.clone())) });
            assert_eq!(received, Err(error));
        }
        // SAFETY: the sink comes from `call`.
        let received = call(|sink| unsafe { answer(sink, || panic!("number {}", 7)) });
        assert_eq!(received, Err(PluginError::Panicked("number 7".into())));
        // SAFETY: a null sink is allowed.
        let status = unsafe { answer(std::ptr::null(), || Err(PluginError::Failed("unheard".into()))) };
        assert_eq!(status, Status::FAILED);
    }

    #[test]
    fn a_panic_whose_payload_panics_in_turn_is_contained() {
        struct Grenade;
        impl Drop for Grenade {
            fn drop(&mut self) {
                panic!("second");
            }
        }
        // SAFETY: a null sink is allowed.
        let status = unsafe { answer(std::ptr::null(), || std::panic::panic_any(Grenade)) };
        assert_eq!(status, Status::PANICKED);
    }
}
