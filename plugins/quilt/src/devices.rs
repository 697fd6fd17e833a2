//! The table of commercial lenticular displays, `devices.json`, with the sources of its numbers.

use std::sync::OnceLock;

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::serde_json;

/// A lenticular display, and the quilt that it expects.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct Device {
    /// Value of the parameter `device` that selects this device.
    pub id: String,
    /// Name of the device, for users.
    pub name: String,
    /// [columns, rows] of the quilt's pixels.
    pub quilt: [usize; 2],
    /// Number of columns of views in the quilt.
    pub columns: usize,
    /// Number of rows of views in the quilt.
    pub rows: usize,
    /// Width over height of one view.
    pub aspect: f64,
    /// Source of these numbers.
    pub source: String,
}

#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct Table {
    devices: Vec<Device>,
}

/// Returns all devices of the table.
pub fn devices() -> &'static [Device] {
    static DEVICES: OnceLock<Vec<Device>> = OnceLock::new();
    DEVICES.get_or_init(|| {
        let table: Table = serde_json::from_str(include_str!("devices.json")).expect("the table is checked by a test");
        table.devices
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_sound() {
        assert_eq!(devices().len(), 8);
        for device in devices() {
            assert!(!device.source.is_empty() && device.aspect > 0.5 && device.aspect < 2.0, "{device:?}");
            let tile = [device.quilt[0] / device.columns, device.quilt[1] / device.rows];
            assert!(tile.iter().all(|side| (300..2000).contains(side)), "{device:?}");
            assert!((45..=72).contains(&(device.columns * device.rows)), "{device:?}");
        }
    }
}
