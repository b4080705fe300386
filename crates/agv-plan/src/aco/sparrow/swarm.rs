//! The flock: producers lead, the others follow or fly off hungry, scouts flee (Xue and Shen 2020, Eqs. 3 to 6).

use super::{
    SparrowParams,
    corridor::{Corridor, straighten},
};
use crate::{
    Error,
    aco::history::{Iteration, Run},
    grid::{DijkstraSolver, GridPlanner, GridPlannerParams, GridSolver, GridSpace, Limits, SearchEnd, SearchResult},
};
use agv_core::compute::{Par, Seed, Stream};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// Plans by sparrow search; paths are any-angle ones.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::aco::{SparrowParams, SparrowSearch};
/// use agv_plan::grid::GridPlannerParams;
///
/// let mut map = Grid::filled(GridLayout::new(20, 20, 1.0, Se2::default())?, CellState::Free);
/// for y in 0..15 {
///     map.set(Cell::new(10, y), CellState::Occupied);
/// }
/// let mut sparrows = SparrowSearch::new(GridPlannerParams::default(), SparrowParams::default(), Seed(1))?;
/// let mut path = Path::new();
/// let (start, goal) = (Se2::new(0.5, 0.5, 0.0), Se2::new(19.5, 0.5, 0.0));
/// let outcome = sparrows.plan_into(&Costmap::from_map(&map), &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if cost < 37.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type SparrowSearch = GridPlanner<Swarm>;

impl SparrowSearch {
    /// Checks the parameters. Every query draws the same numbers again.
    ///
    /// # Errors
    /// Parameters out of their range; a cost weight that is not zero.
    pub fn new(params: GridPlannerParams, sparrows: SparrowParams, seed: Seed) -> Result<Self, Error> {
        Self::with_uniform_solver(params, "SparrowSearch", Swarm::new(sparrows, seed)?)
    }

    /// The same planner, whose sparrows fly in parallel; the result does not depend on it.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.solver_mut().par = par;
        self
    }
}

/// The search of [`SparrowSearch`].
#[derive(Debug, Clone)]
pub struct Swarm {
    params: SparrowParams,
    seed: Seed,
    par: Par,
    corridor: Corridor,
    reach: DijkstraSolver,
    flock: Vec<Sparrow>,
    /// Sparrows by length, shortest first.
    order: Vec<usize>,
    best: Sparrow,
    /// Position of the worst sparrow.
    worst: Vec<f64>,
    trial: Sparrow,
    history: Vec<Iteration>,
    goal: u32,
    run: Run,
}

#[derive(Debug, Clone, Default)]
struct Sparrow {
    position: Vec<f64>,
    rank: usize,
    length: f64,
    /// All cells of its way, and the key nodes of it.
    cells: Vec<u32>,
    way: Vec<u32>,
}

impl Sparrow {
    fn judge(&mut self, corridor: &Corridor, space: &GridSpace) {
        let rows = corridor.rows();
        self.position.iter_mut().for_each(|v| *v = if v.is_finite() { v.clamp(-rows, rows) } else { 0.0 });
        corridor.way_into(space, &self.position, &mut self.cells);
        self.length = straighten(space, &self.cells, &mut self.way);
    }

    fn copy_from(&mut self, other: &Self) {
        self.position.clone_from(&other.position);
        self.way.clone_from(&other.way);
        self.length = other.length;
    }
}

/// Sparrows of a chunk of the parallel loop.
const CHUNK: usize = 8;

impl Swarm {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Parameters out of their range.
    pub fn new(params: SparrowParams, seed: Seed) -> Result<Self, Error> {
        params.check()?;
        Ok(Self {
            params,
            seed,
            par: Par::Seq,
            corridor: Corridor::default(),
            reach: DijkstraSolver::default(),
            flock: vec![Sparrow::default(); params.sparrows],
            order: (0..params.sparrows).collect(),
            best: Sparrow::default(),
            worst: Vec::new(),
            trial: Sparrow::default(),
            history: Vec::new(),
            goal: u32::MAX,
            run: Run::default(),
        })
    }

    /// The iterations of the last run.
    pub fn history(&self) -> &[Iteration] {
        &self.history
    }

    /// What became of the last run; its turns are the corners of the straightened way.
    pub const fn run(&self) -> &Run {
        &self.run
    }

    /// Positions at random around the straight line, wider and wider.
    fn scatter(&mut self, space: &GridSpace) {
        let Self { seed, par, corridor, flock, .. } = self;
        let (seed, corridor) = (*seed, &*corridor);
        let count = flock.len() as f64;
        par.for_each_chunk(flock.as_mut_slice(), CHUNK, |chunk, sparrows| {
            for (index, sparrow) in sparrows.iter_mut().enumerate() {
                let number = chunk * CHUNK + index;
                let mut stream = seed.stream(0, number as u64);
                let wide = 0.5 * corridor.rows() * (number as f64 / count);
                sparrow.position.clear();
                sparrow.position.extend((0..corridor.dimension()).map(|_| wide * normal(&mut stream)));
                sparrow.judge(corridor, space);
            }
        });
    }

    /// One flight of all.
    fn fly(&mut self, space: &GridSpace, iteration: usize) {
        let Self { params, seed, par, corridor, flock, best, worst, .. } = self;
        let (seed, corridor, best, worst) = (*seed, &*corridor, &*best, worst.as_slice());
        let count = flock.len();
        let leaders = ((params.producers * count as f64).round() as usize).clamp(1, count);
        let alarmed = seed.stream(iteration as u64, count as u64).random::<f64>() >= params.safety;
        par.for_each_chunk(flock.as_mut_slice(), CHUNK, |chunk, sparrows| {
            for (index, sparrow) in sparrows.iter_mut().enumerate() {
                let mut stream = seed.stream(iteration as u64, (chunk * CHUNK + index) as u64);
                let rank = sparrow.rank as f64 + 1.0;
                if sparrow.rank < leaders {
                    let shrink = (-rank / (stream.random::<f64>().max(1e-3) * params.iterations as f64)).exp();
                    let jump = normal(&mut stream);
                    sparrow.position.iter_mut().for_each(|v| *v = if alarmed { *v + jump } else { *v * shrink });
                } else if sparrow.rank > count / 2 {
                    for ((v, worst), best) in sparrow.position.iter_mut().zip(worst).zip(&best.position) {
                        let draw = normal(&mut stream);
                        // The addition: around the best sparrow. The original: anywhere, by what the worst one is off.
                        *v = if params.gather {
                            best + draw * (*v - best)
                        } else {
                            draw * ((worst - *v) / (rank * rank)).exp()
                        };
                    }
                } else {
                    follow(&mut sparrow.position, &best.position, &mut stream);
                }
                if stream.random::<f64>() < params.scouts {
                    let is_best = sparrow.length <= best.length;
                    let draw = if is_best { 2.0 * stream.random::<f64>() - 1.0 } else { normal(&mut stream) };
                    for ((v, best), worst) in sparrow.position.iter_mut().zip(&best.position).zip(worst) {
                        *v = if is_best { *v + draw * (*v - worst).abs() } else { best + draw * (*v - best).abs() };
                    }
                }
                sparrow.judge(corridor, space);
            }
        });
    }

    /// The addition: changes of a few neighbouring columns of the best way, kept if they are shorter.
    fn search_around_best(&mut self, space: &GridSpace, iteration: usize) {
        let mut stream = self.seed.stream(iteration as u64, self.flock.len() as u64 + 1);
        let dimension = self.corridor.dimension();
        for _ in 0..self.params.trials {
            self.trial.position.clone_from(&self.best.position);
            let (middle, wide) =
                (dimension as f64 * stream.random::<f64>(), 1.0 + 0.2 * dimension as f64 * stream.random::<f64>());
            let shift = 3.0 * normal(&mut stream);
            for (column, v) in self.trial.position.iter_mut().enumerate() {
                let off = (column as f64 - middle) / wide;
                *v += shift * (-off * off).exp();
            }
            self.trial.judge(&self.corridor, space);
            if self.trial.length < self.best.length {
                self.best.copy_from(&self.trial);
            }
        }
    }

    /// Ranks the flock and takes down what it found.
    fn take_down(&mut self, iteration: usize) {
        let Self { flock, order, .. } = self;
        order.sort_unstable_by(|&a, &b| flock[a].length.total_cmp(&flock[b].length).then(a.cmp(&b)));
        for (rank, &index) in order.iter().enumerate() {
            flock[index].rank = rank;
        }
        let (first, last) = (&flock[order[0]], &flock[order[order.len() - 1]]);
        if first.length < self.best.length {
            self.best.copy_from(first);
        }
        self.worst.clone_from(&last.position);
        self.history.push(Iteration {
            best: first.length,
            mean: flock.iter().map(|sparrow| sparrow.length).sum::<f64>() / flock.len() as f64,
            worst: last.length,
            arrived: flock.len(),
            best_so_far: self.best.length,
        });
        self.run.iterations = iteration + 1;
        self.note(iteration);
    }

    /// Takes over the best length.
    fn note(&mut self, iteration: usize) {
        if self.run.length.is_none_or(|length| self.best.length < length) {
            self.run.length = Some(self.best.length);
            self.run.converged = iteration + 1;
        }
        if let Some(last) = self.history.last_mut() {
            last.best_so_far = self.best.length;
        }
    }
}

impl GridSolver for Swarm {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        self.history.clear();
        self.history.reserve(self.params.iterations);
        self.run = Run::default();
        self.best.length = f64::INFINITY;
        self.goal = goal;
        // Whether there is a way at all; it takes no longer than a few ants, and is not counted.
        let reached = self.reach.search(space, start, goal, &mut limits.without_budget());
        if !matches!(reached.end, SearchEnd::Goal { .. }) {
            return reached;
        }
        if !self.corridor.prepare(space, start, goal) {
            return SearchResult { end: SearchEnd::Budget, expansions: 0, nearest: start };
        }
        self.scatter(space);
        self.take_down(0);
        let mut evaluations = self.flock.len() as u64;
        for iteration in 1..self.params.iterations {
            if limits.stopped(evaluations).is_some() {
                break;
            }
            self.fly(space, iteration);
            self.take_down(iteration);
            self.search_around_best(space, iteration);
            self.note(iteration);
            evaluations += (self.flock.len() + self.params.trials) as u64;
        }
        (self.run.sent, self.run.arrived, self.run.steps) = (evaluations, evaluations, evaluations);
        self.run.turns = self.best.way.len().saturating_sub(2);
        let cost = self.cost(goal).unwrap_or(0);
        SearchResult { end: SearchEnd::Goal { node: goal, cost }, expansions: evaluations, nearest: goal }
    }

    fn cost(&self, node: u32) -> Option<u32> {
        if node == self.goal && self.run.length.is_some() {
            return Some((self.best.length * f64::from(crate::grid::STRAIGHT)).round() as u32);
        }
        self.reach.cost(node)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        if node == self.goal && self.run.length.is_some() {
            way.clone_from(&self.best.way);
        } else {
            self.reach.way_into(space, node, way);
        }
    }
}

/// `X ← X_p + |X - X_p| A⁺`, with A a row of random signs: `A⁺ = Aᵀ / d` is the same step in every column.
fn follow(position: &mut [f64], leader: &[f64], stream: &mut Stream) {
    let sign = |stream: &mut Stream| if stream.random::<bool>() { 1.0 } else { -1.0 };
    let sum: f64 = position.iter().zip(leader).map(|(v, lead)| (v - lead).abs() * sign(stream)).sum();
    let step = sum / position.len().max(1) as f64;
    position.iter_mut().zip(leader).for_each(|(v, lead)| *v = lead + step);
}

fn normal(stream: &mut Stream) -> f64 {
    StandardNormal.sample(stream)
}
