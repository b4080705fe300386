//! How a search went: a record of each generation, for convergence plots.

/// A generation as an observer sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record<'a> {
    /// Generations so far, this one included.
    pub iteration: usize,
    /// Evaluations so far.
    pub evaluations: usize,
    /// Best point, in the user's units.
    pub point: &'a [f64],
    /// Its cost.
    pub cost: f64,
    /// How widely the search is spread, as a part of the space.
    pub spread: f64,
}

/// All generations of a search.
///
/// ```
/// use agv_control::optimize::{History, Search, SearchSpace, Stopping};
/// use agv_control::pso::{Swarm, SwarmParams};
/// use agv_core::compute::Seed;
///
/// let swarm = Swarm::new(2, SwarmParams::improved(), Seed(1))?;
/// let mut search = Search::new(SearchSpace::cube(2, -5.0, 5.0)?, swarm)?;
/// let mut history = History::default();
/// let sphere = |p: &[f64]| p[0] * p[0] + p[1] * p[1];
/// search.run_observed(&sphere, &Stopping::default(), |record| history.push(record))?;
/// assert!(history.records().is_sorted_by(|a, b| a.cost >= b.cost));
/// assert_eq!(history.iterations_to(0.0), None);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct History {
    rows: Vec<(usize, usize, f64, f64)>,
    points: Vec<f64>,
}

impl History {
    /// Adds a generation.
    pub fn push(&mut self, record: &Record<'_>) {
        self.rows.push((record.iteration, record.evaluations, record.cost, record.spread));
        self.points.extend_from_slice(record.point);
    }

    /// The generations in order.
    pub fn records(&self) -> impl DoubleEndedIterator<Item = Record<'_>> + Clone {
        let dimension = self.points.len() / self.rows.len().max(1);
        self.rows.iter().zip(self.points.chunks_exact(dimension.max(1))).map(
            |(&(iteration, evaluations, cost, spread), point)| Record { iteration, evaluations, point, cost, spread },
        )
    }

    /// Generations until the cost was at most `target`; none if it never was.
    pub fn iterations_to(&self, target: f64) -> Option<usize> {
        self.records().find(|record| record.cost <= target).map(|record| record.iteration)
    }

    /// Evaluations until the cost was at most `target`; none if it never was.
    pub fn evaluations_to(&self, target: f64) -> Option<usize> {
        self.records().find(|record| record.cost <= target).map(|record| record.evaluations)
    }
}
