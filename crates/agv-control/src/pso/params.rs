//! What a swarm is made of.

use super::{Inertia, Sensing, Topology};
use agv_core::{Error, check, compute::Stream};
use rand::RngExt;

/// How strongly a particle is drawn to its own best place (d₁) and to its informants' (d₂).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Acceleration {
    /// The same in all iterations.
    Fixed {
        /// d₁, towards the particle's own best place.
        cognitive: f64,
        /// d₂, towards the best place of its informants.
        social: f64,
    },
    /// Eq. 30 of paper 000 for costs with one minimum: `d₁ = d₂` drawn from 0.95 to 1.05 for every particle and iteration.
    Unimodal,
    /// Eq. 30 for costs with several minima: `d₁ = d₂` drawn from 1.4 to 1.8.
    Multimodal,
}

impl Acceleration {
    pub(super) fn draw(self, stream: &mut Stream) -> (f64, f64) {
        let both = |d: f64| (d, d);
        match self {
            Self::Fixed { cognitive, social } => (cognitive, social),
            Self::Unimodal => both(0.95 + 0.1 * stream.random::<f64>()),
            Self::Multimodal => both(1.4 + 0.4 * stream.random::<f64>()),
        }
    }

    /// Greatest sum of the two.
    fn sum(self) -> f64 {
        match self {
            Self::Fixed { cognitive, social } => cognitive + social,
            Self::Unimodal => 2.1,
            Self::Multimodal => 3.6,
        }
    }
}

/// What happens to a particle that would leave the space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Boundary {
    /// It stops at the bound: right where optima lie on bounds, as greatest gains do.
    Clamp,
    /// It bounces off.
    Reflect,
}

/// A swarm's make. Lengths are parts of the edge of the space.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SwarmParams {
    /// Number of particles.
    pub particles: usize,
    /// What a particle keeps of its velocity.
    pub inertia: Inertia,
    /// How strongly it is drawn.
    pub acceleration: Acceleration,
    /// Whom it learns from.
    pub topology: Topology,
    /// Greatest velocity along an axis, as a part of the space per iteration.
    pub velocity_limit: f64,
    /// What happens at a bound.
    pub boundary: Boundary,
    /// Probability, 0 to 1, that a particle makes a differential move instead of flying: from another particle's best
    /// place by the difference of two more's (Zhang and Xie, *DEPSO*, 2003). Such moves fit the shape of the valley that
    /// the swarm is in, whatever its direction, where flight knows the axes only. Needs four particles.
    pub differential: f64,
    /// Sensitive particles, for costs that change while they are searched.
    pub sensing: Option<Sensing>,
}

impl Default for SwarmParams {
    /// [`SwarmParams::improved`].
    fn default() -> Self {
        Self::improved()
    }
}

impl SwarmParams {
    /// Standard PSO with one best place for all: ω and d of Clerc and Kennedy's constriction (Eberhart and Shi, 2000).
    pub const fn standard() -> Self {
        Self {
            particles: 20,
            inertia: Inertia::Constant(0.7298),
            acceleration: Acceleration::Fixed { cognitive: 1.49618, social: 1.49618 },
            topology: Topology::Global,
            velocity_limit: 0.5,
            boundary: Boundary::Clamp,
            differential: 0.0,
            sensing: None,
        }
    }

    /// The improved PSO of paper 000 as its equations have it: inertia that falls linearly over `iterations`, acceleration
    /// draws of Eq. 30 for several minima, the swarm's best place in Eq. 29. What the paper does not state is stated
    /// here: ω from 0.9 to 0.4, velocities up to half of the space.
    pub const fn paper(iterations: usize) -> Self {
        Self {
            inertia: Inertia::Linear { start: 0.9, end: 0.4, iterations },
            acceleration: Acceleration::Multimodal,
            ..Self::standard()
        }
    }

    /// The swarm to take. What it has over [`standard`](Self::standard): random informants, so that a trap does not catch
    /// all; the acceleration draws of Eq. 30; and a differential move seven times in ten.
    pub const fn improved() -> Self {
        Self {
            inertia: Inertia::Constant(0.7),
            acceleration: Acceleration::Multimodal,
            topology: Topology::Random { informants: 3 },
            differential: 0.7,
            ..Self::standard()
        }
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        check::at_least("particles", self.particles, if self.differential > 0.0 { 4 } else { 2 })?;
        self.inertia.check()?;
        if let Acceleration::Fixed { cognitive, social } = self.acceleration {
            check::in_range("cognitive", cognitive, 0.0, 10.0)?;
            check::in_range("social", social, 0.0, 10.0)?;
        }
        if self.inertia == Inertia::Constriction {
            check::positive("cognitive + social - 4 under constriction", self.acceleration.sum() - 4.0)?;
        }
        self.topology.check(self.particles)?;
        check::in_range("velocity_limit", self.velocity_limit, f64::MIN_POSITIVE, 1.0)?;
        check::in_range("differential", self.differential, 0.0, 1.0)?;
        self.sensing.iter().try_for_each(Sensing::check)
    }
}
