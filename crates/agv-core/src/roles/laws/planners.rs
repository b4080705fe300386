//! Laws of [`GlobalPlanner`] and [`LocalPlanner`].

use super::{LawViolation, NOT_FINITE, ensure};
use crate::{
    geometry::{LieGroup, Se2, Twist2},
    grid::Costmap,
    path::Path,
    roles::{GlobalPlanner, LocalPlanRequest, LocalPlanner, PlanError, PlanOutcome, VehicleState},
};

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
    let second = player.plan_into(costmap, start, goal, &mut again);
    ensure(ROLE, "the same query has the same answer, bit for bit", second == outcome && again == path)?;

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

/// Whether the straight lines of the path cross cells that may be entered only; sampled at a quarter of a cell.
fn is_traversable(costmap: &Costmap, path: &Path) -> bool {
    let step = 0.25 * costmap.layout().resolution();
    path.points().windows(2).all(|w| {
        let (a, b) = (w[0].pose.translation(), w[1].pose.translation());
        let samples = ((b - a).norm() / step).ceil().max(1.0) as usize;
        (0..=samples).all(|i| {
            let point = a + (b - a) * (i as f64 / samples as f64);
            costmap.layout().cell_at(&point).is_some_and(|cell| costmap.is_traversable(cell))
        })
    })
}

/// Checks a local planner on a request that has an answer.
///
/// # Errors
/// The first law that was broken.
pub fn local_planner(player: &mut dyn LocalPlanner, request: LocalPlanRequest<'_>) -> Result<(), LawViolation> {
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

    let mut state = request.state;
    for _ in 0..100 {
        let Ok(command) = player.command(LocalPlanRequest { state, ..request }) else {
            return ensure(ROLE, "a good request is taken", false);
        };
        let within = request.limits.allows_step(&state.twist, &command.twist, request.dt);
        ensure(ROLE, "a command respects every limit", within)?;
        state.twist = command.twist;
        state.map_from_base = state.map_from_base.compose(&command.twist.integrate(request.dt));
    }
    Ok(())
}
