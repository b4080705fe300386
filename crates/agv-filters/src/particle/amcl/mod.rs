//! Adaptive Monte Carlo localisation: the ready filter.

mod adaptation;
#[cfg(feature = "serde")]
mod checkpoint;
mod doubts;
mod params;

use super::{
    Clusters, EffectiveSampleSizeBelow, FreeSpace, Hypothesis, ImprovedSwarm, InitialPoses, KldSampling,
    LikelihoodSearch, LikelihoodSearchParams, Mcl, MclDiagnostics, MotionModel, MotionThreshold, ParticleSet,
    PoseProposal, Recovery, ResamplePolicy, Resampler, Systematic, UpdatePolicy, WeighParticles,
};
use adaptation::Adaptation;
use agv_core::{
    Error,
    compute::{Par, Seed},
    geometry::Se2,
    odometry::OdometryIncrement,
    roles::{
        Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, PoseEstimate, StatusMonitor,
        UpdateOutcome,
    },
    sensors::{Observation, SensorId},
};
use doubts::Doubts;

#[cfg(feature = "serde")]
pub use checkpoint::AmclCheckpoint;
pub use params::AmclParams;

/// Adaptive Monte Carlo localisation, as users of `nav2_amcl` know it, built from the parts of [`Mcl`].
///
/// What it adds to that filter:
///
/// - as many particles as the belief needs ([`KldSampling`]), from [`KldParams::max_particles`](super::KldParams) where the
///   vehicle may be anywhere down to some hundred where it is known;
/// - *hypotheses* ([`Clusters`]): the estimate is the best one's mean, followed with hysteresis, and its covariance counts how far
///   the other ones lie;
/// - *recovery*: where observations become less likely than they were, or the estimate does not explain them, part of the next
///   set is drawn elsewhere ([`Recovery`]), by default from poses that explain the scan ([`LikelihoodSearch`]); any
///   [`PoseProposal`] can take its place, [`UniformProposal`](super::UniformProposal) for one.
///
/// A vehicle that was carried away is noticed and found, one that is switched on anywhere
/// ([`PoseBelief::Anywhere`](agv_core::roles::PoseBelief::Anywhere)) is found as well.
///
/// Everything is allocated at construction. An update costs what [`Mcl`]'s does; one that searches costs some milliseconds more.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams};
/// use agv_core::roles::{Correct, Localizer, PoseBelief};
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::particle::*;
///
/// // A corner: walls at x = 2 m and y = 1 m.
/// let mut map = Grid::filled(GridLayout::new(80, 80, 0.05, Se2::new(-2.0, -3.0, 0.0))?, CellState::Free);
/// for i in 0..80 {
///     map.set(Cell::new(79, i), CellState::Occupied);
///     map.set(Cell::new(i, 79), CellState::Occupied);
/// }
/// let field = LikelihoodField::new(&map, LikelihoodFieldParams::default())?;
/// let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
/// let motion = DifferentialOdometryModel::new(OdometryNoise::default())?;
/// let free_space = FreeSpace::new(&map, 0.3)?.largest();
/// let mut amcl = Amcl::new(motion, sensor, free_space, AmclParams::default(), Seed(7))?;
///
/// // Switched on somewhere; ranges to the two walls from the origin, over a quarter turn to the left.
/// amcl.initialize(&PoseBelief::Anywhere)?;
/// let geometry = ScanGeometry { angle_min: 0.01, angle_increment: 0.03, ..Default::default() };
/// let range = |i: i32| { let a = 0.01 + 0.03 * f64::from(i); (1.975 / a.cos()).min(0.975 / a.sin()) as f32 };
/// let scan = LaserScan::new(Stamp::default(), geometry, (0..52).map(range).collect())?;
/// for _ in 0..4 {
///     amcl.request_update();
///     amcl.update(&scan)?;
/// }
/// let best = amcl.hypotheses()[0].pose;
/// assert!(best.mean().translation().norm() < 0.2);
/// assert!(amcl.particles().len() < 5000, "of twenty thousand");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Amcl<M, S, G = LikelihoodSearch, R = Systematic, P = EffectiveSampleSizeBelow, U = MotionThreshold> {
    mcl: Mcl<M, S, R, P, U, KldSampling>,
    adaptation: Adaptation<G>,
    /// Particles of a belief around a pose.
    around: usize,
}

impl<M, S> Amcl<M, S> {
    /// A filter without a belief yet; the vehicle can stand in `free_space`, of the same map that the sensor knows. What cannot
    /// be reached is best left out of it ([`FreeSpace::reached_from`], [`FreeSpace::largest`]).
    ///
    /// # Errors
    /// Parameters that [`validate`](AmclParams::validate) refuses.
    pub fn new(motion: M, sensor: S, free_space: FreeSpace, params: AmclParams, seed: Seed) -> Result<Self, Error> {
        params.validate()?;
        let most = params.kld.max_particles;
        let mcl = Mcl::new(motion, sensor, free_space, params.mcl(), seed)?
            .with_sample_size(KldSampling::new(params.kld)?)?;
        let adaptation = Adaptation {
            proposal: LikelihoodSearch::new(LikelihoodSearchParams::default())?,
            doubts: Doubts::new(params.recovery)?,
            clusters: Clusters::new(params.kld.bins)?.with_capacity(most),
            hysteresis: params.hysteresis,
            bins: params.kld.bins,
            hypotheses: Vec::with_capacity(most),
            fresh: Vec::with_capacity(most),
        };
        Ok(Self { mcl, adaptation, around: params.particles })
    }
}

impl<M, S, G, R, P, U> Amcl<M, S, G, R, P, U> {
    /// The same filter on several threads; the results have the same bits.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.mcl = self.mcl.with_parallelism(par);
        self
    }

    /// The same filter with another source of new particles.
    #[must_use]
    pub fn with_proposal<G2>(self, proposal: G2) -> Amcl<M, S, G2, R, P, U> {
        let Adaptation { doubts, clusters, hysteresis, bins, hypotheses, fresh, .. } = self.adaptation;
        let adaptation = Adaptation { proposal, doubts, clusters, hysteresis, bins, hypotheses, fresh };
        Amcl { mcl: self.mcl, adaptation, around: self.around }
    }

    /// The same filter with another way and another time of resampling.
    #[must_use]
    pub fn with_resampling<R2, P2>(self, resampler: R2, resample: P2) -> Amcl<M, S, G, R2, P2, U> {
        let Self { mcl, adaptation, around } = self;
        Amcl { mcl: mcl.with_resampling(resampler, resample), adaptation, around }
    }

    /// The same filter with another rule for when an observation is taken in.
    #[must_use]
    pub fn with_update_policy<U2>(self, update: U2) -> Amcl<M, S, G, R, P, U2> {
        let Self { mcl, adaptation, around } = self;
        Amcl { mcl: mcl.with_update_policy(update), adaptation, around }
    }

    /// The hypotheses at the last update, by falling weight; one for a belief that is no wider than a bin.
    pub fn hypotheses(&self) -> &[Hypothesis] {
        &self.adaptation.hypotheses
    }

    /// The same, written to a list that keeps its room.
    pub fn hypotheses_into(&self, hypotheses: &mut Vec<Hypothesis>) {
        hypotheses.clear();
        hypotheses.extend_from_slice(&self.adaptation.hypotheses);
    }

    /// How likely a sensor's observations are and were, if there was one: `recovery("laser scan", SensorId::default())`.
    pub fn recovery(&self, kind: &str, sensor: SensorId) -> Option<&Recovery> {
        self.adaptation.doubts.get(kind, sensor)
    }

    /// Where new particles come from.
    pub const fn proposal(&self) -> &G {
        &self.adaptation.proposal
    }

    /// The weighted poses at the last update; the odometry since moves the estimate, not them.
    pub const fn particles(&self) -> &ParticleSet {
        self.mcl.particles()
    }

    /// How the last update went.
    pub const fn diagnostics(&self) -> &MclDiagnostics {
        self.mcl.diagnostics()
    }

    /// The status with what it was derived from.
    pub const fn monitor(&self) -> &StatusMonitor {
        self.mcl.monitor()
    }

    /// The sensor model.
    pub const fn sensor(&self) -> &S {
        self.mcl.sensor()
    }

    /// The motion model.
    pub const fn motion(&self) -> &M {
        self.mcl.motion()
    }

    /// Takes in the next observation of every sensor even if the vehicle has not moved.
    pub fn request_update(&mut self) {
        self.mcl.request_update();
    }
}

impl<M, S, G, R, P, U> Amcl<M, S, G, R, P, U> {
    /// As [`Mcl::initialize_swarm`]; the search goes on where the vehicle may be anywhere.
    ///
    /// # Errors
    /// Those of [`Mcl::initialize_swarm`].
    pub fn initialize_swarm<Z: ?Sized, Q: InitialPoses>(
        &mut self,
        swarm: &ImprovedSwarm<Q>,
        observations: &[&Z],
    ) -> Result<UpdateOutcome, LocalizationError>
    where
        S: WeighParticles<Z>,
    {
        let outcome = self.mcl.initialize_swarm(swarm, observations)?;
        if let Some(estimate) = self.mcl.known_pose() {
            self.adaptation.begin(estimate, self.mcl.particles().len(), swarm.is_anywhere());
        }
        Ok(outcome)
    }
}

impl<M, S, G, R, P, U> Localizer for Amcl<M, S, G, R, P, U>
where
    M: MotionModel<Motion = OdometryIncrement>,
{
    type Pose = Se2;

    /// Draws all particles anew: around a pose, or evenly over free space and heading.
    ///
    /// # Errors
    /// [`LocalizationError::OffMap`] if not one particle lies in the map; a variance above (1000 km)².
    fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        self.mcl.initialize_with(belief, self.around)?;
        if let Some(estimate) = self.mcl.estimate() {
            let says_nothing = matches!(belief, PoseBelief::Anywhere);
            self.adaptation.begin(estimate.pose, self.mcl.particles().len(), says_nothing);
        }
        Ok(())
    }

    fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
        self.mcl.predict(odometry)
    }

    fn estimate(&self) -> Option<PoseEstimate<Se2>> {
        self.mcl.estimate()
    }

    fn status(&self) -> LocalizationStatus {
        self.mcl.status()
    }
}

impl<Z, M, S, G, R, P, U> Correct<Z> for Amcl<M, S, G, R, P, U>
where
    Z: Observation + ?Sized,
    M: MotionModel<Motion = OdometryIncrement>,
    S: WeighParticles<Z>,
    G: PoseProposal<Z, S>,
    R: Resampler,
    P: ResamplePolicy,
    U: UpdatePolicy,
{
    /// As [`Mcl`]'s; draws part of the new set elsewhere where the belief is to be doubted.
    fn update(&mut self, observation: &Z) -> Result<UpdateOutcome, LocalizationError> {
        self.mcl.correct(observation, &mut self.adaptation)
    }
}
