//! What a landmark filter must be told.

use super::{PARAMETERS, Parameter};
use agv_core::{Error, check, roles::StatusParams};

/// How the sensor measures how far a landmark is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum RangeKind {
    /// The distance from the sensor: lasers, radio, sound.
    #[default]
    Distance,
    /// The depth along the sensor's x axis, handed over as the observation's range, which other users of it take for a distance:
    /// cameras that tell how far a landmark is by its size in the image, since an image
    /// plane shows things as large as their depth makes them.
    Depth,
}

/// At which moment the vehicle is where the estimate says, where the clocks of odometry and landmark sensor differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum EstimateClock {
    /// The odometry's stamps are right and the landmark sensor's late.
    #[default]
    Odometry,
    /// The landmark sensor's stamps are right and the odometry's early: it states commands that are yet to be obeyed.
    Landmarks,
}

/// What is known of a parameter before the first sighting.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Prior {
    /// Best guess, in the parameter's unit.
    pub mean: f64,
    /// Its standard deviation; zero for a parameter that is not to be estimated.
    pub sigma: f64,
}

impl Prior {
    /// A best guess with its standard deviation.
    pub const fn new(mean: f64, sigma: f64) -> Self {
        Self { mean, sigma }
    }

    /// Nothing is known but how large it may be.
    pub const fn within(sigma: f64) -> Self {
        Self::new(0.0, sigma)
    }

    fn validate(&self, name: &'static str, most: f64) -> Result<(), Error> {
        check::in_range(name, self.mean, -most, most)?;
        check::in_range(name, self.sigma, 0.0, most)?;
        Ok(())
    }
}

/// What is known before the first sighting of the parameters that are estimated. What one vehicle of a fleet has learnt is a
/// good prior of the next.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CalibrationPriors {
    /// Of [`Parameter::SpeedScale`], as a fraction.
    pub speed_scale: Prior,
    /// Of [`Parameter::TurnLoss`], in m/rad.
    pub turn_loss: Prior,
    /// Of [`Parameter::YawScale`], as a fraction.
    pub yaw_scale: Prior,
    /// Of [`Parameter::YawBias`], in rad/s.
    pub yaw_bias: Prior,
    /// Of [`Parameter::Latency`], in seconds.
    pub latency: Prior,
    /// Of [`Parameter::RangeScale`], as a fraction.
    pub range_scale: Prior,
    /// Of [`Parameter::RangeBias`], in metres.
    pub range_bias: Prior,
    /// Of [`Parameter::BearingBias`], in radians.
    pub bearing_bias: Prior,
    /// Of [`Parameter::BearingSine`], in radians.
    pub bearing_sine: Prior,
    /// Of [`Parameter::BearingCosine`], in radians.
    pub bearing_cosine: Prior,
}

impl Default for CalibrationPriors {
    /// An uncalibrated vehicle and sensor: a tenth of speed and turns, 0.1 m lost per radian (half the track of a small drive),
    /// 0.01 rad/s, 0.2 s of latency, 5 % and 5 cm of range, 0.03 rad of mount and of sine, 0.1 rad of cosine.
    fn default() -> Self {
        Self {
            speed_scale: Prior::within(0.1),
            turn_loss: Prior::within(0.1),
            yaw_scale: Prior::within(0.1),
            yaw_bias: Prior::within(0.01),
            latency: Prior::within(0.2),
            range_scale: Prior::within(0.05),
            range_bias: Prior::within(0.05),
            bearing_bias: Prior::within(0.03),
            bearing_sine: Prior::within(0.03),
            bearing_cosine: Prior::within(0.1),
        }
    }
}

impl CalibrationPriors {
    /// Odometry and sensor are as they say: the pose alone is estimated.
    pub const KNOWN: Self = Self {
        speed_scale: Prior::within(0.0),
        turn_loss: Prior::within(0.0),
        yaw_scale: Prior::within(0.0),
        yaw_bias: Prior::within(0.0),
        latency: Prior::within(0.0),
        range_scale: Prior::within(0.0),
        range_bias: Prior::within(0.0),
        bearing_bias: Prior::within(0.0),
        bearing_sine: Prior::within(0.0),
        bearing_cosine: Prior::within(0.0),
    };
}

/// How odometry errs beyond what is estimated of it. A vehicle that stands does not drift.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OdometryNoise {
    /// White error of the speed: deviation of the way after a second, in m/√s.
    pub forward_density: f64,
    /// White error of the yaw rate: deviation of the heading after a second, in rad/√s.
    pub yaw_density: f64,
    /// Standard deviation of the speed's wandering error, in m/s.
    pub speed_wander: f64,
    /// Standard deviation of the yaw rate's wandering error, in rad/s.
    pub yaw_rate_wander: f64,
    /// Time in which a wandering error is forgotten, in seconds.
    pub wander_time: f64,
    /// Share of the forward variance that the way to the side has: slip.
    pub sideways_share: f64,
}

impl Default for OdometryNoise {
    /// Small drives without a gyro, whose odometry is what they were commanded: 1 cm and 0.03 rad in a second, and slow
    /// errors of 1 cm/s and 0.02 rad/s that last about a second, as wheel speeds in steps of 8 mm/s leave them (measured on
    /// robot 1 of MRCLAM 6).
    fn default() -> Self {
        Self {
            forward_density: 0.01,
            yaw_density: 0.03,
            speed_wander: 0.01,
            yaw_rate_wander: 0.02,
            wander_time: 1.0,
            sideways_share: 0.1,
        }
    }
}

/// Parameters of a [`LandmarkFilter`](super::LandmarkFilter).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LandmarkFilterParams {
    /// What the sensor's ranges are.
    pub range_kind: RangeKind,
    /// Deviation of a range per metre of it, beside what the sighting states: 0.02 for 2 cm a metre.
    pub range_share: f64,
    /// How the odometry errs.
    pub noise: OdometryNoise,
    /// What is to be calibrated.
    pub priors: CalibrationPriors,
    /// Whose stamps are those of the estimate.
    pub clock: EstimateClock,
    /// Probability that a sound sighting passes the gate, between 0 and 1.
    pub gate_probability: f64,
    /// Sightings of landmarks that they name which contradict the belief one after the other before the belief is doubted instead of
    /// them.
    pub patience: usize,
    /// Longest time from a sighting to its use, latency included, in seconds; 60 at most. Odometry is kept for so long, but no more
    /// than 2048 readings of it.
    pub history: f64,
    /// When the estimate is to be trusted.
    pub status: StatusParams,
}

impl Default for LandmarkFilterParams {
    /// 3 % of range, one sound sighting in a thousand lost at the gate, doubt after three contradictions in a row, and 1.5 s of
    /// history.
    fn default() -> Self {
        Self {
            range_kind: RangeKind::Distance,
            range_share: 0.03,
            noise: OdometryNoise::default(),
            priors: CalibrationPriors::default(),
            clock: EstimateClock::Odometry,
            gate_probability: 0.999,
            patience: 3,
            history: 1.5,
            status: StatusParams::default(),
        }
    }
}

/// Greatest scale, and error of a bearing in radians, that is calibrated on the way.
const MOST_SCALE: f64 = 0.5;

/// Greatest bias, in metres, seconds or radians per second.
const MOST_BIAS: f64 = 10.0;

impl CalibrationPriors {
    /// Refuses numbers that are not finite or absurd, and negative deviations.
    pub(super) fn validate(&self) -> Result<(), Error> {
        self.speed_scale.validate("speed_scale", MOST_SCALE)?;
        self.turn_loss.validate("turn_loss", MOST_BIAS)?;
        self.yaw_scale.validate("yaw_scale", MOST_SCALE)?;
        self.yaw_bias.validate("yaw_bias", MOST_BIAS)?;
        self.latency.validate("latency", MOST_BIAS)?;
        self.range_scale.validate("range_scale", MOST_SCALE)?;
        self.range_bias.validate("range_bias", MOST_BIAS)?;
        self.bearing_bias.validate("bearing_bias", MOST_BIAS)?;
        self.bearing_sine.validate("bearing_sine", MOST_SCALE)?;
        self.bearing_cosine.validate("bearing_cosine", MOST_SCALE)
    }

    /// The prior of each parameter, in the order of [`Parameter::ALL`], that of the wander from `noise`.
    pub(super) fn all(&self, noise: &OdometryNoise) -> [Prior; PARAMETERS] {
        Parameter::ALL.map(|parameter| match parameter {
            Parameter::SpeedScale => self.speed_scale,
            Parameter::TurnLoss => self.turn_loss,
            Parameter::YawScale => self.yaw_scale,
            Parameter::YawBias => self.yaw_bias,
            Parameter::Latency => self.latency,
            Parameter::RangeScale => self.range_scale,
            Parameter::RangeBias => self.range_bias,
            Parameter::BearingBias => self.bearing_bias,
            Parameter::BearingSine => self.bearing_sine,
            Parameter::BearingCosine => self.bearing_cosine,
            Parameter::SpeedError => Prior::within(noise.speed_wander),
            Parameter::YawRateError => Prior::within(noise.yaw_rate_wander),
        })
    }
}

impl OdometryNoise {
    /// Refuses densities that are negative or not finite, and a time that is not positive.
    pub(super) fn validate(&self) -> Result<(), Error> {
        check::non_negative("forward_density", self.forward_density)?;
        check::non_negative("yaw_density", self.yaw_density)?;
        check::non_negative("speed_wander", self.speed_wander)?;
        check::non_negative("yaw_rate_wander", self.yaw_rate_wander)?;
        check::positive("wander_time", self.wander_time)?;
        check::non_negative("sideways_share", self.sideways_share)?;
        Ok(())
    }
}
