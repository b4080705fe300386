//! Beam model of a planar scanner: what each beam should measure is found by casting it into the map (Thrun, Burgard and Fox,
//! *Probabilistic Robotics*, section 6.3).
//!
//! A beam hits what the map shows, or something unmapped before it, or does not come back, or measures anything: the
//! densities are in [`BeamModelParams`]' fields. Unlike the likelihood field the model knows that beams do not pass through
//! walls, and learns from beams that do not come back; it costs a ray per beam and particle, and changes abruptly with the
//! pose. How beams go together is a matter of [`ScanForm`], as there.

mod fit;
mod mixture;
mod params;
#[cfg(test)]
mod tests;

use super::{PoseLikelihood, ScanForm, SensorModel, UsedBeams, beams::evenly_spread, weigh_per_pose};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2},
    grid::{CellState, Grid, RayCastParams, RayCaster, UnknownSpace},
    roles::SkipReason,
    sensors::{Beam, LaserScan},
};
use mixture::{Expected, Mixture};
use nalgebra::Vector2;
use std::sync::Arc;

pub use fit::{BeamFit, BeamSample};
pub use params::BeamModelParams;

/// The beam model of planar scans.
///
/// Cheap to clone: the map's tables are shared.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout};
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{BeamModel, BeamModelParams, PoseLikelihood, SensorModel};
///
/// // A wall 2 m ahead of the origin.
/// let mut map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::new(0.0, -1.5, 0.0))?, CellState::Free);
/// (0..60).for_each(|y| { map.set(Cell::new(40, y), CellState::Occupied); });
/// let mut model = BeamModel::new(&map, BeamModelParams::default())?;
///
/// let geometry = ScanGeometry { angle_min: -0.05, angle_increment: 0.01, ..Default::default() };
/// let scan = LaserScan::new(Stamp::default(), geometry, vec![2.0; 11])?;
/// let likelihood = model.condition(&scan).expect("eleven beams hit");
/// let (near, off) = (Se2::new(0.02, 0.0, 0.0), Se2::new(0.4, 0.0, 0.0));
/// assert!(likelihood.log_likelihood(&near) > likelihood.log_likelihood(&off));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct BeamModel {
    params: BeamModelParams,
    map: Arc<BeamMap>,
    beams: Vec<UsedBeam>,
}

/// The map, ready for rays.
#[derive(Debug)]
struct BeamMap {
    caster: RayCaster,
    /// Where unobserved space says nothing: which cells it is.
    unknown: Option<Grid<bool>>,
}

/// A beam that is used.
#[derive(Debug, Clone, Copy)]
struct UsedBeam {
    /// Unit vector of the sensor frame.
    direction: Vector2<f64>,
    /// None if there was no return.
    reading: Option<f64>,
}

impl BeamModel {
    /// A model in a map.
    ///
    /// # Errors
    /// Parameters that [`validate`](BeamModelParams::validate) refuses, or a map that is too long for the [`RayCaster`].
    pub fn new(map: &Grid<CellState>, params: BeamModelParams) -> Result<Self, Error> {
        params.validate()?;
        let caster = RayCaster::new(map, RayCastParams { unknown_is_obstacle: params.unknown != UnknownSpace::Free })?;
        let unknown = (params.unknown == UnknownSpace::Uniform).then(|| map.map(|state| *state == CellState::Unknown));
        let map = Arc::new(BeamMap { caster, unknown });
        Ok(Self { params, map, beams: Vec::with_capacity(params.max_beams.min(1 << 12)) })
    }

    /// The parameters.
    pub const fn params(&self) -> &BeamModelParams {
        &self.params
    }

    fn mixture(&self, scan: &LaserScan) -> Mixture {
        Mixture::new(&self.params, self.params.max_range.min(scan.geometry().range_max))
    }

    /// Collects the beams that are used; returns the number of hits among them.
    fn collect(&mut self, scan: &LaserScan, most: usize, range: f64) -> usize {
        self.beams.clear();
        for index in evenly_spread(scan.len(), most) {
            let reading = match scan.interpret(scan.ranges()[index]) {
                Beam::Invalid => continue,
                Beam::NoReturn => None,
                Beam::Hit(measured) => Some(measured).filter(|measured| *measured < range),
            };
            let (sin, cos) = scan.geometry().angle(index).sin_cos();
            self.beams.push(UsedBeam { direction: Vector2::new(cos, sin), reading });
        }
        self.beams.iter().filter(|beam| beam.reading.is_some()).count()
    }

    /// What each beam of a scan measured at a pose that is known, beside what the map shows: for [`BeamFit`]. Appended to
    /// `samples`. Beams that run into unobserved space are left out where that says nothing.
    pub fn samples_into(&mut self, scan: &LaserScan, map_from_base: &Se2, samples: &mut Vec<BeamSample>) {
        let mixture = self.mixture(scan);
        self.collect(scan, scan.len(), mixture.range);
        let judge = ScanInMap::new(self, scan, mixture);
        judge.for_each_beam(map_from_base, |beam, expected| match expected {
            Expected::Surface(range) => {
                samples.push(BeamSample { measured: beam.reading, expected: Some(range) });
            }
            Expected::Nothing => samples.push(BeamSample { measured: beam.reading, expected: None }),
            Expected::Unknown(_) => {}
        });
    }
}

/// A scan, ready to judge poses.
struct ScanInMap<'a> {
    model: &'a BeamModel,
    base_from_sensor: Se2,
    mixture: Mixture,
    /// What the sum of a product's logarithms is multiplied by.
    power: f64,
}

impl<'a> ScanInMap<'a> {
    fn new(model: &'a BeamModel, scan: &LaserScan, mixture: Mixture) -> Self {
        let power = model.params.form.power(model.beams.len());
        Self { model, base_from_sensor: scan.geometry().base_from_sensor, mixture, power }
    }

    fn for_each_beam(&self, map_from_base: &Se2, mut body: impl FnMut(&UsedBeam, Expected)) {
        let BeamMap { caster, unknown } = &*self.model.map;
        let cast = caster.from_pose(&map_from_base.compose(&self.base_from_sensor), self.mixture.reach());
        for beam in &self.model.beams {
            let expected = match cast(&beam.direction) {
                None => Expected::Nothing,
                Some(hit) if unknown.as_ref().is_some_and(|unknown| unknown.get(hit.cell) == Some(&true)) => {
                    Expected::Unknown(hit.range)
                }
                Some(hit) => Expected::Surface(hit.range),
            };
            body(beam, expected);
        }
    }
}

impl PoseLikelihood for ScanInMap<'_> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        let mut sum = 0.0;
        if matches!(self.model.params.form, ScanForm::SumOfCubes) {
            self.for_each_beam(map_from_base, |beam, expected| {
                sum += self.mixture.likelihood(beam.reading, expected).powi(3);
            });
            sum.ln_1p()
        } else {
            self.for_each_beam(map_from_base, |beam, expected| {
                sum += self.mixture.likelihood(beam.reading, expected).ln();
            });
            self.power * sum
        }
    }

    /// The share of the hits.
    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        let (mut hits, mut explained) = (0.0, 0.0);
        self.for_each_beam(map_from_base, |beam, expected| {
            let Some(z) = beam.reading else { return };
            hits += 1.0;
            let within = self.model.params.explained_within;
            explained += match expected {
                Expected::Surface(range) if (z - range).abs() <= within => 1.0,
                Expected::Unknown(range) if z >= range - within => 1.0,
                _ => 0.0,
            };
        });
        (hits > 0.0).then_some(explained / hits)
    }
}

impl SensorModel<LaserScan> for BeamModel {
    fn condition<'a>(&'a mut self, scan: &'a LaserScan) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        let (mixture, needed) = (self.mixture(scan), self.params.min_hits.max(1));
        let usable = self.collect(scan, self.params.max_beams, mixture.range);
        if usable < needed {
            return Err(SkipReason::TooFewReadings { usable, needed });
        }
        Ok(ScanInMap::new(self, scan, mixture))
    }

    fn independent_readings(&self) -> f64 {
        self.params.form.independent_readings(self.beams.len())
    }
}

weigh_per_pose!(BeamModel: LaserScan);

impl UsedBeams for BeamModel {
    fn max_beams(&self) -> usize {
        self.params.max_beams
    }

    fn max_range(&self) -> f64 {
        self.params.max_range
    }
}
