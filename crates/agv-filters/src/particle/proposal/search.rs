//! Search for poses that explain a scan, from coarse to fine.
//!
//! Candidates are spread over free space and heading, stratified so that none stays empty, and weighed by the scan in one
//! batch. The best of each bin are kept, and refined by trying poses around them, nearer and nearer. From what is found,
//! poses are drawn in proportion to a power of their likelihood: one scan cannot tell like places from each other, so that
//! all of them are to be proposed, and later scans choose. (Lenser and Veloso 2000 draw from the sensor's model for the same
//! purpose; Thrun, Fox, Burgard and Dellaert 2001 call it the dual of the particle filter.)

use super::{
    LikelihoodSearchParams, ObservedPose, Place, PoseProposal, ProposalContext, ResumableProposal, SearchState,
};
use crate::particle::{PoseHistogram, WeighParticles, normal};
use agv_core::{
    Error,
    compute::Stream,
    geometry::{LieGroup, Se2, UncertainPose},
    sensors::{LaserScan, PoseObservation},
};
use nalgebra::Vector3;
use rand::RngExt;

/// Proposes poses that explain the scan; pose observations are drawn from as they are.
///
/// O(candidates x beams); all memory is allocated at construction.
#[derive(Debug, Clone)]
pub struct LikelihoodSearch {
    pub(super) params: LikelihoodSearchParams,
    pub(super) candidates: Vec<Se2>,
    log_likelihoods: Vec<f64>,
    order: Vec<u32>,
    histogram: PoseHistogram,
    pub(super) found: Vec<Found>,
    /// How often the first of the candidates were refined already.
    pub(super) rounds: Vec<u32>,
    cumulative: Vec<f64>,
    pub(super) state: SearchState,
}

/// A pose with its log-likelihood, and how often it was refined.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) pose: Se2,
    pub(super) log_likelihood: f64,
    pub(super) rounds: u32,
}

impl LikelihoodSearch {
    /// Checks the parameters and allocates.
    ///
    /// # Errors
    /// Parameters that [`validate`](LikelihoodSearchParams::validate) refuses.
    pub fn new(params: LikelihoodSearchParams) -> Result<Self, Error> {
        params.validate()?;
        let most = (params.max_candidates + params.refined + 1).max(params.refined * params.trials);
        Ok(Self {
            params,
            candidates: Vec::with_capacity(most),
            log_likelihoods: Vec::with_capacity(most),
            order: Vec::with_capacity(most),
            histogram: PoseHistogram::new(params.bins)?.with_capacity(params.refined),
            found: Vec::with_capacity(params.refined),
            rounds: Vec::with_capacity(params.refined),
            cumulative: Vec::with_capacity(params.refined),
            state: SearchState { places: Vec::with_capacity(params.refined), ..SearchState::default() },
        })
    }

    /// The parameters.
    pub const fn params(&self) -> &LikelihoodSearchParams {
        &self.params
    }

    /// What was found last, by falling likelihood: poses and log-likelihoods.
    pub fn found(&self) -> impl ExactSizeIterator<Item = (&Se2, f64)> {
        self.found.iter().map(|found| (&found.pose, found.log_likelihood))
    }

    /// Candidates of a whole search.
    pub(super) fn count(&self, context: &ProposalContext<'_>) -> usize {
        ((context.free_space.area() * self.params.density) as usize).clamp(1, self.params.max_candidates)
    }

    /// Searches all free space; returns how many places were found, none if the observation weighs nothing.
    pub fn search<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) -> usize {
        self.found.clear();
        self.rounds.clear();
        let (space, count) = (context.free_space, self.count(context));
        self.candidates.clear();
        self.candidates.resize(count, Se2::identity());
        context.fill(1, &mut self.candidates, |index, stream| space.sample_stratum(index, count, stream));
        if self.weigh(observation, sensor, context) {
            self.keep_best(self.params.refined);
            for _ in 0..self.params.rounds {
                self.refine(observation, sensor, context);
            }
            self.sort_found();
        }
        self.found.len()
    }

    /// By falling likelihood.
    pub(super) fn sort_found(&mut self) {
        self.found.sort_unstable_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    }

    /// Weighs the candidates; whether it could be done.
    pub(super) fn weigh<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) -> bool {
        self.log_likelihoods.clear();
        self.log_likelihoods.resize(self.candidates.len(), f64::NEG_INFINITY);
        sensor.weigh(observation, &self.candidates, &mut self.log_likelihoods, context.par).is_ok()
    }

    /// The best candidate of each bin, of so many best bins among the best candidates.
    pub(super) fn keep_best(&mut self, most: usize) {
        let logs = &self.log_likelihoods;
        let by_likelihood = |a: &u32, b: &u32| logs[*b as usize].total_cmp(&logs[*a as usize]).then(a.cmp(b));
        self.order.clear();
        self.order.extend(0..self.candidates.len() as u32);
        // Several candidates share a bin near a good pose: look at more of them than are kept.
        let looked_at = (8 * most).min(self.order.len());
        if looked_at < self.order.len() {
            self.order.select_nth_unstable_by(looked_at, by_likelihood);
        }
        let best = &mut self.order[..looked_at];
        best.sort_unstable_by(by_likelihood);
        self.histogram.clear();
        for &index in &*best {
            let (pose, log_likelihood) = (self.candidates[index as usize], logs[index as usize]);
            let bins = self.histogram.len();
            let is_new = self.histogram.insert(&pose, 1.0) == bins;
            if is_new && log_likelihood.is_finite() {
                let rounds = self.rounds.get(index as usize).copied().unwrap_or(0);
                self.found.push(Found { pose, log_likelihood, rounds });
            }
            if self.histogram.len() == most {
                break;
            }
        }
    }

    /// Tries poses around each that was found, and moves it to the best: a round nearer than the last.
    pub(super) fn refine<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) {
        let (params, trials, found) = (&self.params, self.params.trials, &self.found);
        if trials == 0 || params.rounds == 0 {
            return;
        }
        let part = 2 + u64::from(found.iter().map(|found| found.rounds).max().unwrap_or(0));
        self.candidates.clear();
        self.candidates.resize(found.len() * trials, Se2::identity());
        context.fill(part, &mut self.candidates, |index, stream| {
            let found = &found[index / trials];
            // A place that is carried on over many updates stays at the last round.
            found.pose.plus(&noise(&params.scale(found.rounds.min(params.rounds - 1)), stream))
        });
        if !self.weigh(observation, sensor, context) {
            return;
        }
        let tried = self.candidates.chunks(trials).zip(self.log_likelihoods.chunks(trials));
        for (found, (poses, logs)) in self.found.iter_mut().zip(tried) {
            for (&pose, &log_likelihood) in poses.iter().zip(logs) {
                if log_likelihood > found.log_likelihood {
                    *found = Found { pose, log_likelihood, ..*found };
                }
            }
            found.rounds = (found.rounds + 1).min(self.params.rounds);
        }
    }

    /// Weighs what was found beside the estimate, all at once, since there are models that judge poses together; returns what a place
    /// must reach to be proposed.
    fn compare<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) -> f64 {
        self.candidates.clear();
        self.candidates.extend(self.found.iter().map(|found| found.pose));
        self.candidates.push(context.estimate);
        if !self.weigh(observation, sensor, context) {
            return f64::NEG_INFINITY;
        }
        for (found, log_likelihood) in self.found.iter_mut().zip(&self.log_likelihoods) {
            found.log_likelihood = *log_likelihood;
        }
        self.sort_found();
        self.log_likelihoods.last().map_or(f64::NEG_INFINITY, |there| there - self.params.margin)
    }

    /// Draws poses from what was found and is no less likely, with the spread that the last round left.
    fn draw(&mut self, least: f64, context: &ProposalContext<'_>, poses: &mut [Se2]) -> usize {
        let found = &self.found[..self.found.partition_point(|found| found.log_likelihood >= least)];
        let Some(best) = found.first().map(|found| found.log_likelihood) else { return 0 };
        let (params, mut total) = (&self.params, 0.0);
        let power = params.power;
        self.cumulative.clear();
        self.cumulative.extend(found.iter().map(|found| {
            total += (power * (found.log_likelihood - best)).exp();
            total
        }));
        let cumulative = &self.cumulative;
        context.fill(0, poses, |_, stream| {
            let at = stream.random::<f64>() * total;
            let found = &found[cumulative.partition_point(|&sum| sum <= at).min(found.len() - 1)];
            found.pose.plus(&noise(&params.scale(found.rounds), stream))
        });
        poses.len()
    }
}

/// Draws with these standard deviations.
fn noise(scale: &Vector3<f64>, stream: &mut Stream) -> Vector3<f64> {
    let ([x, y], [turn, _]) = (normal::pair(stream), normal::pair(stream));
    scale.component_mul(&Vector3::new(x, y, turn))
}

impl ResumableProposal for LikelihoodSearch {
    fn state(&self) -> Option<SearchState> {
        Some(self.state.clone())
    }

    fn resume(&mut self, state: Option<&SearchState>) {
        let places = std::mem::take(&mut self.state.places);
        self.state = SearchState {
            places,
            ..state.map_or_else(SearchState::default, |state| SearchState { places: Vec::new(), ..*state })
        };
        self.state.places.clear();
        // It may be the state of a search with other parameters.
        let places = state.iter().flat_map(|state| &state.places).take(self.params.refined);
        self.state.places.extend(places.map(|place| Place { rounds: place.rounds.min(self.params.rounds), ..*place }));
    }
}

impl<S: WeighParticles<LaserScan> + ?Sized> PoseProposal<LaserScan, S> for LikelihoodSearch {
    fn propose(
        &mut self,
        observation: &LaserScan,
        sensor: &mut S,
        context: &ProposalContext<'_>,
        poses: &mut [Se2],
    ) -> usize {
        match self.budget(observation, sensor, context) {
            Some(tried) => self.advance(observation, sensor, context, tried),
            None => self.search_at_once(observation, sensor, context),
        };
        let least = self.compare(observation, sensor, context);
        self.draw(least, context, poses)
    }
}

/// As [`ObservedPose`].
impl<S: ?Sized> PoseProposal<PoseObservation<Se2>, S> for LikelihoodSearch {
    fn propose(
        &mut self,
        observation: &PoseObservation<Se2>,
        sensor: &mut S,
        context: &ProposalContext<'_>,
        poses: &mut [Se2],
    ) -> usize {
        ObservedPose::default().propose(observation, sensor, context, poses)
    }

    fn share(&self, observation: &PoseObservation<Se2>, expected: &UncertainPose<Se2>, doubted: f64) -> f64 {
        PoseProposal::<_, S>::share(&ObservedPose::default(), observation, expected, doubted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particle::{FreeSpace, PoseBins};
    use agv_core::{
        compute::{Par, Seed},
        grid::{CellState, Grid, GridLayout},
        roles::SkipReason,
    };

    /// Two peaks, the second lower by so much.
    struct Peaks(f64);

    const PEAKS: [(f64, f64, f64); 2] = [(2.0, 3.0, 0.5), (7.0, 6.0, -2.0)];

    impl WeighParticles<()> for Peaks {
        fn weigh(&mut self, (): &(), poses: &[Se2], out: &mut [f64], _: Par) -> Result<(), SkipReason> {
            for (value, pose) in out.iter_mut().zip(poses) {
                let [first, second] = PEAKS.map(|(x, y, yaw)| -pose.minus(&Se2::new(x, y, yaw)).norm_squared() * 50.0);
                *value = first.max(second - self.0);
            }
            if self.0.is_finite() { Ok(()) } else { Err(SkipReason::Unexplained) }
        }
    }

    fn space() -> FreeSpace {
        let layout = GridLayout::new(100, 80, 0.1, Se2::identity()).unwrap();
        FreeSpace::new(&Grid::filled(layout, CellState::Free), 0.0).unwrap()
    }

    #[test]
    fn both_peaks_are_found_and_drawn_by_their_power() {
        let space = space();
        let mut search = LikelihoodSearch::new(LikelihoodSearchParams::default()).unwrap();
        let context = ProposalContext::new(&space, Se2::identity(), Par::Seq, Seed(1), 0);
        assert!(search.search(&(), &mut Peaks(2.0), &context) > 1);
        for (x, y, yaw) in PEAKS {
            let nearest = search.found().map(|(pose, _)| pose.minus(&Se2::new(x, y, yaw)).norm()).fold(9.0, f64::min);
            assert!(nearest < 0.05, "{nearest}");
        }
        let mut poses = vec![Se2::identity(); 4000];
        assert_eq!(search.draw(f64::NEG_INFINITY, &context, &mut poses), 4000);
        let near = |(x, y, yaw): (f64, f64, f64)| {
            poses.iter().filter(|pose| pose.minus(&Se2::new(x, y, yaw)).norm() < 0.4).count() as f64
        };
        // A power of 0.2 of two nats; several places around each peak are drawn from, about as many around either.
        let ratio = near(PEAKS[1]) / near(PEAKS[0]);
        assert!((0.3..1.2).contains(&ratio), "{ratio}");
    }

    /// Lenient with a pose that it judges alone, as beam skipping is.
    struct Lenient;

    impl WeighParticles<()> for Lenient {
        fn weigh(&mut self, z: &(), poses: &[Se2], out: &mut [f64], par: Par) -> Result<(), SkipReason> {
            Peaks(2.0).weigh(z, poses, out, par)?;
            if poses.len() == 1 {
                out.fill(0.0);
            }
            Ok(())
        }
    }

    #[test]
    fn the_estimate_is_judged_as_what_was_found_is() {
        let space = space();
        let mut search = LikelihoodSearch::new(LikelihoodSearchParams::default()).unwrap();
        let context = ProposalContext::new(&space, Se2::new(4.0, 4.0, 1.0), Par::Seq, Seed(1), 0);
        search.search(&(), &mut Lenient, &context);
        let least = search.compare(&(), &mut Lenient, &context);
        assert!(least < -50.0, "an estimate two metres off keeps no place out: {least}");
        assert!(search.found().next().unwrap().1 > least);
    }

    #[test]
    fn an_observation_that_weighs_nothing_finds_nothing() {
        let space = space();
        let mut search = LikelihoodSearch::new(LikelihoodSearchParams::default()).unwrap();
        let context = ProposalContext::new(&space, Se2::identity(), Par::Seq, Seed(1), 0);
        assert_eq!(search.search(&(), &mut Peaks(f64::NAN), &context), 0);
        assert_eq!(search.draw(f64::NEG_INFINITY, &context, &mut [Se2::identity(); 5]), 0);
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = LikelihoodSearchParams::default();
        for bad in [
            LikelihoodSearchParams { density: 0.0, ..good },
            LikelihoodSearchParams { density: f64::INFINITY, ..good },
            LikelihoodSearchParams { max_candidates: 0, ..good },
            LikelihoodSearchParams { max_candidates: usize::MAX, ..good },
            LikelihoodSearchParams { refined: 0, ..good },
            LikelihoodSearchParams { trials: usize::MAX, ..good },
            LikelihoodSearchParams { rounds: 31, ..good },
            LikelihoodSearchParams { spread: -1.0, ..good },
            LikelihoodSearchParams { turn: f64::NAN, ..good },
            LikelihoodSearchParams { margin: -1.0, ..good },
            LikelihoodSearchParams { power: 1.5, ..good },
            LikelihoodSearchParams { bins: PoseBins { position: 0.0, ..good.bins }, ..good },
        ] {
            assert!(LikelihoodSearch::new(bad).is_err(), "{bad:?}");
        }
        let least = LikelihoodSearchParams { max_candidates: 1, refined: 1, trials: 0, rounds: 2, ..good };
        let (space, mut search) = (space(), LikelihoodSearch::new(least).unwrap());
        let context = ProposalContext::new(&space, Se2::identity(), Par::Seq, Seed(1), 0);
        assert_eq!(search.search(&(), &mut Peaks(1.0), &context), 1);
    }
}
