//! The filter and its parts.

use super::{MclDiagnostics, MclParams, TemperingParams, belief::Belief};
use crate::particle::{
    EffectiveSampleSizeBelow, FreeSpace, MotionThreshold, ParticleSet, SameSize, SampleSize, Systematic,
};
use agv_core::{
    Error,
    compute::{Par, Seed},
    geometry::{LieGroup, Se2},
    roles::StatusMonitor,
};

/// Monte Carlo localisation in a known map (Dellaert et al. 1999; Thrun, Burgard and Fox, *Probabilistic Robotics*, Table 8.2).
///
/// Plays [`Localizer`](agv_core::roles::Localizer), and [`Correct<Z>`](agv_core::roles::Correct) for every observation `Z` that
/// its sensor `S` can weigh.
///
/// - *predict* gathers odometry and carries the estimate on; the particles stay. Time stamps are passed on in the estimate but
///   not used, so a log whose clock steps backwards does no harm.
/// - *update* asks whether the vehicle has moved enough since the last observation of the same sensor that was applied (the
///   first one of a sensor after an initialisation always counts). If so, every particle moves by a draw of the motion
///   model `M` for all that was gathered, is weighed, mean and covariance are taken, and the set is resampled if the policy
///   asks for it. The motion is drawn once per applied update, so the noise does not depend on the rate of the scans; where
///   observations tell nothing, once per motion after which one would be taken in.
///   An observation that would leave next to no particle alive is taken in by degrees ([`TemperingParams`]).
///   An observation counts as taken at the end of the last motion, whatever its stamp: predict up to it first.
/// - *estimate* is the mean at the last update, carried on by the odometry since, its covariance grown by the motion model.
/// - *status* follows from the spread of the estimate and the share of the beams that it explains
///   ([`StatusMonitor`]).
///
/// Everything it needs is allocated at construction, but for what a sensor keeps. A call costs O(particles x beams).
///
/// ```
/// use agv_core::compute::{Par, Seed};
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams};
/// use agv_core::nalgebra::{Matrix3, Vector3};
/// use agv_core::roles::{Correct, Localizer, PoseBelief, UpdateOutcome};
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
/// let mut mcl = Mcl::new(motion, sensor, FreeSpace::new(&map, 0.3)?, MclParams::default(), Seed(7))?
///     .with_parallelism(Par::threads(2));
///
/// let covariance = Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.01));
/// mcl.initialize(&PoseBelief::around(Se2::new(0.1, -0.1, 0.05), covariance)?)?;
/// // Ranges to the two walls from the origin, over a quarter turn to the left.
/// let geometry = ScanGeometry { angle_min: 0.01, angle_increment: 0.03, ..Default::default() };
/// let range = |i: i32| { let a = 0.01 + 0.03 * f64::from(i); (1.975 / a.cos()).min(0.975 / a.sin()) as f32 };
/// let scan = LaserScan::new(Stamp::default(), geometry, (0..52).map(range).collect())?;
/// assert!(matches!(mcl.update(&scan)?, UpdateOutcome::Applied(_)));
/// let estimate = mcl.estimate().expect("initialised");
/// assert!(estimate.map_from_base().translation().norm() < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Mcl<M, S, R = Systematic, P = EffectiveSampleSizeBelow, U = MotionThreshold, N = SameSize> {
    pub(super) motion: M,
    pub(super) sensor: S,
    pub(super) rules: Rules<R, P, U, N>,
    pub(super) free_space: FreeSpace,
    pub(super) tempering: TemperingParams,
    pub(super) refine: bool,
    pub(in crate::particle) par: Par,
    pub(super) seed: Seed,
    pub(super) belief: Belief,
    /// Scratch of the weighing, as long as the set's capacity.
    pub(super) log_likelihoods: Vec<f64>,
}

/// The exchangeable decisions.
#[derive(Debug, Clone)]
pub(super) struct Rules<R, P, U, N> {
    pub(super) resampler: R,
    pub(super) resample: P,
    pub(super) update: U,
    pub(super) size: N,
}

/// What a random stream is for; part of its key.
#[derive(Debug, Clone, Copy)]
pub(super) enum Draw {
    Initialization = 0,
    Motion = 1,
    Resampling = 2,
    SampleSize = 3,
    Proposal = 4,
    Tempering = 5,
    TemperingKernel = 6,
}

impl<M, S> Mcl<M, S> {
    /// A filter without a belief yet; the vehicle can stand in `free_space`, of the same map that the sensor knows.
    ///
    /// `sensor` weighs particles: a model of this crate, a model of one's own in a [`PerPose`](crate::particle::PerPose),
    /// or a `Box<dyn WeighParticles<LaserScan> + Send>`.
    ///
    /// # Errors
    /// Parameters that [`validate`](MclParams::validate) refuses.
    pub fn new(motion: M, sensor: S, free_space: FreeSpace, params: MclParams, seed: Seed) -> Result<Self, Error> {
        params.validate()?;
        let particles = ParticleSet::new(vec![Se2::identity(); params.particles])?;
        Ok(Self {
            motion,
            sensor,
            rules: Rules { resampler: Systematic, resample: params.resample, update: params.update, size: SameSize },
            free_space,
            tempering: params.tempering,
            refine: params.refine,
            par: Par::Seq,
            seed,
            belief: Belief::none(particles, StatusMonitor::new(params.status)?),
            log_likelihoods: vec![0.0; params.particles],
        })
    }
}

impl<M, S, R, P, U, N> Mcl<M, S, R, P, U, N> {
    /// The same filter on several threads; the results have the same bits.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// The same filter with another way and another time of resampling.
    #[must_use]
    pub fn with_resampling<R2, P2>(self, resampler: R2, resample: P2) -> Mcl<M, S, R2, P2, U, N> {
        self.with_rules(|rules| Rules { resampler, resample, update: rules.update, size: rules.size })
    }

    /// The same filter with another rule for when an observation is taken in.
    #[must_use]
    pub fn with_update_policy<U2>(self, update: U2) -> Mcl<M, S, R, P, U2, N> {
        self.with_rules(|Rules { resampler, resample, size, .. }| Rules { resampler, resample, update, size })
    }

    /// The same filter with a number of particles that `size` says whenever a set is drawn, and with room for as many.
    ///
    /// # Errors
    /// More than [`ParticleSet::MAX_PARTICLES`] at most.
    pub fn with_sample_size<N2: SampleSize>(self, size: N2) -> Result<Mcl<M, S, R, P, U, N2>, Error> {
        let most = size.most();
        let mut filter =
            self.with_rules(|Rules { resampler, resample, update, .. }| Rules { resampler, resample, update, size });
        filter.belief.particles = filter.belief.particles.with_capacity(most.unwrap_or(1))?;
        filter.log_likelihoods.resize(filter.belief.particles.capacity(), 0.0);
        Ok(filter)
    }

    fn with_rules<R2, P2, U2, N2>(
        self,
        change: impl FnOnce(Rules<R, P, U, N>) -> Rules<R2, P2, U2, N2>,
    ) -> Mcl<M, S, R2, P2, U2, N2> {
        let Self { motion, sensor, rules, free_space, tempering, refine, par, seed, belief, log_likelihoods } = self;
        Mcl { motion, sensor, rules: change(rules), free_space, tempering, refine, par, seed, belief, log_likelihoods }
    }

    /// The weighted poses at the last update; the odometry since moves the estimate, not them.
    pub const fn particles(&self) -> &ParticleSet {
        &self.belief.particles
    }

    /// How the last update went.
    pub const fn diagnostics(&self) -> &MclDiagnostics {
        &self.belief.diagnostics
    }

    /// The status with what it was derived from.
    pub const fn monitor(&self) -> &StatusMonitor {
        &self.belief.monitor
    }

    /// The sensor model.
    pub const fn sensor(&self) -> &S {
        &self.sensor
    }

    /// The motion model.
    pub const fn motion(&self) -> &M {
        &self.motion
    }

    /// Takes in the next observation of every sensor even if the vehicle has not moved: for a vehicle that stands and is to
    /// be sure.
    pub fn request_update(&mut self) {
        self.belief.applied.clear();
    }

    /// The seed of a kind of draw.
    pub(super) fn seed_for(&self, draw: Draw) -> Seed {
        self.seed.derive(draw as u64)
    }
}
