//! The plugins as one library, as the loader requires.

extern crate lumistack_plugin_baselines;
