//! The plugins as one library, as the loader takes it.

extern crate lumistack_plugin_baselines;
