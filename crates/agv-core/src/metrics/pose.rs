//! What the metrics need of a pose beyond the group: distances, and the best fit of two sets of positions.

use crate::geometry::{LieGroup, Se2, Se3, So2, So3};
use nalgebra::{Matrix3, Vector2, Vector3};

/// A pose that trajectories are made of: [`Se2`] or [`Se3`].
pub trait TrajectoryPose: LieGroup {
    /// Length of the translation, in metres.
    fn distance(&self) -> f64;

    /// Angle of the rotation, in [0, π] radians.
    fn angle(&self) -> f64;

    /// The motion that brings the positions of the second poses closest to those of the first ones, in the sense of
    /// least squares and without scale (Horn 1987, Umeyama 1991). The identity if there are none; where the positions
    /// leave a turn open, one of the best.
    fn fit(pairs: impl Iterator<Item = (Self, Self)> + Clone) -> Self;
}

impl TrajectoryPose for Se2 {
    fn distance(&self) -> f64 {
        self.translation().norm()
    }

    fn angle(&self) -> f64 {
        self.yaw().abs()
    }

    fn fit(pairs: impl Iterator<Item = (Self, Self)> + Clone) -> Self {
        let positions = pairs.map(|(to, from)| (to.translation(), from.translation()));
        let (count, to, from) = sums(positions.clone(), Vector2::zeros());
        let (to, from) = (to / count, from / count);
        // The turn that maximises Σ aᵀ R b is the angle of the sum of dot and cross products.
        let (dot, cross) = positions.fold((0.0, 0.0), |(dot, cross), (a, b)| {
            let (a, b) = (a - to, b - from);
            (dot + b.dot(&a), cross + b.perp(&a))
        });
        let rotation = So2::from_direction(dot, cross);
        Self::from_parts(to - rotation.act(&from), rotation)
    }
}

impl TrajectoryPose for Se3 {
    fn distance(&self) -> f64 {
        self.translation().norm()
    }

    fn angle(&self) -> f64 {
        self.rotation().log().norm()
    }

    fn fit(pairs: impl Iterator<Item = (Self, Self)> + Clone) -> Self {
        let positions = pairs.map(|(to, from)| (to.translation(), from.translation()));
        let (count, to, from) = sums(positions.clone(), Vector3::zeros());
        let (to, from) = (to / count, from / count);
        let moment = positions.fold(Matrix3::zeros(), |sum, (a, b)| sum + (a - to) * (b - from).transpose());
        let rotation = So3::nearest(&moment).map_or_else(So3::default, |(rotation, _)| rotation);
        Self::from_parts(to - rotation.act(&from), rotation)
    }
}

/// Number of pairs, at least one, and the sums of both sides.
fn sums<V: std::ops::Add<Output = V> + Copy>(pairs: impl Iterator<Item = (V, V)>, zero: V) -> (f64, V, V) {
    let (count, to, from) = pairs.fold((0.0, zero, zero), |(n, a, b), (x, y)| (n + 1.0, a + x, b + y));
    (f64::max(count, 1.0), to, from)
}
