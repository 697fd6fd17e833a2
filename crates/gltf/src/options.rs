//! Options for loading a file: a time, an animation, and a variant of materials.

use crate::error::Fault;

/// Largest width or height of a picture, in texels.
pub(crate) const MAX_SIDE: u32 = 1 << 15;

/// Largest size of a buffer view after decompression, bytes.
pub(crate) const MAX_VIEW_BYTES: u64 = 2 << 30;

/// Choices of [`load_with`](crate::load_with). By default, nodes keep their own transforms and
/// weights, and the default materials are used.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadOptions {
    /// Time at which animations are sampled, in seconds. Before its first key, an animation has the
    /// value of the first key; after its last key, that of the last key. `None`: time 0 with an
    /// [`animation`](Self::animation), otherwise the nodes' own values.
    pub time_s: Option<f64>,
    /// Name or number of the animation. `None` with a [`time_s`](Self::time_s): all animations
    /// together if no two move the same property of a node, otherwise the first. `None` without a
    /// time: no animation.
    pub animation: Option<String>,
    /// Name or number of the material variant (`KHR_materials_variants`). `None`: the default
    /// materials.
    pub variant: Option<String>,
    /// Largest number of bytes that the scene without its pictures may decode to. A small file can
    /// decode to any size, since many primitives may share one accessor. A file over the limit is
    /// refused, so that it cannot exhaust the machine. Default 8 GiB.
    pub max_decoded_bytes: u64,
    /// Largest number of bytes that all decoded pictures of the scene may take, in addition to
    /// `max_decoded_bytes`. The sizes in all headers are added up before the first picture is
    /// decoded. Default 8 GiB.
    pub max_picture_bytes: u64,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self { time_s: None, animation: None, variant: None, max_decoded_bytes: 8 << 30, max_picture_bytes: 8 << 30 }
    }
}

/// Returns the index of the entry that `wanted` names or numbers. A name takes precedence over a
/// number.
pub(crate) fn choose(what: &'static str, wanted: &str, names: &[Option<&str>]) -> Result<usize, Fault> {
    let by_name = names.iter().position(|name| *name == Some(wanted));
    let by_number = || wanted.parse().ok().filter(|&number: &usize| number < names.len());
    by_name.or_else(by_number).ok_or_else(|| {
        let known: Vec<String> = names.iter().enumerate().map(|(i, name)| label(i, *name)).collect();
        Fault::NoSuch { what, wanted: wanted.to_owned(), known: known.join(", ") }
    })
}

/// Returns the number and name of an entry, for messages.
pub(crate) fn label(number: usize, name: Option<&str>) -> String {
    name.map_or_else(|| number.to_string(), |name| format!("{number} ({name})"))
}
