//! Tests that a job keeps paths with bytes that are not UTF-8 when it is written and read.

use crate::Job;

#[cfg(unix)]
#[test]
fn a_job_with_any_name_reads_back_the_same() {
    use std::os::unix::ffi::OsStrExt;
    use std::path::PathBuf;

    use crate::DisplayJob;

    let path = |bytes: &[u8]| Some(PathBuf::from(std::ffi::OsStr::from_bytes(bytes)));
    let mut job = Job::new(DisplayJob::by_name_or_path("paper-three-layer"));
    job.scene = path(b"/tmp/100%/m\xF6bel.glb");
    job.light.environment = path(b"sky%20.hdr");
    job.factorize.weights = path(b"\xFF");
    let text = job.to_toml();
    assert!(text.contains("percent = \"/tmp/100%25/m%F6bel.glb\""), "{text}");
    assert!(text.contains("environment = \"sky%20.hdr\""), "{text}");
    assert_eq!(lumistack_core::config::parse::<Job>(&text).unwrap(), job);
    assert!(job.to_json()["scene"]["percent"].is_string());
}

/// Names on Windows may contain UTF-16 surrogates that have no partner.
#[cfg(windows)]
#[test]
fn a_job_with_any_name_reads_back_the_same() {
    use std::os::windows::ffi::OsStringExt;

    let mut job = Job::new(crate::DisplayJob::by_name_or_path("paper-three-layer"));
    job.scene = Some(std::ffi::OsString::from_wide(&[0x6D, 0xDC00, 0xD800, 0x2E, 0x67]).into());
    let text = job.to_toml();
    assert!(text.contains("percent = \"m%ED%B0%80%ED%A0%80.g\""), "{text}");
    assert_eq!(lumistack_core::config::parse::<Job>(&text).unwrap(), job);
}

#[test]
fn a_path_of_another_kind_is_refused() {
    let parse = |scene: &str| {
        let text = format!("scene = {scene}\n[display]\npreset = \"paper-three-layer\"\n");
        lumistack_core::config::parse::<Job>(&text).unwrap_err().message
    };
    assert!(parse("5").contains("a string that is a path"), "{}", parse("5"));
    assert!(parse("{ bytes = \"a\" }").contains("percent"), "{}", parse("{ bytes = \"a\" }"));
}
