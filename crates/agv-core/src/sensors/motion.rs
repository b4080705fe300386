//! How the base moved while a sensor swept: at one twist, or along known poses.

use crate::{
    Error, check,
    geometry::{LieGroup, Se2, Se3, Twist2, Twist3},
    odometry::OdometryIncrement,
    time::Stamp,
};

/// The motion of the base around a reference time, to which a sweep is brought.
pub trait BodyMotion<G> {
    /// The time in whose base frame all is expressed.
    fn reference(&self) -> Stamp;

    /// Pose of the base `dt` seconds after the reference time (before it, if negative), in the base frame of the
    /// reference time. Sub-nanosecond times are not rounded.
    fn reference_from_base(&self, dt: f64) -> G;
}

/// A motion at one twist: the arc of a short sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstantTwist<G: LieGroup> {
    reference: Stamp,
    tangent: G::Tangent,
}

impl ConstantTwist<Se2> {
    /// The motion of a vehicle on a floor.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn planar(reference: Stamp, twist: &Twist2) -> Result<Self, Error> {
        Self::new(reference, (*twist).into())
    }

    /// The motion that an odometry increment states, held constant over its span and around it.
    ///
    /// # Errors
    /// An increment that is not finite, or whose span is not positive.
    pub fn from_odometry(reference: Stamp, motion: &OdometryIncrement) -> Result<Self, Error> {
        let dt = check::positive("duration of the motion", motion.dt())?;
        Self::new(reference, motion.start_from_end.log() * (1.0 / dt))
    }
}

impl ConstantTwist<Se3> {
    /// The motion of a body in space.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn spatial(reference: Stamp, twist: &Twist3) -> Result<Self, Error> {
        Self::new(reference, (*twist).into())
    }
}

impl<G: LieGroup> ConstantTwist<G> {
    fn new(reference: Stamp, tangent: G::Tangent) -> Result<Self, Error> {
        check::all_finite("twist", G::tangent_slice(&tangent))?;
        Ok(Self { reference, tangent })
    }
}

impl<G: LieGroup> BodyMotion<G> for ConstantTwist<G> {
    fn reference(&self) -> Stamp {
        self.reference
    }

    #[inline]
    fn reference_from_base(&self, dt: f64) -> G {
        G::exp(&(self.tangent * dt))
    }
}

/// A motion through known poses, along geodesics between them; the first and the last piece are continued outwards.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::sensors::{BodyMotion, PoseTrack};
/// use agv_core::time::Stamp;
///
/// let poses = [(Stamp::from_seconds(0.0), Se2::new(0.0, 0.0, 0.0)), (Stamp::from_seconds(0.1), Se2::new(0.2, 0.0, 0.0))];
/// let track = PoseTrack::new(&poses, Stamp::from_seconds(0.1))?;
/// assert!((track.reference_from_base(-0.05).x() + 0.1).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseTrack<'a, G> {
    poses: &'a [(Stamp, G)],
    reference: Stamp,
    reference_from_odom: G,
}

impl<'a, G: LieGroup> PoseTrack<'a, G> {
    /// A motion through `poses` of the base in any fixed frame, in order of time.
    ///
    /// # Errors
    /// [`Error::TooFew`] below two poses, [`Error::TimeBackwards`] for stamps that do not increase, and
    /// [`Error::NotFinite`] for a pose that is not.
    pub fn new(poses: &'a [(Stamp, G)], reference: Stamp) -> Result<Self, Error> {
        check::at_least("poses", poses.len(), 2)?;
        for (before, after) in poses.iter().zip(poses.iter().skip(1)) {
            if after.0 <= before.0 {
                let (earlier_ns, later_ns) = (before.0.nanoseconds(), after.0.nanoseconds());
                return Err(Error::TimeBackwards { earlier_ns, later_ns });
            }
        }
        if !poses.iter().all(|(_, pose)| pose.is_finite()) {
            return Err(Error::NotFinite { name: "pose of the track", value: f64::NAN });
        }
        let mut track = Self { poses, reference, reference_from_odom: G::identity() };
        track.reference_from_odom = track.reference_from_base(0.0).inverse();
        Ok(track)
    }
}

impl<G: LieGroup> BodyMotion<G> for PoseTrack<'_, G> {
    fn reference(&self) -> Stamp {
        self.reference
    }

    fn reference_from_base(&self, dt: f64) -> G {
        // The piece whose end is the first stamp after the wanted one; the outermost pieces serve what is outside.
        let after = self.poses.partition_point(|(stamp, _)| *stamp - self.reference <= dt);
        let end = after.clamp(1, self.poses.len() - 1);
        let ((start, a), (stop, b)) = (self.poses[end - 1], self.poses[end]);
        let fraction = (dt - (start - self.reference)) / (stop - start);
        self.reference_from_odom.compose(&a.interpolate(&b, fraction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// Poses sampled from a constant twist are that twist again, inside, between and outside of the samples.
    #[test]
    fn a_track_of_an_arc_is_the_arc() {
        let (twist, reference) = (Twist2::new(1.2, 0.0, 0.9), Stamp::from_seconds(5.05));
        let start = Se2::new(3.0, -1.0, 2.0);
        let poses = [0.0, 0.03, 0.07, 0.1].map(|t| (Stamp::from_seconds(5.0 + t), start.compose(&twist.integrate(t))));
        let track = PoseTrack::new(&poses, reference).unwrap();
        let arc = ConstantTwist::planar(reference, &twist).unwrap();
        for dt in [-0.08, -0.05, -0.01, 0.0, 0.02, 0.05, 0.09] {
            let difference = track.reference_from_base(dt).minus(&arc.reference_from_base(dt));
            assert!(difference.norm() < 1e-9, "{dt} {difference}");
        }
    }

    #[test]
    fn odometry_states_a_twist() {
        let (t, dt) = (Stamp::from_seconds(1.0), 0.2);
        let end = Se2::exp(&Vector3::new(0.2, 0.0, 0.1));
        let motion = OdometryIncrement::between(t, &Se2::default(), t + dt, &end).unwrap();
        let arc = ConstantTwist::from_odometry(t + dt, &motion).unwrap();
        assert!(arc.reference_from_base(-dt).minus(&end.inverse()).norm() < 1e-12);
        let still = OdometryIncrement { end: t, ..motion };
        assert!(ConstantTwist::from_odometry(t, &still).is_err());
    }

    #[test]
    fn bad_motions_are_refused() {
        let t = Stamp::from_seconds;
        let good = (t(0.0), Se2::default());
        assert!(PoseTrack::new(&[good], t(0.0)).is_err());
        assert!(PoseTrack::new(&[good, good], t(0.0)).is_err());
        assert!(PoseTrack::new(&[good, (t(1.0), Se2::new(f64::NAN, 0.0, 0.0))], t(0.0)).is_err());
        assert!(ConstantTwist::planar(t(0.0), &Twist2::new(0.0, f64::NAN, 0.0)).is_err());
        let spin = Twist3 { angular: Vector3::repeat(f64::INFINITY), ..Default::default() };
        assert!(ConstantTwist::spatial(t(0.0), &spin).is_err());
    }
}
