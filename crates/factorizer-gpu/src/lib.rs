//! The factorizer's updates as compute shaders, on any adapter of wgpu with Vulkan, Metal or Direct3D 12.
//!
//! ```text
//! Plan ──tables──▶ words ┐
//! target, weights ───────┼──▶ buffers ──▶ update.wgsl  one thread per pixel: sums over its rays, step   ──▶ next values
//! start ─────────────────┘               errors.wgsl  one thread per field pixel: errors of all views
//! ```
//!
//! The schedule is the processor's own: [`lumistack_factorizer::device::Updater`] is all that is done here. Every shader is written for the problem's N
//! and M, so that sums stay in registers (`text.rs`). The results are the processor's up to rounding, and the same in every run on one device and driver.
//!
//! Targets of half floats stay half floats. A buffer holds a channel; a shader binds windows of buffers, in bands of lines that fit the device
//! (`bands.rs`). Layers with blur, crosstalk, colour filters or tied channels are refused, and panels of few bits are re-optimized on the processor.

mod adapters;
mod bands;
mod gpu;
mod measure;
mod state;
mod tables;
mod target;
mod text;
mod values;

use std::sync::Arc;

use lumistack_display::LayerStack;
use lumistack_factorizer::device::{Begin, Executor, Updater};
use lumistack_factorizer::{FactorizeError, Problem, Run, Solver, solver, start_on};

pub use adapters::{Adapter, adapters};
pub use measure::Limits;

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// An open device; clones are the same one.
#[derive(Clone)]
pub struct Device {
    gpu: Arc<gpu::Gpu>,
}

impl Device {
    /// Opens the first graphics processor, or the first adapter of any kind whose name contains `name`, whatever its case.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] if there is none, or it does not open.
    pub fn open(name: Option<&str>) -> Result<Self, FactorizeError> {
        Ok(Self { gpu: Arc::new(gpu::Gpu::open(name)?) })
    }

    /// The adapter that was opened.
    pub fn adapter(&self) -> &Adapter {
        self.gpu.adapter()
    }

    /// Whether the device is still there, and everything went well so far.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] with the first that did not. Another [`open`](Self::open) may find the device well again.
    pub fn check(&self) -> Result<(), FactorizeError> {
        self.gpu.check()
    }

    /// Binds no more than so many bytes at a time, so that larger problems are cut into bands; for tests. Opens the device again.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn with_binding_bytes(&self, bytes: u64) -> Result<Self, FactorizeError> {
        let gpu = gpu::Gpu::open(Some(&self.adapter().name))?.with_binding_bytes(bytes);
        Ok(Self { gpu: Arc::new(gpu) })
    }

    /// Gives the device up, as a driver does that was reset; for tests.
    pub fn lose(&self) {
        self.gpu.lose();
    }

    /// What the device can do at most, by two small kernels.
    pub fn measured_limits(&self) -> Limits {
        measure::limits(&self.gpu)
    }

    /// A solver whose patterns live on this device.
    ///
    /// # Errors
    /// If there is none of that name; the error lists all names.
    pub fn solver(&self, name: &str) -> Result<OnDevice, FactorizeError> {
        Ok(OnDevice { device: self.clone(), twin: solver(name)? })
    }
}

impl Executor for Device {
    fn begin(&self, begin: Begin) -> Result<Box<dyn Updater>, FactorizeError> {
        Ok(Box::new(state::State::begin(self.gpu.clone(), begin)?))
    }
}

/// A solver on a device.
pub struct OnDevice {
    device: Device,
    /// The same on the processor.
    twin: &'static dyn Solver,
}

impl Solver for OnDevice {
    fn name(&self) -> &'static str {
        self.twin.name()
    }

    fn doc(&self) -> &'static str {
        self.twin.doc()
    }

    fn start<'a>(&self, problem: &Problem<'a>, start: LayerStack) -> Result<Box<dyn Run + 'a>, FactorizeError> {
        start_on(&self.device, self.twin.name(), problem, start)
    }
}
