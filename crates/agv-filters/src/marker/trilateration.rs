//! A position from distances to known places (paper 001, Eq. 12).
//!
//! The circles `|x - aᵢ|² = rᵢ²` less their weighted mean are linear in x, which gives a start wherever the vehicle is
//! (weights `1 / (2 rᵢ σᵢ)²`, since squaring a range multiplies its error):
//!
//! ```text
//! 2 (aᵢ - ā)ᵀ x = (|aᵢ|² - rᵢ²) - mean
//! ```
//!
//! From there Levenberg–Marquardt minimises `Σ (|x - aᵢ| - rᵢ)² / σᵢ²`, whose Hessian's inverse is the covariance. The linear
//! solution alone would give far ranges too much weight.

use agv_core::{
    Error, check,
    geometry::UncertainVector,
    solve::{LeastSquares, LevenbergMarquardt, LevenbergMarquardtParams, NormalEquations},
};
use nalgebra::{Matrix2, SVector, Vector1, Vector2};

/// A measured distance to a known place.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RangeTo {
    /// The place in the map, in metres.
    pub landmark: Vector2<f64>,
    /// Measured distance, in metres.
    pub range: f64,
    /// Its standard deviation, in metres.
    pub sigma: f64,
}

/// A position that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionFix {
    /// Position in the map, in metres, with its covariance.
    pub position: UncertainVector<2>,
    /// Squared residuals by the ranges' variances: chi-square of [`degrees_of_freedom`](Self::degrees_of_freedom) if the
    /// ranges err as they say.
    pub chi_square: f64,
    /// Ranges less two.
    pub degrees_of_freedom: usize,
    /// Steps of the refinement.
    pub iterations: usize,
}

/// Least ratio of the places' extents across and along: nearer to a line, left and right cannot be told apart.
const LEAST_SPREAD: f64 = 1e-3;

/// The position from which three or more known places, not all on one line, are at the measured distances.
///
/// O(ranges), no allocation.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_filters::marker::{RangeTo, trilaterate};
///
/// let truth = Vector2::new(2.0, 1.0);
/// let places = [Vector2::new(0.0, 0.0), Vector2::new(5.0, 0.0), Vector2::new(0.0, 4.0)];
/// let fix = trilaterate(&places.map(|landmark| RangeTo { landmark, range: (truth - landmark).norm(), sigma: 0.02 }))?;
/// assert!((fix.position.mean() - truth).norm() < 1e-9);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::TooFew`] below three; a place or range that is not finite, a range that is negative, a deviation that is not
/// positive; [`Error::Singular`] for places on one line.
pub fn trilaterate(ranges: &[RangeTo]) -> Result<PositionFix, Error> {
    check::at_least("ranges", ranges.len(), 3)?;
    for entry in ranges {
        check::all_finite("landmark", entry.landmark.iter())?;
        check::non_negative("range", entry.range)?;
        check::positive("sigma", entry.sigma)?;
    }
    let start = linear_solution(ranges)?;
    let params = LevenbergMarquardtParams { step_tolerance: 1e-10, max_iterations: 50, ..Default::default() };
    let found = LevenbergMarquardt::new(params)?.minimize(&mut Circles(ranges), start)?;
    let singular = Error::Singular { name: "trilateration", row: 1, pivot: 0.0 };
    let covariance = found.normal.hessian.cholesky().ok_or(singular)?.inverse();
    Ok(PositionFix {
        position: UncertainVector::new(found.state, (covariance + covariance.transpose()) * 0.5)?,
        chi_square: 2.0 * found.normal.cost,
        degrees_of_freedom: ranges.len() - 2,
        iterations: found.iterations,
    })
}

/// The least-squares solution of the circles' differences.
fn linear_solution(ranges: &[RangeTo]) -> Result<Vector2<f64>, Error> {
    // A range of zero is as sure as its deviation, not infinitely so.
    let weight = |entry: &RangeTo| (2.0 * entry.range.max(entry.sigma) * entry.sigma).powi(-2);
    let total: f64 = ranges.iter().map(weight).sum();
    let centre = ranges.iter().map(|entry| entry.landmark * weight(entry)).sum::<Vector2<f64>>() / total;
    let side = |entry: &RangeTo| (entry.landmark - centre).norm_squared() - entry.range * entry.range;
    let mean = ranges.iter().map(|entry| side(entry) * weight(entry)).sum::<f64>() / total;
    let (mut matrix, mut vector, mut scatter) = (Matrix2::zeros(), Vector2::zeros(), Matrix2::zeros());
    for entry in ranges {
        let row = entry.landmark - centre;
        matrix += row * row.transpose() * (4.0 * weight(entry));
        vector += row * (2.0 * weight(entry) * (side(entry) - mean));
        scatter += row * row.transpose();
    }
    // Extents along the principal axes, of the places alone: the weights say nothing of where they lie.
    let half = 0.5 * scatter.trace();
    let apart = (half * half - scatter.determinant()).max(0.0).sqrt();
    let (narrow, wide) = ((half - apart).max(0.0), half + apart);
    if narrow <= LEAST_SPREAD * LEAST_SPREAD * wide {
        return Err(Error::Singular { name: "trilateration", row: 1, pivot: narrow });
    }
    let singular = Error::Singular { name: "trilateration", row: 1, pivot: narrow };
    Ok(centre + matrix.try_inverse().ok_or(singular)? * vector)
}

struct Circles<'a>(&'a [RangeTo]);

impl LeastSquares<2> for Circles<'_> {
    type State = Vector2<f64>;

    fn linearize(&mut self, position: &Vector2<f64>, normal: &mut NormalEquations<2>) {
        for entry in self.0 {
            let away = position - entry.landmark;
            let distance = away.norm();
            // On the landmark every direction is as good.
            let direction = if distance > 0.0 { away / distance } else { Vector2::new(1.0, 0.0) };
            normal.add(&Vector1::new(distance - entry.range), &direction.transpose(), entry.sigma.powi(-2));
        }
    }

    fn cost(&mut self, position: &Vector2<f64>) -> f64 {
        let squared = |entry: &RangeTo| (((position - entry.landmark).norm() - entry.range) / entry.sigma).powi(2);
        0.5 * self.0.iter().map(squared).sum::<f64>()
    }

    fn retract(&self, position: &Vector2<f64>, step: &SVector<f64, 2>) -> Vector2<f64> {
        position + step
    }
}

/// The two points at the measured distances from two known places: a vehicle that sees two landmarks is at one of them, and
/// the order in which it sees them, left and right, says at which. The first lies to the left of the line from `a` to `b`.
///
/// Where noise keeps the circles from meeting, both are the point between them on that line.
///
/// # Errors
/// A place or range that is not finite, a negative range, or [`Error::Singular`] for one place given twice.
pub fn intersect_circles(a: (Vector2<f64>, f64), b: (Vector2<f64>, f64)) -> Result<[Vector2<f64>; 2], Error> {
    let ((place_a, range_a), (place_b, range_b)) = (a, b);
    check::all_finite("landmark", place_a.iter().chain(place_b.iter()))?;
    check::non_negative("range", range_a)?;
    check::non_negative("range", range_b)?;
    let apart = place_b - place_a;
    let distance = apart.norm();
    if distance <= 1e-9 * (1.0 + place_a.norm()) {
        return Err(Error::Singular { name: "two circles", row: 0, pivot: distance });
    }
    let along = 0.5 * (distance + (range_a - range_b) * (range_a + range_b) / distance);
    let height = ((range_a - along) * (range_a + along)).max(0.0).sqrt();
    let (ahead, left) = (apart / distance, Vector2::new(-apart.y, apart.x) / distance);
    Ok([1.0, -1.0].map(|side| place_a + ahead * along + left * (side * height)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Seed;
    use proptest::prelude::*;
    use rand_distr::{Distribution, StandardNormal};

    fn ranges(truth: Vector2<f64>, places: &[(f64, f64)], sigma: f64) -> Vec<RangeTo> {
        let range = |&(x, y): &(f64, f64)| RangeTo {
            landmark: Vector2::new(x, y),
            range: (truth - Vector2::new(x, y)).norm(),
            sigma,
        };
        places.iter().map(range).collect()
    }

    const ROOM: [(f64, f64); 5] = [(0.0, 0.0), (9.0, 1.0), (8.0, 7.0), (-1.0, 6.0), (4.0, 9.0)];

    proptest! {
        /// Inside, outside and far away from the landmarks.
        #[test]
        fn exact_ranges_give_the_position(x in -30.0..30.0_f64, y in -30.0..30.0_f64, count in 3..6_usize) {
            let truth = Vector2::new(x, y);
            let fix = trilaterate(&ranges(truth, &ROOM[..count], 0.05)).unwrap();
            prop_assert!((fix.position.mean() - truth).norm() < 1e-7, "{}", fix.position.mean());
            prop_assert!(fix.chi_square < 1e-9 && fix.degrees_of_freedom == count - 2);
        }

        #[test]
        fn two_circles_meet_on_both_sides(x in -5.0..5.0_f64, y in -5.0..5.0_f64) {
            let (a, b, truth) = (Vector2::new(1.0, 0.0), Vector2::new(-1.0, 2.0), Vector2::new(x, y));
            let found = intersect_circles((a, (truth - a).norm()), (b, (truth - b).norm())).unwrap();
            let side = usize::from((b - a).perp(&(truth - a)) < 0.0);
            prop_assert!((found[side] - truth).norm() < 1e-6, "{found:?}");
        }
    }

    /// NEES and squared residuals over 3000 draws, 2 and 3 degrees of freedom, within 4.5 deviations.
    #[test]
    fn the_covariance_is_that_of_the_ranges() {
        let (truth, n, mut stream) = (Vector2::new(3.0, 2.0), 3000_u32, Seed(2).stream(0, 0));
        let exact = ranges(truth, &ROOM, 0.05);
        let (mut nees, mut residuals) = (0.0, 0.0);
        for _ in 0..n {
            let noisy: Vec<_> = exact
                .iter()
                .map(|entry| {
                    let z: f64 = StandardNormal.sample(&mut stream);
                    RangeTo { range: entry.range + 0.05 * z, ..*entry }
                })
                .collect();
            let fix = trilaterate(&noisy).unwrap();
            let error = fix.position.mean() - truth;
            nees += error.dot(&(fix.position.covariance().try_inverse().unwrap() * error));
            residuals += fix.chi_square;
        }
        for (sum, freedom) in [(nees, 2.0), (residuals, 3.0)] {
            let mean = freedom * f64::from(n);
            assert!((sum - mean).abs() < 4.5 * (2.0 * mean).sqrt(), "{sum} {mean}");
        }
    }

    #[test]
    fn bad_ranges_are_named() {
        let good = ranges(Vector2::new(1.0, 2.0), &ROOM, 0.1);
        assert!(matches!(trilaterate(&good[..2]), Err(Error::TooFew { .. })));
        let with = |change: &dyn Fn(&mut RangeTo)| {
            let mut bad = good.clone();
            change(&mut bad[1]);
            trilaterate(&bad)
        };
        assert!(matches!(with(&|r| r.range = -1.0), Err(Error::Negative { .. })));
        assert!(matches!(with(&|r| r.range = f64::NAN), Err(Error::Negative { .. })));
        assert!(matches!(with(&|r| r.sigma = 0.0), Err(Error::NotPositive { .. })));
        assert!(matches!(with(&|r| r.landmark.x = f64::INFINITY), Err(Error::NotFinite { .. })));
        let line = [(0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (5.0, 5.0)];
        assert!(matches!(trilaterate(&ranges(Vector2::new(1.0, 2.0), &line, 0.1)), Err(Error::Singular { .. })));
        assert!(matches!(
            trilaterate(&ranges(Vector2::new(1.0, 2.0), &[(1.0, 1.0); 3], 0.1)),
            Err(Error::Singular { .. })
        ));
        // A vehicle that stands on a landmark, and ranges of zero.
        let on = trilaterate(&ranges(Vector2::new(0.0, 0.0), &ROOM, 0.1)).unwrap();
        assert!(on.position.mean().norm() < 1e-6);
    }

    #[test]
    fn circles_that_do_not_meet_give_the_point_between() {
        let (a, b) = (Vector2::new(0.0, 0.0), Vector2::new(4.0, 0.0));
        let [left, right] = intersect_circles((a, 1.0), (b, 2.8)).unwrap();
        assert!((left - right).norm() < 1e-12 && left.y == 0.0 && left.x > 0.9 && left.x < 1.3);
        assert!(intersect_circles((a, 1.0), (a, 1.0)).is_err());
        assert!(intersect_circles((a, -1.0), (b, 1.0)).is_err());
        assert!(intersect_circles((a, f64::NAN), (b, 1.0)).is_err());
        assert!(intersect_circles((a * f64::NAN, 1.0), (b, 1.0)).is_err());
    }
}
