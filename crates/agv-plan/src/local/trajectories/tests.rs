use super::*;
use agv_core::{
    grid::{CellState, Costmap, Grid, GridLayout, LocalMapParams},
    kinematics::rise,
    roles::laws,
};
use proptest::prelude::*;

fn map_with(walls: &[(i32, i32)], yaw: f64) -> LocalMap {
    let layout = GridLayout::new(160, 160, 0.05, Se2::new(-4.0, -4.0, yaw)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for &(x, y) in walls {
        map.set(Cell::new(x, y), CellState::Occupied);
    }
    LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap()
}

proptest! {
    /// Without ramps a trajectory is the exact arc of its twist; the state is at the target from the beginning.
    #[test]
    fn constant_twists_are_exact_arcs(vx in -0.3..1.0_f64, vy in -0.4..0.4_f64, yaw_rate in -1.0..1.0_f64, yaw in -3.0..3.0_f64) {
        let mut limits = laws::vehicles()[3].1;
        limits.lateral_acceleration = None;
        let map = map_with(&[], 0.3);
        let twist = Twist2::new(vx, vy, yaw_rate);
        let state = VehicleState::new(Se2::new(0.2, -0.1, yaw), twist);
        let mut batch = Trajectories::default();
        batch.begin(&state, &map, 30, 0.1);
        batch.push([vx as f32, vy as f32, yaw_rate as f32]);
        batch.roll_out(&state, &limits, &map, &Footprint::circle(0.2).unwrap());
        for step in [0, 9, 29] {
            let view = batch.at_step(step);
            let pose = state.map_from_base.compose(&twist.integrate(0.1 * (step + 1) as f64));
            let found = batch.map_from_local().act(&Vector2::new(f64::from(view.x[0]), f64::from(view.y[0])));
            prop_assert!((found - pose.translation()).norm() < 2e-5, "{found} {pose:?}");
            let nose = batch.map_from_local().rotation().act(&Vector2::new(f64::from(view.cos[0]), f64::from(view.sin[0])));
            prop_assert!((nose - Vector2::new(pose.yaw().cos(), pose.yaw().sin())).norm() < 2e-5);
        }
    }

    /// A vehicle changes its speed as its limits say, through zero too, and the batch keeps to it.
    #[test]
    fn ramps_are_those_of_the_limits(
        before in -0.3..1.0_f64, vx in -0.3..1.0_f64, yaw_rate in -1.0..1.0_f64,
        acceleration in 0.2..2.0_f64, deceleration in 0.2..2.0_f64,
    ) {
        let mut limits = MotionLimits::default();
        (limits.twist.acceleration, limits.twist.deceleration) = (acceleration, deceleration);
        let map = map_with(&[], 0.0);
        let mut state = VehicleState::new(Se2::default(), Twist2::new(before, 0.0, 0.0));
        let mut batch = Trajectories::default();
        batch.begin(&state, &map, 20, 0.1);
        batch.push([vx as f32, 0.0, yaw_rate as f32]);
        batch.roll_out(&state, &limits, &map, &Footprint::circle(0.2).unwrap());
        for step in 0..20 {
            let now = state.twist;
            let to = |now: f64, target: f64, a: f64, d: f64| target.clamp(-rise(-now, a, d, 0.1), rise(now, a, d, 0.1));
            let twist = Twist2::new(to(now.vx, vx, acceleration, deceleration), 0.0, to(now.yaw_rate, yaw_rate, 1.0, 1.0));
            prop_assert!(limits.allows_step(&now.into(), &twist.into(), 0.1));
            state = state.after(&twist.into(), 0.1);
            let view = batch.at_step(step);
            let found = Vector2::new(f64::from(view.x[0]), f64::from(view.y[0]));
            prop_assert!((found - state.map_from_base.translation()).norm() < 2e-5);
        }
    }

    /// What a trajectory has free is what the exact check of its states has, but for the cells that look-ups are rough by.
    #[test]
    fn free_steps_are_about_those_of_the_exact_check(post in (85..150_i32, 60..100_i32), yaw_rate in -1.0..1.0_f64) {
        let limits = MotionLimits::default();
        let map = map_with(&[post], 0.0);
        let footprint = Footprint::rectangle(-0.2, 0.3, 0.4).unwrap();
        let twist = Twist2::new(1.0, 0.0, yaw_rate);
        let state = VehicleState::new(Se2::default(), twist);
        let mut batch = Trajectories::default();
        batch.begin(&state, &map, 40, 0.05);
        batch.push([1.0, 0.0, yaw_rate as f32]);
        batch.roll_out(&state, &limits, &map, &footprint);
        let pose = |step: usize| state.map_from_base.compose(&twist.integrate(0.05 * (step + 1) as f64));
        for step in 0..batch.free()[0] as usize {
            // A smaller vehicle touches nothing.
            let smaller = Footprint::rectangle(-0.125, 0.225, 0.25).unwrap();
            prop_assert!(!map.collides(&smaller, &pose(step)).unwrap());
        }
        if (batch.free()[0] as usize) < 40 && batch.free()[0] > 0 {
            let larger = Footprint::rectangle(-0.45, 0.55, 0.6).unwrap();
            prop_assert!(map.collides(&larger, &pose(batch.free()[0] as usize)).unwrap());
        }
    }
}

#[test]
fn obstacles_are_met_at_their_time() {
    let (map, limits) = (map_with(&[], 0.0), MotionLimits::default());
    let state = VehicleState::new(Se2::default(), Twist2::new(1.0, 0.0, 0.0));
    let footprint = Footprint::circle(0.2).unwrap();
    let crossing = MovingObstacle::new(Vector2::new(1.0, -1.0), Vector2::new(0.0, 1.0), 0.2).unwrap();
    let gone = MovingObstacle { velocity: Vector2::new(0.0, 3.0), ..crossing };
    for (obstacle, free) in [(crossing, false), (gone, true)] {
        let mut batch = Trajectories::default();
        batch.begin(&state, &map, 20, 0.1);
        batch.push([1.0, 0.0, 0.0]);
        batch.roll_out(&state, &limits, &map, &footprint);
        batch.meet(&[obstacle]);
        assert_eq!(batch.free()[0] == 20, free, "{obstacle:?}");
    }
}

/// Within an outline the vehicle touches it, however far its edges are.
#[test]
fn the_inside_of_an_obstacle_is_no_free_ground() {
    let (map, limits) = (map_with(&[], 0.5), MotionLimits::default());
    let state = VehicleState::new(Se2::new(0.2, 0.1, 0.7), Twist2::new(1.0, 0.0, 0.0));
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| Vector2::new(x, y));
    let center = state.map_from_base.act(&Vector2::new(1.6, 0.0));
    let shelf = MovingObstacle::new(center, Vector2::zeros(), 0.1).unwrap().with_hull(Hull::new(&corners).unwrap());
    let mut batch = Trajectories::default();
    batch.begin(&state, &map, 20, 0.1);
    batch.push([1.0, 0.0, 0.0]);
    batch.roll_out(&state, &limits, &map, &Footprint::circle(0.2).unwrap());
    batch.meet(&[shelf]);
    for step in 0..20 {
        let place = state.map_from_base.act(&Vector2::new(0.1 * f64::from(step + 1), 0.0));
        let gap = shelf.distance_after(0.0, &place) - 0.2;
        let found = f64::from(batch.at_step(step as usize).clearance[0]);
        assert!(gap > 0.3 || (found - gap).abs() < 1e-3, "{found} {gap}");
    }
}

/// A sequence that always aims at the same is the trajectory of that aim, and tells what was done.
#[test]
fn sequences_of_one_aim_are_trajectories() {
    let map = map_with(&[(110, 82)], 0.2);
    let footprint = Footprint::rectangle(-0.2, 0.3, 0.4).unwrap();
    let state = VehicleState::new(Se2::new(0.1, 0.0, 0.4), Twist2::new(0.3, 0.0, 0.2));
    for (name, limits) in laws::vehicles() {
        let aim = |i: usize| [-0.2 + 0.06 * i as f32, 0.0, -0.9 + 0.1 * i as f32];
        let (mut plain, mut sequences) = (Trajectories::default(), Trajectories::default());
        plain.begin(&state, &map, 25, 0.1);
        (0..19).for_each(|i| plain.push(aim(i)));
        sequences.begin_sequences(&state, &map, (19, 25), 0.1);
        for (step, k) in (0..25).flat_map(|step| (0..3).map(move |k| (step, k))) {
            (0..19).for_each(|i| sequences.controls_mut(step)[k][i] = aim(i)[k]);
        }
        plain.roll_out(&state, &limits, &map, &footprint);
        sequences.roll_out(&state, &limits, &map, &footprint);
        assert!(plain.free().iter().any(|&free| free < 25) && plain.free().contains(&25), "{name}");
        assert_eq!(plain.free(), sequences.free());
        for step in 0..25 {
            let (a, b) = (plain.at_step(step), sequences.at_step(step));
            assert!(a.x == b.x && a.y == b.y && a.sin == b.sin && a.clearance == b.clearance, "{name}");
        }
        // The targets are reached, and the means lie between them and the beginning.
        let (end, mean) = (sequences.control(18, 24), sequences.target(18));
        assert!((end[0] - aim(18)[0]).abs() < 1e-6 && mean[0] > 0.3 && mean[0] < end[0], "{name}: {end:?} {mean:?}");
    }
}

/// A group that is deep in an obstacle is left there; others go on.
#[test]
fn those_who_are_stuck_are_left() {
    let walls: Vec<_> = (100..160).flat_map(|x| (60..100).map(move |y| (x, y))).collect();
    let (map, mut limits) = (map_with(&walls, 0.0), MotionLimits::default());
    // Half a metre until rest.
    limits.twist.deceleration = 1.0;
    let state = VehicleState::new(Se2::default(), Twist2::new(1.0, 0.0, 0.0));
    let mut batch = Trajectories::default();
    batch.begin(&state, &map, 30, 0.1);
    (0..16).for_each(|_| batch.push([1.0, 0.0, 0.0]));
    (0..16).for_each(|i| batch.push([0.0, 0.0, 0.1 * i as f32]));
    batch.roll_out(&state, &limits, &map, &Footprint::circle(0.2).unwrap());
    let end = batch.at_step(29);
    // The wall is a metre ahead.
    assert!(batch.free()[..16].iter().all(|&free| free == 7 || free == 8), "{:?}", batch.free());
    assert!(end.x[..16].iter().all(|&x| x < 1.1) && end.clearance[..16].iter().all(|&c| c == f32::NEG_INFINITY));
    assert!(batch.free()[16..].iter().all(|&free| free == 30) && end.clearance[16..].iter().all(|&c| c > 0.0));
}
