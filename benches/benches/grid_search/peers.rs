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

/// `grid_pathfinding`'s jump point search. It knows one rule of corners only, `CornerRule::Free`: a diagonal step may squeeze
/// between two blocked cells.
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
    way_points(grid, query).len()
}

/// Length of its path, in cells; none if it found none.
pub(crate) fn jump_length(grid: &PathingGrid, query: &Query) -> Option<f64> {
    let way = way_points(grid, query);
    let octile = |pair: &[Point]| {
        let (dx, dy) = (f64::from((pair[1].x - pair[0].x).abs()), f64::from((pair[1].y - pair[0].y).abs()));
        dx.max(dy) + (std::f64::consts::SQRT_2 - 1.0) * dx.min(dy)
    };
    (!way.is_empty()).then(|| way.windows(2).map(octile).sum())
}

fn way_points(grid: &PathingGrid, query: &Query) -> Vec<Point> {
    let point = |cell: agv_core::grid::Cell| Point::new(cell.x, cell.y);
    grid.get_waypoints_single_goal(point(query.start), point(query.goal), false).unwrap_or_default()
}
