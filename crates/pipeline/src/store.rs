//! Run folders: their files, and how these are told from those of others.
//!
//! ```text
//! key        what a result depends on, as a hash          code           fingerprints of the crates that results pass through
//! stamps     which results are current                    views          cached pictures that carry their own hash
//! files      written whole or not at all                  settings       job.toml and display.toml with a seal
//! lock       one owner at a time                          names          what work writes under which name
//! folder     taken for a job                              left_overs     of runs that were killed
//! used       what the last run needed                     clean          frees the rest
//! handover   scenes that Blender handed over              plugin_files   files among the parameters of plugins
//! paged      light fields too large for memory         farm         units of work that are done
//! ```

pub(crate) mod clean;
pub(crate) mod code;
pub(crate) mod farm;
pub(crate) mod files;
pub(crate) mod folder;
pub(crate) mod handover;
pub(crate) mod key;
pub(crate) mod left_overs;
pub(crate) mod lock;
pub(crate) mod names;
pub(crate) mod paged;
pub(crate) mod plugin_files;
pub(crate) mod settings;
pub(crate) mod stamps;
pub(crate) mod used;
pub(crate) mod views;
