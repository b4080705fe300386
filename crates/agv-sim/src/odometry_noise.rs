//! What wheel odometry gets wrong: scale errors that stay, and noise that grows with the motion.

use crate::Error;
use crate::noise::normal;
use agv_core::{
    check,
    compute::Stream,
    geometry::{LieGroup, Se2, angle_difference},
};

/// Least translation whose direction means anything, in metres; below it the motion is one rotation.
const STILL: f64 = 1e-9;

/// Errors of wheel odometry.
///
/// The noise is drawn per call, with variances that are quadratic in the motion of that call (paper 001, Eq. 4):
///
/// ```text
/// σ²(rot1) = α₁ rot1² + α₂ trans²
/// σ²(trans) = α₃ trans² + α₄ (rot1² + rot2²)
/// σ²(rot2) = α₁ rot2² + α₂ trans²
/// ```
///
/// so the same drive reported in more, smaller steps ends up less noisy: state the α for the rate that is used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryErrors {
    /// α₁ to α₄: rad²/rad², rad²/m², m²/m², m²/rad².
    pub alphas: [f64; 4],
    /// Relative error of distances: 0.01 reads 1 % too far (wheel diameters).
    pub distance_scale: f64,
    /// Relative error of turns (wheel base).
    pub yaw_scale: f64,
    /// Turn that is read per metre driven, in radians (unequal wheels).
    pub yaw_per_metre: f64,
}

impl OdometryErrors {
    /// Odometry that tells exactly what the wheels did.
    pub const NONE: Self = Self { alphas: [0.0; 4], distance_scale: 0.0, yaw_scale: 0.0, yaw_per_metre: 0.0 };

    pub(crate) fn validate(&self) -> Result<(), Error> {
        self.alphas.iter().try_for_each(|&a| check::non_negative("odometry alphas", a).map(|_| ()))?;
        check::in_range("distance_scale", self.distance_scale, -0.99, 10.0)?;
        check::in_range("yaw_scale", self.yaw_scale, -0.99, 10.0)?;
        check::finite("yaw_per_metre", self.yaw_per_metre)?;
        Ok(())
    }

    /// What the odometry says of a motion `start_from_end` of the wheels.
    pub(crate) fn distort(&self, start_from_end: &Se2, stream: &mut Stream) -> Se2 {
        if *self == Self::NONE {
            return *start_from_end;
        }
        let t = start_from_end.translation() * (1.0 + self.distance_scale);
        let trans = t.norm();
        // Signed, so that driving backwards is a negative translation and not two half turns (Eq. 2).
        let forwards = if t.x < 0.0 { -1.0 } else { 1.0 };
        let rot1 = if trans > STILL { (forwards * t.y).atan2(forwards * t.x) } else { 0.0 };
        let yaw = start_from_end.yaw() * (1.0 + self.yaw_scale) + self.yaw_per_metre * forwards * trans;
        let rot2 = angle_difference(yaw, rot1);
        let [a1, a2, a3, a4] = self.alphas;
        let spread = |variance: f64, stream: &mut Stream| normal(variance.sqrt(), stream);
        let turned = rot1 + spread(a1 * rot1 * rot1 + a2 * trans * trans, stream);
        let driven = forwards * trans + spread(a3 * trans * trans + a4 * (rot1 * rot1 + rot2 * rot2), stream);
        let turned_back = rot2 + spread(a1 * rot2 * rot2 + a2 * trans * trans, stream);
        // Eq. 5, as a composition.
        Se2::new(0.0, 0.0, turned).compose(&Se2::new(driven, 0.0, 0.0)).compose(&Se2::new(0.0, 0.0, turned_back))
    }
}

impl Default for OdometryErrors {
    /// A well kept differential drive reported at 10 to 20 Hz: α = 0.01, 0.005, 0.01, 0.001, no scale errors.
    fn default() -> Self {
        Self { alphas: [0.01, 0.005, 0.01, 0.001], ..Self::NONE }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Seed;

    #[test]
    fn without_noise_the_motion_comes_back() {
        let quiet = OdometryErrors { yaw_scale: 1e-300, ..OdometryErrors::NONE };
        for motion in [Se2::new(0.3, 0.1, 0.5), Se2::new(-0.3, 0.1, -2.5), Se2::new(0.0, 0.0, 1.0), Se2::default()] {
            let read = quiet.distort(&motion, &mut Seed(0).stream(0, 0));
            assert!(read.minus(&motion).norm() < 1e-12, "{motion:?}");
        }
    }

    #[test]
    fn scales_are_systematic() {
        let errors =
            OdometryErrors { distance_scale: 0.1, yaw_scale: -0.2, yaw_per_metre: 0.01, ..OdometryErrors::NONE };
        let read = errors.distort(&Se2::new(2.0, 0.0, 0.5), &mut Seed(0).stream(0, 0));
        assert!(read.minus(&Se2::new(2.2, 0.0, 0.4 + 0.022)).norm() < 1e-12);
    }

    /// Variances of rot1 and trans over 20 000 draws of one motion: chi-square within 4.5 sigma of Eq. 4's.
    #[test]
    fn noise_has_the_variances_of_equation_4() {
        let errors = OdometryErrors { alphas: [0.02, 0.01, 0.03, 0.005], ..OdometryErrors::NONE };
        let (rot1, trans, rot2) = (0.2_f64, 0.5_f64, -0.1_f64);
        let motion = Se2::new(0.0, 0.0, rot1) * Se2::new(trans, 0.0, 0.0) * Se2::new(0.0, 0.0, rot2);
        let mut stream = Seed(3).stream(0, 0);
        let (mut turns, mut drives, n) = (0.0, 0.0, 20_000_u32);
        for _ in 0..n {
            let read = errors.distort(&motion, &mut stream).translation();
            turns += (read.y.atan2(read.x) - rot1).powi(2);
            drives += (read.norm() - trans).powi(2);
        }
        let turn_variance = 0.02 * rot1 * rot1 + 0.01 * trans * trans;
        let drive_variance = 0.03 * trans * trans + 0.005 * (rot1 * rot1 + rot2 * rot2);
        let n = f64::from(n);
        for (sum, variance) in [(turns, turn_variance), (drives, drive_variance)] {
            assert!((sum / variance - n).abs() < 4.5 * (2.0 * n).sqrt(), "{}", sum / n / variance);
        }
    }

    #[test]
    fn bad_errors_are_refused() {
        for bad in [
            OdometryErrors { alphas: [0.0, -1.0, 0.0, 0.0], ..OdometryErrors::NONE },
            OdometryErrors { alphas: [f64::NAN; 4], ..OdometryErrors::NONE },
            OdometryErrors { distance_scale: -1.0, ..OdometryErrors::NONE },
            OdometryErrors { yaw_scale: f64::NAN, ..OdometryErrors::NONE },
            OdometryErrors { yaw_per_metre: f64::INFINITY, ..OdometryErrors::NONE },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
