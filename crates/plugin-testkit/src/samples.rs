//! Small displays with random data. All values differ, so tests detect swapped layers, frames,
//! views and channels.

use lumistack_core::seed::{Stream, derive};
use lumistack_display::{
    Backlight, Display, FieldGeometry, Layer, LayerStack, LensletBacklight, LightField, Projection, Transfer, ViewGrid,
};

use lumistack_plugin::Port;
use lumistack_plugin_host::serve::OutputData;

/// A display with data for one port.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The property by which the sample differs from the other samples.
    pub name: &'static str,
    /// The display for which an output is opened.
    pub display: Display,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    Stack(LayerStack),
    Field(LightField),
}

impl Sample {
    /// Returns the data of the sample.
    pub fn data(&self) -> OutputData<'_> {
        match &self.kind {
            Kind::Stack(stack) => OutputData::LayerStack(stack, None),
            Kind::Field(field) => OutputData::LightField(field),
        }
    }

    /// Returns the port, which is the kind of the data.
    pub fn port(&self) -> Port {
        self.data().port()
    }

    /// Returns the layer stack; `None` if the sample has a light field.
    pub fn stack(&self) -> Option<&LayerStack> {
        match &self.kind {
            Kind::Stack(stack) => Some(stack),
            Kind::Field(_) => None,
        }
    }

    /// Returns the light field; `None` if the sample has a layer stack.
    pub fn field(&self) -> Option<&LightField> {
        match &self.kind {
            Kind::Field(field) => Some(field),
            Kind::Stack(_) => None,
        }
    }
}

/// Returns all samples, for both ports that outputs accept: layer stacks and light fields.
pub fn samples() -> Vec<Sample> {
    let layered = three_layers();
    let directional = one_directional_layer();
    let fixed = two_static_layers();
    let perspective = FieldGeometry {
        rows: 5,
        cols: 9,
        pitch_mm: 0.5,
        grid: ViewGrid {
            projection: Projection::Perspective { distance_mm: 500.0 },
            slope_x: vec![-0.1, 0.0, 0.15],
            slope_y: vec![0.05, -0.05],
        },
    };
    let mut field = LightField::black(perspective).expect("the geometry is sound");
    fill(field.radiance_mut().data_mut(), 3);
    vec![
        Sample {
            name: "three layers of different resolution and transfer function, two frames",
            kind: Kind::Stack(random_stack(&layered, 1)),
            display: layered.clone(),
        },
        Sample {
            name: "one layer, one frame, directional backlight",
            kind: Kind::Stack(random_stack(&directional, 2)),
            display: directional,
        },
        Sample { name: "perspective light field of 3 × 2 views", kind: Kind::Field(field), display: layered },
        Sample {
            name: "two layers of different size, one frame",
            kind: Kind::Stack(random_stack(&fixed, 4)),
            display: fixed,
        },
    ]
}

fn three_layers() -> Display {
    let plain = Display::uniform([8, 6], 1.0, [3, 3], [10.0, 10.0], &[-4.0, 0.0, 4.0], 2);
    let mut display = Display { name: "three layers".into(), brightness: 0.5, ..plain };
    display.layers[1] = Layer { transfer: Transfer::Linear, ..Layer::new(0.0, [10, 7], 0.8) };
    display.layers[2] = Layer { transfer: Transfer::gamma(2.2), ..Layer::new(4.0, [4, 3], 2.0) };
    display
}

fn two_static_layers() -> Display {
    let plain = Display::uniform([8, 6], 1.0, [3, 3], [10.0, 10.0], &[0.0, 4.0], 1);
    let mut display = Display { name: "static".into(), ..plain };
    display.layers[1] = Layer { offset_mm: [0.5, -0.25], black_level: 0.1, ..Layer::new(4.0, [9, 7], 1.5) };
    display
}

fn one_directional_layer() -> Display {
    let plain = Display::uniform([8, 6], 1.0, [3, 2], [40.0, 40.0], &[0.0], 1);
    let lenslets = LensletBacklight::new(-6.0, [4, 3], 2.0, [3, 2], [40.0, 40.0]);
    Display { name: "directional".into(), backlight: Backlight::Lenslets(lenslets), ..plain }
}

/// Returns a stack of uniformly distributed random values.
fn random_stack(display: &Display, seed: u64) -> LayerStack {
    let mut stack = LayerStack::filled(display, 0.0);
    for (n, layer) in stack.layers.iter_mut().enumerate() {
        fill(layer.data_mut(), derive(seed, &[n as u64]));
    }
    if let Some(emission) = &mut stack.emission {
        fill(emission.data_mut(), derive(seed, &[u64::MAX]));
    }
    stack
}

fn fill(values: &mut [f32], seed: u64) {
    let mut stream = Stream::new(derive(seed, &[]));
    values.fill_with(|| stream.next_f32());
}
