//! What a local planner sees: a rolling window with points in it, and the vehicle that it plans for.

use agv_core::compute::Seed;
use agv_core::geometry::Se2;
use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
use agv_core::kinematics::{MotionLimits, TwistLimits};
use agv_core::nalgebra::Vector2;
use rand_distr::{Distribution, Uniform};

/// A rolling window of 10 m, with points at random but for a lane of two metres in its middle.
///
/// # Panics
/// Never: the window and the range of its points are sound.
pub fn costmap(points: usize) -> Costmap {
    let layout = GridLayout::new(200, 200, 0.05, Se2::new(-5.0, -5.0, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    let (mut stream, any) = (Seed(3).stream(0, 0), Uniform::new(-5.0, 5.0).unwrap());
    let mut set = 0;
    while set < points {
        let point: Vector2<f64> = Vector2::new(any.sample(&mut stream), any.sample(&mut stream));
        if point.y.abs() > 1.0 {
            map.set(layout.cell_at(&point).unwrap(), CellState::Occupied);
            set += 1;
        }
    }
    Costmap::from_map(&map)
}

/// A quick differential drive, as BARN's.
pub fn limits() -> MotionLimits {
    TwistLimits {
        forward_speed: 2.0,
        yaw_rate: 2.0,
        acceleration: 2.0,
        deceleration: 2.0,
        yaw_acceleration: 4.0,
        ..TwistLimits::default()
    }
    .into()
}
