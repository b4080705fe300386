//! Where new particles come from, when they do not come from the old ones.

mod advance;
mod markers;
mod params;
mod search;
mod state;

use super::{FreeSpace, draw::draw_chunk, gaussian::PoseGaussian};
use agv_core::{
    Error, check,
    compute::{CHUNK, Par, Seed, Stream},
    geometry::{LieGroup, Se2, UncertainPose},
    sensors::PoseObservation,
};

pub use markers::MarkerProposal;
pub use params::LikelihoodSearchParams;
pub use search::LikelihoodSearch;
use state::Place;
pub use state::SearchState;

/// What a [`PoseProposal`] may use beside the observation and the sensor's model.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct ProposalContext<'a> {
    /// Where the vehicle can stand.
    pub free_space: &'a FreeSpace,
    /// Where the vehicle is taken to be.
    pub estimate: Se2,
    /// Particles of the set: what the update spends anyway.
    pub particles: usize,
    /// Whether the belief is narrow: the vehicle is tracked, if it is where it is taken to be.
    pub is_narrow: bool,
    /// Tells the belief that was given last from those before: after each initialisation another number.
    pub belief: u64,
    /// Updates applied before this one since the belief was given.
    pub updates: u64,
    /// The base in the frame that the odometry is summed up in: what the vehicle has moved since an earlier call.
    pub odom_from_base: Se2,
    /// How its loops run.
    pub par: Par,
    seed: Seed,
    step: u64,
}

impl<'a> ProposalContext<'a> {
    /// Draws from the streams of (`seed`, `step`), which nothing else may draw from; the first update of a belief that says nothing.
    pub fn new(free_space: &'a FreeSpace, estimate: Se2, par: Par, seed: Seed, step: u64) -> Self {
        let odom_from_base = Se2::identity();
        Self {
            free_space,
            estimate,
            particles: 0,
            is_narrow: false,
            belief: 0,
            updates: 0,
            odom_from_base,
            par,
            seed,
            step,
        }
    }

    /// The same in another belief.
    #[must_use]
    pub const fn in_belief(self, belief: u64) -> Self {
        Self { belief, ..self }
    }

    /// The same after so many updates, with the odometry summed up.
    #[must_use]
    pub const fn after(self, updates: u64, odom_from_base: Se2) -> Self {
        Self { updates, odom_from_base, ..self }
    }

    /// The same for a set of so many particles.
    #[must_use]
    pub const fn of_particles(self, particles: usize, is_narrow: bool) -> Self {
        Self { particles, is_narrow, ..self }
    }

    /// The random stream of a chunk, for one `part` of the work.
    pub fn stream(&self, part: u64, chunk: usize) -> Stream {
        self.seed.derive(part).stream(self.step, chunk as u64)
    }

    /// Writes each pose with `draw(index, stream)`, in chunks with streams of their own.
    pub fn fill(&self, part: u64, poses: &mut [Se2], draw: impl Fn(usize, &mut Stream) -> Se2 + Sync) {
        self.par.for_each_chunk(poses, CHUNK, |chunk, poses: &mut [Se2]| {
            draw_chunk(chunk, poses, self.stream(part, chunk), &draw);
        });
    }
}

/// Proposes poses where the vehicle may be, given an observation: asked by [`Amcl`](super::Amcl) for the particles that it
/// does not draw from the old ones.
///
/// `S` is the sensor's model, which may weigh what is to be proposed.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_filters::particle::{PoseProposal, ProposalContext};
///
/// /// Vehicles are switched on at a charger.
/// struct Charger(Se2);
/// impl<Z: ?Sized, S> PoseProposal<Z, S> for Charger {
///     fn propose(&mut self, _: &Z, _: &mut S, _: &ProposalContext<'_>, poses: &mut [Se2]) -> usize {
///         poses.fill(self.0);
///         poses.len()
///     }
/// }
/// ```
pub trait PoseProposal<Z: ?Sized, S: ?Sized> {
    /// Writes poses to the front of `poses`, and returns how many: as many as there is room for, or fewer where the
    /// observation does not give them.
    fn propose(&mut self, observation: &Z, sensor: &mut S, context: &ProposalContext<'_>, poses: &mut [Se2]) -> usize;

    /// The share of the next set that is to be proposed, where the belief was `expected` before the observation and
    /// [`Recovery`](super::Recovery) asks for `doubted`: that, unless the observation tells more.
    fn share(&self, observation: &Z, expected: &UncertainPose<Se2>, doubted: f64) -> f64 {
        let _ = (observation, expected);
        doubted
    }
}

/// What a proposal remembers from update to update, for checkpoints: by default nothing.
///
/// An [`Amcl`](super::Amcl) whose proposal is of this kind can be stored and resumed.
///
/// ```
/// use agv_filters::particle::ResumableProposal;
///
/// struct Charger;
/// impl ResumableProposal for Charger {}
/// assert!(Charger.state().is_none());
/// ```
pub trait ResumableProposal {
    /// What is to be stored.
    fn state(&self) -> Option<SearchState> {
        None
    }

    /// Takes what was stored; none is a search that has not begun.
    fn resume(&mut self, state: Option<&SearchState>) {
        let _ = state;
    }
}

impl ResumableProposal for UniformProposal {}

impl ResumableProposal for ObservedPose {}

/// Proposes any pose in free space, with equal density: Augmented MCL as it is in the textbook and in `nav2_amcl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct UniformProposal;

impl<Z: ?Sized, S: ?Sized> PoseProposal<Z, S> for UniformProposal {
    fn propose(&mut self, _: &Z, _: &mut S, context: &ProposalContext<'_>, poses: &mut [Se2]) -> usize {
        context.fill(0, poses, |_, stream| context.free_space.sample(stream));
        poses.len()
    }
}

/// Draws poses from what a pose observation says itself: a code on the floor, a beacon, another localizer.
///
/// Such an observation brings part of the particles in any case, since few old ones are as near to it as it is exact; and most
/// of them if it contradicts the belief, at 99.9 % of chi-square.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "(f64, f64)", into = "(f64, f64)")
)]
pub struct ObservedPose {
    agreed: f64,
    contradicted: f64,
}

impl ObservedPose {
    /// Draws a share `agreed` of the particles from an observation that agrees with the belief, and `contradicted` from one that
    /// contradicts it.
    ///
    /// # Errors
    /// A share outside [0, 1].
    pub fn new(agreed: f64, contradicted: f64) -> Result<Self, Error> {
        check::in_range("agreed", agreed, 0.0, 1.0)?;
        check::in_range("contradicted", contradicted, 0.0, 1.0)?;
        Ok(Self { agreed, contradicted })
    }
}

impl TryFrom<(f64, f64)> for ObservedPose {
    type Error = Error;

    fn try_from((agreed, contradicted): (f64, f64)) -> Result<Self, Error> {
        Self::new(agreed, contradicted)
    }
}

impl From<ObservedPose> for (f64, f64) {
    fn from(shares: ObservedPose) -> Self {
        (shares.agreed, shares.contradicted)
    }
}

impl Default for ObservedPose {
    /// 0.3 and 0.9: a code that was misread leaves one particle in ten where it was, and the next scan decides.
    fn default() -> Self {
        Self { agreed: 0.3, contradicted: 0.9 }
    }
}

impl<S: ?Sized> PoseProposal<PoseObservation<Se2>, S> for ObservedPose {
    fn propose(
        &mut self,
        observation: &PoseObservation<Se2>,
        _: &mut S,
        context: &ProposalContext<'_>,
        poses: &mut [Se2],
    ) -> usize {
        let gaussian = PoseGaussian::new(&observation.map_from_base());
        context.fill(0, poses, |_, stream| gaussian.sample(stream));
        poses.len()
    }

    fn share(&self, observation: &PoseObservation<Se2>, expected: &UncertainPose<Se2>, _: f64) -> f64 {
        /// The 99.9 % quantile of chi-square with three degrees of freedom.
        const GATE: f64 = 16.27;
        let difference = expected.between(&observation.map_from_base());
        let residual = difference.mean().log();
        let distance = difference.covariance().cholesky().map(|root| residual.dot(&root.solve(&residual)));
        if distance.is_some_and(|distance| distance <= GATE) { self.agreed } else { self.contradicted }
    }
}
