//! The planners keep the laws of their role, on random maps with walls.

use agv_core::compute::Seed;
use agv_core::geometry::Se2;
use agv_core::grid::{Cell, Costmap, Grid, GridLayout, cost};
use agv_core::nalgebra::Vector2;
use agv_core::roles::{GlobalPlanner, laws};
use agv_plan::grid::{
    AStar, AStarParams, Anya, Bidirectional, Connectivity, DStarLite, Dijkstra, GridHeuristic, GridParams,
    GridPlannerParams, Jps, JpsPlus, LazyThetaStar, ThetaStar,
};
use rand_distr::{Bernoulli, Distribution, Uniform};

/// Walls across the map with a door each, a share of clutter between them, and a cost in every free cell.
fn walled(seed: u64, clutter: f64) -> Costmap {
    let layout = GridLayout::new(60, 40, 0.1, Se2::new(1.0, -2.0, 0.3)).unwrap();
    let mut stream = Seed(seed).stream(0, 0);
    let (clutter, height) = (Bernoulli::new(clutter).unwrap(), Uniform::new(1, 38).unwrap());
    let costs = Uniform::new(0, cost::INSCRIBED).unwrap();
    let mut map = Grid::filled(layout, 0_u8);
    for index in 0..layout.len() {
        let value = if clutter.sample(&mut stream) { cost::LETHAL } else { costs.sample(&mut stream) };
        map.set(layout.cell(index), value);
    }
    for x in [15, 30, 45] {
        let door: i32 = height.sample(&mut stream);
        for y in 0..40 {
            map.set(Cell::new(x, y), if (y - door).abs() <= 1 { 0 } else { cost::LETHAL });
        }
        // The clutter must not close the door.
        for x in [x - 1, x + 1] {
            map.set(Cell::new(x, door), 0);
        }
    }
    for corner in [(2, 2), (57, 37)] {
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            map.set(Cell::new(corner.0 + dx, corner.1 + dy), 0);
        }
    }
    Costmap::from_costs(map)
}

fn pose(costmap: &Costmap, x: f64, y: f64) -> Se2 {
    let point = costmap.layout().to_map(&Vector2::new(x, y));
    Se2::new(point.x, point.y, 0.5)
}

#[test]
fn planners_keep_the_laws() {
    for seed in 0..10 {
        let costmap = walled(seed, 0.08);
        let (start, goal) = (pose(&costmap, 2.3, 2.6), pose(&costmap, 57.5, 37.9));
        for connectivity in [Connectivity::Four, Connectivity::Eight] {
            for cost_weight in [0.0, 3.0] {
                let grid = GridParams { connectivity, cost_weight, ..Default::default() };
                let mut planners: Vec<Box<dyn GlobalPlanner>> = vec![
                    Box::new(Dijkstra::new(GridPlannerParams { grid, ..Default::default() }).unwrap()),
                    Box::new(AStar::new(AStarParams { grid, ..Default::default() }).unwrap()),
                    Box::new(
                        AStar::new(AStarParams { grid, heuristic: GridHeuristic::Zero, ..Default::default() }).unwrap(),
                    ),
                ];
                planners.push(Box::new(DStarLite::new(GridPlannerParams { grid, ..Default::default() }).unwrap()));
                planners.push(Box::new(Bidirectional::new(AStarParams { grid, ..Default::default() }).unwrap()));
                if cost_weight == 0.0 {
                    let params = GridPlannerParams { grid, ..Default::default() };
                    planners.push(Box::new(Jps::new(params).unwrap()));
                    planners.push(Box::new(JpsPlus::new(params).unwrap()));
                    planners.push(Box::new(ThetaStar::new(params).unwrap()));
                    planners.push(Box::new(LazyThetaStar::new(params).unwrap()));
                }
                for planner in &mut planners {
                    let verdict = laws::global_planner(planner.as_mut(), &costmap, &start, &goal);
                    assert_eq!(verdict, Ok(()), "seed {seed}, {grid:?}");
                }
            }
        }
    }
}

#[test]
fn anya_keeps_the_laws() {
    for seed in 0..10 {
        let costmap = walled(seed, 0.08);
        let (start, goal) = (pose(&costmap, 2.3, 2.6), pose(&costmap, 57.5, 37.9));
        let mut planner = Anya::new(GridPlannerParams::default()).unwrap();
        assert_eq!(laws::global_planner(&mut planner, &costmap, &start, &goal), Ok(()), "seed {seed}");
    }
}
