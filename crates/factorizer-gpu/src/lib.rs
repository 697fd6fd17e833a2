//! The factorizer's updates as compute shaders, on any adapter of wgpu with Vulkan, Metal or
//! Direct3D 12, and in a page with WebGPU.
//!
//! ```text
//! Plan ──tables──▶ words ┐
//! target, weights ───────┼──▶ buffers ─┬─▶ update.wgsl ──▶ next values
//! start ─────────────────┘             │   one thread per pixel: sums over its rays, step
//!                                      └─▶ errors.wgsl ──▶ objective
//!                                          one thread per field pixel: errors of all views
//! ```
//!
//! Updates run in the same order as on the processor: this crate only implements
//! [`lumistack_factorizer::device::Updater`]. Every shader is generated for the problem's N and M,
//! so sums stay in registers (`text.rs`). The results equal the processor's up to rounding. They
//! are the same in every run on one device and driver.
//!
//! Targets of half floats stay half floats. A buffer holds one channel. A shader binds windows of
//! buffers, in bands of lines that fit the device (`bands.rs`). Layers with blur, crosstalk, colour
//! filters or one value for all channels are an error. Patterns for panels of few bits are
//! re-optimized on the processor.

mod adapters;
mod bands;
mod gpu;
mod measure;
mod state;
mod tables;
mod target;
mod text;
mod values;
mod wait;

use std::sync::Arc;

use lumistack_display::LayerStack;
use lumistack_factorizer::device::{Begin, Executor, Updater};
use lumistack_factorizer::{FactorizeError, Problem, Run, Solver, solver, start_on};

pub use adapters::{Adapter, adapters};
pub use measure::Limits;

/// Hash of this crate's sources, computed by the build script. It is part of the keys of all cached
/// results that this code contributes to.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// An open device; clones of this value share it.
#[derive(Clone)]
pub struct Device {
    gpu: Arc<gpu::Gpu>,
}

impl Device {
    /// Opens the first adapter whose name contains `name`, ignoring case. Without `name`, opens the
    /// first graphics processor.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] if there is no such adapter, or if it does not open.
    pub fn open(name: Option<&str>) -> Result<Self, FactorizeError> {
        Ok(Self { gpu: Arc::new(gpu::Gpu::open(name)?) })
    }

    /// Returns the adapter of the device.
    pub fn adapter(&self) -> &Adapter {
        self.gpu.adapter()
    }

    /// Checks that the device exists and that nothing has failed so far.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] with the first failure. A new [`open`](Self::open) may succeed.
    pub fn check(&self) -> Result<(), FactorizeError> {
        self.gpu.check()
    }

    /// Opens the device again with a lower limit of `bytes` per binding, so that tests can divide
    /// small problems into bands.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn with_binding_bytes(&self, bytes: u64) -> Result<Self, FactorizeError> {
        let gpu = gpu::Gpu::open(Some(&self.adapter().name))?.with_binding_bytes(bytes);
        Ok(Self { gpu: Arc::new(gpu) })
    }

    /// Returns true if shaders sum their results by subgroups, an optional feature of adapters.
    pub fn has_subgroups(&self) -> bool {
        self.gpu.parts > 1
    }

    /// Opens the device again without subgroups, so that tests can compare sums with and without
    /// them.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn without_subgroups(&self) -> Result<Self, FactorizeError> {
        let gpu = gpu::Gpu::open(Some(&self.adapter().name))?.without_subgroups();
        Ok(Self { gpu: Arc::new(gpu) })
    }

    /// Destroys the device for tests, as a reset of the driver does.
    pub fn lose(&self) {
        self.gpu.lose();
    }

    /// Measures the device's limits by two small kernels.
    pub fn measured_limits(&self) -> Limits {
        measure::limits(&self.gpu)
    }

    /// Returns a solver that keeps its patterns on this device.
    ///
    /// # Errors
    /// If no solver has this name; the error lists all names.
    pub fn solver(&self, name: &str) -> Result<OnDevice, FactorizeError> {
        Ok(OnDevice { device: self.clone(), on_processor: solver(name)? })
    }
}

impl Executor for Device {
    fn begin(&self, begin: Begin) -> Result<Box<dyn Updater>, FactorizeError> {
        Ok(Box::new(state::State::begin(self.gpu.clone(), begin)?))
    }
}

/// A solver that keeps its patterns on a device.
pub struct OnDevice {
    device: Device,
    /// The same solver on the processor.
    on_processor: &'static dyn Solver,
}

impl Solver for OnDevice {
    fn name(&self) -> &'static str {
        self.on_processor.name()
    }

    fn doc(&self) -> &'static str {
        self.on_processor.doc()
    }

    fn start<'a>(&self, problem: &Problem<'a>, start: LayerStack) -> Result<Box<dyn Run + 'a>, FactorizeError> {
        start_on(&self.device, self.on_processor.name(), problem, start)
    }
}
