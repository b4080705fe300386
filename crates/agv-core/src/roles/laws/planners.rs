//! Laws of [`GlobalPlanner`] and [`LocalPlanner`].

use super::{LawViolation, NOT_FINITE, ensure};
use crate::{
    geometry::{LieGroup, Se2, Twist2},
    grid::{CellState, CollisionChecker, CollisionParams, Costmap, Footprint, Grid, cost},
    path::Path,
    roles::{
        GlobalPlanner, LocalPlanRequest, LocalPlanStatus, LocalPlanner, NoPathReason, PlanError, PlanOutcome,
        VehicleState,
    },
};
use nalgebra::Vector2;

/// Checks a global planner on a query that has an answer: `costmap` joins `start` and `goal`.
///
/// # Errors
/// The first law that was broken.
pub fn global_planner(
    player: &mut dyn GlobalPlanner,
    costmap: &Costmap,
    start: &Se2,
    goal: &Se2,
) -> Result<(), LawViolation> {
    const ROLE: &str = "GlobalPlanner";
    let mut path = Path::new();
    for value in NOT_FINITE {
        let nowhere = Se2::new(value, 0.0, 0.0);
        let refused = player.plan_into(costmap, &nowhere, goal, &mut path).is_err()
            && player.plan_into(costmap, start, &nowhere, &mut path).is_err();
        ensure(ROLE, "a pose that is not finite is refused", refused && path.is_empty())?;
    }
    let far = Se2::new(1e9, 1e9, 0.0);
    let outside = matches!(player.plan_into(costmap, &far, goal, &mut path), Err(PlanError::StartOutside { .. }))
        && matches!(player.plan_into(costmap, start, &far, &mut path), Err(PlanError::GoalOutside { .. }));
    ensure(ROLE, "a pose outside the map is refused by name", outside && path.is_empty())?;

    let outcome = player.plan_into(costmap, start, goal, &mut path);
    let found = matches!(outcome, Ok(PlanOutcome::Found { cost, .. }) if cost.is_finite() && cost >= 0.0);
    ensure(ROLE, "a path that exists is found", found)?;
    let ends = |path: &Path| path.points().first().zip(path.points().last()).map(|(a, b)| (a.pose, b.pose));
    let at_ends = ends(&path).is_some_and(|(first, last)| {
        (first.translation() - start.translation()).norm() <= costmap.layout().resolution()
            && (last.translation() - goal.translation()).norm() <= costmap.layout().resolution()
    });
    ensure(ROLE, "the path leads from start to goal", at_ends)?;
    ensure(ROLE, "the path keeps to cells that may be entered", is_traversable(costmap, &path))?;

    let mut again = Path::new();
    let second = player.plan_with_cancel(costmap, start, goal, &mut again, &mut || false);
    // A planner that remembers may have less to do, so the expansions are not compared.
    let cost = |outcome| match outcome {
        Ok(PlanOutcome::Found { cost, .. }) => Some(f64::to_bits(cost)),
        _ => None,
    };
    let same = cost(second) == cost(outcome) && again == path;
    ensure(ROLE, "the same query has the same answer, bit for bit", same)?;

    for patience in [0, 1] {
        let (mut asked, mut said) = (0, false);
        let mut asked_again = false;
        let mut cancelled = || {
            asked_again |= said;
            said = asked >= patience;
            asked += 1;
            said
        };
        let stopped = player.plan_with_cancel(costmap, start, goal, &mut path, &mut cancelled);
        ensure(ROLE, "who said to stop is not asked again", !asked_again)?;
        // A planner may have a path by the time it asks.
        let is_told = match stopped {
            Ok(PlanOutcome::Found { .. }) => true,
            Ok(PlanOutcome::NoPath { reason, .. }) => said && reason == NoPathReason::Cancelled,
            Err(_) => false,
        };
        ensure(ROLE, "a query that is cancelled says so", is_told)?;
        let from_start = path.points().first().is_none_or(|first| first.pose.translation() == start.translation());
        ensure(
            ROLE,
            "the path of a cancelled query begins at the start",
            from_start && is_traversable(costmap, &path),
        )?;
    }

    let trivial = player.plan_into(costmap, start, start, &mut path);
    let stays = matches!(trivial, Ok(PlanOutcome::Found { .. })) && !path.is_empty();
    ensure(ROLE, "a goal at the start is found", stays)?;

    if let Some(wall) =
        (0..costmap.layout().len()).map(|i| costmap.layout().cell(i)).find(|c| !costmap.is_traversable(*c))
    {
        let center = costmap.layout().center(wall);
        let inside = Se2::new(center.x, center.y, 0.0);
        let blocked = player.plan_into(costmap, &inside, goal, &mut path);
        let said = matches!(blocked, Ok(PlanOutcome::NoPath { .. })) && path.is_empty();
        ensure(ROLE, "a start where the vehicle cannot stand is an outcome", said)?;
    }
    Ok(())
}

/// Whether the straight lines of the path cross cells that may be entered only; sampled at a quarter of a cell. A point on an
/// edge, up to rounding, belongs to the cells on either side of it.
fn is_traversable(costmap: &Costmap, path: &Path) -> bool {
    let layout = costmap.layout();
    let step = 0.25 * layout.resolution();
    let hair = 1e-6 * layout.resolution();
    let enterable = |point: Vector2<f64>| {
        [(0.0, 0.0), (-hair, -hair), (hair, -hair), (-hair, hair), (hair, hair)].into_iter().any(|(dx, dy)| {
            let off = layout.map_from_grid().rotation().act(&Vector2::new(dx, dy));
            layout.cell_at(&(point + off)).is_some_and(|cell| costmap.is_traversable(cell))
        })
    };
    path.points().windows(2).all(|w| {
        let (a, b) = (w[0].pose.translation(), w[1].pose.translation());
        let samples = ((b - a).norm() / step).ceil().max(1.0) as usize;
        (0..=samples).all(|i| enterable(a + (b - a) * (i as f64 / samples as f64)))
    })
}

/// Checks a local planner on a request of a vehicle that touches nothing lethal: an ideal vehicle with that `footprint`
/// never does so on its way, keeps all limits at once, and comes to rest within `tolerance` metres of the path's end and
/// `heading_tolerance` radians (π for any) of its last heading, or says that it is blocked.
///
/// [`vehicles`](super::vehicles) has limits to try it with.
///
/// # Errors
/// The first law that was broken.
pub fn local_planner(
    player: &mut dyn LocalPlanner,
    request: LocalPlanRequest<'_>,
    footprint: &Footprint,
    tolerance: f64,
    heading_tolerance: f64,
) -> Result<(), LawViolation> {
    const ROLE: &str = "LocalPlanner";
    for value in NOT_FINITE {
        let nowhere = VehicleState { map_from_base: Se2::new(value, 0.0, 0.0), ..request.state };
        let flying = VehicleState { twist: Twist2::new(value, 0.0, 0.0), ..request.state };
        let refused = player.command(LocalPlanRequest { state: nowhere, ..request }).is_err()
            && player.command(LocalPlanRequest { state: flying, ..request }).is_err()
            && player.command(LocalPlanRequest { dt: value, ..request }).is_err();
        ensure(ROLE, "a request that is not finite is refused", refused)?;
    }
    ensure(ROLE, "a dt of zero is refused", player.command(LocalPlanRequest { dt: 0.0, ..request }).is_err())?;
    let nothing = Path::new();
    ensure(ROLE, "an empty path is refused", player.command(LocalPlanRequest { path: &nothing, ..request }).is_err())?;

    let Ok(mut obstacles) = lethal(request.map.costmap(), footprint) else {
        return ensure(ROLE, "the case is a sound one: its costmap can be checked", false);
    };
    let mut state = request.state;
    // Ten times as long as the path takes at full speed, and a minute for turning and braking.
    let cycles =
        ((10.0 * request.path.length() / request.limits.twist.forward_speed.max(0.01) + 60.0) / request.dt).ceil();
    for _ in 0..cycles as usize {
        let Ok(command) = player.command(LocalPlanRequest { state, ..request }) else {
            return ensure(ROLE, "a good request is taken", false);
        };
        let within = request.limits.allows_step(&state.motion(), &command.motion, request.dt);
        ensure(ROLE, "a command respects every limit", within)?;
        ensure(
            ROLE,
            "the vehicle touches nothing",
            !sweeps(&mut obstacles, &state.map_from_base, &command.motion.twist, request.dt),
        )?;
        state = state.after(&command.motion, request.dt);
        match command.status {
            LocalPlanStatus::Arrived if state.twist == Twist2::ZERO => {
                let end = request.path.points().last().map_or(state.map_from_base, |end| end.pose);
                let end_from_base = end.inverse().compose(&state.map_from_base);
                let at_end = end_from_base.translation().norm() <= tolerance;
                ensure(ROLE, "a vehicle that arrived is at the end of the path", at_end)?;
                let headed = end_from_base.yaw().abs() <= heading_tolerance;
                return ensure(ROLE, "a vehicle that arrived has the heading of the end", headed);
            }
            LocalPlanStatus::Blocked(_) if state.twist == Twist2::ZERO => return Ok(()),
            LocalPlanStatus::InCollision => {
                return ensure(ROLE, "a vehicle that touches nothing is in no collision", false);
            }
            _ => {}
        }
    }
    ensure(ROLE, "the vehicle arrives and comes to rest, or stands and says that it is blocked", false)
}

/// A checker of one vehicle against the lethal cells of a costmap.
fn lethal(costmap: &Costmap, footprint: &Footprint) -> Result<CollisionChecker, crate::Error> {
    let state = |&c: &u8| if c == cost::LETHAL { CellState::Occupied } else { CellState::Free };
    let map = Grid::new(*costmap.layout(), costmap.costs().iter().map(state).collect())?;
    let params = CollisionParams { outside_is_obstacle: false, ..CollisionParams::default() };
    CollisionChecker::new(&map, footprint.clone(), params)
}

/// Whether the vehicle touches an obstacle in a cycle; sampled so that no point moves farther than a quarter of a cell, and
/// exact at the samples: unlike [`CollisionChecker::collides_along`] it blames nobody who only passes nearby.
fn sweeps(obstacles: &mut CollisionChecker, from: &Se2, twist: &Twist2, dt: f64) -> bool {
    let reach = twist.speed() + twist.yaw_rate.abs() * obstacles.footprint().circumscribed_radius();
    let samples = (reach * dt / (0.25 * obstacles.layout().resolution())).ceil().max(1.0) as usize;
    (1..=samples).any(|i| {
        let pose = from.compose(&twist.integrate(dt * i as f64 / samples as f64));
        obstacles.collides(&pose).unwrap_or(true)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        check,
        grid::{Cell, GridLayout, LocalMap, LocalMapParams},
        kinematics::MotionLimits,
        roles::{BlockReason, LocalCommand, LocalPlanError},
    };

    const BLOCKED: LocalPlanStatus = LocalPlanStatus::Blocked(BlockReason::Obstacle);

    /// Goes straight at half a metre per second, looking at nothing, until it says what it always says.
    struct Straight {
        speed: f64,
        says: LocalPlanStatus,
    }

    impl LocalPlanner for Straight {
        fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
            check::positive("dt", request.dt)?;
            let end = request.path.points().last().ok_or(LocalPlanError::EmptyPath)?.pose;
            if !request.state.is_finite() {
                check::finite("state", f64::NAN)?;
            }
            let rest = end.x() - request.state.map_from_base.x();
            let (wish, status) = if rest < 0.3 { (0.0, LocalPlanStatus::Arrived) } else { (self.speed, self.says) };
            let wish = Twist2::new(wish, 0.0, 0.0).into();
            let motion = request.limits.step(&request.state.motion(), &wish, request.dt)?;
            Ok(LocalCommand { motion, status })
        }
    }

    #[test]
    fn local_planners_that_cheat_are_caught() {
        let verdict = |wall: bool, speed: f64, says| {
            let mut map = Grid::filled(GridLayout::new(100, 40, 0.1, Se2::default()).unwrap(), CellState::Free);
            if wall {
                map.set(Cell::new(50, 20), CellState::Occupied);
            }
            let costmap = Costmap::from_map(&map);
            let path = Path::from_positions(&[Vector2::new(1.0, 2.0), Vector2::new(8.0, 2.0)]).unwrap();
            let state = VehicleState::new(Se2::new(1.0, 2.0, 0.0), Twist2::ZERO);
            let limits = &MotionLimits::default();
            let map = &LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
            let request = LocalPlanRequest { state, path: &path, map, obstacles: &[], limits, dt: 0.1 };
            let footprint = Footprint::circle(0.3).unwrap();
            local_planner(&mut Straight { speed, says }, request, &footprint, 0.4, 0.1)
                .map_err(|violation| violation.law)
        };
        assert_eq!(verdict(false, 0.5, LocalPlanStatus::Following), Ok(()));
        assert_eq!(verdict(true, 0.0, BLOCKED), Ok(()));
        for (wall, speed, says, law) in [
            (true, 0.5, LocalPlanStatus::Following, "the vehicle touches nothing"),
            (true, 0.5, BLOCKED, "the vehicle touches nothing"),
            (
                false,
                0.0,
                LocalPlanStatus::Following,
                "the vehicle arrives and comes to rest, or stands and says that it is blocked",
            ),
            (false, 0.0, LocalPlanStatus::Arrived, "a vehicle that arrived is at the end of the path"),
            (false, 0.0, LocalPlanStatus::InCollision, "a vehicle that touches nothing is in no collision"),
        ] {
            assert_eq!(verdict(wall, speed, says), Err(law), "{says:?} at {speed} m/s");
        }
    }
}
