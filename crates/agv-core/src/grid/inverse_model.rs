//! What a beam says of the cells it crosses: the inverse sensor model.
//!
//! Occupancy grids add log-odds (paper 003, Eqs. 4-11; Thrun, Burgard and Fox, *Probabilistic Robotics*, Table 9.2):
//!
//! ```text
//! S+ = S- + log( p(z | s = 1) / p(z | s = 0) ),    S = log( p / (1 - p) ),    S = 0 before the first scan
//! ```
//!
//! The inverse model gives the increment: `log(p_miss / (1 - p_miss)) < 0` for cells before the end of a beam, and
//! `log(p_hit / (1 - p_hit)) > 0` for the cell of its end. Increments are integers, multiples of [`QUANTUM`], so that
//! adding them in any order gives the same bits.

use crate::{Error, check, sensors::Beam};

/// Log-odds of one unit of evidence: 2⁻⁸, about 0.1 percent of probability at p = 0.5.
///
/// An `i32` then holds 8.4 million nats: the default model's free evidence of all 1081 beams of a scan reaches that in
/// the sensor's own cell after 38,000 scans from one place, and then the grid says so. An `i16` holds 128 nats, which
/// is far beyond the greatest clamp (13.8 nats at p = 1e-6).
pub const QUANTUM: f64 = 1.0 / 256.0;

/// Nearest to certainty that a probability of a grid may come; its distance from 0 and from 1.
pub(crate) const MIN_PROBABILITY: f64 = 1e-6;

/// Log-odds of a probability.
#[inline]
pub(crate) fn log_odds(probability: f64) -> f64 {
    (probability / (1.0 - probability)).ln()
}

/// Probability of log-odds.
#[inline]
pub(crate) fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

/// Log-odds in units of [`QUANTUM`], rounded to the nearest.
#[inline]
pub(crate) fn quantize(log_odds: f64) -> i32 {
    (log_odds / QUANTUM).round() as i32
}

/// What a beam without a return says.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum NoReturn {
    /// Nothing: black, shiny and transparent surfaces do not answer either.
    #[default]
    Ignore,
    /// The beam is free up to this distance in metres (at most the scanner's `range_max`).
    FreeUpTo(f64),
}

/// Parameters of [`InverseModel`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct InverseModelParams {
    /// Probability that the cell of a beam's end is occupied, in [0.501, 1 - 1e-6].
    pub p_hit: f64,
    /// Probability that a cell before a beam's end is occupied, in [1e-6, 0.499].
    pub p_miss: f64,
    /// Greatest range that is used, in metres: a longer beam is free up to there, and its end is not inserted.
    pub max_range: Option<f64>,
    /// Range at which a hit weighs half, in metres: its evidence is divided by `1 + (r / half_range)²`, as the error
    /// of the range or the spot of the beam grows.
    pub half_range: Option<f64>,
    /// What a beam without a return says.
    pub no_return: NoReturn,
    /// Whether a cell that one beam hits is kept from being freed by the other beams of the same scan, so that flat
    /// incidence does not wash walls out (as Cartographer inserts).
    pub protect_hits: bool,
}

impl Default for InverseModelParams {
    /// 0.8 and 0.45, every range, hits protected.
    ///
    /// Evidence is not clamped while it adds up, so the two say what share of the beams that reach a cell must end
    /// there for it to be a wall: with log-odds of 1.386 and -0.201, about one of eight. Noise and flat incidence let
    /// most beams at a wall's face end a little deeper; with `OctoMap`'s 0.7 and 0.4 (Hornung et al., Autonomous Robots
    /// 2013), one of three, they carve the face away.
    fn default() -> Self {
        Self {
            p_hit: 0.8,
            p_miss: 0.45,
            max_range: None,
            half_range: None,
            no_return: NoReturn::default(),
            protect_hits: true,
        }
    }
}

/// A beam as the inverse model reads it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeamEvidence {
    /// Cells before this distance are free, in metres.
    pub free_until: f64,
    /// Evidence for the cell at that distance, in units of [`QUANTUM`]; zero if nothing is claimed there.
    pub hit: i32,
}

/// Inverse model of a range finder.
///
/// ```
/// use agv_core::grid::{BeamEvidence, InverseModel, InverseModelParams};
/// use agv_core::sensors::Beam;
///
/// let model = InverseModel::new(InverseModelParams { max_range: Some(10.0), ..Default::default() })?;
/// // log(0.8 / 0.2) = 1.386 = 355 / 256
/// assert_eq!(model.read(Beam::Hit(4.0), 30.0), Some(BeamEvidence { free_until: 4.0, hit: 355 }));
/// assert_eq!(model.read(Beam::Hit(12.0), 30.0), Some(BeamEvidence { free_until: 10.0, hit: 0 }));
/// assert_eq!(model.read(Beam::NoReturn, 30.0), None);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseModel {
    params: InverseModelParams,
    hit: i32,
    free: i32,
    max_range: f64,
    inverse_half_range: f64,
}

impl InverseModel {
    /// Checks the parameters and rounds the increments to [`QUANTUM`].
    ///
    /// # Errors
    /// The first parameter out of the range that its field states.
    pub fn new(params: InverseModelParams) -> Result<Self, Error> {
        check::in_range("p_hit", params.p_hit, 0.501, 1.0 - MIN_PROBABILITY)?;
        check::in_range("p_miss", params.p_miss, MIN_PROBABILITY, 0.499)?;
        let max_range = params.max_range.map_or(Ok(f64::INFINITY), |r| check::positive("max_range", r))?;
        let half_range = params.half_range.map_or(Ok(f64::INFINITY), |r| check::positive("half_range", r))?;
        if let NoReturn::FreeUpTo(limit) = params.no_return {
            check::positive("no_return (free up to)", limit)?;
        }
        Ok(Self {
            params,
            hit: quantize(log_odds(params.p_hit)),
            free: quantize(log_odds(params.p_miss)),
            max_range,
            inverse_half_range: 1.0 / half_range,
        })
    }

    /// The parameters that were given.
    pub const fn params(&self) -> &InverseModelParams {
        &self.params
    }

    /// Evidence for a cell before the end of a beam, in units of [`QUANTUM`]; negative.
    pub const fn free(&self) -> i32 {
        self.free
    }

    /// Greatest evidence for the cell of a beam's end, in units of [`QUANTUM`]; positive.
    pub const fn hit(&self) -> i32 {
        self.hit
    }

    /// Greatest distance in metres up to which a scanner of range `range_max` says anything.
    pub(crate) const fn reach(&self, range_max: f64) -> f64 {
        range_max.min(self.max_range)
    }

    /// What the beam of a scanner of range `range_max` (in metres) says; none if nothing.
    #[inline]
    pub fn read(&self, beam: Beam, range_max: f64) -> Option<BeamEvidence> {
        match beam {
            Beam::Hit(range) if range <= self.max_range => {
                let ratio = range * self.inverse_half_range;
                let hit =
                    if ratio > 0.0 { (f64::from(self.hit) / (1.0 + ratio * ratio)).round() as i32 } else { self.hit };
                Some(BeamEvidence { free_until: range, hit })
            }
            Beam::Hit(_) => Some(BeamEvidence { free_until: self.max_range, hit: 0 }),
            Beam::NoReturn => match self.params.no_return {
                NoReturn::Ignore => None,
                NoReturn::FreeUpTo(limit) => {
                    Some(BeamEvidence { free_until: limit.min(self.reach(range_max)), hit: 0 })
                }
            },
            Beam::Invalid => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = InverseModelParams::default();
        let nan = f64::NAN;
        for (name, bad) in [
            ("p_hit", InverseModelParams { p_hit: 0.5, ..good }),
            ("p_hit", InverseModelParams { p_hit: 1.0, ..good }),
            ("p_hit", InverseModelParams { p_hit: nan, ..good }),
            ("p_miss", InverseModelParams { p_miss: 0.5, ..good }),
            ("p_miss", InverseModelParams { p_miss: 0.0, ..good }),
            ("max_range", InverseModelParams { max_range: Some(0.0), ..good }),
            ("max_range", InverseModelParams { max_range: Some(nan), ..good }),
            ("half_range", InverseModelParams { half_range: Some(-1.0), ..good }),
            ("no_return", InverseModelParams { no_return: NoReturn::FreeUpTo(f64::INFINITY), ..good }),
        ] {
            let error = InverseModel::new(bad).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
    }

    #[test]
    fn no_return_frees_up_to_the_least_limit() {
        let params = InverseModelParams { no_return: NoReturn::FreeUpTo(8.0), ..Default::default() };
        let model = InverseModel::new(params).unwrap();
        assert_eq!(model.read(Beam::NoReturn, 30.0), Some(BeamEvidence { free_until: 8.0, hit: 0 }));
        assert_eq!(model.read(Beam::NoReturn, 5.0), Some(BeamEvidence { free_until: 5.0, hit: 0 }));
        assert_eq!(model.read(Beam::Invalid, 30.0), None);
    }

    #[test]
    fn a_hit_at_half_range_weighs_half() {
        let model = InverseModel::new(InverseModelParams { half_range: Some(6.0), ..Default::default() }).unwrap();
        let at = |range: f64| f64::from(model.read(Beam::Hit(range), 30.0).unwrap().hit);
        assert!((at(6.0) - 0.5 * at(1e-6)).abs() <= 0.5);
        assert!(at(30.0) < at(20.0));
    }

    #[test]
    fn quantized_probabilities_are_near_the_given_ones() {
        let model = InverseModel::new(InverseModelParams::default()).unwrap();
        assert!((probability(f64::from(model.hit()) * QUANTUM) - 0.8).abs() < 1e-3);
        assert!((probability(f64::from(model.free()) * QUANTUM) - 0.45).abs() < 1e-3);
    }
}
