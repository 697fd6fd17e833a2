//! The plugin as a library for the loader.

extern crate lumistack_plugin_web_simulator;
