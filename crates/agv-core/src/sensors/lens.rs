//! What a lens does to straight lines, after Brown and Conrady, with the five numbers that every calibration tool states.
//!
//! With `(x, y)` the direction of a ray, `X / Z` and `Y / Z` in the camera's frame, and `s = x² + y²` (Brown 1966; Heikkilä
//! and Silvén 1997):
//!
//! ```text
//! x' = x (1 + k1 s + k2 s² + k3 s³) + 2 p1 x y + p2 (s + 2 x²)
//! y' = y (1 + k1 s + k2 s² + k3 s³) + p1 (s + 2 y²) + 2 p2 x y
//! ```

use crate::{Error, check};
use nalgebra::{Matrix2, Vector2};

/// Coefficients of a lens's distortion; all zero for one that has none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LensDistortion {
    /// `k1`, `k2`, `k3`, without unit.
    pub radial: [f64; 3],
    /// `p1`, `p2`, without unit.
    pub tangential: [f64; 2],
}

/// Widest ray that is looked at, as a tangent: 84° off the axis.
const WIDEST: f64 = 10.0;

/// Most Newton steps from a distorted ray back to the straight one; four to six are usual.
const MAX_STEPS: usize = 20;

impl LensDistortion {
    /// Checks all coefficients.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn validate(&self) -> Result<(), Error> {
        check::all_finite("radial distortion", &self.radial)?;
        check::all_finite("tangential distortion", &self.tangential)
    }

    /// The distorted ray and its Jacobian with respect to the straight one.
    pub(super) fn distort(&self, ray: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let ([k1, k2, k3], [p1, p2], (x, y)) = (self.radial, self.tangential, (ray.x, ray.y));
        let s = x * x + y * y;
        let stretch = 1.0 + s * (k1 + s * (k2 + s * k3));
        let slope = 2.0 * (k1 + s * (2.0 * k2 + s * 3.0 * k3)); // d stretch / dx = slope x
        let bent = Vector2::new(
            x * stretch + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * stretch + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let across = slope * x * y + 2.0 * (p1 * x + p2 * y);
        let jacobian = Matrix2::new(
            stretch + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            across,
            across,
            stretch + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (bent, jacobian)
    }

    /// The straight ray of a distorted one, by Newton's method, and the Jacobian of [`distort`](Self::distort) there; none if
    /// no ray within `radius` looks like that.
    pub(super) fn straighten(&self, bent: &Vector2<f64>, radius: f64) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        if *self == Self::default() {
            return (bent.norm() <= radius).then(|| (*bent, Matrix2::identity()));
        }
        let mut ray = *bent;
        for _ in 0..MAX_STEPS {
            if ray.norm() > radius {
                ray *= radius / ray.norm(); // a step too far comes back to where rays are in order
            }
            let (guess, jacobian) = self.distort(&ray);
            let step = jacobian.try_inverse()? * (bent - guess);
            ray += step;
            if step.norm() <= 1e-14 * (1.0 + ray.norm()) {
                let found = ray.norm() <= radius * (1.0 + 1e-9);
                return found.then(|| (ray, self.distort(&ray).1));
            }
        }
        None
    }

    /// Tangent of the angle off the axis up to which wider rays are farther from the centre of the image; beyond, the
    /// polynomial folds back and means nothing.
    pub(super) fn monotone_radius(&self) -> f64 {
        let [k1, k2, k3] = self.radial;
        // d/dr of r (1 + k1 r² + k2 r⁴ + k3 r⁶).
        let grows = |r: f64| {
            let s = r * r;
            1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3)) > 0.0
        };
        let steps = 1000;
        let at = |i: u32| WIDEST * f64::from(i) / f64::from(steps);
        (1..=steps).find(|&i| !grows(at(i))).map_or(WIDEST, |i| at(i - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A wide lens as calibration tools print it.
    const WIDE: LensDistortion = LensDistortion { radial: [-0.28, 0.07, -0.005], tangential: [4e-4, -2e-4] };

    proptest! {
        #[test]
        fn straightening_undoes_distortion(x in -0.8..0.8_f64, y in -0.8..0.8_f64) {
            let ray = Vector2::new(x, y);
            let (bent, jacobian) = WIDE.distort(&ray);
            let (found, there) = WIDE.straighten(&bent, WIDE.monotone_radius()).unwrap();
            prop_assert!((found - ray).norm() < 1e-12, "{found} {ray}");
            prop_assert!((there - jacobian).norm() < 1e-10);
        }

        #[test]
        fn the_jacobian_is_the_slope(x in -0.8..0.8_f64, y in -0.8..0.8_f64) {
            let ray = Vector2::new(x, y);
            let (_, jacobian) = WIDE.distort(&ray);
            for (column, step) in [Vector2::new(1e-6, 0.0), Vector2::new(0.0, 1e-6)].into_iter().enumerate() {
                let slope = (WIDE.distort(&(ray + step)).0 - WIDE.distort(&(ray - step)).0) / 2e-6;
                prop_assert!((slope - jacobian.column(column)).norm() < 1e-8);
            }
        }
    }

    #[test]
    fn what_no_ray_looks_like_has_no_ray() {
        let barrel = LensDistortion { radial: [-0.3, 0.0, 0.0], tangential: [0.0; 2] };
        // d/dr (r - 0.3 r³) = 0 at r = 1.054, where the image ends at 0.703.
        assert!((barrel.monotone_radius() - 1.054).abs() < 0.011);
        assert!(barrel.straighten(&Vector2::new(0.69, 0.0), barrel.monotone_radius()).is_some());
        assert!(barrel.straighten(&Vector2::new(0.72, 0.0), barrel.monotone_radius()).is_none());
        assert_eq!(LensDistortion::default().monotone_radius(), WIDEST);
        assert!(LensDistortion { radial: [f64::NAN, 0.0, 0.0], ..barrel }.validate().is_err());
    }
}
