//! The swarm itself: particles that fly, remember, and learn from one another.
//!
//! Kennedy and Eberhart, *Particle swarm optimization* (1995), with the inertia of paper 000, Eqs. 26, 27 and 29:
//!
//! ```text
//! v ← ω v + d₁ a₁ (p - x) + d₂ a₂ (g - x),     x ← x + v
//! ```
//!
//! with `a₁`, `a₂` drawn from 0 to 1 for every coordinate, `p` the particle's own best place and `g` the best one that it
//! hears of.

use super::{Boundary, SwarmParams, Topology};
use crate::optimize::{Optimizer, comparable, inside, spread_of, three_others};
use agv_core::{
    Error, check,
    compute::{Seed, Stream},
};
use rand::RngExt;

/// A particle swarm; the [`Optimizer`] role.
///
/// What a generation draws depends on the seed and on its number alone. A generation costs O(particles · dimension)
/// beside the evaluations and allocates nothing.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "checkpoint::RawSwarm"))]
pub struct Swarm {
    params: SwarmParams,
    dimension: usize,
    seed: Seed,
    /// Generations told, and those since the environment was last found changed.
    generation: u64,
    age: usize,
    /// Places of the sensitive particles, then of the others: what is asked for. Where the best place is watched, it is
    /// the first.
    places: Vec<f64>,
    velocities: Vec<f64>,
    best_places: Vec<f64>,
    #[cfg_attr(feature = "serde", serde(with = "crate::optimize::stored_costs"))]
    best_costs: Vec<f64>,
    /// Last costs of the sensitive particles; without meaning before the first generation.
    #[cfg_attr(feature = "serde", serde(with = "crate::optimize::stored_costs"))]
    sensed: Vec<f64>,
    /// Index of the particle with the least of the best costs.
    leader: usize,
    links: Vec<usize>,
    /// Scratch: whom each particle follows.
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    guides: Vec<usize>,
    /// Scratch: particles in the order of their costs.
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    order: Vec<usize>,
    /// Changes of the environment noticed so far.
    changes: usize,
}

impl Swarm {
    /// A swarm of random particles in the unit cube of `dimension` coordinates.
    ///
    /// # Errors
    /// No dimension, or the first parameter that is out of range.
    pub fn new(dimension: usize, params: SwarmParams, seed: Seed) -> Result<Self, Error> {
        check::at_least("dimension", dimension, 1)?;
        params.check()?;
        let (count, sensors) = (params.particles, params.sensing.map_or(0, |sensing| sensing.count()));
        let mut stream = seed.stream(0, 0);
        let places = (0..(sensors + count) * dimension).map(|_| stream.random()).collect();
        let limit = params.velocity_limit;
        let velocities = (0..count * dimension).map(|_| draw_velocity(limit, &mut stream)).collect();
        let mut links = vec![0; params.topology.link_count(count)];
        Topology::draw_links(&mut links, count, &mut stream);
        Ok(Self {
            params,
            dimension,
            seed,
            generation: 0,
            age: 0,
            places,
            velocities,
            best_places: vec![0.0; count * dimension],
            best_costs: vec![f64::INFINITY; count],
            sensed: vec![f64::INFINITY; sensors],
            leader: 0,
            links,
            guides: vec![0; count],
            order: (0..count).collect(),
            changes: 0,
        })
    }

    /// Puts the first particle at a place of the unit cube, where good values are known or in use.
    ///
    /// # Errors
    /// A place of another dimension or outside of the cube.
    pub fn starting_at(mut self, place: &[f64]) -> Result<Self, Error> {
        check::length("place", place.len(), self.dimension)?;
        for &x in place {
            check::in_range("place", x, 0.0, 1.0)?;
        }
        let first = self.sensed.len() * self.dimension;
        self.places[first..first + self.dimension].copy_from_slice(place);
        Ok(self)
    }

    /// What the swarm is made of.
    pub const fn params(&self) -> &SwarmParams {
        &self.params
    }

    /// How often the sensitive particles have noticed a change.
    pub const fn changes(&self) -> usize {
        self.changes
    }

    /// The particles' places, one after another.
    pub fn particles(&self) -> &[f64] {
        &self.places[self.sensed.len() * self.dimension..]
    }

    /// Whether the costs of the sensitive particles differ from what they were.
    fn senses_change(&mut self, costs: &[f64]) -> bool {
        let Some(sensing) = self.params.sensing else { return false };
        let mut changed = false;
        for (before, &cost) in self.sensed.iter_mut().zip(costs) {
            let now = comparable(cost);
            changed |= self.generation > 0 && sensing.threshold.exceeded(*before, now);
            *before = now;
        }
        changed
    }

    /// Takes what the particles just learned into their memories; `true` if the swarm's best cost fell.
    fn remember(&mut self, costs: &[f64]) -> bool {
        let (dimension, first) = (self.dimension, self.sensed.len() * self.dimension);
        let fresh = self.age == 0;
        let before = if fresh { f64::INFINITY } else { self.best_costs[self.leader] };
        for (i, &cost) in costs.iter().enumerate() {
            let cost = comparable(cost);
            // The first cost in an environment is remembered whatever it is: a particle always has a best place.
            if fresh || cost < self.best_costs[i] {
                self.best_costs[i] = cost;
                let place = &self.places[first + i * dimension..][..dimension];
                self.best_places[i * dimension..][..dimension].copy_from_slice(place);
            }
        }
        let better = |a: usize, b: usize| if self.best_costs[b] < self.best_costs[a] { b } else { a };
        self.leader = (1..costs.len()).fold(0, better);
        self.best_costs[self.leader] < before
    }

    /// Keeps the sensitive particle that watches the best place there; after a change it is the one that knows what the
    /// old best place is worth.
    fn watch_best(&mut self, changed: bool) {
        if !self.params.sensing.is_some_and(|sensing| sensing.watch_best) {
            return;
        }
        let best = self.leader * self.dimension..(self.leader + 1) * self.dimension;
        if changed && self.sensed[0] < self.best_costs[self.leader] {
            self.best_costs[self.leader] = self.sensed[0];
            self.best_places[best].copy_from_slice(&self.places[..self.dimension]);
        } else {
            self.sensed[0] = self.best_costs[self.leader];
            self.places[..self.dimension].copy_from_slice(&self.best_places[best]);
        }
    }

    /// Scatters the worst part of the swarm, after the environment has changed.
    fn reseed(&mut self, part: f64, stream: &mut Stream) {
        let (dimension, first) = (self.dimension, self.sensed.len() * self.dimension);
        let costs = &self.best_costs;
        // Ties by index, so that the order is one.
        self.order.sort_unstable_by(|&a, &b| costs[b].total_cmp(&costs[a]).then(a.cmp(&b)));
        let count = (part * self.order.len() as f64).round() as usize;
        for &i in &self.order[..count] {
            self.places[first + i * dimension..][..dimension].fill_with(|| stream.random());
            self.velocities[i * dimension..][..dimension]
                .fill_with(|| draw_velocity(self.params.velocity_limit, stream));
            // What it remembers it has seen in the new environment, so it keeps it.
        }
    }

    /// Moves every particle to where it is to be evaluated next.
    fn fly(&mut self, stream: &mut Stream) {
        let (dimension, first, params) = (self.dimension, self.sensed.len() * self.dimension, self.params);
        params.topology.guides_into(&self.best_costs, &self.links, &mut self.guides);
        let best = |i: usize| &self.best_places[i * dimension..][..dimension];
        let particles =
            self.places[first..].chunks_exact_mut(dimension).zip(self.velocities.chunks_exact_mut(dimension));
        for (i, (place, velocity)) in particles.enumerate() {
            if params.differential > 0.0 && stream.random::<f64>() < params.differential {
                let [a, b, c] = three_others(i, params.particles, stream).map(best);
                differential_move(place, best(i), [a, b, c], stream);
            } else {
                let (d1, d2) = params.acceleration.draw(stream);
                let (inertia, factor) = params.inertia.weights(self.age - 1, d1 + d2);
                let flight = Flight { inertia, own: factor * d1, guide: factor * d2, params: &params };
                flight.advance(place, velocity, best(i), best(self.guides[i]), stream);
            }
        }
    }
}

/// The weights of one particle's flight.
struct Flight<'a> {
    inertia: f64,
    own: f64,
    guide: f64,
    params: &'a SwarmParams,
}

impl Flight<'_> {
    fn advance(&self, place: &mut [f64], velocity: &mut [f64], own: &[f64], guide: &[f64], stream: &mut Stream) {
        let limit = self.params.velocity_limit;
        for (((x, v), &p), &g) in place.iter_mut().zip(velocity).zip(own).zip(guide) {
            let (a1, a2): (f64, f64) = (stream.random(), stream.random());
            *v = self.inertia * *v + self.own * a1 * (p - *x) + self.guide * a2 * (g - *x);
            *v = v.clamp(-limit, limit);
            *x += *v;
            if !(0.0..=1.0).contains(x) {
                let bound = x.clamp(0.0, 1.0);
                (*x, *v) = match self.params.boundary {
                    Boundary::Clamp => (bound, 0.0),
                    // Velocities are at most one, so that one reflection is enough.
                    Boundary::Reflect => (2.0 * bound - *x, -*v),
                };
            }
        }
    }
}

/// Coordinates from `a + F (b - c)`, the factor `F` drawn from 0.5 to 1; one in ten from the particle's own best place. The
/// numbers are those of [`DifferentialEvolutionParams`](crate::evolution::DifferentialEvolutionParams).
fn differential_move(place: &mut [f64], own: &[f64], [a, b, c]: [&[f64]; 3], stream: &mut Stream) {
    let factor = stream.random_range(0.5..=1.0);
    let always = stream.random_range(0..place.len());
    for (d, x) in place.iter_mut().enumerate() {
        let moved = d == always || stream.random::<f64>() < 0.9;
        *x = if moved { inside(a[d] + factor * (b[d] - c[d]), a[d]) } else { own[d] };
    }
}

impl Optimizer for Swarm {
    fn dimension(&self) -> usize {
        self.dimension
    }

    fn ask(&self) -> &[f64] {
        &self.places
    }

    fn tell(&mut self, costs: &[f64]) -> Result<(), Error> {
        let sensors = self.sensed.len();
        check::length("costs", costs.len(), sensors + self.params.particles)?;
        let changed = self.senses_change(&costs[..sensors]);
        self.generation += 1;
        let mut stream = self.seed.stream(self.generation, 0);
        if changed {
            // Memories of the old environment are worth nothing; this generation has seen the new one.
            self.changes += 1;
            self.age = 0;
        }
        let improved = self.remember(&costs[sensors..]);
        self.watch_best(changed);
        if !improved {
            Topology::draw_links(&mut self.links, self.params.particles, &mut stream);
        }
        self.age += 1;
        self.fly(&mut stream);
        if let (true, Some(sensing)) = (changed, self.params.sensing) {
            self.reseed(sensing.reseed, &mut stream);
        }
        Ok(())
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        let best = &self.best_places[self.leader * self.dimension..][..self.dimension];
        (self.generation > 0).then_some((best, self.best_costs[self.leader]))
    }

    fn spread(&self) -> f64 {
        spread_of(self.particles(), self.dimension)
    }
}

fn draw_velocity(limit: f64, stream: &mut Stream) -> f64 {
    limit * stream.random_range(-1.0..=1.0)
}

#[cfg(feature = "serde")]
mod checkpoint;
#[cfg(test)]
mod tests;
