//! Any-angle planners on random small grids, against the shortest way over all pairs of cells that see each other.

use agv_core::geometry::Se2;
use agv_core::grid::{Connectivity, CornerRule, Costmap, Grid, GridLayout, cost};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, NoPathReason, PlanOutcome};
use agv_plan::grid::{AStar, AStarParams, GridParams, GridPlanner, GridPlannerParams, GridSolver, GridSpace};
use agv_plan::grid::{LazyThetaStar, ThetaStar};
use proptest::prelude::*;

fn length(space: &GridSpace, a: u32, b: u32) -> f64 {
    let (a, b) = (space.cell(a), space.cell(b));
    f64::from(a.x - b.x).hypot(f64::from(a.y - b.y))
}

/// Length of the shortest way over centres of cells that see each other, by relaxation to the fixed point.
fn shortest(space: &GridSpace, start: u32, goal: u32) -> f64 {
    let free: Vec<u32> = (0..space.len() as u32).filter(|&n| space.is_passable(n)).collect();
    let mut edges = Vec::new();
    for &a in &free {
        edges
            .extend(free.iter().filter(|&&b| a != b && space.is_line_open(a, b)).map(|&b| (a, b, length(space, a, b))));
    }
    let mut best = vec![f64::INFINITY; space.len()];
    best[start as usize] = 0.0;
    loop {
        let mut changed = false;
        for &(a, b, length) in &edges {
            if best[a as usize] + length < best[b as usize] - 1e-12 {
                best[b as usize] = best[a as usize] + length;
                changed = true;
            }
        }
        if !changed {
            return best[goal as usize];
        }
    }
}

/// Cost of the path that a planner finds, which is the length of its way and runs along open lines.
fn solve<S: GridSolver>(
    planner: &mut GridPlanner<S>,
    costmap: &Costmap,
    (start, goal): (u32, u32),
) -> Result<Option<f64>, TestCaseError> {
    let pose = |node: u32| {
        let centre = costmap.layout().center(costmap.layout().cell(node as usize));
        Se2::new(centre.x, centre.y, 0.3)
    };
    let mut path = Path::new();
    match planner.plan_into(costmap, &pose(start), &pose(goal), &mut path).unwrap() {
        PlanOutcome::Found { cost, .. } => {
            prop_assert!((path.length() - cost).abs() < 1e-9, "{} for {}", path.length(), cost);
            prop_assert_eq!(path.points().first().map(|p| p.pose), Some(pose(start)));
            prop_assert_eq!(path.points().last().map(|p| p.pose), Some(pose(goal)));
            let mut way = Vec::new();
            planner.solver().way_into(planner.space(), goal, &mut way);
            prop_assert!(way.windows(2).all(|pair| planner.space().is_line_open(pair[0], pair[1])));
            Ok(Some(cost))
        }
        PlanOutcome::NoPath { reason, .. } => {
            prop_assert_eq!(reason, NoPathReason::Disconnected);
            Ok(None)
        }
        other => Err(TestCaseError::fail(format!("{other:?}"))),
    }
}

proptest! {
    /// Between the shortest of all ways and the shortest along the grid.
    #[test]
    fn any_angle_ways_lie_between_the_line_and_the_grid(
        costs in proptest::collection::vec(prop_oneof![7 => Just(cost::FREE), 3 => Just(cost::LETHAL)], 10 * 9),
        rule in prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)],
        four in any::<bool>(),
        picks in (any::<u32>(), any::<u32>()),
    ) {
        let layout = GridLayout::new(10, 9, 1.0, Se2::new(2.0, -3.0, 0.7)).unwrap();
        let costmap = Costmap::from_costs(Grid::new(layout, costs).unwrap());
        let connectivity = if four { Connectivity::Four } else { Connectivity::Eight };
        let grid = GridParams { connectivity, corner_rule: rule, ..Default::default() };
        let mut space = GridSpace::new(grid).unwrap();
        space.update(&costmap);
        let free: Vec<u32> = (0..90).filter(|&n| space.is_passable(n)).collect();
        prop_assume!(!free.is_empty());
        let ends = (free[picks.0 as usize % free.len()], free[picks.1 as usize % free.len()]);

        let params = GridPlannerParams { grid, ..Default::default() };
        let along = solve(&mut AStar::new(AStarParams { grid, ..Default::default() }).unwrap(), &costmap, ends)?;
        let theta = solve(&mut ThetaStar::new(params).unwrap(), &costmap, ends)?;
        let lazy = solve(&mut LazyThetaStar::new(params).unwrap(), &costmap, ends)?;
        let (Some(along), Some(theta), Some(lazy)) = (along, theta, lazy) else {
            prop_assert_eq!((along, theta, lazy), (None, None, None));
            return Ok(());
        };
        let least = shortest(&space, ends.0, ends.1);
        prop_assert!(theta >= least - 1e-9 && lazy >= least - 1e-9);
        // Integer costs are rounded by up to 1/985 of a cell per line.
        prop_assert!(theta <= along + 0.02, "{} along the grid {}", theta, along);
        prop_assert!(lazy <= along + 0.02, "{} along the grid {}", lazy, along);
    }
}
