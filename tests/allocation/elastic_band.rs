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

/// Round a post, while somebody crosses: bands that are new and bands that go on, all ways.
#[test]
fn elastic_band() {
    let layout = GridLayout::new(160, 100, 0.05, Se2::default()).unwrap();
    let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
    for y in 47..53 {
        costmap.set(Cell::new(80, y), cost::LETHAL);
    }
    let map = LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
    let path = Path::from_positions(&[Vector2::new(1.0, 2.5), Vector2::new(7.0, 2.5)]).unwrap();
    let limits = MotionLimits::default();
    let mut teb = Teb::new(TebParams::for_footprint(Footprint::rectangle(-0.3, 0.3, 0.4).unwrap())).unwrap();
    let mut drive = || {
        teb.reset();
        let mut state = VehicleState::new(Se2::new(1.0, 2.5, 0.5), Twist2::ZERO);
        for cycle in 0..200 {
            let person = Vector2::new(3.0, -2.0 + 0.04 * f64::from(cycle));
            let obstacles = [MovingObstacle::new(person, Vector2::new(0.0, 0.8), 0.3).unwrap()];
            let request =
                LocalPlanRequest { state, path: &path, map: &map, obstacles: &obstacles, limits: &limits, dt: 0.05 };
            state = state.after(&teb.command(request).unwrap().motion, 0.05);
        }
        assert!(state.map_from_base.x() > 6.0, "{state:?}");
    };
    drive();
    assert_eq!(counter::count(drive), 0);
}
