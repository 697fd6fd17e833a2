//! The device of the solver: the processor, or a graphics processor in a build with the feature
//! `gpu`.

use lumistack_core::Task;
use lumistack_factorizer::device::Executor;
use lumistack_factorizer::{FactorizeError, Processor};

use crate::error::PipelineError;
use crate::store::key::KeyBuilder;

/// An open device to solve on.
pub(crate) enum SolverDevice {
    Processor,
    #[cfg(feature = "gpu")]
    Device {
        device: lumistack_factorizer_gpu::Device,
        /// True if the job requests no graphics processor, so that the processor may replace it.
        optional: bool,
    },
}

impl SolverDevice {
    /// Opens the device that a job names: `auto`, `cpu`, `gpu` or `gpu:NAME`.
    ///
    /// # Errors
    /// If the name is another one, or the device is missing.
    pub(crate) fn of(device: &str) -> Result<Self, PipelineError> {
        check(device)?;
        #[cfg(feature = "gpu")]
        {
            use lumistack_factorizer_gpu::Device;
            let name = device.strip_prefix("gpu:");
            match device {
                "cpu" => {}
                // Without a usable graphics processor, `auto` is the processor.
                "auto" => {
                    if let Ok(device) = Device::open(None) {
                        return Ok(Self::Device { device, optional: true });
                    }
                }
                _ => {
                    let device = Device::open(name).map_err(PipelineError::Factorize)?;
                    return Ok(Self::Device { device, optional: false });
                }
            }
        }
        Ok(Self::Processor)
    }

    pub(crate) fn executor(&self) -> &dyn Executor {
        match self {
            Self::Processor => &Processor,
            #[cfg(feature = "gpu")]
            Self::Device { device, .. } => device,
        }
    }

    /// True if the processor may replace the device.
    fn is_optional(&self) -> bool {
        match self {
            Self::Processor => false,
            #[cfg(feature = "gpu")]
            Self::Device { optional, .. } => *optional,
        }
    }

    /// Adds the device to a key: its rounding differs from the processor's.
    pub(crate) fn add_to(&self, key: &mut KeyBuilder) {
        match self {
            // Results of the processor have equal keys in builds with and without the feature.
            Self::Processor => _ = key,
            #[cfg(feature = "gpu")]
            Self::Device { device, .. } => {
                let adapter = device.adapter();
                let parts = (lumistack_factorizer_gpu::FINGERPRINT, &adapter.name, &adapter.backend, &adapter.driver);
                key.add_json("device", &parts);
            }
        }
    }
}

/// Executes work on a job's device. If `auto` selected a graphics processor that fails, the
/// processor repeats the work, with a warning.
///
/// # Errors
/// Those of the work and of [`SolverDevice::of`].
pub(crate) fn on_device<T>(
    device: &str,
    task: Task<'_>,
    mut work: impl FnMut(&SolverDevice) -> Result<T, PipelineError>,
) -> Result<T, PipelineError> {
    let site = SolverDevice::of(device)?;
    match work(&site) {
        Err(PipelineError::Factorize(error @ FactorizeError::Device { .. })) if site.is_optional() => {
            task.warn("device", format!("{error}; solving on the processor instead"));
            work(&SolverDevice::Processor)
        }
        result => result,
    }
}

/// Checks the device name of a job, without opening the device.
///
/// # Errors
/// If the name is unknown, or this build has no code for the device.
pub(crate) fn check(device: &str) -> Result<(), PipelineError> {
    let is_gpu = device == "gpu" || device.strip_prefix("gpu:").is_some_and(|name| !name.is_empty());
    if is_gpu && !cfg!(feature = "gpu") {
        let expected = "`auto` or `cpu`: this program is built without the feature `gpu`";
        return Err(PipelineError::job("factorize.device", expected, format!("`{device}`")));
    }
    if is_gpu || device == "auto" || device == "cpu" {
        return Ok(());
    }
    Err(PipelineError::job("factorize.device", "`auto`, `cpu`, `gpu` or `gpu:NAME`", format!("`{device}`")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_that_name_no_device_are_refused() {
        for good in ["auto", "cpu"] {
            check(good).unwrap();
        }
        assert!(matches!(SolverDevice::of("cpu").unwrap(), SolverDevice::Processor));
        for bad in ["", "gpu:", "GPU", "cuda"] {
            assert!(check(bad).unwrap_err().to_string().contains("factorize.device"), "{bad}");
        }
        assert_eq!(check("gpu:llvmpipe").is_ok(), cfg!(feature = "gpu"));
    }
}
