//! Sensitive particles: points that stay where they are, to notice that the objective has changed.
//!
//! Paper 000, section 3.3.3: "when the adaptive values of the sensitive particles change by more than a predetermined
//! threshold, the positions and velocities of all particles in the swarm will be reinitialized according to a specific
//! ratio".

use agv_core::{Error, check};

/// How much the cost of a sensitive particle must change to count.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Threshold {
    /// By more than this, in the cost's unit.
    Absolute(f64),
    /// By more than this part of the smaller of the two costs.
    Relative(f64),
}

impl Threshold {
    /// Whether a cost that was `before` and is `now` has changed.
    pub(super) fn exceeded(self, before: f64, now: f64) -> bool {
        if before == now {
            return false;
        }
        // An infinite difference exceeds everything.
        let change = (now - before).abs();
        match self {
            Self::Absolute(limit) => change > limit,
            Self::Relative(limit) => change > limit * before.abs().min(now.abs()),
        }
    }
}

/// Sensitive particles, and what follows when they notice a change.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Sensing {
    /// Number of sensitive particles that stand at random places: each costs one evaluation per iteration.
    pub particles: usize,
    /// Whether one more stands at the best place found so far. It notices what matters most, and after a change the swarm
    /// knows at once what its old answer is worth.
    pub watch_best: bool,
    /// When a change is one. Costs that carry noise need a threshold above it.
    pub threshold: Threshold,
    /// Part of the swarm that begins anew after a change, 0 to 1: the particles that fare worst.
    pub reseed: f64,
}

impl Default for Sensing {
    /// [`Sensing::frugal`].
    fn default() -> Self {
        Self::frugal()
    }
}

impl Sensing {
    /// The paper's: 20 particles and a threshold of 1; half of the swarm begins anew (the paper does not state its ratio).
    pub const fn paper() -> Self {
        Self { particles: 20, watch_best: false, threshold: Threshold::Absolute(1.0), reseed: 0.5 }
    }

    /// Three particles and the best place, which notice a change of a thousandth: where costs carry no noise, few are
    /// enough, and evaluations are left for the search. Half of the swarm begins anew.
    pub const fn frugal() -> Self {
        Self { particles: 3, watch_best: true, threshold: Threshold::Relative(1e-3), reseed: 0.5 }
    }

    /// How many places are evaluated beside the swarm's.
    pub(super) fn count(&self) -> usize {
        self.particles.saturating_add(usize::from(self.watch_best))
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        check::at_least("sensitive particles", self.count(), 1)?;
        check::in_range("reseed", self.reseed, 0.0, 1.0)?;
        match self.threshold {
            Threshold::Absolute(limit) | Threshold::Relative(limit) => {
                check::non_negative("threshold", limit).map(|_| ())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_more_than_the_threshold() {
        let (absolute, relative) = (Threshold::Absolute(1.0), Threshold::Relative(0.1));
        for (before, now, by_size, by_part) in [
            (5.0, 6.0, false, true),
            (5.0, 3.5, true, true),
            (100.0, 105.0, true, false),
            (-100.0, -105.0, true, false),
            (0.0, 1e-9, false, true),
            (f64::INFINITY, f64::INFINITY, false, false),
            (f64::INFINITY, 3.0, true, true),
            (3.0, f64::INFINITY, true, true),
        ] {
            assert_eq!(
                (absolute.exceeded(before, now), relative.exceeded(before, now)),
                (by_size, by_part),
                "{before} {now}"
            );
        }
    }
}
