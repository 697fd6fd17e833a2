//! Time steps of a sequence.

use lumistack_plugin_abi as abi;

use crate::PluginError;
use crate::wire::needs;

/// One time step of a sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Time {
    /// Number of the time step. For outputs and nodes the first number is 0; a still has the number
    /// 0. For a source the job sets the first number.
    pub index: u64,
    /// Time in the scene, seconds.
    pub seconds: f64,
}

impl Time {
    /// Returns the time step as the C struct.
    pub fn to_abi(self) -> abi::Time {
        abi::Time { size: size_of::<abi::Time>(), index: self.index, seconds: self.seconds }
    }

    /// # Safety
    /// `time` is lent for the call, and its `size` is set.
    pub(crate) unsafe fn from_abi(time: *const abi::Time) -> Result<Self, PluginError> {
        // SAFETY: guaranteed by the caller.
        unsafe {
            needs((*time).size, size_of::<abi::Time>())?;
            Ok(Self { index: (*time).index, seconds: (*time).seconds })
        }
    }
}
