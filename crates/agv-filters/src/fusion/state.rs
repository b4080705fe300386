//! What the filter believes at one time: a mean on SE(2) × Rⁿ, and the covariance of its error.
//!
//! Errors are right increments where the state is a pose, and differences elsewhere, in this order:
//!
//! ```text
//! 0..3    pose map_from_base         3..6  vx, vy, yaw rate       6..8  acceleration (ax, ay)
//! 8       bias of the gyro           9, 10 scales of distances and turns that wheels misread
//! 11      what a source is later than its latency says
//! 12..    anchors: the poses from which motions are measured, three errors each
//! ```
//!
//! An anchor is a copy of the pose of an earlier time whose correlation with everything else is kept (stochastic cloning;
//! Roumeliotis and Burdick 2002): a measured motion is then one between two poses of the state, with the right covariance
//! whatever else was measured meanwhile.

use super::source::MAX_SOURCES;
use agv_core::{
    Error,
    geometry::{LieGroup, Se2, So2, Twist2, UncertainPose},
    time::Stamp,
};
use nalgebra::{Matrix3, Vector2, Vector3};

/// First entry of each part of the error.
pub(super) const POSE: usize = 0;
pub(super) const VELOCITY: usize = 3;
pub(super) const ACCELERATION: usize = 6;
pub(super) const GYRO_BIAS: usize = 8;
pub(super) const DISTANCE_SCALE: usize = 9;
pub(super) const YAW_SCALE: usize = 10;
pub(super) const LATENCY: usize = 11;
pub(super) const ANCHORS: usize = 12;

/// Poses that are kept at most.
pub(super) const MAX_ANCHORS: usize = 3;

/// Entries of the error.
pub(super) const DIMENSION: usize = ANCHORS + 3 * MAX_ANCHORS;

/// An error, or a row of a Jacobian.
pub(super) type Row = [f64; DIMENSION];

/// A symmetric matrix over the errors.
pub(super) type Covariance = [Row; DIMENSION];

/// First error of an anchor.
pub(super) const fn anchor_at(slot: usize) -> usize {
    ANCHORS + 3 * slot
}

/// A pose of the past.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Anchor {
    pub(super) map_from_base: Se2,
    pub(super) stamp: Stamp,
    /// What the sensor itself read there, in its own frame.
    pub(super) own_from_sensor: Se2,
}

/// What became of the measurements of a source, as far as the state knows of them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Tally {
    pub(super) accepted: u64,
    pub(super) gated: u64,
    pub(super) gated_in_a_row: u32,
    pub(super) nis_sum: f64,
    pub(super) degrees_of_freedom: u64,
}

/// Mean, covariance and what goes with them back in time.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct State {
    pub(super) stamp: Stamp,
    pub(super) map_from_base: Se2,
    pub(super) twist: Twist2,
    pub(super) acceleration: Vector2<f64>,
    pub(super) gyro_bias: f64,
    pub(super) distance_scale: f64,
    pub(super) yaw_scale: f64,
    pub(super) latency: f64,
    pub(super) anchors: [Option<Anchor>; MAX_ANCHORS],
    pub(super) covariance: Covariance,
    pub(super) tallies: [Tally; MAX_SOURCES],
}

/// A pose moved by an error: along its own axes, and turned. To first order that is the right increment that it stands for; unlike
/// the exponential it puts a vehicle that is lost by kilometres and radians where a measurement says.
fn moved(pose: &Se2, error: &Vector3<f64>) -> Se2 {
    let way = pose.rotation().act(&Vector2::new(error.x, error.y));
    Se2::from_parts(pose.translation() + way, pose.rotation().compose(&So2::from_angle(error.z)))
}

/// Greatest scale: wheels that misread by half are not to be calibrated on the way.
const MOST_SCALE: f64 = 0.5;

/// Greatest latency beyond what is stated, in seconds: a vehicle does not keep its velocity for longer.
pub(super) const MOST_LATENCY: f64 = 1.0;

impl State {
    /// A vehicle at `map_from_base` whose errors are known by their deviations; nothing is correlated yet.
    pub(super) fn new(stamp: Stamp, map_from_base: Se2, pose: &Matrix3<f64>, sigmas: &[f64; ANCHORS]) -> Self {
        let mut covariance = [[0.0; DIMENSION]; DIMENSION];
        for (i, sigma) in sigmas.iter().enumerate() {
            covariance[i][i] = sigma * sigma;
        }
        for column in 0..3 {
            for row in 0..3 {
                covariance[POSE + column][POSE + row] = pose[(row, column)];
            }
        }
        Self {
            stamp,
            map_from_base,
            twist: Twist2::ZERO,
            acceleration: Vector2::zeros(),
            gyro_bias: 0.0,
            distance_scale: 0.0,
            yaw_scale: 0.0,
            latency: 0.0,
            anchors: [None; MAX_ANCHORS],
            covariance,
            tallies: [Tally::default(); MAX_SOURCES],
        }
    }

    /// The mean moved by an error, anchors included.
    pub(super) fn shift(&mut self, error: &Row) {
        let three = |at: usize| Vector3::new(error[at], error[at + 1], error[at + 2]);
        self.map_from_base = moved(&self.map_from_base, &three(POSE));
        self.twist = (Vector3::from(self.twist) + three(VELOCITY)).into();
        self.acceleration += Vector2::new(error[ACCELERATION], error[ACCELERATION + 1]);
        self.gyro_bias += error[GYRO_BIAS];
        self.distance_scale = (self.distance_scale + error[DISTANCE_SCALE]).clamp(-MOST_SCALE, MOST_SCALE);
        self.yaw_scale = (self.yaw_scale + error[YAW_SCALE]).clamp(-MOST_SCALE, MOST_SCALE);
        self.latency = (self.latency + error[LATENCY]).clamp(-MOST_LATENCY, MOST_LATENCY);
        for (slot, anchor) in self.anchors.iter_mut().enumerate() {
            if let Some(anchor) = anchor {
                anchor.map_from_base = moved(&anchor.map_from_base, &three(anchor_at(slot)));
            }
        }
    }

    /// The pose with its covariance.
    pub(super) fn pose(&self) -> Result<UncertainPose<Se2>, Error> {
        UncertainPose::new(self.map_from_base, self.block(POSE, POSE))
    }

    /// Errors up to the last anchor that is there; the others are zero, and so are their covariances.
    pub(super) fn used(&self) -> usize {
        ANCHORS + 3 * self.anchors.iter().rposition(Option::is_some).map_or(0, |slot| slot + 1)
    }

    /// A square of three errors, or the covariance between two of them.
    pub(super) fn block(&self, row: usize, column: usize) -> Matrix3<f64> {
        Matrix3::from_fn(|i, j| self.covariance[column + j][row + i])
    }

    /// Puts the anchor to where the vehicle is now, fully correlated with it; `noise` is what makes it uncertain beside that.
    pub(super) fn drop_anchor(&mut self, slot: usize, own_from_sensor: Se2, noise: &Matrix3<f64>) {
        let at = anchor_at(slot);
        self.anchors[slot] = Some(Anchor { map_from_base: self.map_from_base, stamp: self.stamp, own_from_sensor });
        for i in 0..3 {
            self.covariance[at + i] = self.covariance[POSE + i];
        }
        for column in &mut self.covariance {
            for i in 0..3 {
                column[at + i] = column[POSE + i];
            }
        }
        for i in 0..3 {
            for j in 0..3 {
                self.covariance[at + j][at + i] += noise[(i, j)];
            }
        }
    }

    /// Forgets the anchor.
    pub(super) fn forget_anchor(&mut self, slot: usize) {
        let at = anchor_at(slot);
        self.anchors[slot] = None;
        for column in &mut self.covariance {
            column[at..at + 3].fill(0.0);
        }
        self.covariance[at..at + 3].fill([0.0; DIMENSION]);
    }

    /// Checks that the numbers can be those of a filter.
    #[cfg(feature = "serde")]
    pub(super) fn validate(&self) -> Result<(), agv_core::Error> {
        use agv_core::{Error, check};
        if !self.map_from_base.is_finite() || !self.anchors.iter().flatten().all(|a| a.map_from_base.is_finite()) {
            return Err(Error::NotFinite { name: "fused pose", value: f64::NAN });
        }
        check::all_finite("twist", Vector3::from(self.twist).iter())?;
        check::all_finite("acceleration", self.acceleration.iter())?;
        check::finite("gyro_bias", self.gyro_bias)?;
        check::in_range("distance_scale", self.distance_scale, -MOST_SCALE, MOST_SCALE)?;
        check::in_range("yaw_scale", self.yaw_scale, -MOST_SCALE, MOST_SCALE)?;
        check::in_range("latency", self.latency, -MOST_LATENCY, MOST_LATENCY)?;
        check::all_finite("covariance", self.covariance.iter().flatten())?;
        for (i, column) in self.covariance.iter().enumerate() {
            for (j, &entry) in column.iter().enumerate().take(i + 1) {
                // Clones of poses leave the matrix singular: a stricter check would refuse what rounding makes of that.
                let largest = (column[i] * self.covariance[j][j]).max(0.0).sqrt() * (1.0 + 1e-6) + 1e-12;
                let off = (entry - self.covariance[j][i]).abs();
                if column[i] < -1e-12 || entry.abs() > largest || off > 1e-9 * largest {
                    return Err(Error::NotCovariance { name: "covariance", pivot: entry });
                }
            }
        }
        Ok(())
    }
}
