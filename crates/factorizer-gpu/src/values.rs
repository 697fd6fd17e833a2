//! Values of one factor on a device: a buffer per channel, `[line][frame][column]`.

use lumistack_factorizer::device::{Factor, Plan};

use crate::gpu::Gpu;

/// Buffers of one factor, per channel.
pub(crate) struct Values {
    /// Values that rays read.
    pub(crate) current: Vec<wgpu::Buffer>,
    /// Buffers that the next update writes. After an update they are swapped with `current`. So
    /// between updates they hold the values before the last update.
    pub(crate) next: Vec<wgpu::Buffer>,
    /// The last iterate, if rays read extrapolated values.
    pub(crate) latest: Option<Vec<wgpu::Buffer>>,
    words: u64,
}

impl Values {
    pub(crate) fn upload(gpu: &Gpu, plan: &Plan, n: usize, factor: &Factor) -> Self {
        let ([lines, cols], frames) = (plan.size(n), plan.frames());
        let words = (lines * frames * cols) as u64;
        let buffers = || (0..plan.channels()).map(|_| gpu.buffer(words)).collect();
        let (current, next): (Vec<_>, Vec<_>) = (buffers(), buffers());
        for (channel, buffer) in current.iter().enumerate() {
            let mut values = Vec::with_capacity(words as usize);
            for (line, frame) in (0..lines).flat_map(|line| (0..frames).map(move |frame| (line, frame))) {
                values.extend_from_slice(factor.values(channel, line, frame));
            }
            gpu.write(buffer, &values, f32::to_le_bytes);
        }
        Self { current, next, latest: None, words }
    }

    /// Copies the values to this machine.
    pub(crate) fn download(&self, gpu: &Gpu, plan: &Plan, n: usize) -> Factor {
        let ([lines, cols], frames) = (plan.size(n), plan.frames());
        let mut factor = Factor::of(plan, n);
        for (channel, buffer) in self.current.iter().enumerate() {
            let values = gpu.read(buffer, lines * frames * cols);
            for (index, row) in values.chunks_exact(cols).enumerate() {
                factor.values_mut(channel, index / frames, index % frames).copy_from_slice(row);
            }
        }
        factor
    }

    /// Allocates the last iterate as a copy of the current values, unless it exists already.
    pub(crate) fn begin_latest(&mut self, gpu: &Gpu) {
        if self.latest.is_none() {
            self.latest = Some(self.current.iter().map(|_| gpu.buffer(self.words)).collect());
            self.copy_to_latest(gpu);
        }
    }

    /// Copies the current values to the last iterate.
    pub(crate) fn copy_to_latest(&self, gpu: &Gpu) {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (from, to) in self.current.iter().zip(self.latest.iter().flatten()) {
            encoder.copy_buffer_to_buffer(from, 0, to, 0, 4 * self.words);
        }
        gpu.queue.submit([encoder.finish()]);
    }

    /// Exchanges the current values and the last iterate.
    pub(crate) fn swap_latest(&mut self) {
        if let Some(latest) = &mut self.latest {
            std::mem::swap(&mut self.current, latest);
        }
    }

    /// Exchanges `current` and `next`. The first call after an update makes the new values current;
    /// a second call makes the values before the update current again.
    pub(crate) fn swap_next(&mut self) {
        std::mem::swap(&mut self.current, &mut self.next);
    }
}
