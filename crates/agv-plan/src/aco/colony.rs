//! The colony: iteration by iteration.

use super::{
    ant::{ABREAST, Ant, Rules, length_of, price_of, turns_of},
    detours::Detours,
    ground::Ground,
    history::{Iteration, Run},
    params::ColonyParams,
    sight::{SightTable, step_factors},
    trail::{Deposit, Trail},
};
use crate::{
    Error,
    grid::{DijkstraSolver, GridPlanner, GridPlannerParams, GridSolver, GridSpace, Limits, SearchEnd, SearchResult},
};
use agv_core::{
    compute::{Par, Seed},
    grid::GridLayout,
};

/// Plans by an ant colony.
pub type AntColony = GridPlanner<Colony>;

impl AntColony {
    /// Checks the parameters. Every query draws the same numbers again: what it finds depends on the seed and the query
    /// alone.
    ///
    /// # Errors
    /// Parameters out of their range; a cost weight that is not zero.
    pub fn new(params: GridPlannerParams, colony: ColonyParams, seed: Seed) -> Result<Self, Error> {
        Self::with_uniform_solver(params, "AntColony", Colony::new(colony, seed)?)
    }

    /// The same planner, whose ants walk in parallel; the result does not depend on it.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.solver_mut().par = par;
        self
    }
}

/// The search of [`AntColony`].
#[derive(Debug, Clone)]
pub struct Colony {
    params: ColonyParams,
    seed: Seed,
    par: Par,
    trail: Trail,
    sight: SightTable,
    reach: DijkstraSolver,
    squads: Vec<Squad>,
    history: Vec<Iteration>,
    /// Steps of the shortest way of the run.
    best: Vec<u8>,
    goal: u32,
    run: Run,
}

/// Ants that walk one after another, and the memory that they share.
#[derive(Debug, Clone, Default)]
struct Squad {
    ants: Vec<Ant>,
    grounds: [Ground; ABREAST],
    detours: Detours,
}

/// Ants of a squad: fixed, so that the number of threads reaches no result.
const SQUAD: usize = 8;

impl Colony {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Parameters out of their range.
    pub fn new(params: ColonyParams, seed: Seed) -> Result<Self, Error> {
        params.check()?;
        let squad = |index: usize| {
            let ants = SQUAD.min(params.ants - index * SQUAD);
            Squad { ants: vec![Ant::default(); ants], ..Squad::default() }
        };
        Ok(Self {
            params,
            seed,
            par: Par::Seq,
            trail: Trail::default(),
            sight: SightTable::default(),
            reach: DijkstraSolver::default(),
            squads: (0..params.ants.div_ceil(SQUAD)).map(squad).collect(),
            history: Vec::new(),
            best: Vec::new(),
            goal: u32::MAX,
            run: Run::default(),
        })
    }

    /// Parameters it was made with.
    pub const fn params(&self) -> &ColonyParams {
        &self.params
    }

    /// The iterations of the last run.
    pub fn history(&self) -> &[Iteration] {
        &self.history
    }

    /// What became of the last run.
    pub const fn run(&self) -> &Run {
        &self.run
    }

    /// Sends the ants of an iteration.
    fn send(&mut self, space: &GridSpace, (start, goal): (u32, u32), strides: &[u32; 8], iteration: usize) {
        let params = &self.params;
        let (now, all) = (iteration, params.iterations);
        let beta = params.beta.at(now, all);
        self.sight.raise(beta);
        let bounds = params.limits.bounds(self.run.length, params.quantity, params.evaporation);
        self.trail.raise(params.alpha.at(now, all), bounds, &step_factors(&params.sight, beta));
        let rules = Rules {
            masks: space.masks(),
            strides,
            width: space.layout().map_or(0, GridLayout::width),
            trail: self.trail.powers(),
            sight: self.sight.powers(),
            greed: params.greed.at(now, all) as f32,
            dead_end: params.dead_end,
            start,
            goal,
        };
        let (seed, erase) = (self.seed, params.erase_detours);
        self.par.for_each_chunk(self.squads.as_mut_slice(), 1, |squad, squads| {
            for Squad { ants, grounds, detours } in squads {
                rules.walk(ants, grounds, |ant| seed.stream(iteration as u64, (squad * SQUAD + ant) as u64));
                if erase {
                    for ant in ants.iter_mut().filter(|ant| ant.length.is_some()) {
                        detours.erase(&rules, &mut ant.steps);
                        ant.length = Some(length_of(&ant.steps));
                    }
                }
            }
        });
    }

    /// Takes down what the ants of an iteration found, and returns its best and worst ant.
    fn take_down(&mut self, iteration: usize) -> Option<(usize, usize)> {
        let mut ends: Option<[(f64, usize); 2]> = None;
        let (mut sum, mut arrived) = (0.0, 0);
        for (index, ant) in self.squads.iter().flat_map(|squad| &squad.ants).enumerate() {
            self.run.steps += ant.taken;
            let Some(length) = ant.length else { continue };
            sum += length;
            arrived += 1;
            let here = (length, index);
            ends = Some(ends.map_or([here; 2], |[best, worst]| {
                [if length < best.0 { here } else { best }, if length > worst.0 { here } else { worst }]
            }));
        }
        self.run.sent += self.params.ants as u64;
        self.run.arrived += arrived as u64;
        self.run.iterations = iteration + 1;
        let best = ends.map(|[best, _]| best);
        if let Some((length, index)) = best
            && self.run.length.is_none_or(|least| length < least)
        {
            self.run.length = Some(length);
            self.run.converged = iteration + 1;
            self.best.clear();
            self.best.extend_from_slice(&self.squads[index / SQUAD].ants[index % SQUAD].steps);
        }
        let infinite = f64::INFINITY;
        self.history.push(Iteration {
            best: best.map_or(infinite, |(length, _)| length),
            mean: if arrived > 0 { sum / arrived as f64 } else { infinite },
            worst: ends.map_or(infinite, |[_, (length, _)]| length),
            arrived,
            best_so_far: self.run.length.unwrap_or(infinite),
        });
        ends.map(|[(_, best), (_, worst)]| (best, worst))
    }

    /// Evaporation and what the ants leave.
    fn leave(&mut self, start: u32, strides: &[u32; 8], ends: Option<(usize, usize)>) {
        let Self { params, trail, squads, history, best: best_way, run, .. } = self;
        let quantity = params.quantity;
        trail.evaporate(params.evaporation);
        let (Some((best, worst)), Some(now)) = (ends, history.last()) else { return };
        let ant = |index: usize| &squads[index / SQUAD].ants[index % SQUAD];
        let ants = squads.iter().flat_map(|squad| &squad.ants);
        let arrived = ants.filter_map(|ant| ant.length.map(|length| (ant, length)));
        match params.deposit {
            Deposit::EveryAnt => {
                for (ant, length) in arrived {
                    trail.deposit(start, &ant.steps, strides, quantity / length.max(1.0));
                }
            }
            Deposit::Graded { threshold } => {
                let [least, mean, greatest] = [now.best, now.mean, now.worst].map(|length| quantity / length.max(1.0));
                for (ant, length) in arrived {
                    let fitness = now.best / length;
                    let amount = if length == now.best {
                        least + mean - greatest
                    } else if fitness > threshold {
                        fitness * (2.0 * quantity / length - greatest)
                    } else {
                        continue;
                    };
                    trail.deposit(start, &ant.steps, strides, params.evaporation * amount);
                }
                trail.deposit(start, &ant(best).steps, strides, least);
                if now.worst > now.best {
                    trail.deposit(start, &ant(worst).steps, strides, -greatest);
                }
            }
            Deposit::BestWay { period } => {
                let (steps, length) = match run.length {
                    Some(length) if period == 0 || !history.len().is_multiple_of(period) => (&*best_way, length),
                    _ => (&ant(best).steps, now.best),
                };
                trail.deposit(start, steps, strides, quantity / length.max(1.0));
            }
        }
    }
}

impl GridSolver for Colony {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        self.history.clear();
        self.history.reserve(self.params.iterations);
        self.best.clear();
        self.run = Run::default();
        self.goal = goal;
        // Whether there is a way at all; it takes no longer than a few ants, and is not counted.
        let reached = self.reach.search(space, start, goal, &mut limits.without_budget());
        if !matches!(reached.end, SearchEnd::Goal { .. }) {
            return reached;
        }
        if start == goal {
            self.run.length = Some(0.0);
            return SearchResult { end: SearchEnd::Goal { node: goal, cost: 0 }, expansions: 0, nearest: goal };
        }
        let strides = space.strides();
        self.trail.reset(space.len(), self.params.initial);
        self.sight.prepare(&self.params.sight, space, goal);
        self.squads.iter_mut().flat_map(|squad| &mut squad.grounds).for_each(|ground| ground.prepare(space));
        let mut stopped = None;
        let mut levelled = 0;
        for iteration in 0..self.params.iterations {
            self.send(space, (start, goal), &strides, iteration);
            let ends = self.take_down(iteration);
            self.leave(start, &strides, ends);
            stopped = limits.stopped(self.run.steps);
            let idle = iteration + 1 - self.run.converged;
            if stopped.is_some() || (self.params.patience > 0 && idle >= self.params.patience) {
                break;
            }
            let since = iteration + 1 - self.run.converged.max(levelled);
            if self.params.restart_after > 0 && since >= self.params.restart_after {
                let bounds = self.params.limits.bounds(self.run.length, self.params.quantity, self.params.evaporation);
                self.trail.level((self.params.initial as f32).clamp(bounds.0, bounds.1));
                levelled = iteration + 1;
            }
        }
        self.run.turns = turns_of(&self.best);
        let expansions = self.run.steps;
        let end = match self.run.length {
            Some(_) => SearchEnd::Goal { node: goal, cost: cost_of(&self.best) },
            None => stopped.unwrap_or(SearchEnd::Budget),
        };
        SearchResult { end, expansions, nearest: if self.run.length.is_some() { goal } else { start } }
    }

    fn cost(&self, node: u32) -> Option<u32> {
        if node == self.goal && self.run.length.is_some() {
            return Some(cost_of(&self.best));
        }
        self.reach.cost(node)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        if node != self.goal || self.run.length.is_none() {
            return self.reach.way_into(space, node, way);
        }
        let strides = space.strides();
        way.clear();
        // From the goal back to where the ants came from.
        let back = |node: u32, &step: &u8| node.wrapping_sub(strides[usize::from(step & 7)]);
        let start = self.best.iter().rev().fold(node, back);
        way.push(start);
        way.extend(self.best.iter().scan(start, |node, &step| {
            *node = node.wrapping_add(strides[usize::from(step & 7)]);
            Some(*node)
        }));
    }
}

/// Length of steps in the integers of the search.
fn cost_of(steps: &[u8]) -> u32 {
    steps.iter().fold(0_u32, |cost, &step| cost.saturating_add(price_of(step)))
}

#[cfg(test)]
mod tests;
