//! Costs in a checkpoint: infinity, which JSON cannot store, becomes nothing and comes back.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub(crate) fn serialize<S: Serializer>(costs: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(costs.iter().map(|&cost| finite(cost)))
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let costs = Vec::<Option<f64>>::deserialize(deserializer)?;
    Ok(costs.into_iter().map(|cost| cost.unwrap_or(f64::INFINITY)).collect())
}

/// The same for a single cost.
pub(crate) mod single {
    use super::{Deserialize, Deserializer, Serialize, Serializer, finite};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
    pub(crate) fn serialize<S: Serializer>(cost: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        finite(*cost).serialize(serializer)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
    }
}

/// An endlessly good cost is kept as the least number.
fn finite(cost: f64) -> Option<f64> {
    (cost < f64::INFINITY).then_some(cost.max(f64::MIN))
}
