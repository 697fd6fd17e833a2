//! The plugin as a library of its own, as the loader requires.

extern crate lumistack_plugin_test_views;
