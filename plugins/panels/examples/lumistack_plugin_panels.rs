//! The plugin as a shared library, which the host's loader opens.

extern crate lumistack_plugin_panels;
