//! A landscape of many peaks that moves: the dynamic environment of paper 000, Eq. 33.
//!
//! ```text
//! f(a, b) = h g(a - a₀) g(b - b₀),      g(x) = x sin x cos 2x - 2 x sin 3x
//! ```
//!
//! on [-5, 5]², to be maximised. The paper prints the function but not how it moves. Here the offset (a₀, b₀) wanders
//! round a torus, so that every environment has the same peaks at other places, and the height `h` is drawn anew: optimum
//! and its value change, and the optimum is always known.

use crate::Objective;
use crate::optimize::SearchSpace;
use agv_core::{
    Error, check,
    compute::{Seed, Stream},
};
use rand::RngExt;

/// Half of the edge of the landscape.
const HALF: f64 = 5.0;

/// How the peaks move.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MovingPeaksParams {
    /// Greatest displacement along each axis at a change; the landscape is 10 wide.
    pub shift: f64,
    /// Greatest change of the height around one.
    pub height: f64,
}

impl Default for MovingPeaksParams {
    /// Peaks are about two apart: a change of up to one takes a swarm off its peak, and another one may become the best
    /// that is near.
    fn default() -> Self {
        Self { shift: 1.0, height: 0.2 }
    }
}

/// The landscape as an [`Objective`] of two coordinates, whose cost is `-f`.
///
/// ```
/// use agv_control::{Objective, pso::{MovingPeaks, MovingPeaksParams}};
/// use agv_core::compute::Seed;
///
/// let mut peaks = MovingPeaks::new(MovingPeaksParams::default(), Seed(1))?;
/// let optimum = peaks.optimum();
/// assert!(peaks.error(&optimum) < 1e-9 * peaks.evaluate(&optimum).abs());
/// peaks.change();
/// assert!(peaks.error(&optimum) > 1.0);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MovingPeaks {
    params: MovingPeaksParams,
    stream: Stream,
    offset: [f64; 2],
    height: f64,
    /// Where `|g|` is greatest, and that value squared.
    peak: f64,
    greatest: f64,
}

impl MovingPeaks {
    /// The landscape before its first change.
    ///
    /// # Errors
    /// A shift below zero, or a height that would turn peaks over.
    pub fn new(params: MovingPeaksParams, seed: Seed) -> Result<Self, Error> {
        check::non_negative("shift", params.shift)?;
        check::in_range("height", params.height, 0.0, 0.9)?;
        // `g` is even; the greatest product of two values is the square of the one that is farthest from zero.
        let size = |x: f64| profile(x).abs();
        let coarse = (0..=5000).map(|k| f64::from(k) * 1e-3).fold(0.0, |a, b| if size(b) > size(a) { b } else { a });
        let (mut low, mut high) = (coarse - 1e-3, (coarse + 1e-3).min(HALF));
        for _ in 0..100 {
            let (left, right) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
            if size(left) < size(right) { low = left } else { high = right }
        }
        let peak = f64::midpoint(low, high);
        let greatest = profile(peak) * profile(peak);
        Ok(Self { params, stream: seed.stream(0, 0), offset: [0.0; 2], height: 1.0, peak, greatest })
    }

    /// The square that is searched.
    ///
    /// # Errors
    /// None.
    pub fn space() -> Result<SearchSpace, Error> {
        SearchSpace::cube(2, -HALF, HALF)
    }

    /// Moves on to the next environment.
    pub fn change(&mut self) {
        for offset in &mut self.offset {
            *offset = wrap(*offset + self.params.shift * self.stream.random_range(-1.0..=1.0));
        }
        self.height = 1.0 + self.params.height * self.stream.random_range(-1.0..=1.0);
    }

    /// A place of the highest peak.
    pub fn optimum(&self) -> [f64; 2] {
        self.offset.map(|offset| wrap(self.peak + offset))
    }

    /// How far below the highest peak a point is.
    pub fn error(&self, point: &[f64]) -> f64 {
        self.height * self.greatest + self.evaluate(point)
    }

    /// The same as a part of the highest peak, not below zero.
    pub fn relative_error(&self, point: &[f64]) -> f64 {
        (self.error(point) / (self.height * self.greatest)).max(0.0)
    }
}

impl Objective for MovingPeaks {
    fn evaluate(&self, point: &[f64]) -> f64 {
        let value: f64 = point.iter().zip(self.offset).map(|(x, offset)| profile(wrap(x - offset))).product();
        -self.height * value
    }
}

/// `g` of Eq. 33.
fn profile(x: f64) -> f64 {
    x * x.sin() * (2.0 * x).cos() - 2.0 * x * (3.0 * x).sin()
}

/// A coordinate on the torus.
fn wrap(x: f64) -> f64 {
    (x + HALF).rem_euclid(2.0 * HALF) - HALF
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_higher_than_the_optimum_in_any_environment() {
        let mut peaks = MovingPeaks::new(MovingPeaksParams::default(), Seed(5)).unwrap();
        for _ in 0..5 {
            let errors = (0..200 * 200)
                .map(|k| peaks.error(&[f64::from(k % 200) * 0.05 - HALF, f64::from(k / 200) * 0.05 - HALF]));
            let least = errors.fold(f64::INFINITY, f64::min);
            // A grid of 0.05 comes near the peak, whose curvature is below 200 per axis.
            assert!((0.0..0.3 * 200.0 * 0.025 * 0.025 * 100.0).contains(&least), "{least}");
            assert!(peaks.error(&peaks.optimum()).abs() < 1e-9 * peaks.greatest);
            peaks.change();
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        for (name, params) in [
            ("shift", MovingPeaksParams { shift: -1.0, height: 0.0 }),
            ("shift", MovingPeaksParams { shift: f64::NAN, height: 0.0 }),
            ("height", MovingPeaksParams { shift: 1.0, height: 1.0 }),
        ] {
            assert!(MovingPeaks::new(params, Seed(0)).unwrap_err().to_string().starts_with(name));
        }
    }
}
