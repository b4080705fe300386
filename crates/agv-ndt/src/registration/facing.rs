//! Which directions the points of a source face, and which none of them do.

use super::quadratic::{MotionSums, PointDerivatives};
use agv_core::geometry::{PoseSigma, Se3, unobserved_directions};
use nalgebra::{Matrix3, Matrix6, Vector3};

/// Longest arm, in metres, at which rotations are compared with translations: a corridor's walls hold the roll, though nearly all of
/// its points are far ahead.
const ARM: f64 = 2.0;

/// Sums over points of `JᵀFJ`, where `F` has eigenvalue 1 along what the point's surface fixes and 0 along the rest.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Facing {
    sums: MotionSums,
    squared_distance: f64,
}

impl Facing {
    /// Adds a point at `y = R p`.
    pub(crate) fn add(&mut self, y: &Vector3<f64>, fixed: &Matrix3<f64>) {
        self.squared_distance += y.norm_squared();
        let facing = PointDerivatives { cost: 0.0, gradient: Vector3::zeros(), hessian: *fixed, curvature: 0.0 };
        self.sums.add(y, &facing);
    }

    pub(crate) fn merged(self, other: Self) -> Self {
        Self { sums: self.sums.merged(other.sums), squared_distance: self.squared_distance + other.squared_distance }
    }

    /// Projector onto the directions, among those of the projector `free`, that less than `min_share` of the points face: their
    /// eigenvalues are shares, rotations at an arm of 2 m or the root mean square of the points' distances (Zhang, Kaess and Singh 2016, with a
    /// threshold without unit).
    pub(crate) fn unobserved(&self, pose: &Se3, min_share: f64, free: &Matrix6<f64>) -> Matrix6<f64> {
        let counted = self.sums.matches.max(1) as f64;
        let arm = (self.squared_distance / counted).sqrt().clamp(1e-3, ARM);
        let shares = self.sums.quadratic(pose).hessian / (counted * min_share);
        let fixed = (Matrix6::identity() - free) * (10.0 + shares.trace());
        let shares = free * shares * free + (fixed + fixed.transpose()) * 0.5;
        let shares = (shares + shares.transpose()) * 0.5;
        let sigma = PoseSigma { translation: 1.0, rotation: 1.0 / arm };
        unobserved_directions::<Se3>(&shares, sigma).unwrap_or(*free)
    }
}
