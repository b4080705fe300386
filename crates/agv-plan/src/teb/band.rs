//! The band itself: poses, and the times between them.

use agv_core::geometry::{Se2, angle_difference};
use nalgebra::Vector2;

/// Poses with the time from each to the next.
///
/// Headings are not wrapped: two that follow each other differ by how far the vehicle turns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Band {
    /// `x, y, θ, Δt` in metres, radians and seconds; the last time means nothing.
    nodes: Vec<[f64; 4]>,
}

impl Band {
    /// A band without poses.
    pub const fn new() -> Self {
        Self { nodes: Vec::new() }
    }

    /// Number of poses.
    pub const fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether there are no poses.
    pub const fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// A pose of the base in the map.
    pub fn pose(&self, index: usize) -> Option<Se2> {
        self.nodes.get(index).map(|&[x, y, yaw, _]| Se2::new(x, y, yaw))
    }

    /// Time from a pose to the next, in seconds.
    pub fn interval(&self, index: usize) -> Option<f64> {
        self.nodes.get(index).filter(|_| index + 1 < self.nodes.len()).map(|node| node[3])
    }

    /// Time from the first pose to the last, in seconds.
    pub fn duration(&self) -> f64 {
        self.nodes.split_last().map_or(0.0, |(_, nodes)| nodes.iter().map(|node| node[3]).sum())
    }

    /// Length of the lines between the poses, in metres.
    pub fn length(&self) -> f64 {
        self.nodes.windows(2).map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1])).sum()
    }

    /// All numbers in a row: what is optimised.
    pub(super) fn unknowns(&self) -> &[f64] {
        self.nodes.as_flattened()
    }

    pub(super) fn unknowns_mut(&mut self) -> &mut [f64] {
        self.nodes.as_flattened_mut()
    }

    pub(super) fn nodes(&self) -> &[[f64; 4]] {
        &self.nodes
    }

    pub(super) fn nodes_mut(&mut self) -> &mut [[f64; 4]] {
        &mut self.nodes
    }

    pub(super) fn clear(&mut self) {
        self.nodes.clear();
    }

    pub(super) fn copy_from(&mut self, other: &Self) {
        self.nodes.clone_from(&other.nodes);
    }

    pub(super) fn truncate(&mut self, len: usize) {
        self.nodes.truncate(len);
    }

    /// Appends a pose whose heading is taken the short way from the last one's.
    pub(super) fn push(&mut self, position: Vector2<f64>, yaw: f64, interval: f64) {
        let yaw = self.nodes.last().map_or(yaw, |last| last[2] + angle_difference(yaw, last[2]));
        self.nodes.push([position.x, position.y, yaw, interval]);
    }

    /// Gives the last pose a place, its heading taken the short way; the speed towards it stays.
    pub(super) fn set_last(&mut self, position: Vector2<f64>, yaw: f64) {
        if let [.., before, last] = &mut self.nodes[..] {
            let yaw = last[2] + angle_difference(yaw, last[2]);
            let moved = [position.x, position.y, yaw, last[3]];
            before[3] *= stretch(before, last, before, &moved);
            *last = moved;
        }
    }

    /// Lets the band begin at `pose`: poses that the vehicle has passed are dropped. False if it is farther than `reach` metres
    /// from all of them; the band is then as it was. The speed to the next pose stays.
    pub(super) fn begin_at(&mut self, pose: &Se2, reach: f64) -> bool {
        let at = pose.translation();
        let square = |node: &[f64; 4]| (node[0] - at.x).powi(2) + (node[1] - at.y).powi(2);
        // Not farther ahead than a few poses: a band may pass the same place twice.
        let near = self.nodes.iter().take(8).map(square).enumerate();
        let Some((nearest, distance)) = near.min_by(|a, b| a.1.total_cmp(&b.1)) else { return false };
        if distance > reach * reach || self.nodes.len() < nearest + 2 {
            return false;
        }
        // The nearest may lie behind or ahead: the pose replaces it, and those before it go.
        self.nodes.drain(..nearest);
        // A full turn between the vehicle's heading and the band's changes nothing but numbers.
        let next = self.nodes.get(1).copied();
        let Some(first) = self.nodes.first_mut() else { return false };
        let yaw = first[2] + angle_difference(pose.yaw(), first[2]);
        let moved = [at.x, at.y, yaw, first[3]];
        let share = next.map_or(1.0, |next| stretch(first, &next, &moved, &next));
        *first = [at.x, at.y, yaw, first[3] * share];
        true
    }

    /// Cuts intervals that are more than 1.4 times as long as `spacing` metres, or turn by more than 1.4 times `turn` radians, into
    /// even parts, 64 at the most; and joins one that is shorter than half of both to the next where that is no longer than 1.3
    /// times. First and last pose stay.
    pub(super) fn resize(&mut self, spacing: f64, turn: f64, scratch: &mut Vec<[f64; 4]>) {
        scratch.clear();
        let size =
            |a: &[f64; 4], b: &[f64; 4]| ((b[0] - a[0]).hypot(b[1] - a[1]) / spacing).max((b[2] - a[2]).abs() / turn);
        let Some((&last, nodes)) = self.nodes.split_last() else { return };
        for (i, node) in nodes.iter().enumerate() {
            let next = nodes.get(i + 1).unwrap_or(&last);
            if let Some(before) = scratch.last_mut() {
                // Too near to the one before: its time goes to that.
                if i > 0 && size(before, node) < 0.5 && size(before, next) < 1.3 {
                    before[3] += node[3];
                    continue;
                }
            }
            scratch.push(*node);
        }
        scratch.push(last);
        self.nodes.clear();
        for pair in scratch.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let parts = (size(&a, &b) / 1.4).ceil().clamp(1.0, 64.0);
            for k in 0..parts as usize {
                let share = k as f64 / parts;
                let mix = |j: usize| a[j] + share * (b[j] - a[j]);
                self.nodes.push([mix(0), mix(1), mix(2), a[3] / parts]);
            }
        }
        self.nodes.push(last);
    }
}

/// How many times as long one line is as another was, from a quarter to four.
fn stretch(a: &[f64; 4], b: &[f64; 4], to_a: &[f64; 4], to_b: &[f64; 4]) -> f64 {
    let length = |a: &[f64; 4], b: &[f64; 4]| (b[0] - a[0]).hypot(b[1] - a[1]);
    (length(to_a, to_b) / length(a, b).max(1e-6)).clamp(0.25, 4.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn band(points: &[(f64, f64)]) -> Band {
        let mut band = Band::new();
        for &(x, y) in points {
            band.push(Vector2::new(x, y), 0.3 * x, 0.2);
        }
        band
    }

    proptest! {
        /// Resizing keeps the time and the ends, and leaves no interval that is too long.
        #[test]
        fn resizing_keeps_time_and_ends(points in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64), 2..30)) {
            let mut resized = band(&points);
            let before = resized.clone();
            resized.resize(0.2, 0.3, &mut Vec::new());
            prop_assert!((resized.duration() - before.duration()).abs() < 1e-9);
            prop_assert_eq!(resized.pose(0), before.pose(0));
            prop_assert_eq!(resized.pose(resized.len() - 1), before.pose(before.len() - 1));
            for w in resized.nodes().windows(2) {
                prop_assert!((w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1]) <= 0.28 + 1e-9);
                prop_assert!((w[1][2] - w[0][2]).abs() <= 0.42 + 1e-9);
            }
        }
    }

    #[test]
    fn what_was_passed_is_dropped() {
        let mut line = band(&[(0.0, 0.0), (0.2, 0.0), (0.4, 0.0), (0.6, 0.0), (0.8, 0.0)]);
        assert!(line.begin_at(&Se2::new(0.45, 0.02, 0.1), 0.3));
        assert_eq!((line.len(), line.pose(0).unwrap().x()), (3, 0.45));
        // 0.15 m are left of 0.2 m, and of the time as much.
        assert!((line.interval(0).unwrap() - 0.15).abs() < 2e-3);
        assert!(!line.begin_at(&Se2::new(0.45, 0.9, 0.1), 0.3));
        assert!(!line.begin_at(&Se2::new(0.8, 0.0, 0.0), 0.3), "nothing is left");
        assert!(!Band::new().begin_at(&Se2::default(), 1.0));
    }
}
