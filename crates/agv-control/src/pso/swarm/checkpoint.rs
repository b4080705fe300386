//! A swarm read from a checkpoint: as long as one made anew, and within its bounds.

use super::{Swarm, SwarmParams};
use crate::optimize::stored_costs;
use agv_core::{Error, check, compute::Seed};

#[derive(serde::Deserialize)]
pub(super) struct RawSwarm {
    params: SwarmParams,
    dimension: usize,
    seed: Seed,
    generation: u64,
    age: usize,
    places: Vec<f64>,
    velocities: Vec<f64>,
    best_places: Vec<f64>,
    #[serde(with = "stored_costs")]
    best_costs: Vec<f64>,
    #[serde(with = "stored_costs")]
    sensed: Vec<f64>,
    leader: usize,
    links: Vec<usize>,
    changes: usize,
}

impl TryFrom<RawSwarm> for Swarm {
    type Error = Error;

    fn try_from(raw: RawSwarm) -> Result<Self, Error> {
        // Lengths before anything is made of them: a checkpoint must not ask for more memory than it fills.
        let count = raw.params.particles;
        check::length("velocities", raw.velocities.len(), count.saturating_mul(raw.dimension))?;
        check::length("sensed", raw.sensed.len(), raw.params.sensing.map_or(0, |sensing| sensing.count()))?;
        check::length("links", raw.links.len(), raw.params.topology.link_count(count))?;
        let fresh = Self::new(raw.dimension, raw.params, raw.seed)?;
        check::length("places", raw.places.len(), fresh.places.len())?;
        check::length("best_places", raw.best_places.len(), fresh.best_places.len())?;
        check::length("best_costs", raw.best_costs.len(), count)?;
        for &place in raw.places.iter().chain(&raw.best_places) {
            check::in_range("place", place, 0.0, 1.0)?;
        }
        let limit = raw.params.velocity_limit;
        for &velocity in &raw.velocities {
            check::in_range("velocity", velocity, -limit, limit)?;
        }
        for &particle in raw.links.iter().chain([&raw.leader]) {
            check::in_range("particle", particle as f64, 0.0, count as f64 - 1.0)?;
        }
        // Ages count from the first generation on.
        check::in_range("age", raw.age as f64, f64::from(u8::from(raw.generation > 0)), raw.generation as f64)?;
        Ok(Self {
            generation: raw.generation,
            age: raw.age,
            places: raw.places,
            velocities: raw.velocities,
            best_places: raw.best_places,
            best_costs: raw.best_costs,
            sensed: raw.sensed,
            leader: raw.leader,
            links: raw.links,
            changes: raw.changes,
            ..fresh
        })
    }
}
