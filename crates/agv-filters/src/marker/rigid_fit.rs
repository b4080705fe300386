//! The rigid motion of the plane that carries points onto measured points, weighted by the measured points' covariances.

use agv_core::{
    check,
    geometry::{LieGroup, Se2, UncertainPose},
    solve::NormalEquations,
};
use nalgebra::{Matrix2, Vector2};

/// At most `N` points to be fitted, each with the information of its measurement.
#[derive(Debug, Clone, Copy)]
pub(super) struct RigidFit<const N: usize> {
    points: [(Vector2<f64>, Vector2<f64>, Matrix2<f64>); N],
    count: usize,
}

/// A fitted motion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fitted {
    pub(super) pose: UncertainPose<Se2>,
    pub(super) chi_square: f64,
}

impl<const N: usize> Default for RigidFit<N> {
    fn default() -> Self {
        Self { points: [(Vector2::zeros(), Vector2::zeros(), Matrix2::zeros()); N], count: 0 }
    }
}

/// Most Gauss–Newton steps; three are usual.
const MAX_STEPS: usize = 20;

impl<const N: usize> RigidFit<N> {
    /// Adds a point of the source frame and where it was measured in the target frame; none for a covariance that cannot be
    /// inverted, or one point too many.
    pub(super) fn add(&mut self, source: Vector2<f64>, target: Vector2<f64>, covariance: &Matrix2<f64>) -> Option<()> {
        let information = covariance.cholesky()?.inverse();
        *self.points.get_mut(self.count)? = (source, target, information);
        self.count += 1;
        Some(())
    }

    /// Minimises `Σ |target - T source|²`, weighted, from a start that is near; none if the points leave the pose open.
    pub(super) fn solve(&self, start: &Se2) -> Option<Fitted> {
        let mut pose = *start;
        for _ in 0..MAX_STEPS {
            let normal = self.linearized(&pose);
            check::positive_definite("hessian", &normal.hessian).ok()?;
            let step = normal.hessian.cholesky()?.solve(&-normal.gradient);
            pose = pose.plus(&step);
            if step.norm() <= 1e-12 * (1.0 + pose.translation().norm()) {
                break;
            }
        }
        let normal = self.linearized(&pose);
        let covariance = Se2::inverse_of(&normal.hessian)?;
        let pose = UncertainPose::new(pose, covariance).ok()?;
        Some(Fitted { pose, chi_square: 2.0 * normal.cost })
    }

    fn linearized(&self, pose: &Se2) -> NormalEquations<3> {
        let mut normal = NormalEquations::<3>::zeros();
        for (source, target, information) in self.points.iter().take(self.count) {
            let (by_pose, _) = pose.act_jacobians(source);
            let residual = pose.act(source) - target;
            let weighted = by_pose.transpose() * information;
            normal.hessian += weighted * by_pose;
            normal.gradient += weighted * residual;
            normal.cost += 0.5 * residual.dot(&(information * residual));
        }
        normal
    }
}

/// Points nearer to each other than this share of their distance from the origin are one: the rest is rounding.
const DISTINCT: f64 = 1e-9;

/// The unweighted fit in closed form (Umeyama 1991, without scale): none without two distinct points.
pub(super) fn rigid_motion(pairs: impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + Clone) -> Option<Se2> {
    let (mut sources, mut targets, mut count) = (Vector2::zeros(), Vector2::zeros(), 0.0);
    for (source, target) in pairs.clone() {
        (sources, targets, count) = (sources + source, targets + target, count + 1.0);
    }
    let (sources, targets) = (sources / f64::max(count, 1.0), targets / f64::max(count, 1.0));
    let (mut cos, mut sin, mut scale) = (0.0, 0.0, 0.0);
    let mut is_spread = [false; 2];
    for (source, target) in pairs {
        let (a, b) = (source - sources, target - targets);
        cos += a.dot(&b);
        sin += a.perp(&b);
        scale += a.norm() * b.norm();
        is_spread[0] |= a.norm() > DISTINCT * source.norm();
        is_spread[1] |= b.norm() > DISTINCT * target.norm();
    }
    let turned = f64::hypot(cos, sin);
    (is_spread == [true; 2] && turned > DISTINCT * scale && turned.is_finite()).then(|| {
        let yaw = f64::atan2(sin, cos);
        let rotation = Se2::new(0.0, 0.0, yaw);
        let place = targets - rotation * sources;
        Se2::new(place.x, place.y, yaw)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn exact_points_give_the_motion(
            (x, y, yaw) in (-5.0..5.0_f64, -5.0..5.0_f64, -3.1..3.1_f64),
            points in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64), 3..8),
        ) {
            let truth = Se2::new(x, y, yaw);
            let pairs: Vec<_> = points.iter().map(|&(a, b)| Vector2::new(a, b)).map(|p| (p, truth * p)).collect();
            prop_assume!((pairs[0].0 - pairs[1].0).norm() > 0.1);
            let closed = rigid_motion(pairs.iter().copied()).unwrap();
            prop_assert!(closed.minus(&truth).norm() < 1e-9);
            let mut fit = RigidFit::<8>::default();
            for (i, (source, target)) in pairs.iter().enumerate() {
                fit.add(*source, *target, &Matrix2::new(1.0 + i as f64, 0.2, 0.2, 0.5)).unwrap();
            }
            let found = fit.solve(&Se2::new(x + 0.1, y - 0.1, yaw + 0.2)).unwrap();
            prop_assert!(found.pose.mean().minus(&truth).norm() < 1e-9 && found.chi_square < 1e-15);
        }
    }

    #[test]
    fn what_leaves_the_pose_open_has_no_fit() {
        let point = Vector2::new(1.0, 2.0);
        assert!(rigid_motion([(point, point)].into_iter()).is_none());
        // The mean of like numbers is not always that number.
        for i in 0..200 {
            let place = Vector2::new(0.1 + 0.37 * f64::from(i), 3.3 - 0.71 * f64::from(i));
            assert!(rigid_motion([(place, point); 3].into_iter()).is_none(), "{place}");
            assert!(rigid_motion([(point, place), (point * 2.0, place), (point * 3.0, place)].into_iter()).is_none());
        }
        assert!(rigid_motion(std::iter::empty()).is_none());
        assert!(rigid_motion([(point, point * f64::NAN), (point, point)].into_iter()).is_none());
        let mut fit = RigidFit::<8>::default();
        assert!(fit.add(point, point, &Matrix2::zeros()).is_none());
        fit.add(point, point, &Matrix2::identity()).unwrap();
        assert!(fit.solve(&Se2::default()).is_none());
    }
}
