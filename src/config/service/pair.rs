//! Two values, one for each axis of the turret: a third is no slip to be overlooked.

use crate::units::counted;
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<T>")]
pub(super) struct Pair<T>(pub(super) [T; 2]);

impl<T> TryFrom<Vec<T>> for Pair<T> {
    type Error = String;

    fn try_from(values: Vec<T>) -> Result<Self, String> {
        let count = values.len();
        let two = values.try_into().map_err(|_| format!("{}, expected two", counted(count, "value")))?;
        Ok(Self(two))
    }
}
