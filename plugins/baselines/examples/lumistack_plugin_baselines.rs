//! The plugins of this crate as one shared library, which the host's loader opens.

extern crate lumistack_plugin_baselines;
