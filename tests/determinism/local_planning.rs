//! Local planners, and the navigation around one: how bands are spread over threads is not part of a drive.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes::room,
};
use agv_nav::{
    core::{
        compute::Par,
        grid::{Footprint, Inflation, InflationParams, LocalMapParams},
        nalgebra::Vector2,
        obstacle::MovingObstacle,
    },
    pipeline::{Navigation, NavigationParams, NavigationRequest},
    plan::{
        dwa::{Dwa, DwaParams},
        grid::{AStar, AStarParams},
        teb::{Teb, TebParams},
    },
    prelude::*,
};

/// Time of a cycle, in seconds.
const DT: f64 = 0.1;

fn footprint() -> Footprint {
    Footprint::rectangle(-0.3, 0.3, 0.4).unwrap()
}

fn dwa() -> Dwa {
    Dwa::new(DwaParams::for_footprint(&footprint())).unwrap()
}

fn teb(par: Par) -> Teb {
    Teb::new(TebParams::for_footprint(footprint())).unwrap().with_parallelism(par)
}

/// The room with its pillar, seen after an empty one.
fn hall(par: Par) -> LocalMap {
    let room = room();
    let empty = Grid::filled(*room.layout(), CellState::Free);
    let mut inflation = Inflation::new(InflationParams::for_footprint(&footprint())).unwrap().with_parallelism(par);
    let mut map = LocalMap::new(&inflation.inflate(&empty).unwrap(), LocalMapParams::default()).unwrap();
    map = map.with_parallelism(par);
    map.update(&inflation.inflate(&room).unwrap()).unwrap();
    map
}

/// Drives an ideal vehicle past a post, while somebody crosses, and digests all of its poses.
fn drive(map: &LocalMap, mut command: impl FnMut(VehicleState, &LocalMap, &[MovingObstacle]) -> Motion) -> Digest {
    let mut state = VehicleState::new(Se2::new(1.0, 2.5, 0.5), Twist2::ZERO);
    let mut poses = Vec::new();
    for cycle in 0..60 {
        let person = Vector2::new(4.5, 4.7 - 0.08 * f64::from(cycle));
        let obstacles = [MovingObstacle::new(person, Vector2::new(0.0, -0.8), 0.3).unwrap()];
        state = state.after(&command(state, map, &obstacles), DT);
        poses.push(state.map_from_base);
    }
    assert!(state.map_from_base.x() > 2.0, "{state:?}");
    Digest::new().poses(&poses)
}

fn drive_with(mut planner: impl LocalPlanner, map: &LocalMap) -> Digest {
    let path = Path::from_positions(&[Vector2::new(1.0, 2.5), Vector2::new(7.0, 2.5)]).unwrap();
    let limits = MotionLimits::default();
    drive(map, |state, map, obstacles| {
        let request = LocalPlanRequest { state, path: &path, map, obstacles, limits: &limits, dt: DT };
        planner.command(request).unwrap().motion
    })
}

fn navigate_with(planner: impl LocalPlanner + Send + 'static, map: &LocalMap) -> Digest {
    let astar = AStar::new(AStarParams::default()).unwrap();
    let mut navigation =
        Navigation::new(Box::new(astar), Box::new(planner), footprint(), NavigationParams::default()).unwrap();
    navigation.go_to(&Se2::new(7.0, 2.5, 0.0)).unwrap();
    let limits = MotionLimits::default();
    drive(map, |state, map, obstacles| {
        navigation.cycle(NavigationRequest { state, map, obstacles, limits: &limits, dt: DT }).unwrap().motion
    })
}

#[test]
fn local_planners_do_not_depend_on_threads() {
    assert_same_bits("Dwa", |par| drive_with(dwa(), &hall(par)));
    assert_same_bits("Teb", |par| drive_with(teb(par), &hall(par)));
}

#[test]
fn navigation_does_not_depend_on_threads() {
    assert_same_bits("Navigation with Dwa", |par| navigate_with(dwa(), &hall(par)));
    assert_same_bits("Navigation with Teb", |par| navigate_with(teb(par), &hall(par)));
}
