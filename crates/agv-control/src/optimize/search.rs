//! The loop around an optimiser: ask, evaluate, tell, count, and stop.

use super::{Optimizer, Record, SearchSpace, Stopping, Termination};
use crate::objective::{Objective, evaluate_all};
use agv_core::{Error, check, compute::Par};

/// An optimiser at work in a space of the user's units.
///
/// [`run`](Self::run) goes on until it must stop. [`advance`](Self::advance) spends a few evaluations at a time, which is
/// how a controller is tuned while its vehicle drives. After the first generation neither allocates,
/// but for the outcome's point and for CMA-ES when it starts anew with more samples. A checkpoint keeps whole
/// generations: one that was begun is evaluated again.
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawSearch<O>", bound(deserialize = "O: Optimizer + serde::Deserialize<'de>"))
)]
pub struct Search<O> {
    space: SearchSpace,
    optimizer: O,
    par: Par,
    /// The generation that is being evaluated, in the user's units, and the costs so far.
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    points: Vec<f64>,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    costs: Vec<f64>,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    evaluated: usize,
    /// Best point in the user's units.
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    best: Vec<f64>,
    /// Of whole generations.
    evaluations: usize,
    iterations: usize,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawSearch<O> {
    space: SearchSpace,
    optimizer: O,
    par: Par,
    evaluations: usize,
    iterations: usize,
}

#[cfg(feature = "serde")]
impl<O: Optimizer> TryFrom<RawSearch<O>> for Search<O> {
    type Error = Error;

    fn try_from(raw: RawSearch<O>) -> Result<Self, Error> {
        let mut search = Self::new(raw.space, raw.optimizer)?.with_parallelism(raw.par);
        (search.evaluations, search.iterations) = (raw.evaluations, raw.iterations);
        search.take_best();
        Ok(search)
    }
}

/// Where a search ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Best point, in the user's units.
    pub point: Vec<f64>,
    /// Its cost; infinite if no point had one.
    pub cost: f64,
    /// Evaluations of the objective.
    pub evaluations: usize,
    /// Generations.
    pub iterations: usize,
    /// Why it ended.
    pub termination: Termination,
}

impl<O: Optimizer> Search<O> {
    /// Joins an optimiser with the space that it is to search.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`] if the two differ in dimension.
    pub fn new(space: SearchSpace, optimizer: O) -> Result<Self, Error> {
        check::length("optimiser's dimensions", optimizer.dimension(), space.dimension())?;
        let mut search = Self {
            best: vec![0.0; space.dimension()],
            space,
            optimizer,
            par: Par::Seq,
            points: Vec::new(),
            costs: Vec::new(),
            evaluated: 0,
            evaluations: 0,
            iterations: 0,
        };
        search.begin();
        Ok(search)
    }

    /// Evaluates generations on several threads, with the same bits as on one.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// The space that is searched.
    pub fn space(&self) -> &SearchSpace {
        &self.space
    }

    /// The optimiser.
    pub fn optimizer(&self) -> &O {
        &self.optimizer
    }

    /// Best point so far in the user's units, and its cost; none before the first generation is complete.
    pub fn best(&self) -> Option<(&[f64], f64)> {
        self.optimizer.best().map(|(_, cost)| (self.best.as_slice(), cost))
    }

    /// Evaluations so far.
    pub fn evaluations(&self) -> usize {
        self.evaluations + self.evaluated
    }

    /// Complete generations so far.
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// Spends at most `evaluations` on the generation at hand; `true` if that completed it.
    ///
    /// # Errors
    /// What the optimiser has to say against the costs; the optimisers of this crate have nothing.
    pub fn advance<F: Objective + ?Sized>(&mut self, objective: &F, evaluations: usize) -> Result<bool, Error> {
        let from = self.evaluated;
        let to = self.costs.len().min(from.saturating_add(evaluations));
        let dimension = self.space.dimension();
        let points = &self.points[from * dimension..to * dimension];
        evaluate_all(objective, points, &mut self.costs[from..to], self.par);
        self.evaluated = to;
        if to < self.costs.len() {
            return Ok(false);
        }
        self.optimizer.tell(&self.costs)?;
        self.evaluations += to;
        self.iterations += 1;
        self.take_best();
        self.begin();
        Ok(true)
    }

    /// Searches until a criterion says stop. Counts go on from where they are: a second call with greater limits
    /// continues the search.
    ///
    /// # Errors
    /// A criterion that is not a number; otherwise as [`advance`](Self::advance).
    pub fn run<F: Objective + ?Sized>(&mut self, objective: &F, stopping: &Stopping) -> Result<Outcome, Error> {
        self.run_observed(objective, stopping, |_| {})
    }

    /// As [`run`](Self::run), and shows each generation to `observe`, the first one as soon as it is complete.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn run_observed<F: Objective + ?Sized>(
        &mut self,
        objective: &F,
        stopping: &Stopping,
        mut observe: impl FnMut(&Record<'_>),
    ) -> Result<Outcome, Error> {
        stopping.check()?;
        let mut least = self.best().map_or(f64::INFINITY, |(_, cost)| cost);
        let mut stalled = 0;
        let termination = loop {
            if let Some(termination) = self.termination(stopping, stalled) {
                break termination;
            }
            self.advance(objective, usize::MAX)?;
            let Some((point, cost)) = self.best() else { continue };
            // A cost that rises is that of a new environment: the search begins anew.
            stalled = if cost == least { stalled + 1 } else { 0 };
            least = cost;
            let (iteration, evaluations) = (self.iterations, self.evaluations());
            observe(&Record { iteration, evaluations, point, cost, spread: self.optimizer.spread() });
        };
        let (point, cost) = self.best().map_or((&[][..], f64::INFINITY), |best| best);
        Ok(Outcome {
            point: point.to_vec(),
            cost,
            evaluations: self.evaluations(),
            iterations: self.iterations,
            termination,
        })
    }

    fn termination(&self, stopping: &Stopping, stalled: usize) -> Option<Termination> {
        let pending = self.costs.len() - self.evaluated;
        if let Some((_, cost)) = self.best() {
            if cost <= stopping.target {
                return Some(Termination::Target);
            }
            if stopping.min_spread > 0.0 && self.optimizer.spread() < stopping.min_spread {
                return Some(Termination::Converged);
            }
            if stopping.stall_iterations > 0 && stalled >= stopping.stall_iterations {
                return Some(Termination::Stalled);
            }
        }
        if self.iterations >= stopping.max_iterations {
            return Some(Termination::MaxIterations);
        }
        (self.evaluations().saturating_add(pending) > stopping.max_evaluations).then_some(Termination::MaxEvaluations)
    }

    fn take_best(&mut self) {
        if let Some((unit, _)) = self.optimizer.best() {
            self.space.values_into(unit, &mut self.best);
        }
    }

    /// Takes the next generation from the optimiser.
    fn begin(&mut self) {
        let units = self.optimizer.ask();
        self.points.resize(units.len(), 0.0);
        self.space.values_into(units, &mut self.points);
        self.costs.resize(units.len() / self.space.dimension(), f64::INFINITY);
        self.evaluated = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pso::{Swarm, SwarmParams};
    use agv_core::compute::Seed;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn bowl(point: &[f64]) -> f64 {
        point.iter().map(|x| (x - 2.0) * (x - 2.0)).sum()
    }

    fn search(seed: u64) -> Search<Swarm> {
        let swarm = Swarm::new(3, SwarmParams::improved(), Seed(seed)).unwrap();
        Search::new(SearchSpace::cube(3, -10.0, 10.0).unwrap(), swarm).unwrap()
    }

    #[test]
    fn ends_for_the_reason_that_it_says() {
        let all = Stopping { max_evaluations: usize::MAX, ..Stopping::default() };
        for (stopping, expected) in [
            (Stopping::default(), Termination::MaxEvaluations),
            (Stopping { max_evaluations: 0, ..all }, Termination::MaxEvaluations),
            (Stopping { max_iterations: 7, ..all }, Termination::MaxIterations),
            (Stopping { target: 0.5, ..all }, Termination::Target),
            (Stopping { min_spread: 0.01, ..all }, Termination::Converged),
            (Stopping { stall_iterations: 5, ..all }, Termination::Stalled),
        ] {
            let calls = AtomicUsize::new(0);
            let counted = |point: &[f64]| {
                calls.fetch_add(1, Ordering::Relaxed);
                bowl(point)
            };
            let outcome = search(1).run(&counted, &stopping).unwrap();
            assert_eq!(outcome.termination, expected);
            assert_eq!(outcome.evaluations, calls.into_inner());
            assert_eq!(outcome.evaluations, 20 * outcome.iterations);
            assert!(outcome.evaluations <= stopping.max_evaluations);
            match expected {
                Termination::Target => assert!(outcome.cost <= 0.5),
                Termination::MaxIterations => assert_eq!(outcome.iterations, 7),
                _ => {}
            }
            if outcome.iterations > 0 {
                assert_eq!(outcome.cost, bowl(&outcome.point));
            }
        }
    }

    #[test]
    fn spent_in_bits_it_goes_the_same_way() {
        let stopping = Stopping { max_iterations: 12, ..Stopping::default() };
        let (mut whole, mut bits) = (search(5), search(5));
        let expected = whole.run(&bowl, &stopping).unwrap();
        let mut spent = 0;
        for share in (0..5).cycle() {
            let before = bits.evaluations();
            bits.advance(&bowl, share).unwrap();
            assert!(bits.evaluations() - before <= share);
            spent += bits.evaluations() - before;
            if bits.iterations() == 12 {
                break;
            }
        }
        assert_eq!((bits.best().unwrap(), spent), ((expected.point.as_slice(), expected.cost), expected.evaluations));
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let run = |par| search(9).with_parallelism(par).run(&bowl, &Stopping::default()).unwrap();
        assert_eq!(run(Par::Seq), run(Par::threads(3)));
    }

    #[test]
    fn a_cost_of_nothing_but_nan_is_infinite() {
        let outcome = search(1).run(&|_: &[f64]| f64::NAN, &Stopping::default()).unwrap();
        assert_eq!((outcome.cost, outcome.iterations), (f64::INFINITY, 100));
    }

    #[test]
    fn misfits_are_refused() {
        let swarm = Swarm::new(2, SwarmParams::improved(), Seed(0)).unwrap();
        assert!(Search::new(SearchSpace::cube(3, 0.0, 1.0).unwrap(), swarm).is_err());
        for stopping in
            [Stopping { target: f64::NAN, ..Stopping::default() }, Stopping { min_spread: -1.0, ..Stopping::default() }]
        {
            assert!(search(1).run(&bowl, &stopping).is_err());
        }
    }
}
