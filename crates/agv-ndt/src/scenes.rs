//! Scenes that the tests of several methods share.

use agv_core::geometry::{LieGroup, Se3};
use agv_core::sensors::PointCloud;
use nalgebra::Vector3;

/// A numbered value in [0, 1) without pattern.
pub(crate) fn scatter(n: u32) -> f64 {
    f64::from(n.wrapping_mul(2_654_435_761) ^ (n.wrapping_mul(40_503) << 7)) / f64::from(u32::MAX)
}

/// Points on rectangles, given by a corner and two edges, as many on each as its area says; another `draw` draws others.
pub(crate) fn sheets(rectangles: &[[[f64; 3]; 3]], per_area: f64, draw: u32) -> Vec<Vector3<f64>> {
    let mut points = Vec::new();
    for (number, rectangle) in rectangles.iter().enumerate() {
        let [corner, a, b] = rectangle.map(Vector3::from);
        let normal = a.cross(&b);
        for i in 0..(normal.norm() * per_area) as u32 {
            let n = 1_000_003 * draw + 70_001 * number as u32 + 3 * i;
            let noise = 0.02 * (scatter(n) - 0.5);
            points.push(corner + a * scatter(n + 1) + b * scatter(n + 2) + normal.normalize() * noise);
        }
    }
    points
}

/// A room of 14 x 10 m with a cupboard and a table.
pub(crate) const ROOM: [[[f64; 3]; 3]; 7] = [
    [[-6.3, -4.2, -1.0], [14.0, 0.0, 0.0], [0.0, 10.0, 0.0]],
    [[-6.3, -4.2, -1.0], [14.0, 0.0, 0.0], [0.0, 0.0, 3.0]],
    [[-6.3, 5.8, -1.0], [14.0, 0.0, 0.0], [0.0, 0.0, 3.0]],
    [[-6.3, -4.2, -1.0], [0.0, 10.0, 0.0], [0.0, 0.0, 3.0]],
    [[7.7, -4.2, -1.0], [0.0, 10.0, 0.0], [0.0, 0.0, 3.0]],
    [[2.0, 1.0, -1.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.2]],
    [[-3.0, -2.0, -0.2], [1.6, 0.0, 0.0], [0.0, 0.8, 0.0]],
];

/// A corridor that goes on for ever.
pub(crate) const CORRIDOR: [[[f64; 3]; 3]; 3] = [
    [[-60.0, -1.4, -1.0], [120.0, 0.0, 0.0], [0.0, 2.8, 0.0]],
    [[-60.0, -1.4, -1.0], [120.0, 0.0, 0.0], [0.0, 0.0, 2.5]],
    [[-60.0, 1.4, -1.0], [120.0, 0.0, 0.0], [0.0, 0.0, 2.5]],
];

/// Walls of one direction, of which a wall explains one in three at most.
pub(crate) const PARALLEL: [[[f64; 3]; 3]; 3] = [
    [[-5.0, 0.0, -1.0], [10.0, 0.0, 0.0], [0.0, 0.0, 2.5]],
    [[-5.0, 0.7, -1.0], [10.0, 0.0, 0.0], [0.0, 0.0, 2.5]],
    [[-5.0, -0.8, -1.0], [10.0, 0.0, 0.0], [0.0, 0.0, 2.5]],
];

/// A cloud of points of the target frame, as it is seen from a pose.
pub(crate) fn cloud(points: &[Vector3<f64>], target_from_source: &Se3) -> PointCloud {
    PointCloud::from_points(points.iter().map(|p| target_from_source.inverse().act(p).cast()))
}
