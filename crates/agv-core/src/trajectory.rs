//! Trajectories: poses with times and velocities, what local planners roll out, optimise and draw.

use crate::{
    Error, check,
    geometry::{LieGroup, Se2, Twist2},
    kinematics::{Motion, MotionLimits},
};

/// Where a vehicle is at a time, and what it does then.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TrajectoryPoint {
    /// Time since the trajectory's beginning in the caller's sense, in seconds.
    pub time: f64,
    /// Pose of the base in the map.
    pub map_from_base: Se2,
    /// Twist and steering angle from here on, until the next point.
    pub motion: Motion,
}

/// Poses by time, in the map frame; each motion lasts until the next point.
///
/// Between two points the vehicle is on the arc that joins them: for a roll-out of constant twists that is the motion itself.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::trajectory::Trajectory;
///
/// // Two seconds on a circle of 2 m radius.
/// let mut arc = Trajectory::new();
/// arc.roll_out(&Se2::default(), &Twist2::new(1.0, 0.0, 0.5).into(), 0.1, 20)?;
/// assert!((arc.duration() - 2.0).abs() < 1e-12 && (arc.length() - 2.0).abs() < 1e-9);
/// let halfway = arc.at(1.0).unwrap();
/// assert!((halfway.map_from_base.yaw() - 0.5).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawTrajectory"))]
pub struct Trajectory {
    points: Vec<TrajectoryPoint>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawTrajectory {
    points: Vec<TrajectoryPoint>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawTrajectory> for Trajectory {
    type Error = Error;

    fn try_from(raw: RawTrajectory) -> Result<Self, Error> {
        let mut checked = Self::new();
        raw.points.into_iter().try_for_each(|point| checked.push(point))?;
        Ok(checked)
    }
}

impl Trajectory {
    /// A trajectory without points.
    pub const fn new() -> Self {
        Self { points: Vec::new() }
    }

    /// Appends a point.
    ///
    /// # Errors
    /// A pose, motion or time that is not finite, or a time that is not after the last point's; the trajectory is then as it
    /// was.
    pub fn push(&mut self, point: TrajectoryPoint) -> Result<(), Error> {
        let (pose, twist) = (point.map_from_base, point.motion.twist);
        check::finite("time", point.time)?;
        check::all_finite("map_from_base", &[pose.x(), pose.y(), pose.yaw()])?;
        check::all_finite("twist", &[twist.vx, twist.vy, twist.yaw_rate])?;
        check::all_finite("steering", point.motion.steering.iter())?;
        if let Some(last) = self.points.last() {
            check::positive("time since the last point", point.time - last.time)?;
        }
        self.points.push(point);
        Ok(())
    }

    /// Replaces the points by those of a constant motion from `map_from_base`: `steps` steps of `dt` seconds from time zero.
    ///
    /// # Errors
    /// A pose or motion that is not finite, or a `dt` that is not finite and positive; the trajectory is then empty.
    pub fn roll_out(&mut self, map_from_base: &Se2, motion: &Motion, dt: f64, steps: usize) -> Result<(), Error> {
        self.clear();
        check::positive("dt", dt)?;
        let step = motion.twist.integrate(dt);
        let mut point = TrajectoryPoint { time: 0.0, map_from_base: *map_from_base, motion: *motion };
        for i in 0..=steps {
            point.time = i as f64 * dt;
            if let Err(error) = self.push(point) {
                self.clear();
                return Err(error);
            }
            point.map_from_base = point.map_from_base.compose(&step);
        }
        Ok(())
    }

    /// Removes all points, keeping the memory.
    pub fn clear(&mut self) {
        self.points.clear();
    }

    /// The points, by time.
    pub fn points(&self) -> &[TrajectoryPoint] {
        &self.points
    }

    /// Number of points.
    pub const fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no points.
    pub const fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Time from the first point to the last, in seconds.
    pub fn duration(&self) -> f64 {
        self.points.first().zip(self.points.last()).map_or(0.0, |(first, last)| last.time - first.time)
    }

    /// Length of the arcs that the base is on, in metres.
    pub fn length(&self) -> f64 {
        self.points.windows(2).map(|w| Twist2::from(w[1].map_from_base.minus(&w[0].map_from_base)).speed()).sum()
    }

    /// The point at a time: the pose on the arc between its neighbours, the motion as it lasts then. Before the first and after
    /// the last point, those; none for no points or a time that is NaN. O(log points).
    pub fn at(&self, time: f64) -> Option<TrajectoryPoint> {
        if time.is_nan() {
            return None;
        }
        let next = self.points.partition_point(|point| point.time <= time);
        let after = self.points.get(next);
        let Some(before) = next.checked_sub(1).and_then(|i| self.points.get(i)) else { return after.copied() };
        let Some(after) = after else { return Some(*before) };
        let share = (time - before.time) / (after.time - before.time);
        let arc = after.map_from_base.minus(&before.map_from_base);
        Some(TrajectoryPoint {
            time,
            map_from_base: before.map_from_base.compose(&Se2::exp(&(arc * share))),
            ..*before
        })
    }

    /// The first point whose motion cannot be reached from its predecessor's within the limits, in the time between them; none
    /// if all can. From `current` to the first point it is checked over `dt` seconds.
    pub fn first_violation(&self, current: &Motion, dt: f64, limits: &MotionLimits) -> Option<usize> {
        let mut from = (*current, None);
        self.points.iter().position(|point| {
            let elapsed = from.1.map_or(dt, |before| point.time - before);
            let broken = !limits.allows_step(&from.0, &point.motion, elapsed);
            from = (point.motion, Some(point.time));
            broken
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point(time: f64, x: f64, vx: f64) -> TrajectoryPoint {
        TrajectoryPoint { time, map_from_base: Se2::new(x, 0.0, 0.0), motion: Twist2::new(vx, 0.0, 0.0).into() }
    }

    proptest! {
        /// A roll-out is the constant twist itself, at its points and between them.
        #[test]
        fn a_roll_out_is_the_motion(
            x in -3.0..3.0_f64, yaw in -3.0..3.0_f64, vx in -2.0..2.0_f64, vy in -1.0..1.0_f64, w in -2.0..2.0_f64,
            dt in 0.01..0.3_f64, share in 0.0..1.0_f64,
        ) {
            let (start, twist) = (Se2::new(x, 1.0, yaw), Twist2::new(vx, vy, w));
            let mut trajectory = Trajectory::new();
            trajectory.roll_out(&start, &twist.into(), dt, 10).unwrap();
            let time = share * trajectory.duration();
            let found = trajectory.at(time).unwrap();
            let difference = found.map_from_base.minus(&start.compose(&twist.integrate(time)));
            prop_assert!(difference.norm() < 1e-9 && found.motion.twist == twist);
            prop_assert!((trajectory.length() - 10.0 * dt * twist.speed()).abs() < 1e-9);
        }
    }

    #[test]
    fn times_beyond_the_ends_are_the_ends() {
        let mut trajectory = Trajectory::new();
        assert_eq!((trajectory.at(0.0), trajectory.duration(), trajectory.is_empty()), (None, 0.0, true));
        for (time, x) in [(1.0, 0.0), (2.0, 1.0), (4.0, 1.5)] {
            trajectory.push(point(time, x, 1.0)).unwrap();
        }
        assert_eq!(trajectory.at(-9.0), Some(point(1.0, 0.0, 1.0)));
        assert_eq!(trajectory.at(9.0), Some(point(4.0, 1.5, 1.0)));
        assert_eq!(trajectory.at(3.0).unwrap().map_from_base.x(), 1.25);
        assert_eq!(trajectory.at(f64::NAN), None);
    }

    #[test]
    fn a_jump_of_speed_is_found() {
        let limits = MotionLimits::default();
        let mut trajectory = Trajectory::new();
        for (time, vx) in [(0.0, 0.05), (0.1, 0.1), (0.2, 0.15), (0.3, 0.4)] {
            trajectory.push(point(time, time, vx)).unwrap();
        }
        assert_eq!(trajectory.first_violation(&Motion::REST, 0.1, &limits), Some(3));
        assert_eq!(trajectory.first_violation(&Motion::REST, 0.05, &limits), Some(0));
    }

    #[test]
    fn bad_points_are_refused() {
        let mut trajectory = Trajectory::new();
        trajectory.push(point(1.0, 0.0, 0.0)).unwrap();
        let good = trajectory.clone();
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(trajectory.push(point(bad, 0.0, 0.0)).is_err());
            assert!(trajectory.push(point(2.0, bad, 0.0)).is_err());
            assert!(trajectory.push(point(2.0, 0.0, bad)).is_err());
            assert!(Trajectory::new().roll_out(&Se2::default(), &Motion::REST, bad, 3).is_err());
            let angle = Motion { steering: Some(bad), ..Motion::REST };
            assert!(trajectory.push(TrajectoryPoint { motion: angle, ..point(2.0, 0.0, 0.0) }).is_err());
        }
        for time in [1.0, 0.5] {
            assert!(matches!(trajectory.push(point(time, 0.0, 0.0)), Err(Error::NotPositive { .. })));
        }
        assert_eq!(trajectory, good);
    }

    #[cfg(feature = "serde")]
    #[test]
    fn stored_trajectories_are_checked() {
        let mut trajectory = Trajectory::new();
        trajectory.roll_out(&Se2::default(), &Motion::REST, 0.5, 2).unwrap();
        let text = serde_json::to_string(&trajectory).unwrap();
        assert_eq!(serde_json::from_str::<Trajectory>(&text).unwrap(), trajectory);
        let points = vec![point(1.0, 0.0, 0.0), point(1.0, 0.0, 0.0)];
        assert!(Trajectory::try_from(RawTrajectory { points }).is_err());
    }
}
