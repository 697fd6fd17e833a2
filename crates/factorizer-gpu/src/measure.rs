//! Measures the limits of a device, with which the speed of its updates is compared.

use std::time::Instant;

use crate::gpu::Gpu;

/// Limits of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Bytes per second, read and written, of a kernel that copies.
    pub bytes_per_s: f64,
    /// Multiply-adds of f32 per second.
    pub multiply_adds_per_s: f64,
}

/// Multiply-adds per thread of the kernel `multiply_add`.
const MULTIPLY_ADDS: f64 = 8.0 * 4.0 * 64.0;
/// Number of threads; each copies 16 bytes. Their data exceed the caches of graphics processors.
const THREADS: u64 = 1 << 24;
const ROUNDS: usize = 5;
/// A timed submission takes at least this long, seconds: dispatches are added until it does.
const LEAST_SECONDS: f64 = 0.02;

/// Measures the limits. Each kernel runs several times, and the fastest run is taken.
pub(crate) fn limits(gpu: &Gpu) -> Limits {
    // use fewer threads if their data exceed the device's buffers
    let fits = gpu.limits.max_storage_buffer_binding_size.min(gpu.limits.max_buffer_size) / 16;
    let threads = THREADS.min(fits / 64 * 64);
    let [from, to] = [0; 2].map(|_| gpu.buffer(4 * threads));
    let entry = |binding: u32, read_only: bool| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };
    // use one layout for both kernels
    let entries = [entry(0, true), entry(1, false)];
    let layout =
        gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries });
    let entries = [&from, &to].map(wgpu::Buffer::as_entire_binding);
    let mut binding = 0..;
    let entries =
        entries.map(|resource| wgpu::BindGroupEntry { binding: binding.next().unwrap_or_default(), resource });
    let group =
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout: &layout, entries: &entries });
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("limits"),
        source: wgpu::ShaderSource::Wgsl(include_str!("shaders/measure.wgsl").into()),
    });
    let groups = (threads / 64) as u32;
    let across = groups.min(1 << 12);
    // Returns the shortest time per dispatch. Each submission holds enough dispatches that the time
    // to start and end the submission is negligible.
    let fastest = |entry: &str| {
        let pipeline = gpu.pipeline(&module, &layout, entry);
        let timed = |dispatches: u32| {
            let start = Instant::now();
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &group, &[]);
                (0..dispatches).for_each(|_| pass.dispatch_workgroups(across, groups / across, 1));
            }
            gpu.queue.submit([encoder.finish()]);
            gpu.wait();
            start.elapsed().as_secs_f64()
        };
        // the first run compiles, so it is not timed
        timed(1);
        let mut dispatches = 1;
        while timed(dispatches) < LEAST_SECONDS {
            dispatches *= 2;
        }
        (0..ROUNDS).map(|_| timed(dispatches) / f64::from(dispatches)).fold(f64::INFINITY, f64::min)
    };
    let done = f64::from(groups / across * across) * 64.0;
    Limits {
        bytes_per_s: 32.0 * done / fastest("copy"),
        multiply_adds_per_s: MULTIPLY_ADDS * done / fastest("multiply_add"),
    }
}
