//! Serves a child's requests. The requests use services of the host, and data and sinks that are
//! lent to a call.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use lumistack_plugin::PlaneView;
use lumistack_plugin::abi::{
    Assets, ByteSink, Bytes, Data, ErrorSink, FieldSink, HostServices, Plane, StackSink, Status, Str, View, dtype,
};
use lumistack_plugin::wire::{append, keeping, write_error};

use super::protocol::{Answer, Request, Say};

/// The objects that are lent to the running calls of a child.
#[derive(Default)]
pub(super) struct Lending {
    /// The objects lent to each call, by the call's number. The key [`HOST`] has the host's table.
    all: RwLock<HashMap<u64, Lent>>,
    /// Names of the files that are being written, by their handles.
    files: Mutex<BTreeMap<u64, String>>,
}

/// Pointers to the objects lent to one call; null for an object that is not lent.
#[derive(Clone, Copy)]
pub(super) struct Lent {
    pub(super) host: *const HostServices,
    pub(super) data: *const Data,
    pub(super) assets: *const Assets,
    pub(super) scene: *const ByteSink,
    pub(super) field: *const FieldSink,
    pub(super) stack: *const StackSink,
}

impl Lent {
    pub(super) const fn nothing() -> Self {
        use std::ptr::null;
        Self { host: null(), data: null(), assets: null(), scene: null(), field: null(), stack: null() }
    }
}

// SAFETY: the interface allows use of all these objects from any thread, except sinks. Locks guard
// the sinks of light fields and layer stacks. Only the thread that reads messages uses `scene`.
unsafe impl Send for Lent {}
// SAFETY: as above.
unsafe impl Sync for Lent {}

/// The key of the host's table in [`Lending`]; no call has this number. The table of an output is
/// lent from `open` to `close`, also while no call runs.
pub(super) const HOST: u64 = 0;

/// # Safety
/// `host` is a valid table.
pub(super) unsafe fn is_cancelled(host: *const HostServices) -> bool {
    // SAFETY: guaranteed by the caller.
    unsafe { ((*host).is_cancelled)((*host).context) != 0 }
}

impl Lending {
    /// Locks and returns the objects of all calls. A request holds the lock while it uses them.
    pub(super) fn all(&self) -> RwLockReadGuard<'_, HashMap<u64, Lent>> {
        self.all.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until no request uses the objects of any call. Then locks the objects for changes, and
    /// returns them.
    pub(super) fn all_mut(&self) -> RwLockWriteGuard<'_, HashMap<u64, Lent>> {
        self.all.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the names of the files that are being written.
    pub(super) fn files(&self) -> MutexGuard<'_, BTreeMap<u64, String>> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Serves one request.
    pub(super) fn answer(&self, request: u64, what: Request, body: &[u8]) -> (Answer, Vec<u8>) {
        let mut answer = Answer { request, ..Answer::default() };
        let mut out = Vec::new();
        let all = self.all();
        let Some(lent) = all.get(&HOST) else {
            (answer.status, answer.text) =
                (Status::FAILED.0, "the plugin called the host after the host's services had ended".into());
            return (answer, out);
        };
        // SAFETY: the lock keeps the table alive.
        let host = unsafe { &*lent.host };
        let mut text = String::new();
        let error = keeping(&mut text);
        // SAFETY: objects stay lent while they are in the map, and the lock keeps them there; the
        // other arguments are lent for the call.
        let status = unsafe { self.serve(host, &all, what, body, &mut answer, &mut out, &error) };
        answer.cancelled = {
            // SAFETY: as above.
            unsafe { is_cancelled(host) }
        };
        (answer.status, answer.text) = (status.0, text);
        (answer, out)
    }

    /// # Safety
    /// All tables and sinks in `all`, `host` and `error` are valid.
    unsafe fn serve(
        &self,
        host: &HostServices,
        all: &HashMap<u64, Lent>,
        what: Request,
        body: &[u8],
        answer: &mut Answer,
        out: &mut Vec<u8>,
        error: *const ErrorSink,
    ) -> Status {
        let nothing = Lent::nothing();
        let of = |call: u64| all.get(&call).unwrap_or(&nothing);
        // SAFETY: guaranteed by the caller.
        let refused = |reason: &str| unsafe {
            write_error(error, reason);
            Status::REFUSED
        };
        let context = host.context;
        let path = Str { ptr: body.as_ptr(), len: body.len() };
        // SAFETY: guaranteed by the caller, here and below.
        unsafe {
            match what {
                Request::IsCancelled => Status::OK,
                Request::FileOpen => {
                    let status = (host.file_open)(context, path, &mut answer.file, error);
                    if status == Status::OK {
                        self.files().insert(answer.file, String::from_utf8_lossy(body).into_owned());
                    }
                    status
                }
                Request::FileAppend { file } => (host.file_append)(context, file, Bytes::new(body), error),
                Request::FileCommit { file } => {
                    let status = (host.file_commit)(context, file, error);
                    self.files().remove(&file);
                    status
                }
                Request::FileAbort { file } => {
                    let status = (host.file_abort)(context, file, error);
                    self.files().remove(&file);
                    status
                }
                Request::LayerPlane { call, layer, frame } => match of(call).data.as_ref() {
                    Some(data) => {
                        fetch(answer, out, error, |plane| (data.layer_plane)(data.context, layer, frame, plane, error))
                    }
                    None => refused(CALL_RETURNED),
                },
                Request::EmissionPlane { call, frame, bin_y, bin_x } => match of(call).data.as_ref() {
                    Some(data) => fetch(answer, out, error, |plane| {
                        (data.emission_plane)(data.context, frame, bin_y, bin_x, plane, error)
                    }),
                    None => refused(CALL_RETURNED),
                },
                Request::ViewPlane { call, view_y, view_x } => match of(call).data.as_ref() {
                    Some(data) => {
                        fetch(answer, out, error, |plane| (data.view_plane)(data.context, view_y, view_x, plane, error))
                    }
                    None => refused(CALL_RETURNED),
                },
                Request::WeightPlane { call, view_y, view_x } => match of(call).data.as_ref() {
                    Some(data) => fetch(answer, out, error, |plane| {
                        (data.weight_plane)(data.context, view_y, view_x, plane, error)
                    }),
                    None => refused(CALL_RETURNED),
                },
                Request::Simulate { call, kind, value_bits } => match of(call).data.as_ref() {
                    Some(data) => {
                        let view = View { size: size_of::<View>(), kind, value: value_bits.map(f64::from_bits) };
                        fetch(answer, out, error, |plane| (host.simulate)(context, data, &view, plane, error))
                    }
                    None => refused(CALL_RETURNED),
                },
                Request::ReadAsset { call } => match of(call).assets.as_ref() {
                    Some(assets) => {
                        let sink =
                            ByteSink { size: size_of::<ByteSink>(), context: (&raw mut *out).cast(), write: append };
                        (assets.read)(assets.context, path, &sink, error)
                    }
                    None => refused(CALL_RETURNED),
                },
                Request::GiveScene { call } => match of(call).scene.as_ref() {
                    Some(sink) => (sink.write)(sink.context, Bytes::new(body), error),
                    None => refused(CALL_RETURNED),
                },
                Request::GiveGeometry { call } => match of(call).field.as_ref() {
                    Some(sink) => (sink.geometry)(sink.context, path, error),
                    None => refused(CALL_RETURNED),
                },
                Request::GiveView { call, view_y, view_x, shape } => match of(call).field.as_ref() {
                    Some(sink) => give_to_sink(body, shape, error, |plane| {
                        (sink.view_plane)(sink.context, view_y, view_x, plane, error)
                    }),
                    None => refused(CALL_RETURNED),
                },
                Request::GiveBrightness { call, bits } => match of(call).stack.as_ref() {
                    Some(sink) => (sink.brightness)(sink.context, f64::from_bits(bits), error),
                    None => refused(CALL_RETURNED),
                },
                Request::GiveLayer { call, layer, frame, shape } => match of(call).stack.as_ref() {
                    Some(sink) => give_to_sink(body, shape, error, |plane| {
                        (sink.layer_plane)(sink.context, layer, frame, plane, error)
                    }),
                    None => refused(CALL_RETURNED),
                },
                Request::GiveEmission { call, frame, bin_y, bin_x, shape } => match of(call).stack.as_ref() {
                    Some(sink) => give_to_sink(body, shape, error, |plane| {
                        (sink.emission_plane)(sink.context, frame, bin_y, bin_x, plane, error)
                    }),
                    None => refused(CALL_RETURNED),
                },
                Request::GiveStep { call, iteration, objective_bits, psnr_bits } => match of(call).stack.as_ref() {
                    Some(sink) => {
                        let [objective, psnr] = [objective_bits, psnr_bits].map(f64::from_bits);
                        (sink.step)(sink.context, iteration, objective, psnr, error)
                    }
                    None => refused(CALL_RETURNED),
                },
                Request::GiveSolution { call } => match of(call).stack.as_ref() {
                    Some(sink) => (sink.solution)(sink.context, path, error),
                    None => refused(CALL_RETURNED),
                },
            }
        }
    }
}

/// The error if the plugin uses an object after the call to which it was lent has returned.
const CALL_RETURNED: &str =
    "the plugin used an object that the host had lent to a call, but the call has already returned";

/// Forwards a notification to the host.
///
/// # Safety
/// The table is valid.
pub(super) unsafe fn forward(host: &HostServices, say: &Say) {
    let context = host.context;
    // SAFETY: `context` belongs to the table; the texts are lent for the call.
    unsafe {
        match say {
            Say::Log { level, message } => (host.log)(context, *level, Str::new(message)),
            Say::ProgressBegin { stage, total, unit } => {
                (host.progress_begin)(context, Str::new(stage), *total, Str::new(unit));
            }
            Say::ProgressAdvance { steps, note } => (host.progress_advance)(context, *steps, Str::new(note)),
            Say::ProgressEnd => (host.progress_end)(context),
            Say::Tell { json } => (host.tell)(context, Str::new(json)),
        }
    }
}

/// Copies a plane that the host lends into the body of an answer.
///
/// # Safety
/// `error` is a valid sink, and `lend` fills in a valid plane on success.
unsafe fn fetch(
    answer: &mut Answer,
    out: &mut Vec<u8>,
    error: *const ErrorSink,
    lend: impl FnOnce(*mut Plane) -> Status,
) -> Status {
    let mut plane = Plane::empty();
    let status = lend(&mut plane);
    if status != Status::OK {
        return status;
    }
    // SAFETY: guaranteed by the caller; the plane is released when the view is dropped.
    let view = match unsafe { PlaneView::new(plane) } {
        Ok(view) => view,
        Err(reason) => {
            // SAFETY: guaranteed by the caller.
            unsafe { write_error(error, &reason.to_string()) };
            return Status::FAILED;
        }
    };
    answer.shape = [view.rows(), view.cols(), view.channels()];
    let values = view.values();
    // SAFETY: the bytes of `f32` values are initialized.
    out.extend_from_slice(unsafe { std::slice::from_raw_parts(values.as_ptr().cast(), size_of_val(&*values)) });
    Status::OK
}

/// Passes a plane of the child to a sink.
///
/// # Safety
/// `error` is a valid sink.
unsafe fn give_to_sink(
    body: &[u8],
    [rows, cols, channels]: [usize; 3],
    error: *const ErrorSink,
    take: impl FnOnce(*const Plane) -> Status,
) -> Status {
    let element = size_of::<f32>();
    let count = rows.checked_mul(cols).and_then(|count| count.checked_mul(channels));
    if count.and_then(|count| count.checked_mul(element)) != Some(body.len()) {
        // SAFETY: guaranteed by the caller.
        unsafe {
            write_error(
                error,
                &format!(
                    "expected a plane of shape {:?} with {element} bytes per value, found {} bytes",
                    [rows, cols, channels],
                    body.len()
                ),
            )
        };
        return Status::REFUSED;
    }
    // The products overflow only if the plane has no values, so no wrong stride is used.
    let pixel = channels.wrapping_mul(element);
    let strides = [cols.wrapping_mul(pixel), pixel, element, 0].map(|stride| stride as isize);
    let shape = [rows, cols, channels, 1];
    take(&Plane { data: body.as_ptr().cast(), dtype: dtype::F32, ndim: 3, shape, strides, ..Plane::empty() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_without_values_reaches_the_sink_whatever_its_shape() {
        let mut text = String::new();
        let error = keeping(&mut text);
        let mut found = [1; 4];
        // SAFETY: the sink of errors is valid, and the plane is lent for the call.
        let status = unsafe {
            give_to_sink(&[], [0, usize::MAX, 2], &error, |plane| {
                found = (*plane).shape;
                Status::OK
            })
        };
        assert_eq!((status, found), (Status::OK, [0, usize::MAX, 2, 1]));
    }
}
