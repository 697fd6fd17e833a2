//! An open device: its buffers and compiled shaders, and the first failure that it reported.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use lumistack_factorizer::FactorizeError;

use crate::adapters::{self, Adapter};
use crate::text::{FIRST_FACTOR, Program};
use crate::wait;

/// Largest number of bytes that are written or read in one step.
pub(crate) const CHUNK: u64 = 32 << 20;

/// Number of threads of a workgroup, as in the shaders.
pub(crate) const GROUP: usize = 64;

/// Appends the bytes of values. The loop compiles to a plain copy of memory; an iterator over
/// single bytes would not.
pub(crate) fn append<T: Copy, const N: usize>(to: &mut Vec<u8>, values: &[T], bytes_of: impl Fn(T) -> [u8; N]) {
    let start = to.len();
    to.resize(start + N * values.len(), 0);
    for (bytes, value) in to[start..].as_chunks_mut::<N>().0.iter_mut().zip(values) {
        *bytes = bytes_of(*value);
    }
}

/// An open graphics device.
pub struct Gpu {
    adapter: Adapter,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) limits: wgpu::Limits,
    /// Largest number of results that a workgroup writes: one result per subgroup, or a single
    /// result if shaders do not sum by subgroups.
    pub(crate) parts: usize,
    programs: Mutex<HashMap<String, wgpu::ComputePipeline>>,
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the first adapter whose name contains `name`, ignoring case. Without `name`, opens the
    /// first graphics processor.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] if there is no such adapter, or if it does not open.
    pub fn open(name: Option<&str>) -> Result<Self, FactorizeError> {
        let failed = |device: &str, why: String| FactorizeError::Device { device: device.into(), why };
        let (adapter, found) = adapters::choose(name).map_err(|why| failed(name.unwrap_or("gpu"), why))?;
        let limits = found.limits();
        // In a web page no subgroups are used: a browser requires the line `enable subgroups;` in
        // WGSL, which wgpu's own parser does not know.
        let offered = if cfg!(target_arch = "wasm32") { wgpu::Features::empty() } else { found.features() };
        let features = offered & wgpu::Features::SUBGROUP;
        let least = found.get_info().subgroup_min_size.max(1) as usize;
        let parts = if features.is_empty() { 1 } else { GROUP.div_ceil(least) };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("factorizer"),
            required_features: features,
            required_limits: limits.clone(),
            ..Default::default()
        };
        let (device, queue) = wait::block_on(async move { found.request_device(&descriptor).await })
            .map_err(|error| failed(&adapter.name, error.to_string()))?;
        let failure = Arc::new(Mutex::new(None));
        let record = |failure: &Arc<Mutex<Option<String>>>| {
            let failure = failure.clone();
            move |why: String| {
                failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(why);
            }
        };
        let (heard, lost) = (record(&failure), record(&failure));
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| heard(error.to_string())));
        // If a web page loses its device, the solver continues on the processor. So in a page this
        // error states no remedy.
        let remedy = if cfg!(target_arch = "wasm32") {
            ""
        } else {
            "; repeat the command, or solve on the processor with --device cpu"
        };
        device.set_device_lost_callback(move |_, message| {
            lost(format!("the device was lost: {message}").trim_end_matches(": ").to_owned() + remedy);
        });
        Ok(Self { adapter, device, queue, limits, parts, programs: Mutex::default(), failure })
    }

    /// Returns the adapter of the device.
    pub fn adapter(&self) -> &Adapter {
        &self.adapter
    }

    /// Lowers the device's limit for the size of a storage buffer's binding, so that tests can
    /// divide small problems into bands.
    #[must_use]
    pub fn with_binding_bytes(mut self, bytes: u64) -> Self {
        self.limits.max_storage_buffer_binding_size = self.limits.max_storage_buffer_binding_size.min(bytes);
        self
    }

    /// Makes shaders sum without subgroups, so that tests can compare these sums with sums by
    /// subgroups.
    #[must_use]
    pub fn without_subgroups(mut self) -> Self {
        self.parts = 1;
        self
    }

    /// Destroys the device for tests, as a reset of the driver does.
    pub fn lose(&self) {
        self.device.destroy();
    }

    /// Records a failure; the first one is kept.
    pub(crate) fn record(&self, why: String) {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(why);
    }

    /// Makes an error that names the device.
    pub(crate) fn error(&self, why: String) -> FactorizeError {
        FactorizeError::Device { device: self.adapter.name.clone(), why }
    }

    /// Returns the first failure as an error.
    pub(crate) fn check(&self) -> Result<(), FactorizeError> {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        failure.as_ref().map_or(Ok(()), |why| Err(self.error(why.clone())))
    }

    /// Allocates a buffer of at least `words` words. It is never empty, since an empty buffer
    /// cannot be bound.
    pub(crate) fn buffer(&self, words: u64) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 4 * words.max(4),
            usage,
            mapped_at_creation: false,
        })
    }

    /// Waits until all submitted work is done.
    pub(crate) fn wait(&self) {
        if let Err(error) = self.device.poll(wgpu::PollType::wait_indefinitely()) {
            self.record(error.to_string());
        }
    }

    /// Writes words to a buffer in chunks, since the words of a chunk are in memory twice until
    /// they are copied.
    pub(crate) fn write<T: Copy>(&self, buffer: &wgpu::Buffer, words: &[T], bytes_of: impl Fn(T) -> [u8; 4]) {
        let per_chunk = (CHUNK / 4) as usize;
        let mut bytes = Vec::new();
        for (index, part) in words.chunks(per_chunk).enumerate() {
            bytes.clear();
            append(&mut bytes, part, &bytes_of);
            self.queue.write_buffer(buffer, index as u64 * CHUNK, &bytes);
            if words.len() > per_chunk {
                self.queue.submit([]);
                self.wait();
            }
        }
    }

    /// Reads floats; returns zeros if the device is lost.
    pub(crate) fn read(&self, buffer: &wgpu::Buffer, count: usize) -> Vec<f32> {
        let mut floats = Vec::with_capacity(count);
        let bytes = 4 * count as u64;
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: bytes.clamp(4, CHUNK),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        // read in chunks, through one staging buffer
        for start in (0..bytes).step_by(CHUNK as usize) {
            let len = (bytes - start).min(CHUNK);
            let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_buffer_to_buffer(buffer, start, &staging, 0, len);
            self.queue.submit([encoder.finish()]);
            let mapped = wait::answer(|reply| {
                staging.map_async(wgpu::MapMode::Read, 0..len, reply);
                self.wait();
            });
            let unread = || "the device does not answer".to_owned();
            let mapped = mapped.ok_or_else(unread);
            match mapped.and_then(|result| result.map_err(|error| format!("{}: {error}", unread()))) {
                Ok(()) => match staging.get_mapped_range(0..len) {
                    Ok(view) => {
                        let words = view.as_chunks::<4>().0;
                        floats.extend(words.iter().map(|word| f32::from_le_bytes(*word)));
                    }
                    Err(error) => self.record(error.to_string()),
                },
                Err(error) => self.record(error),
            }
            staging.unmap();
        }
        floats.resize(count, 0.0);
        floats
    }

    /// Returns the layout of bindings that all shaders for a number of factors share.
    pub(crate) fn layout(&self, factors: usize) -> wgpu::BindGroupLayout {
        let binding = |binding: usize| {
            let ty = match binding {
                0 => wgpu::BufferBindingType::Uniform,
                4..=6 => wgpu::BufferBindingType::Storage { read_only: false },
                _ => wgpu::BufferBindingType::Storage { read_only: true },
            };
            wgpu::BindGroupLayoutEntry {
                binding: binding as u32,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
                count: None,
            }
        };
        let entries: Vec<_> = (0..FIRST_FACTOR + factors).map(binding).collect();
        self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries })
    }

    /// Compiles a shader, or returns it from the cache.
    pub(crate) fn program(&self, program: &Program, layout: &wgpu::BindGroupLayout) -> wgpu::ComputePipeline {
        let text = program.text();
        let mut programs = self.programs.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = programs.get(&text) {
            return known.clone();
        }
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("factorizer"),
            source: wgpu::ShaderSource::Wgsl(text.as_str().into()),
        });
        let made = self.pipeline(&module, layout, "main");
        programs.insert(text, made.clone());
        made
    }

    pub(crate) fn pipeline(
        &self,
        module: &wgpu::ShaderModule,
        layout: &wgpu::BindGroupLayout,
        entry: &str,
    ) -> wgpu::ComputePipeline {
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(layout)],
            immediate_size: 0,
        });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: Some(&layout),
            module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
            cache: None,
        })
    }
}
