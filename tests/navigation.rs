//! Navigation among obstacles that are seen on the way: an ideal vehicle in a map that is uncovered as it comes near.

use agv_nav::{
    control::track::{FollowerParams, PurePursuit, PurePursuitParams},
    core::{
        geometry::Twist2,
        grid::{CollisionParams, Footprint, Inflation, InflationParams, LocalMapParams},
        nalgebra::Vector2,
        obstacle::MovingObstacle,
        roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanStatus, NoPathReason, PlanError},
    },
    pipeline::{GiveUpReason, Navigation, NavigationParams, NavigationRequest, NavigationStatus},
    plan::{
        grid::{AStar, AStarParams, GridParams, UnknownCells},
        local::{Tracked, TrackedParams},
        smooth::{KeyNodes, LineOfSightParams, Straightened},
    },
    prelude::*,
};

const DT: f64 = 0.1;
/// How far the vehicle sees, in metres.
const SIGHT: f64 = 2.5;

fn footprint() -> Footprint {
    Footprint::rectangle(-0.25, 0.25, 0.4).unwrap()
}

fn navigation(params: NavigationParams) -> Navigation {
    let grid = GridParams { cost_weight: 4.0, unknown: UnknownCells::AtCost(0), ..GridParams::default() };
    let astar = AStar::new(AStarParams { grid, start_tolerance: 0.5, ..AStarParams::default() }).unwrap();
    let key_nodes =
        KeyNodes::new(LineOfSightParams { max_cost: 60, cross_unknown: true, ..Default::default() }).unwrap();
    let follower = FollowerParams { response_time: 0.0, max_yaw_slip: 0.0, ..FollowerParams::default() };
    let tracker = PurePursuit::new(PurePursuitParams { look_ahead_min: 0.3, follower, ..Default::default() }).unwrap();
    let local = Tracked::new(tracker, footprint(), TrackedParams::default()).unwrap();
    Navigation::new(Box::new(Straightened::new(astar, key_nodes)), Box::new(local), footprint(), params).unwrap()
}

/// A world of 8 m by 6 m, of which cells are known that the vehicle came near to.
struct World {
    truth: Grid<CellState>,
    seen: Grid<CellState>,
    inflation: Inflation,
    local: LocalMap,
}

impl World {
    fn new(is_solid: impl Fn(f64, f64) -> bool) -> Self {
        let layout = GridLayout::new(160, 120, 0.05, Se2::default()).unwrap();
        let state = |i| {
            let centre = layout.center(layout.cell(i));
            if is_solid(centre.x, centre.y) { CellState::Occupied } else { CellState::Free }
        };
        let truth = Grid::new(layout, (0..layout.len()).map(state).collect()).unwrap();
        let seen = Grid::filled(layout, CellState::Unknown);
        let params = InflationParams { cost_scaling_factor: 4.0, ..InflationParams::for_footprint(&footprint()) };
        let mut inflation = Inflation::new(params).unwrap();
        let collision = CollisionParams { unknown_is_obstacle: false, outside_is_obstacle: true };
        let params = LocalMapParams { collision, ..LocalMapParams::default() };
        let local = LocalMap::new(&inflation.inflate(&seen).unwrap(), params).unwrap();
        Self { truth, seen, inflation, local }
    }

    fn look(&mut self, here: &Se2) {
        for i in 0..self.truth.layout().len() {
            let cell = self.truth.layout().cell(i);
            if (self.truth.layout().center(cell) - here.translation()).norm() < SIGHT {
                self.seen.set(cell, self.truth.values()[i]);
            }
        }
        self.local.update(&self.inflation.inflate(&self.seen).unwrap()).unwrap();
    }

    fn touches(&self, here: &Se2) -> bool {
        let solid = LocalMap::new(&Costmap::from_map(&self.truth), LocalMapParams::default()).unwrap();
        solid.collides(&footprint(), here).unwrap()
    }
}

/// Drives until the navigation ends; every command keeps the limits, and no pose touches anything.
fn drive(world: &mut World, navigation: &mut Navigation, start: Se2, cycles: usize) -> (NavigationStatus, Se2) {
    drive_with(world, navigation, start, cycles, Twist2::ZERO)
}

/// The same, with a twist that is measured with an error.
fn drive_with(
    world: &mut World,
    navigation: &mut Navigation,
    start: Se2,
    cycles: usize,
    error: Twist2,
) -> (NavigationStatus, Se2) {
    let limits: MotionLimits = TwistLimits::default().into();
    let mut state = VehicleState::new(start, Twist2::ZERO);
    let mut status = NavigationStatus::Idle;
    for cycle in 0..cycles {
        world.look(&state.map_from_base);
        state.twist = Twist2::new(state.twist.vx + error.vx, 0.0, state.twist.yaw_rate + error.yaw_rate);
        let request = NavigationRequest { state, map: &world.local, obstacles: &[], limits: &limits, dt: DT };
        let command = navigation.cycle(request).unwrap();
        assert!(limits.allows_step(&state.motion(), &command.motion, DT), "{cycle}: {command:?}");
        state = state.after(&command.motion, DT);
        assert!(cycle % 10 != 0 || !world.touches(&state.map_from_base), "{cycle}: {state:?}");
        status = command.status;
        if matches!(status, NavigationStatus::Arrived | NavigationStatus::GaveUp(_)) {
            break;
        }
    }
    (status, state.map_from_base)
}

#[test]
fn arrives_around_a_wall_that_was_not_known() {
    // The wall bars the straight way; its open end shows only from near.
    let mut world = World::new(|x, y| (3.9..4.1).contains(&x) && y < 4.2);
    let mut navigation = navigation(NavigationParams::default());
    let goal = Se2::new(7.0, 2.0, 0.0);
    navigation.go_to(&goal).unwrap();
    let (status, end) = drive(&mut world, &mut navigation, Se2::new(1.0, 2.0, 0.0), 1200);
    assert_eq!(status, NavigationStatus::Arrived);
    assert!((end.translation() - goal.translation()).norm() < 0.25, "{end:?}");
}

#[test]
fn gives_up_where_there_is_no_way_and_says_so() {
    let mut world = World::new(|x, _| (3.9..4.1).contains(&x));
    let mut navigation = navigation(NavigationParams { recoveries: 3, ..NavigationParams::default() });
    navigation.go_to(&Se2::new(7.0, 2.0, 0.0)).unwrap();
    let (status, end) = drive(&mut world, &mut navigation, Se2::new(1.0, 2.0, 0.0), 3000);
    assert_eq!(status, NavigationStatus::GaveUp(GiveUpReason::NoPath(NoPathReason::Disconnected)));
    assert!(end.x() < 3.7, "{end:?}");
    // Another goal is another matter.
    navigation.go_to(&Se2::new(2.0, 3.5, 0.0)).unwrap();
    let (status, _) = drive(&mut world, &mut navigation, end, 1200);
    assert_eq!(status, NavigationStatus::Arrived);
}

/// The straight way, whatever stands in it.
struct Straight;

impl GlobalPlanner for Straight {
    fn plan_with_cancel(
        &mut self,
        _: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
        _: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError> {
        path.set_positions([start.translation(), goal.translation()])?;
        Ok(PlanOutcome::Found { cost: path.length(), expansions: 0 })
    }
}

/// Drives ahead, and never beyond one `x`.
struct BlockedAt(f64);

impl LocalPlanner for BlockedAt {
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        let is_blocked = request.state.map_from_base.x() >= self.0;
        let wish = if is_blocked { Twist2::ZERO } else { Twist2::new(0.3, 0.0, 0.0) };
        let motion = request.limits.step(&request.state.motion(), &wish.into(), request.dt)?;
        let status =
            if is_blocked { LocalPlanStatus::Blocked(BlockReason::Obstacle) } else { LocalPlanStatus::Following };
        Ok(LocalCommand { motion, status })
    }
}

#[test]
fn backing_off_and_coming_again_is_no_progress() {
    for error in [Twist2::ZERO, Twist2::new(1e-4, 0.0, 1e-4)] {
        let mut world = World::new(|x, _| (4.4..4.6).contains(&x));
        let local = Box::new(BlockedAt(4.0));
        let mut navigation =
            Navigation::new(Box::new(Straight), local, footprint(), NavigationParams::default()).unwrap();
        navigation.go_to(&Se2::new(7.0, 2.0, 0.0)).unwrap();
        let (status, end) = drive_with(&mut world, &mut navigation, Se2::new(1.0, 2.0, 0.0), 3000, error);
        assert_eq!(status, NavigationStatus::GaveUp(GiveUpReason::Blocked(BlockReason::Obstacle)));
        assert!((3.0..4.2).contains(&end.x()), "{end:?}");
    }
}

/// Who comes, and what becomes of a vehicle that drives ahead and brakes for nobody: the least gap of the drive.
fn meet(world: &mut World, foresight: f64, from: Vector2<f64>, velocity: Vector2<f64>) -> f64 {
    let params = NavigationParams { foresight, ..NavigationParams::default() };
    let local = Box::new(BlockedAt(4.0));
    let mut navigation = Navigation::new(Box::new(Straight), local, footprint(), params).unwrap();
    navigation.go_to(&Se2::new(7.0, 3.0, 0.0)).unwrap();
    let limits: MotionLimits = TwistLimits { yaw_rate: 2.0, yaw_acceleration: 4.0, ..TwistLimits::default() }.into();
    let mut state = VehicleState::new(Se2::new(2.0, 3.0, 0.0), Twist2::ZERO);
    let mut least = f64::INFINITY;
    for cycle in 0..100 {
        let somebody = MovingObstacle::new(from + velocity * (DT * f64::from(cycle)), velocity, 0.3).unwrap();
        world.look(&state.map_from_base);
        let obstacles = [somebody];
        let request = NavigationRequest { state, map: &world.local, obstacles: &obstacles, limits: &limits, dt: DT };
        let command = navigation.cycle(request).unwrap();
        assert!(limits.allows_step(&state.motion(), &command.motion, DT), "{cycle}: {command:?}");
        for tenth in 0..10 {
            let time = 0.1 * DT * f64::from(tenth);
            let pose = state.map_from_base * command.motion.twist.integrate(time);
            least = least.min(somebody.gap_after(time, &footprint(), &pose));
        }
        state = state.after(&command.motion, DT);
        assert!(cycle % 10 != 0 || !world.touches(&state.map_from_base), "{cycle}: {state:?}");
    }
    least
}

/// From all sides, straight at where the vehicle will be after five seconds.
#[test]
fn gets_out_of_the_way_of_who_would_run_into_it() {
    let mut world = World::new(|x, y| !(0.1..7.9).contains(&x) || !(0.1..5.9).contains(&y));
    let mut hit = 0;
    for k in 0..12 {
        let angle = std::f64::consts::TAU * (f64::from(k) + 0.5) / 12.0;
        let velocity = Vector2::new(angle.cos(), angle.sin()) * 0.7;
        let from = Vector2::new(3.5, 3.0) - velocity * 5.0;
        let gap = meet(&mut world, 2.5, from, velocity);
        assert!(gap > 0.0, "{k}: {gap}");
        hit += usize::from(meet(&mut world, 0.0, from, velocity) <= 0.0);
    }
    // Who minds nobody is run into, mostly.
    assert!(hit > 6, "{hit}");
}

/// In a passage there is no side to go to: the vehicle backs off, and touches no wall.
#[test]
fn backs_off_where_there_is_no_side_to_go_to() {
    let mut world = World::new(|x, y| !(0.1..7.9).contains(&x) || !(2.4..3.6).contains(&y));
    let gap = meet(&mut world, 2.5, Vector2::new(5.5, 3.0), Vector2::new(-0.2, 0.0));
    assert!(gap > 0.0, "{gap}");
}

#[test]
fn without_a_goal_it_brakes() {
    let mut world = World::new(|_, _| false);
    world.look(&Se2::new(2.0, 2.0, 0.0));
    let limits: MotionLimits = TwistLimits::default().into();
    let mut navigation = navigation(NavigationParams::default());
    let mut state = VehicleState::new(Se2::new(2.0, 2.0, 0.0), Twist2::new(0.5, 0.0, 0.2));
    for _ in 0..20 {
        let request = NavigationRequest { state, map: &world.local, obstacles: &[], limits: &limits, dt: DT };
        let command = navigation.cycle(request).unwrap();
        assert_eq!(command.status, NavigationStatus::Idle);
        state = state.after(&command.motion, DT);
    }
    assert_eq!(state.twist, Twist2::ZERO);
}

#[test]
fn bad_input_is_refused() {
    let world = World::new(|_, _| false);
    let limits: MotionLimits = TwistLimits::default().into();
    let mut navigation = navigation(NavigationParams::default());
    for bad in [f64::NAN, f64::INFINITY] {
        assert!(navigation.go_to(&Se2::new(bad, 0.0, 0.0)).is_err());
        assert!(navigation.goal().is_none());
        let good = NavigationRequest {
            state: VehicleState::new(Se2::new(2.0, 2.0, 0.0), Twist2::ZERO),
            map: &world.local,
            obstacles: &[],
            limits: &limits,
            dt: DT,
        };
        let nowhere = VehicleState::new(Se2::new(0.0, bad, 0.0), Twist2::ZERO);
        assert!(navigation.cycle(NavigationRequest { state: nowhere, ..good }).is_err());
        for dt in [bad, 0.0, -0.1] {
            assert!(navigation.cycle(NavigationRequest { dt, ..good }).is_err());
        }
    }
    let good = NavigationParams::default();
    for params in [
        NavigationParams { plan_period: 0.0, ..good },
        NavigationParams { retry_period: f64::NAN, ..good },
        NavigationParams { hysteresis: 1.5, ..good },
        NavigationParams { cost_weight: -1.0, ..good },
        NavigationParams { reach: 0.0, ..good },
        NavigationParams { border: f64::NAN, ..good },
        NavigationParams { goal_tolerance: 0.0, ..good },
        NavigationParams { patience: -1.0, ..good },
        NavigationParams { foresight: f64::NAN, ..good },
    ] {
        let astar = AStar::new(AStarParams::default()).unwrap();
        let tracker = PurePursuit::new(PurePursuitParams::default()).unwrap();
        let local = Tracked::new(tracker, footprint(), TrackedParams::default()).unwrap();
        assert!(Navigation::new(Box::new(astar), Box::new(local), footprint(), params).is_err(), "{params:?}");
    }
}
