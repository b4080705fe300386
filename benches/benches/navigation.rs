//! What a whole cycle of a navigation costs, the costmap aside: global plans at their period, the route, the dynamic window, and the look for
//! a course that keeps clear of what moves. A hall of 20 x 10 m with posts, cells of 0.05 m; 40 drives' worth of cycles in turn.

use agv_core::{
    geometry::{Se2, Twist2},
    grid::{Cell, CellState, Footprint, Grid, GridLayout, Inflation, InflationParams, LocalMap, LocalMapParams},
    kinematics::{MotionLimits, TwistLimits},
    obstacle::MovingObstacle,
    roles::VehicleState,
};
use agv_nav::pipeline::{Navigation, NavigationParams, NavigationRequest, NavigationStatus};
use agv_plan::{
    dwa::{Dwa, DwaParams},
    grid::{AStar, AStarParams},
};
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector2;
use std::hint::black_box;

const DT: f64 = 0.05;

fn footprint() -> Footprint {
    Footprint::rectangle(-0.25, 0.25, 0.43).expect("a rectangle")
}

fn hall() -> LocalMap {
    let layout = GridLayout::new(400, 200, 0.05, Se2::default()).expect("a layout");
    let mut map = Grid::filled(layout, CellState::Free);
    for (x, y) in [(80, 95), (130, 110), (180, 90), (230, 104), (280, 98), (330, 108)] {
        for cell in (0..4).flat_map(|i| (0..4).map(move |j| Cell::new(x + i, y + j))) {
            map.set(cell, CellState::Occupied);
        }
    }
    let params = InflationParams::for_footprint(&footprint());
    let costmap = Inflation::new(params).expect("good parameters").inflate(&map).expect("a map");
    LocalMap::new(&costmap, LocalMapParams::default()).expect("a map")
}

/// So many people, who cross the way of a vehicle that comes by.
fn people(count: u32, time: f64) -> Vec<MovingObstacle> {
    let person = |i: u32| {
        let side = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        let velocity = Vector2::new(-0.2, -0.8 * side);
        let from = Vector2::new(5.0 + 1.5 * f64::from(i), 5.0 + side * (2.0 + 0.5 * f64::from(i)));
        MovingObstacle::new(from + velocity * time, velocity, 0.3).expect("an obstacle")
    };
    (0..count).map(person).collect()
}

fn bench(c: &mut Criterion) {
    let (map, goal) = (hall(), Se2::new(19.0, 5.0, 0.0));
    let limits: MotionLimits = TwistLimits {
        forward_speed: 2.0,
        acceleration: 2.0,
        deceleration: 2.0,
        yaw_rate: 2.0,
        yaw_acceleration: 4.0,
        ..TwistLimits::default()
    }
    .into();
    let mut group = c.benchmark_group("navigation");
    for count in [0, 4, 10] {
        let astar = AStar::new(AStarParams::default()).expect("good parameters");
        let dwa = Dwa::new(DwaParams::for_footprint(&footprint())).expect("good parameters");
        let (planner, local) = (Box::new(astar), Box::new(dwa));
        let mut navigation =
            Navigation::new(planner, local, footprint(), NavigationParams::default()).expect("good parameters");
        let seen: Vec<_> = (0..160).map(|cycle| people(count, DT * f64::from(cycle))).collect();
        let start = VehicleState::new(Se2::new(1.0, 5.0, 0.0), Twist2::ZERO);
        let mut drive = |state: &mut VehicleState, cycle: usize| {
            if cycle == 0 {
                *state = start;
                navigation.go_to(&goal).expect("a goal");
            }
            let obstacles = seen.get(cycle).map(Vec::as_slice).unwrap_or_default();
            let request = NavigationRequest { state: *state, map: &map, obstacles, limits: &limits, dt: DT };
            let command = navigation.cycle(request).expect("a good request");
            *state = state.after(&command.motion, DT);
            command.status
        };
        let mut state = start;
        let evades = (0..160).filter(|&cycle| drive(&mut state, cycle) == NavigationStatus::Evading).count();
        println!(
            "{count} people: at {:.1} m after 8 s, {evades} cycles of getting out of the way",
            state.map_from_base.x()
        );
        assert!(state.map_from_base.x() > 8.0, "{state:?}");
        let mut cycle = 0;
        group.bench_function(format!("cycle, {count} people"), |b| {
            b.iter(|| {
                let status = drive(&mut state, cycle);
                cycle = (cycle + 1) % 160;
                black_box(status)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
