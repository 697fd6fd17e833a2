//! Reads the input as a job file. If the job is valid, it must stay the same when it is written and
//! read again.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_core::config;
use lumistack_fuzz::reads;
use lumistack_pipeline::Job;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Some(job) = reads(|_| config::parse::<Job>(text)) else { return };
    reads(|_| job.check());
    if job.display.file.is_none() {
        reads(|_| job.resolve_display());
    }
    let written = job.to_toml();
    let again: Job = config::parse(&written).expect("a job that was written can be read");
    assert_eq!(again.to_toml(), written);
});
