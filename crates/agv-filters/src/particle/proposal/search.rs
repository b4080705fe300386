//! Search for poses that explain a scan, from coarse to fine.
//!
//! Candidates are spread over free space and heading, stratified so that none stays empty, and weighed by the scan in one
//! batch. The best of each bin are kept, and refined by trying poses around them, nearer and nearer. From what is found,
//! poses are drawn in proportion to a power of their likelihood: one scan cannot tell like places from each other, so that
//! all of them are to be proposed, and later scans choose. (Lenser and Veloso 2000 draw from the sensor's model for the same
//! purpose; Thrun, Fox, Burgard and Dellaert 2001 call it the dual of the particle filter.)

use super::{ObservedPose, PoseProposal, ProposalContext};
use crate::particle::{PoseBins, PoseHistogram, WeighParticles};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainPose},
    sensors::{LaserScan, PoseObservation},
};
use nalgebra::Vector3;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// Parameters of a [`LikelihoodSearch`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LikelihoodSearchParams {
    /// Candidates per square metre of free space.
    pub density: f64,
    /// Most candidates of a search.
    pub max_candidates: usize,
    /// Bins of which one candidate each is refined.
    pub bins: PoseBins,
    /// Most candidates that are refined.
    pub refined: usize,
    /// Rounds of refinement.
    pub rounds: u32,
    /// Poses that are tried around each in a round.
    pub trials: usize,
    /// Standard deviation of the first round's trials, in metres; it halves from round to round.
    pub spread: f64,
    /// The same of the heading, in radians.
    pub turn: f64,
    /// Power of the likelihood that poses are drawn in proportion to, in [0, 1].
    pub power: f64,
}

impl Default for LikelihoodSearchParams {
    /// A candidate each 0.5 m and 10°, 144 per square metre, of which at most 50 000 are tried at once: 60 beams of them
    /// take some milliseconds, and a search that misses is repeated with the next scan. 100 are refined, to 3 cm and 1°.
    fn default() -> Self {
        Self {
            density: 144.0,
            max_candidates: 50_000,
            bins: PoseBins::default(),
            refined: 100,
            rounds: 4,
            trials: 12,
            spread: 0.2,
            turn: 0.1,
            power: 0.2,
        }
    }
}

impl LikelihoodSearchParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// A density, spread or turn that is not finite and positive; no candidates, or more than 16 million of them, of refined
    /// ones or of trials; more than 30 rounds; a power outside [0, 1].
    pub fn validate(&self) -> Result<(), Error> {
        const MOST: f64 = 16e6;
        check::positive("search density", self.density)?;
        check::in_range("max_candidates", self.max_candidates as f64, 1.0, MOST)?;
        check::in_range("refined", self.refined as f64, 1.0, MOST)?;
        check::in_range("trials", self.refined as f64 * self.trials as f64, 0.0, MOST)?;
        check::in_range("rounds", f64::from(self.rounds), 0.0, 30.0)?;
        check::positive("search spread", self.spread)?;
        check::positive("search turn", self.turn)?;
        check::in_range("search power", self.power, 0.0, 1.0)?;
        self.bins.validate()
    }
}

/// Proposes poses that explain the scan; pose observations are drawn from as they are.
///
/// O(candidates x beams); all memory is allocated at construction.
#[derive(Debug, Clone)]
pub struct LikelihoodSearch {
    params: LikelihoodSearchParams,
    candidates: Vec<Se2>,
    log_likelihoods: Vec<f64>,
    order: Vec<u32>,
    histogram: PoseHistogram,
    found: Vec<Found>,
    cumulative: Vec<f64>,
}

/// A pose with its log-likelihood.
#[derive(Debug, Clone, Copy)]
struct Found {
    pose: Se2,
    log_likelihood: f64,
}

impl LikelihoodSearch {
    /// Checks the parameters and allocates.
    ///
    /// # Errors
    /// Parameters that [`validate`](LikelihoodSearchParams::validate) refuses.
    pub fn new(params: LikelihoodSearchParams) -> Result<Self, Error> {
        params.validate()?;
        let most = params.max_candidates.max(params.refined * params.trials);
        Ok(Self {
            params,
            candidates: Vec::with_capacity(most),
            log_likelihoods: Vec::with_capacity(most),
            order: Vec::with_capacity(most),
            histogram: PoseHistogram::new(params.bins)?.with_capacity(params.refined),
            found: Vec::with_capacity(params.refined),
            cumulative: Vec::with_capacity(params.refined),
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

    /// Searches all free space; returns how many places were found, none if the observation weighs nothing.
    pub fn search<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) -> usize {
        self.found.clear();
        let space = context.free_space;
        let count = ((space.area() * self.params.density) as usize).clamp(1, self.params.max_candidates);
        self.candidates.clear();
        self.candidates.resize(count, Se2::identity());
        context.fill(1, &mut self.candidates, |index, stream| space.sample_stratum(index, count, stream));
        if self.weigh(observation, sensor, context) {
            self.keep_best();
            for round in 0..self.params.rounds {
                self.refine(round, observation, sensor, context);
            }
            self.found.sort_unstable_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
        }
        self.found.len()
    }

    /// Weighs the candidates; whether it could be done.
    fn weigh<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) -> bool {
        self.log_likelihoods.clear();
        self.log_likelihoods.resize(self.candidates.len(), f64::NEG_INFINITY);
        sensor.weigh(observation, &self.candidates, &mut self.log_likelihoods, context.par).is_ok()
    }

    /// The best candidate of each bin, of the best bins among the best candidates.
    fn keep_best(&mut self) {
        let logs = &self.log_likelihoods;
        let by_likelihood = |a: &u32, b: &u32| logs[*b as usize].total_cmp(&logs[*a as usize]).then(a.cmp(b));
        self.order.clear();
        self.order.extend(0..self.candidates.len() as u32);
        // Several candidates share a bin near a good pose: look at more of them than are kept.
        let looked_at = (8 * self.params.refined).min(self.order.len());
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
                self.found.push(Found { pose, log_likelihood });
            }
            if self.found.len() == self.params.refined || self.histogram.len() == self.params.refined {
                break;
            }
        }
    }

    /// Tries poses around each that was found, and moves it to the best.
    fn refine<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        round: u32,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) {
        let (trials, found) = (self.params.trials, &self.found);
        let scale = self.scale(round);
        self.candidates.clear();
        self.candidates.resize(found.len() * trials, Se2::identity());
        context.fill(2 + u64::from(round), &mut self.candidates, |index, stream| {
            found[index / trials].pose.plus(&scale.map(|sigma| {
                let z: f64 = StandardNormal.sample(stream);
                sigma * z
            }))
        });
        if !self.weigh(observation, sensor, context) || trials == 0 {
            return;
        }
        let tried = self.candidates.chunks(trials).zip(self.log_likelihoods.chunks(trials));
        for (found, (poses, logs)) in self.found.iter_mut().zip(tried) {
            for (&pose, &log_likelihood) in poses.iter().zip(logs) {
                if log_likelihood > found.log_likelihood {
                    *found = Found { pose, log_likelihood };
                }
            }
        }
    }

    /// Standard deviations of a round's trials.
    fn scale(&self, round: u32) -> Vector3<f64> {
        let LikelihoodSearchParams { spread, turn, .. } = self.params;
        Vector3::new(spread, spread, turn) * 0.5_f64.powi(round as i32)
    }

    /// Draws poses from what was found, with the spread that the last round left.
    fn draw(&mut self, context: &ProposalContext<'_>, poses: &mut [Se2]) -> usize {
        let Some(best) = self.found.first().map(|found| found.log_likelihood) else { return 0 };
        let (power, mut total) = (self.params.power, 0.0);
        self.cumulative.clear();
        self.cumulative.extend(self.found.iter().map(|found| {
            total += (power * (found.log_likelihood - best)).exp();
            total
        }));
        let (found, cumulative, scale) = (&self.found, &self.cumulative, self.scale(self.params.rounds));
        context.fill(0, poses, |_, stream| {
            let at = stream.random::<f64>() * total;
            let index = cumulative.partition_point(|&sum| sum <= at).min(found.len() - 1);
            found[index].pose.plus(&scale.map(|sigma| {
                let z: f64 = StandardNormal.sample(stream);
                sigma * z
            }))
        });
        poses.len()
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
        self.search(observation, sensor, context);
        self.draw(context, poses)
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
