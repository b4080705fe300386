//! Range from the time that light needs, measured on a pulse or on the phase of a modulated beam (paper 000, section
//! 1.1.3; Amann et al. 2001).
//!
//! ```text
//! pulse:  r = c t / 2              sigma = c sigma_t / 2             two surfaces are told apart from c τ / 2 on
//! phase:  r = c φ / (4 π f)        sigma = c sigma_φ / (4 π f)       ranges repeat every c / (2 f)
//! ```
//!
//! Unlike [triangulation](super::Triangulation) the error does not grow with the range, as long as the echo is strong.

use super::RangeReading;
use crate::{Error, check};
use std::f64::consts::TAU;

/// Speed of light in vacuum, in metres per second; air slows it by 0.03 %, which calibration takes along.
const LIGHT: f64 = 299_792_458.0;

/// A pulsed range finder.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PulsedTimeOfFlightParams {
    /// Standard deviation of the measured time, in seconds.
    pub time_sigma: f64,
    /// Length of the pulse, in seconds.
    pub pulse_width: f64,
    /// Pulses per second, in hertz.
    pub pulse_rate: f64,
}

impl Default for PulsedTimeOfFlightParams {
    /// A safety scanner: 67 ps jitter (1 cm), 3 ns pulses, 100 kHz.
    fn default() -> Self {
        Self { time_sigma: 67e-12, pulse_width: 3e-9, pulse_rate: 1e5 }
    }
}

/// Turns flight times into ranges.
///
/// ```
/// use agv_core::sensors::{PulsedTimeOfFlight, PulsedTimeOfFlightParams};
///
/// let lidar = PulsedTimeOfFlight::new(PulsedTimeOfFlightParams::default())?;
/// let reading = lidar.range(66.7128e-9)?;
/// assert!((reading.range - 10.0).abs() < 1e-4 && (reading.sigma - 0.01).abs() < 1e-4);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PulsedTimeOfFlight {
    params: PulsedTimeOfFlightParams,
}

impl PulsedTimeOfFlight {
    /// Checks the parameters once.
    ///
    /// # Errors
    /// [`Error::NotPositive`] names the first field that is not finite and positive.
    pub fn new(params: PulsedTimeOfFlightParams) -> Result<Self, Error> {
        check::positive("time_sigma", params.time_sigma)?;
        check::positive("pulse_width", params.pulse_width)?;
        check::positive("pulse_rate", params.pulse_rate)?;
        Ok(Self { params })
    }

    /// Range for an echo `flight_time` seconds after its pulse.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] outside [0, 1 / `pulse_rate`]: the echo would belong to another pulse.
    pub fn range(&self, flight_time: f64) -> Result<RangeReading, Error> {
        let time = check::in_range("flight_time", flight_time, 0.0, 1.0 / self.params.pulse_rate)?;
        Ok(RangeReading { range: 0.5 * LIGHT * time, sigma: 0.5 * LIGHT * self.params.time_sigma })
    }

    /// Least distance between two surfaces on one beam that give two echoes, in metres.
    pub fn resolution(&self) -> f64 {
        0.5 * LIGHT * self.params.pulse_width
    }

    /// Range from which on an echo meets the next pulse, in metres.
    pub fn ambiguity(&self) -> f64 {
        0.5 * LIGHT / self.params.pulse_rate
    }
}

/// A range finder that modulates its beam.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PhaseShiftParams {
    /// Frequency of the modulation, in hertz.
    pub modulation: f64,
    /// Standard deviation of the measured phase, in radians.
    pub phase_sigma: f64,
}

impl Default for PhaseShiftParams {
    /// 10 MHz, so that ranges are unique to 15 m, and a phase noise of 0.24°: 1 cm.
    fn default() -> Self {
        Self { modulation: 1e7, phase_sigma: 0.0042 }
    }
}

/// Turns phases into ranges.
///
/// ```
/// use agv_core::sensors::{PhaseShift, PhaseShiftParams};
///
/// // A coarse tone says which period of the fine one is meant.
/// let coarse = PhaseShift::new(PhaseShiftParams::default())?;
/// let fine = PhaseShift::new(PhaseShiftParams { modulation: 1e8, ..Default::default() })?;
/// let about = coarse.range(coarse.phase(7.003)?)?;
/// let exactly = fine.range_near(fine.phase(7.0)?, about.range)?;
/// assert!((exactly.range - 7.0).abs() < 1e-9 && exactly.sigma < 0.2 * about.sigma);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhaseShift {
    params: PhaseShiftParams,
}

impl PhaseShift {
    /// Checks the parameters once.
    ///
    /// # Errors
    /// [`Error::NotPositive`] names the first field that is not finite and positive.
    pub fn new(params: PhaseShiftParams) -> Result<Self, Error> {
        check::positive("modulation", params.modulation)?;
        check::positive("phase_sigma", params.phase_sigma)?;
        Ok(Self { params })
    }

    /// Period of the ranges, in metres: a surface at `r` and one at `r + ambiguity` give one phase.
    pub fn ambiguity(&self) -> f64 {
        0.5 * LIGHT / self.params.modulation
    }

    /// Least range for this phase, in radians; the phase is taken modulo a full turn.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn range(&self, phase: f64) -> Result<RangeReading, Error> {
        let turns = check::finite("phase", phase)?.rem_euclid(TAU) / TAU;
        let period = self.ambiguity();
        Ok(RangeReading { range: turns * period, sigma: self.params.phase_sigma / TAU * period })
    }

    /// The range for this phase that is nearest to a coarse measurement, in metres.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for the phase, [`Error::Negative`] for the coarse range.
    pub fn range_near(&self, phase: f64, coarse: f64) -> Result<RangeReading, Error> {
        let least = self.range(phase)?;
        let periods = ((check::non_negative("coarse", coarse)? - least.range) / self.ambiguity()).round().max(0.0);
        Ok(RangeReading { range: least.range + periods * self.ambiguity(), ..least })
    }

    /// Phase of a surface at `range` metres, in [0, 2π).
    ///
    /// # Errors
    /// [`Error::Negative`].
    pub fn phase(&self, range: f64) -> Result<f64, Error> {
        Ok((check::non_negative("range", range)? / self.ambiguity()).fract() * TAU)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Any range comes back through its phase, given a coarse range within half a period.
        #[test]
        fn phases_round_trip(range in 0.0..200.0_f64, miss in -0.45..0.45_f64) {
            let sensor = PhaseShift::new(PhaseShiftParams::default()).unwrap();
            let phase = sensor.phase(range).unwrap();
            let coarse = (range + miss * sensor.ambiguity()).max(0.0);
            prop_assert!((sensor.range_near(phase, coarse).unwrap().range - range).abs() < 1e-9);
            prop_assert!(sensor.range(phase).unwrap().range <= sensor.ambiguity());
        }

        /// The stated sigma is the propagated noise of what is measured.
        #[test]
        fn sigma_is_propagated(range in 0.5..14.0_f64) {
            let phase = PhaseShift::new(PhaseShiftParams::default()).unwrap();
            let shifted = phase.range(phase.phase(range).unwrap() + phase.params.phase_sigma).unwrap();
            prop_assert!((shifted.range - range - shifted.sigma).abs() < 1e-9);
            let pulse = PulsedTimeOfFlight::new(PulsedTimeOfFlightParams::default()).unwrap();
            let later = pulse.range(2.0 * range / LIGHT + pulse.params.time_sigma).unwrap();
            prop_assert!((later.range - range - later.sigma).abs() < 1e-9);
        }
    }

    #[test]
    fn figures_of_a_common_scanner() {
        let pulse = PulsedTimeOfFlight::new(PulsedTimeOfFlightParams::default()).unwrap();
        assert!((pulse.ambiguity() - 1499.0).abs() < 0.1 && (pulse.resolution() - 0.45).abs() < 0.001);
    }

    #[test]
    fn bad_input_is_refused() {
        let pulse = PulsedTimeOfFlight::new(PulsedTimeOfFlightParams::default()).unwrap();
        let phase = PhaseShift::new(PhaseShiftParams::default()).unwrap();
        for bad in [-1e-9, 2e-5, f64::NAN, f64::INFINITY] {
            assert!(pulse.range(bad).is_err(), "{bad}");
        }
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(phase.range(bad).is_err() && phase.range_near(1.0, bad).is_err() && phase.phase(bad).is_err());
        }
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let good = PulsedTimeOfFlightParams::default();
            assert!(PulsedTimeOfFlight::new(PulsedTimeOfFlightParams { time_sigma: bad, ..good }).is_err());
            assert!(PulsedTimeOfFlight::new(PulsedTimeOfFlightParams { pulse_width: bad, ..good }).is_err());
            assert!(PulsedTimeOfFlight::new(PulsedTimeOfFlightParams { pulse_rate: bad, ..good }).is_err());
            assert!(PhaseShift::new(PhaseShiftParams { modulation: bad, ..Default::default() }).is_err());
            assert!(PhaseShift::new(PhaseShiftParams { phase_sigma: bad, ..Default::default() }).is_err());
        }
    }
}
