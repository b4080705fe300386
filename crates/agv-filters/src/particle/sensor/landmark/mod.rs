//! Landmark model: ranges and bearings to reflectors, barcode tubes, pillars whose places are known.
//!
//! With the landmark at range `r` and bearing `β` from the pose, and the reading `(r_z, β_z)` of covariance `R`,
//!
//! ```text
//! d = (r_z - r, wrap(β_z - β))      S = R + diag(σ², σ² / r_z²)
//! p = (1 - o) N(d; 0, S) + o / (range_max 2π)
//! ```
//!
//! (Thrun, Burgard and Fox, *Probabilistic Robotics*, Table 6.4) with `σ` for the landmark's own place and `o` the share of
//! readings that are no landmark at all, which keeps one of them from killing the set. A reading that does not tell which
//! landmark it is belongs to the one that explains it best, from each pose by itself.

use super::{PoseLikelihood, SensorModel, weigh_per_pose};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    roles::SkipReason,
    sensors::LandmarkObservation,
};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::{PI, TAU};
use std::ops::Range;
use std::sync::Arc;

/// Parameters of a [`LandmarkModel`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LandmarkModelParams {
    /// Standard deviation of a landmark's place in the map, along each axis, in metres. It also says how densely the particles
    /// must stand: where readings are more exact than that, few of them find themselves right.
    pub position_sigma: f64,
    /// Share of readings that are no landmark of the map, in (0, 1).
    pub outlier: f64,
    /// Range over which those spread, in metres.
    pub range_max: f64,
}

impl Default for LandmarkModelParams {
    /// 5 cm, which 2000 particles in a metre square resolve; one reading in twenty is false (other reflecting things), within
    /// the 30 m of the usual scanner.
    fn default() -> Self {
        Self { position_sigma: 0.05, outlier: 0.05, range_max: 30.0 }
    }
}

impl LandmarkModelParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// A deviation or range that is not finite and positive, or a share outside (0, 1).
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("position_sigma", self.position_sigma)?;
        check::open_probability("outlier", self.outlier)?;
        check::positive("range_max", self.range_max)?;
        Ok(())
    }
}

/// The landmark model, for one reading or for all of one scan: `LandmarkObservation` and `[LandmarkObservation]`.
///
/// Several landmarks may share a number, as kinds of things do: a reading of that number then belongs to one of them.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainVector};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::sensors::LandmarkObservation;
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{LandmarkModel, LandmarkModelParams, PoseLikelihood, SensorModel};
///
/// let tubes = [(1, Vector2::new(4.0, 0.0)), (2, Vector2::new(4.0, 3.0))];
/// let mut model = LandmarkModel::new(tubes, LandmarkModelParams::default())?;
/// let measured = UncertainVector::from_sigmas(Vector2::new(5.0, 0.6435), &Vector2::new(0.05, 0.01))?;
/// let seen = LandmarkObservation::new(Stamp::default(), Some(2), measured)?;
/// let judged = model.condition(&seen).expect("a landmark of the map");
/// assert!(judged.log_likelihood(&Se2::default()) > judged.log_likelihood(&Se2::new(0.2, 0.0, 0.0)));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct LandmarkModel {
    params: LandmarkModelParams,
    map: Arc<LandmarkMap>,
    readings: Vec<Reading>,
}

/// Landmarks, once by number and once by x.
#[derive(Debug)]
struct LandmarkMap {
    by_id: Vec<(u32, Vector2<f64>)>,
    by_x: Vec<Vector2<f64>>,
}

/// A reading, ready to be compared.
#[derive(Debug, Clone)]
struct Reading {
    base_from_sensor: Se2,
    range: f64,
    /// Unit vector towards the landmark, in the sensor frame.
    direction: Vector2<f64>,
    information: Matrix2<f64>,
    /// Density of false readings over the greatest one of true ones.
    floor: f64,
    /// Landmarks of that number.
    named: Option<Range<usize>>,
    /// Squared distance, in deviations, beyond which the floor is all.
    gate: f64,
    /// In metres, from where the reading puts the landmark: beyond, none is within the gate.
    reach: f64,
}

/// The 99 % quantile of chi-square with two degrees of freedom: what counts as explained.
const EXPLAINED: f64 = 9.210;

impl LandmarkModel {
    /// Most landmarks of a map.
    pub const MAX_LANDMARKS: usize = 1 << 24;

    /// A model of landmarks, by number and place in the map, in metres.
    ///
    /// # Errors
    /// Parameters that [`validate`](LandmarkModelParams::validate) refuses, no landmarks or more than
    /// [`MAX_LANDMARKS`](Self::MAX_LANDMARKS), or a place that is not finite.
    pub fn new(
        landmarks: impl IntoIterator<Item = (u32, Vector2<f64>)>,
        params: LandmarkModelParams,
    ) -> Result<Self, Error> {
        params.validate()?;
        let mut by_id: Vec<_> = landmarks.into_iter().take(Self::MAX_LANDMARKS + 1).collect();
        if by_id.is_empty() {
            return Err(Error::Empty { name: "landmarks" });
        }
        if by_id.len() > Self::MAX_LANDMARKS {
            return Err(Error::TooMany { name: "landmarks", len: by_id.len(), max: Self::MAX_LANDMARKS });
        }
        by_id.iter().try_for_each(|(_, place)| check::all_finite("landmark", place.iter()))?;
        by_id.sort_by_key(|(id, _)| *id);
        let mut by_x: Vec<_> = by_id.iter().map(|(_, place)| *place).collect();
        by_x.sort_by(|a, b| a.x.total_cmp(&b.x));
        Ok(Self { params, map: Arc::new(LandmarkMap { by_id, by_x }), readings: Vec::with_capacity(64) })
    }

    /// The parameters.
    pub const fn params(&self) -> &LandmarkModelParams {
        &self.params
    }

    /// Takes over the readings that can be compared.
    fn collect(&mut self, observations: &[LandmarkObservation]) -> Result<(), SkipReason> {
        self.readings.clear();
        let (map, params) = (&*self.map, &self.params);
        self.readings.extend(observations.iter().filter_map(|seen| Reading::new(seen, map, params)));
        if self.readings.is_empty() { Err(SkipReason::TooFewReadings { usable: 0, needed: 1 }) } else { Ok(()) }
    }
}

impl Reading {
    /// None for a landmark whose number is not in the map.
    fn new(seen: &LandmarkObservation, map: &LandmarkMap, params: &LandmarkModelParams) -> Option<Self> {
        let named = match seen.id() {
            None => None,
            Some(id) => {
                let first = map.by_id.partition_point(|(other, _)| *other < id);
                let last = map.by_id.partition_point(|(other, _)| *other <= id);
                Some(first..last).filter(|range| !range.is_empty()).map(Some)?
            }
        };
        let (range, variance) = (seen.range(), params.position_sigma * params.position_sigma);
        let across = variance / (range * range).max(variance);
        let spread = seen.range_bearing().covariance() + Matrix2::from_diagonal(&Vector2::new(variance, across));
        let determinant = spread.m11 * spread.m22 - spread.m12 * spread.m21;
        let information = Matrix2::new(spread.m22, -spread.m12, -spread.m21, spread.m11) / determinant;
        if !information.iter().all(|v| v.is_finite()) {
            return None;
        }
        // A reading that says less than a false one would, as a range known to a kilometre, has no greater density.
        let ratio = (TAU * determinant.sqrt() / (params.range_max * TAU)).min(1.0);
        let floor = params.outlier / (1.0 - params.outlier) * ratio;
        // Where the density is a hundredth of the floor.
        let gate = (-2.0 * (0.01 * floor).ln()).max(0.0);
        let (off, turn) = ((gate * spread.m11).sqrt(), (gate * spread.m22).sqrt().min(PI));
        let (sin, cos) = seen.bearing().sin_cos();
        Some(Self {
            base_from_sensor: seen.base_from_sensor(),
            range,
            direction: Vector2::new(cos, sin),
            information,
            floor,
            named,
            gate,
            reach: off + (range + off) * turn,
        })
    }

    /// Squared distance of a landmark from the reading, in deviations.
    #[inline]
    fn squared(&self, map_from_sensor: &Se2, landmark: &Vector2<f64>) -> f64 {
        let towards = map_from_sensor.rotation().inverse().act(&(landmark - map_from_sensor.translation()));
        let u = self.direction;
        // The angle from the reading to the landmark, wrapped by its nature.
        let turn = (u.x * towards.y - u.y * towards.x).atan2(u.dot(&towards));
        let off = Vector2::new(self.range - towards.norm(), -turn);
        off.dot(&(self.information * off))
    }

    /// Squared distance of the landmark that explains the reading best; infinite if all are beyond the gate.
    fn best(&self, map: &LandmarkMap, map_from_base: &Se2) -> f64 {
        let map_from_sensor = map_from_base.compose(&self.base_from_sensor);
        let squared = |place: &Vector2<f64>| self.squared(&map_from_sensor, place);
        if let Some(named) = &self.named {
            return map.by_id[named.clone()].iter().map(|(_, place)| squared(place)).fold(f64::INFINITY, f64::min);
        }
        let at = map_from_sensor.act(&(self.direction * self.range));
        let first = map.by_x.partition_point(|place| place.x < at.x - self.reach);
        let near = map.by_x[first..].iter().take_while(|place| place.x <= at.x + self.reach);
        let near = near.filter(|place| (place.y - at.y).abs() <= self.reach);
        near.map(squared).filter(|&squared| squared <= self.gate).fold(f64::INFINITY, f64::min)
    }
}

/// Readings, ready to judge poses.
struct ReadingsInMap<'a> {
    map: &'a LandmarkMap,
    readings: &'a [Reading],
}

impl PoseLikelihood for ReadingsInMap<'_> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        // In terms of the density of a reading that fits exactly. Of an absurd pose the comparison leaves the floor.
        let term = |reading: &Reading| {
            let hit = (-0.5 * reading.best(self.map, map_from_base)).exp();
            (if hit > 0.0 { hit + reading.floor } else { reading.floor }).ln()
        };
        self.readings.iter().map(term).sum()
    }

    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        let explained = self.readings.iter().filter(|reading| reading.best(self.map, map_from_base) <= EXPLAINED);
        Some(explained.count() as f64 / self.readings.len() as f64)
    }
}

impl SensorModel<[LandmarkObservation]> for LandmarkModel {
    fn condition<'a>(
        &'a mut self,
        observations: &'a [LandmarkObservation],
    ) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        self.collect(observations)?;
        Ok(ReadingsInMap { map: &self.map, readings: &self.readings })
    }

    /// Those of the last observation.
    fn independent_readings(&self) -> f64 {
        self.readings.len().max(1) as f64
    }
}

impl SensorModel<LandmarkObservation> for LandmarkModel {
    fn condition<'a>(
        &'a mut self,
        observation: &'a LandmarkObservation,
    ) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        self.collect(std::slice::from_ref(observation))?;
        Ok(ReadingsInMap { map: &self.map, readings: &self.readings })
    }

    /// Those of the last observation.
    fn independent_readings(&self) -> f64 {
        self.readings.len().max(1) as f64
    }
}

weigh_per_pose!(LandmarkModel: [LandmarkObservation]);
weigh_per_pose!(LandmarkModel: LandmarkObservation);

#[cfg(test)]
mod tests;
