//! The heading from the directions in which known places are seen, at a known position (paper 001, Eq. 13).
//!
//! Each place says `θᵢ = atan2(yᵢ - y, xᵢ - x) - φᵢ`; the heading is their weighted circular mean. The paper's five branches
//! are `atan2` written out, and its arithmetic mean breaks at ±π. An error of the position turns all directions together, the
//! nearest most, and does not average out:
//!
//! ```text
//! ∂θᵢ/∂p = (sin αᵢ, -cos αᵢ) / dᵢ        σ² = Σ (wᵢ σᵢ)² / (Σ wᵢ)² + gᵀ P g,      g = Σ wᵢ ∂θᵢ/∂p / Σ wᵢ
//! ```
//!
//! with the weights `wᵢ = 1 / (σᵢ² + (∂θᵢ/∂p)ᵀ P ∂θᵢ/∂p)`.

use agv_core::{
    Error, check,
    geometry::{UncertainVector, circular_mean},
};
use nalgebra::Vector2;

/// A measured direction of a known place.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BearingTo {
    /// The place in the map, in metres.
    pub landmark: Vector2<f64>,
    /// Measured direction in the vehicle's frame, in radians, counter-clockwise from its x axis.
    pub bearing: f64,
    /// Its standard deviation, in radians.
    pub sigma: f64,
}

/// A heading that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingFix {
    /// Heading in the map, in (-π, π] radians.
    pub yaw: f64,
    /// Its standard deviation, in radians.
    pub sigma: f64,
    /// Length of the mean of the unit vectors, from 0 to 1: well below one, the places contradict each other.
    pub resultant_length: f64,
}

/// The heading of a vehicle at `position` that sees known places at these directions. O(bearings), no allocation.
///
/// ```
/// use agv_core::geometry::UncertainVector;
/// use agv_core::nalgebra::{Matrix2, Vector2};
/// use agv_filters::marker::{BearingTo, heading_from_bearings};
///
/// let position = UncertainVector::new(Vector2::new(0.0, 0.0), Matrix2::identity() * 1e-4)?;
/// let ahead = BearingTo { landmark: Vector2::new(-5.0, 0.1), bearing: 0.02, sigma: 0.01 };
/// let right = BearingTo { landmark: Vector2::new(0.0, 5.0), bearing: -1.5708, sigma: 0.01 };
/// let heading = heading_from_bearings(&position, &[ahead, right])?;
/// assert!(heading.yaw.abs() > 3.12 && heading.sigma < 0.01);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::Empty`] without a place; a place or a direction that is not finite, a deviation that is not positive, or a place
/// where the vehicle is, which is seen in no direction.
pub fn heading_from_bearings(position: &UncertainVector<2>, bearings: &[BearingTo]) -> Result<HeadingFix, Error> {
    if bearings.is_empty() {
        return Err(Error::Empty { name: "bearings" });
    }
    let (here, spread) = (position.mean(), position.covariance());
    for entry in bearings {
        check::all_finite("landmark", entry.landmark.iter())?;
        check::finite("bearing", entry.bearing)?;
        check::positive("sigma", entry.sigma)?;
        check::positive("distance of the landmark", (entry.landmark - here).norm())?;
    }
    let by_position = |entry: &BearingTo| {
        let away = entry.landmark - here;
        Vector2::new(away.y, -away.x) / away.norm_squared()
    };
    let weight = |entry: &BearingTo| {
        let slope = by_position(entry);
        1.0 / (entry.sigma * entry.sigma + slope.dot(&(spread * slope)))
    };
    let mean = circular_mean(bearings.iter().map(|entry| {
        let away = entry.landmark - here;
        (away.y.atan2(away.x) - entry.bearing, weight(entry))
    }))?;
    let total: f64 = bearings.iter().map(weight).sum();
    let gradient = bearings.iter().map(|entry| by_position(entry) * weight(entry)).sum::<Vector2<f64>>() / total;
    let own = bearings.iter().map(|entry| (weight(entry) * entry.sigma).powi(2)).sum::<f64>() / (total * total);
    let sigma = (own + gradient.dot(&(spread * gradient))).sqrt();
    Ok(HeadingFix { yaw: mean.angle, sigma, resultant_length: mean.resultant_length })
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{compute::Seed, geometry::wrap_angle};
    use nalgebra::Matrix2;
    use proptest::prelude::*;
    use rand_distr::{Distribution, StandardNormal};

    const PLACES: [(f64, f64); 4] = [(4.0, 1.0), (-3.0, 2.0), (0.5, -5.0), (-1.0, 6.0)];

    fn seen(from: Vector2<f64>, yaw: f64, sigma: f64) -> Vec<BearingTo> {
        let bearing = |&(x, y): &(f64, f64)| {
            let landmark = Vector2::new(x, y);
            let away = landmark - from;
            BearingTo { landmark, bearing: wrap_angle(away.y.atan2(away.x) - yaw), sigma }
        };
        PLACES.iter().map(bearing).collect()
    }

    fn exact(position: Vector2<f64>) -> UncertainVector<2> {
        UncertainVector::new(position, Matrix2::zeros()).unwrap()
    }

    proptest! {
        #[test]
        fn exact_directions_give_the_heading(x in -2.0..2.0_f64, y in -2.0..1.5_f64, yaw in -3.2..3.2_f64) {
            let here = Vector2::new(x, y);
            let found = heading_from_bearings(&exact(here), &seen(here, yaw, 0.01)).unwrap();
            prop_assert!(wrap_angle(found.yaw - yaw).abs() < 1e-9 && found.resultant_length > 1.0 - 1e-12);
            prop_assert!((found.sigma - 0.005).abs() < 1e-12, "four directions halve the error");
        }
    }

    /// Squared scores over 4000 draws of directions and position, chi-square(1) within 4.5 deviations; the heading is near ±π.
    #[test]
    fn the_deviation_is_that_of_directions_and_position() {
        let (truth, yaw, n, mut stream) = (Vector2::new(0.5, 0.2), 3.13, 4000_u32, Seed(3).stream(0, 0));
        let mut draw = |sigma: f64| {
            let z: f64 = StandardNormal.sample(&mut stream);
            sigma * z
        };
        let mut squares = 0.0;
        for _ in 0..n {
            let mut noisy = seen(truth, yaw, 0.02);
            for entry in &mut noisy {
                entry.bearing += draw(0.02);
            }
            let believed = truth + Vector2::new(draw(0.08), draw(0.05));
            let spread = Matrix2::from_diagonal(&Vector2::new(0.08 * 0.08, 0.05 * 0.05));
            let found = heading_from_bearings(&UncertainVector::new(believed, spread).unwrap(), &noisy).unwrap();
            squares += (wrap_angle(found.yaw - yaw) / found.sigma).powi(2);
        }
        let n = f64::from(n);
        assert!((squares - n).abs() < 4.5 * (2.0 * n).sqrt(), "{squares}");
    }

    #[test]
    fn bad_directions_are_named() {
        let here = exact(Vector2::new(0.0, 0.0));
        let good = BearingTo { landmark: Vector2::new(1.0, 0.0), bearing: 0.0, sigma: 0.1 };
        assert_eq!(heading_from_bearings(&here, &[]), Err(Error::Empty { name: "bearings" }));
        for bad in [
            BearingTo { landmark: Vector2::zeros(), ..good },
            BearingTo { landmark: Vector2::new(f64::NAN, 0.0), ..good },
            BearingTo { bearing: f64::INFINITY, ..good },
            BearingTo { sigma: 0.0, ..good },
            BearingTo { sigma: f64::NAN, ..good },
        ] {
            assert!(heading_from_bearings(&here, &[good, bad]).is_err(), "{bad:?}");
        }
    }
}
