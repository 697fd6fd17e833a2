//! A presenter that echoes its input as events. The host's tests use it compiled in, and also load
//! it as a library.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin::{Display, Host, Input, OutputPlugin, PluginError, Port, Schema, Time, export_plugin};

/// The plugin.
pub struct Echo {
    host: Host,
    send: Sender<Given>,
    given: Mutex<Receiver<Given>>,
}

enum Given {
    Patterns { time: u64, brightness: f64 },
    Quit,
}

/// The plugin has no parameters.
#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct Params {}

impl OutputPlugin for Echo {
    const DOC: &'static str = "Echoes its input as events.";
    const PORTS: &'static [Port] = &[Port::LayerStack];
    const PRESENTS: bool = true;
    type Params = Params;

    fn schema() -> Schema {
        Schema::new([])
    }

    fn open(host: Host, _params: Params, _display: Display) -> Result<Self, PluginError> {
        let (send, given) = channel();
        Ok(Self { host, send, given: Mutex::new(given) })
    }

    fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError> {
        self.host.check_cancelled()?;
        let Input::LayerStack(stack) = data else { return Err(PluginError::unexpected(data)) };
        let _ = self.send.send(Given::Patterns { time: time.index, brightness: stack.brightness() });
        Ok(())
    }

    fn run(&self) -> Result<(), PluginError> {
        let given = self.given.lock().unwrap_or_else(PoisonError::into_inner);
        while !self.host.is_cancelled() {
            match given.recv_timeout(Duration::from_millis(10)) {
                Ok(Given::Patterns { time, brightness }) => {
                    self.host.tell(&json!({"time": time, "brightness": brightness}));
                }
                Ok(Given::Quit) => break,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
            }
        }
        self.host.warn("the presentation has ended");
        Ok(())
    }

    fn command(&self, command: &Value) -> Result<(), PluginError> {
        if command != "quit" {
            return Err(PluginError::Refused(format!("expected \"quit\", found {command}")));
        }
        let _ = self.send.send(Given::Quit);
        Ok(())
    }

    fn finish(self) -> Result<(), PluginError> {
        Ok(())
    }
}

export_plugin!("echo", Echo);
