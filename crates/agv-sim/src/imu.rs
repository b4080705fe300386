//! An inertial measurement unit: three gyros and three accelerometers.
//!
//! ```text
//! gyro  = (1 + g) ω + b + n          b' = walk        n, walk white
//! accel = (1 + a) (Rᵀ (v' - gravity)) + c + m
//! ```
//!
//! with gain errors `g`, `a` that last for the unit's life, biases `b`, `c` that start somewhere and wander (Woodman
//! 2007, *An introduction to inertial navigation*), and noise given as densities, so that the sampling rate does not
//! change its physics: a sample over `dt` seconds has the standard deviation `density / √dt`.

use crate::Error;
use crate::noise::normal;
use agv_core::{
    check,
    compute::{Seed, Stream},
    geometry::{LieGroup, So3, Twist2},
};
use nalgebra::Vector3;

/// Standard gravity, in metres per second squared.
pub const GRAVITY: f64 = 9.806_65;

/// Errors of one kind of sensor in the unit (`u`: rad/s for gyros, m/s² for accelerometers).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InertialNoise {
    /// White noise density, in u/√Hz.
    pub density: f64,
    /// Density of the bias's random walk, in u/s/√Hz.
    pub bias_walk: f64,
    /// Standard deviation of each axis's bias at the start, in u.
    pub initial_bias: f64,
    /// Relative gain error, the same on all axes: 0.03 reads 3 % too much.
    pub gain_error: f64,
}

impl InertialNoise {
    /// No errors at all.
    pub const NONE: Self = Self { density: 0.0, bias_walk: 0.0, initial_bias: 0.0, gain_error: 0.0 };

    fn validate(&self) -> Result<(), Error> {
        check::non_negative("density", self.density)?;
        check::non_negative("bias_walk", self.bias_walk)?;
        check::non_negative("initial_bias", self.initial_bias)?;
        check::in_range("gain_error", self.gain_error, -0.99, 10.0)?;
        Ok(())
    }
}

/// What an inertial measurement unit is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuParams {
    /// Errors of the gyros, in rad/s.
    pub gyro: InertialNoise,
    /// Errors of the accelerometers, in m/s².
    pub accelerometer: InertialNoise,
}

impl Default for ImuParams {
    /// A consumer MEMS unit: 0.01 °/s/√Hz and 200 µg/√Hz, biases of 0.3 °/s and 0.05 m/s² (orders of magnitude of the
    /// Bosch BMI160 data sheet).
    fn default() -> Self {
        Self {
            gyro: InertialNoise { density: 1.7e-4, bias_walk: 1e-5, initial_bias: 5e-3, gain_error: 0.0 },
            accelerometer: InertialNoise { density: 2e-3, bias_walk: 1e-4, initial_bias: 0.05, gain_error: 0.0 },
        }
    }
}

/// What the body of the unit really does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InertialTruth {
    /// Attitude of the body in the map, whose z axis points up.
    pub map_from_body: So3,
    /// Turn rates in the body frame, in radians per second.
    pub angular_rate: Vector3<f64>,
    /// Acceleration of the body in the body frame, in metres per second squared, gravity not counted.
    pub acceleration: Vector3<f64>,
}

impl InertialTruth {
    /// A vehicle on a level floor with this twist, and the twist's change per second (`acceleration` in m/s² and
    /// rad/s²), at its origin: turning adds the centripetal acceleration.
    pub fn planar(twist: &Twist2, acceleration: &Twist2) -> Self {
        // d/dt of a velocity given in a frame that turns: v' + ω × v.
        let (vx, vy, rate) = (twist.vx, twist.vy, twist.yaw_rate);
        Self {
            map_from_body: So3::default(),
            angular_rate: Vector3::new(0.0, 0.0, rate),
            acceleration: Vector3::new(acceleration.vx - rate * vy, acceleration.vy + rate * vx, 0.0),
        }
    }
}

/// What the unit reads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuReading {
    /// Turn rates in the body frame, in radians per second; z is all that a planar vehicle needs.
    pub gyro: Vector3<f64>,
    /// Specific force in the body frame, in metres per second squared: at rest it reads +g upwards.
    pub accelerometer: Vector3<f64>,
}

/// An inertial measurement unit with its ground truth.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Twist2;
/// use agv_sim::{Imu, ImuParams, InertialTruth};
///
/// let mut imu = Imu::new(ImuParams::default(), Seed(1))?;
/// let turning = InertialTruth::planar(&Twist2::new(1.0, 0.0, 0.5), &Twist2::ZERO);
/// let reading = imu.sample(&turning, 0.01)?;
/// assert!((reading.gyro.z - 0.5).abs() < 0.05);
/// // What a filter should find out:
/// let truth = imu.gyro_bias();
/// assert!(truth.norm() < 0.05);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Imu {
    params: ImuParams,
    seed: Seed,
    step: u64,
    gyro_bias: Vector3<f64>,
    accelerometer_bias: Vector3<f64>,
}

/// Three independent draws.
fn normal3(sigma: f64, stream: &mut Stream) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(sigma, stream))
}

impl Imu {
    /// A unit whose biases are drawn from the seed.
    ///
    /// # Errors
    /// A parameter that is negative or not finite, or a gain error that would invert the reading.
    pub fn new(params: ImuParams, seed: Seed) -> Result<Self, Error> {
        params.gyro.validate()?;
        params.accelerometer.validate()?;
        let mut stream = seed.stream(0, 0);
        Ok(Self {
            params,
            seed,
            step: 1,
            gyro_bias: normal3(params.gyro.initial_bias, &mut stream),
            accelerometer_bias: normal3(params.accelerometer.initial_bias, &mut stream),
        })
    }

    /// The reading over the next `dt` seconds.
    ///
    /// # Errors
    /// A truth that is not finite, or a `dt` that is not finite and positive; the unit is then as it was.
    pub fn sample(&mut self, truth: &InertialTruth, dt: f64) -> Result<ImuReading, Error> {
        check::positive("dt", dt)?;
        check::all_finite("angular_rate", truth.angular_rate.iter())?;
        check::all_finite("acceleration", truth.acceleration.iter())?;
        check::all_finite("map_from_body", &truth.map_from_body.matrix())?;
        let mut stream = self.seed.stream(self.step, 0);
        self.step += 1;
        let force = truth.acceleration + truth.map_from_body.inverse().act(&(Vector3::z() * GRAVITY));
        let mut read = |noise: &InertialNoise, bias: &mut Vector3<f64>, value: Vector3<f64>| {
            *bias += normal3(noise.bias_walk * dt.sqrt(), &mut stream);
            value * (1.0 + noise.gain_error) + *bias + normal3(noise.density / dt.sqrt(), &mut stream)
        };
        Ok(ImuReading {
            gyro: read(&self.params.gyro, &mut self.gyro_bias, truth.angular_rate),
            accelerometer: read(&self.params.accelerometer, &mut self.accelerometer_bias, force),
        })
    }

    /// True bias of the gyros now, in radians per second.
    pub const fn gyro_bias(&self) -> Vector3<f64> {
        self.gyro_bias
    }

    /// True bias of the accelerometers now, in metres per second squared.
    pub const fn accelerometer_bias(&self) -> Vector3<f64> {
        self.accelerometer_bias
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_rest() -> InertialTruth {
        InertialTruth::planar(&Twist2::ZERO, &Twist2::ZERO)
    }

    #[test]
    fn an_ideal_unit_at_rest_reads_gravity_alone() {
        let ideal = ImuParams { gyro: InertialNoise::NONE, accelerometer: InertialNoise::NONE };
        let mut imu = Imu::new(ideal, Seed(0)).unwrap();
        let level = imu.sample(&at_rest(), 0.01).unwrap();
        assert_eq!((level.gyro, level.accelerometer), (Vector3::zeros(), Vector3::z() * GRAVITY));
        // Nose up by 30°: the x axis feels half of gravity.
        let pitched =
            InertialTruth { map_from_body: So3::from_roll_pitch_yaw(0.0, -30_f64.to_radians(), 1.0), ..at_rest() };
        assert!((imu.sample(&pitched, 0.01).unwrap().accelerometer.x - 0.5 * GRAVITY).abs() < 1e-9);
        // On a circle of 2 m at 1 m/s the y axis feels v² / r.
        let turning = InertialTruth::planar(&Twist2::new(1.0, 0.0, 0.5), &Twist2::ZERO);
        assert_eq!(imu.sample(&turning, 0.01).unwrap().accelerometer.y, 0.5);
    }

    /// Noise as a density: the mean over a second has the same spread at every rate, `density / √1 s`; and the bias
    /// after T seconds has spread `walk √T`. Chi-square over 400 units, 3 axes: within 4.5 sigma.
    #[test]
    fn noise_and_bias_do_not_depend_on_the_rate() {
        let gyro = InertialNoise { density: 0.02, bias_walk: 0.0, initial_bias: 0.0, gain_error: 0.0 };
        let walk = InertialNoise { density: 0.0, bias_walk: 0.3, initial_bias: 0.0, gain_error: 0.0 };
        for rate in [10_u32, 100] {
            let dt = 1.0 / f64::from(rate);
            let (mut means, mut walks) = (0.0, 0.0);
            for unit in 0..400 {
                let params = ImuParams { gyro, accelerometer: walk };
                let mut imu = Imu::new(params, Seed(unit)).unwrap();
                let sum: Vector3<f64> = (0..rate).map(|_| imu.sample(&at_rest(), dt).unwrap().gyro).sum();
                means += (sum * dt / 0.02).norm_squared();
                walks += (imu.accelerometer_bias() / 0.3).norm_squared();
            }
            for statistic in [means, walks] {
                assert!((statistic - 1200.0).abs() < 4.5 * 2400_f64.sqrt(), "{statistic}");
            }
        }
    }

    #[test]
    fn gains_scale_the_reading() {
        let gyro = InertialNoise { gain_error: 0.03, ..InertialNoise::NONE };
        let mut imu = Imu::new(ImuParams { gyro, accelerometer: InertialNoise::NONE }, Seed(0)).unwrap();
        let turning = InertialTruth::planar(&Twist2::new(0.0, 0.0, 2.0), &Twist2::ZERO);
        assert!((imu.sample(&turning, 0.1).unwrap().gyro.z - 2.06).abs() < 1e-12);
    }

    #[test]
    fn bad_units_and_truths_are_refused() {
        let bad = |gyro| Imu::new(ImuParams { gyro, ..Default::default() }, Seed(0)).is_err();
        assert!(bad(InertialNoise { density: -1.0, ..InertialNoise::NONE }));
        assert!(bad(InertialNoise { bias_walk: f64::NAN, ..InertialNoise::NONE }));
        assert!(bad(InertialNoise { initial_bias: f64::INFINITY, ..InertialNoise::NONE }));
        assert!(bad(InertialNoise { gain_error: -1.0, ..InertialNoise::NONE }));
        let mut imu = Imu::new(ImuParams::default(), Seed(0)).unwrap();
        let before = imu.clone();
        assert!(imu.sample(&at_rest(), 0.0).is_err());
        assert!(imu.sample(&at_rest(), f64::NAN).is_err());
        let nan = InertialTruth { angular_rate: Vector3::repeat(f64::NAN), ..at_rest() };
        assert!(imu.sample(&nan, 0.01).is_err());
        assert_eq!(imu, before);
    }
}
