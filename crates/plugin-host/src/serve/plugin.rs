//! A plugin, from the host's side.

use std::fmt;
use std::sync::Arc;

use lumistack_plugin::abi::{
    ABI_MAJOR, ABI_MINOR, Descriptor, ImporterVtable, NodeVtable, OutputVtable, SourceVtable, Str, kind,
};
use lumistack_plugin::wire::lent_text;
use lumistack_plugin::{Export, PluginError, Port, Schema, is_plugin_id};
use serde::{Deserialize, Serialize};

use crate::serve::functions::{Functions, Vtable};

/// The kind of a plugin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PluginKind {
    /// Converts files into scenes.
    Importer,
    /// Makes light fields.
    Source,
    /// Solves layer stacks for light fields.
    Node,
    /// Writes or shows the results.
    Output,
}

impl PluginKind {
    /// Returns the name of the kind in listings and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Importer => "importer",
            Self::Source => "source",
            Self::Node => "node",
            Self::Output => "output",
        }
    }
}

impl fmt::Display for PluginKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name();
        write!(f, "{} {name}", if name.starts_with(['i', 'o']) { "an" } else { "a" })
    }
}

/// The description of a plugin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PluginInfo {
    /// Name in job files and on the command line.
    pub id: String,
    /// The kind of the plugin.
    pub kind: PluginKind,
    /// Version of the plugin.
    pub version: String,
    /// The description; listings show its first sentence.
    pub doc: String,
    /// The kinds of data that the plugin accepts.
    pub ports: Vec<Port>,
    /// For an importer: file extensions that it reads, without the dot.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub extensions: Vec<String>,
    /// True for a presenter, which runs until the user closes it.
    pub presents: bool,
    /// The plugin's parameters.
    #[serde(flatten)]
    pub schema: Schema,
}

/// A plugin with a checked descriptor.
#[derive(Clone)]
pub struct Plugin {
    info: PluginInfo,
    functions: Arc<dyn Functions>,
}

impl Plugin {
    /// Makes a plugin from the `PLUGIN` of a compiled-in crate.
    ///
    /// # Errors
    /// If the plugin's description is invalid.
    pub fn compiled_in(export: &'static Export) -> Result<Self, PluginError> {
        // SAFETY: an `Export` holds a valid descriptor whose texts and functions are static.
        unsafe { Self::from_descriptor(export.descriptor()) }
    }

    /// Makes a plugin from the descriptor that its entry function returns.
    ///
    /// # Errors
    /// If the descriptor is null, too short, or of another major version of the interface. Also if
    /// this host does not support the plugin's kind, or the plugin's description is invalid.
    ///
    /// # Safety
    /// `descriptor` is null, or points to a descriptor of at least `size` bytes. All that it points
    /// to satisfies the documentation of [`Descriptor`] and lives as long as the process.
    pub unsafe fn from_descriptor(descriptor: *const Descriptor) -> Result<Self, PluginError> {
        if descriptor.is_null() {
            return Err(PluginError::Refused(
                "expected a descriptor from the plugin's entry function, found null".into(),
            ));
        }
        // SAFETY: version and size come first in every version of the struct.
        let (major, minor, size) = unsafe { ((*descriptor).abi_major, (*descriptor).abi_minor, (*descriptor).size) };
        // Refuse other major versions, and structs that are shorter than the struct of this
        // version.
        if major != ABI_MAJOR {
            let remedy = if major > ABI_MAJOR {
                "the plugin needs a newer version of this program"
            } else {
                "the plugin must be rebuilt"
            };
            return Err(PluginError::Refused(format!(
                "expected a plugin for version {ABI_MAJOR}.{ABI_MINOR} of the plugin interface (ABI), found a plugin for version {major}.{minor}; {remedy}"
            )));
        }
        if size < size_of::<Descriptor>() {
            return Err(PluginError::Refused(format!(
                "descriptor of version {major}.{minor}: expected {} bytes or more, found a size of {size} bytes",
                size_of::<Descriptor>()
            )));
        }
        // SAFETY: the descriptor is at least as long as this version's struct.
        let descriptor = unsafe { &*descriptor };
        // SAFETY: the texts live as long as the process.
        let text = |text: Str, what: &str| unsafe { lent_text(text, what) };
        // Parse and check id, parameters, functions, ports and extensions.
        let id = text(descriptor.id, "id")?.to_string();
        if !is_plugin_id(&id) {
            return Err(invalid_id(&id));
        }
        let refused = |what: String| PluginError::Refused(format!("plugin `{id}`: {what}"));
        let schema: Schema = serde_json::from_str(text(descriptor.schema_json, "parameters")?)
            .map_err(|error| refused(format!("parameters: {error}")))?;
        schema.check().map_err(refused)?;
        // SAFETY: a descriptor points to the functions of its kind.
        let (kind, vtable) = unsafe { vtable_of(descriptor) }.map_err(refused)?;
        let ports: Vec<Port> = Port::ALL.into_iter().filter(|port| descriptor.ports & port.bit() != 0).collect();
        if ports.is_empty() && kind != PluginKind::Source {
            return Err(refused("expected at least one input port in the descriptor, found no input port".into()));
        }
        let mut extensions = Vec::new();
        if let Vtable::Importer(importer) = vtable {
            extensions.extend(text(importer.extensions, "extensions")?.split_whitespace().map(String::from));
            if extensions.is_empty()
                || extensions.iter().any(|word| word.starts_with('.') || *word != word.to_lowercase())
            {
                return Err(refused(
                    "expected at least one extension of files, in lower case and without a dot".into(),
                ));
            }
        }
        let info = PluginInfo {
            kind,
            version: text(descriptor.version, "version")?.into(),
            doc: text(descriptor.doc, "doc")?.into(),
            ports,
            extensions,
            presents: matches!(vtable, Vtable::Output(output) if output.run.is_some()),
            schema,
            id,
        };
        Ok(Self { info, functions: Arc::new(vtable) })
    }

    /// Makes a plugin whose functions run in another process, which has sent the plugin's
    /// description.
    ///
    /// # Errors
    /// If the id or the parameters are invalid. The other process has checked the rest of the
    /// description.
    pub fn elsewhere(info: PluginInfo, functions: Arc<dyn Functions>) -> Result<Self, PluginError> {
        let refused = |what: String| PluginError::Refused(format!("plugin `{}`: {what}", info.id));
        if !is_plugin_id(&info.id) {
            return Err(invalid_id(&info.id));
        }
        info.schema.check().map_err(refused)?;
        Ok(Self { info, functions })
    }

    /// Returns the plugin's functions if the plugin is of the kind `wanted`, otherwise an error.
    pub(crate) fn of_kind(&self, wanted: PluginKind) -> Result<&Arc<dyn Functions>, PluginError> {
        if self.info.kind != wanted {
            let text = format!("plugin `{}`: expected {wanted}, found {}", self.info.id, self.info.kind);
            return Err(PluginError::Refused(text));
        }
        Ok(&self.functions)
    }

    /// Returns the plugin's functions, for a process that runs them for another process.
    pub fn functions(&self) -> &Arc<dyn Functions> {
        &self.functions
    }

    /// Returns the description of the plugin.
    pub fn info(&self) -> &PluginInfo {
        &self.info
    }
}

impl fmt::Debug for Plugin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Plugin").field(&self.info.id).finish()
    }
}

/// Returns a plugin's kind and its table of functions. Fails if a required function is missing.
///
/// # Safety
/// The descriptor's `vtable` is null, or points to the table of functions of its kind. The table
/// has at least as many bytes as its `size`, and lives as long as the process.
unsafe fn vtable_of(descriptor: &Descriptor) -> Result<(PluginKind, Vtable), String> {
    let missing = |kind: PluginKind| format!("expected all functions of {kind}, found a table that lacks one");
    let table = descriptor.vtable;
    // SAFETY: every table starts with its size.
    let size = if table.is_null() { 0 } else { unsafe { *table.cast::<usize>() } };
    match descriptor.kind {
        kind::IMPORTER if size >= size_of::<ImporterVtable>() => {
            // SAFETY: guaranteed by the caller, and the table is long enough.
            let found = unsafe { &*table.cast::<ImporterVtable>() };
            let whole = found.import.is_some();
            whole
                .then_some((PluginKind::Importer, Vtable::Importer(found)))
                .ok_or_else(|| missing(PluginKind::Importer))
        }
        kind::SOURCE if size >= size_of::<SourceVtable>() => {
            // SAFETY: as above.
            let found = unsafe { &*table.cast::<SourceVtable>() };
            found.make.map(|_| (PluginKind::Source, Vtable::Source(found))).ok_or_else(|| missing(PluginKind::Source))
        }
        kind::NODE if size >= size_of::<NodeVtable>() => {
            // SAFETY: as above.
            let found = unsafe { &*table.cast::<NodeVtable>() };
            found.make.map(|_| (PluginKind::Node, Vtable::Node(found))).ok_or_else(|| missing(PluginKind::Node))
        }
        kind::OUTPUT if size >= size_of::<OutputVtable>() => {
            // SAFETY: as above.
            let found = unsafe { &*table.cast::<OutputVtable>() };
            let whole =
                found.open.is_some() && found.submit.is_some() && found.finish.is_some() && found.close.is_some();
            whole.then_some((PluginKind::Output, Vtable::Output(found))).ok_or_else(|| missing(PluginKind::Output))
        }
        kind::IMPORTER => Err(missing(PluginKind::Importer)),
        kind::SOURCE => Err(missing(PluginKind::Source)),
        kind::NODE => Err(missing(PluginKind::Node)),
        kind::OUTPUT => Err(missing(PluginKind::Output)),
        other => Err(format!(
            "expected kind {} (importer), {} (source), {} (node) or {} (output), found {other}",
            kind::IMPORTER,
            kind::SOURCE,
            kind::NODE,
            kind::OUTPUT
        )),
    }
}

/// Returns the error for a plugin whose id is not valid.
fn invalid_id(found: &str) -> PluginError {
    let expected = "lower-case letters, digits and underscores, beginning with a letter";
    PluginError::Refused(format!("id of a plugin: expected {expected}, found `{found}`"))
}
