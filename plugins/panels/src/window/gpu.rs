//! Copies code values to outputs on the GPU. Codes are textures, which are copied texel by texel,
//! so that outputs receive exact codes.

use std::sync::{Arc, OnceLock};
use std::time::Instant;

use winit::event_loop::ActiveEventLoop;
use winit::window::Window;

use super::WindowError;
use crate::Shows;
use crate::assign::Output;

/// Device and pipeline, shared by all threads.
pub(super) struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    /// The first uncaptured error and its time. The main thread reports it.
    pub(super) failure: Arc<OnceLock<(Instant, String)>>,
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
}

/// A window and its surface.
pub(super) struct Screen {
    pub(super) window: Arc<Window>,
    pub(super) surface: wgpu::Surface<'static>,
    pub(super) config: wgpu::SurfaceConfiguration,
}

/// The area of a screen that one output's picture fills.
#[derive(Clone, Debug)]
pub(super) struct Viewport {
    pub(super) shows: Shows,
    pub(super) output: Output,
    pub(super) screen: usize,
    /// [x, y] of the area's upper left pixel on the screen.
    pub(super) origin: [u32; 2],
    /// [columns, rows] of the area; `None` for the whole screen.
    pub(super) extent: Option<[u32; 2]>,
}

/// The uploaded frames of one period.
pub(super) struct FrameSet {
    pub(super) pictures: Vec<Vec<wgpu::BindGroup>>,
    /// Number of frame sets that were made before this one.
    pub(super) number: u64,
}

const SHADER: &str = "
@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var<uniform> origin: vec4<i32>;

@vertex
fn corner(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
    // Return the corners of one triangle that covers the whole target.
    return vec4<f32>(f32(i32(i & 1u) * 4 - 1), f32(i32(i >> 1u) * 4 - 1), 0.0, 1.0);
}

@fragment
fn texel(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    return textureLoad(picture, vec2<i32>(place.xy) - origin.xy, 0);
}
";

/// Opens a device that can present on all windows, and configures their surfaces.
///
/// # Errors
/// If no driver can present on all windows. Also if the first surface has no 8-bit unorm format, or
/// another surface lacks this format.
pub(super) fn open(
    event_loop: &ActiveEventLoop,
    windows: Vec<(Arc<Window>, String)>,
) -> Result<(Gpu, Vec<Screen>), WindowError> {
    let handle = Box::new(event_loop.owned_display_handle());
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_with_display_handle_from_env(handle));
    let failed = |on: &str, found: String| WindowError::Graphics { on: on.into(), found };
    let mut surfaces = Vec::new();
    for (window, name) in windows {
        let surface = instance.create_surface(window.clone()).map_err(|error| failed(&name, error.to_string()))?;
        surfaces.push((window, name, surface));
    }
    // Choose an adapter that can present on the first window.
    let first = surfaces.first().ok_or_else(|| failed("any output", "no window".into()))?;
    let options = wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        compatible_surface: Some(&first.2),
        ..Default::default()
    };
    let adapter =
        pollster::block_on(instance.request_adapter(&options)).map_err(|error| failed(&first.1, error.to_string()))?;
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("panels"),
        required_limits: wgpu::Limits::downlevel_defaults().using_resolution(adapter.limits()),
        ..Default::default()
    };
    let (device, queue) =
        pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| failed(&first.1, error.to_string()))?;

    // Configure every surface for presentation at vertical blanks (Fifo), with two frames of
    // latency. All surfaces have one format.
    let mut format = None;
    let mut screens = Vec::new();
    for (window, name, surface) in surfaces {
        let offered = surface.get_capabilities(&adapter).formats;
        // Unorm formats pass codes unchanged. sRGB formats would convert them.
        let plain = [wgpu::TextureFormat::Bgra8Unorm, wgpu::TextureFormat::Rgba8Unorm];
        let chosen = plain.into_iter().find(|plain| offered.contains(plain) && format.is_none_or(|f| f == *plain));
        let chosen = chosen.ok_or_else(|| {
            failed(
                &name,
                format!(
                    "surface formats {offered:?} on {}, none of them Bgra8Unorm or Rgba8Unorm",
                    adapter.get_info().name
                ),
            )
        })?;
        format = Some(chosen);
        let size = window.inner_size();
        let mut config = surface
            .get_default_config(&adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| failed(&name, "a surface that this adapter cannot present on".into()))?;
        config.format = chosen;
        config.present_mode = wgpu::PresentMode::Fifo;
        config.desired_maximum_frame_latency = 2;
        surface.configure(&device, &config);
        screens.push(Screen { window, surface, config });
    }
    let gpu = Gpu::new(device, queue, format.expect("at least one window"));
    Ok((gpu, screens))
}

impl Screen {
    /// Resizes the surface to its window.
    pub(super) fn fit(&mut self, device: &wgpu::Device) {
        let size = self.window.inner_size();
        (self.config.width, self.config.height) = (size.width.max(1), size.height.max(1));
        self.surface.configure(device, &self.config);
    }
}

impl Gpu {
    fn new(device: wgpu::Device, queue: wgpu::Queue, format: wgpu::TextureFormat) -> Self {
        // Keep the first uncaptured error, which the main thread reports.
        let failure = Arc::new(OnceLock::new());
        let first_error = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let _ = first_error.set((Instant::now(), error.to_string()));
        }));
        // Declare two bindings: the picture, and the origin of its viewport.
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("picture"),
            entries: &[
                wgpu::BindGroupLayoutEntry {
                    binding: 0,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Float { filterable: false },
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                    count: None,
                },
                wgpu::BindGroupLayoutEntry {
                    binding: 1,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Buffer {
                        ty: wgpu::BufferBindingType::Uniform,
                        has_dynamic_offset: false,
                        min_binding_size: None,
                    },
                    count: None,
                },
            ],
        });
        // Make a pipeline that draws one triangle over the target, so that each pixel gets one
        // texel.
        let shader = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("texel by texel"),
            source: wgpu::ShaderSource::Wgsl(SHADER.into()),
        });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("pictures"),
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("pictures"),
            layout: Some(&pipeline_layout),
            vertex: wgpu::VertexState {
                module: &shader,
                entry_point: Some("corner"),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &shader,
                entry_point: Some("texel"),
                compilation_options: Default::default(),
                targets: &[Some(format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        Self { device, queue, failure, pipeline, layout }
    }

    /// Uploads the code values `[row][col][red, green, blue, 255]` of one output. The upload is
    /// submitted immediately.
    pub(super) fn load(&self, codes: &[u8], [cols, rows]: [usize; 2], origin: [u32; 2]) -> wgpu::BindGroup {
        let size = wgpu::Extent3d { width: cols as u32, height: rows as u32, depth_or_array_layers: 1 };
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let rows_of_bytes =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * cols as u32), rows_per_image: None };
        self.queue.write_texture(texture.as_image_copy(), codes, rows_of_bytes, size);
        let place = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("origin"),
            size: 16,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let bytes: Vec<u8> = [origin[0], origin[1], 0, 0].into_iter().flat_map(u32::to_ne_bytes).collect();
        self.queue.write_buffer(&place, 0, &bytes);
        // Submit each picture's upload immediately, so that a refresh waits for at most one upload.
        self.queue.submit([]);
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&texture.create_view(&Default::default())),
                },
                wgpu::BindGroupEntry { binding: 1, resource: place.as_entire_binding() },
            ],
        })
    }

    /// Draws the viewports of one screen.
    pub(super) fn draw<'a>(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        target: &wgpu::Texture,
        viewports: impl IntoIterator<Item = (&'a Viewport, &'a wgpu::BindGroup)>,
    ) {
        let view = target.create_view(&Default::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("refresh"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        for (viewport, picture) in viewports {
            let [x, y] = viewport.origin;
            // The surface may have shrunk since the pictures were made, so limit the viewport to
            // the target.
            let (width, height) = (target.width().saturating_sub(x), target.height().saturating_sub(y));
            if width == 0 || height == 0 {
                continue;
            }
            // Clip to the viewport, since other viewports of the surface may be next to it. The
            // viewport of a preview is the whole window.
            let [cols, rows] = viewport.extent.unwrap_or([width, height]);
            pass.set_scissor_rect(x, y, cols.min(width), rows.min(height));
            pass.set_bind_group(0, picture, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}
