//! What a colony is made of.

use super::{
    ant::DeadEnd,
    schedule::{Greed, Schedule},
    sight::{GoalDistance, Sight},
    trail::{Deposit, Trail, TrailLimits},
};
use crate::Error;
use agv_core::check;

/// A colony's make. The parts are independent: any rule of transition goes with any heuristic and any update of the
/// pheromone, as the paper's ladder of experiments has them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ColonyParams {
    /// Ants of an iteration, m.
    pub ants: usize,
    /// Iterations of a run, NC.
    pub iterations: usize,
    /// α, exponent of the pheromone.
    pub alpha: Schedule,
    /// β, exponent of the heuristic.
    pub beta: Schedule,
    /// ρ, part of the pheromone that evaporates in an iteration, above 0 and below 1.
    pub evaporation: f64,
    /// Q, what an ant leaves on a way of one cell's length.
    pub quantity: f64,
    /// Pheromone on all steps at first. The paper states none; the level matters beside Q only.
    pub initial: f64,
    /// How often the best step is taken instead of a drawn one.
    pub greed: Greed,
    /// What an ant sees.
    pub sight: Sight,
    /// What ants leave.
    pub deposit: Deposit,
    /// Between what values pheromone is kept.
    pub limits: TrailLimits,
    /// What ants do in dead ends.
    pub dead_end: DeadEnd,
    /// Whether an ant's way is shortened over its own cells before it counts: an addition to the paper.
    pub erase_detours: bool,
    /// Iterations without a shorter way after which the pheromone is levelled, so that the search begins anew around what it
    /// sees; 0 for never. An addition to the paper.
    pub restart_after: usize,
    /// Iterations without a shorter way after which the run ends; 0 for never.
    pub patience: usize,
}

impl Default for ColonyParams {
    /// [`ColonyParams::iaco`].
    fn default() -> Self {
        Self::iaco()
    }
}

impl ColonyParams {
    /// The traditional colony that paper 002 compares with: Eqs. 1 to 4, m = 50, NC = 100, α = 1, β = 7, ρ = 0.3, Q = 1.
    pub const fn aco() -> Self {
        Self {
            ants: 50,
            iterations: 100,
            alpha: Schedule::constant(1.0),
            beta: Schedule::constant(7.0),
            evaporation: 0.3,
            quantity: 1.0,
            initial: 1.0,
            greed: Greed::Never,
            sight: Sight::StepLength,
            deposit: Deposit::EveryAnt,
            limits: TrailLimits::Fixed { floor: Trail::LEAST, ceiling: Trail::GREATEST },
            dead_end: DeadEnd::Retreat,
            erase_detours: false,
            restart_after: 0,
            patience: 0,
        }
    }

    /// The paper's experiment 1: [`aco`](Self::aco) with the adaptive rule of transition (Eqs. 7 to 9), q₀ = 0.9, α from 0.5 to
    /// 1.5, β from 8.5 to 2.5.
    pub const fn with_transition() -> Self {
        Self {
            alpha: Schedule::linear(0.5, 1.5),
            beta: Schedule::linear(8.5, 2.5),
            greed: Greed::Fading(0.9),
            ..Self::aco()
        }
    }

    /// The paper's experiment 2: that and the heuristic of distance and direction (Eqs. 5 and 6).
    pub const fn with_heuristic() -> Self {
        Self { sight: Sight::goal(GoalDistance::ThreeTimes), ..Self::with_transition() }
    }

    /// The paper's experiment 3, which with key nodes is its IACO: that and the graded pheromone (Eqs. 10 to 17), R = 0.95.
    ///
    /// The paper's penalty of the worst way needs a floor that the paper does not state. Max-min limits are taken, with a
    /// span of 50: from corner to corner of 50 x 50 cells ways are then 0.9 % longer than the optimum, and 2.6 % with a fixed floor
    /// of 0.01.
    pub const fn iaco() -> Self {
        Self {
            deposit: Deposit::Graded { threshold: 0.95 },
            limits: TrailLimits::MaxMin { ants_worth: 1.0, span: 50.0 },
            ..Self::with_heuristic()
        }
    }

    /// The colony to take: [`iaco`](Self::iaco) whose ants erase their detours. From corner to corner of the same maps ways
    /// are 0.1 % longer than the optimum.
    pub const fn refined() -> Self {
        Self { erase_detours: true, ..Self::iaco() }
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        check::at_least("ants", self.ants, 1)?;
        check::at_least("iterations", self.iterations, 1)?;
        for (name, len, max) in
            [("ants", self.ants, Self::MAX_ANTS), ("iterations", self.iterations, Self::MAX_ITERATIONS)]
        {
            if len > max {
                return Err(agv_core::Error::TooMany { name, len, max }.into());
            }
        }
        self.alpha.check("alpha")?;
        self.beta.check("beta")?;
        check::open_probability("evaporation", self.evaporation)?;
        check::in_range("quantity", self.quantity, 1e-6, 1e6)?;
        check::in_range("initial pheromone", self.initial, Trail::LEAST, Trail::GREATEST)?;
        self.greed.check()?;
        self.sight.check()?;
        self.deposit.check()?;
        self.limits.check()
    }

    /// Most ants of an iteration.
    pub const MAX_ANTS: usize = 1 << 16;

    /// Most iterations of a run: room for their history is made at once.
    pub const MAX_ITERATIONS: usize = 1 << 16;
}
