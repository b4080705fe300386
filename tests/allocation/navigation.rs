//! A whole cycle of a navigation.

use crate::{counter, scenes::room};
use agv_nav::{
    core::{
        grid::{Footprint, Inflation, InflationParams, LocalMapParams},
        nalgebra::Vector2,
        obstacle::MovingObstacle,
    },
    pipeline::{Navigation, NavigationParams, NavigationRequest, NavigationStatus},
    plan::{
        dwa::{Dwa, DwaParams},
        grid::{AStar, AStarParams},
    },
    prelude::*,
};

/// Around the pillar of the room, while somebody comes towards the vehicle and the map changes: plans, swerves, and
/// getting out of the way, on memory of an earlier drive.
#[test]
fn navigation() {
    let footprint = Footprint::rectangle(-0.2, 0.3, 0.4).unwrap();
    let mut inflation = Inflation::new(InflationParams::for_footprint(&footprint)).unwrap();
    let mut changed = room();
    changed.set(Cell::new(110, 20), CellState::Occupied);
    let costmaps = [room(), changed].map(|map| inflation.inflate(&map).unwrap());
    let mut map = LocalMap::new(&costmaps[0], LocalMapParams::default()).unwrap();
    let astar = AStar::new(AStarParams::default()).unwrap();
    let dwa = Dwa::new(DwaParams::for_footprint(&footprint)).unwrap();
    // Waiting is no reason for a recovery here.
    let params = NavigationParams { progress_time: 100.0, blocked_time: 100.0, ..NavigationParams::default() };
    let mut navigation = Navigation::new(Box::new(astar), Box::new(dwa), footprint, params).unwrap();
    let limits = MotionLimits::default();
    let mut evades = 0;
    let mut drive = || {
        let mut state = VehicleState::new(Se2::new(1.0, 1.5, 0.0), Twist2::ZERO);
        navigation.go_to(&Se2::new(6.5, 3.5, 0.0)).unwrap();
        for cycle in 0..100 {
            map.update(&costmaps[cycle / 30 % 2]).unwrap();
            let velocity = Vector2::new(-0.6, -0.2);
            let person =
                [MovingObstacle::new(Vector2::new(4.5, 2.6) + velocity * (0.1 * cycle as f64), velocity, 0.3).unwrap()];
            let request = NavigationRequest { state, map: &map, obstacles: &person, limits: &limits, dt: 0.1 };
            let command = navigation.cycle(request).unwrap();
            assert!(!matches!(command.status, NavigationStatus::Recovering(_)), "a search for a way out may allocate");
            evades += u32::from(command.status == NavigationStatus::Evading);
            state = state.after(&command.motion, 0.1);
        }
        assert!(state.map_from_base.x() > 2.0, "{state:?}");
    };
    drive();
    drive();
    assert_eq!(counter::count(drive), 0);
    assert!(evades > 0);
}
