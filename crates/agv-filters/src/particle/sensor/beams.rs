//! Which beams of a scan a model reads.

use agv_core::{
    geometry::LieGroup,
    sensors::{Beam, LaserScan},
};
use nalgebra::Vector2;

/// The indices of `most` beams out of `count`, evenly spread: the middle of each of as many equal parts. All of them if there
/// are no more.
pub(super) fn evenly_spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let used = count.min(most);
    (0..used).map(move |k| (2 * k + 1) * count / (2 * used))
}

/// The beams that hit something, of at most so many and up to a range in metres: their indices, and where they end in the base
/// frame.
pub(super) fn hits(scan: &LaserScan, most: usize, max_range: f64) -> impl Iterator<Item = (usize, Vector2<f64>)> {
    let geometry = scan.geometry();
    evenly_spread(scan.len(), most).filter_map(move |index| {
        let Beam::Hit(range) = scan.interpret(scan.ranges()[index]) else { return None };
        let (sin, cos) = geometry.angle(index).sin_cos();
        (range <= max_range).then(|| (index, geometry.base_from_sensor.act(&[range * cos, range * sin].into())))
    })
}

/// A model of scans that reads some of their beams: what a wrapper around it must know.
pub trait UsedBeams {
    /// Most beams of a scan that are read, evenly spread.
    fn max_beams(&self) -> usize;

    /// Hits beyond this range say nothing, in metres.
    fn max_range(&self) -> f64;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_are_spread_evenly_and_symmetrically() {
        for (count, most) in [(180, 60), (1081, 60), (7, 3), (5, 9), (0, 4), (1, 1), (65_536, 720)] {
            let chosen: Vec<usize> = evenly_spread(count, most).collect();
            assert_eq!(chosen.len(), count.min(most));
            assert!(chosen.iter().all(|&i| i < count) && chosen.is_sorted_by(|a, b| a < b));
            let gaps: Vec<usize> = chosen.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(gaps.iter().max().unwrap_or(&0) - gaps.iter().min().unwrap_or(&0) <= 1);
        }
    }
}
