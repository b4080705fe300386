//! Paths: the poses that a planner hands to a tracker.

mod course;
pub mod shapes;
mod speed;

use crate::{
    Error,
    geometry::{LieGroup, Se2},
};
pub use course::{Bend, Course, Leg, Projection};
use nalgebra::Vector2;
pub use speed::SpeedProfile;

/// Which way a vehicle drives along a stretch of path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Gear {
    /// Nose first.
    #[default]
    Forward,
    /// Tail first: the pose's heading points against the motion.
    Reverse,
}

/// One pose of a path, to be reached by a straight line, or by a turn on the spot if it has the position of the one before.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PathPoint {
    /// Pose of the base in the map frame.
    pub pose: Se2,
    /// How the stretch that ends here is driven. Where it changes, the vehicle stops: a cusp. Of no meaning in a turn.
    pub gear: Gear,
}

/// A path as a sequence of poses in the map frame, joined by straight lines.
///
/// Two points of one position and different headings are a turn on the spot: the vehicle stops there, turns the shorter way to
/// the second heading, and goes on. A point that repeats the one before says nothing. The last heading is the one to arrive
/// with: where it is not that of the last line, the vehicle turns on the spot at the end, if it can.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
///
/// let path = Path::from_positions(&[Vector2::new(0.0, 0.0), Vector2::new(3.0, 0.0), Vector2::new(3.0, 4.0)])?;
/// assert_eq!(path.length(), 7.0);
/// assert_eq!(path.points()[1].pose.yaw(), std::f64::consts::FRAC_PI_2); // headings look ahead
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawPath"))]
pub struct Path {
    points: Vec<PathPoint>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawPath {
    points: Vec<PathPoint>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawPath> for Path {
    type Error = Error;

    fn try_from(raw: RawPath) -> Result<Self, Error> {
        raw.points.iter().try_for_each(check_point)?;
        Ok(Self { points: raw.points })
    }
}

/// Difference of headings, in radians, that is no turn but rounding.
const SAME_HEADING: f64 = 1e-6;

fn check_point(point: &PathPoint) -> Result<(), Error> {
    let pose = point.pose;
    crate::check::all_finite("path pose", &[pose.x(), pose.y(), pose.yaw()])
}

impl Path {
    /// A path without points, to be filled by a planner.
    pub const fn new() -> Self {
        Self { points: Vec::new() }
    }

    /// A forward path through the positions, in metres; each heading looks towards the next position, the last keeps
    /// its predecessor's.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn from_positions(positions: &[Vector2<f64>]) -> Result<Self, Error> {
        let mut path = Self::new();
        path.set_positions(positions.iter().copied())?;
        Ok(path)
    }

    /// Refills the path as [`from_positions`](Self::from_positions) does, keeping its memory.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; the path is then empty.
    pub fn set_positions(&mut self, positions: impl IntoIterator<Item = Vector2<f64>>) -> Result<(), Error> {
        self.points.clear();
        for position in positions {
            if let Some(bad) = position.iter().find(|v| !v.is_finite()) {
                self.points.clear();
                return Err(Error::NotFinite { name: "path position", value: *bad });
            }
            if let Some(last) = self.points.last().map(|point| point.pose.translation()) {
                let ahead = position - last;
                // A repeated position has no direction: keep the heading that is there.
                if ahead != Vector2::zeros() {
                    let pose = Se2::new(last.x, last.y, ahead.y.atan2(ahead.x));
                    // All that repeat it face the same way: another heading in one place would be a turn on the spot.
                    let repeated = self.points.iter_mut().rev().take_while(|point| point.pose.translation() == last);
                    repeated.for_each(|point| point.pose = pose);
                }
            }
            let yaw = self.points.last().map_or(0.0, |p| p.pose.yaw());
            self.points.push(PathPoint { pose: Se2::new(position.x, position.y, yaw), gear: Gear::Forward });
        }
        Ok(())
    }

    /// Appends a pose.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; the path is then as it was.
    pub fn push(&mut self, point: PathPoint) -> Result<(), Error> {
        check_point(&point)?;
        self.points.push(point);
        Ok(())
    }

    /// Appends a turn on the spot to a heading, in radians; to an empty path nothing.
    ///
    /// ```
    /// use agv_core::nalgebra::Vector2;
    /// use agv_core::path::Path;
    ///
    /// let mut path = Path::from_positions(&[Vector2::new(0.0, 0.0), Vector2::new(3.0, 0.0)])?;
    /// path.push_turn(std::f64::consts::FRAC_PI_2)?;
    /// assert!(path.is_turn(2) && !path.is_turn(1));
    /// assert_eq!(path.length(), 3.0);
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::NotFinite`]; the path is then as it was.
    pub fn push_turn(&mut self, yaw: f64) -> Result<(), Error> {
        crate::check::finite("yaw", yaw)?;
        self.points.last().copied().map_or(Ok(()), |PathPoint { pose, gear }| {
            self.push(PathPoint { pose: Se2::new(pose.x(), pose.y(), yaw), gear })
        })
    }

    /// Whether the point of this index is reached by a turn on the spot: it has the position of the one before, and another
    /// heading (by more than a microradian).
    pub fn is_turn(&self, index: usize) -> bool {
        let pose = |i: usize| self.points.get(i).map(|point| point.pose);
        let pair = index.checked_sub(1).and_then(pose).zip(pose(index));
        pair.is_some_and(|(a, b)| {
            let turn = a.rotation().inverse().compose(&b.rotation()).angle();
            a.translation() == b.translation() && turn.abs() > SAME_HEADING
        })
    }

    /// Removes all points, keeping the memory.
    pub fn clear(&mut self) {
        self.points.clear();
    }

    /// The poses, from start to goal.
    pub fn points(&self) -> &[PathPoint] {
        &self.points
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Length along the straight lines, in metres.
    pub fn length(&self) -> f64 {
        self.points.windows(2).map(|w| (w[1].pose.translation() - w[0].pose.translation()).norm()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_positions_keep_the_heading() {
        let p = Vector2::new(1.0, 1.0);
        let path = Path::from_positions(&[Vector2::zeros(), p, p]).unwrap();
        let yaw = std::f64::consts::FRAC_PI_4;
        assert!(path.points().iter().all(|q| (q.pose.yaw() - yaw).abs() < 1e-12));
    }

    #[test]
    fn repeated_positions_are_no_turns() {
        let corner = [(0.0, 0.0), (0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (1.0, 0.0), (1.0, 2.0)];
        let path = Path::from_positions(&corner.map(|(x, y)| Vector2::new(x, y))).unwrap();
        assert!((0..path.len()).all(|i| !path.is_turn(i)), "{path:?}");
    }

    #[test]
    fn turns_are_told_from_repeated_points() {
        let mut path = Path::new();
        assert!(path.push_turn(1.0).is_ok() && path.is_empty() && !path.is_turn(0));
        for yaw in [0.0, 0.0, 1.0] {
            path.push(PathPoint { pose: Se2::new(1.0, 2.0, yaw), gear: Gear::Reverse }).unwrap();
        }
        assert_eq!([0, 1, 2, 3].map(|i| path.is_turn(i)), [false, false, true, false]);
        path.push_turn(-1.0).unwrap();
        assert!(path.is_turn(3) && path.points()[3].gear == Gear::Reverse);
        assert!(path.push_turn(f64::NAN).is_err() && path.len() == 4);
    }

    #[test]
    fn a_position_that_is_not_finite_is_refused() {
        assert!(Path::from_positions(&[Vector2::zeros(), Vector2::new(f64::NAN, 0.0)]).is_err());
        assert!(Path::new().push(PathPoint { pose: Se2::new(0.0, f64::INFINITY, 0.0), gear: Gear::Forward }).is_err());
    }

    #[cfg(feature = "serde")]
    #[test]
    fn stored_paths_are_checked() {
        let bad = Se2::new(0.0, f64::INFINITY, 0.0);
        assert!(Path::try_from(RawPath { points: vec![PathPoint { pose: bad, gear: Gear::Forward }] }).is_err());
        let path = Path::from_positions(&[Vector2::zeros(), Vector2::new(1.0, 2.0)]).unwrap();
        assert_eq!(serde_json::from_str::<Path>(&serde_json::to_string(&path).unwrap()).unwrap(), path);
    }
}
