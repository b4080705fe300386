//! Key nodes: the few points of a path that straight lines cannot do without (paper 002, "key node" strategy).
//!
//! From the first point on, the line to point `P[i]` is tried for growing `i`. At the first one that is blocked, `P[i-1]`
//! becomes a key node *and the start of the next line*. (The paper lets `P[i]` be the next start, which leaves the stretch
//! between the two unchecked.)

use super::{LineOfSight, LineOfSightParams, PathSmoother, straight::heading};
use crate::Error;
use agv_core::{
    geometry::Se2,
    grid::Costmap,
    path::{Path, PathPoint},
};

/// Straightens a path by leaving out points that a straight line can skip.
///
/// First and last pose stay as they are, and so does every cusp (a change of gear). Other headings look along the new
/// lines. A stretch of the given path that is itself not clear is kept. The result is never longer than the path. Time is
/// in proportion to the points times the cells of a line.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_plan::smooth::{KeyNodes, LineOfSightParams};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(20, 10, 0.5, Se2::default())?, CellState::Free));
/// let stairs: Vec<_> = (1..9).map(|i| Vector2::new(f64::from(i), f64::from(i / 2) * 0.5 + 0.5)).collect();
/// let mut straight = Path::new();
/// KeyNodes::new(LineOfSightParams::default())?.shorten_into(&map, &Path::from_positions(&stairs)?, &mut straight)?;
/// assert_eq!(straight.len(), 2);
/// # Ok::<(), agv_plan::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeyNodes {
    sight: LineOfSight,
}

impl KeyNodes {
    /// What new lines may cross.
    ///
    /// # Errors
    /// As [`LineOfSight::new`].
    pub fn new(params: LineOfSightParams) -> Result<Self, Error> {
        Ok(Self { sight: LineOfSight::new(params)? })
    }

    /// Writes the straightened path, reusing the memory of `short`.
    ///
    /// # Errors
    /// None for a valid path; kept for paths whose poses cannot be pushed.
    pub fn shorten_into(&self, costmap: &Costmap, path: &Path, short: &mut Path) -> Result<(), agv_core::Error> {
        short.clear();
        let points = path.points();
        let Some(first) = points.first() else { return Ok(()) };
        // A key node is written when the next one is known, which is what it looks at.
        let (mut anchor, mut anchor_is_first) = (first, true);
        let mut next = 1;
        while next < points.len() {
            let end = self.farthest(costmap, anchor, points, next);
            let Some(key) = points.get(end) else { break };
            short.push(if anchor_is_first { *anchor } else { looking_at(anchor, key) })?;
            (anchor, anchor_is_first, next) = (key, false, end + 1);
        }
        // The last pose as it was given.
        short.push(*anchor)?;
        Ok(())
    }

    /// Index of the last point before the first one, from `next` on, that is not seen from the anchor; `next` if there is
    /// none. Lines do not go past a cusp.
    fn farthest(&self, costmap: &Costmap, anchor: &PathPoint, points: &[PathPoint], next: usize) -> usize {
        let from = anchor.pose.translation();
        let gear = points.get(next).map(|p| p.gear);
        let seen = points.iter().skip(next).take_while(|point| {
            Some(point.gear) == gear && self.sight.is_clear(costmap, &from, &point.pose.translation())
        });
        next + seen.count().saturating_sub(1)
    }
}

impl PathSmoother for KeyNodes {
    fn smooth_into(&mut self, costmap: &Costmap, path: &Path, smooth: &mut Path) -> Result<(), agv_core::Error> {
        self.shorten_into(costmap, path, smooth)
    }
}

/// The point with the heading of the line to the next one.
fn looking_at(point: &PathPoint, next: &PathPoint) -> PathPoint {
    let position = point.pose.translation();
    heading(position, next.pose.translation(), next.gear)
        .map_or(*point, |heading| PathPoint { pose: Se2::from_parts(position, heading), gear: point.gear })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{AStar, AStarParams};
    use agv_core::{
        geometry::So2,
        grid::{Cell, CellState, Grid, GridLayout},
        path::Gear,
        roles::{GlobalPlanner, PlanOutcome},
    };
    use proptest::prelude::*;

    proptest! {
        /// On planned paths: never longer, ends kept, every line clear, key nodes taken from the path.
        #[test]
        fn planned_paths_become_shorter_and_stay_clear(blocked in proptest::collection::vec(any::<bool>(), 144)) {
            let layout = GridLayout::new(12, 12, 0.5, Se2::new(-2.0, 1.0, 0.2)).unwrap();
            let mut flags = blocked.chunks(2).map(|pair| pair[0] && pair[1]).chain([false; 72]);
            let states = (0..144).map(|i| if i % 2 == 1 && flags.next() == Some(true) { CellState::Occupied } else { CellState::Free });
            let costmap = Costmap::from_map(&Grid::new(layout, states.collect()).unwrap());
            let pose = |x, y, yaw| Se2::from_parts(layout.center(Cell::new(x, y)), So2::from_angle(yaw));
            let (start, goal) = (pose(0, 0, 1.0), pose(10, 11, 2.0));
            let (mut path, mut short) = (Path::new(), Path::new());
            let outcome =
                AStar::new(AStarParams::default()).unwrap().plan_into(&costmap, &start, &goal, &mut path).unwrap();
            if let PlanOutcome::Found { .. } = outcome {
                let keys = KeyNodes::new(LineOfSightParams::default()).unwrap();
                keys.shorten_into(&costmap, &path, &mut short).unwrap();
                prop_assert!(short.length() <= path.length() + 1e-9);
                prop_assert_eq!(short.points()[0].pose, start);
                prop_assert_eq!(short.points()[short.len() - 1].pose, goal);
                for pair in short.points().windows(2) {
                    let (a, b) = (pair[0].pose.translation(), pair[1].pose.translation());
                    prop_assert!(keys.sight.is_clear(&costmap, &a, &b));
                    prop_assert!(path.points().iter().any(|p| p.pose.translation() == b));
                }
            }
        }
    }

    #[test]
    fn cusps_stay_and_reverse_headings_point_back() {
        let layout = GridLayout::new(20, 20, 1.0, Se2::default()).unwrap();
        let costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        let (mut path, mut short) = (Path::new(), Path::new());
        for (x, gear) in [(1.0, Gear::Forward), (5.0, Gear::Forward), (9.0, Gear::Forward), (6.0, Gear::Reverse)] {
            path.push(PathPoint { pose: Se2::new(x, 4.0, 0.0), gear }).unwrap();
        }
        path.push(PathPoint { pose: Se2::new(2.0, 4.0, 0.0), gear: Gear::Reverse }).unwrap();
        KeyNodes::new(LineOfSightParams::default()).unwrap().shorten_into(&costmap, &path, &mut short).unwrap();
        let xs: Vec<f64> = short.points().iter().map(|p| p.pose.x()).collect();
        assert_eq!(xs, [1.0, 9.0, 2.0]);
        assert!(short.points().iter().all(|p| p.pose.yaw().abs() < 1e-12));
        assert_eq!(short.points()[2].gear, Gear::Reverse);
    }

    #[test]
    fn bad_parameters_and_empty_paths() {
        assert!(KeyNodes::new(LineOfSightParams { margin: -0.1, ..Default::default() }).is_err());
        let layout = GridLayout::new(2, 2, 1.0, Se2::default()).unwrap();
        let costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        let mut short = Path::from_positions(&[nalgebra::Vector2::zeros()]).unwrap();
        KeyNodes::new(LineOfSightParams::default()).unwrap().shorten_into(&costmap, &Path::new(), &mut short).unwrap();
        assert!(short.is_empty());
    }
}
