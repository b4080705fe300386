//! Who searches, and one run of it.

use super::{Args, Result};
use agv_nav::{
    control::{
        Objective,
        evolution::{CmaEs, CmaEsParams, DifferentialEvolution, DifferentialEvolutionParams},
        optimize::{History, Interval, Optimizer, Outcome, Search, SearchSpace, Stopping},
        pso::{Acceleration, Inertia, Swarm, SwarmParams, Topology},
    },
    core::compute::Seed,
};
use agv_support::timing::Timings;
use clap::ValueEnum;

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Method {
    /// Standard PSO with constant inertia
    Pso,
    /// Standard PSO with constriction
    Constriction,
    /// The paper's PSO: linear inertia, acceleration draws, one best place for all
    Paper,
    /// The same with the inertia as it is printed
    PaperPrinted,
    /// The same with a ring of neighbours, which its prose fits
    PaperRing,
    /// The swarm to take
    Improved,
    /// Differential evolution
    De,
    /// CMA-ES with restarts
    CmaEs,
    /// All of them, as a table
    All,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Scale {
    /// Evenly
    Linear,
    /// Denser towards zero, by the third power
    Gain,
}

impl Method {
    pub(crate) const EACH: [Self; 8] = [
        Self::Pso,
        Self::Constriction,
        Self::Paper,
        Self::PaperPrinted,
        Self::PaperRing,
        Self::Improved,
        Self::De,
        Self::CmaEs,
    ];

    /// The swarm of a method; none if it is none.
    pub(crate) fn swarm(self, args: &Args) -> Option<SwarmParams> {
        let paper = SwarmParams::paper(usize::from(args.iterations));
        let params = match self {
            Self::Pso => SwarmParams::standard(),
            Self::Constriction => SwarmParams {
                inertia: Inertia::Constriction,
                acceleration: Acceleration::Fixed { cognitive: 2.05, social: 2.05 },
                ..SwarmParams::standard()
            },
            Self::Paper => paper,
            Self::PaperPrinted => SwarmParams {
                inertia: Inertia::AsPrinted { start: 0.9, end: 0.4, iterations: usize::from(args.iterations) },
                ..paper
            },
            Self::PaperRing => SwarmParams { topology: Topology::Ring { neighbours: 1 }, ..paper },
            Self::Improved => SwarmParams::improved(),
            Self::De | Self::CmaEs | Self::All => return None,
        };
        Some(SwarmParams { particles: usize::from(args.particles), ..params })
    }

    fn optimizer(self, args: &Args, dimension: usize, seed: Seed) -> Result<Box<dyn Optimizer>> {
        if let Some(params) = self.swarm(args) {
            return Ok(Box::new(Swarm::new(dimension, params, seed)?));
        }
        if self == Self::CmaEs {
            return Ok(Box::new(CmaEs::new(dimension, CmaEsParams::default(), seed)?));
        }
        let population = usize::from(args.particles);
        let params = DifferentialEvolutionParams { population, ..DifferentialEvolutionParams::default() };
        Ok(Box::new(DifferentialEvolution::new(dimension, params, seed)?))
    }

    /// The gains up to the greatest one, on the scale that the method takes if the user takes none.
    pub(crate) fn space(self, args: &Args, greatest: f64) -> Result<SearchSpace> {
        let plain = matches!(self, Self::Pso | Self::Constriction | Self::Paper | Self::PaperPrinted | Self::PaperRing);
        let interval = match args.scale.unwrap_or(if plain { Scale::Linear } else { Scale::Gain }) {
            Scale::Linear => Interval::linear(0.0, greatest),
            Scale::Gain => Interval::gain(greatest),
        };
        Ok(SearchSpace::new(vec![interval; 3])?)
    }

    /// One search, and what it looked like.
    pub(crate) fn search<F: Objective>(
        self,
        args: &Args,
        (cost, greatest): (&F, f64),
        budget: usize,
        seed: Seed,
        timings: &mut Timings,
    ) -> Result<(Outcome, History)> {
        let stopping = Stopping { max_evaluations: budget, ..Stopping::default() };
        let mut history = History::default();
        let outcome = timings.time(|| {
            let optimizer = self.optimizer(args, 3, seed)?;
            let search = Search::new(self.space(args, greatest)?, optimizer)?;
            let mut search = search.with_parallelism(args.common.par());
            Result::Ok(search.run_observed(cost, &stopping, |record| history.push(record))?)
        })?;
        Ok((outcome, history))
    }
}
