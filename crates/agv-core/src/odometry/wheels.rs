//! From wheel angles to the motion of the base, with its uncertainty.
//!
//! A vehicle whose wheels turn by the small angles `φ` moves by `exp(J φ)`, with `J` the matrix of its forward
//! kinematics: the exact arc, not a chord. Wheel slip makes the variance of each angle grow with the angle itself
//! (Chong and Kleeman 1997: independent increments, so that the uncertainty of a path does not depend on how finely it
//! is sampled), and each steering angle has a noise of its own:
//!
//! ```text
//! Σ = Jr (J diag(k |φ|) Jᵀ + Σ g gᵀ s² + lateral) Jrᵀ        g = ∂(J φ) / ∂ steering
//! ```
//!
//! with `Jr` the right Jacobian of the exponential: a covariance in the base frame of the end.

use super::{EncoderParams, OdometryIncrement, RollingModel, TickCounter};
use crate::{
    Error, check,
    geometry::{LieGroup, Se2},
    time::Stamp,
};
use nalgebra::{Matrix3, SVector};

/// How wheels mislead.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WheelNoise {
    /// Variance of a wheel angle per radian rolled, in rad² per radian.
    pub angle_variance_per_radian: f64,
    /// Standard deviation of each steering angle, in radians; ignored by vehicles that do not steer.
    pub steering_sigma: f64,
    /// Variance of the sideways slip per metre travelled, in m² per metre. Positive keeps the covariance definite for
    /// vehicles that cannot move sideways.
    pub lateral_variance_per_metre: f64,
}

impl Default for WheelNoise {
    /// 1 cm of standard deviation per wheel after 10 m on 20 cm wheels, half a degree of steering, and 3 mm sideways
    /// after 1 m: hard floors indoors (Chong and Kleeman 1997 measured the like).
    fn default() -> Self {
        Self { angle_variance_per_radian: 1e-4, steering_sigma: 0.5_f64.to_radians(), lateral_variance_per_metre: 1e-5 }
    }
}

/// Wheel odometry of one vehicle with `N` encoders and `S` steering angles: counts in, increments out.
///
/// Between an increment and the next nothing is lost: every increment starts where the last one ended.
///
/// ```
/// use agv_core::kinematics::{DifferentialDrive, DifferentialParams};
/// use agv_core::odometry::{EncoderParams, WheelNoise, WheelOdometry};
/// use agv_core::time::Stamp;
///
/// let drive = DifferentialDrive::new(DifferentialParams::default())?;
/// let mut odometry = WheelOdometry::new(drive, EncoderParams::default(), WheelNoise::default())?;
/// assert!(odometry.update(Stamp::from_seconds(0.0), [0, 0], [])?.is_none()); // the first counts are the reference
///
/// let motion = odometry.update(Stamp::from_seconds(0.5), [4096, 4096], [])?.unwrap();
/// assert!((motion.start_from_end.x() - 0.2 * std::f64::consts::PI).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelOdometry<M, const N: usize, const S: usize = 0> {
    model: M,
    counter: TickCounter,
    noise: WheelNoise,
    last: Option<(Stamp, [i64; N])>,
}

impl<M: RollingModel<N, S>, const N: usize, const S: usize> WheelOdometry<M, N, S> {
    /// Odometry of a vehicle with equal encoders on all wheels.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(model: M, encoder: EncoderParams, noise: WheelNoise) -> Result<Self, Error> {
        check::non_negative("angle_variance_per_radian", noise.angle_variance_per_radian)?;
        check::non_negative("steering_sigma", noise.steering_sigma)?;
        check::non_negative("lateral_variance_per_metre", noise.lateral_variance_per_metre)?;
        Ok(Self { model, counter: TickCounter::new(encoder)?, noise, last: None })
    }

    /// The vehicle.
    pub const fn model(&self) -> &M {
        &self.model
    }

    /// Forgets the reference, after a restart of the encoders: the next counts are the new one.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// The motion since the last update; `None` for the first. `steering` holds the mean angles since then, in radians,
    /// in the order of the vehicle's [`RollingModel`].
    ///
    /// # Errors
    /// [`Error::TimeBackwards`], a steering angle that is not finite, or a wheel faster than the encoder's
    /// `max_wheel_speed`. The reference stays as it was: leave the reading out, or [`reset`](Self::reset).
    pub fn update(
        &mut self,
        stamp: Stamp,
        ticks: [i64; N],
        steering: [f64; S],
    ) -> Result<Option<OdometryIncrement>, Error> {
        check::all_finite("steering", &steering)?;
        let Some((start, before)) = self.last else {
            self.last = Some((stamp, ticks));
            return Ok(None);
        };
        if stamp < start {
            return Err(Error::TimeBackwards { earlier_ns: start.nanoseconds(), later_ns: stamp.nanoseconds() });
        }
        let mut angles = [0.0; N];
        for ((angle, before), now) in angles.iter_mut().zip(before).zip(ticks) {
            *angle = self.counter.angle(before, now, stamp - start)?;
        }
        let increment = self.increment(start, stamp, &angles, &steering)?;
        self.last = Some((stamp, ticks));
        Ok(Some(increment))
    }

    /// The motion for wheel angles in radians, from the caller's own encoders.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for an angle that is not, or for a motion that is not (a steering angle of a quarter turn).
    pub fn increment(
        &self,
        start: Stamp,
        end: Stamp,
        angles: &[f64; N],
        steering: &[f64; S],
    ) -> Result<OdometryIncrement, Error> {
        check::all_finite("wheel angle", angles)?;
        check::all_finite("steering", steering)?;
        let rolling = self.model.rolling_matrix(steering);
        let angles = SVector::<f64, N>::from(*angles);
        let tangent = rolling * angles;
        let mut spread = Matrix3::zeros();
        for axle in 0..S {
            let slope = self.model.rolling_matrix_slope(steering, axle) * angles * self.noise.steering_sigma;
            spread += slope * slope.transpose();
        }
        for (column, angle) in rolling.column_iter().zip(angles.iter()) {
            spread += column * column.transpose() * (self.noise.angle_variance_per_radian * angle.abs());
        }
        spread[(1, 1)] += self.noise.lateral_variance_per_metre * tangent.x.hypot(tangent.y);
        let jacobian = Se2::right_jacobian(&tangent);
        let covariance: Matrix3<f64> = jacobian * spread * jacobian.transpose();
        check::all_finite("odometry motion", &[tangent.x, tangent.y, tangent.z])?;
        check::all_finite("odometry covariance", covariance.as_slice())?;
        Ok(OdometryIncrement { start, end, start_from_end: Se2::exp(&tangent), covariance })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compute::Seed;
    use crate::kinematics::*;
    use rand_distr::{Distribution, StandardNormal};

    fn odometry() -> WheelOdometry<DifferentialDrive, 2> {
        let drive = DifferentialDrive::new(DifferentialParams::default()).unwrap();
        WheelOdometry::new(drive, EncoderParams::default(), WheelNoise::default()).unwrap()
    }

    /// The covariance against drawn wheel errors: 4000 draws of a quarter circle, each entry within the sampling error.
    #[test]
    fn the_covariance_is_that_of_drawn_wheel_angles() {
        let mut odometry = odometry();
        odometry.noise.lateral_variance_per_metre = 0.0;
        let angles = [10.0, 14.0];
        let mean = odometry.increment(Stamp::default(), Stamp::default(), &angles, &[]).unwrap();
        let mut stream = Seed(5).stream(0, 0);
        let draws = 4000;
        let mut scatter = Matrix3::zeros();
        for _ in 0..draws {
            let drawn = angles.map(|angle: f64| {
                let unit: f64 = StandardNormal.sample(&mut stream);
                angle + unit * (1e-4 * angle.abs()).sqrt()
            });
            let pose = odometry.increment(Stamp::default(), Stamp::default(), &drawn, &[]).unwrap().start_from_end;
            let error = pose.minus(&mean.start_from_end);
            scatter += error * error.transpose() / f64::from(draws);
        }
        // Standard error of a variance is sqrt(2 / n) = 2.2 %; four of them, relative to the largest entries.
        let scale = |i: usize, j: usize| (mean.covariance[(i, i)] * mean.covariance[(j, j)]).sqrt();
        for i in 0..3 {
            for j in 0..3 {
                assert!((scatter[(i, j)] - mean.covariance[(i, j)]).abs() < 0.09 * scale(i, j) + 1e-12, "{i} {j}");
            }
        }
    }

    /// Finer sampling gives the same pose and the same covariance: the noise grows with the path, not with the steps.
    #[test]
    fn covariance_does_not_depend_on_the_sampling() {
        let run = |steps: i64| {
            let mut odometry = odometry();
            let mut sum = super::super::OdometryAccumulator::default();
            for i in 0..=steps {
                let stamp = Stamp::from_seconds(i as f64 * 10.0 / steps as f64);
                let ticks = [40_000 * i / steps, 60_000 * i / steps];
                if let Some(increment) = odometry.update(stamp, ticks, []).unwrap() {
                    sum.push(&increment).unwrap();
                }
            }
            sum.take().unwrap()
        };
        let (coarse, fine) = (run(10), run(1000));
        assert!((fine.start_from_end.minus(&coarse.start_from_end)).norm() < 1e-9);
        let relative = (fine.covariance - coarse.covariance).norm() / fine.covariance.norm();
        assert!(relative < 0.02, "{relative}");
    }

    #[test]
    fn bad_readings_leave_the_reference_as_it_was() {
        let mut odometry = odometry();
        odometry.update(Stamp::from_seconds(1.0), [0, 0], []).unwrap();
        let before = odometry;
        assert!(matches!(odometry.update(Stamp::from_seconds(0.5), [1, 1], []), Err(Error::TimeBackwards { .. })));
        assert!(odometry.update(Stamp::from_seconds(1.01), [9000, 0], []).is_err());
        assert!(odometry.increment(Stamp::default(), Stamp::default(), &[f64::INFINITY, 0.0], &[]).is_err());
        assert_eq!(odometry, before);
        // A repeated stamp with the same counts is no motion, not an error.
        let still = odometry.update(Stamp::from_seconds(1.0), [0, 0], []).unwrap().unwrap();
        assert_eq!((still.dt(), still.start_from_end), (0.0, Se2::default()));
    }

    fn crab() -> WheelOdometry<DoubleAckermann, 1, 2> {
        let carrier = DoubleAckermann::new(DoubleAckermannParams { front: 0.8, rear: 0.5, ..Default::default() });
        WheelOdometry::new(carrier.unwrap(), EncoderParams::default(), WheelNoise::default()).unwrap()
    }

    /// A quarter revolution with both axles steered is the arc that the forward kinematics says.
    #[test]
    fn both_axles_steer() {
        let mut odometry = crab();
        odometry.update(Stamp::default(), [7], [0.0; 2]).unwrap();
        for (front_steering, rear_steering) in [(0.3, 0.3), (0.4, -0.4), (-0.2, 0.1)] {
            odometry.reset();
            odometry.update(Stamp::default(), [0], [0.0; 2]).unwrap();
            let angles = [front_steering, rear_steering];
            let motion = odometry.update(Stamp::from_seconds(1.0), [1024], angles).unwrap().unwrap();
            let wheels = DoubleAckermannWheels { drive: std::f64::consts::FRAC_PI_2, front_steering, rear_steering };
            let arc = odometry.model().forward(&wheels).integrate(1.0);
            assert!(motion.start_from_end.minus(&arc).norm() < 1e-12);
        }
        let before = odometry;
        let later = Stamp::from_seconds(1.01);
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(odometry.update(later, [1024], [bad, 0.0]).is_err());
            assert!(odometry.update(later, [1024], [0.0, bad]).is_err());
        }
        assert_eq!(odometry, before);
    }

    /// Errors of the two steering angles are independent: each entry of the covariance within the sampling error of
    /// 4000 draws.
    #[test]
    fn the_covariance_is_that_of_drawn_steering_angles() {
        let mut odometry = crab();
        odometry.noise =
            WheelNoise { angle_variance_per_radian: 0.0, steering_sigma: 0.01, lateral_variance_per_metre: 0.0 };
        let (rolled, steering) = ([5.0], [0.4, -0.2]);
        let mean = odometry.increment(Stamp::default(), Stamp::default(), &rolled, &steering).unwrap();
        let mut stream = Seed(6).stream(0, 0);
        let mut scatter = Matrix3::zeros();
        for _ in 0..4000 {
            let drawn = steering.map(|angle| {
                let unit: f64 = StandardNormal.sample(&mut stream);
                angle + 0.01 * unit
            });
            let pose = odometry.increment(Stamp::default(), Stamp::default(), &rolled, &drawn).unwrap().start_from_end;
            let error = pose.minus(&mean.start_from_end);
            scatter += error * error.transpose() / 4000.0;
        }
        // Standard error of a variance is sqrt(2 / n) = 2.2 %; four of them, and the curvature of the model.
        let scale = |i: usize, j: usize| (mean.covariance[(i, i)] * mean.covariance[(j, j)]).sqrt();
        for (i, j) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)] {
            assert!((scatter[(i, j)] - mean.covariance[(i, j)]).abs() < 0.1 * scale(i, j), "{i} {j}");
        }
    }

    #[test]
    fn bad_noise_is_refused() {
        let drive = DifferentialDrive::new(DifferentialParams::default()).unwrap();
        let good = WheelNoise::default();
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            for noise in [
                WheelNoise { angle_variance_per_radian: bad, ..good },
                WheelNoise { steering_sigma: bad, ..good },
                WheelNoise { lateral_variance_per_metre: bad, ..good },
            ] {
                assert!(WheelOdometry::new(drive, EncoderParams::default(), noise).is_err());
            }
        }
    }
}
