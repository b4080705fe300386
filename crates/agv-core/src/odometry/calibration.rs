//! UMBmark: the systematic errors of a differential drive from two driven squares.
//!
//! A vehicle drives a square of side `L` by its own odometry, several times clockwise and several times
//! counter-clockwise, and the end positions are measured where the odometry says (0, 0). A wrong wheel base (type A)
//! turns every corner too far or not far enough, unequal wheels (type B) bend every side; their effects add in one
//! direction and cancel in the other, which tells them apart (Borenstein and Feng 1996, *Measurement and correction of
//! systematic odometry errors in mobile robots*, Eqs. 15–24). With the centres of gravity of the end positions
//!
//! ```text
//! α = (x_cw + x_ccw) / (-4 L)     or  (y_cw - y_ccw) / (-4 L)     missing turn per corner
//! β = (x_cw - x_ccw) / (-4 L)     or  (y_cw + y_ccw) / (-4 L)     turn along one side
//! Eb = (π/2) / (π/2 - α)          true wheel base / assumed one
//! R = (L/2) / sin(β/2)            Ed = (R + b/2) / (R - b/2)     right / left wheel diameter
//! ```
//!
//! Both forms of α and β are averaged. The mean diameter is left alone: a tape measure along a straight line gives it.

use crate::{Error, check, kinematics::DifferentialParams};
use nalgebra::Vector2;
use std::f64::consts::FRAC_PI_2;

/// Where the vehicle ended, in metres, against the place where its odometry says it ended.
///
/// The first side is driven along +x, with +y to the left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SquareRuns<'a> {
    /// Side of the square, in metres; 4 m and five runs each way in the original.
    pub side: f64,
    /// True end minus odometry's end of each clockwise run.
    pub clockwise: &'a [Vector2<f64>],
    /// True end minus odometry's end of each counter-clockwise run.
    pub counter_clockwise: &'a [Vector2<f64>],
}

/// What the runs say.
///
/// ```
/// use agv_core::kinematics::DifferentialParams;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::odometry::{SquareRuns, UmbMark};
///
/// let runs = SquareRuns {
///     side: 4.0,
///     clockwise: &[Vector2::new(-0.21, -0.19), Vector2::new(-0.19, -0.21)],
///     counter_clockwise: &[Vector2::new(-0.20, 0.20)],
/// };
/// let assumed = DifferentialParams::default();
/// let found = UmbMark::calibrate(&runs, &assumed)?;
/// assert!(found.wheel_base_ratio > 1.0); // corners fell short: the wheels are farther apart than assumed
/// assert!((found.diameter_ratio - 1.0).abs() < 1e-3);
/// let corrected = found.correct(&assumed);
/// # let _ = corrected;
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct UmbMark {
    /// Eb: true wheel base over the assumed one.
    pub wheel_base_ratio: f64,
    /// Ed: true right over true left diameter, where the assumed ones are equal; else a factor on their ratio.
    pub diameter_ratio: f64,
    /// Greater distance of the two centres of gravity from the origin, in metres: the measure of odometric accuracy
    /// for systematic errors.
    pub max_systematic_error: f64,
}

impl UmbMark {
    /// Finds both ratios.
    ///
    /// # Errors
    /// A side that is not positive, [`Error::Empty`] without runs in one direction, [`Error::NotFinite`] for an end
    /// position, and [`Error::OutOfRange`] where the errors are too large for the method, which is of first order: more
    /// than the side itself.
    pub fn calibrate(runs: &SquareRuns<'_>, assumed: &DifferentialParams) -> Result<Self, Error> {
        let side = check::positive("side", runs.side)?;
        let track = check::positive("track", assumed.track)?;
        let clockwise = centre("clockwise", runs.clockwise)?;
        let counter = centre("counter_clockwise", runs.counter_clockwise)?;
        let max_systematic_error = clockwise.norm().max(counter.norm());
        check::in_range("systematic error", max_systematic_error, 0.0, side)?;
        let (sum, difference) = (clockwise + counter, clockwise - counter);
        let missing_turn = (sum.x + difference.y) / (-8.0 * side);
        let bend = (difference.x + sum.y) / (-8.0 * side);
        // 1 / R, which is zero for equal wheels.
        let curvature = (0.5 * bend).sin() * 2.0 / side;
        let half = check::in_range("bend of a side", 0.5 * track * curvature, -0.5, 0.5)?;
        Ok(Self {
            wheel_base_ratio: FRAC_PI_2 / (FRAC_PI_2 - missing_turn),
            diameter_ratio: (1.0 + half) / (1.0 - half),
            max_systematic_error,
        })
    }

    /// The assumed parameters with both corrections; the mean radius stays.
    pub fn correct(&self, assumed: &DifferentialParams) -> DifferentialParams {
        let ratio = self.diameter_ratio * assumed.right_radius / assumed.left_radius;
        let twice_mean = assumed.left_radius + assumed.right_radius;
        DifferentialParams {
            left_radius: twice_mean / (1.0 + ratio),
            right_radius: twice_mean * ratio / (1.0 + ratio),
            track: assumed.track * self.wheel_base_ratio,
        }
    }
}

fn centre(name: &'static str, ends: &[Vector2<f64>]) -> Result<Vector2<f64>, Error> {
    if ends.is_empty() {
        return Err(Error::Empty { name });
    }
    ends.iter().try_for_each(|end| check::all_finite(name, end.as_slice()))?;
    Ok(ends.iter().sum::<Vector2<f64>>() / ends.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{LieGroup, Se2, Twist2};
    use crate::kinematics::{DifferentialDrive, Kinematics};

    /// Drives the square by the odometry of `assumed` with the wheels of `real`; the true end.
    fn drive(real: &DifferentialParams, assumed: &DifferentialParams, side: f64, turn: f64) -> Vector2<f64> {
        let (real, assumed) = (DifferentialDrive::new(*real).unwrap(), DifferentialDrive::new(*assumed).unwrap());
        let legs = [Twist2::new(side, 0.0, 0.0), Twist2::new(0.0, 0.0, turn)];
        let pose = (0..4).flat_map(|_| legs).fold(Se2::default(), |pose, leg| {
            let wheels = assumed.inverse(&leg).unwrap();
            pose.compose(&real.forward(&wheels).integrate(1.0))
        });
        pose.translation()
    }

    /// Wrong wheel base and unequal wheels at once: the calibrated vehicle ends at least ten times nearer, and the found
    /// ratios are the true ones to second order.
    #[test]
    fn calibration_removes_the_systematic_error() {
        let assumed = DifferentialParams::default();
        for (base, diameter) in [(1.02, 1.003), (0.985, 1.004), (1.01, 0.997), (1.0, 1.002), (0.98, 1.0)] {
            let real = DifferentialParams {
                left_radius: 0.2 / (1.0 + diameter),
                right_radius: 0.2 * diameter / (1.0 + diameter),
                track: assumed.track * base,
            };
            let run = |params: &DifferentialParams| [-FRAC_PI_2, FRAC_PI_2].map(|turn| drive(&real, params, 4.0, turn));
            let [cw, ccw] = run(&assumed);
            let runs = SquareRuns { side: 4.0, clockwise: &[cw], counter_clockwise: &[ccw] };
            let found = UmbMark::calibrate(&runs, &assumed).unwrap();
            assert!((found.wheel_base_ratio - base).abs() < 2e-3, "{found:?}");
            assert!((found.diameter_ratio - diameter).abs() < 3e-4, "{found:?}");
            let [cw, ccw] = run(&found.correct(&assumed));
            let left = cw.norm().max(ccw.norm());
            assert!(left < found.max_systematic_error / 10.0, "{left} of {}", found.max_systematic_error);

            // A second round, from the corrected parameters, removes what the first order left.
            let again = SquareRuns { side: 4.0, clockwise: &[cw], counter_clockwise: &[ccw] };
            let corrected = found.correct(&assumed);
            let refined = UmbMark::calibrate(&again, &corrected).unwrap().correct(&corrected);
            let [cw, ccw] = run(&refined);
            assert!(cw.norm().max(ccw.norm()) < found.max_systematic_error / 200.0);
        }
    }

    #[test]
    fn bad_runs_are_refused() {
        let assumed = DifferentialParams::default();
        let end = [Vector2::new(0.1, 0.1)];
        let good = SquareRuns { side: 4.0, clockwise: &end, counter_clockwise: &end };
        let nan = [Vector2::new(f64::NAN, 0.0)];
        let far = [Vector2::new(9.0, 0.0)];
        for bad in [
            SquareRuns { side: 0.0, ..good },
            SquareRuns { side: f64::NAN, ..good },
            SquareRuns { clockwise: &[], ..good },
            SquareRuns { counter_clockwise: &[], ..good },
            SquareRuns { clockwise: &nan, ..good },
            SquareRuns { clockwise: &far, ..good },
        ] {
            assert!(UmbMark::calibrate(&bad, &assumed).is_err(), "{bad:?}");
        }
        assert!(UmbMark::calibrate(&good, &DifferentialParams { track: 0.0, ..assumed }).is_err());
        assert!(UmbMark::calibrate(&good, &assumed).is_ok());
    }
}
