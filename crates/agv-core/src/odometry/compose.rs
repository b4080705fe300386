//! Increments one after another.
//!
//! ```text
//! pose = a b            Σ = Ad(b)⁻¹ Σa Ad(b)⁻ᵀ + Σb
//! ```
//!
//! exact to first order in the errors, which are right increments (Solà et al., Eq. 54).

use super::{MotionIncrement, OdometryIncrement, increment::check_pose};
use crate::{
    Error, check,
    geometry::{LieGroup, Se2, propagate_covariance},
};
use nalgebra::Matrix3;

impl<G: LieGroup> MotionIncrement<G> {
    /// This motion followed by `next`, with the covariance of both. The time between the two counts as rest.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if either motion is not finite, [`Error::TimeBackwards`] if `next` starts before this one
    /// ends.
    ///
    /// ```
    /// # use agv_core::{geometry::Se2, odometry::OdometryIncrement, time::Stamp};
    /// let (t0, t1, t2) = (Stamp::from_seconds(0.0), Stamp::from_seconds(0.1), Stamp::from_seconds(0.2));
    /// let (a, b, c) = (Se2::new(0.0, 0.0, 0.0), Se2::new(0.1, 0.0, 0.2), Se2::new(0.2, 0.02, 0.3));
    /// let both = OdometryIncrement::between(t0, &a, t1, &b)?.then(&OdometryIncrement::between(t1, &b, t2, &c)?)?;
    /// assert!((both.start_from_end.translation() - c.translation()).norm() < 1e-12);
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    pub fn then(&self, next: &Self) -> Result<Self, Error> {
        for motion in [self, next] {
            check_pose("odometry motion", &motion.start_from_end)?;
            check::all_finite("odometry covariance", G::matrix_slice(&motion.covariance))?;
        }
        if next.start < self.end {
            let (earlier_ns, later_ns) = (self.end.nanoseconds(), next.start.nanoseconds());
            return Err(Error::TimeBackwards { earlier_ns, later_ns });
        }
        Ok(self.compose(next))
    }

    /// As [`then`](Self::then) without its checks, for a log whose clock steps backwards: from the start of this motion to
    /// the end of `next`.
    #[must_use]
    pub fn compose(&self, next: &Self) -> Self {
        let (jacobian, _) = self.start_from_end.compose_jacobians(&next.start_from_end);
        Self {
            start: self.start,
            end: next.end,
            start_from_end: self.start_from_end.compose(&next.start_from_end),
            covariance: propagate_covariance::<G>(&jacobian, &self.covariance) + next.covariance,
        }
    }
}

/// Gathers increments until someone asks: wheel odometry at 100 Hz for a filter at 10 Hz.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OdometryAccumulator {
    sum: Option<OdometryIncrement>,
}

impl OdometryAccumulator {
    /// Adds the motion that followed.
    ///
    /// # Errors
    /// As [`OdometryIncrement::then`]; what was gathered stays.
    pub fn push(&mut self, next: &OdometryIncrement) -> Result<(), Error> {
        // A motion of no duration in front validates the first increment like every other.
        let start = OdometryIncrement { end: next.start, ..*next };
        let first = OdometryIncrement { start_from_end: Se2::identity(), covariance: Matrix3::zeros(), ..start };
        self.sum = Some(self.sum.unwrap_or(first).then(next)?);
        Ok(())
    }

    /// What was gathered so far; `None` if nothing was.
    pub const fn motion(&self) -> Option<&OdometryIncrement> {
        self.sum.as_ref()
    }

    /// What was gathered, leaving nothing behind.
    pub fn take(&mut self) -> Option<OdometryIncrement> {
        self.sum.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Stamp;
    use proptest::prelude::*;

    fn increment(start: f64, pose: Se2, covariance: Matrix3<f64>) -> OdometryIncrement {
        let start = Stamp::from_seconds(start);
        OdometryIncrement { start, end: start + 0.1, start_from_end: pose, covariance }
    }

    proptest! {
        /// (a b) c = a (b c), in pose and covariance.
        #[test]
        fn composition_is_associative(v in prop::collection::vec(-1.0..1.0_f64, 9)) {
            let spread = Matrix3::new(2.0, 0.3, 0.1, 0.3, 1.0, 0.2, 0.1, 0.2, 0.5) * 0.01;
            let [a, b, c] = [0, 3, 6].map(|i| increment(i as f64, Se2::new(v[i], v[i + 1], v[i + 2]), spread));
            let left = a.then(&b).unwrap().then(&c).unwrap();
            let right = a.then(&b.then(&c).unwrap()).unwrap();
            prop_assert!(left.start_from_end.minus(&right.start_from_end).norm() < 1e-12);
            prop_assert!((left.covariance - right.covariance).norm() < 1e-12);
        }
    }

    /// A heading error of the first part becomes a sideways error over the second.
    #[test]
    fn heading_errors_grow_into_position_errors() {
        let turn = increment(0.0, Se2::default(), Matrix3::from_diagonal(&nalgebra::Vector3::new(0.0, 0.0, 0.01)));
        let both = turn.then(&increment(1.0, Se2::new(3.0, 0.0, 0.0), Matrix3::zeros())).unwrap();
        assert!((both.covariance[(1, 1)] - 0.09).abs() < 1e-12 && (both.covariance[(1, 2)] - 0.03).abs() < 1e-12);
    }

    #[test]
    fn bad_increments_are_refused_and_leave_the_sum() {
        let good = increment(0.0, Se2::new(1.0, 0.0, 0.0), Matrix3::zeros());
        let mut sum = OdometryAccumulator::default();
        assert!(sum.push(&increment(0.0, Se2::new(f64::NAN, 0.0, 0.0), Matrix3::zeros())).is_err());
        assert!(sum.push(&increment(0.0, Se2::default(), Matrix3::repeat(f64::INFINITY))).is_err());
        assert_eq!(sum.motion(), None);
        sum.push(&good).unwrap();
        assert!(matches!(sum.push(&good), Err(Error::TimeBackwards { .. })));
        assert_eq!(sum.take(), Some(good));
        assert_eq!(sum.take(), None);
    }
}
