//! A force of position and velocity alone that a model states, evaluated as it stands there.

use super::*;
use crate::plant::effects::EffectKind;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stated {
    pub(crate) effect: EffectKind,
}

impl Law for Stated {
    fn facts(&self) -> Facts {
        Facts::of(self.effect, Size::Free, &[])
    }
}
