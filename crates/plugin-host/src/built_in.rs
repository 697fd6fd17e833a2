//! Which code the compiled-in plugins are.

/// Hash of the sources of the plugins' side of the boundary, for keys of kept results.
pub const PLUGIN_FINGERPRINT: &str = lumistack_plugin::FINGERPRINT;

/// Hash of the sources of the compiled-in plugin `id`, for keys of kept results; `None` of others. A plugin's version stays the same while somebody works
/// on it, its sources do not.
pub fn fingerprint_of(id: &str) -> Option<&'static str> {
    Some(match id {
        #[cfg(feature = "directional-sequence")]
        "directional_sequence" => lumistack_plugin_directional_sequence::FINGERPRINT,
        #[cfg(feature = "images")]
        "images" => lumistack_plugin_images::FINGERPRINT,
        #[cfg(feature = "integral-imaging")]
        "integral_imaging" => lumistack_plugin_integral_imaging::FINGERPRINT,
        #[cfg(feature = "log-tomography")]
        "log_tomography" => lumistack_plugin_log_tomography::FINGERPRINT,
        #[cfg(feature = "obj")]
        "obj" => lumistack_plugin_obj::FINGERPRINT,
        #[cfg(feature = "parallax-barrier")]
        "parallax_barrier" => lumistack_plugin_parallax_barrier::FINGERPRINT,
        #[cfg(feature = "quilt")]
        "quilt" => lumistack_plugin_quilt::FINGERPRINT,
        #[cfg(feature = "test-views")]
        "test_views" => lumistack_plugin_test_views::FINGERPRINT,
        #[cfg(feature = "transparencies")]
        "transparencies" => lumistack_plugin_transparencies::FINGERPRINT,
        #[cfg(feature = "two-layer-nmf")]
        "two_layer_nmf" => lumistack_plugin_two_layer_nmf::FINGERPRINT,
        #[cfg(feature = "web-simulator")]
        "web_simulator" => lumistack_plugin_web_simulator::FINGERPRINT,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Registry;

    #[test]
    fn every_compiled_in_plugin_has_a_fingerprint_of_its_own() {
        let registry = Registry::built_in().unwrap();
        let mut all: Vec<&str> = registry.infos().map(|info| fingerprint_of(&info.id).expect(&info.id)).collect();
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), count);
        assert_eq!(fingerprint_of("no_such_plugin"), None);
    }
}
