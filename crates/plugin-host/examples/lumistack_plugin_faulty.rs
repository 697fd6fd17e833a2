//! An output plugin with selectable faults. The host's tests use it compiled in, and also load it
//! as a library.

use std::thread;
use std::time::Duration;

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Display, Host, Input, OutputPlugin, Param, PluginError, Port, Schema, Time, export_plugin};

/// The plugin.
pub struct Faulty {
    host: Host,
    params: Params,
}

/// The parameters, with the fault that the plugin has.
#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct Params {
    fault: String,
    files: usize,
    path: String,
}

/// A panic's payload that panics again when it is dropped.
struct Grenade;

impl Drop for Grenade {
    fn drop(&mut self) {
        panic!("a panic while panicking would end the program");
    }
}

impl OutputPlugin for Faulty {
    const DOC: &'static str = "Fails in the way that its parameter selects.";
    const PORTS: &'static [Port] = &[Port::LayerStack];
    type Params = Params;

    fn schema() -> Schema {
        Schema::new([
            Param::text("fault", "", "Fault to commit."),
            Param::int("files", 3, 0..=9, "Number of files to write.").unit("files"),
            Param::text("path", "", "Name of one more file to write."),
        ])
    }

    fn open(host: Host, params: Params, _display: Display) -> Result<Self, PluginError> {
        assert!(params.fault != "panic in open", "no paper");
        Ok(Self { host, params })
    }

    fn submit(&self, _time: Time, _data: &Input<'_>) -> Result<(), PluginError> {
        let stage = self.host.stage("writing", self.params.files as u64, "files");
        for i in 0..self.params.files {
            let mut file = self.host.create(&format!("sub{i}/f.txt"))?;
            file.append(format!("{} of {}", i, self.params.files).as_bytes())?;
            match self.params.fault.as_str() {
                "fail" if i == 1 => return Err(PluginError::Failed("the ink is empty".into())),
                "panic" if i == 1 => panic!("no more ink"),
                "panic with a payload that panics" if i == 1 => std::panic::panic_any(Grenade),
                "leave open" if i == 1 => std::mem::forget(file),
                "hang" if i == 1 => {
                    while !self.host.is_cancelled() {
                        thread::sleep(Duration::from_millis(1));
                    }
                    // The fault is that the plugin commits the file although the user has
                    // cancelled.
                    file.commit()?;
                }
                _ => file.commit()?,
            }
            stage.advance(1, "");
        }
        if self.params.fault == "warn" {
            self.host.warn("low on ink");
            self.host.info("all is well");
        }
        if self.params.fault == "panic in a thread" {
            let thread = thread::spawn(|| panic!("nobody joins"));
            while !thread.is_finished() {
                thread::yield_now();
            }
        }
        if self.params.fault == "long name" {
            self.host.write(&"n".repeat(1 << 20), b"x")?;
        }
        if !self.params.path.is_empty() {
            let written = self.host.write(&self.params.path, b"x");
            if self.params.fault != "ignore errors" {
                written?;
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<(), PluginError> {
        match self.params.fault.as_str() {
            "fail late" => Err(PluginError::Failed("jam".into())),
            "panic late" => panic!("torn"),
            _ => Ok(()),
        }
    }
}

impl Drop for Faulty {
    fn drop(&mut self) {
        assert!(self.params.fault != "panic in drop", "dropped");
    }
}

export_plugin!("faulty", Faulty);
