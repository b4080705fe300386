use super::*;
use agv_core::{
    compute::Seed,
    geometry::Se2,
    grid::{CellState, CollisionChecker, CollisionParams, Costmap, Grid, GridLayout, LocalMap, LocalMapParams},
    obstacle::MovingObstacle,
    path::Path,
    roles::{VehicleState, laws},
};
use nalgebra::Vector2;
use proptest::prelude::*;
use rand_distr::{Distribution, Uniform};

const DT: f64 = 0.1;

fn outlines() -> [Footprint; 3] {
    let rectangle = Footprint::rectangle(-0.25, 0.6, 0.5).unwrap();
    [rectangle, Footprint::circle(0.3).unwrap(), Footprint::two_circles(0.4, 0.25, -0.1, 0.25).unwrap()]
}

/// A hall of 8 by 8 metres with posts, none near the middle.
fn hall(seed: u64, posts: usize) -> Grid<CellState> {
    let layout = GridLayout::new(160, 160, 0.05, Se2::new(-4.0, -4.0, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    let (mut stream, place) = (Seed(seed).stream(0, 0), Uniform::new(-4.0, 4.0).unwrap());
    for _ in 0..posts {
        let post = Vector2::new(place.sample(&mut stream), place.sample(&mut stream));
        if let Some(cell) = layout.cell_at(&post).filter(|_| post.norm() > 1.0) {
            map.set(cell, CellState::Occupied);
        }
    }
    map
}

fn path() -> Path {
    Path::from_positions(&[Vector2::zeros(), Vector2::x()]).unwrap()
}

/// Drives wildly, and yet no faster than the guard lets it, for ten seconds; then brakes.
fn drive_wildly(
    seed: u64,
    vehicle: usize,
    outline: usize,
    posts: usize,
    people: &[MovingObstacle],
) -> Result<(), TestCaseError> {
    let (name, limits) = laws::vehicles()[vehicle];
    let footprint = outlines()[outline].clone();
    let map = hall(seed, posts);
    let local = LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap();
    let checker = CollisionChecker::new(&map, footprint.clone(), CollisionParams::default()).unwrap();
    let guard = Guard::new(footprint.clone(), GuardParams::default()).unwrap();
    let (mut stream, any) = (Seed(seed).stream(1, 0), Uniform::new(-1.0, 1.0).unwrap());
    let (path, mut people) = (path(), people.to_vec());
    let mut state = VehicleState::new(Se2::default(), Twist2::ZERO);
    let mut target = Twist2::ZERO;
    for cycle in 0..160 {
        let request = LocalPlanRequest { state, path: &path, map: &local, obstacles: &people, limits: &limits, dt: DT };
        if cycle % 8 == 0 {
            let mut draw = || any.sample(&mut stream);
            target = Twist2::new(0.6 + draw(), 0.5 * draw(), draw());
        }
        let wanted = limits.step(&state.motion(), &target.into(), DT).unwrap();
        let passes = cycle < 100 && guard.check(&request, &wanted).unwrap().is_clear();
        let motion = if passes { wanted } else { guard.brake(&request).unwrap() };
        prop_assert!(limits.allows_step(&state.motion(), &motion, DT), "{name}: {motion:?}");
        for i in 1..=20 {
            let t = DT * f64::from(i) / 20.0;
            let pose = state.map_from_base.compose(&motion.twist.integrate(t));
            prop_assert!(!checker.collides(&pose).unwrap(), "{name} in cycle {cycle}");
            let run_into =
                |p: &MovingObstacle| motion.twist != Twist2::ZERO && p.gap_after(t, &footprint, &pose) <= 0.0;
            prop_assert!(!people.iter().any(run_into), "{name} in cycle {cycle}");
        }
        state = state.after(&motion, DT);
        for person in &mut people {
            person.position = person.position_after(DT);
        }
    }
    prop_assert_eq!(state.twist, Twist2::ZERO);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// After commands that passed, braking touches nothing, for ever; nor does anything on the way.
    #[test]
    fn there_is_always_a_way_to_brake(seed: u64, vehicle in 0..4_usize, outline in 0..3_usize, posts in 0..300_usize) {
        drive_wildly(seed, vehicle, outline, posts, &[])?;
    }

    #[test]
    fn a_vehicle_that_moves_runs_into_nobody(
        seed: u64, vehicle in 0..4_usize, outline in 0..3_usize,
        people in prop::collection::vec((1.2..4.0_f64, -3.0..3.0_f64, -1.0..1.0_f64, -1.0..1.0_f64), 0..6),
    ) {
        let person = |(distance, angle, u, w): (f64, f64, f64, f64)| {
            let at = Vector2::new(distance * angle.cos(), distance * angle.sin());
            MovingObstacle::new(at, Vector2::new(u, w), 0.25).unwrap()
        };
        let people: Vec<_> = people.into_iter().map(person).collect();
        drive_wildly(seed, vehicle, outline, 40, &people)?;
    }
}

/// A ring of free ground around the origin, with one cell of it marked if a place is given.
fn ring(outer: f64, mark: Option<Vector2<f64>>) -> LocalMap {
    let layout = GridLayout::new(120, 120, 0.05, Se2::new(-3.0, -3.0, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for index in 0..layout.len() {
        let distance = layout.center(layout.cell(index)).norm();
        if !(0.6..outer).contains(&distance) {
            map.set(layout.cell(index), CellState::Occupied);
        }
    }
    if let Some(cell) = mark.and_then(|mark| layout.cell_at(&mark)) {
        map.set(cell, CellState::Occupied);
    }
    LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap()
}

/// In a ring of wall with a lane of half a metre to spare, the arc leads to rest where the straight way ends in the wall.
#[test]
fn braking_in_a_bend_stays_in_the_bend() {
    let local = ring(1.5, None);
    let guard = Guard::new(Footprint::circle(0.25).unwrap(), GuardParams::default()).unwrap();
    // Turning could stop at once, driving takes a metre.
    let mut limits = MotionLimits::default();
    limits.twist.yaw_acceleration = 20.0;
    let twist = Twist2::new(0.9, 0.0, 0.9);
    let state = VehicleState::new(Se2::new(1.0, 0.0, std::f64::consts::FRAC_PI_2), twist);
    let path = path();
    let request = LocalPlanRequest { state, path: &path, map: &local, obstacles: &[], limits: &limits, dt: DT };
    assert_eq!(guard.check(&request, &twist.into()).unwrap(), Verdict::Clear);
    let brake = guard.brake(&request).unwrap().twist;
    assert!((brake.vx - brake.yaw_rate).abs() < 1e-12 && brake.vx < 0.9);
    let straight = Twist2::new(0.9, 0.0, 0.0);
    assert_eq!(guard.check(&request, &straight.into()).unwrap(), Verdict::Blocked(BlockReason::Obstacle));
}

/// A new mark on the arc is no reason to drive straight into the wall, unless the wall is touched at a much lower speed.
#[test]
fn a_mark_on_the_arc_does_not_lead_into_the_wall() {
    let guard = Guard::new(Footprint::circle(0.25).unwrap(), GuardParams::default()).unwrap();
    let mut limits = MotionLimits::default();
    limits.twist.yaw_acceleration = 20.0;
    let state = VehicleState::new(Se2::new(1.0, 0.0, std::f64::consts::FRAC_PI_2), Twist2::new(0.9, 0.0, 0.9));
    let path = path();
    // At the inner and the outer edge of what the arc sweeps, with a wall near and far.
    for (outer, radius, angle, stays) in
        [(1.35, 0.8, 0.45_f64, true), (1.35, 1.22, 0.45, true), (1.6, 0.78, 0.6, false)]
    {
        let mark = Vector2::new(angle.cos(), angle.sin()) * radius;
        let local = ring(outer, Some(mark));
        let request = LocalPlanRequest { state, path: &path, map: &local, obstacles: &[], limits: &limits, dt: DT };
        assert!(!guard.touches(&request).unwrap());
        let brake = guard.brake(&request).unwrap().twist;
        assert_eq!((brake.vx - brake.yaw_rate).abs() < 1e-12, stays, "{outer} {radius}: {brake:?}");
        assert!(brake.vx < 0.9);
    }
}

#[test]
fn the_reason_is_told() {
    let local = LocalMap::new(&Costmap::from_map(&hall(0, 0)), LocalMapParams::default()).unwrap();
    let guard = Guard::new(outlines()[0].clone(), GuardParams::default()).unwrap();
    let (path, limits) = (path(), MotionLimits::default());
    let ahead = Twist2::new(1.0, 0.0, 0.0);
    let person = [MovingObstacle::new(Vector2::new(1.4, 0.0), Vector2::new(-0.5, 0.0), 0.3).unwrap()];
    let request = |x: f64, obstacles| {
        let state = VehicleState::new(Se2::new(x, 0.0, 0.0), ahead);
        LocalPlanRequest { state, path: &path, map: &local, obstacles, limits: &limits, dt: DT }
    };
    let check = |x: f64, obstacles, twist: Twist2| guard.check(&request(x, obstacles), &twist.into()).unwrap();
    assert_eq!(check(0.0, &[], ahead), Verdict::Clear);
    assert_eq!(check(2.8, &[], ahead), Verdict::Blocked(BlockReason::Obstacle));
    assert_eq!(check(0.0, &person, ahead), Verdict::Blocked(BlockReason::MovingObstacle));
    assert_eq!(check(0.0, &[], Twist2::new(1.2, 0.0, 0.0)), Verdict::Blocked(BlockReason::Limits));
    assert!(!guard.touches(&request(0.0, &[])).unwrap() && guard.touches(&request(3.8, &[])).unwrap());
}

#[test]
fn bad_input_is_refused() {
    let footprint = outlines()[0].clone();
    for margin in [0.0, 2.0, f64::NAN] {
        assert!(Guard::new(footprint.clone(), GuardParams { margin }).is_err());
    }
    let local = LocalMap::new(&Costmap::from_map(&hall(0, 0)), LocalMapParams::default()).unwrap();
    let guard = Guard::new(footprint, GuardParams::default()).unwrap();
    let (path, limits) = (path(), MotionLimits::default());
    let state = VehicleState::new(Se2::default(), Twist2::ZERO);
    let good = LocalPlanRequest { state, path: &path, map: &local, obstacles: &[], limits: &limits, dt: DT };
    assert!(guard.check(&good, &Motion::REST).unwrap().is_clear());
    let nothing = Path::new();
    assert_eq!(
        guard.check(&LocalPlanRequest { path: &nothing, ..good }, &Motion::REST),
        Err(LocalPlanError::EmptyPath)
    );
    let mut broken = limits;
    broken.twist.deceleration = 0.0;
    assert!(guard.brake(&LocalPlanRequest { limits: &broken, ..good }).is_err());
    let mut lost = [MovingObstacle::new(Vector2::zeros(), Vector2::zeros(), 0.1).unwrap()];
    lost[0].velocity.x = f64::NAN;
    assert!(guard.brake(&LocalPlanRequest { obstacles: &lost, ..good }).is_err());
    for bad in [f64::NAN, f64::INFINITY] {
        let twist = Twist2::new(bad, 0.0, 0.0);
        assert!(guard.check(&good, &twist.into()).is_err());
        assert!(guard.check(&LocalPlanRequest { dt: bad, ..good }, &Motion::REST).is_err());
        assert!(guard.brake(&LocalPlanRequest { state: VehicleState { twist, ..state }, ..good }).is_err());
    }
}
