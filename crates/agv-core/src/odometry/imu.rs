//! The turn of the base from a gyroscope, and its union with the wheels.
//!
//! The rate between two samples is taken as linear (trapezoid), with the bias subtracted:
//!
//! ```text
//! yaw += ((w0 + w1) / 2 - bias) dt            variance += density² dt + sigma² ((T + dt)² - T²)
//! ```
//!
//! White noise makes the variance grow with time; an unknown but constant bias of deviation `sigma` makes the
//! *deviation* grow with the time `T` since it was set (Woodman 2007, section 3.2). Turns that are taken one after
//! another share this error, so each gets what it adds: their variances sum up to that of the whole, however it is cut.
//! Gyrodometry (Borenstein and Feng 1996) takes the turn from the gyro, which does not slip, and the distance from the
//! wheels, which do not drift.

use super::OdometryIncrement;
use crate::{
    Error, check,
    geometry::{LieGroup, Se2},
    sensors::ImuSample,
    time::Stamp,
};
use nalgebra::Vector3;

/// The turn between two moments.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct YawIncrement {
    /// When it began.
    pub start: Stamp,
    /// When it ended.
    pub end: Stamp,
    /// Turn in radians, not wrapped.
    pub yaw: f64,
    /// Variance that the turn adds to those before it, in rad²: the sum over a drive is the variance of its heading.
    pub variance: f64,
}

/// Integrates yaw rates at irregular times.
///
/// ```
/// use agv_core::odometry::YawIntegrator;
/// use agv_core::time::Stamp;
///
/// let mut gyro = YawIntegrator::new(1e-3)?;
/// gyro.set_bias(0.1, 0.0)?;
/// for i in 0..=10 {
///     gyro.push(Stamp::from_seconds(0.1 * f64::from(i)), 0.6)?;
/// }
/// let turn = gyro.take_until(Stamp::from_seconds(1.0))?.unwrap();
/// assert!((turn.yaw - 0.5).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawIntegrator"))]
pub struct YawIntegrator {
    noise_density: f64,
    bias: f64,
    bias_sigma: f64,
    /// Where the turn that is being gathered began.
    start: Stamp,
    /// Time and rate of the last sample, bias included.
    last: Option<(Stamp, f64)>,
    /// Time integrated with this bias, in seconds.
    bias_age: f64,
    yaw: f64,
    variance: f64,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawIntegrator {
    noise_density: f64,
    bias: f64,
    bias_sigma: f64,
    start: Stamp,
    last: Option<(Stamp, f64)>,
    bias_age: f64,
    yaw: f64,
    variance: f64,
}

#[cfg(feature = "serde")]
impl TryFrom<RawIntegrator> for YawIntegrator {
    type Error = Error;

    fn try_from(raw: RawIntegrator) -> Result<Self, Error> {
        let RawIntegrator { noise_density, bias, bias_sigma, start, last, bias_age, yaw, variance } = raw;
        let mut fresh = Self::new(noise_density)?;
        fresh.set_bias(bias, bias_sigma)?;
        check::non_negative("bias_age", bias_age)?;
        check::finite("yaw", yaw)?;
        check::non_negative("variance", variance)?;
        if let Some((stamp, rate)) = last {
            check::finite("yaw_rate", rate)?;
            check::non_negative("span", stamp - start)?;
        }
        Ok(Self { start, last, bias_age, yaw, variance, ..fresh })
    }
}

impl YawIntegrator {
    /// An integrator for a gyro of this white noise, in rad/s per √Hz; a MEMS gyro has 1e-4 to 1e-3.
    ///
    /// # Errors
    /// [`Error::Negative`].
    pub fn new(noise_density: f64) -> Result<Self, Error> {
        check::non_negative("noise_density", noise_density)?;
        Ok(Self {
            noise_density,
            bias: 0.0,
            bias_sigma: 0.0,
            start: Stamp::default(),
            last: None,
            bias_age: 0.0,
            yaw: 0.0,
            variance: 0.0,
        })
    }

    /// The bias that is subtracted from the last sample on, in radians per second, and its standard deviation.
    ///
    /// A new pair is taken as a new estimate, with an error independent of the last one's; the same pair again changes
    /// nothing. So set it when the vehicle has stood still, not with every sample.
    ///
    /// # Errors
    /// A bias that is not finite, or a negative deviation; both stay as they were then.
    pub fn set_bias(&mut self, bias: f64, sigma: f64) -> Result<(), Error> {
        let (bias, sigma) = (check::finite("bias", bias)?, check::non_negative("bias sigma", sigma)?);
        if (bias, sigma) != (self.bias, self.bias_sigma) {
            (self.bias, self.bias_sigma, self.bias_age) = (bias, sigma, 0.0);
        }
        Ok(())
    }

    /// Bias and its standard deviation, in radians per second.
    pub const fn bias(&self) -> (f64, f64) {
        (self.bias, self.bias_sigma)
    }

    /// Adds a sample, in radians per second. A repeated stamp replaces the rate and adds no turn.
    ///
    /// # Errors
    /// [`Error::NotFinite`], or [`Error::TimeBackwards`]; the sample is then left out.
    pub fn push(&mut self, stamp: Stamp, yaw_rate: f64) -> Result<(), Error> {
        check::finite("yaw_rate", yaw_rate)?;
        self.advance(stamp, yaw_rate)
    }

    /// Adds the rate about the vehicle's z axis of an inertial measurement unit's sample; its covariance is not looked at,
    /// for the integrator's own noise states it.
    ///
    /// # Errors
    /// [`Error::Empty`] for a sample without turn rates, or [`Error::TimeBackwards`]; the sample is then left out.
    pub fn push_sample(&mut self, sample: &ImuSample) -> Result<(), Error> {
        let (rate, _) = sample.yaw_rate().ok_or(Error::Empty { name: "angular velocity" })?;
        self.push(sample.stamp(), rate)
    }

    /// The turn since the last call (or the first sample) up to `end`, with the last rate held after the last sample;
    /// `None` before the first sample. The next turn begins at `end`.
    ///
    /// # Errors
    /// [`Error::TimeBackwards`] if a sample later than `end` was added; nothing is taken then.
    pub fn take_until(&mut self, end: Stamp) -> Result<Option<YawIncrement>, Error> {
        let Some((_, rate)) = self.last else { return Ok(None) };
        self.advance(end, rate)?;
        let turn = YawIncrement { start: self.start, end, yaw: self.yaw, variance: self.variance };
        (self.start, self.yaw, self.variance) = (end, 0.0, 0.0);
        Ok(Some(turn))
    }

    fn advance(&mut self, stamp: Stamp, rate: f64) -> Result<(), Error> {
        match self.last {
            Some((before, _)) if stamp < before => {
                return Err(Error::TimeBackwards { earlier_ns: before.nanoseconds(), later_ns: stamp.nanoseconds() });
            }
            Some((before, last_rate)) => {
                let dt = stamp - before;
                self.yaw += (0.5 * (last_rate + rate) - self.bias) * dt;
                // (T + dt)² - T², the drift's share in the form that does not cancel.
                let drift = self.bias_sigma * self.bias_sigma * dt * (2.0 * self.bias_age + dt);
                self.variance += self.noise_density * self.noise_density * dt + drift;
                self.bias_age += dt;
            }
            None => self.start = stamp,
        }
        self.last = Some((stamp, rate));
        Ok(())
    }
}

/// Distance from the wheels, turn from the gyro.
///
/// The wheels' motion is read as an arc of its length; the arc is bent to the gyro's turn. Its covariance keeps the
/// wheels' translation part, with the gyro's variance for the turn.
///
/// # Errors
/// [`Error::NotFinite`] for a motion that is not, and [`Error::OutOfRange`] if the two spans differ by more than 1 ms at
/// either end ([`YawIntegrator::take_until`] cuts them to measure).
pub fn gyrodometry(wheels: &OdometryIncrement, gyro: &YawIncrement) -> Result<OdometryIncrement, Error> {
    let motion = wheels.start_from_end;
    check::all_finite("odometry motion", &[motion.x(), motion.y(), motion.yaw()])?;
    check::all_finite("odometry covariance", wheels.covariance.as_slice())?;
    check::finite("gyro yaw", gyro.yaw)?;
    check::non_negative("gyro variance", gyro.variance)?;
    check::in_range("gyro start - wheel start", gyro.start - wheels.start, -1e-3, 1e-3)?;
    check::in_range("gyro end - wheel end", gyro.end - wheels.end, -1e-3, 1e-3)?;
    let arc = motion.log();
    // From the frame of the end to the tangent at the start, where the components are independent, and back.
    let to_tangent = Se2::right_jacobian_inverse(&arc);
    let mut spread = to_tangent * wheels.covariance * to_tangent.transpose();
    for i in 0..2 {
        (spread[(i, 2)], spread[(2, i)]) = (0.0, 0.0);
    }
    spread[(2, 2)] = gyro.variance;
    let bent = Vector3::new(arc.x, arc.y, gyro.yaw);
    let jacobian = Se2::right_jacobian(&bent);
    Ok(OdometryIncrement {
        start_from_end: Se2::exp(&bent),
        covariance: jacobian * spread * jacobian.transpose(),
        ..*wheels
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    proptest! {
        /// The trapezoid is exact for rates that are linear in time, at any irregular sampling and however it is cut.
        #[test]
        fn linear_rates_are_integrated_exactly(gaps in prop::collection::vec(1_i64..200_000_000, 2..40), slope in -2.0..2.0_f64) {
            let mut gyro = YawIntegrator::new(0.0).unwrap();
            gyro.set_bias(0.3, 0.0).unwrap();
            let (mut time, mut total) = (0_i64, 0.0);
            gyro.push(Stamp::default(), 0.3).unwrap();
            for (i, gap) in gaps.iter().enumerate() {
                time += gap;
                let stamp = Stamp::from_nanoseconds(time);
                gyro.push(stamp, 0.3 + slope * stamp.seconds()).unwrap();
                if i % 3 == 0 {
                    total += gyro.take_until(stamp).unwrap().unwrap().yaw;
                }
            }
            let end = Stamp::from_nanoseconds(time);
            total += gyro.take_until(end).unwrap().unwrap().yaw;
            prop_assert!((total - 0.5 * slope * end.seconds().powi(2)).abs() < 1e-9);
        }

        /// However the turn is cut, and however often the rate is sampled, the variances sum up to that of the whole.
        #[test]
        fn cutting_changes_no_variance(cuts in prop::collection::vec((1_i64..200_000_000, any::<bool>()), 1..200)) {
            let mut gyro = YawIntegrator::new(1e-3).unwrap();
            gyro.set_bias(0.1, 0.003).unwrap();
            gyro.push(Stamp::default(), 0.2).unwrap();
            let (mut time, mut total) = (0_i64, 0.0);
            for (gap, taken) in cuts {
                time += gap;
                let stamp = Stamp::from_nanoseconds(time);
                gyro.push(stamp, 0.2).unwrap();
                if taken {
                    total += gyro.take_until(stamp).unwrap().unwrap().variance;
                }
            }
            let end = Stamp::from_nanoseconds(time);
            total += gyro.take_until(end).unwrap().unwrap().variance;
            let expected = 1e-6 * end.seconds() + (0.003 * end.seconds()).powi(2);
            prop_assert!((total - expected).abs() < 1e-12 * expected);
        }

        /// Wheels that agree with the gyro are left as they are.
        #[test]
        fn agreement_changes_nothing(x in -1.0..1.0_f64, yaw in -1.0..1.0_f64) {
            let pose = Se2::exp(&Vector3::new(x, 0.0, yaw));
            let wheels = OdometryIncrement { start: at(0.0), end: at(0.1), start_from_end: pose, covariance: Matrix3::zeros() };
            let turn = YawIncrement { start: at(0.0), end: at(0.1), yaw, variance: 1e-6 };
            let joint = gyrodometry(&wheels, &turn).unwrap();
            prop_assert!(joint.start_from_end.minus(&pose).norm() < 1e-12);
            prop_assert!((joint.covariance[(2, 2)] - 1e-6).abs() < 1e-15);
        }
    }

    /// One wheel slips through a quarter circle: the gyro restores the arc.
    #[test]
    fn the_gyro_corrects_a_slipping_wheel() {
        let truth = Se2::exp(&Vector3::new(1.0, 0.0, 1.5));
        let slipped = Se2::exp(&Vector3::new(1.0, 0.0, 1.1));
        let wheels = OdometryIncrement::between(at(0.0), &Se2::default(), at(1.0), &slipped).unwrap();
        let turn = YawIncrement { start: at(0.0), end: at(1.0), yaw: 1.5, variance: 0.0 };
        assert!(gyrodometry(&wheels, &turn).unwrap().start_from_end.minus(&truth).norm() < 1e-12);
    }

    #[test]
    fn the_variance_knows_white_noise_and_bias() {
        let mut gyro = YawIntegrator::new(0.01).unwrap();
        gyro.set_bias(0.0, 0.002).unwrap();
        gyro.push(at(0.0), 0.0).unwrap();
        let turn = gyro.take_until(at(4.0)).unwrap().unwrap();
        assert!((turn.variance - (1e-4 * 4.0 + 0.008 * 0.008)).abs() < 1e-15);
    }

    /// Two estimates of the bias err independently; an estimate that is set again does not.
    #[test]
    fn a_new_bias_has_an_error_of_its_own() {
        let mut gyro = YawIntegrator::new(0.0).unwrap();
        gyro.set_bias(0.0, 0.1).unwrap();
        gyro.push(at(0.0), 0.0).unwrap();
        gyro.push(at(2.0), 0.0).unwrap();
        gyro.set_bias(0.0, 0.1).unwrap();
        gyro.push(at(3.0), 0.0).unwrap();
        gyro.set_bias(0.01, 0.2).unwrap();
        let turn = gyro.take_until(at(4.0)).unwrap().unwrap();
        assert!((turn.variance - (0.3_f64.powi(2) + 0.2_f64.powi(2))).abs() < 1e-15);
    }

    #[test]
    fn bad_samples_are_left_out() {
        let mut gyro = YawIntegrator::new(1e-3).unwrap();
        assert_eq!(gyro.take_until(at(1.0)), Ok(None));
        gyro.push(at(1.0), 0.5).unwrap();
        let before = gyro;
        assert!(gyro.push(at(1.1), f64::NAN).is_err());
        assert_eq!(gyro.push_sample(&ImuSample::new(at(1.1))), Err(Error::Empty { name: "angular velocity" }));
        assert!(matches!(gyro.push(at(0.9), 0.5), Err(Error::TimeBackwards { .. })));
        assert!(gyro.take_until(at(0.9)).is_err());
        assert!(gyro.set_bias(f64::NAN, 0.0).is_err() && gyro.set_bias(0.0, -1.0).is_err());
        assert_eq!(gyro, before);
        assert!(YawIntegrator::new(-1.0).is_err() && YawIntegrator::new(f64::NAN).is_err());
    }

    #[cfg(feature = "serde")]
    #[test]
    fn stored_integrators_are_checked() {
        let mut gyro = YawIntegrator::new(0.25).unwrap();
        gyro.push(Stamp::from_nanoseconds(7), 0.5).unwrap();
        let text = serde_json::to_string(&gyro).unwrap();
        let read = |text: &str| serde_json::from_str::<YawIntegrator>(text);
        assert_eq!(read(&text).unwrap(), gyro);
        for (good, bad) in
            [("0.25", "-0.25"), ("\"start\":7", "\"start\":8"), ("\"variance\":0.0", "\"variance\":-1.0")]
        {
            assert!(text.contains(good) && read(&text.replace(good, bad)).is_err(), "{bad}");
        }
    }

    #[test]
    fn spans_that_do_not_match_are_refused() {
        let wheels = OdometryIncrement::between(at(0.0), &Se2::default(), at(1.0), &Se2::default()).unwrap();
        let turn = YawIncrement { start: at(0.0), end: at(1.0), yaw: 0.0, variance: 0.0 };
        assert!(gyrodometry(&wheels, &YawIncrement { end: at(1.1), ..turn }).is_err());
        assert!(gyrodometry(&wheels, &YawIncrement { start: at(-0.1), ..turn }).is_err());
        assert!(gyrodometry(&wheels, &YawIncrement { yaw: f64::NAN, ..turn }).is_err());
        assert!(gyrodometry(&wheels, &YawIncrement { variance: -1.0, ..turn }).is_err());
        let bad = OdometryIncrement { covariance: Matrix3::repeat(f64::NAN), ..wheels };
        assert!(gyrodometry(&bad, &turn).is_err());
    }
}
