//! The program that child processes run, and their time limits.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::Duration;

/// Environment variable: the longest time, in seconds, in which a called plugin function neither
/// calls the host nor returns; 0 for no limit.
const SILENCE: &str = "LUMISTACK_PLUGIN_SILENCE_S";
/// Environment variable: the longest time, in seconds, to load a library; 0 for no limit.
const LOAD: &str = "LUMISTACK_PLUGIN_LOAD_S";

/// The program that a child process runs, which calls [`plugin_child`](crate::plugin_child). The
/// library's path and the plugin's id are appended to `args`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Launcher {
    /// The path of the program.
    pub program: PathBuf,
    /// The program's arguments before the library's path.
    pub args: Vec<OsString>,
}

static OF_PROCESS: OnceLock<Launcher> = OnceLock::new();

impl Launcher {
    /// Returns a launcher of the current program; `None` if the program's path is unknown. `first`
    /// is the program's first argument, which makes it run a plugin.
    pub fn this_program(first: &str) -> Option<Self> {
        // On Linux `/proc/self/exe` opens the running program, even if the program's file was
        // replaced on disk.
        let own = PathBuf::from("/proc/self/exe");
        let program = if cfg!(target_os = "linux") && own.exists() { own } else { std::env::current_exe().ok()? };
        Some(Self { program, args: vec![first.into()] })
    }

    /// Sets the launcher of all children of this process; [`PluginPaths`](crate::PluginPaths) can
    /// override it. Only the first call has an effect.
    pub fn set_for_process(self) {
        let _ = OF_PROCESS.set(self);
    }

    /// Returns the launcher set for this process.
    pub fn of_process() -> Option<Self> {
        OF_PROCESS.get().cloned()
    }
}

/// Time limits of a child; `None` for no limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Longest time from the start of the process until the plugin has described itself.
    pub load: Option<Duration>,
    /// Longest time that a running call may take without a sign of life. The plugin gives a sign
    /// when it calls a host service, and when one of its functions returns. The function `run` of a
    /// presenter has no such limit.
    pub silence: Option<Duration>,
    /// Time in which a running call must end after the user has cancelled. After this time the
    /// process is ended.
    pub grace: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        let (load, silence) = (Duration::from_secs(60), Duration::from_secs(30 * 60));
        Self { load: Some(load), silence: Some(silence), grace: Duration::from_secs(3) }
    }
}

impl Limits {
    /// Returns the default limits, overridden by the environment variables
    /// `LUMISTACK_PLUGIN_LOAD_S` and `LUMISTACK_PLUGIN_SILENCE_S`. Their values are seconds, with 0
    /// for no limit.
    ///
    /// # Errors
    /// The variable and its value, if the value is no number of seconds.
    pub(crate) fn of_system() -> Result<Self, (&'static str, String)> {
        let mut limits = Self::default();
        for (variable, limit) in [(LOAD, &mut limits.load), (SILENCE, &mut limits.silence)] {
            if let Some(text) = std::env::var_os(variable) {
                let text = text.to_string_lossy().into_owned();
                *limit = limit_of(&text).ok_or((variable, text))?;
            }
        }
        Ok(limits)
    }
}

/// Parses the value of an environment variable that sets a limit: seconds, with 0 for no limit.
/// Returns `None` if the value is invalid.
fn limit_of(text: &str) -> Option<Option<Duration>> {
    let limit = Duration::try_from_secs_f64(text.trim().parse().ok()?).ok()?;
    Some((!limit.is_zero()).then_some(limit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_seconds_and_zero_is_none() {
        assert_eq!(limit_of("2.5"), Some(Some(Duration::from_millis(2500))));
        assert_eq!(limit_of(" 0 "), Some(None));
        for text in ["", "-1", "ten", "NaN", "1e300"] {
            assert_eq!(limit_of(text), None, "{text}");
        }
    }
}
