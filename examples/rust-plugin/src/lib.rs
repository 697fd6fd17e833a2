//! Output plugin `means`: writes the mean transmittance of every layer and frame as a table.

pub mod centre_view;

use std::sync::Mutex;

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Display, Host, Input, OutputPlugin, Param, PluginError, Port, Schema, Time, export_plugin};

/// The plugin: its host, its parameters, and the table's lines so far.
pub struct Means {
    host: Host,
    params: MeansParams,
    lines: Mutex<Vec<String>>,
}

/// One field for every parameter of the schema.
#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct MeansParams {
    digits: usize,
    separator: Separator,
}

/// The values of the parameter `separator`.
#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub enum Separator {
    /// `,`
    Comma,
    /// A tabulator.
    Tab,
}

impl OutputPlugin for Means {
    const DOC: &'static str = "Writes the mean transmittance of every layer and frame as a table.";
    const PORTS: &'static [Port] = &[Port::LayerStack];
    type Params = MeansParams;

    fn schema() -> Schema {
        Schema::new([
            Param::int("digits", 4, 1..=9, "Digits after the point.").unit("1"),
            Param::choice(
                "separator",
                "comma",
                [("comma", "A comma."), ("tab", "A tabulator.")],
                "Separator of the columns.",
            ),
        ])
    }

    fn open(host: Host, params: MeansParams, _display: Display) -> Result<Self, PluginError> {
        Ok(Self { host, params, lines: Mutex::default() })
    }

    // Called once for every time step of a sequence, from any thread and in any order.
    fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError> {
        let Input::LayerStack(stack) = data else { return Err(PluginError::unexpected(data)) };
        let separator = match self.params.separator {
            Separator::Comma => ",",
            Separator::Tab => "\t",
        };
        for layer in 0..stack.layer_count() {
            for frame in 0..stack.frames() {
                self.host.check_cancelled()?;
                let values = stack.layer(layer, frame)?.to_vec();
                let mean = values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64;
                let columns = [
                    format!("{:04}", time.index),
                    layer.to_string(),
                    format!("{frame:02}"),
                    format!("{mean:.*}", self.params.digits),
                ];
                self.lines.lock().expect("no submit panics").push(columns.join(separator));
            }
        }
        Ok(())
    }

    // Called after the last time step.
    fn finish(self) -> Result<(), PluginError> {
        self.host.check_cancelled()?;
        let mut lines = self.lines.into_inner().expect("no submit panicked");
        lines.sort();
        self.host.write("means.csv", (lines.join("\n") + "\n").as_bytes())
    }
}

export_plugin!("means", Means);

#[cfg(test)]
mod tests {
    use lumistack_plugin::display::LayerStack;
    use lumistack_plugin::serde_json::json;
    use lumistack_plugin::{Display, Time};
    use lumistack_plugin_testkit::serve::{Output, OutputData, Plugin};
    use lumistack_plugin_testkit::{MemoryHost, conformance};

    #[test]
    fn keeps_the_rules_of_plugins() {
        conformance(&super::PLUGIN).unwrap();
    }

    #[test]
    fn writes_a_line_per_layer_and_frame() {
        let display = Display::uniform([8, 6], 1.0, [3, 3], [20.0, 20.0], &[-3.0, 3.0], 1);
        let stack = LayerStack::filled(&display, 0.25);
        let (plugin, host) = (Plugin::compiled_in(&super::PLUGIN).unwrap(), MemoryHost::new());
        let output = Output::open(&plugin, &host, &json!({ "digits": 3 }), &display).unwrap();
        // `None`: no light field for which the stack was solved
        output.submit(Time::default(), OutputData::LayerStack(&stack, None)).unwrap();
        output.finish().unwrap();
        assert_eq!(host.files()["means.csv"], b"0000,0,00,0.250\n0000,1,00,0.250\n");
    }
}
