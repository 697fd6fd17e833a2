//! Run folders: their files, and the checks that a file is from Lumistack.
//!
//! ```text
//! key        hash of a result's inputs           code           fingerprints of crates, for keys
//! stamps     records of results, with their keys views          cached pictures with hashes
//! files      atomic writes                       settings       job.toml, display.toml with hashes
//! lock       one owner of a folder at a time     names          names of the files of a run
//! folder     locks a folder for a job            left_overs     files of killed runs
//! used       files that the last run used        clean          removes other cached files
//! handover   scenes that Blender exported        plugin_files   files in parameters of plugins
//! farm       finished units of work
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
pub(crate) mod plugin_files;
pub(crate) mod settings;
pub(crate) mod space;
pub(crate) mod stamps;
pub(crate) mod used;
pub(crate) mod views;
