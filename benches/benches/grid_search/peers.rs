//! The crates that do the same.

use crate::sets::Set;
use agv_plan::grid::{DIAGONAL, GridSpace, Heuristic, Octile, Offset, STRAIGHT, Step};
use agv_support::movingai::Query;
use grid_pathfinding::PathingGrid;
use grid_util::{grid::ValueGrid, point::Point};

/// `pathfinding`'s A* with the same integers, heuristic and corner rule.
pub(crate) fn astar(space: &GridSpace, query: &Query) -> Option<u32> {
    let (start, goal) = (space.node(query.start)?, space.node(query.goal)?);
    let width = space.layout()?.width() as u32;
    let octile = Octile(Offset::new(width, query.goal));
    let successors = |&node: &u32| {
        let mask = space.mask(node);
        Step::ALL.into_iter().filter(move |step| mask & step.bit() != 0).map(move |step| {
            let stride = (step.dx() as u32).wrapping_add((step.dy() as u32).wrapping_mul(width));
            let cost = if step.is_diagonal() { DIAGONAL } else { STRAIGHT };
            (node.wrapping_add(stride), cost)
        })
    };
    pathfinding::directed::astar::astar(&start, successors, |&n| octile.estimate(n), |&n| n == goal).map(|r| r.1)
}

/// `grid_pathfinding`'s jump point search. It knows one rule of corners only, by which a diagonal step may pass a blocked
/// cell, so that its paths are shorter than ours where that pays, and other ones are searched.
pub(crate) fn jump_grid(set: &Set) -> PathingGrid {
    let layout = set.costmap.layout();
    let mut grid = PathingGrid::new(layout.width(), layout.height(), false);
    for index in 0..layout.len() {
        let cell = layout.cell(index);
        if !set.space.is_passable(index as u32) {
            grid.set(cell.x, cell.y, true);
        }
    }
    grid.generate_components();
    grid
}

/// Number of its way points.
pub(crate) fn jump(grid: &PathingGrid, query: &Query) -> usize {
    let point = |cell: agv_core::grid::Cell| Point::new(cell.x, cell.y);
    grid.get_waypoints_single_goal(point(query.start), point(query.goal), false).map_or(0, |way| way.len())
}
