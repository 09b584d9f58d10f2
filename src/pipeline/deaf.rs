//! Whether chatter of the bar can be heard at all.

use super::Pipeline;
use crate::force::validity::Validity;

/// Why chatter cannot be heard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deaf {
    /// The tools are where the bar's band is another than was planned for.
    BandOutOfReach,
    /// On no watched axis the force is estimated rightly in any of the band.
    ForceAboveBand,
}

crate::keyframe::keep_list!(Deaf {
    BandOutOfReach => "band_out_of_reach",
    ForceAboveBand => "force_above_band",
});

impl Pipeline {
    /// Why chatter of the bar cannot be heard; nothing while on one watched axis at least the estimate is
    /// right in a part of the band.
    #[must_use]
    pub fn deaf(&self) -> Option<Deaf> {
        let mut watched = (0..self.channels.len()).filter(|axis| self.channels[*axis].watch);
        match self.out_of_reach {
            true => Some(Deaf::BandOutOfReach),
            false => watched.all(|axis| self.is_deaf(axis)).then_some(Deaf::ForceAboveBand),
        }
    }

    /// Whether the force of an axis is estimated rightly in no part of the band.
    pub(super) fn is_deaf(&self, axis: usize) -> bool {
        self.force_flags(axis).contains(Validity::FORCE_ABOVE_BAND)
    }
}
