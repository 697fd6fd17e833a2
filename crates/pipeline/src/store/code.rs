//! Code of cached results: the fingerprints of all crates whose code affects a result. If one of
//! the crates changes, the result is not reused.

/// Fingerprints of crates.
pub(crate) type Code = &'static [&'static str];

/// Fingerprint of this crate, which computes the keys.
const PIPELINE: &str = env!("LUMISTACK_FINGERPRINT");
const CORE: &str = lumistack_core::FINGERPRINT;
const DISPLAY: &str = lumistack_display::FINGERPRINT;
const FIELD_IO: &str = lumistack_field_io::FINGERPRINT;
const SIMD: &str = lumistack_simd::FINGERPRINT;

/// Code that makes a lit scene from scene files.
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

/// Code that makes traced radiance, depths and the window's placement from scene files.
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

/// Code that writes files of a light field.
pub(crate) const FIELDS: Code = &[PIPELINE, CORE, FIELD_IO, DISPLAY, lumistack_shot::FINGERPRINT];

/// Code that makes patterns from a light field.
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

/// Code that makes a row of a sweep's table from a light field.
pub(crate) const DESIGNS: Code = &[
    PIPELINE,
    CORE,
    FIELD_IO,
    DISPLAY,
    SIMD,
    lumistack_factorizer::FINGERPRINT,
    lumistack_plugin_host::PLUGIN_FINGERPRINT,
    lumistack_plugin_host::FINGERPRINT,
    lumistack_design::FINGERPRINT,
    lumistack_plot::FINGERPRINT,
];

/// Code that passes data to a plugin and writes the plugin's files. The code of the plugin itself
/// is not included.
pub(crate) const PLUGINS: Code =
    &[PIPELINE, CORE, FIELD_IO, DISPLAY, lumistack_plugin_host::PLUGIN_FINGERPRINT, lumistack_plugin_host::FINGERPRINT];

/// Code that makes a report from patterns.
pub(crate) const REPORTS: Code = &[PIPELINE, CORE, DISPLAY, lumistack_plot::FINGERPRINT, lumistack_report::FINGERPRINT];

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// Computes the fingerprint of a crate's present sources.
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

    /// Keys must contain the fingerprint of every crate that affects a result. A version number
    /// that was raised by hand would miss some changes.
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
