//! What a step of odometry leaves open.

use super::LidarDrift;
use agv_core::{
    geometry::{PoseSigma, Se3, UncertainPose},
    nalgebra::{Matrix6, Vector6},
    roles::{Alignment, Termination},
};

/// Variances of each entry of a tangent.
pub(super) fn variances(sigma: PoseSigma) -> Matrix6<f64> {
    let PoseSigma { translation: t, rotation: r } = sigma;
    Matrix6::from_diagonal(&Vector6::new(t, t, t, r, r, r).map(|sigma| sigma * sigma))
}

/// Directions that a cloud did not fix: all of them for one that fits nowhere.
pub(super) fn unseen(alignment: Option<&Alignment<Se3>>) -> Matrix6<f64> {
    match alignment {
        None => Matrix6::zeros(),
        Some(found) if found.converged() || found.termination == Termination::Degenerate => found.unobserved,
        Some(_) => Matrix6::identity(),
    }
}

impl LidarDrift {
    /// A motion between two clouds with its covariance: that of a random walk, wider along directions that the second
    /// did not fix.
    pub(super) fn of(&self, motion: &Se3, alignment: Option<&Alignment<Se3>>) -> UncertainPose<Se3> {
        let way = motion.translation().norm();
        let turn = agv_core::geometry::LieGroup::log(&motion.rotation()).norm();
        let unseen = unseen(alignment);
        let covariance = variances(self.per_metre) * way
            + variances(self.per_radian) * turn
            + unseen * variances(self.unobserved) * unseen * (way + turn);
        UncertainPose::new(*motion, covariance).unwrap_or_else(|_| {
            // A projector that is none: nothing is known.
            let covariance = (variances(self.unobserved) + variances(self.per_metre)) * (way + turn);
            UncertainPose::new(*motion, covariance).unwrap_or_else(|_| UncertainPose::exact(*motion))
        })
    }
}
