//! Code of cached results: fingerprints of the crates' sources that a result passes through. A
//! change to any of them makes it stale.

/// Fingerprints of crates.
pub(crate) type Code = &'static [&'static str];

/// This crate, which computes the keys.
const PIPELINE: &str = env!("LUMISTACK_FINGERPRINT");
const CORE: &str = lumistack_core::FINGERPRINT;
const DISPLAY: &str = lumistack_display::FINGERPRINT;
const FIELD_IO: &str = lumistack_field_io::FINGERPRINT;
const SIMD: &str = lumistack_simd::FINGERPRINT;

/// From scene files to a lit scene.
pub(crate) const SCENE: Code = &[
    PIPELINE,
    CORE,
    FIELD_IO,
    lumistack_scene::FINGERPRINT,
    lumistack_gltf::FINGERPRINT,
    lumistack_usd::FINGERPRINT,
    lumistack_splats::FINGERPRINT,
    lumistack_shot::FINGERPRINT,
];

/// From scene files to traced radiance, depths and the window's placement.
pub(crate) const VIEWS: Code = &[
    PIPELINE,
    CORE,
    FIELD_IO,
    lumistack_scene::FINGERPRINT,
    lumistack_gltf::FINGERPRINT,
    lumistack_usd::FINGERPRINT,
    lumistack_splats::FINGERPRINT,
    lumistack_shot::FINGERPRINT,
    DISPLAY,
    SIMD,
    lumistack_pathtracer::FINGERPRINT,
];

/// From a light field to files of it.
pub(crate) const FIELDS: Code = &[PIPELINE, CORE, FIELD_IO, DISPLAY, lumistack_shot::FINGERPRINT];

/// From a light field to patterns.
pub(crate) const PATTERNS: Code = &[
    PIPELINE,
    CORE,
    FIELD_IO,
    DISPLAY,
    SIMD,
    lumistack_factorizer::FINGERPRINT,
    lumistack_plugin_host::PLUGIN_FINGERPRINT,
    lumistack_plugin_host::FINGERPRINT,
];

/// From a light field to a row of a sweep's table.
pub(crate) const DESIGNS: Code = &[
    PIPELINE,
    CORE,
    FIELD_IO,
    DISPLAY,
    SIMD,
    lumistack_factorizer::FINGERPRINT,
    lumistack_design::FINGERPRINT,
    lumistack_plot::FINGERPRINT,
];

/// From data to a plugin's files: code that passes data and writes, besides the plugin's own.
pub(crate) const PLUGINS: Code =
    &[PIPELINE, CORE, FIELD_IO, DISPLAY, lumistack_plugin_host::PLUGIN_FINGERPRINT, lumistack_plugin_host::FINGERPRINT];

/// From patterns to a report.
pub(crate) const REPORTS: Code = &[PIPELINE, CORE, DISPLAY, lumistack_plot::FINGERPRINT, lumistack_report::FINGERPRINT];

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// The fingerprint of a crate's present sources.
    fn of(name: &str, more: &[&str]) -> String {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name);
        lumistack_fingerprint::of(&folder, more).unwrap()
    }

    fn holds(code: Code, crates: &[&str]) {
        for name in crates {
            let more: &[&str] = if *name == "usd" { &["python"] } else { &[] };
            assert!(code.contains(&of(name, more).as_str()), "the sources of `{name}` are not in the key");
        }
    }

    /// A version number that must be raised by hand missed changes of a crate's sources.
    #[test]
    fn keys_hold_the_sources_of_all_that_makes_a_result() {
        let scene = ["pipeline", "core", "scene", "gltf", "usd", "splats", "shot", "field-io"];
        holds(SCENE, &scene);
        holds(VIEWS, &scene);
        holds(VIEWS, &["display", "simd", "pathtracer"]);
        holds(FIELDS, &["pipeline", "core", "display", "field-io", "shot"]);
        holds(PATTERNS, &["pipeline", "core", "display", "field-io", "simd", "factorizer", "plugin", "plugin-host"]);
        holds(DESIGNS, &["pipeline", "core", "display", "field-io", "simd", "factorizer", "design", "plot"]);
        holds(PLUGINS, &["pipeline", "core", "display", "field-io", "plugin", "plugin-host"]);
        holds(REPORTS, &["pipeline", "core", "display", "plot", "report"]);
    }
}
