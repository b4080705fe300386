//! The search core taken apart: stores, single steps, several starts and goals, and a graph that is no grid.

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, CornerRule, Costmap, Grid, GridLayout, cost};
use agv_plan::grid::{
    BucketQueue, DenseNodes, Frontier, GridParams, GridSpace, HeapQueue, Limits, Nearest, NodeStore, Octile, Offset,
    OpenList, Potential, Reached, SearchEnd, SearchSpace, SparseNodes, Step, Workspace, Zero,
};
use proptest::prelude::*;

fn spaces() -> impl Strategy<Value = GridSpace> {
    let costs = proptest::collection::vec(prop_oneof![7 => Just(cost::FREE), 3 => Just(cost::LETHAL)], 12 * 9);
    let rules = prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)];
    (costs, rules).prop_map(|(costs, corner_rule)| {
        let layout = GridLayout::new(12, 9, 1.0, Se2::default()).unwrap();
        let mut space = GridSpace::new(GridParams { corner_rule, ..Default::default() }).unwrap();
        space.update(&Costmap::from_costs(Grid::new(layout, costs).unwrap()));
        space
    })
}

fn octile(space: &GridSpace, goal: u32) -> Octile {
    Octile(Offset::new(12, space.cell(goal)))
}

proptest! {
    /// Any store, any queue, in one go, step by step, or a few expansions at a time: the same costs everywhere.
    #[test]
    fn stores_queues_and_pieces_agree(space in spaces(), start in 0_u32..108, goal in 0_u32..108, chunk in 1_u64..9) {
        let (view, bound) = (space.uniform(), octile(&space, goal));
        let mut whole: Workspace<Step> = Workspace::default();
        let mut sparse: Workspace<Step, BucketQueue, SparseNodes<Step>> = Workspace::default();
        let mut heap: Workspace<Step, HeapQueue, DenseNodes<Step>> = Workspace::default();
        let want = whole.search(&view, &bound, start, |n| n == goal, &mut Limits::none());
        prop_assert_eq!(sparse.search(&view, &bound, start, |n| n == goal, &mut Limits::none()), want);
        // Among equals the queues may differ.
        let other = heap.search(&view, &bound, start, |n| n == goal, &mut Limits::none());
        prop_assert_eq!(other.end, want.end);
        let (mut way, mut same) = (Vec::new(), Vec::new());
        whole.trace_into(&view, goal, &mut way);
        sparse.trace_into(&view, goal, &mut same);
        prop_assert_eq!(way, same);

        let (mut pieces, mut total): (Workspace<Step>, _) = (Workspace::default(), 0);
        pieces.begin(&view);
        prop_assert!(pieces.add_start(&bound, start, 0) && !pieces.add_start(&bound, start, 0));
        let end = loop {
            let part = pieces.run(&view, &bound, |n| n == goal, &mut Limits { budget: chunk, cancel: None });
            total += part.expansions;
            if part.end != SearchEnd::Budget {
                break part.end;
            }
            prop_assert_eq!(part.expansions, chunk);
        };
        prop_assert_eq!((end, total), (want.end, want.expansions));

        let mut steps: Workspace<Step> = Workspace::default();
        steps.begin(&view);
        steps.add_start(&Zero, start, 0);
        let mut last = 0;
        while let Some(key) = steps.least_key() {
            prop_assert!(key >= last);
            last = key;
            if let Some(at) = steps.expand_next(&view, &Zero) {
                prop_assert!(at.cost >= key);
            }
        }
        if let SearchEnd::Goal { cost, .. } = want.end {
            prop_assert_eq!(steps.cost(goal), Some(cost));
        }
    }

    /// From any of several starts to any of several goals: the least of the single answers, by search and by potential.
    #[test]
    fn several_starts_and_goals(
        space in spaces(),
        starts in proptest::collection::vec(0_u32..108, 1..4),
        goals in proptest::collection::vec(0_u32..108, 1..4),
    ) {
        let view = space.uniform();
        let mut workspace: Workspace<Step> = Workspace::default();
        let mut single = |start, goal| {
            match workspace.search(&view, &Zero, start, |n| n == goal, &mut Limits::none()).end {
                SearchEnd::Goal { cost, .. } => Some(cost),
                _ => None,
            }
        };
        let pairs = starts.iter().flat_map(|&s| goals.iter().map(move |&g| (s, g)));
        let want = pairs.filter_map(|(s, g)| single(s, g)).min();

        let bounds: Vec<Octile> = goals.iter().map(|&goal| octile(&space, goal)).collect();
        let nearest = Nearest(&bounds);
        workspace.begin(&view);
        for &start in &starts {
            workspace.add_start(&nearest, start, 0);
        }
        let found = match workspace.run(&view, &nearest, |n| goals.contains(&n), &mut Limits::none()).end {
            SearchEnd::Goal { cost, node } => {
                prop_assert!(goals.contains(&node));
                Some(cost)
            }
            _ => None,
        };
        prop_assert_eq!(found, want);
        let mut potential = Potential::default();
        potential.compute_to_nearest(&space, &goals).unwrap();
        let least = starts.iter().filter_map(|&s| potential.distance(s)).min_by(f64::total_cmp);
        prop_assert_eq!(least, want.map(|cost| f64::from(cost) / 985.0));
    }
}

#[test]
fn a_potential_without_goals_reaches_nothing() {
    let mut space = GridSpace::new(GridParams::default()).unwrap();
    space.update(&Costmap::from_costs(Grid::filled(GridLayout::new(3, 3, 1.0, Se2::default()).unwrap(), 0)));
    let mut potential = Potential::default();
    potential.compute(&space, 0).unwrap();
    assert!(potential.compute_to_nearest(&space, &[4, 9]).is_err());
    assert_eq!(potential.distance(1), Some(1.0), "as it was");
    potential.compute_to_nearest(&space, &[]).unwrap();
    assert_eq!(potential.distance(1), None);
}

/// Poses (x, y, heading) on a wide plane; a vehicle that goes one cell ahead, or half a cell ahead in turning by 45°.
struct Lattice {
    blocked: fn(Cell) -> bool,
}

impl Lattice {
    const SIZE: i32 = 4096;
    const HEADINGS: u32 = 8;

    fn node(cell: Cell, heading: u32) -> u32 {
        ((cell.y * Self::SIZE + cell.x) as u32) * Self::HEADINGS + heading
    }

    fn pose(node: u32) -> (Cell, u32) {
        let cell = (node / Self::HEADINGS) as i32;
        (Cell::new(cell % Self::SIZE, cell / Self::SIZE), node % Self::HEADINGS)
    }
}

impl SearchSpace for Lattice {
    type Link = Option<u32>;

    fn node_count(&self) -> usize {
        (Self::SIZE * Self::SIZE) as usize * Self::HEADINGS as usize
    }

    fn max_step(&self) -> u32 {
        20
    }

    fn expand(&self, at: Reached<Option<u32>>, frontier: &mut impl Frontier<Option<u32>>) {
        let (cell, heading) = Self::pose(at.node);
        let ahead = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];
        let (dx, dy) = ahead[heading as usize];
        for (next, turned, step) in
            [(Cell::new(cell.x + dx, cell.y + dy), 0, 10), (cell, 1, 20), (cell, Self::HEADINGS - 1, 20)]
        {
            if next.x.min(next.y) >= 0 && next.x.max(next.y) < Self::SIZE && !(self.blocked)(next) {
                let node = Self::node(next, (heading + turned) % Self::HEADINGS);
                frontier.reach(node, at.cost.saturating_add(step), Some(at.node));
            }
        }
    }

    fn predecessor(&self, _: u32, before: Option<u32>) -> Option<u32> {
        before
    }
}

/// 134 million states of which a query sees some thousands: dense records would take gigabytes.
#[test]
fn a_lattice_with_headings_is_searched_in_a_sparse_store() {
    let lattice = Lattice { blocked: |cell| cell.x == 2010 && (1900..2003).contains(&cell.y) };
    let (start, goal) = (Lattice::node(Cell::new(2000, 2000), 0), Lattice::node(Cell::new(2020, 2000), 0));
    let mut workspace: Workspace<Option<u32>, BucketQueue, SparseNodes<Option<u32>>> = Workspace::default();
    for _ in 0..2 {
        let result = workspace.search(&lattice, &Zero, start, |n| n == goal, &mut Limits::none());
        // Over the wall at y = 2003 and back: 20 columns, 3 rows up and 3 down on diagonals, four turns of 45°.
        assert!(matches!(result.end, SearchEnd::Goal { cost, .. } if cost == 200 + 4 * 20), "{result:?}");
    }
    let mut way = Vec::new();
    workspace.trace_into(&lattice, goal, &mut way);
    assert_eq!((way.first(), way.last()), (Some(&start), Some(&goal)));
    assert!(way.iter().all(|&node| !(lattice.blocked)(Lattice::pose(node).0)));
}

/// What a search that mends its answer needs: keys in the heap that fall, and costs in a store that rise.
#[test]
fn keys_may_fall_and_costs_may_rise() {
    let mut open = HeapQueue::default();
    open.reset(0, 4);
    for (node, key) in [(0, 6), (1, 5), (2, 7)] {
        open.push(key, agv_plan::grid::Entry { node, cost: key });
    }
    assert_eq!(open.pop().map(|(key, entry)| (key, entry.node)), Some((5, 1)));
    open.push(3, agv_plan::grid::Entry { node: 3, cost: 3 });
    assert_eq!(open.least_key(), Some(3));
    let mut nodes: SparseNodes<u32> = SparseNodes::default();
    nodes.begin(10);
    assert!(
        nodes.set(3, agv_plan::grid::Known { cost: 9, link: 4 })
            && nodes.set(3, agv_plan::grid::Known { cost: 11, link: 4 })
    );
    assert_eq!(nodes.get(3).map(|known| (known.cost, known.link)), Some((11, 4)));
}
