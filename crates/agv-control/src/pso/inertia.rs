//! How much of its velocity a particle keeps from one iteration to the next.

use agv_core::{Error, check};

/// A schedule of the inertia weight ω over the iterations.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Inertia {
    /// The same ω in all iterations (Shi and Eberhart, *A modified particle swarm optimizer*, 1998).
    Constant(f64),
    /// From `start` down to `end`, then at `end`: what the text of paper 000 says of its Eq. 28.
    Linear {
        /// ω of the first iteration.
        start: f64,
        /// ω from iteration `iterations` on.
        end: f64,
        /// How long the change takes.
        iterations: usize,
    },
    /// Eq. 28 of paper 000 letter by letter, `end + (start - end) (1 - t/T) / (1 - end/start)`. It begins at
    /// `end + start`: above one, where a swarm flies apart, for the first part of the iterations.
    AsPrinted {
        /// The paper's `ω_max`.
        start: f64,
        /// The paper's `ω_min`.
        end: f64,
        /// The paper's `T`.
        iterations: usize,
    },
    /// The constriction `χ = 2 / (φ - 2 + √(φ² - 4φ))` of Clerc and Kennedy (*The particle swarm*, 2002), which scales
    /// inertia and both attractions; φ is the sum of the acceleration coefficients and must exceed four.
    Constriction,
}

impl Inertia {
    pub(super) fn check(self) -> Result<(), Error> {
        match self {
            Self::Constant(weight) => check::in_range("inertia", weight, 0.0, 1.0).map(|_| ()),
            Self::Linear { start, end, iterations } | Self::AsPrinted { start, end, iterations } => {
                check::in_range("inertia start", start, f64::MIN_POSITIVE, 1.0)?;
                check::in_range("inertia end", end, 0.0, start)?;
                if let Self::AsPrinted { .. } = self {
                    // The printed fraction divides by 1 - end / start.
                    check::positive("inertia start - end", start - end)?;
                }
                check::at_least("inertia iterations", iterations, 1).map(|_| ())
            }
            Self::Constriction => Ok(()),
        }
    }

    /// ω and the factor on both attractions in iteration `t`, counted from zero, for coefficients whose sum is `phi`.
    pub(super) fn weights(self, t: usize, phi: f64) -> (f64, f64) {
        let left = |iterations: usize| 1.0 - (t as f64 / iterations as f64).min(1.0);
        match self {
            Self::Constant(weight) => (weight, 1.0),
            Self::Linear { start, end, iterations } => (end + (start - end) * left(iterations), 1.0),
            Self::AsPrinted { start, end, iterations } => {
                (end + (start - end) * left(iterations) / (1.0 - end / start), 1.0)
            }
            Self::Constriction => {
                let chi = 2.0 / (phi - 2.0 + (phi * phi - 4.0 * phi).sqrt());
                (chi, chi)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_falls_from_start_to_end_and_stays() {
        let linear = Inertia::Linear { start: 0.9, end: 0.4, iterations: 100 };
        for (t, expected) in [(0, 0.9), (50, 0.65), (100, 0.4), (500, 0.4)] {
            assert!((linear.weights(t, 0.0).0 - expected).abs() < 1e-12);
        }
    }

    /// The sheet of paper 000: 1.30 at the start, above one until a third of the way, 0.4 at the end.
    #[test]
    fn as_printed_begins_above_one() {
        let printed = Inertia::AsPrinted { start: 0.9, end: 0.4, iterations: 99 };
        for (t, expected) in [(0, 1.3), (33, 1.0), (99, 0.4)] {
            assert!((printed.weights(t, 0.0).0 - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn constriction_of_twice_2_05_is_the_published_number() {
        let (inertia, factor) = Inertia::Constriction.weights(7, 4.1);
        assert!((inertia - 0.729_843_788).abs() < 1e-8 && factor == inertia);
    }
}
