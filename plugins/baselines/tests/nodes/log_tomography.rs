//! Tests the plugin `log_tomography`: it must recover the light fields of known stacks, and its
//! solution must minimize the objective.

use lumistack_plugin::PluginError;
use lumistack_plugin::core::seed::Stream;
use lumistack_plugin::display::{
    Backlight, Display, LayerStack, LensletBacklight, LightField, RayMap, Simulator, Weights, score,
};
use lumistack_plugin_baselines::log_tomography::PLUGIN;
use lumistack_plugin_testkit::{conformance, made_by};

fn display(frames: usize) -> Display {
    Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &[-12.0, 0.0, 12.0], frames)
}

/// Returns the light field that a random static stack shows.
fn shown(display: &Display) -> LightField {
    let still = Display { frames: 1, ..display.clone() };
    let mut stack = LayerStack::filled(&still, 1.0);
    let mut stream = Stream::new(5);
    for layer in &mut stack.layers {
        layer.data_mut().fill_with(|| 0.4 + 0.6 * stream.next_f32());
    }
    let mut field = LightField::black(display.geometry().unwrap()).unwrap();
    let (map, simulator) = (RayMap::new(&still, field.geometry()), Simulator::new(&still, &stack));
    for view in field.geometry().clone().grid.iter() {
        let view_shown = simulator.view(&map, field.geometry(), view);
        field.view_mut(view).copy_from_slice(view_shown.radiance.data());
    }
    field
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

#[test]
fn a_light_field_of_a_static_stack_is_reproduced() {
    let display = display(2);
    let field = shown(&display);
    let psnr = |iterations: u32| {
        let stack = made_by(&PLUGIN, &format!("{{\"iterations\": {iterations}}}"), &display, &field).unwrap();
        let layer = &stack.layers[1];
        assert_eq!(layer.block([0]), layer.block([1]), "every frame is the same");
        score(&display, &stack, &field, &Weights::Uniform).psnr_view()
    };
    let [few, many] = [5, 300].map(psnr);
    assert!(many > 40.0 && many > few + 6.0, "{few} {many}");
}

/// The objective is convex in the logarithms. So at the solution no small change of one pixel may
/// lower the objective.
#[test]
fn the_optimum_is_one() {
    let display = display(1);
    let mut field = shown(&display);
    let mut stream = Stream::new(9);
    field.radiance_mut().data_mut().fill_with(|| 0.2 + 0.8 * stream.next_f32());
    let stack = made_by(&PLUGIN, r#"{"iterations": 1500}"#, &display, &field).unwrap();
    let simulator = |stack: &LayerStack| -> f64 {
        let (map, simulator) = (RayMap::new(&display, field.geometry()), Simulator::new(&display, stack));
        let mut sum = 0.0;
        for view in field.geometry().grid.iter() {
            let view_shown = simulator.view(&map, field.geometry(), view);
            let rays = view_shown.radiance.data().iter().zip(field.view(view)).enumerate();
            let counted = rays.filter(|(i, _)| view_shown.valid[i / 3]);
            sum += counted.map(|(_, (a, b))| (f64::from(*a).ln() - f64::from(*b).ln()).powi(2)).sum::<f64>();
        }
        sum
    };
    let least = simulator(&stack);
    for (layer, row, col) in [(0, 3, 4), (1, 5, 8), (2, 9, 15), (1, 0, 0)] {
        for factor in [0.97f32, 1.03] {
            let mut changed = stack.clone();
            let value = changed.layers[layer].at_mut([0, row, col, 0]);
            *value = (*value * factor).min(1.0);
            assert!(simulator(&changed) >= least - 1e-6, "layer {layer}, pixel {row} {col}, × {factor}");
        }
    }
}

#[test]
fn other_displays_are_refused() {
    let mut display = display(1);
    let field = shown(&display);
    display.backlight = Backlight::Lenslets(LensletBacklight::new(-20.0, [4, 4], 4.0, [3, 3], [20.0, 20.0]));
    let error = made_by(&PLUGIN, "{}", &display, &field).unwrap_err();
    assert!(matches!(&error, PluginError::Refused(text) if text.contains("expected a uniform backlight")), "{error:?}");
}
