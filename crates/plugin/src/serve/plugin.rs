//! A plugin as a host sees it.

use std::fmt;

use lumistack_plugin_abi::{ABI_MAJOR, ABI_MINOR, Descriptor, OutputVtable, Str, kind};
use serde::Serialize;

use crate::boundary::lent_text;
use crate::{Export, PluginError, Port, Schema, is_plugin_id};

/// What a plugin is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PluginKind {
    /// Makes scenes from files.
    Importer,
    /// Makes light fields.
    Source,
    /// Turns light fields into layer stacks.
    Node,
    /// Takes what the graph makes and puts it somewhere.
    Output,
}

/// What a plugin says about itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PluginInfo {
    /// Name in job files and on the command line.
    pub id: String,
    /// What it is.
    pub kind: PluginKind,
    /// Version of the plugin.
    pub version: String,
    /// What it does; the first sentence stands in lists.
    pub doc: String,
    /// What it accepts.
    pub ports: Vec<Port>,
    /// Whether it runs until the user closes it.
    pub presents: bool,
    /// Its parameters.
    #[serde(flatten)]
    pub schema: Schema,
}

/// A plugin whose descriptor was checked.
#[derive(Clone)]
pub struct Plugin {
    info: PluginInfo,
    pub(crate) vtable: &'static OutputVtable,
}

impl Plugin {
    /// Takes a plugin that is compiled in: the `PLUGIN` of its crate.
    ///
    /// # Errors
    /// If the plugin describes itself badly.
    pub fn compiled_in(export: &'static Export) -> Result<Self, PluginError> {
        // SAFETY: an `Export` holds a valid descriptor whose texts and functions are static.
        unsafe { Self::from_descriptor(export.descriptor()) }
    }

    /// Takes a plugin from its entry function.
    ///
    /// # Errors
    /// If it was built for another version of the boundary, is of a kind that this host does not drive, or describes itself badly.
    ///
    /// # Safety
    /// `descriptor` is null or points to a descriptor at least as far as its `size` says, and all that it points to is as the documentation
    /// of [`Descriptor`] says and lives as long as the process.
    pub unsafe fn from_descriptor(descriptor: *const Descriptor) -> Result<Self, PluginError> {
        if descriptor.is_null() {
            return Err(PluginError::Refused("the plugin could not describe itself".into()));
        }
        // SAFETY: version and size come first in every version of the struct.
        let (major, minor, size) = unsafe { ((*descriptor).abi_major, (*descriptor).abi_minor, (*descriptor).size) };
        if major != ABI_MAJOR || size < size_of::<Descriptor>() {
            return Err(PluginError::Refused(format!(
                "built for version {major}.{minor} of the plugin boundary, this program has {ABI_MAJOR}.{ABI_MINOR}"
            )));
        }
        // SAFETY: it is at least as long as this version's struct.
        let descriptor = unsafe { &*descriptor };
        // SAFETY: the texts live as long as the process.
        let text = |text: Str, what: &str| unsafe { lent_text(text, what) };
        let id = text(descriptor.id, "id")?.to_string();
        if !is_plugin_id(&id) {
            return Err(PluginError::Refused(format!("`{id}` cannot be a plugin's id")));
        }
        let refused = |what: String| PluginError::Refused(format!("plugin `{id}`: {what}"));
        if descriptor.kind != kind::OUTPUT {
            return Err(refused(format!("plugins of kind {} are not driven by this version", descriptor.kind)));
        }
        let schema: Schema = serde_json::from_str(text(descriptor.schema_json, "parameters")?)
            .map_err(|error| refused(format!("parameters: {error}")))?;
        schema.check().map_err(refused)?;
        // SAFETY: an output's descriptor points to an output's functions.
        let vtable = unsafe { descriptor.vtable.cast::<OutputVtable>().as_ref() }
            .filter(|vtable| vtable.size >= size_of::<OutputVtable>())
            .filter(|vtable| vtable.open.is_some() && vtable.submit.is_some())
            .filter(|vtable| vtable.finish.is_some() && vtable.close.is_some())
            .ok_or_else(|| refused("a function of an output is missing".into()))?;
        let ports: Vec<Port> = Port::ALL.into_iter().filter(|port| descriptor.ports & port.bit() != 0).collect();
        if ports.is_empty() {
            return Err(refused("it accepts nothing".into()));
        }
        let info = PluginInfo {
            kind: PluginKind::Output,
            version: text(descriptor.version, "version")?.into(),
            doc: text(descriptor.doc, "doc")?.into(),
            ports,
            presents: vtable.run.is_some(),
            schema,
            id,
        };
        Ok(Self { info, vtable })
    }

    /// What it says about itself.
    pub fn info(&self) -> &PluginInfo {
        &self.info
    }
}

impl fmt::Debug for Plugin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Plugin").field(&self.info.id).finish()
    }
}
