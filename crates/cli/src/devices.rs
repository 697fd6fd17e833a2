//! `lumistack devices`: lists the graphics processors that can compute patterns.

use lumistack_pipeline::PipelineError;
use serde_json::json;

use crate::console::say;

/// A graphics adapter.
#[cfg_attr(not(feature = "gpu"), allow(dead_code, reason = "without the feature none is listed"))]
pub(crate) struct Adapter {
    pub(crate) name: String,
    backend: String,
    kind: String,
    driver: String,
    /// Size of the largest buffer, and size of the largest part of a buffer that a shader can read,
    /// bytes.
    buffer_bytes: [u64; 2],
    pub(crate) is_hardware: bool,
}

/// Finds all adapters, or returns the reason why this program cannot search for adapters.
#[cfg(feature = "gpu")]
pub(crate) fn found() -> Result<Vec<Adapter>, String> {
    let of = |adapter: lumistack_pipeline::GpuAdapter| Adapter {
        name: adapter.name,
        backend: adapter.backend,
        kind: adapter.kind.into(),
        driver: adapter.driver,
        buffer_bytes: adapter.buffer_bytes,
        is_hardware: adapter.is_hardware,
    };
    Ok(lumistack_pipeline::gpu_adapters().into_iter().map(of).collect())
}

/// Finds all adapters, or returns the reason why this program cannot search for adapters.
#[cfg(not(feature = "gpu"))]
pub(crate) fn found() -> Result<Vec<Adapter>, String> {
    Err("this program is built without the feature `gpu`".into())
}

/// Describes an adapter in one line.
pub(crate) fn line(adapter: &Adapter) -> String {
    let Adapter { name, backend, kind, driver, buffer_bytes, .. } = adapter;
    let [buffer, binding] = buffer_bytes.map(|bytes| bytes >> 20);
    format!(
        "{name}, {kind}, {backend}, {driver}; a buffer has up to {buffer} MiB, and a shader reads up to {binding} MiB of it"
    )
}

/// Lists the adapters.
///
/// # Errors
/// Never; all commands have this signature.
pub(crate) fn run(as_json: bool) -> Result<(), PipelineError> {
    let adapters = found();
    let listed = adapters.as_deref().unwrap_or_default();
    let first = listed.iter().position(|adapter| adapter.is_hardware);
    if as_json {
        let of = |(index, a): (usize, &Adapter)| {
            json!({
                "name": a.name, "backend": a.backend, "kind": a.kind, "driver": a.driver,
                "buffer_bytes": a.buffer_bytes[0], "binding_bytes": a.buffer_bytes[1], "auto": first == Some(index),
            })
        };
        let devices: Vec<_> = listed.iter().enumerate().map(of).collect();
        say!("{}", json!({ "event": "devices", "devices": devices, "note": adapters.as_ref().err() }));
        return Ok(());
    }
    for (index, adapter) in listed.iter().enumerate() {
        say!("{} {}", if first == Some(index) { "*" } else { " " }, line(adapter));
    }
    match (&adapters, first) {
        (Err(why), _) => say!("{why}; the processor computes the patterns"),
        (Ok(_), None) => {
            say!("found no graphics processor with Vulkan, Metal or Direct3D 12, so `--device auto` uses the processor")
        }
        (Ok(_), Some(_)) => say!("`--device auto` uses the graphics processor that is marked with *"),
    }
    Ok(())
}
