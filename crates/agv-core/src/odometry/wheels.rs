//! From wheel angles to the motion of the base, with its uncertainty.
//!
//! A vehicle whose wheels turn by the small angles `φ` moves by `exp(J φ)`, with `J` the matrix of its forward
//! kinematics: the exact arc, not a chord. Wheel slip makes the variance of each angle grow with the angle itself
//! (Chong and Kleeman 1997: independent increments, so that the uncertainty of a path does not depend on how finely it
//! is sampled), and the steering angle has a noise of its own:
//!
//! ```text
//! Σ = Jr (J diag(k |φ|) Jᵀ + g g' s² + lateral) Jrᵀ        g = ∂(J φ) / ∂ steering
//! ```
//!
//! with `Jr` the right Jacobian of the exponential: a covariance in the base frame of the end.

use super::{EncoderParams, OdometryIncrement, TickCounter};
use crate::{
    Error, check,
    geometry::{LieGroup, Se2},
    kinematics::{
        Ackermann, AckermannWheels, DifferentialDrive, DifferentialWheels, Kinematics, Mecanum, MecanumWheels,
        Tricycle, TricycleWheels,
    },
    time::Stamp,
};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// A vehicle whose motion is linear in `N` wheel angles, at a given steering angle.
pub trait RollingModel<const N: usize> {
    /// Motion of the base, as a tangent `(x, y, yaw)`, per radian of each wheel; `steering` in radians. Its columns are
    /// what [`Kinematics::forward`] says of one wheel alone.
    fn rolling_matrix(&self, steering: f64) -> SMatrix<f64, 3, N>;

    /// Derivative of [`rolling_matrix`](Self::rolling_matrix) with respect to the steering angle.
    fn rolling_matrix_slope(&self, _steering: f64) -> SMatrix<f64, 3, N> {
        SMatrix::zeros()
    }
}

/// Wheels in the order left, right.
impl RollingModel<2> for DifferentialDrive {
    fn rolling_matrix(&self, _: f64) -> SMatrix<f64, 3, 2> {
        let column = |left, right| self.forward(&DifferentialWheels { left, right }).into();
        SMatrix::from_columns(&[column(1.0, 0.0), column(0.0, 1.0)])
    }
}

/// The mean angle of the driven rear wheels.
impl RollingModel<1> for Ackermann {
    fn rolling_matrix(&self, steering: f64) -> Vector3<f64> {
        self.forward(&AckermannWheels { drive: 1.0, steering }).into()
    }

    fn rolling_matrix_slope(&self, steering: f64) -> Vector3<f64> {
        let (p, cos) = (self.params(), steering.cos());
        Vector3::new(0.0, 0.0, p.wheel_radius / (p.wheelbase * cos * cos))
    }
}

/// The front wheel.
impl RollingModel<1> for Tricycle {
    fn rolling_matrix(&self, steering: f64) -> Vector3<f64> {
        self.forward(&TricycleWheels { drive: 1.0, steering }).into()
    }

    fn rolling_matrix_slope(&self, steering: f64) -> Vector3<f64> {
        let (p, (sin, cos)) = (self.params(), steering.sin_cos());
        Vector3::new(-p.wheel_radius * sin, 0.0, p.wheel_radius * cos / p.wheelbase)
    }
}

/// Wheels in the order front left, front right, rear left, rear right.
impl RollingModel<4> for Mecanum {
    fn rolling_matrix(&self, _: f64) -> SMatrix<f64, 3, 4> {
        let column = |front_left, front_right, rear_left, rear_right| {
            self.forward(&MecanumWheels { front_left, front_right, rear_left, rear_right }).into()
        };
        SMatrix::from_columns(&[
            column(1.0, 0.0, 0.0, 0.0),
            column(0.0, 1.0, 0.0, 0.0),
            column(0.0, 0.0, 1.0, 0.0),
            column(0.0, 0.0, 0.0, 1.0),
        ])
    }
}

/// How wheels mislead.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WheelNoise {
    /// Variance of a wheel angle per radian rolled, in rad² per radian.
    pub angle_variance_per_radian: f64,
    /// Standard deviation of the steering angle, in radians; ignored by vehicles that do not steer.
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

/// Wheel odometry of one vehicle: counts in, increments out.
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
/// assert!(odometry.update(Stamp::from_seconds(0.0), [0, 0], 0.0)?.is_none()); // the first counts are the reference
///
/// let motion = odometry.update(Stamp::from_seconds(0.5), [4096, 4096], 0.0)?.unwrap();
/// assert!((motion.start_from_end.x() - 0.2 * std::f64::consts::PI).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelOdometry<M, const N: usize> {
    model: M,
    counter: TickCounter,
    noise: WheelNoise,
    last: Option<(Stamp, [i64; N])>,
}

impl<M: RollingModel<N>, const N: usize> WheelOdometry<M, N> {
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

    /// The motion since the last update; `None` for the first. `steering` is the mean angle since then, in radians
    /// (any finite number for a vehicle that does not steer).
    ///
    /// # Errors
    /// [`Error::TimeBackwards`], a steering angle that is not finite, or a wheel faster than the encoder's
    /// `max_wheel_speed`. The reference stays as it was: leave the reading out, or [`reset`](Self::reset).
    pub fn update(&mut self, stamp: Stamp, ticks: [i64; N], steering: f64) -> Result<Option<OdometryIncrement>, Error> {
        check::finite("steering", steering)?;
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
        let increment = self.increment(start, stamp, &angles, steering)?;
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
        steering: f64,
    ) -> Result<OdometryIncrement, Error> {
        check::all_finite("wheel angle", angles)?;
        check::finite("steering", steering)?;
        let rolling = self.model.rolling_matrix(steering);
        let angles = SVector::<f64, N>::from(*angles);
        let tangent = rolling * angles;
        let slope = self.model.rolling_matrix_slope(steering) * angles * self.noise.steering_sigma;
        let mut spread = slope * slope.transpose();
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

    /// The matrices are the forward kinematics of the same vehicles, and their slopes the numeric derivatives.
    #[test]
    fn rolling_matrices_agree_with_the_kinematics() {
        let truck = Ackermann::new(AckermannParams::default()).unwrap();
        let tricycle = Tricycle::new(TricycleParams::default()).unwrap();
        let carrier = Mecanum::new(MecanumParams::default()).unwrap();
        let drive = DifferentialDrive::new(DifferentialParams { left_radius: 0.09, ..Default::default() }).unwrap();
        let (steering, h) = (0.4, 1e-6);
        let close = |a: Vector3<f64>, b: Vector3<f64>| assert!((a - b).norm() < 1e-9, "{a} {b}");
        close(truck.rolling_matrix(steering) * 2.0, truck.forward(&AckermannWheels { drive: 2.0, steering }).into());
        close(
            tricycle.rolling_matrix(steering) * 2.0,
            tricycle.forward(&TricycleWheels { drive: 2.0, steering }).into(),
        );
        close(
            drive.rolling_matrix(0.0) * nalgebra::Vector2::new(1.0, 3.0),
            drive.forward(&DifferentialWheels { left: 1.0, right: 3.0 }).into(),
        );
        let wheels = MecanumWheels { front_left: 1.0, front_right: -2.0, rear_left: 3.0, rear_right: 0.5 };
        close(
            carrier.rolling_matrix(0.0) * nalgebra::Vector4::new(1.0, -2.0, 3.0, 0.5),
            carrier.forward(&wheels).into(),
        );
        close(
            truck.rolling_matrix_slope(steering),
            (truck.rolling_matrix(steering + h) - truck.rolling_matrix(steering - h)) / (2.0 * h),
        );
        close(
            tricycle.rolling_matrix_slope(steering),
            (tricycle.rolling_matrix(steering + h) - tricycle.rolling_matrix(steering - h)) / (2.0 * h),
        );
    }

    /// The covariance against drawn wheel errors: 4000 draws of a quarter circle, each entry within the sampling error.
    #[test]
    fn the_covariance_is_that_of_drawn_wheel_angles() {
        let mut odometry = odometry();
        odometry.noise.lateral_variance_per_metre = 0.0;
        let angles = [10.0, 14.0];
        let mean = odometry.increment(Stamp::default(), Stamp::default(), &angles, 0.0).unwrap();
        let mut stream = Seed(5).stream(0, 0);
        let draws = 4000;
        let mut scatter = Matrix3::zeros();
        for _ in 0..draws {
            let drawn = angles.map(|angle: f64| {
                let unit: f64 = StandardNormal.sample(&mut stream);
                angle + unit * (1e-4 * angle.abs()).sqrt()
            });
            let pose = odometry.increment(Stamp::default(), Stamp::default(), &drawn, 0.0).unwrap().start_from_end;
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
                if let Some(increment) = odometry.update(stamp, ticks, 0.0).unwrap() {
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
        odometry.update(Stamp::from_seconds(1.0), [0, 0], 0.0).unwrap();
        let before = odometry;
        assert!(matches!(odometry.update(Stamp::from_seconds(0.5), [1, 1], 0.0), Err(Error::TimeBackwards { .. })));
        assert!(odometry.update(Stamp::from_seconds(1.01), [9000, 0], 0.0).is_err());
        assert!(odometry.update(Stamp::from_seconds(1.01), [1, 1], f64::NAN).is_err());
        assert!(odometry.increment(Stamp::default(), Stamp::default(), &[f64::INFINITY, 0.0], 0.0).is_err());
        assert_eq!(odometry, before);
        // A repeated stamp with the same counts is no motion, not an error.
        let still = odometry.update(Stamp::from_seconds(1.0), [0, 0], 0.0).unwrap().unwrap();
        assert_eq!((still.dt(), still.start_from_end), (0.0, Se2::default()));
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
