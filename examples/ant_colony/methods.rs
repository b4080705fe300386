//! Who searches, and what is made of the path.

use agv_nav::plan::aco::{
    ColonyParams, DeadEnd, Deposit, GoalDistance, Greed, Schedule, Sight, SparrowParams, TrailLimits,
};

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Search {
    Colony(ColonyParams),
    Sparrows(SparrowParams),
}

/// A line of a table: a search, and the key nodes of its path for a vehicle of some radius, if any.
#[derive(Clone, Copy)]
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) search: Search,
    /// Radius of the vehicle, in metres, if the path is cut down to its key nodes.
    pub(crate) key_nodes: Option<f64>,
    /// Whether it makes use of the search of the line before.
    again: bool,
}

impl Row {
    const fn colony(name: &'static str, params: ColonyParams) -> Self {
        Self { name, search: Search::Colony(params), key_nodes: None, again: false }
    }

    const fn with_key_nodes(self, name: &'static str, radius: f64) -> Self {
        Self { name, key_nodes: Some(radius), again: true, ..self }
    }

    pub(crate) const fn is_new_search(&self) -> bool {
        !self.again
    }
}

const IACO: Row = Row::colony("pheromone (IACO)", ColonyParams::iaco());
/// With the threshold of the paper's section 6.3, where Tables 3 and 4 come from.
const IACO_LATER: Row =
    Row::colony("IACO, R = 0.5", ColonyParams { deposit: Deposit::Graded { threshold: 0.5 }, ..ColonyParams::iaco() });
const REFINED: Row = Row::colony("refined", ColonyParams::refined());

/// The paper's Table 1 from rung to rung; what the paper calls IACO has key nodes.
/// The first two rungs are there twice: with Eq. 1's heuristic, which knows no goal, and with the widespread one that does.
pub(crate) const LADDER: [Row; 16] = [
    ACO,
    ACO.with_key_nodes("ACO, key nodes", 0.0),
    Row::colony("transition", ColonyParams::with_transition()),
    ACO_TO_GOAL,
    Row::colony("transition, goal seen", ColonyParams { sight: Sight::to_goal(), ..ColonyParams::with_transition() }),
    Row::colony("heuristic", ColonyParams::with_heuristic()),
    Row { name: "ISSA", search: Search::Sparrows(SparrowParams::improved()), key_nodes: None, again: false },
    IACO,
    IACO.with_key_nodes("IACO, key nodes", 0.0),
    IACO.with_key_nodes("IACO, key nodes, 0.3 m", 0.3),
    IACO_LATER,
    IACO_LATER.with_key_nodes("IACO, R = 0.5, key nodes", 0.0),
    IACO_LATER.with_key_nodes("IACO, R = 0.5, key nodes, 0.3 m", 0.3),
    REFINED,
    REFINED.with_key_nodes("refined, key nodes", 0.0),
    REFINED.with_key_nodes("refined, key nodes, 0.3 m", 0.3),
];

const ACO: Row = Row::colony("ACO", ColonyParams::aco());
const ACO_TO_GOAL: Row = Row::colony("ACO, goal seen", ColonyParams { sight: Sight::to_goal(), ..ColonyParams::aco() });
const BASE: ColonyParams = ColonyParams::iaco();

/// Every option and addition alone, beside the defaults.
pub(crate) const OPTIONS: [Row; 19] = [
    ACO,
    Row::colony("ACO, dies in dead ends", ColonyParams { dead_end: DeadEnd::Die, ..ColonyParams::aco() }),
    ACO_TO_GOAL,
    Row::colony("ACO, detours erased", ColonyParams { erase_detours: true, ..ColonyParams::aco() }),
    IACO,
    Row::colony(
        "IACO, floor 0.01",
        ColonyParams { limits: TrailLimits::Fixed { floor: 0.01, ceiling: 100.0 }, ..BASE },
    ),
    Row::colony(
        "IACO, floor 1e-6",
        ColonyParams { limits: TrailLimits::Fixed { floor: 1e-6, ceiling: 100.0 }, ..BASE },
    ),
    Row::colony(
        "IACO, span 500",
        ColonyParams { limits: TrailLimits::MaxMin { ants_worth: 1.0, span: 500.0 }, ..BASE },
    ),
    Row::colony("IACO, dies in dead ends", ColonyParams { dead_end: DeadEnd::Die, ..BASE }),
    Row::colony("IACO, cube root in Eq. 5", ColonyParams { sight: Sight::goal(GoalDistance::CubeRoot), ..BASE }),
    Row::colony("IACO, root alone in Eq. 5", ColonyParams { sight: Sight::goal(GoalDistance::Plain), ..BASE }),
    IACO_LATER,
    Row::colony(
        "IACO, Eq. 9 squared",
        ColonyParams {
            alpha: Schedule { exponent: 2.0, ..BASE.alpha },
            beta: Schedule { exponent: 2.0, ..BASE.beta },
            ..BASE
        },
    ),
    Row::colony("IACO, q0 constant", ColonyParams { greed: Greed::Constant(0.9), ..BASE }),
    Row::colony("IACO, first pheromone 0.01", ColonyParams { initial: 0.01, ..BASE }),
    REFINED,
    Row::colony(
        "refined, floor 0.01",
        ColonyParams { limits: TrailLimits::Fixed { floor: 0.01, ceiling: 100.0 }, ..ColonyParams::refined() },
    ),
    Row::colony("refined, anew after 15", ColonyParams { restart_after: 15, ..ColonyParams::refined() }),
    Row::colony(
        "refined, best way alone",
        ColonyParams { deposit: Deposit::BestWay { period: 2 }, ..ColonyParams::refined() },
    ),
];
