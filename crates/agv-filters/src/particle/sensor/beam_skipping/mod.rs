//! Beam skipping: beams that few particles explain are left out of the weighing.
//!
//! People, pallets and moved shelves stop beams that the map sends farther. Where the set has converged, a beam that hardly
//! any particle can place near something mapped says nothing of which particle is right, but pulls them all. So a first pass
//! counts, per beam, the particles that put its end within `distance` of an obstacle; beams with a share of at most
//! `threshold` are masked, and the others weigh (`do_beamskip` of `nav2_amcl`'s `likelihood_field_prob`). If nearly all beams
//! would go, the set has rather converged on a wrong place: then all weigh.

use super::{
    UsedBeams, WeighParticles,
    beams::hits,
    end_points::{BLOCK, EndPoints, Raster},
};
use agv_core::{
    Error, check,
    compute::{CHUNK, Par},
    geometry::{LieGroup, Se2, UncertainPose},
    grid::{CellState, DistanceParams, DistanceTransform, Grid, GridLayout},
    roles::SkipReason,
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use nalgebra::Vector2;
use pulp::{Arch, Simd, WithSimd};
use std::sync::Arc;

/// When [`BeamSkipping`] leaves a beam out.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BeamSkippingParams {
    /// A particle explains a beam whose end it puts nearer than this to an obstacle, in metres.
    pub distance: f64,
    /// Beams that no more than this share of the particles explain are left out.
    pub threshold: f64,
    /// If at least this share of the beams were to be left out, none is.
    pub error_threshold: f64,
    /// The set has converged if no particle is farther than this from the mean along x or y, in metres; before, no beam is
    /// left out.
    pub converged_within: f64,
}

impl Default for BeamSkippingParams {
    /// The defaults of `nav2_amcl`: 0.5 m, 0.3, 0.9, and 0.5 m for a set that has converged.
    fn default() -> Self {
        Self { distance: 0.5, threshold: 0.3, error_threshold: 0.9, converged_within: 0.5 }
    }
}

impl BeamSkippingParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// A distance that is not finite and positive, or a share outside [0, 1].
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("beam skipping distance", self.distance)?;
        check::in_range("threshold", self.threshold, 0.0, 1.0)?;
        check::in_range("error_threshold", self.error_threshold, 0.0, 1.0)?;
        check::positive("converged_within", self.converged_within)?;
        Ok(())
    }
}

/// Leaves out beams that few particles explain, and has the others weighed by a model of scans.
///
/// Around [`LikelihoodFieldModel`](super::LikelihoodFieldModel) with a product of all its beams it is `likelihood_field_prob`
/// of `nav2_amcl`. It costs a look-up per beam and particle more; nothing is allocated once the set and the scan have been as
/// large.
///
/// ```
/// use agv_core::compute::Par;
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams};
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::particle::*;
///
/// // A wall 2 m ahead of the origin; someone stands in front of a third of the beams.
/// let mut map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::new(0.0, -1.5, 0.0))?, CellState::Free);
/// (0..60).for_each(|y| { map.set(Cell::new(40, y), CellState::Occupied); });
/// let field = LikelihoodField::new(&map, LikelihoodFieldParams::default())?;
/// let model = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
/// let mut skipping = BeamSkipping::new(model, &map, BeamSkippingParams::default())?;
///
/// let geometry = ScanGeometry { angle_min: -0.15, angle_increment: 0.01, ..Default::default() };
/// let ranges = (0..30).map(|i| if i % 3 == 0 { 0.7 } else { 2.0 }).collect();
/// let scan = LaserScan::new(Stamp::default(), geometry, ranges)?;
/// let poses = [Se2::default(), Se2::new(0.1, 0.0, 0.0)];
/// skipping.weigh(&scan, &poses, &mut [0.0; 2], Par::Seq).expect("thirty beams hit");
/// assert_eq!(skipping.skipped(), 10);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct BeamSkipping<S> {
    model: S,
    params: BeamSkippingParams,
    near: Arc<NearObstacles>,
    /// Beams of the hits that are used, and their end points.
    hits: Vec<usize>,
    ends: EndPoints,
    /// Particles that explain each of them, chunk by chunk.
    counts: Vec<u32>,
    keep: Vec<bool>,
    masked: LaserScan,
    skipped: usize,
}

/// Which cells lie near an obstacle, those beyond the map's edge too: its outermost cells do not.
#[derive(Debug)]
struct NearObstacles {
    cells: Vec<u8>,
    raster: Raster,
}

impl NearObstacles {
    fn new(map: &Grid<CellState>, distance: f64) -> Result<Self, Error> {
        let layout = map.layout();
        let margin = ((distance / layout.resolution()).ceil() as usize).saturating_add(1);
        let (width, height) = (layout.width(), layout.height());
        let corner = layout.to_map(&Vector2::repeat(-(margin as f64)));
        let wider = GridLayout::new(
            width.saturating_add(margin.saturating_mul(2)),
            height.saturating_add(margin.saturating_mul(2)),
            layout.resolution(),
            Se2::from_parts(corner, layout.map_from_grid().rotation()),
        )?;
        let mut padded = Grid::filled(wider, CellState::Free);
        let rows = padded.values_mut().chunks_exact_mut(wider.width()).skip(margin);
        for (row, states) in rows.zip(map.values().chunks_exact(width)) {
            row[margin..margin + width].copy_from_slice(states);
        }
        let params = DistanceParams { max_distance: Some(distance), ..Default::default() };
        let distances = DistanceTransform::new(params)?.compute(&padded)?;
        let raster = Raster {
            grid_from_map: wider.map_from_grid().inverse(),
            cells_per_metre: layout.resolution().recip(),
            stride: wider.width() as u32,
            last: [(wider.width() - 1) as f32, (wider.height() - 1) as f32],
        };
        Ok(Self {
            cells: distances.values().iter().map(|&near| u8::from(f64::from(near) < distance)).collect(),
            raster,
        })
    }
}

/// Counts, for every end point, the poses that put it near an obstacle; compiled once for each instruction set.
struct Count<'a> {
    near: &'a NearObstacles,
    ends: &'a EndPoints,
    poses: &'a [Se2],
    counts: &'a mut [u32],
}

impl WithSimd for Count<'_> {
    type Output = ();

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set")]
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let NearObstacles { cells, raster } = self.near;
        for pose in self.poses {
            let at = raster.place(pose);
            for ((block, _), counts) in self.ends.blocks().zip(self.counts.chunks_mut(BLOCK)) {
                // From a cell's lower left corner to its middle.
                let indices = raster.nearest_corners(&at.act(block, -0.5));
                for (count, index) in counts.iter_mut().zip(indices) {
                    *count += u32::from(cells[index as usize]);
                }
            }
        }
    }
}

impl<S: UsedBeams> BeamSkipping<S> {
    /// Around a model of scans in the map.
    ///
    /// # Errors
    /// Parameters that [`validate`](BeamSkippingParams::validate) refuses, or a map that, with a margin of the distance, is
    /// too large for a grid or too long for the [`DistanceTransform`].
    pub fn new(model: S, map: &Grid<CellState>, params: BeamSkippingParams) -> Result<Self, Error> {
        params.validate()?;
        let most = model.max_beams().min(LaserScan::MAX_BEAMS);
        Ok(Self {
            near: Arc::new(NearObstacles::new(map, params.distance)?),
            hits: Vec::with_capacity(most.min(1 << 12)),
            ends: EndPoints::with_capacity(most),
            counts: Vec::new(),
            keep: Vec::new(),
            masked: LaserScan::new(Stamp::default(), ScanGeometry::default(), Vec::new())?,
            skipped: 0,
            model,
            params,
        })
    }
}

impl<S> BeamSkipping<S> {
    /// When a beam is left out.
    pub const fn params(&self) -> &BeamSkippingParams {
        &self.params
    }

    /// The model that weighs.
    pub const fn model(&self) -> &S {
        &self.model
    }

    /// How many beams the last weighing left out.
    pub const fn skipped(&self) -> usize {
        self.skipped
    }

    /// Whether no pose is far from the mean.
    fn has_converged(&self, poses: &[Se2]) -> bool {
        let mean = poses.iter().map(Se2::translation).sum::<Vector2<f64>>() / poses.len() as f64;
        // The comparison fails for poses that are not numbers.
        poses.iter().all(|pose| (pose.translation() - mean).amax() <= self.params.converged_within)
    }
}

impl<S: UsedBeams> BeamSkipping<S> {
    /// Marks the beams that enough poses explain; whether some are to be left out.
    fn choose(&mut self, scan: &LaserScan, poses: &[Se2], par: Par) -> bool {
        self.hits.clear();
        self.ends.clear();
        for (index, end) in hits(scan, self.model.max_beams(), self.model.max_range()) {
            self.ends.push(&(end * self.near.raster.cells_per_metre));
            self.hits.push(index);
        }
        let (beams, near, ends) = (self.ends.len(), &*self.near, &self.ends);
        if beams == 0 {
            return false;
        }
        self.counts.clear();
        self.counts.resize(beams * poses.len().div_ceil(CHUNK), 0);
        let arch = Arch::new();
        par.for_each_chunk(self.counts.as_mut_slice(), beams, |chunk, counts: &mut [u32]| {
            let last = (chunk * CHUNK + CHUNK).min(poses.len());
            arch.dispatch(Count { near, ends, poses: &poses[chunk * CHUNK..last], counts });
        });
        self.keep.clear();
        self.keep.resize(scan.len(), true);
        let least = self.params.threshold * poses.len() as f64;
        let mut skipped = 0;
        for (k, &index) in self.hits.iter().enumerate() {
            let explaining: u32 = self.counts.iter().skip(k).step_by(beams).sum();
            if f64::from(explaining) <= least {
                self.keep[index] = false;
                skipped += 1;
            }
        }
        self.skipped = if (skipped as f64) < self.params.error_threshold * beams as f64 { skipped } else { 0 };
        self.skipped > 0
    }
}

impl<S: UsedBeams + WeighParticles<LaserScan>> WeighParticles<LaserScan> for BeamSkipping<S> {
    fn weigh(
        &mut self,
        scan: &LaserScan,
        poses: &[Se2],
        log_likelihoods: &mut [f64],
        par: Par,
    ) -> Result<(), SkipReason> {
        self.skipped = 0;
        if self.has_converged(poses) && self.choose(scan, poses, par) {
            self.masked.copy_masked(scan, |beam| self.keep[beam]);
            if self.model.weigh(&self.masked, poses, log_likelihoods, par).is_ok() {
                return Ok(());
            }
            // Too few are left to say anything.
            self.skipped = 0;
        }
        self.model.weigh(scan, poses, log_likelihoods, par)
    }

    /// The share of all beams: those that were left out are not explained.
    fn explained(&mut self, scan: &LaserScan, map_from_base: &Se2) -> Option<f64> {
        self.model.explained(scan, map_from_base)
    }

    fn independent_readings(&self) -> f64 {
        self.model.independent_readings()
    }

    fn refine(&mut self, scan: &LaserScan, guess: &UncertainPose<Se2>) -> Option<Se2> {
        self.model.refine(scan, guess)
    }
}

#[cfg(test)]
mod tests;
