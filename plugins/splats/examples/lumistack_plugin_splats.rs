//! The plugin as a library of its own, as the loader takes it.

extern crate lumistack_plugin_splats;
