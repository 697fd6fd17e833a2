//! The plugins that are compiled in.

use std::sync::LazyLock;

use lumistack_plugin::Export;

/// Hash of the sources of `lumistack-plugin`, the plugins' side of the interface. It is part of
/// cache keys.
pub const PLUGIN_FINGERPRINT: &str = lumistack_plugin::FINGERPRINT;

/// Builds the list of compiled-in plugins and the hashes of their crates' sources. Each line of the
/// macro's input names the feature that enables a crate, and the module that ends with
/// `export_plugin!`.
macro_rules! plugins {
    ($($feature:literal: $krate:ident $(:: $module:ident)*;)*) => {
        pub(crate) static BUILT_IN: &[(&LazyLock<Export>, &str)] = &[$(
            #[cfg(feature = $feature)]
            (&$krate $(:: $module)* ::PLUGIN, $krate::FINGERPRINT),
        )*];
    };
}

// The list is explicit: registration through linker sections silently drops crates that no code
// refers to.
plugins! {
    "baselines": lumistack_plugin_baselines::directional_sequence;
    "baselines": lumistack_plugin_baselines::integral_imaging;
    "baselines": lumistack_plugin_baselines::log_tomography;
    "baselines": lumistack_plugin_baselines::parallax_barrier;
    "baselines": lumistack_plugin_baselines::two_layer_nmf;
    "images": lumistack_plugin_images;
    "obj": lumistack_plugin_obj;
    "panels": lumistack_plugin_panels;
    "quilt": lumistack_plugin_quilt;
    "splats": lumistack_plugin_splats;
    "tensor-display": lumistack_plugin_tensor_display;
    "test-views": lumistack_plugin_test_views;
    "transparencies": lumistack_plugin_transparencies;
    "web-simulator": lumistack_plugin_web_simulator;
}

/// Returns true if two ids are equal when their hyphens are read as underscores.
pub(crate) fn same_id(a: &str, b: &str) -> bool {
    let plain = |byte: u8| if byte == b'-' { b'_' } else { byte };
    a.len() == b.len() && a.bytes().zip(b.bytes()).all(|(a, b)| plain(a) == plain(b))
}

/// Returns the hash of the sources of the compiled-in plugin `id`; `None` for other plugins. Cache
/// keys need the hash, since a plugin's version stays the same during development.
pub fn fingerprint_of(id: &str) -> Option<&'static str> {
    BUILT_IN.iter().find(|(export, _)| same_id(export.id(), id)).map(|(_, fingerprint)| *fingerprint)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_compiled_in_plugin_has_the_fingerprint_of_its_crate() {
        let mut all: Vec<&str> = BUILT_IN.iter().map(|(_, fingerprint)| *fingerprint).collect();
        assert!(all.iter().all(|fingerprint| !fingerprint.is_empty()));
        all.dedup();
        let crates = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), crates, "two crates have one fingerprint");
        assert_eq!(fingerprint_of("no_such_plugin"), None);
        let [a, b] = ["parallax_barrier", "parallax-barrier"].map(fingerprint_of);
        assert!(a.is_some() && a == b);
    }
}
