//! The descriptor and the entry symbol that a plugin exports.

use std::panic::catch_unwind;
use std::sync::LazyLock;

use lumistack_plugin_abi::{ABI_MAJOR, ABI_MINOR, Descriptor, Str, kind, port};

use crate::makers::{importer_vtable, node_vtable, source_vtable};
use crate::output::vtable_of;

use crate::{ImporterPlugin, NodePlugin, OutputPlugin, Schema, SourcePlugin};

/// The descriptor of a plugin written with this crate's safe traits.
#[derive(Clone, Copy, Debug)]
pub struct Export {
    id: &'static str,
    descriptor: Descriptor,
}

impl Export {
    /// Describes an output plugin. [`export_plugin!`](crate::export_plugin) calls this function
    /// once per plugin. The descriptor's texts are never freed.
    pub fn output<P: OutputPlugin>(id: &'static str, version: &'static str) -> Self {
        let ports = P::PORTS.iter().fold(0, |set, port| set | port.bit());
        Self::describe(kind::OUTPUT, ports, id, version, P::DOC, P::schema(), vtable_of::<P>())
    }

    /// Describes an importer. [`export_plugin!`](crate::export_plugin) calls this function.
    pub fn importer<P: ImporterPlugin>(id: &'static str, version: &'static str) -> Self {
        let vtable = Box::leak(Box::new(importer_vtable::<P>()));
        Self::describe(kind::IMPORTER, port::FILE, id, version, P::DOC, P::schema(), vtable)
    }

    /// Describes a source. [`export_plugin!`](crate::export_plugin) calls this function.
    pub fn source<P: SourcePlugin>(id: &'static str, version: &'static str) -> Self {
        let vtable = Box::leak(Box::new(source_vtable::<P>()));
        Self::describe(kind::SOURCE, 0, id, version, P::DOC, P::schema(), vtable)
    }

    /// Describes a node. [`export_plugin!`](crate::export_plugin) calls this function.
    pub fn node<P: NodePlugin>(id: &'static str, version: &'static str) -> Self {
        let vtable = Box::leak(Box::new(node_vtable::<P>()));
        Self::describe(kind::NODE, port::LIGHT_FIELD, id, version, P::DOC, P::schema(), vtable)
    }

    fn describe<V>(
        kind: u32,
        ports: u32,
        id: &'static str,
        version: &'static str,
        doc: &'static str,
        schema: Schema,
        vtable: &'static V,
    ) -> Self {
        let schema_json: &'static str = schema.to_json().leak();
        let descriptor = Descriptor {
            abi_major: ABI_MAJOR,
            abi_minor: ABI_MINOR,
            size: size_of::<Descriptor>(),
            kind,
            ports,
            id: Str::new(id),
            version: Str::new(version),
            doc: Str::new(doc),
            schema_json: Str::new(schema_json),
            vtable: (&raw const *vtable).cast(),
        };
        Self { id, descriptor }
    }

    /// Returns the plugin's name in job files and on the command line.
    pub fn id(&self) -> &'static str {
        self.id
    }

    /// Returns the C descriptor.
    pub fn descriptor(&self) -> &Descriptor {
        &self.descriptor
    }
}

/// Returns a plugin's descriptor, as the result of its entry function. Returns null if the
/// construction of the descriptor panics.
pub fn entry_of(plugin: &'static LazyLock<Export>) -> *const Descriptor {
    catch_unwind(|| &raw const *plugin.descriptor()).unwrap_or(std::ptr::null())
}

/// Returns true if a text can be a plugin's id: it has lower-case letters, digits and underscores,
/// and begins with a letter. The name of a plugin's entry symbol ends with the id.
pub const fn is_plugin_id(id: &str) -> bool {
    let id = id.as_bytes();
    let mut i = 0;
    while i < id.len() {
        if !(id[i].is_ascii_lowercase() || i > 0 && (id[i].is_ascii_digit() || id[i] == b'_')) {
            return false;
        }
        i += 1;
    }
    !id.is_empty()
}

/// `export_plugin!("id", Type)` belongs at the end of a plugin's module. It defines the static
/// `PLUGIN`, for hosts with the plugin compiled in, and the symbol `lumistack_plugin_entry_<id>`
/// for hosts that load libraries. The plugin's version is the version of its crate. Without a kind
/// the plugin is an output. Other plugins state their kind: `export_plugin!("id", Type as
/// importer)`, `as source`, `as node`.
#[macro_export]
macro_rules! export_plugin {
    ($id:literal, $type:ty) => {
        $crate::export_plugin!($id, $type as output);
    };
    ($id:literal, $type:ty as $kind:ident) => {
        const _: () = ::std::assert!(
            $crate::is_plugin_id($id),
            "a plugin's id has lower-case letters, digits and underscores, a letter first"
        );

        #[doc = ::std::concat!("The plugin `", $id, "`, for a host that has it compiled in.")]
        pub static PLUGIN: ::std::sync::LazyLock<$crate::Export> =
            ::std::sync::LazyLock::new(|| $crate::Export::$kind::<$type>($id, ::std::env!("CARGO_PKG_VERSION")));

        #[doc = ::std::concat!("The function by which a loader finds the plugin `", $id, "`.")]
        // SAFETY: the name ends in the plugin's id, which is unique in the program.
        #[unsafe(export_name = ::std::concat!("lumistack_plugin_entry_", $id))]
        pub extern "C" fn lumistack_plugin_entry() -> *const $crate::abi::Descriptor {
            $crate::entry_of(&PLUGIN)
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Port;

    #[test]
    fn ids_can_end_a_symbol() {
        assert!(is_plugin_id("images") && is_plugin_id("web_simulator2"));
        for id in ["", "2d", "_a", "Images", "web-simulator", "a b", "é"] {
            assert!(!is_plugin_id(id), "{id}");
        }
    }

    #[test]
    fn ports_have_their_own_bits_and_the_names_of_the_job_file() {
        assert_eq!(Port::ALL.iter().fold(0, |set, port| set | port.bit()).count_ones(), 4);
        for port in Port::ALL {
            assert_eq!(serde_json::to_value(port).unwrap(), port.to_string());
        }
    }
}
