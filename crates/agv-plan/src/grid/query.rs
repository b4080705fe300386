//! From poses to nodes and back: what all planners on grids share.

use super::{space::GridSpace, step::Step};
use agv_core::{
    Error, check,
    geometry::{Se2, So2},
    grid::{Cell, CornerRule, GridLayout},
    path::{Gear, Path, PathPoint},
    roles::{NoPathReason, PlanError},
};
use nalgebra::Vector2;

/// How far start and goal may move to a cell where the vehicle can stand, in metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tolerances {
    pub(super) start: f64,
    pub(super) goal: f64,
}

/// Start and goal as nodes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Endpoints {
    pub(super) start: u32,
    pub(super) goal: u32,
}

/// Nodes of the poses, each moved to the nearest passable cell within its tolerance, or why there are none.
pub(super) fn endpoints(
    space: &GridSpace,
    layout: &GridLayout,
    (start, goal): (&Se2, &Se2),
    tolerances: Tolerances,
) -> Result<Result<Endpoints, NoPathReason>, PlanError> {
    for (name, pose) in [("start", start), ("goal", goal)] {
        check::all_finite(name, &[pose.x(), pose.y(), pose.yaw()])?;
    }
    let start_cell =
        layout.cell_at(&start.translation()).ok_or(PlanError::StartOutside { x: start.x(), y: start.y() })?;
    let goal_cell = layout.cell_at(&goal.translation()).ok_or(PlanError::GoalOutside { x: goal.x(), y: goal.y() })?;
    let nearest = |pose: &Se2, cell: Cell, tolerance: f64| match space.node(cell) {
        Some(node) if space.is_passable(node) => Some(node),
        _ => nearest_node(space, pose, tolerance, |node| space.is_passable(node)),
    };
    let Some(start) = nearest(start, start_cell, tolerances.start) else {
        return Ok(Err(NoPathReason::StartBlocked));
    };
    let Some(goal) = nearest(goal, goal_cell, tolerances.goal) else { return Ok(Err(NoPathReason::GoalBlocked)) };
    Ok(Ok(Endpoints { start, goal }))
}

/// Node whose cell's centre lies nearest to the pose, among those within `tolerance` that `accept` takes; none for a
/// tolerance of zero.
pub(super) fn nearest_node(space: &GridSpace, pose: &Se2, tolerance: f64, accept: impl Fn(u32) -> bool) -> Option<u32> {
    let layout = space.layout().filter(|_| tolerance > 0.0)?;
    let accepts = |cell| space.node(cell).is_some_and(&accept);
    layout.nearest_cell(&pose.translation(), tolerance, accepts).and_then(|cell| space.node(cell))
}

/// Writes the way as a path: the start pose, the cells' centres, each heading to the next, and the goal pose.
///
/// Start and goal pose stand for the centres of their own cells where the line to the next centre provably stays in free
/// cells: along a row or column of cells always, along a diagonal step if no corner may be cut. The path ends with the goal
/// pose if the way ends in its cell, otherwise at the last centre with the goal's heading.
pub(super) fn write_path(
    space: &GridSpace,
    layout: &GridLayout,
    way: &[u32],
    (start, goal): (&Se2, &Se2),
    path: &mut Path,
) -> Result<(), Error> {
    path.clear();
    let (Some(&first), Some(&last)) = (way.first(), way.last()) else { return Ok(()) };
    let node_at = |pose: &Se2| layout.cell_at(&pose.translation()).and_then(|cell| space.node(cell));
    let never_cuts = space.params().corner_rule == CornerRule::Never;
    let may_skip = |pair: Option<&[u32]>| match pair {
        Some(&[a, b]) => {
            let (dx, dy) = offset_between(space, a, b);
            dx == 0 || dy == 0 || (never_cuts && dx.abs() == 1 && dy.abs() == 1)
        }
        _ => true,
    };
    let skip_first = node_at(start) == Some(first) && may_skip(way.get(..2));
    let reaches_goal = node_at(goal) == Some(last);
    let skip_last = reaches_goal && may_skip(way.len().checked_sub(2).and_then(|from| way.get(from..)));
    let yaw = layout.map_from_grid().rotation();
    // The headings of the eight steps, computed once.
    let headings = Step::ALL.map(|step| yaw * So2::from_direction(f64::from(step.dx()), f64::from(step.dy())));

    let point = |pose: Se2| PathPoint { pose, gear: Gear::Forward };
    path.push(point(*start))?;
    let from = usize::from(skip_first).min(way.len());
    let to = (way.len() - usize::from(skip_last)).max(from);
    let mut ahead = way.get(from).map(|&node| space.cell(node));
    for i in from..to {
        let Some(cell) = ahead else { break };
        ahead = way.get(i + 1).map(|&node| space.cell(node));
        let center = layout.center(cell);
        let pose = match ahead {
            // The last centre before the goal pose looks at the pose itself.
            Some(_) if i + 2 == way.len() && skip_last => looking_at(center, &goal.translation(), goal),
            Some(next) => {
                let (dx, dy) = (next.x - cell.x, next.y - cell.y);
                let known = headings.get(Step::towards(dx, dy).index());
                let heading = match known.filter(|_| dx == 0 || dy == 0 || dx.abs() == dy.abs()) {
                    Some(&along_step) => along_step,
                    None => yaw * So2::from_direction(f64::from(dx), f64::from(dy)),
                };
                Se2::from_parts(center, heading)
            }
            None if reaches_goal => looking_at(center, &goal.translation(), goal),
            None => Se2::from_parts(center, goal.rotation()),
        };
        path.push(point(pose))?;
    }
    if reaches_goal {
        path.push(point(*goal))?;
    }
    Ok(())
}

/// The pose at `from` that looks at `to`, or as `fallback` does where they coincide.
fn looking_at(from: Vector2<f64>, to: &Vector2<f64>, fallback: &Se2) -> Se2 {
    let ahead = to - from;
    let heading = if ahead == Vector2::zeros() { fallback.rotation() } else { So2::from_direction(ahead.x, ahead.y) };
    Se2::from_parts(from, heading)
}

fn offset_between(space: &GridSpace, a: u32, b: u32) -> (i32, i32) {
    let (a, b) = (space.cell(a), space.cell(b));
    (b.x - a.x, b.y - a.y)
}
