//! Beam skipping: beams that few particles explain are left out of the weighing.
//!
//! People, pallets and moved shelves stop beams that the map sends farther. Where the set has converged, a beam that hardly
//! any particle can place near something mapped says nothing of which particle is right, but pulls them all. So a first pass
//! counts, per beam, the particles that put its end within `distance` of an obstacle; beams with a share of at most
//! `threshold` are masked, and the others weigh (`do_beamskip` of `nav2_amcl`'s `likelihood_field_prob`). If nearly all beams
//! would go, the set has rather converged on a wrong place: then all weigh.

use super::{
    MaxBeams, WeighParticles,
    beams::evenly_spread,
    end_points::{BLOCK, EndPoints, Raster},
};
use agv_core::{
    Error, check,
    compute::{CHUNK, Par},
    geometry::{LieGroup, Se2},
    grid::{CellState, DistanceParams, DistanceTransform, Grid, GridLayout},
    roles::SkipReason,
    sensors::{Beam, LaserScan, ScanGeometry},
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

impl<S: MaxBeams> BeamSkipping<S> {
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

impl<S: MaxBeams> BeamSkipping<S> {
    /// Marks the beams that enough poses explain; whether some are to be left out.
    fn choose(&mut self, scan: &LaserScan, poses: &[Se2], par: Par) -> bool {
        let geometry = scan.geometry();
        self.hits.clear();
        self.ends.clear();
        for index in evenly_spread(scan.len(), self.model.max_beams()) {
            if let Beam::Hit(range) = scan.interpret(scan.ranges()[index]) {
                let (sin, cos) = geometry.angle(index).sin_cos();
                let end = geometry.base_from_sensor.act(&[range * cos, range * sin].into());
                self.ends.push(&(end * self.near.raster.cells_per_metre));
                self.hits.push(index);
            }
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

impl<S: MaxBeams + WeighParticles<LaserScan>> WeighParticles<LaserScan> for BeamSkipping<S> {
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particle::{LikelihoodFieldModel, LikelihoodFieldModelParams, ScanForm};
    use agv_core::grid::{Cell, LikelihoodField, LikelihoodFieldParams};

    /// A room of 4 m by 3 m.
    fn room() -> Grid<CellState> {
        let mut map = Grid::filled(GridLayout::new(80, 60, 0.05, Se2::default()).unwrap(), CellState::Free);
        for x in 0..80 {
            for y in 0..60 {
                if x == 0 || y == 0 || x == 79 || y == 59 {
                    map.set(Cell::new(x, y), CellState::Occupied);
                }
            }
        }
        map
    }

    fn model(max_beams: usize) -> LikelihoodFieldModel {
        let field = LikelihoodField::new(&room(), LikelihoodFieldParams::default()).unwrap();
        let form = ScanForm::Product { independent_beams: max_beams as f64 };
        LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams { max_beams, form, ..Default::default() }).unwrap()
    }

    fn skipping(max_beams: usize, params: BeamSkippingParams) -> BeamSkipping<LikelihoodFieldModel> {
        BeamSkipping::new(model(max_beams), &room(), params).unwrap()
    }

    /// Seen from the middle of the room, ahead; `blocked` of the 40 beams end after 0.5 m.
    fn scan(blocked: usize) -> LaserScan {
        let geometry = ScanGeometry { angle_min: -0.4, angle_increment: 0.02, ..Default::default() };
        let range = |i: usize| if i < blocked { 0.5 } else { (1.95 / geometry.angle(i).cos()) as f32 };
        LaserScan::new(Stamp::default(), geometry, (0..40).map(range).collect()).unwrap()
    }

    fn poses() -> Vec<Se2> {
        (0..600).map(|i| Se2::new(2.0 + 1e-4 * f64::from(i - 300), 1.5, 1e-5 * f64::from(i))).collect()
    }

    fn weigh(model: &mut impl WeighParticles<LaserScan>, scan: &LaserScan, poses: &[Se2], par: Par) -> Vec<f64> {
        let mut out = vec![0.0; poses.len()];
        model.weigh(scan, poses, &mut out, par).unwrap();
        out
    }

    /// Blocked beams say nothing: the weights are those of the scan without them.
    #[test]
    fn beams_that_nobody_explains_do_not_weigh() {
        let poses = poses();
        let mut skipping = skipping(40, BeamSkippingParams::default());
        for par in [Par::Seq, Par::threads(2)] {
            let got = weigh(&mut skipping, &scan(12), &poses, par);
            assert_eq!(skipping.skipped(), 12);
            let mut without = scan(12);
            without.copy_masked(&scan(12), |beam| beam >= 12);
            assert_eq!(got, weigh(&mut model(40), &without, &poses, Par::Seq));
        }
        // Where all beams fit nothing changes.
        assert_eq!(weigh(&mut skipping, &scan(0), &poses, Par::Seq), weigh(&mut model(40), &scan(0), &poses, Par::Seq));
        assert_eq!(skipping.skipped(), 0);
    }

    #[test]
    fn a_set_that_is_spread_or_wrong_uses_all_beams() {
        let mut spread = poses();
        spread[7] = Se2::new(2.0, 2.2, 0.0);
        let mut skipping = skipping(40, BeamSkippingParams::default());
        for (scan, poses) in [(scan(12), spread), (scan(37), poses())] {
            let got = weigh(&mut skipping, &scan, &poses, Par::Seq);
            assert_eq!((skipping.skipped(), got), (0, weigh(&mut model(40), &scan, &poses, Par::Seq)));
        }
        // Not wrong, but too few beams are left for the model.
        let mut skipping =
            super::tests::skipping(40, BeamSkippingParams { error_threshold: 1.0, ..Default::default() });
        let got = weigh(&mut skipping, &scan(37), &poses(), Par::Seq);
        assert_eq!((skipping.skipped(), got), (0, weigh(&mut model(40), &scan(37), &poses(), Par::Seq)));
    }

    /// Walls at the edge of a map explain beams that end a little beyond it.
    #[test]
    fn the_edge_of_the_map_is_no_edge_of_its_obstacles() {
        let beyond: Vec<Se2> = poses().iter().map(|pose| Se2::new(pose.x() + 0.4, pose.y(), 0.0)).collect();
        let mut skipping = skipping(40, BeamSkippingParams::default());
        weigh(&mut skipping, &scan(12), &beyond, Par::Seq);
        assert_eq!(skipping.skipped(), 12);
    }

    /// The beams that are judged are those that the model reads.
    #[test]
    fn thinned_scans_are_judged_on_the_beams_that_are_used() {
        let mut skipping = skipping(10, BeamSkippingParams::default());
        let got = weigh(&mut skipping, &scan(12), &poses(), Par::Seq);
        assert_eq!(skipping.skipped(), 3);
        let mut without = scan(12);
        without.copy_masked(&scan(12), |beam| beam >= 12);
        assert_eq!(got, weigh(&mut model(10), &without, &poses(), Par::Seq));
    }

    #[test]
    fn bad_input_is_named_or_survived() {
        let good = BeamSkippingParams::default();
        for (name, bad) in [
            ("beam skipping distance", BeamSkippingParams { distance: 0.0, ..good }),
            ("threshold", BeamSkippingParams { threshold: -0.1, ..good }),
            ("error_threshold", BeamSkippingParams { error_threshold: f64::NAN, ..good }),
            ("converged_within", BeamSkippingParams { converged_within: -1.0, ..good }),
            ("grid has", BeamSkippingParams { distance: 1e300, ..good }),
        ] {
            let error = BeamSkipping::new(model(40), &room(), bad).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
        let mut skipping = skipping(40, good);
        for ranges in [vec![], vec![f32::NAN; 40], vec![f32::INFINITY; 40]] {
            let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), ranges).unwrap();
            let expected = Err(SkipReason::TooFewReadings { usable: 0, needed: 5 });
            assert_eq!(skipping.weigh(&scan, &poses(), &mut [0.0; 600], Par::Seq), expected);
        }
        skipping.weigh(&scan(3), &[], &mut [], Par::Seq).unwrap();
        for pose in [Se2::new(1e300, 0.0, 0.0), Se2::new(-1e9, 1e9, 0.0), Se2::new(f64::NAN, 0.0, 0.0)] {
            assert!(weigh(&mut skipping, &scan(3), &[pose; 3], Par::Seq).iter().all(|l| l.is_finite()));
        }
    }
}
