//! Pose and points with one covariance, and the errors in the group of both.
//!
//! An error `ξ` moves the whole state on the side of the map, by the same turn `φ` about the map's origin (Barrau and Bonnabel 2015):
//!
//! ```text
//! X ← exp(ξ_X) X          l ← R(φ) l + V(φ) ξ_l
//! ```
//!
//! A motion that is known exactly leaves `ξ` as it is, so that the filter's transition is the identity; what a motion of the vehicle
//! errs by, `Ad(X) w`, turns the points back by its own turn: `ξ_l -= S l φ` with `S l = (-l_y, l_x)`. That depends on the points, not on the motion, so
//! motions are summed in three by three numbers, and spread over the points once before the next update. A place seen by the vehicle is
//!
//! ```text
//! q = Rᵀ (l - p)          δq = Rᵀ (ξ_l - ξ_p)
//! ```
//!
//! without the turn of the map, which no sighting can tell.

use super::{
    correction::CorrectionScratch,
    joint::JointCovariance,
    reading::{Expected, symmetric},
};
use agv_core::geometry::{LieGroup, Se2};
use nalgebra::{Matrix2, Matrix3, Vector2};

/// Row of the heading, of the scale of ranges, and of the first point.
pub(super) const YAW: usize = 2;
pub(super) const SCALE: usize = 3;
pub(super) const POINTS: usize = 4;

/// What a point of the map is.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) enum PointKind {
    /// A landmark, with the identity that a sensor reads, how often it was seen, and how often missed since it was.
    Landmark { id: Option<u32>, sightings: u32, misses: u32 },
    /// Where a sensor was when it measured a range that still waits for its landmark.
    Anchor,
}

/// A point that does not move.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Point {
    /// Grows from point to point, and is never used twice.
    pub(super) key: u32,
    pub(super) place: Vector2<f64>,
    pub(super) kind: PointKind,
}

/// The estimate.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct SlamState {
    pub(super) map_from_base: Se2,
    /// Share by which ranges are too long.
    pub(super) scale: f64,
    pub(super) points: Vec<Point>,
    /// Of the pose, the scale, and the points in their order.
    pub(super) covariance: JointCovariance,
    /// Covariance of the motions since the last update, in the axes of the map.
    pub(super) pending: Matrix3<f64>,
}

/// Readings of one point from where a sensor was, linearised: `residual ≈ a (ξ_point - ξ_base) + by_scale δs + noise`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Constraint {
    /// Row of the point, and that of the pose or of an anchor.
    pub(super) point: usize,
    pub(super) base: usize,
    pub(super) rows: usize,
    pub(super) a: Matrix2<f64>,
    pub(super) by_scale: Vector2<f64>,
    pub(super) residual: Vector2<f64>,
    pub(super) noise: Matrix2<f64>,
}

/// `S l`.
#[inline]
pub(super) fn turned(l: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-l.y, l.x)
}

/// Row of the point at an index.
#[inline]
pub(super) const fn row_of(index: usize) -> usize {
    POINTS + 2 * index
}

impl SlamState {
    /// At the map's origin, for certain.
    pub(super) fn new(range_scale_sigma: f64) -> Self {
        let mut covariance = JointCovariance::default();
        for variance in [0.0, 0.0, 0.0, range_scale_sigma * range_scale_sigma] {
            covariance.push(variance);
        }
        let pending = Matrix3::zeros();
        Self { map_from_base: Se2::default(), scale: 0.0, points: Vec::new(), covariance, pending }
    }

    /// Moves the vehicle; the covariance is of the right increment.
    pub(super) fn drive(&mut self, start_from_end: &Se2, covariance: &Matrix3<f64>) {
        self.map_from_base = self.map_from_base.compose(start_from_end);
        let adjoint = self.map_from_base.adjoint();
        self.pending += symmetric(&(adjoint * covariance * adjoint.transpose()));
    }

    /// Spreads what the motions erred by over the points.
    pub(super) fn flush(&mut self, scratch: &mut CorrectionScratch) {
        let pending = std::mem::replace(&mut self.pending, Matrix3::zeros());
        if pending == Matrix3::zeros() {
            return;
        }
        for i in 0..3 {
            for j in 0..=i {
                self.covariance.add(i, j, pending[(i, j)]);
            }
        }
        let back = &mut scratch.step;
        back.clear();
        back.resize(self.covariance.size(), 0.0);
        for (k, point) in self.points.iter().enumerate() {
            let turned = turned(&point.place);
            for (row, value) in [(row_of(k), -turned.x), (row_of(k) + 1, -turned.y)] {
                back[row] = value;
                for i in 0..3 {
                    self.covariance.add(row, i, value * pending[(YAW, i)]);
                }
            }
        }
        self.covariance.add_products(back, back, pending[(YAW, YAW)]);
    }

    /// Covariance of the pose, in its own frame.
    pub(super) fn pose_covariance(&self) -> Matrix3<f64> {
        let sum = Matrix3::from_fn(|i, j| self.covariance.get(i, j)) + self.pending;
        let adjoint = self.map_from_base.inverse().adjoint();
        symmetric(&(adjoint * sum * adjoint.transpose()))
    }

    /// Covariance of a point's place, in the axes of the map.
    pub(super) fn point_covariance(&self, index: usize) -> Matrix2<f64> {
        let (row, lever) = (row_of(index), turned(&self.points[index].place));
        let own = Matrix2::from_fn(|i, j| self.covariance.get(row + i, row + j));
        let cross = Vector2::from_fn(|i, _| self.covariance.get(row + i, YAW));
        let mixed = cross * lever.transpose();
        symmetric(&(own + mixed + mixed.transpose() + lever * lever.transpose() * self.covariance.get(YAW, YAW)))
    }

    /// Place of a point in the frame of a sensor.
    pub(super) fn seen(&self, base_from_sensor: &Se2, index: usize) -> Vector2<f64> {
        let in_base = self.map_from_base.inverse().act(&self.points[index].place);
        base_from_sensor.inverse().act(&in_base)
    }

    /// What a reading says of the point at an index, seen from where the vehicle is.
    pub(super) fn constraint(&self, base_from_sensor: &Se2, index: usize, expected: &Expected) -> Constraint {
        let turn = self.map_from_base.rotation().compose(&base_from_sensor.rotation());
        let sensor_from_map = Matrix2::new(turn.cos(), turn.sin(), -turn.sin(), turn.cos());
        Constraint {
            point: row_of(index),
            base: 0,
            rows: expected.rows,
            a: expected.by_seen * sensor_from_map,
            by_scale: expected.by_scale,
            residual: expected.residual,
            noise: expected.noise,
        }
    }

    /// Covariance of what two constraints predict, noise apart.
    pub(super) fn cross(&self, one: &Constraint, two: &Constraint) -> Matrix2<f64> {
        let p = &self.covariance;
        let spread = Matrix2::from_fn(|i, j| {
            (p.get(one.point + i, two.point + j) - p.get(one.base + i, two.point + j))
                - (p.get(one.point + i, two.base + j) - p.get(one.base + i, two.base + j))
        });
        let mut cross = one.a * spread * two.a.transpose();
        let scale = p.get(SCALE, SCALE);
        if scale > 0.0 {
            let by = |c: &Constraint| Vector2::from_fn(|i, _| p.get(c.point + i, SCALE) - p.get(c.base + i, SCALE));
            cross += one.a * by(one) * two.by_scale.transpose();
            cross += one.by_scale * (two.a * by(two)).transpose();
            cross += one.by_scale * two.by_scale.transpose() * scale;
        }
        cross
    }

    /// Covariance of a constraint's innovation; the second row of a constraint of one row is that of nothing.
    pub(super) fn innovation(&self, constraint: &Constraint) -> Matrix2<f64> {
        symmetric(&(self.cross(constraint, constraint) + constraint.noise))
    }

    /// Adds a landmark that lies at `seen` in the sensor's frame, with the covariance of that reading; `by_scale` is the slope of the
    /// place by the scale of ranges. O(points).
    pub(super) fn add_landmark(
        &mut self,
        point: Point,
        base_from_sensor: &Se2,
        noise: &Matrix2<f64>,
        by_scale: &Vector2<f64>,
    ) {
        let turn = self.map_from_base.rotation().compose(&base_from_sensor.rotation());
        let map_from_sensor = Matrix2::new(turn.cos(), -turn.sin(), turn.sin(), turn.cos());
        let (noise, slope) = (map_from_sensor * noise * map_from_sensor.transpose(), map_from_sensor * by_scale);
        self.add_at_base(point, &slope);
        let row = row_of(self.points.len() - 1);
        for (i, j) in [(0, 0), (1, 0), (1, 1)] {
            self.covariance.add(row + i, row + j, noise[(i, j)]);
        }
    }

    /// Adds a point that is tied to the vehicle as it stands, but for the scale.
    pub(super) fn add_at_base(&mut self, point: Point, by_scale: &Vector2<f64>) {
        self.covariance.push_sum(0, SCALE, by_scale.x);
        self.covariance.push_sum(1, SCALE, by_scale.y);
        self.points.push(point);
    }

    /// Adds a point of which nothing is known beyond this variance.
    pub(super) fn add_unknown(&mut self, point: Point, variance: f64) {
        self.covariance.push(variance);
        self.covariance.push(variance);
        self.points.push(point);
    }

    /// Leaves a point out.
    pub(super) fn remove(&mut self, index: usize) {
        self.points.remove(index);
        self.covariance.remove_pair(row_of(index));
    }

    /// Index of the point with a key.
    pub(super) fn index_of(&self, key: u32) -> Option<usize> {
        self.points.binary_search_by_key(&key, |point| point.key).ok()
    }

    /// Whether all is finite.
    #[cfg(feature = "serde")]
    pub(super) fn is_finite(&self) -> bool {
        self.scale.is_finite()
            && self.points.iter().all(|p| p.place.iter().all(|v| v.is_finite()))
            && self.pending.iter().all(|v| v.is_finite())
    }
}
