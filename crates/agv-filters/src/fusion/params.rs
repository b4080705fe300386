//! What is set once: how the vehicle moves, what is calibrated on the way, and how far back the filter remembers.

use super::state::MOST_LATENCY;
use agv_core::{Error, check, roles::StatusParams};

/// A quantity that wanders around zero.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Wander {
    /// Standard deviation of its value, in its unit: how great it usually is.
    pub sigma: f64,
    /// Time for which it holds its value, in seconds; with `sigma` it says how fast it changes: by `σ √(2 dt / T)` within a
    /// short `dt`.
    pub time: f64,
}

impl Wander {
    /// A quantity of this deviation and time.
    pub const fn new(sigma: f64, time: f64) -> Self {
        Self { sigma, time }
    }

    fn validate(&self, name: &'static str) -> Result<(), Error> {
        check::in_range(name, self.sigma, 0.0, LARGEST)?;
        check::in_range(name, self.time, 1e-3, LARGEST)?;
        Ok(())
    }
}

/// Beyond, deviations and times have no meaning.
const LARGEST: f64 = 1e6;

/// How the vehicle moves while nothing is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionParams {
    /// Forward velocity, in m/s.
    pub vx: Wander,
    /// Sideways velocity, in m/s: of a vehicle that cannot drive sideways, how it slips.
    pub vy: Wander,
    /// Turn rate, in rad/s.
    pub yaw_rate: Wander,
    /// Acceleration along both axes, in m/s², where it is to be estimated; what `vx` and `vy` say of changes is then what it
    /// leaves unexplained. Unmeasured for long, the variance of a velocity is then `σ² + σ_a² T² T_a / (T + T_a)`.
    pub acceleration: Option<Wander>,
}

impl MotionParams {
    /// A vehicle that cannot drive sideways: up to about 1 m/s and 0.6 rad/s, which it changes by about 0.5 m/s and 0.5 rad/s
    /// within a second; 2 cm/s of slip.
    pub const fn differential() -> Self {
        Self {
            vx: Wander::new(1.0, 8.0),
            vy: Wander::new(0.02, 1.0),
            yaw_rate: Wander::new(0.6, 3.0),
            acceleration: None,
        }
    }

    /// A vehicle that drives sideways as it drives ahead.
    pub const fn omnidirectional() -> Self {
        Self { vy: Wander::new(1.0, 8.0), ..Self::differential() }
    }
}

/// Parameters of a [`FusionFilter`](super::FusionFilter).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FusionParams {
    /// How the vehicle moves.
    pub motion: MotionParams,
    /// Standard deviation of the gyro's bias at the beginning, in rad/s; zero for a gyro that has none.
    pub gyro_bias_sigma: f64,
    /// Density of the bias's walk, in rad/s per √s.
    pub gyro_bias_walk: f64,
    /// Standard deviation at the beginning of the share by which ways are longer than the wheels say; zero for wheels that are
    /// known to be right.
    pub distance_scale_sigma: f64,
    /// Variance that this share gains per metre.
    pub distance_scale_walk: f64,
    /// Standard deviation at the beginning of the share by which turns are greater than the wheels say.
    pub yaw_scale_sigma: f64,
    /// Variance that this share gains per radian.
    pub yaw_scale_walk: f64,
    /// Standard deviation of what the measurements of the source that is [`late`](super::SourceParams::late) are older than its
    /// latency says, in seconds; zero for a latency that is known.
    pub latency_sigma: f64,
    /// How long measurements are kept, in seconds: later ones are not taken in any more.
    pub history: f64,
    /// How many measurements are kept at most; each takes some 5 kB.
    pub capacity: usize,
    /// A measurement that claims to be so many seconds ahead of all others is taken for a mistaken clock.
    pub longest_gap: f64,
    /// So many measurements in a row from outside of the history and the gap are taken for a clock that was set anew: after one that
    /// was set back the vehicle is where it was, a jump ahead counts as time that has passed. What a source sends late, but newer
    /// than anything it sent before, does not count.
    pub clock_patience: u32,
    /// When the estimate is to be trusted.
    pub status: StatusParams,
}

impl Default for FusionParams {
    /// A differential drive with a consumer gyro (0.3 °/s of bias that wanders by 0.03 °/s in a quarter of an hour) and wheels
    /// that are right; one second of history at up to 500 measurements a second.
    fn default() -> Self {
        Self {
            motion: MotionParams::differential(),
            gyro_bias_sigma: 5e-3,
            gyro_bias_walk: 2e-5,
            distance_scale_sigma: 0.0,
            distance_scale_walk: 0.0,
            yaw_scale_sigma: 0.0,
            yaw_scale_walk: 0.0,
            latency_sigma: 0.0,
            history: 1.0,
            capacity: 500,
            longest_gap: 30.0,
            clock_patience: 10,
            status: StatusParams::default(),
        }
    }
}

impl FusionParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        self.motion.vx.validate("vx")?;
        self.motion.vy.validate("vy")?;
        self.motion.yaw_rate.validate("yaw_rate")?;
        if let Some(acceleration) = &self.motion.acceleration {
            acceleration.validate("acceleration")?;
        }
        check::in_range("gyro_bias_sigma", self.gyro_bias_sigma, 0.0, LARGEST)?;
        check::in_range("gyro_bias_walk", self.gyro_bias_walk, 0.0, LARGEST)?;
        check::in_range("distance_scale_sigma", self.distance_scale_sigma, 0.0, 0.5)?;
        check::in_range("distance_scale_walk", self.distance_scale_walk, 0.0, 1.0)?;
        check::in_range("yaw_scale_sigma", self.yaw_scale_sigma, 0.0, 0.5)?;
        check::in_range("yaw_scale_walk", self.yaw_scale_walk, 0.0, 1.0)?;
        check::in_range("latency_sigma", self.latency_sigma, 0.0, MOST_LATENCY)?;
        check::in_range("history", self.history, 0.0, LARGEST)?;
        check::in_range("capacity", self.capacity as f64, 2.0, 1e6)?;
        check::positive("longest_gap", self.longest_gap)?;
        check::in_range("clock_patience", f64::from(self.clock_patience), 1.0, f64::from(u32::MAX))?;
        self.status.validate()
    }
}
