//! The device of the solver: the processor or, if the program is built with the feature `gpu`, a
//! graphics processor.

use lumistack_core::Task;
use lumistack_factorizer::device::Executor;
use lumistack_factorizer::{FactorizeError, Processor};

use crate::error::PipelineError;
use crate::store::key::KeyBuilder;

/// A device of the solver, open for use.
pub(crate) enum SolverDevice {
    Processor,
    #[cfg(feature = "gpu")]
    Device {
        device: lumistack_factorizer_gpu::Device,
        /// True if the job's device is `auto`. Only then may the processor replace this graphics
        /// processor.
        optional: bool,
    },
}

impl SolverDevice {
    /// Opens the device that a job names: `auto`, `cpu`, `gpu` or `gpu:NAME`.
    ///
    /// # Errors
    /// If the name is none of these, or the device is not available.
    pub(crate) fn of(device: &str) -> Result<Self, PipelineError> {
        check(device)?;
        #[cfg(feature = "gpu")]
        if device != "cpu" {
            let optional = device == "auto";
            return match opened(device.strip_prefix("gpu:")) {
                Ok(device) => Ok(Self::Device { device, optional }),
                // Without a usable graphics processor, `auto` selects the processor.
                Err(_) if optional => Ok(Self::Processor),
                Err(error) => Err(PipelineError::Factorize(error)),
            };
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

    /// Returns true if the processor may replace the device.
    fn is_optional(&self) -> bool {
        match self {
            Self::Processor => false,
            #[cfg(feature = "gpu")]
            Self::Device { optional, .. } => *optional,
        }
    }

    /// Executes work on the device. If an optional device fails, this value becomes the processor,
    /// which repeats the work; a warning reports the failure.
    ///
    /// # Errors
    /// The errors of the work.
    pub(crate) fn run<T>(
        &mut self,
        task: Task<'_>,
        mut work: impl FnMut(&Self) -> Result<T, PipelineError>,
    ) -> Result<T, PipelineError> {
        match work(self) {
            Err(PipelineError::Factorize(error @ FactorizeError::Device { .. })) if self.is_optional() => {
                task.warn("device", format!("{error}; the processor computes the patterns instead"));
                *self = Self::Processor;
                work(self)
            }
            result => result,
        }
    }

    /// Adds the device to a key, since a graphics processor rounds differently from the processor.
    pub(crate) fn add_to(&self, key: &mut KeyBuilder) {
        match self {
            // Add nothing, so that results of the processor have equal keys in builds with and
            // without the feature `gpu`.
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

/// Opens a device, or returns the open device if it has not failed. Opening a device compiles all
/// its shaders, so an open device is reused.
#[cfg(feature = "gpu")]
fn opened(name: Option<&str>) -> Result<lumistack_factorizer_gpu::Device, FactorizeError> {
    use std::collections::BTreeMap;
    use std::sync::{Mutex, PoisonError};

    static OPEN: Mutex<BTreeMap<Option<String>, lumistack_factorizer_gpu::Device>> = Mutex::new(BTreeMap::new());
    let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
    let key = name.map(str::to_owned);
    if let Some(device) = open.get(&key).filter(|device| device.check().is_ok()) {
        return Ok(device.clone());
    }
    let device = lumistack_factorizer_gpu::Device::open(name)?;
    open.insert(key, device.clone());
    Ok(device)
}

/// Executes work on the device of a job. If `auto` selected a graphics processor and it fails, the
/// processor repeats the work, with a warning.
///
/// # Errors
/// The errors of the work and of [`SolverDevice::of`].
pub(crate) fn on_device<T>(
    device: &str,
    task: Task<'_>,
    work: impl FnMut(&SolverDevice) -> Result<T, PipelineError>,
) -> Result<T, PipelineError> {
    SolverDevice::of(device)?.run(task, work)
}

/// Checks the device name of a job, but does not open the device.
///
/// # Errors
/// If the name is unknown, or this build has no code for the device.
pub(crate) fn check(device: &str) -> Result<(), PipelineError> {
    let is_gpu = device == "gpu" || device.strip_prefix("gpu:").is_some_and(|name| !name.is_empty());
    if is_gpu && !cfg!(feature = "gpu") {
        let expected = "`auto` or `cpu`, since this program is built without the feature `gpu`";
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

    /// A lost device is an error if the job names the device. If the job's device is `auto`, the
    /// processor replaces the lost device, with a warning.
    #[cfg(feature = "gpu")]
    #[test]
    fn the_processor_replaces_a_lost_device_that_the_job_does_not_name() {
        use lumistack_core::{Cancel, Collector};
        use lumistack_display::{Display, LightField, Weights};
        use lumistack_factorizer_gpu::Device;

        use crate::job::FactorizeJob;
        use crate::stage::factorize::Solve;

        let display = Display::uniform([20, 12], 1.0, [3, 3], [20.0; 2], &[-2.0, 2.0], 2);
        let target = LightField::black(display.geometry().unwrap()).unwrap();
        let job = FactorizeJob { iterations: Some(2), ..Default::default() };
        let solve = Solve { job: &job, seed: 1, display: &display, target: &target, weights: &Weights::Uniform };
        for optional in [true, false] {
            let device = match Device::open(Some("")) {
                Ok(device) => device,
                Err(error) => return lumistack_testkit::skip::skipped(&error.to_string()),
            };
            device.lose();
            let (warnings, cancel) = (Collector::default(), Cancel::default());
            let task = Task::quiet(&warnings, &cancel);
            let mut site = SolverDevice::Device { device, optional };
            let result = site.run(task, |site| solve.factorize(site, None, task, &mut |_| ()));
            assert_eq!(matches!(site, SolverDevice::Processor), optional);
            let notes: Vec<String> = warnings.take().into_iter().map(|warning| warning.message).collect();
            match result {
                Ok(_) => assert!(optional && notes.iter().any(|note| note.contains("lost")), "{notes:?}"),
                Err(error) => assert!(!optional && error.to_string().contains("lost"), "{error}"),
            }
        }
    }
}
