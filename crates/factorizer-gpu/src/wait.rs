//! Waits for answers of the device.
//!
//! In a page the answers are promises. There the module suspends until they settle (JavaScript
//! Promise Integration), so that solvers need no second, asynchronous form. For this, every call of
//! this file's functions must come from an exported function with the attribute `jspi`.

#[cfg(not(target_arch = "wasm32"))]
pub(crate) use native::{answer, block_on};
#[cfg(target_arch = "wasm32")]
pub(crate) use page::{answer, block_on};

/// A callback that receives the answer.
type Reply<T> = Box<dyn FnOnce(T) + Send>;

#[cfg(not(target_arch = "wasm32"))]
mod native {
    use std::sync::mpsc::channel;
    use std::time::Duration;

    use super::Reply;

    /// Longest wait for the callback of a read whose data has arrived.
    const CALLBACK_TIMEOUT: Duration = Duration::from_secs(30);

    pub(crate) use pollster::block_on;

    /// Calls `ask` with a callback, and returns the answer that the callback receives; `None` if no
    /// answer comes.
    pub(crate) fn answer<T: Send + 'static>(ask: impl FnOnce(Reply<T>)) -> Option<T> {
        let (sender, receiver) = channel();
        ask(Box::new(move |answer| drop(sender.send(answer))));
        // Another thread that waits for the device may run the callback, slightly later.
        receiver.recv_timeout(CALLBACK_TIMEOUT).ok()
    }
}

#[cfg(target_arch = "wasm32")]
mod page {
    use std::future::{Future, poll_fn};
    use std::sync::mpsc::{TryRecvError, channel};
    use std::sync::{Arc, Mutex, PoisonError};
    use std::task::{Poll, Waker};

    use js_sys::futures::future_to_promise;
    use wasm_bindgen::JsValue;

    use super::Reply;

    /// Suspends the module until a future is ready, and returns its result.
    pub(crate) fn block_on<T: 'static>(future: impl Future<Output = T> + 'static) -> T {
        let (sender, receiver) = channel();
        let promise = future_to_promise(async move {
            drop(sender.send(future.await));
            Ok(JsValue::UNDEFINED)
        });
        // the deprecation only states that this function is experimental
        #[allow(deprecated)]
        let settled = js_sys::futures::jspi_block_on_promise(&promise);
        match (settled, receiver.try_recv()) {
            (Ok(_), Ok(result)) => result,
            _ => wasm_bindgen::throw_str("the device does not answer"),
        }
    }

    /// Calls `ask` with a callback, and returns the answer that the callback receives; `None` if no
    /// answer comes.
    pub(crate) fn answer<T: Send + 'static>(ask: impl FnOnce(Reply<T>)) -> Option<T> {
        let (sender, receiver) = channel();
        let waiting = Arc::new(Mutex::new(None::<Waker>));
        let woken = waiting.clone();
        ask(Box::new(move |answer| {
            drop(sender.send(answer));
            if let Some(waker) = woken.lock().unwrap_or_else(PoisonError::into_inner).take() {
                waker.wake();
            }
        }));
        block_on(poll_fn(move |context| match receiver.try_recv() {
            Ok(answer) => Poll::Ready(Some(answer)),
            Err(TryRecvError::Disconnected) => Poll::Ready(None),
            Err(TryRecvError::Empty) => {
                *waiting.lock().unwrap_or_else(PoisonError::into_inner) = Some(context.waker().clone());
                Poll::Pending
            }
        }))
    }
}
