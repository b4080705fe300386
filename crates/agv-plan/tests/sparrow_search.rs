//! Sparrow search on random maps: every way is one, and no thread shows.

use agv_core::compute::{Par, Seed};
use agv_core::geometry::Se2;
use agv_core::grid::{CornerRule, Costmap, Grid, GridLayout, cost};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, PlanOutcome, laws};
use agv_plan::aco::{SparrowParams, SparrowSearch, Swarm};
use agv_plan::grid::{GridParams, GridPlannerParams, GridSolver, GridSpace, Limits, Potential, SearchEnd};
use proptest::prelude::*;

fn small(params: SparrowParams) -> SparrowParams {
    SparrowParams { sparrows: 12, iterations: 6, ..params }
}

fn costmap(width: usize, costs: Vec<u8>) -> Costmap {
    let layout = GridLayout::new(width, costs.len() / width, 1.0, Se2::default()).unwrap();
    Costmap::from_costs(Grid::new(layout, costs).unwrap())
}

proptest! {
    /// Each line of a way is open, its length adds up and is no less than the straight line's; there is none only where
    /// nothing leads to the goal, or nothing without turning back.
    #[test]
    fn ways_are_valid(
        costs in proptest::collection::vec(prop_oneof![3 => Just(cost::FREE), 1 => Just(cost::LETHAL)], 120),
        corner_rule in prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)],
        (start, goal, seed) in (0_u32..120, 0_u32..120, any::<u64>()),
    ) {
        let mut space = GridSpace::new(GridParams { corner_rule, ..Default::default() }).unwrap();
        space.update(&costmap(12, costs));
        prop_assume!(space.is_passable(start) && space.is_passable(goal));
        let mut potential = Potential::default();
        potential.compute(&space, goal).unwrap();
        for params in [small(SparrowParams::original()), small(SparrowParams::improved())] {
            let mut swarm = Swarm::new(params, Seed(seed)).unwrap();
            let (result, mut way) = (swarm.search(&space, start, goal, &mut Limits::none()), Vec::new());
            swarm.way_into(&space, goal, &mut way);
            match result.end {
                SearchEnd::Goal { .. } => {
                    prop_assert_eq!((way.first(), way.last()), (Some(&start), Some(&goal)));
                    prop_assert!(way.windows(2).all(|pair| space.is_line_open(pair[0], pair[1])));
                    let length = space.path_cost(&way);
                    prop_assert!((length - swarm.run().length.unwrap()).abs() < 1e-9);
                    let (a, b) = (space.cell(start), space.cell(goal));
                    prop_assert!(length >= f64::from(b.x - a.x).hypot(f64::from(b.y - a.y)) - 1e-9);
                    prop_assert!(swarm.history().windows(2).all(|pair| pair[1].best_so_far <= pair[0].best_so_far));
                }
                SearchEnd::Exhausted => prop_assert_eq!(potential.distance(start), None),
                _ => prop_assert!(potential.distance(start).is_some()),
            }
        }
    }
}

/// Columns of 40 x 30 cells with a gap each.
fn gates() -> Costmap {
    let gate = |i: usize| i % 40 % 8 != 5 || (i / 40 + 30 - i % 40 * 7 % 30) % 30 < 4;
    costmap(40, (0..1200).map(|i| if gate(i) { cost::FREE } else { cost::LETHAL }).collect())
}

fn ends() -> (Se2, Se2) {
    (Se2::new(0.7, 0.4, 0.3), Se2::new(39.2, 29.3, -1.0))
}

#[test]
fn the_planner_keeps_its_role_and_threads_do_not_show() {
    let plan = |par| {
        let params = small(SparrowParams::improved());
        let mut planner =
            SparrowSearch::new(GridPlannerParams::default(), params, Seed(4)).unwrap().with_parallelism(par);
        let mut path = Path::new();
        let outcome = planner.plan_into(&gates(), &ends().0, &ends().1, &mut path).unwrap();
        assert!(matches!(outcome, PlanOutcome::Found { .. }));
        assert_eq!(laws::global_planner(&mut planner, &gates(), &ends().0, &ends().1), Ok(()));
        (outcome, path, planner.solver().history().to_vec())
    };
    let reference = plan(Par::Seq);
    assert!([2, 4].into_iter().all(|threads| plan(Par::threads(threads)) == reference));
}

#[test]
fn a_search_around_the_best_way_helps() {
    let length = |params| {
        let params = SparrowParams { sparrows: 20, iterations: 50, ..params };
        let lengths = (0..8).map(|seed| {
            let mut planner = SparrowSearch::new(GridPlannerParams::default(), params, Seed(seed)).unwrap();
            planner.plan_into(&gates(), &ends().0, &ends().1, &mut Path::new()).unwrap();
            planner.solver().run().length.unwrap()
        });
        lengths.sum::<f64>()
    };
    let original = length(SparrowParams::original());
    let trials = length(SparrowParams { trials: 10, ..SparrowParams::original() });
    let gather = length(SparrowParams { gather: true, ..SparrowParams::original() });
    let improved = length(SparrowParams::improved());
    assert!(trials < original && improved < gather, "{original} {trials} {gather} {improved}");
}

#[test]
fn bad_parameters_are_named() {
    let good = SparrowParams::improved();
    for (name, params) in [
        ("sparrows", SparrowParams { sparrows: 1, ..good }),
        ("sparrows", SparrowParams { sparrows: usize::MAX, ..good }),
        ("iterations", SparrowParams { iterations: 0, ..good }),
        ("trials", SparrowParams { trials: usize::MAX, ..good }),
        ("producers", SparrowParams { producers: f64::NAN, ..good }),
        ("scouts", SparrowParams { scouts: 1.5, ..good }),
        ("safety", SparrowParams { safety: -0.1, ..good }),
    ] {
        assert!(Swarm::new(params, Seed(0)).unwrap_err().to_string().starts_with(name));
    }
}
