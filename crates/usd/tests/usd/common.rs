//! The Python that tests use.

use std::ffi::OsString;
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Returns the Python that `LUMISTACK_PYTHON` names, if it has OpenUSD. Otherwise reports the test
/// as skipped.
pub fn python() -> Option<OsString> {
    static FOUND: OnceLock<Option<OsString>> = OnceLock::new();
    let found = FOUND.get_or_init(|| {
        let python = std::env::var_os("LUMISTACK_PYTHON")?;
        let mut check = Command::new(&python);
        let status = check.args(["-c", "import pxr"]).stdout(Stdio::null()).stderr(Stdio::null()).status();
        status.is_ok_and(|status| status.success()).then_some(python)
    });
    if found.is_none() {
        lumistack_testkit::skip::skipped("LUMISTACK_PYTHON names no Python with usd-core");
    }
    found.clone()
}
