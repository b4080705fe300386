//! What changes from one iteration to the next: the exponents α and β, and how often an ant takes the best step.

use crate::Error;
use agv_core::check;

/// A value that runs from `start` to `end` over the iterations:
///
/// ```text
/// v(N) = start + (end - start) (N / NC)^exponent,      N = 0 .. NC - 1
/// ```
///
/// Eq. 9 of paper 002. Its text says "nonlinearly", its formula shows `N/NC` alone, so that an exponent may have been lost:
/// one is the default.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Schedule {
    /// Value in the first iteration, without unit.
    pub start: f64,
    /// Value that the iterations run towards, without unit.
    pub end: f64,
    /// Above one the change comes late, below one early.
    pub exponent: f64,
}

impl Schedule {
    /// Greatest value of α or β: beyond it, on maps of some thousand cells a side, the weights of near and far cells no longer fit
    /// into single precision together.
    pub const MAX: f64 = 10.0;

    /// The same value in all iterations.
    pub const fn constant(value: f64) -> Self {
        Self::linear(value, value)
    }

    /// Evenly from one value to another.
    pub const fn linear(start: f64, end: f64) -> Self {
        Self { start, end, exponent: 1.0 }
    }

    /// Value in an iteration of `iterations`.
    pub fn at(&self, iteration: usize, iterations: usize) -> f64 {
        let part = iteration as f64 / iterations.max(1) as f64;
        // The usual exponent without a call.
        let part = if self.exponent == 1.0 { part } else { part.powf(self.exponent) };
        self.start + (self.end - self.start) * part
    }

    pub(super) fn check(&self, name: &'static str) -> Result<(), Error> {
        check::in_range(name, self.start, 0.0, Self::MAX)?;
        check::in_range(name, self.end, 0.0, Self::MAX)?;
        check::positive("exponent of a schedule", self.exponent)?;
        Ok(())
    }
}

/// How often an ant takes the step of greatest weight instead of drawing one (Eq. 7 of paper 002; the pseudo-random
/// proportional rule of Dorigo and Gambardella 1997).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Greed {
    /// Never: steps are drawn in proportion to their weights (Eq. 1).
    Never,
    /// With this probability in all iterations, as in the ant colony system.
    Constant(f64),
    /// Eq. 8: `q₀(N) = NC / (N + NC) exp(q₀ - 1)`; with q₀ = 0.9 it falls from 0.905 to half of that.
    Fading(f64),
}

impl Greed {
    /// Probability in an iteration of `iterations`.
    pub fn at(self, iteration: usize, iterations: usize) -> f64 {
        match self {
            Self::Never => 0.0,
            Self::Constant(q0) => q0,
            Self::Fading(q0) => {
                let (n, all) = (iteration as f64, iterations.max(1) as f64);
                all / (n + all) * (q0 - 1.0).exp()
            }
        }
    }

    pub(super) fn check(self) -> Result<(), Error> {
        match self {
            Self::Never => {}
            Self::Constant(q0) | Self::Fading(q0) => {
                check::in_range("q0", q0, 0.0, 1.0)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_run_as_the_paper_says() {
        let beta = Schedule::linear(8.5, 2.5);
        assert_eq!([0, 50, 100].map(|n| beta.at(n, 100)), [8.5, 5.5, 2.5]);
        let late = Schedule { exponent: 3.0, ..beta };
        assert!(late.at(50, 100) > beta.at(50, 100) && late.at(0, 100) == 8.5);
        let greed = Greed::Fading(0.9);
        assert!((greed.at(0, 100) - 0.904_837).abs() < 1e-6 && (greed.at(100, 100) - 0.452_419).abs() < 1e-6);
        assert_eq!((Greed::Never.at(3, 10), Greed::Constant(0.7).at(3, 10)), (0.0, 0.7));
    }
}
