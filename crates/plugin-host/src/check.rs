//! Checks that an output accepts its parameters and the display, before any work begins.

use crate::serve::{Output, PluginKind, Services};
use lumistack_core::{NoProgress, Task};
use lumistack_display::Display;
use lumistack_plugin::{PluginError, Port};
use serde_json::Value;

use crate::{HostError, Registry};

/// Opens the output plugin `id` for a display and data of `port`, and closes the output unused.
/// Warnings are dropped, since [`run_output`](crate::run_output) reports them again.
///
/// # Errors
/// If no usable output has this id, or the output is a presenter, refuses the parameters or the
/// display, or fails. [`HostError::Cancelled`] if the user cancelled.
pub fn check_output(
    registry: &Registry,
    id: &str,
    params: &Value,
    display: &Display,
    port: Port,
    task: Task<'_>,
) -> Result<(), HostError> {
    task.cancel.check().map_err(|_| HostError::Cancelled)?;
    let plugin = registry.output(id, false)?;
    let resolved = registry.check_params(id, params)?;
    let host = Unused { task: Task { progress: &NoProgress, ..task }, port };
    let opened = Output::open(plugin, &host, &Value::Object(resolved), display);
    opened.map(drop).map_err(|error| HostError::of_plugin(PluginKind::Output, id, error))
}

/// Services for an output that is opened only as a check: they refuse all files.
struct Unused<'a> {
    task: Task<'a>,
    port: Port,
}

impl Services for Unused<'_> {
    fn task(&self) -> Task<'_> {
        self.task
    }

    fn warn(&self, _message: &str) {}

    fn no_files(&self) -> PluginError {
        PluginError::Refused("an output writes files when it has data, not when it opens".into())
    }

    fn port(&self) -> Option<Port> {
        Some(self.port)
    }
}

#[cfg(all(test, feature = "transparencies", feature = "quilt", feature = "images"))]
mod tests {
    use super::*;
    use lumistack_core::{Cancel, Collector};
    use lumistack_display::Layer;
    use serde_json::json;

    #[test]
    fn refusals_of_outputs_need_no_data() {
        let registry = Registry::built_in().unwrap();
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let (_, text) = lumistack_display::PRESETS.iter().find(|(name, _)| *name == "fig7-uniform").unwrap();
        let display = Display::from_toml(text).unwrap().with_resolution([40, 25]);
        let check = |id: &str, params: Value, display: &Display| {
            check_output(&registry, id, &params, display, Port::LayerStack, task).map_err(|error| error.to_string())
        };
        let mut still = display.clone();
        (still.frames, still.layers) = (1, vec![Layer::new(-5.0, [40, 25], 1.0), Layer::new(5.0, [40, 25], 1.0)]);
        assert_eq!(check("images", json!({}), &display), Ok(()));
        assert_eq!(check("transparencies", json!({"paper": "tight"}), &still), Ok(()));
        assert!(
            check("transparencies", json!({}), &Display { frames: 12, ..still.clone() }).unwrap_err().contains("12")
        );
        let huge = Layer::new(5.0, [40, 25], 500.0);
        still.layers[1] = huge;
        let error = check("transparencies", json!({"paper": "tight", "dpi": 4800}), &still).unwrap_err();
        assert!(error.contains("`dpi`") && error.contains("layer 1"), "{error}");
        let error = check("quilt", json!({"calibration": "{}"}), &display).unwrap_err();
        assert!(error.contains("calibration"), "{error}");
        let error = check("quilt", json!({"view_row": 99}), &display).unwrap_err();
        assert!(error.contains("`view_row`"), "{error}");
        let error = check("quilt", json!({"columns": 4}), &display).unwrap_err();
        assert!(error.contains("two numbers above 0, or 0 for both"), "{error}");
        // The views of a quilt can be simulated from a layer stack. A light field has only its own
        // views, so it lacks some of the quilt's views.
        let views = json!({"columns": 7, "rows": 1, "missing_views": "refuse"});
        assert_eq!(check("quilt", views.clone(), &display), Ok(()));
        let error = check_output(&registry, "quilt", &views, &display, Port::LightField, task).unwrap_err();
        assert!(error.to_string().contains("views = [7, 1]"), "{error}");
        let error = check("images", json!({"lenslet_panel": true}), &display).unwrap_err();
        assert!(error.contains("lenslets"), "{error}");
        let mut uneven = display.clone();
        uneven.field.fov_deg = [20.0, 5.0];
        let error = check("images", json!({"hci": true}), &uneven).unwrap_err();
        assert!(error.contains("`hci`"), "{error}");
        assert!(warnings.take().is_empty());
    }
}
