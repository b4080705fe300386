//! Likelihood-field model of a planar scanner: a beam's end point is looked up in the map's
//! [`LikelihoodField`], whatever lies between (Thrun, Burgard and Fox, *Probabilistic Robotics*, Table 6.3).
//!
//! How the beams `p_1 … p_n` of a scan go together is a matter of [`ScanForm`]:
//!
//! ```text
//! product:       log w = min(1, k / n) Σ ln p_i          sum of cubes:  log w = ln(1 + Σ p_i³)
//! ```
//!
//! with `k` the number of independent beams that a scan counts as. The beam end points are brought to the base frame, in
//! cells, once per scan.

mod beams;
mod kernel;
mod params;
mod refine;
mod table;
#[cfg(test)]
mod tests;

use super::{PoseLikelihood, ScanForm, SensorModel, UsedBeams, weigh_per_pose};
use agv_core::{
    Error,
    geometry::{Se2, UncertainPose},
    grid::LikelihoodField,
    roles::SkipReason,
    sensors::LaserScan,
};
use beams::Beams;
use kernel::{COORDINATE_BITS, EndPoints, ScanOnTable};
use pulp::Arch;
use refine::Refiner;
use std::sync::Arc;
use table::Table;

pub use params::LikelihoodFieldModelParams;

/// The likelihood-field model of planar scans.
///
/// Cheap to clone: the table is shared, so that several filters can use one map.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams};
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{LikelihoodFieldModel, LikelihoodFieldModelParams, PoseLikelihood, SensorModel};
///
/// // A wall 2 m ahead of the origin.
/// let mut map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::new(0.0, -1.5, 0.0))?, CellState::Free);
/// (0..60).for_each(|y| { map.set(Cell::new(40, y), CellState::Occupied); });
/// let field = LikelihoodField::new(&map, LikelihoodFieldParams::default())?;
/// let mut model = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
///
/// let geometry = ScanGeometry { angle_min: -0.05, angle_increment: 0.01, ..Default::default() };
/// let scan = LaserScan::new(Stamp::default(), geometry, vec![2.0; 11])?;
/// let likelihood = model.condition(&scan).expect("eleven beams hit");
/// let (near, off) = (Se2::new(0.02, 0.0, 0.0), Se2::new(0.4, 0.0, 0.0));
/// assert!(likelihood.log_likelihood(&near) > likelihood.log_likelihood(&off));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct LikelihoodFieldModel {
    params: LikelihoodFieldModelParams,
    table: Arc<Table>,
    beams: Beams,
    arch: Arch,
}

impl LikelihoodFieldModel {
    /// Most cells along a side: a coordinate, those of the border included, is a number of 15 bits.
    pub const MAX_SIDE: usize = (1 << COORDINATE_BITS) - 3;

    /// A model on the field of a map.
    ///
    /// # Errors
    /// Parameters that [`validate`](LikelihoodFieldModelParams::validate) refuses, beams that would be explained as far away as the
    /// field's `max_distance`, from where on all places are alike, or a map longer than [`MAX_SIDE`](Self::MAX_SIDE).
    pub fn new(field: &LikelihoodField, params: LikelihoodFieldModelParams) -> Result<Self, Error> {
        params.validate()?;
        let table = Arc::new(Table::new(field, &params)?);
        Ok(Self { params, table, beams: Beams::with_capacity(params.max_beams), arch: Arch::new() })
    }

    /// The parameters.
    pub const fn params(&self) -> &LikelihoodFieldModelParams {
        &self.params
    }

    /// The end points of the beams that are used.
    fn ends(&mut self, scan: &LaserScan) -> &EndPoints {
        self.beams.ends(scan, &self.params, self.table.cells_per_metre)
    }
}

impl SensorModel<LaserScan> for LikelihoodFieldModel {
    fn condition<'a>(&'a mut self, scan: &'a LaserScan) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        let (usable, needed) = (self.ends(scan).len(), self.params.min_hits.max(1));
        if usable < needed {
            return Err(SkipReason::TooFewReadings { usable, needed });
        }
        Ok(ScanOnTable::new(&self.table, self.beams.known(), self.params.form, self.arch))
    }

    fn independent_readings(&self) -> f64 {
        self.params.form.independent_readings(self.beams.known().len())
    }

    /// Not with the sum of cubes: its terms do not tell distances.
    fn refine(&mut self, scan: &LaserScan, guess: &UncertainPose<Se2>) -> Option<Se2> {
        if self.params.form == ScanForm::SumOfCubes || self.ends(scan).len() < self.params.min_hits.max(1) {
            return None;
        }
        let ends = self.beams.known();
        let weight = self.params.form.power(ends.len());
        Refiner { table: &self.table, ends, weight, arch: self.arch }.refine(guess)
    }
}

weigh_per_pose!(LikelihoodFieldModel: LaserScan);

impl UsedBeams for LikelihoodFieldModel {
    fn max_beams(&self) -> usize {
        self.params.max_beams
    }

    fn max_range(&self) -> f64 {
        self.params.max_range
    }
}
