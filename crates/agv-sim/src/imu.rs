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

use crate::noise::{Part, normal, own_seed};
use crate::{Error, InertialTruth};
use agv_core::{
    check,
    compute::{Seed, Stream},
    geometry::{LieGroup, Se3, UncertainPose, UncertainVector},
    sensors::{GRAVITY, ImuSample, SensorId},
    time::Stamp,
};
use nalgebra::{Matrix3, Vector3};

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
    /// Which unit of the vehicle it is.
    pub sensor: SensorId,
    /// Pose of the unit on the vehicle.
    pub base_from_sensor: Se3,
    /// Errors of the gyros, in rad/s.
    pub gyro: InertialNoise,
    /// Errors of the accelerometers, in m/s².
    pub accelerometer: InertialNoise,
    /// Standard deviation of the attitude that the unit makes of its readings, about each of its axes, in radians; none
    /// for a unit that makes none.
    pub attitude_sigma: Option<f64>,
}

impl Default for ImuParams {
    /// A consumer MEMS unit: 0.01 °/s/√Hz and 200 µg/√Hz, biases of 0.3 °/s and 0.05 m/s² (orders of magnitude of the
    /// Bosch BMI160 data sheet).
    fn default() -> Self {
        Self {
            sensor: SensorId::default(),
            base_from_sensor: Se3::default(),
            gyro: InertialNoise { density: 1.7e-4, bias_walk: 1e-5, initial_bias: 5e-3, gain_error: 0.0 },
            accelerometer: InertialNoise { density: 2e-3, bias_walk: 1e-4, initial_bias: 0.05, gain_error: 0.0 },
            attitude_sigma: None,
        }
    }
}

impl ImuParams {
    /// The same unit without errors: it reads the truth.
    #[must_use]
    pub const fn ideal(self) -> Self {
        Self { gyro: InertialNoise::NONE, accelerometer: InertialNoise::NONE, ..self }
    }

    fn validate(&self) -> Result<(), Error> {
        // The mount is checked where a sample takes it.
        ImuSample::new(Stamp::default()).with_mount(self.base_from_sensor)?;
        self.gyro.validate()?;
        self.accelerometer.validate()?;
        check::non_negative("attitude_sigma", self.attitude_sigma.unwrap_or(0.0))?;
        Ok(())
    }
}

/// An inertial measurement unit with its ground truth.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Twist2;
/// use agv_core::time::Stamp;
/// use agv_sim::{Imu, ImuParams, InertialTruth};
///
/// let mut imu = Imu::new(ImuParams::default(), Seed(1))?;
/// let turning = InertialTruth::planar(0.0, &Twist2::new(1.0, 0.0, 0.5), &Twist2::ZERO);
/// let sample = imu.sample(&turning, Stamp::from_seconds(0.01), 0.01)?;
/// let (rate, _) = sample.yaw_rate().unwrap();
/// assert!((rate - 0.5).abs() < 0.05);
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
    last: Option<ImuSample>,
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
        params.validate()?;
        let seed = own_seed(seed, Part::Imu, params.sensor);
        let mut stream = seed.stream(0, 0);
        Ok(Self {
            params,
            seed,
            step: 1,
            gyro_bias: normal3(params.gyro.initial_bias, &mut stream),
            accelerometer_bias: normal3(params.accelerometer.initial_bias, &mut stream),
            last: None,
        })
    }

    /// What the unit is like.
    pub const fn params(&self) -> &ImuParams {
        &self.params
    }

    /// The sample taken last; none before the first.
    pub const fn last(&self) -> Option<&ImuSample> {
        self.last.as_ref()
    }

    /// The sample at `stamp`, over the `dt` seconds before it, on a vehicle that does what `base` says. Its covariances
    /// are those of the white noise alone, as data sheets state it.
    ///
    /// # Errors
    /// A truth that is not finite, or a `dt` that is not finite and positive; the unit is then as it was.
    pub fn sample(&mut self, base: &InertialTruth, stamp: Stamp, dt: f64) -> Result<ImuSample, Error> {
        check::positive("dt", dt)?;
        base.validate()?;
        let truth = base.at(&self.params.base_from_sensor);
        truth.validate()?;
        let mut stream = self.seed.stream(self.step, 0);
        let force = truth.acceleration + truth.map_from_body.inverse().act(&(Vector3::z() * GRAVITY));
        let mut read = |noise: &InertialNoise, bias: &mut Vector3<f64>, value: Vector3<f64>| {
            *bias += normal3(noise.bias_walk * dt.sqrt(), &mut stream);
            let sigma = noise.density / dt.sqrt();
            let reading = value * (1.0 + noise.gain_error) + *bias + normal3(sigma, &mut stream);
            UncertainVector::from_sigmas(reading, &Vector3::repeat(sigma))
        };
        let (mut gyro_bias, mut accelerometer_bias) = (self.gyro_bias, self.accelerometer_bias);
        let rates = read(&self.params.gyro, &mut gyro_bias, truth.angular_rate)?;
        let forces = read(&self.params.accelerometer, &mut accelerometer_bias, force)?;
        let mut sample = ImuSample::new(stamp)
            .with_sensor(self.params.sensor)
            .with_mount(self.params.base_from_sensor)?
            .with_angular_velocity(rates)
            .with_specific_force(forces);
        if let Some(sigma) = self.params.attitude_sigma {
            // A stream of its own: whether there is an attitude does not change the other readings.
            let error = normal3(sigma, &mut self.seed.stream(self.step, 1));
            let spread = Matrix3::from_diagonal_element(sigma * sigma);
            sample = sample.with_orientation(UncertainPose::new(truth.map_from_body.plus(&error), spread)?);
        }
        (self.gyro_bias, self.accelerometer_bias) = (gyro_bias, accelerometer_bias);
        self.step += 1;
        self.last = Some(sample);
        Ok(sample)
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
    use agv_core::geometry::{So3, Twist2};

    fn at_rest() -> InertialTruth {
        InertialTruth::planar(0.0, &Twist2::ZERO, &Twist2::ZERO)
    }

    /// Rates and forces of a sample.
    fn read(imu: &mut Imu, truth: &InertialTruth, dt: f64) -> (Vector3<f64>, Vector3<f64>) {
        let sample = imu.sample(truth, Stamp::default(), dt).unwrap();
        (*sample.angular_velocity().unwrap().mean(), *sample.specific_force().unwrap().mean())
    }

    #[test]
    fn an_ideal_unit_at_rest_reads_gravity_alone() {
        let mut imu = Imu::new(ImuParams::default().ideal(), Seed(0)).unwrap();
        assert_eq!(read(&mut imu, &at_rest(), 0.01), (Vector3::zeros(), Vector3::z() * GRAVITY));
        // Nose up by 30°: the x axis feels half of gravity.
        let pitched =
            InertialTruth { map_from_body: So3::from_roll_pitch_yaw(0.0, -30_f64.to_radians(), 1.0), ..at_rest() };
        assert!((read(&mut imu, &pitched, 0.01).1.x - 0.5 * GRAVITY).abs() < 1e-9);
        // On a circle of 2 m at 1 m/s the y axis feels v² / r.
        let turning = InertialTruth::planar(2.0, &Twist2::new(1.0, 0.0, 0.5), &Twist2::ZERO);
        assert!((read(&mut imu, &turning, 0.01).1.y - 0.5).abs() < 1e-12);
    }

    /// A unit off the centre of a vehicle that spins up feels the lever, and reads it on its own axes.
    #[test]
    fn a_lever_adds_to_the_force() {
        let mount = Se3::from_parts(Vector3::new(0.4, 0.0, 0.2), So3::from_roll_pitch_yaw(0.0, 0.0, 0.7));
        let mut imu = Imu::new(ImuParams { base_from_sensor: mount, ..ImuParams::default().ideal() }, Seed(0)).unwrap();
        let spin = InertialTruth::planar(0.3, &Twist2::new(0.0, 0.0, 2.0), &Twist2::new(0.0, 0.0, 0.5));
        let (rates, forces) = read(&mut imu, &spin, 0.01);
        let in_base = mount.rotation().act(&forces);
        // ω² r towards the centre, α r along the turn.
        assert!((in_base - Vector3::new(-1.6, 0.2, GRAVITY)).norm() < 1e-12, "{in_base}");
        assert!((rates - Vector3::z() * 2.0).norm() < 1e-12);
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
                let params = ImuParams { gyro, accelerometer: walk, ..Default::default() };
                let mut imu = Imu::new(params, Seed(unit)).unwrap();
                let sum: Vector3<f64> = (0..rate).map(|_| read(&mut imu, &at_rest(), dt).0).sum();
                means += (sum * dt / 0.02).norm_squared();
                walks += (imu.accelerometer_bias() / 0.3).norm_squared();
            }
            for statistic in [means, walks] {
                assert!((statistic - 1200.0).abs() < 4.5 * 2400_f64.sqrt(), "{statistic}");
            }
        }
    }

    /// Rates, forces and attitude err as the sample's own covariances say: chi-square over 2000 samples, 3 axes each.
    #[test]
    fn samples_state_their_noise() {
        let noise = |density| InertialNoise { density, ..InertialNoise::NONE };
        let params = ImuParams {
            gyro: noise(0.01),
            accelerometer: noise(0.02),
            attitude_sigma: Some(0.03),
            ..Default::default()
        };
        let mut imu = Imu::new(params, Seed(3)).unwrap();
        let mut squares = [0.0; 3];
        for _ in 0..2000 {
            let sample = imu.sample(&at_rest(), Stamp::default(), 0.01).unwrap();
            let (rates, forces) = (sample.angular_velocity().unwrap(), sample.specific_force().unwrap());
            let attitude = sample.orientation().unwrap();
            let errors = [*rates.mean(), forces.mean() - Vector3::z() * GRAVITY, attitude.mean().log()];
            let spreads = [*rates.covariance(), *forces.covariance(), *attitude.covariance()];
            for ((sum, error), spread) in squares.iter_mut().zip(errors).zip(spreads) {
                *sum += error.dot(&(spread.try_inverse().unwrap() * error));
            }
        }
        for sum in squares {
            assert!((sum - 6000.0).abs() < 4.5 * 12_000_f64.sqrt(), "{sum}");
        }
    }

    #[test]
    fn gains_scale_the_reading_and_an_attitude_changes_none() {
        let gyro = InertialNoise { gain_error: 0.03, ..InertialNoise::NONE };
        let turning = InertialTruth::planar(0.0, &Twist2::new(0.0, 0.0, 2.0), &Twist2::ZERO);
        let mut imu = Imu::new(ImuParams { gyro, ..ImuParams::default().ideal() }, Seed(0)).unwrap();
        assert!((read(&mut imu, &turning, 0.1).0.z - 2.06).abs() < 1e-12);

        let mut plain = Imu::new(ImuParams::default(), Seed(5)).unwrap();
        let mut full = Imu::new(ImuParams { attitude_sigma: Some(0.1), ..Default::default() }, Seed(5)).unwrap();
        for _ in 0..3 {
            assert_eq!(read(&mut plain, &turning, 0.1), read(&mut full, &turning, 0.1));
        }
    }

    #[test]
    fn bad_units_and_truths_are_refused() {
        let good = ImuParams::default();
        let noisy = |gyro| ImuParams { gyro, ..good };
        for bad in [
            noisy(InertialNoise { density: -1.0, ..InertialNoise::NONE }),
            noisy(InertialNoise { bias_walk: f64::NAN, ..InertialNoise::NONE }),
            noisy(InertialNoise { initial_bias: f64::INFINITY, ..InertialNoise::NONE }),
            noisy(InertialNoise { gain_error: -1.0, ..InertialNoise::NONE }),
            ImuParams { accelerometer: InertialNoise { density: f64::NAN, ..InertialNoise::NONE }, ..good },
            ImuParams { attitude_sigma: Some(-0.1), ..good },
            ImuParams { base_from_sensor: Se3::from_parts(Vector3::repeat(f64::NAN), So3::default()), ..good },
        ] {
            assert!(Imu::new(bad, Seed(0)).is_err(), "{bad:?}");
        }
        let mut imu = Imu::new(good, Seed(0)).unwrap();
        let before = imu.clone();
        let nan = Vector3::repeat(f64::NAN);
        for (truth, dt) in [
            (at_rest(), 0.0),
            (at_rest(), f64::NAN),
            (InertialTruth { angular_rate: nan, ..at_rest() }, 0.01),
            (InertialTruth { angular_acceleration: nan, ..at_rest() }, 0.01),
            (InertialTruth { acceleration: nan, ..at_rest() }, 0.01),
            (InertialTruth { map_from_body: So3::from_roll_pitch_yaw(f64::NAN, 0.0, 0.0), ..at_rest() }, 0.01),
        ] {
            assert!(imu.sample(&truth, Stamp::default(), dt).is_err(), "{truth:?} {dt}");
        }
        assert_eq!(imu, before);
    }
}
