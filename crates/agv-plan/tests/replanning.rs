//! Planners that follow a map which changes, and a vehicle that moves in it: each answer is that of a planner made anew.

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, Connectivity, CornerRule, Costmap, Grid, GridLayout, cost};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, PlanOutcome};
use agv_plan::grid::{AStar, AStarParams, DStarLite, GridParams, GridPlannerParams, Jps, JpsPlus};
use proptest::prelude::*;

fn pose(costmap: &Costmap, index: u32) -> Se2 {
    let layout = costmap.layout();
    let centre = layout.center(layout.cell(index as usize % layout.len()));
    Se2::new(centre.x, centre.y, 0.0)
}

/// Cost of the path, which is as long as it claims where cells are uniform; or why there is none.
fn solve(planner: &mut dyn GlobalPlanner, costmap: &Costmap, ends: (u32, u32)) -> Result<f64, String> {
    let (start, goal, mut path) = (pose(costmap, ends.0), pose(costmap, ends.1), Path::new());
    match planner.plan_into(costmap, &start, &goal, &mut path).unwrap() {
        PlanOutcome::Found { cost, .. } => {
            assert!(path.length() <= cost + 1e-9, "{} for {cost}", path.length());
            Ok(cost)
        }
        PlanOutcome::NoPath { reason, .. } => Err(format!("{reason:?}")),
        other => Err(format!("{other:?}")),
    }
}

/// What happens between two queries.
#[derive(Debug, Clone)]
enum Event {
    /// These cells take these costs.
    Edit(Vec<(u32, u8)>),
    /// The vehicle moves on.
    Move(u32),
    /// Another goal.
    Goal(u32),
    /// The map is another object with the same costs.
    Clone,
}

fn events() -> impl Strategy<Value = Vec<Event>> {
    let value = prop_oneof![3 => Just(cost::LETHAL), 3 => Just(cost::FREE), 2 => 0_u8..=253, 1 => Just(cost::UNKNOWN)];
    let edit = proptest::collection::vec((any::<u32>(), value), 1..6).prop_map(Event::Edit);
    let event = prop_oneof![
        6 => edit,
        3 => any::<u32>().prop_map(Event::Move),
        1 => any::<u32>().prop_map(Event::Goal),
        1 => Just(Event::Clone)
    ];
    proptest::collection::vec(event, 1..12)
}

fn apply(event: Event, costmap: &mut Costmap, ends: &mut (u32, u32)) {
    match event {
        Event::Edit(cells) => {
            let layout = *costmap.layout();
            for (index, value) in cells {
                costmap.set(layout.cell(index as usize % layout.len()), value);
            }
        }
        Event::Move(start) => ends.0 = start,
        Event::Goal(goal) => ends.1 = goal,
        Event::Clone => *costmap = costmap.clone(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn followers_answer_as_a_planner_made_anew(
        costs in proptest::collection::vec(prop_oneof![3 => 0_u8..200, 1 => Just(cost::LETHAL)], 13 * 11),
        rule in prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)],
        four in any::<bool>(),
        cost_weight in prop_oneof![2 => Just(0.0), 1 => 0.0..20.0_f64],
        ends in (any::<u32>(), any::<u32>()),
        events in events(),
    ) {
        let layout = GridLayout::new(13, 11, 0.5, Se2::new(1.0, -2.0, 0.3)).unwrap();
        let mut costmap = Costmap::from_costs(Grid::new(layout, costs).unwrap());
        let connectivity = if four { Connectivity::Four } else { Connectivity::Eight };
        let grid = GridParams { connectivity, corner_rule: rule, cost_weight, ..Default::default() };
        let params = GridPlannerParams { grid, ..Default::default() };
        let mut planners: Vec<Box<dyn GlobalPlanner>> =
            vec![Box::new(AStar::new(AStarParams { grid, ..Default::default() }).unwrap())];
        planners.push(Box::new(DStarLite::new(params).unwrap()));
        // One that seldom ends what it begins, and goes on with the next query.
        let hasty = GridPlannerParams { max_expansions: 12, ..params };
        let mut hasty = DStarLite::new(hasty).unwrap();
        if cost_weight == 0.0 {
            planners.push(Box::new(Jps::new(params).unwrap()));
            planners.push(Box::new(JpsPlus::new(params).unwrap()));
        }
        let mut ends = ends;
        for event in std::iter::once(Event::Clone).chain(events) {
            apply(event, &mut costmap, &mut ends);
            let mut fresh = AStar::new(AStarParams { grid, ..Default::default() }).unwrap();
            let want = solve(&mut fresh, &costmap, ends);
            for (number, planner) in planners.iter_mut().enumerate() {
                let got = solve(planner.as_mut(), &costmap, ends);
                match (&got, &want) {
                    // Equally cheap ways may differ in the rounding of their steps.
                    (Ok(a), Ok(b)) => prop_assert!((a - b).abs() <= 1e-3 * b + 1e-9, "{number}: {a} for {b}"),
                    _ => prop_assert_eq!(&got, &want, "{}", number),
                }
            }
            match (solve(&mut hasty, &costmap, ends), &want) {
                (Ok(a), Ok(b)) => prop_assert!((a - b).abs() <= 1e-3 * b + 1e-9, "hasty: {a} for {b}"),
                (Err(got), _) if got == "Budget" => {}
                (got, want) => prop_assert_eq!(&got, want),
            }
        }
    }
}

/// Larger than the blocks in which some planners follow a map, with changes far apart.
#[test]
fn a_large_map_is_followed_in_parts() {
    let layout = GridLayout::new(200, 150, 0.1, Se2::default()).unwrap();
    let mut costmap = Costmap::from_costs(Grid::filled(layout, cost::FREE));
    let params = GridPlannerParams::default();
    let mut planners: Vec<Box<dyn GlobalPlanner>> =
        vec![Box::new(Jps::new(params).unwrap()), Box::new(JpsPlus::new(params).unwrap())];
    planners.push(Box::new(DStarLite::new(params).unwrap()));
    for x in (20..180).step_by(20) {
        for y in 0..149 {
            costmap.set(Cell::new(x, if x % 40 == 0 { y } else { 149 - y }), cost::LETHAL);
        }
        let want = solve(&mut AStar::new(AStarParams::default()).unwrap(), &costmap, (200, 150 * 200 - 1)).unwrap();
        for planner in &mut planners {
            let got = solve(planner.as_mut(), &costmap, (200, 150 * 200 - 1)).unwrap();
            assert!((got - want).abs() < 1e-9, "{x}: {got} for {want}");
        }
    }
}
