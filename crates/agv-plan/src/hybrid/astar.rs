//! Hybrid A*: a path that a vehicle with a turning circle can drive, its outline kept clear of obstacles.
//!
//! A* over motions of constant curvature, forwards and backwards, of which the cheapest pose per cell and heading is kept
//! (Dolgov, Thrun, Montemerlo and Diebel, *Path planning for autonomous vehicles in unknown semi-structured environments*,
//! 2010). From time to time a curve is tried straight to the goal; one that touches nothing makes a path, which is taken when
//! what is still open promises no cheaper one. Curves are tried to gates as well, which lead through narrow places.

use super::{
    UNIT,
    gate::GateFinder,
    goal::free_near,
    guide::{Guide, Potential},
    lattice::{Arrival, Lattice},
    motion::{Leg, Motion, motions},
    params::HybridAStarParams,
    shorten::Shortener,
    shot::{Curves, Shooter, Shot},
    site::Site,
    table::CurveTable,
};
use crate::{
    Error,
    grid::{BucketQueue, Entry, Heuristic, Limits, OpenList, SearchEnd, SparseNodes, Workspace},
};
use agv_core::{
    check,
    geometry::Se2,
    grid::{Costmap, Footprint},
    path::{Path, PathPoint},
    roles::{GlobalPlanner, NoPathReason, PlanError, PlanOutcome},
};

/// A bucket queue that makes no room for nodes that the search will never see.
#[derive(Debug, Clone, Default)]
struct Buckets(BucketQueue);

impl OpenList for Buckets {
    fn reset(&mut self, window: u32, capacity: usize) {
        self.0.reset(window, capacity.min(1 << 12));
    }

    #[inline]
    fn push(&mut self, key: u32, entry: Entry) {
        self.0.push(key, entry);
    }

    #[inline]
    fn pop(&mut self) -> Option<(u32, Entry)> {
        self.0.pop()
    }

    #[inline]
    fn least_key(&self) -> Option<u32> {
        self.0.least_key()
    }
}

/// Plans for vehicles that steer one axle or two.
///
/// The path begins at the start pose and ends at the goal pose, its headings and directions of travel being those to drive
/// with; between its points the vehicle follows arcs no tighter than the turning radius. The footprint touches no lethal cell
/// on the way, nor one that was not observed, and the base keeps off cells from [`cost::INSCRIBED`](agv_core::grid::cost::INSCRIBED)
/// on. All is derived from a costmap when it changes; queries on the same map cost what they look at, and allocate nothing once
/// they have seen its like.
///
/// The cost is the path's: its length, weighted and with what cusps and steering cost.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Footprint, Grid, GridLayout};
/// use agv_core::kinematics::AckermannParams;
/// use agv_core::path::{Gear, Path};
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::hybrid::{HybridAStar, HybridAStarParams};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(200, 120, 0.05, Se2::default())?, CellState::Free));
/// let tugger = HybridAStarParams::for_ackermann(&AckermannParams::default())?;
/// let mut planner = HybridAStar::new(tugger, Footprint::rectangle(-0.4, 1.6, 0.8)?)?;
/// // Turned around within 6 m: it takes a cusp.
/// let (start, goal, mut path) = (Se2::new(5.0, 2.0, 0.0), Se2::new(5.0, 4.0, std::f64::consts::PI), Path::new());
/// let outcome = planner.plan_into(&map, &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { .. }));
/// assert!(path.points().iter().any(|point| point.gear == Gear::Reverse));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct HybridAStar {
    params: HybridAStarParams,
    motions: Vec<Motion>,
    table: CurveTable,
    curves: Curves,
    site: Site,
    potential: Potential,
    gates: GateFinder,
    workspace: Workspace<Arrival, Buckets, SparseNodes<Arrival>>,
    shooter: Shooter,
    shortener: Shortener,
    way: Vec<u32>,
    legs: Vec<Leg>,
}

/// What a search found.
struct Search {
    shot: Option<Shot>,
    /// The expanded node that is nearest to the goal.
    nearest: u32,
    expansions: u64,
    end: SearchEnd,
}

impl HybridAStar {
    /// A planner for a vehicle: tabulates its curves, which takes about 0.1 s.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(params: HybridAStarParams, footprint: Footprint) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            motions: motions(&params),
            table: CurveTable::new(&params)?,
            curves: Curves::new(&params)?,
            gates: GateFinder::new(&params, &footprint),
            site: Site::new(footprint, &params)?,
            potential: Potential::default(),
            workspace: Workspace::default(),
            shooter: Shooter::default(),
            shortener: Shortener::default(),
            way: Vec::new(),
            legs: Vec::new(),
            params,
        })
    }

    /// Parameters it was made with.
    pub const fn params(&self) -> &HybridAStarParams {
        &self.params
    }

    fn search(&mut self, start: Se2, goal: &Se2, fine: bool, limits: &mut Limits<'_>) -> Result<Search, PlanError> {
        let Self { params, motions, table, curves, site, potential, gates, workspace, shooter, .. } = self;
        let lattice = Lattice::new(params, motions, site, start)?.with_fine(fine).with_gates(gates.gates(), curves);
        let start_node = lattice.node(&start).unwrap_or(u32::MAX);
        let mut search = Search { shot: None, nearest: start_node, expansions: 0, end: SearchEnd::Exhausted };
        let (mut nearest, mut pause, mut next_shot) = (u32::MAX, 0, 0);
        let mut refine_until = u64::MAX;
        workspace.begin(&lattice);
        workspace.add_start(&Guide::new(potential, table, &lattice, goal), start_node, 0);
        while let Some((key, at)) = workspace.pop(&lattice) {
            let settled = |shot: Shot| shot.cost * UNIT <= f64::from(key) * (1.0 + params.slack);
            if search.shot.is_some_and(settled) || search.expansions >= refine_until {
                break;
            }
            if search.expansions >= pause {
                if let Some(end) = limits.stopped(search.expansions) {
                    search.end = end;
                    break;
                }
                pause = limits.budget.min(search.expansions + CANCEL_INTERVAL);
            }
            potential.reach(site, at.node / u32::from(params.headings));
            let guide = Guide::new(potential, table, &lattice, goal);
            let estimate = guide.estimate(at.node);
            if estimate < nearest {
                (nearest, search.nearest) = (estimate, at.node);
            }
            if search.expansions >= next_shot {
                let from = lattice.pose(&at.link);
                let before = lattice.motion(&at.link).map(|motion| motion.twist);
                let limit = search.shot.map_or(f64::INFINITY, |shot| shot.cost);
                let radii = f64::from(estimate) / (UNIT * params.heuristic_weight * params.turning_radius);
                let so_far = (&from, f64::from(at.cost) / UNIT, before);
                if let Some((curve, cost)) = shooter.shoot(&lattice, site, curves, so_far, goal, (limit, radii < NEAR))
                {
                    if search.shot.is_none() {
                        refine_until = search.expansions.saturating_add(params.refinement);
                    }
                    search.shot = Some(Shot { node: at.node, curve, cost });
                }
                next_shot = search.expansions + 1 + (radii / NEAR) as u64;
            }
            search.expansions += 1;
            workspace.expand(&lattice, &guide, at);
        }
        Ok(search)
    }
}

/// Turning radii from the goal within which every expansion tries a curve, and other words than the cheapest.
const NEAR: f64 = 4.0;

/// Expansions between two questions to `cancel`: they cost some 50 µs each, a thousand times those of a grid.
const CANCEL_INTERVAL: u64 = 16;

fn into_core(error: &Error) -> PlanError {
    match error {
        Error::Core(core) => (*core).into(),
        // The parts that are used report nothing else.
        _ => PlanError::Invalid(agv_core::Error::NotFinite { name: "costmap", value: f64::NAN }),
    }
}

/// The motions from the start to a node.
fn legs_into(
    workspace: &Workspace<Arrival, Buckets, SparseNodes<Arrival>>,
    lattice: &Lattice<'_>,
    node: u32,
    way: &mut Vec<u32>,
    legs: &mut Vec<Leg>,
) {
    workspace.trace_into(lattice, node, way);
    legs.clear();
    let arrivals = || way.iter().filter_map(|&node| workspace.link(node));
    for (from, to) in arrivals().zip(arrivals().skip(1)) {
        lattice.legs_between(&from, &to, legs);
    }
}

/// Samples the legs, which end at `end`.
fn write_path(legs: &[Leg], start: &Se2, end: &Se2, spacing: f64, path: &mut Path) -> Result<(), agv_core::Error> {
    path.clear();
    let first = legs.first().map_or_else(Default::default, Leg::gear);
    path.push(PathPoint { pose: *start, gear: first })?;
    for (i, leg) in legs.iter().enumerate() {
        let steps = (leg.length / spacing - 1e-9).ceil().max(1.0) as u32;
        for k in 1..=steps {
            let is_end = i + 1 == legs.len() && k == steps;
            let pose = if is_end { *end } else { leg.at(leg.length * f64::from(k) / f64::from(steps)) };
            path.push(PathPoint { pose, gear: leg.gear() })?;
        }
    }
    if legs.is_empty() {
        path.push(PathPoint { pose: *end, gear: first })?;
    }
    Ok(())
}

impl GlobalPlanner for HybridAStar {
    /// Asks when the map is derived and the potential known, and every 16 expansions from then on, about a millisecond. A path that was found before is not shortened then, but is a
    /// path.
    ///
    /// # Errors
    /// As [`plan_into`](GlobalPlanner::plan_into), a map with more cells and headings than 2^32, and one whose cells a step
    /// does not leave.
    fn plan_with_cancel(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
        cancelled: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError> {
        path.clear();
        for (name, pose) in [("start", start), ("goal", goal)] {
            check::all_finite(name, &[pose.x(), pose.y(), pose.yaw()])?;
        }
        let layout = costmap.layout();
        let outside = |pose: &Se2| layout.cell_at(&pose.translation()).is_none();
        if outside(start) {
            return Err(PlanError::StartOutside { x: start.x(), y: start.y() });
        }
        if outside(goal) {
            return Err(PlanError::GoalOutside { x: goal.x(), y: goal.y() });
        }
        let no_path = |reason, expansions| Ok(PlanOutcome::NoPath { reason, expansions });
        if self.site.update(costmap).map_err(|error| into_core(&error))? {
            // At once: the site tells of a change no second time, and this query may end before it needs the potential.
            self.potential.forget();
        }
        if !self.site.is_free(start) {
            return no_path(NoPathReason::StartBlocked, 0);
        }
        let Some(goal) = free_near(&self.site, &self.params, goal) else {
            return no_path(NoPathReason::GoalBlocked, 0);
        };
        self.site.set_ends([*start, goal]);
        let lattice = Lattice::new(&self.params, &self.motions, &self.site, *start)?;
        let cells = lattice.cell(&start.translation()).zip(lattice.cell(&goal.translation()));
        let Some((start_cell, goal_cell)) = cells.filter(|&(a, b)| self.site.are_joined(a, b)) else {
            return no_path(NoPathReason::Disconnected, 0);
        };
        self.potential.begin(&self.site, goal_cell);
        self.potential.reach(&self.site, start_cell);
        self.gates.find(&self.site, &lattice, &self.potential, start_cell, &goal);

        let mut limits = Limits { budget: self.params.max_expansions, cancel: Some(&mut *cancelled) };
        let mut search = self.search(*start, &goal, false, &mut limits)?;
        if search.shot.is_none() && search.end == SearchEnd::Exhausted {
            // The whole motions may be too long for a tight place: once more, with shorter ones.
            let before = search.expansions;
            limits.budget = limits.budget.saturating_sub(before);
            search = self.search(*start, &goal, true, &mut limits)?;
            search.expansions += before;
        }
        let lattice =
            Lattice::new(&self.params, &self.motions, &self.site, *start)?.with_gates(self.gates.gates(), &self.curves);
        let reason = match (search.shot, search.end) {
            (Some(_), _) => None,
            (None, SearchEnd::Budget) => Some(NoPathReason::Budget),
            (None, SearchEnd::Cancelled) => Some(NoPathReason::Cancelled),
            (None, _) => return no_path(NoPathReason::Disconnected, search.expansions),
        };
        let last = search.shot.map_or(search.nearest, |shot| shot.node);
        legs_into(&self.workspace, &lattice, last, &mut self.way, &mut self.legs);
        let mut end = self.legs.last().map_or(*start, Leg::end);
        if let Some(shot) = &search.shot {
            self.legs.extend(self.curves.legs(&end, &shot.curve));
            end = goal;
        }
        if self.params.shorten && search.end != SearchEnd::Cancelled && !cancelled() {
            self.shortener.run(&lattice, &self.site, &self.curves, &mut self.legs, &end);
        }
        write_path(&self.legs, start, &end, self.params.spacing, path)?;
        let cost = lattice.cost_of(None, self.legs.iter().copied());
        match reason {
            None => Ok(PlanOutcome::Found { cost, expansions: search.expansions }),
            Some(reason) => no_path(reason, search.expansions),
        }
    }
}
