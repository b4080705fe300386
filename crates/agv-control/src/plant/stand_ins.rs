//! The plants on which tuning is compared.
//!
//! Paper 000 tunes its PID on a plant that it does not state; these stand in for it. Each comes with the step test that
//! makes costs comparable: set-point 1, sampling, horizon, derivative filter, actuator and range of the gains.

use super::{ActuatorLimits, DriveParams, LinearPlant, TransferFunction};
use crate::Error;
use crate::step_response::{StepTest, StepTestParams};

/// A plant that stands in for the one of paper 000.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum StandIn {
    /// Second order, `1.6 / (s² + 1.5 s + 1.6)`, input within ±10: two basins, of which the wide one is a trap.
    P1,
    /// Lateral shift of a differential AGV at 0.5 m/s: yaw-rate actuator of 0.15 s, at most 0.3 rad/s, small angles:
    /// `0.5 / (s² (0.15 s + 1))`.
    P2,
    /// Unstable with slow and fast poles, `(s + 2) / (s⁴ + 8 s³ + 4 s² - s + 0.4)`, no limit.
    P3,
    /// Speed of an AGV of 200 kg whose drive was laid out for it and that carries 600 kg, voltage within ±48: the
    /// linear part of a [`DrivePlant`](super::DrivePlant) with its default parameters.
    Load,
}

impl StandIn {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::P1, Self::P2, Self::P3, Self::Load];

    /// `"p1"`, `"p2"`, `"p3"`, `"load"`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::P1 => "p1",
            Self::P2 => "p2",
            Self::P3 => "p3",
            Self::Load => "load",
        }
    }

    /// The plant at rest.
    ///
    /// # Errors
    /// None with the constants that stand here.
    pub fn plant(self) -> Result<LinearPlant, Error> {
        match self {
            Self::P1 => linear(&[1.6], &[1.0, 1.5, 1.6])?.with_actuator(ActuatorLimits::symmetric(10.0)),
            Self::P2 => linear(&[0.5], &[0.15, 1.0, 0.0, 0.0])?.with_actuator(ActuatorLimits::symmetric(0.3)),
            Self::P3 => linear(&[1.0, 2.0], &[1.0, 8.0, 4.0, -1.0, 0.4]),
            Self::Load => DriveParams::default().linear(600.0),
        }
    }

    /// The step test that defines its cost.
    ///
    /// # Errors
    /// None with the constants that stand here.
    pub fn step_test(self) -> Result<StepTest, Error> {
        let (dt, horizon, filter_time) = match self {
            Self::P1 => (0.01, 10.0, 0.02),
            Self::P2 => (0.02, 20.0, 0.05),
            Self::P3 => (0.01, 20.0, 0.001),
            Self::Load => (0.01, 5.0, 0.02),
        };
        StepTest::new(&self.plant()?, StepTestParams { dt, horizon, filter_time, ..StepTestParams::default() })
    }

    /// Greatest value of each gain in a search; the least is zero.
    pub const fn greatest_gain(self) -> f64 {
        match self {
            Self::P1 => 50.0,
            Self::P2 => 5.0,
            Self::P3 => 300.0,
            Self::Load => 200.0,
        }
    }
}

impl std::str::FromStr for StandIn {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|plant| plant.name() == name).ok_or(Error::NoSuchPlant)
    }
}

fn linear(numerator: &[f64], denominator: &[f64]) -> Result<LinearPlant, Error> {
    LinearPlant::new(TransferFunction::new(numerator, denominator)?)
}
