//! Planners that draw lots: how ants are spread over threads is not part of a way.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes::cluttered,
};
use agv_nav::{
    core::{compute::Seed, grid::Costmap, path::Path, roles::GlobalPlanner},
    plan::{
        aco::{AntColony, ColonyParams},
        grid::GridPlannerParams,
    },
    prelude::*,
};

#[test]
fn ants_do_not_depend_on_threads() {
    let map = cluttered(40, 30);
    let costmap = Costmap::from_map(&map);
    let pose = |cell| {
        let center = map.layout().center(cell);
        Se2::new(center.x, center.y, 0.0)
    };
    let free: Vec<_> = (0..map.layout().len()).map(|i| map.layout().cell(i)).collect();
    let mut free = free.into_iter().filter(|&cell| costmap.is_traversable(cell));
    let (start, goal) = (pose(free.next().unwrap()), pose(free.next_back().unwrap()));
    for (name, colony) in
        [("AntColony, improved", ColonyParams::iaco()), ("AntColony, refined", ColonyParams::refined())]
    {
        // No multiple of a squad of eight.
        let colony = ColonyParams { ants: 37, iterations: 12, ..colony };
        assert_same_bits(name, |par| {
            let ants = AntColony::new(GridPlannerParams::default(), colony, Seed(3)).unwrap();
            let (mut ants, mut path) = (ants.with_parallelism(par), Path::new());
            let outcome = ants.plan_into(&costmap, &start, &goal, &mut path).unwrap();
            assert!(matches!(outcome, PlanOutcome::Found { .. }), "{outcome:?}");
            let history = ants.solver().history().iter().flat_map(|iteration| [iteration.best, iteration.mean]);
            Digest::new().poses(path.points().iter().map(|point| &point.pose)).bits(history.map(f64::to_bits))
        });
    }
}
