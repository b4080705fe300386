//! The timed elastic band.

use crate::counter;
use agv_nav::core::{
    geometry::{Se2, Twist2},
    grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams, cost},
    kinematics::MotionLimits,
    nalgebra::Vector2,
    obstacle::MovingObstacle,
    path::Path,
    roles::{LocalPlanRequest, LocalPlanner, VehicleState},
};
use agv_nav::plan::teb::{Teb, TebParams};

/// A hall with a post, six cells wide.
fn hall(post: Cell) -> LocalMap {
    let layout = GridLayout::new(160, 100, 0.05, Se2::default()).unwrap();
    let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
    for y in 0..6 {
        costmap.set(Cell::new(post.x, post.y + y), cost::LETHAL);
    }
    LocalMap::new(&costmap, LocalMapParams::default()).unwrap()
}

/// Round a post, while somebody crosses: bands that are new and bands that go on, all ways; along a path and to a place. The
/// memory grows with the longest band and roll-out so far, so that what is counted are drives as were had, in another order.
#[test]
fn elastic_band() {
    let path = Path::from_positions(&[Vector2::new(1.0, 2.5), Vector2::new(7.0, 2.5)]).unwrap();
    let place = Path::from_positions(&[Vector2::new(7.0, 2.5)]).unwrap();
    let worlds = [hall(Cell::new(80, 47)), hall(Cell::new(95, 46))];
    let limits = MotionLimits::default();
    let mut teb = Teb::new(TebParams::for_footprint(Footprint::rectangle(-0.3, 0.3, 0.4).unwrap())).unwrap();
    let mut drive = |map: &LocalMap, path: &Path| {
        teb.reset();
        let mut state = VehicleState::new(Se2::new(1.0, 2.5, 0.5), Twist2::ZERO);
        for cycle in 0..200 {
            let person = Vector2::new(3.0, -2.0 + 0.04 * f64::from(cycle));
            let obstacles = [MovingObstacle::new(person, Vector2::new(0.0, 0.8), 0.3).unwrap()];
            let request = LocalPlanRequest { state, path, map, obstacles: &obstacles, limits: &limits, dt: 0.05 };
            state = state.after(&teb.command(request).unwrap().motion, 0.05);
        }
        assert!(state.map_from_base.x() > 6.0, "{state:?}");
    };
    let mut drives = [(0, &path), (0, &place), (1, &path), (1, &place)];
    for &(world, path) in &drives {
        drive(&worlds[world], path);
    }
    drives.reverse();
    assert_eq!(counter::count(|| drives.iter().for_each(|&(world, path)| drive(&worlds[world], path))), 0);
}
