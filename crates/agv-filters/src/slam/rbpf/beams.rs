//! A scan as the filter reads it, once for all particles: ends of beams in the base frame.

use agv_core::{
    geometry::{LieGroup, Se2},
    grid::{BeamEvidence, InverseModel},
    sensors::LaserScan,
};
use nalgebra::Vector2;

/// Cells from a pose beyond which no scan is read: two kilometres at 0.05 m.
pub(super) const FARTHEST: f64 = 40_000.0;

/// Cells from the origin up to which there are maps: a quarter of what traversals count, so that sums of coordinates fit.
pub(super) const FAR: f64 = (1_i64 << 27) as f64;

/// Where a beam ends, in the base frame, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct End {
    pub(super) point: Vector2<f64>,
    /// Whether there is a surface at the end.
    pub(super) hit: bool,
}

/// The beams that say something.
#[derive(Debug, Clone, Default)]
pub(super) struct Beams {
    /// Where the scanner is, in the base frame.
    pub(super) origin: Vector2<f64>,
    pub(super) ends: Vec<End>,
    /// Ends on surfaces that matching uses, in metres.
    pub(super) points: Vec<Vector2<f64>>,
    /// Farthest end from the base's origin, in metres.
    pub(super) reach: f64,
}

impl Beams {
    /// Reads a scan; of its surfaces at most `most` are kept to match, evenly spread over the beams.
    pub(super) fn read(&mut self, scan: &LaserScan, model: &InverseModel, most: usize) {
        let (mount, range_max) = (scan.geometry().base_from_sensor, scan.geometry().range_max);
        self.origin = mount.translation();
        self.reach = self.origin.norm();
        self.ends.clear();
        for (angle, beam) in scan.beams() {
            let Some(BeamEvidence { free_until, hit }) = model.read(beam, range_max) else { continue };
            let (sin, cos) = angle.sin_cos();
            let point = mount.act(&(Vector2::new(cos, sin) * free_until));
            self.reach = self.reach.max(point.norm());
            self.ends.push(End { point, hit: hit > 0 });
        }
        let hits = self.hits();
        let stride = hits.div_ceil(most.max(1)).max(1);
        self.points.clear();
        self.points.extend(self.ends.iter().filter(|end| end.hit).map(|end| end.point).step_by(stride));
    }

    /// Beams that end on a surface.
    pub(super) fn hits(&self) -> usize {
        self.ends.iter().filter(|end| end.hit).count()
    }

    /// Least and greatest cell that the beams may reach from a pose, with a margin of cells; none where
    /// that is more than a scanner can reach, or farther off than cells are counted.
    pub(super) fn cells_from(&self, pose: &Se2, resolution: f64, margin: i32) -> Option<((i32, i32), (i32, i32))> {
        let (middle, reach) = (pose.translation() / resolution, self.reach / resolution + f64::from(margin) + 1.0);
        if reach > FARTHEST {
            return None;
        }
        let (low, high) = (middle.map(|v| (v - reach).floor()), middle.map(|v| (v + reach).floor()));
        let fits = low.amax() < FAR && high.amax() < FAR;
        fits.then(|| ((low.x as i32, low.y as i32), (high.x as i32, high.y as i32)))
    }
}
