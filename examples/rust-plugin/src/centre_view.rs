//! Node plugin `centre_view`: the front layer shows the middle view, and all other layers are open.

use lumistack_plugin::display::LayerStack;
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{NodeInput, NodePlugin, PluginError, Schema, expects, export_plugin};

/// The plugin, which keeps no state.
pub struct CentreView;

/// The plugin has no parameters.
#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct NoParams {}

impl NodePlugin for CentreView {
    const DOC: &'static str = "Shows the middle view on the front layer, behind which all layers are open.";
    type Params = NoParams;

    fn schema() -> Schema {
        Schema::default()
    }

    fn make(_params: NoParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let (host, display, field) = (input.host(), input.display(), input.field());
        expects::attenuating(display)?;
        expects::uniform_backlight(display)?;
        expects::same_pixels(display)?;
        let mut stack = LayerStack::filled(display, 0.0);
        for (values, layer) in stack.layers.iter_mut().zip(&display.layers) {
            values.data_mut().fill(layer.range()[1]);
        }
        // The display emits β times the view. Here β is the fraction of light that open layers
        // transmit.
        stack.brightness = display.layers.iter().map(|layer| layer.peak).product();
        let [views_y, views_x] = field.geometry().grid.views();
        let view = field.view([views_y / 2, views_x / 2])?.to_vec();
        let (Some(front), Some(layer)) = (stack.layers.last_mut(), display.layers.last()) else { return Ok(stack) };
        let [dark, bright] = layer.range();
        for frame in 0..display.frames {
            host.check_cancelled()?;
            for (value, wanted) in front.block_mut([frame]).iter_mut().zip(&view) {
                *value = (wanted * bright).clamp(dark, bright);
            }
        }
        Ok(stack)
    }
}

export_plugin!("centre_view", CentreView as node);

#[cfg(test)]
mod tests {
    use lumistack_plugin::Display;
    use lumistack_plugin::display::Simulator;
    use lumistack_plugin_testkit::{conformance, made_by, random_field};

    #[test]
    fn keeps_the_rules_of_plugins() {
        conformance(&super::PLUGIN).unwrap();
    }

    #[test]
    fn the_display_emits_the_middle_view() {
        let mut display = Display::uniform([8, 6], 1.0, [3, 3], [20.0, 20.0], &[-3.0, 3.0], 2);
        display.layers[0].peak = 0.8;
        let field = random_field(&display).unwrap();
        let stack = made_by(&super::PLUGIN, "{}", &display, &field).unwrap();
        let seen = Simulator::new(&display, &stack).from_slope([0.0, 0.0]).radiance;
        for (seen, wanted) in seen.data().iter().zip(field.view([1, 1])) {
            assert!((seen / stack.brightness as f32 - wanted).abs() < 1e-5, "{seen} {wanted}");
        }
    }
}
