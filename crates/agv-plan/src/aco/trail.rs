//! Pheromone on the directed steps of a grid.

use crate::Error;
use agv_core::check;

/// What ants leave on their ways when all of an iteration have arrived or died.
///
/// `L_b`, `L_a` and `L_w` are the least, mean and greatest length of the iteration's arrived ants, Q is
/// [`ColonyParams::quantity`](super::ColonyParams::quantity).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Deposit {
    /// Every ant leaves `Q / L_k` (Eqs. 2 to 4): `τ ← (1 - ρ) τ + Σ Q/L_k`.
    EveryAnt,
    /// Ants are graded by their fitness `f = L_b / L_k` (Eqs. 10 to 17):
    ///
    /// ```text
    /// τ ← (1 - ρ) τ + ρ Σ Δ_k + Δ* - Δ**
    /// Δ_k = Q f / L_b + Q f / L_a - Q f / L_w     for f = 1
    ///       2 Q f / L_k - Q f / L_w               for threshold < f < 1
    ///       nothing                               otherwise
    /// Δ*  = Q / L_b on the best way,  Δ** = Q / L_w on the worst
    /// ```
    ///
    /// The best way is that of the first of the best ants, the worst that of the first of the worst; where all are equally
    /// long there is no worst.
    Graded {
        /// R, from 0 to 1: 0.95 in the paper's section 6.1, 0.5 in 6.3.
        threshold: f64,
    },
    /// Only the best way of the run so far gets `Q / L` (Stützle and Hoos 2000), and every `period`-th iteration the
    /// best of the iteration instead; 0 for never.
    BestWay {
        /// Iterations from one deposit of the iteration's best ant to the next.
        period: usize,
    },
}

/// Between what values pheromone is kept. The paper states none, and its worst way may lose more than lies on it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TrailLimits {
    /// From `floor` to `ceiling`.
    Fixed {
        /// Least pheromone on a step.
        floor: f64,
        /// Greatest pheromone on a step.
        ceiling: f64,
    },
    /// Max-min (Stützle and Hoos 2000): at most what the best length L so far can build up, `Q / (ρ L)`, times
    /// `ants_worth`; at least that over `span`.
    MaxMin {
        /// How many ants' deposits the ceiling holds.
        ants_worth: f64,
        /// Ceiling over floor.
        span: f64,
    },
}

impl Deposit {
    pub(super) fn check(&self) -> Result<(), Error> {
        if let Self::Graded { threshold } = *self {
            check::in_range("threshold", threshold, 0.0, 1.0)?;
        }
        Ok(())
    }
}

impl TrailLimits {
    pub(super) fn check(&self) -> Result<(), Error> {
        match *self {
            Self::Fixed { floor, ceiling } => {
                check::in_range("pheromone floor", floor, Trail::LEAST, Trail::GREATEST)?;
                check::in_range("pheromone ceiling", ceiling, floor, Trail::GREATEST)?;
            }
            Self::MaxMin { ants_worth, span } => {
                check::in_range("ants_worth", ants_worth, 1e-6, 1e6)?;
                check::in_range("span", span, 1.0, 1e9)?;
            }
        }
        Ok(())
    }

    /// Floor and ceiling when the best length so far is `best`, if any ant arrived yet.
    pub(super) fn bounds(&self, best: Option<f64>, quantity: f64, evaporation: f64) -> (f32, f32) {
        let (floor, ceiling) = match (*self, best) {
            (Self::Fixed { floor, ceiling }, _) => (floor, ceiling),
            (Self::MaxMin { ants_worth, span }, Some(best)) => {
                let ceiling = ants_worth * quantity / (evaporation * best.max(1.0));
                (ceiling / span, ceiling)
            }
            (Self::MaxMin { .. }, None) => (Trail::LEAST, Trail::GREATEST),
        };
        let within = |v: f64| v.clamp(Trail::LEAST, Trail::GREATEST) as f32;
        (within(floor), within(ceiling))
    }
}

/// Pheromone of every directed step, `[cell][step]`, and the weights that it gives.
#[derive(Debug, Clone, Default)]
pub(super) struct Trail {
    pheromone: Vec<[f32; 8]>,
    powers: Vec<[f32; 8]>,
}

impl Trail {
    /// Least and greatest pheromone: beyond them weights would leave single precision.
    pub(super) const LEAST: f64 = 1e-12;
    pub(super) const GREATEST: f64 = 1e9;
    /// The same for its power; at α = 1 the limits of the pheromone are narrower.
    const POWERS: (f32, f32) = (1e-12, 1e11);

    pub(super) fn reset(&mut self, cells: usize, initial: f64) {
        self.pheromone.clear();
        self.pheromone.resize(cells, [initial as f32; 8]);
        self.powers.clear();
        self.powers.resize(cells, [0.0; 8]);
    }

    /// All steps back to one value.
    pub(super) fn level(&mut self, value: f32) {
        self.pheromone.fill([value; 8]);
    }

    /// Keeps the pheromone within its limits and raises it to α, times a factor per step.
    pub(super) fn raise(&mut self, alpha: f64, (floor, ceiling): (f32, f32), factors: &[f32; 8]) {
        let alpha = alpha as f32;
        if alpha == 1.0 {
            for (row, powers) in self.pheromone.iter_mut().zip(&mut self.powers) {
                for ((tau, out), factor) in row.iter_mut().zip(powers).zip(factors) {
                    *tau = tau.clamp(floor, ceiling);
                    *out = *tau * factor;
                }
            }
            return;
        }
        let (mut last, mut power) = (f32::NAN, 0.0);
        for (row, powers) in self.pheromone.iter_mut().zip(&mut self.powers) {
            for ((tau, out), factor) in row.iter_mut().zip(powers).zip(factors) {
                *tau = tau.clamp(floor, ceiling);
                // Most steps were never walked and share one value: a comparison saves the power.
                if *tau != last {
                    last = *tau;
                    power = tau.powf(alpha).clamp(Self::POWERS.0, Self::POWERS.1);
                }
                *out = power * factor;
            }
        }
    }

    pub(super) fn powers(&self) -> &[[f32; 8]] {
        &self.powers
    }

    pub(super) fn evaporate(&mut self, rate: f64) {
        let kept = (1.0 - rate) as f32;
        self.pheromone.as_flattened_mut().iter_mut().for_each(|tau| *tau *= kept);
    }

    /// Adds pheromone to the steps of a way.
    pub(super) fn deposit(&mut self, start: u32, steps: &[u8], strides: &[u32; 8], amount: f64) {
        let (amount, mut node) = (amount as f32, start);
        for &step in steps {
            let step = usize::from(step & 7);
            if let Some(tau) = self.pheromone.get_mut(node as usize) {
                tau[step] += amount;
            }
            node = node.wrapping_add(strides[step]);
        }
    }
}
