//! The adapters of this machine, and the choice of one for a solver.

use wgpu::{Backends, DeviceType};

use crate::wait;

/// A graphics adapter, as its driver describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct Adapter {
    /// Name of the adapter.
    pub name: String,
    /// Interface to the adapter: `vulkan`, `metal`, `dx12` or `browserwebgpu`.
    pub backend: String,
    /// Kind: `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: &'static str,
    /// Name and version of the driver.
    pub driver: String,
    /// Largest size of a buffer, and of the region of a buffer that a shader can read, bytes.
    pub buffer_bytes: [u64; 2],
    /// True for a graphics processor; `auto` selects only such adapters.
    pub is_hardware: bool,
}

/// Returns all adapters, in the order in which `auto` prefers them.
pub fn adapters() -> Vec<Adapter> {
    found().iter().map(|(adapter, _)| adapter.clone()).collect()
}

fn found() -> Vec<(Adapter, wgpu::Adapter)> {
    // leave out OpenGL: without a graphical session its driver writes to standard error
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    descriptor.backends = Backends::PRIMARY;
    let instance = wgpu::Instance::new(descriptor);
    let mut all: Vec<_> = wait::block_on(async move { instance.enumerate_adapters(Backends::PRIMARY).await })
        .into_iter()
        .map(|adapter| (described(&adapter), adapter))
        .collect();
    let rank = |kind: &str| ["discrete", "integrated", "virtual", "other"].iter().position(|k| *k == kind).unwrap_or(4);
    all.sort_by_key(|(adapter, _)| rank(adapter.kind));
    all
}

fn described(adapter: &wgpu::Adapter) -> Adapter {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    let kind = match info.device_type {
        DeviceType::DiscreteGpu => "discrete",
        DeviceType::IntegratedGpu => "integrated",
        DeviceType::VirtualGpu => "virtual",
        DeviceType::Cpu => "software",
        DeviceType::Other => "other",
    };
    Adapter {
        // most browsers keep the name secret
        name: if info.name.is_empty() { "graphics processor".into() } else { info.name },
        backend: format!("{:?}", info.backend).to_lowercase(),
        kind,
        driver: [info.driver, info.driver_info].join(" ").trim().to_owned(),
        buffer_bytes: [limits.max_buffer_size, limits.max_storage_buffer_binding_size],
        // A browser does not report the kind of an adapter, so every browser adapter of kind
        // `other` is taken as a graphics processor.
        is_hardware: ["discrete", "integrated", "virtual"].contains(&kind)
            || (info.backend == wgpu::Backend::BrowserWebGpu && kind == "other"),
    }
}

/// Chooses the first adapter whose name contains `name`, ignoring case. Without `name`, chooses the
/// first graphics processor.
///
/// # Errors
/// If no adapter fits; the error lists all adapters.
pub(crate) fn choose(name: Option<&str>) -> Result<(Adapter, wgpu::Adapter), String> {
    let mut all = found();
    let fits = |adapter: &Adapter| match name {
        Some(name) => adapter.name.to_lowercase().contains(&name.to_lowercase()),
        None => adapter.is_hardware,
    };
    let Some(at) = all.iter().position(|(adapter, _)| fits(adapter)) else {
        let names: Vec<_> = all.iter().map(|(a, _)| format!("{} ({}, {})", a.name, a.kind, a.backend)).collect();
        // In a web page the browser, not a driver, offers adapters.
        let none = match cfg!(target_arch = "wasm32") {
            true => "no device that this browser offers by WebGPU",
            false => "no device with Vulkan, Metal or Direct3D 12",
        };
        let found = if names.is_empty() { none.into() } else { names.join("; ") };
        let expected = name
            .map_or("a graphics processor".into(), |name| format!("a graphics processor whose name contains `{name}`"));
        return Err(format!("expected {expected}, found {found}"));
    };
    Ok(all.swap_remove(at))
}
