//! How far from its path a vehicle truly is.

use agv_core::path::Path;
use nalgebra::Vector2;

/// How far along the path the nearest point is looked for, before and behind the last, in metres.
const REACH: f64 = 0.5;

/// Distance from a path, followed along it: where the path crosses itself, the branch that is being driven counts. At a cusp
/// both branches do, the nearer of the two.
///
/// Exact to the path's straight lines, by brute force over all of them within half a metre of path around the last nearest
/// point; independent of how trackers find theirs.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossTrack {
    positions: Vec<Vector2<f64>>,
    arc_lengths: Vec<f64>,
    nearest: usize,
}

impl CrossTrack {
    /// At the beginning of a path.
    pub fn new(path: &Path) -> Self {
        let mut positions: Vec<_> = path.points().iter().map(|point| point.pose.translation()).collect();
        positions.dedup();
        let mut arc_lengths = vec![0.0; positions.len()];
        for i in 1..positions.len() {
            arc_lengths[i] = arc_lengths[i - 1] + (positions[i] - positions[i - 1]).norm();
        }
        Self { positions, arc_lengths, nearest: 0 }
    }

    /// Distance of a position from the path, in metres; positive to the left of the direction in which the path runs.
    /// Zero for a path of fewer than two points.
    pub fn at(&mut self, position: &Vector2<f64>) -> f64 {
        let here = self.arc_lengths.get(self.nearest).copied().unwrap_or(0.0);
        let first = self.arc_lengths.partition_point(|&s| s < here - REACH).saturating_sub(1);
        let mut best = (f64::INFINITY, self.nearest, 0.0);
        for i in first..self.positions.len().saturating_sub(1) {
            if self.arc_lengths[i] > here + REACH {
                break;
            }
            let (along, offset) = (self.positions[i + 1] - self.positions[i], position - self.positions[i]);
            let share = (along.dot(&offset) / along.norm_squared()).clamp(0.0, 1.0);
            let distance = (offset - along * share).norm();
            if distance < best.0 {
                best = (distance, i, along.perp(&offset));
            }
        }
        self.nearest = best.1;
        if best.0.is_finite() { best.0.copysign(best.2) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::path::shapes;

    #[test]
    fn the_branch_that_is_driven_counts() {
        let eight = shapes::lemniscate(3.0, 0.02).unwrap();
        let mut cross_track = CrossTrack::new(&eight);
        // 5 cm to the left all along, through the crossing and back to it.
        for pair in eight.points().windows(2) {
            let (at, along) = (pair[0].pose.translation(), pair[1].pose.translation() - pair[0].pose.translation());
            let left = Vector2::new(-along.y, along.x).normalize();
            let distance = cross_track.at(&(at + left * 0.05));
            assert!((distance - 0.05).abs() < 1e-3, "{distance}");
        }
    }

    #[test]
    fn beyond_the_end_the_end_counts_and_no_path_is_no_distance() {
        let mut cross_track = CrossTrack::new(&shapes::line(1.0, 0.1).unwrap());
        assert!((cross_track.at(&Vector2::new(-0.3, -0.4)) + 0.5).abs() < 1e-12);
        assert_eq!(CrossTrack::new(&Path::new()).at(&Vector2::new(1.0, 1.0)), 0.0);
    }
}
