//! The patterns of a run on a device. An update of [`Updater`] runs one shader, by a dispatch for
//! each channel and band.

use std::sync::Arc;

use lumistack_core::Cancel;
use lumistack_display::{Display, LayerStack};
use lumistack_factorizer::FactorizeError;
use lumistack_factorizer::device::{Begin, ErrorSum, Factor, Outcome, Plan, Rule, Updater, stack_of};

use crate::bands::{Band, BandSizes};
use crate::gpu::{GROUP, Gpu};
use crate::tables::Tables;
use crate::target::Target;
use crate::text::{FIRST_FACTOR, Program, Update};
use crate::values::Values;
use crate::wait;

/// Advice to the user if the device cannot solve a display. In a web page the advice is empty,
/// since the page then solves on the processor by itself.
const REMEDY: &str = if cfg!(target_arch = "wasm32") { "" } else { "; solve on the processor with --device cpu" };

/// The patterns of a run on a device.
pub(crate) struct State {
    gpu: Arc<Gpu>,
    plan: Arc<Plan>,
    display: Display,
    ranges: Vec<[f32; 2]>,
    tries_local: bool,
    cancel: Cancel,
    tables: Tables,
    table_words: wgpu::Buffer,
    target: Target,
    factors: Vec<Values>,
    /// Bands of each factor's lines.
    bands: Vec<Vec<Band>>,
    /// Bands of the field rows.
    row_bands: Vec<Band>,
    layout: wgpu::BindGroupLayout,
    /// Programs that this run has used, by their updates. Generating the text of a program takes
    /// milliseconds, as long as several updates on a fast device.
    programs: Vec<(Option<Update>, wgpu::ComputePipeline)>,
    params: wgpu::Buffer,
    /// Distance between the parameters of successive dispatches in `params`, bytes.
    params_stride: u64,
    sums: wgpu::Buffer,
    /// Buffers for bindings that a program does not use.
    unused: [wgpu::Buffer; 3],
    /// Number of results that the last call of `dispatch` left in `sums`.
    found: usize,
    submitted: Option<wgpu::SubmissionIndex>,
}

impl State {
    /// Copies the patterns of a run to the device.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] if the device cannot solve this display, or has too little
    /// memory.
    pub(crate) fn begin(gpu: Arc<Gpu>, begin: Begin) -> Result<Self, FactorizeError> {
        // refuse displays outside the device's limits with a clear message, before any allocation
        let (plan, n_factors) = (begin.plan.clone(), begin.plan.factor_count());
        if begin.display.layers.iter().any(|layer| layer.response().is_some()) {
            let why = "expected layers without blur, crosstalk, colour filters or one value for all channels, found a layer with one of these properties";
            return Err(gpu.error(format!("{why}{REMEDY}")));
        }
        let limits = &gpu.limits;
        let (bindings, most) = (FIRST_FACTOR - 1 + n_factors, limits.max_storage_buffers_per_shader_stage);
        if bindings > most as usize {
            return Err(gpu.error(format!(
                "{n_factors} layers and backlights need {bindings} buffers in one program, but the device allows at most {most}{REMEDY}"
            )));
        }
        let sizes = (0..n_factors).map(|n| (plan.size(n)[0] * plan.size(n)[1] * plan.frames()) as u64);
        let largest = 4 * sizes.chain([Target::largest(&plan)]).max().unwrap_or(0);
        if largest > limits.max_buffer_size {
            let [needed, allowed] = [largest, limits.max_buffer_size].map(|bytes| bytes.div_ceil(1 << 20));
            return Err(gpu.error(format!(
                "too little memory: one channel needs a buffer of {needed} MiB, but the device allows at most {allowed} MiB{REMEDY}"
            )));
        }
        // wgpu reports failed allocations through error scopes
        let scopes =
            [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::OutOfMemory].map(|f| gpu.device.push_error_scope(f));
        let state = Self::upload(gpu.clone(), begin);
        let errors = scopes.into_iter().rev().map(|scope| wait::block_on(scope.pop()));
        let errors: Vec<_> = errors.flatten().collect();
        if let Some(error) = errors.first() {
            let memory = matches!(error, wgpu::Error::OutOfMemory { .. });
            return Err(gpu.error(if memory {
                format!("too little memory for all buffers of the display{REMEDY}")
            } else {
                error.to_string()
            }));
        }
        gpu.check()?;
        state
    }

    /// Allocates and fills all buffers, and divides the work into bands.
    fn upload(gpu: Arc<Gpu>, begin: Begin) -> Result<Self, FactorizeError> {
        let Begin { plan, display, ranges, factors, tries_local } = begin;
        // copy the problem and the patterns to the device
        let tables = Tables::new(&plan);
        let table_words = gpu.buffer(tables.words.len() as u64);
        gpu.write(&table_words, &tables.words, u32::to_le_bytes);
        let target = Target::upload(&gpu, &plan);
        let factors: Vec<_> =
            factors.iter().enumerate().map(|(n, factor)| Values::upload(&gpu, &plan, n, factor)).collect();
        // divide lines into bands that fit the bindings
        let limits = &gpu.limits;
        let sizes = BandSizes {
            tables: &tables,
            line_words: (0..factors.len()).map(|n| (plan.frames() * plan.size(n)[1]) as u64).collect(),
            target_words: target.row_words,
            weight_words: target.weight_words,
            limit: limits.max_storage_buffer_binding_size,
            align: u64::from(limits.min_storage_buffer_offset_alignment),
            groups: limits.max_compute_workgroups_per_dimension as usize,
        };
        let too_small = || {
            gpu.error(format!(
                "the data of one row of pixels exceed the largest storage buffer that the device can bind{REMEDY}"
            ))
        };
        let bands: Option<Vec<_>> = (0..factors.len()).map(|n| sizes.of_factor(n, plan.size(n)[0])).collect();
        let bands = bands.ok_or_else(too_small)?;
        let row_bands = sizes.of_rows(plan.field()[0]).ok_or_else(too_small)?;
        // allocate room for the parameters and results of the largest number of dispatches
        let dispatches = bands.iter().chain([&row_bands]).map(Vec::len).max().unwrap_or(0) * plan.channels();
        let places = (0..factors.len()).map(|n| plan.size(n)).chain([plan.field()]);
        let groups = places.map(|[lines, cols]| lines * cols.div_ceil(GROUP)).max().unwrap_or(0) * plan.channels();
        let params_stride = u64::from(limits.min_uniform_buffer_offset_alignment)
            .max(4 * (PARAMS + 4 * factors.len()) as u64)
            .next_multiple_of(u64::from(limits.min_uniform_buffer_offset_alignment));
        Ok(Self {
            layout: gpu.layout(factors.len()),
            programs: Vec::new(),
            params: gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("parameters"),
                size: params_stride * dispatches as u64,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            params_stride,
            sums: gpu.buffer(2 * (gpu.parts * groups) as u64),
            unused: [0; 3].map(|_| gpu.buffer(1)),
            found: 0,
            submitted: None,
            cancel: Cancel::default(),
            gpu,
            plan,
            display,
            ranges,
            tries_local,
            tables,
            table_words,
            target,
            factors,
            bands,
            row_bands,
        })
    }

    /// Runs a shader over all bands and channels, and leaves the results in `sums`.
    fn dispatch(&mut self, update: Option<Update>, extrapolation: f32) {
        let plan = self.plan.clone();
        // all bands use one program with different parameters
        let pipeline = self.program(update);
        let (bands, cols) = match update {
            Some(Update { own, .. }) => (&self.bands[own], plan.size(own)[1]),
            None => (&self.row_bands, plan.field()[1]),
        };
        let groups_x = cols.div_ceil(GROUP);
        let (mut words, mut calls, mut found) = (Vec::new(), Vec::new(), 0);
        for (channel, band) in (0..plan.channels()).flat_map(|channel| bands.iter().map(move |band| (channel, band))) {
            let at = words.len() as u64;
            words.extend(
                self.parameters(update, band, extrapolation, [found, groups_x]).into_iter().flat_map(u32::to_le_bytes),
            );
            words.resize((at + self.params_stride) as usize, 0);
            found += groups_x * band.lines.len();
            calls.push((self.bind(update, channel, band, at), band.lines.len()));
        }
        // Wait for the previous update, so that at most one update runs on the device while the
        // next is prepared.
        if let Some(index) = self.submitted.take() {
            let waiting = wgpu::PollType::Wait { submission_index: Some(index), timeout: None };
            if let Err(error) = self.gpu.device.poll(waiting) {
                self.gpu.record(error.to_string());
            }
        }
        // submit all bands together
        self.gpu.queue.write_buffer(&self.params, 0, &words);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            for (group, lines) in &calls {
                pass.set_bind_group(0, group, &[]);
                pass.dispatch_workgroups(groups_x as u32, *lines as u32, 1);
            }
        }
        self.submitted = Some(self.gpu.queue.submit([encoder.finish()]));
        self.found = found * self.gpu.parts;
    }

    /// Returns the program of an update, or the program that computes errors.
    fn program(&mut self, update: Option<Update>) -> wgpu::ComputePipeline {
        if let Some((_, known)) = self.programs.iter().find(|(of, _)| *of == update) {
            return known.clone();
        }
        let weighted = self.target.weights.is_some();
        let program = Program { plan: &self.plan, weighted, parts: self.gpu.parts, update };
        let made = self.gpu.program(&program, &self.layout);
        self.programs.push((update, made.clone()));
        made
    }

    /// Returns the parameters of a dispatch, in the order of `Params` in `read.wgsl`.
    fn parameters(
        &self,
        update: Option<Update>,
        band: &Band,
        extrapolation: f32,
        [found, groups_x]: [usize; 2],
    ) -> Vec<u32> {
        let (plan, tables) = (&self.plan, &self.tables);
        let ([views_y, views_x], [rows, cols]) = (plan.views(), plan.field());
        let own = update.map_or(0, |update| update.own);
        let [own_lines, own_cols] = plan.size(own);
        let sweeps = match update.map(|update| update.rule) {
            Some(Rule::Block { sweeps }) => sweeps,
            _ => 0,
        };
        let [low, high] = self.ranges[own];
        let mut words =
            [views_y, views_x, rows, cols, band.lines.start, band.lines.len(), own_cols].map(|n| n as u32).to_vec();
        words.extend([band.own.start, band.target.start, band.weights.start].map(|at| at as u32));
        words.extend([found as u32, groups_x as u32]);
        words.extend([tables.factors[own].own_lines, tables.factors[own].own_columns, own_lines as u32]);
        words.extend([tables.counted_rows, tables.counted_cols, sweeps]);
        words.extend([plan.brightness(), low, high, extrapolation, plan.unlit_share()].map(f32::to_bits));
        debug_assert_eq!(words.len(), PARAMS);
        for (k, (window, of)) in band.factors.iter().zip(&tables.factors).enumerate() {
            words.extend([plan.size(k)[1] as u32, window.start as u32, of.y, of.x]);
        }
        words
    }

    /// Binds the windows of a dispatch.
    fn bind(&self, update: Option<Update>, channel: usize, band: &Band, params_at: u64) -> wgpu::BindGroup {
        fn window<'a>(buffer: &'a wgpu::Buffer, words: &std::ops::Range<u64>) -> wgpu::BindingResource<'a> {
            let size = std::num::NonZeroU64::new(4 * (words.end - words.start));
            wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: 4 * words.start, size })
        }
        // list the bindings in the order of `read.wgsl`
        let size = std::num::NonZeroU64::new(self.params_stride);
        let params = wgpu::BufferBinding { buffer: &self.params, offset: params_at, size };
        let [weights, next, latest] = &self.unused;
        let mut resources = vec![
            wgpu::BindingResource::Buffer(params),
            self.table_words.as_entire_binding(),
            window(&self.target.channels[channel], &band.target),
            self.target.weights.as_ref().map_or(weights.as_entire_binding(), |weights| window(weights, &band.weights)),
        ];
        // outputs that this shader does not write are bound to unused buffers
        let moving =
            update.filter(|update| update.rule != Rule::KktResidual).map(|update| (&self.factors[update.own], update));
        resources.push(match moving {
            Some((factor, _)) => window(&factor.next[channel], &band.own),
            None => next.as_entire_binding(),
        });
        resources.push(
            match moving.and_then(|(factor, update)| factor.latest.as_ref().filter(|_| update.extrapolated)) {
                Some(buffers) => window(&buffers[channel], &band.own),
                None => latest.as_entire_binding(),
            },
        );
        resources.push(self.sums.as_entire_binding());
        resources.extend(self.factors.iter().zip(&band.factors).map(|(f, words)| window(&f.current[channel], words)));
        let numbered = resources.into_iter().enumerate();
        let entries: Vec<_> =
            numbered.map(|(i, resource)| wgpu::BindGroupEntry { binding: i as u32, resource }).collect();
        let layout = &self.layout;
        self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
    }

    /// Sums the results of the last call of `dispatch`.
    fn sum(&mut self) -> [f64; 2] {
        if self.found == 0 {
            return [0.0; 2];
        }
        let found = self.gpu.read(&self.sums, 2 * self.found);
        let pairs = found.as_chunks::<2>().0;
        pairs.iter().fold([0.0; 2], |[a, b], pair| [a + f64::from(pair[0]), b + f64::from(pair[1])])
    }
}

/// Number of words of `Params` in front of the words of the factors.
const PARAMS: usize = 23;

impl Updater for State {
    fn plan(&self) -> &Arc<Plan> {
        &self.plan
    }

    fn display(&self) -> &Display {
        &self.display
    }

    fn tries_local(&self) -> bool {
        self.tries_local
    }

    fn set_cancel(&mut self, cancel: &Cancel) {
        self.cancel = cancel.clone();
    }

    fn apply(&mut self, n: usize, rule: Rule, extrapolation: Option<f32>, local: bool) {
        self.found = 0;
        if self.cancel.is_cancelled() {
            return;
        }
        if extrapolation.is_some() {
            self.factors.iter_mut().for_each(|factor| factor.begin_latest(&self.gpu));
        }
        let update = Update { own: n, rule, extrapolated: extrapolation.is_some(), local };
        self.dispatch(Some(update), extrapolation.unwrap_or(0.0));
        if rule != Rule::KktResidual {
            self.factors[n].swap_next();
        }
    }

    fn outcome(&mut self) -> Outcome {
        let [error, gain] = self.sum();
        Outcome { error, gain }
    }

    fn save(&mut self, _: usize) {
        // Nothing is copied, since an update leaves the previous values in the buffer `next`, until
        // the next update of the factor.
    }

    fn restore(&mut self, n: usize) {
        self.factors[n].swap_next();
    }

    fn errors(&mut self) -> ErrorSum {
        self.dispatch(None, 0.0);
        let [weighted, plain] = self.sum();
        ErrorSum { weighted, plain }
    }

    fn swap_latest(&mut self) {
        self.factors.iter_mut().for_each(Values::swap_latest);
    }

    fn restart(&mut self) {
        self.swap_latest();
        self.factors.iter().for_each(|factor| factor.copy_to_latest(&self.gpu));
    }

    fn check(&self) -> Result<(), FactorizeError> {
        self.gpu.check()
    }

    fn download(&mut self) -> LayerStack {
        let factors: Vec<_> = self.factors().collect();
        stack_of(&self.display, factors.iter())
    }

    fn into_stack(mut self: Box<Self>) -> Result<LayerStack, FactorizeError> {
        let stack = self.download();
        self.check().map(|()| stack)
    }

    fn into_factors(self: Box<Self>) -> Result<Vec<Factor>, FactorizeError> {
        let factors = self.factors().collect();
        self.check().map(|()| factors)
    }
}

impl State {
    fn factors(&self) -> impl Iterator<Item = Factor> + '_ {
        self.factors.iter().enumerate().map(|(n, values)| values.download(&self.gpu, &self.plan, n))
    }
}
