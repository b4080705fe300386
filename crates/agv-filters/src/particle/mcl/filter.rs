//! The filter's state and the cycle.

use crate::particle::{
    EffectiveSampleSizeBelow, FreeSpace, MotionModel, MotionThreshold, ParticleSet, ResamplePolicy, Resampler,
    Systematic, UpdatePolicy, WeighParticles, WeightSummary,
};
use agv_core::{
    Error,
    compute::{Par, Seed},
    geometry::{LieGroup, Se2},
    odometry::OdometryIncrement,
    roles::{PoseEstimate, SkipReason, UpdateOutcome, UpdateReport},
    sensors::Observation,
    time::Stamp,
};

/// Parameters of an [`Mcl`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MclParams {
    /// Number of particles.
    pub particles: usize,
    /// When a scan is taken in.
    pub update: MotionThreshold,
    /// When a new set is drawn.
    pub resample: EffectiveSampleSizeBelow,
}

impl Default for MclParams {
    /// 2000 particles, `nav2_amcl`'s upper limit; updates each 0.2 m or 0.2 rad; resampling below half the effective
    /// sample size.
    fn default() -> Self {
        Self { particles: 2000, update: MotionThreshold::default(), resample: EffectiveSampleSizeBelow::default() }
    }
}

impl MclParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// Zero or more than [`ParticleSet::MAX_PARTICLES`] particles, or a policy out of range.
    pub fn validate(&self) -> Result<(), Error> {
        ParticleSet::check_count(self.particles)?;
        self.update.validate()?;
        self.resample.validate()
    }
}

/// How the last update went.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MclDiagnostics {
    /// The weights after the last update, before resampling.
    pub weights: WeightSummary,
    /// Whether the set was resampled then.
    pub resampled: bool,
    /// Updates applied since the belief was initialised.
    pub updates: u64,
}

/// Monte Carlo localisation in a known map (Dellaert et al. 1999; Thrun, Burgard and Fox, *Probabilistic Robotics*, Table 8.2).
///
/// Plays [`Localizer`](agv_core::roles::Localizer), and [`Correct<Z>`](agv_core::roles::Correct) for every observation `Z` that
/// its sensor `S` can weigh.
///
/// - *predict* gathers odometry; once it calls for an update, every particle moves by a draw of the motion model `M`. Time
///   stamps are passed on in the estimate but not used, so a log whose clock steps backwards does no harm.
/// - *update* weighs the particles if the vehicle has moved enough (the first observation after an initialisation always
///   counts), takes mean and covariance, and resamples if the policy asks for it.
///   An observation counts as taken at the end of the last motion, whatever its stamp: predict up to it first.
/// - *estimate* is the mean at the last update, carried on by the odometry since.
///
/// Everything it needs is allocated by [`new`](Self::new), but for what a sensor keeps. A call costs O(particles x beams).
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
/// let mut mcl = Mcl::new(motion, sensor, FreeSpace::new(&map)?, MclParams::default(), Seed(7))?
///     .with_parallelism(Par::threads(2));
///
/// let covariance = Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.01));
/// mcl.initialize(&PoseBelief::around(Se2::new(0.1, -0.1, 0.05), covariance))?;
/// // Ranges to the two walls from the origin, over a quarter turn to the left.
/// let geometry = ScanGeometry { angle_min: 0.01, angle_increment: 0.03, ..Default::default() };
/// let range = |i: i32| { let a = 0.01 + 0.03 * f64::from(i); (1.975 / a.cos()).min(0.975 / a.sin()) as f32 };
/// let scan = LaserScan::new(Stamp::default(), geometry, (0..52).map(range).collect())?;
/// assert!(matches!(mcl.update(&scan)?, UpdateOutcome::Applied(_)));
/// assert!(mcl.estimate().map_from_base.translation().norm() < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Mcl<M, S, R = Systematic, P = EffectiveSampleSizeBelow, U = MotionThreshold> {
    pub(super) motion: M,
    pub(super) sensor: S,
    pub(super) resampler: R,
    pub(super) resample_policy: P,
    pub(super) update_policy: U,
    pub(super) free_space: FreeSpace,
    pub(super) par: Par,
    pub(super) seed: Seed,
    pub(super) belief: Belief,
    /// Scratch of the weighing.
    pub(super) log_likelihoods: Vec<f64>,
}

/// All of the filter that changes as it runs.
#[derive(Debug, Clone)]
pub(super) struct Belief {
    pub(super) particles: ParticleSet,
    pub(super) initialized: bool,
    /// Counts the random draws of the whole set, so that none uses a stream twice.
    pub(super) step: u64,
    /// Odometry that the particles have not followed yet.
    pub(super) pending: Option<OdometryIncrement>,
    /// The time that the belief refers to.
    pub(super) stamp: Option<Stamp>,
    /// Whether the next observation is taken in.
    pub(super) due: bool,
    /// Moments of the particles; none once they have moved.
    pub(super) moments: Option<PoseEstimate<Se2>>,
    pub(super) diagnostics: MclDiagnostics,
}

/// What a random stream is for; part of its key.
#[derive(Debug, Clone, Copy)]
pub(super) enum Draw {
    Initialization = 0,
    Motion = 1,
    Resampling = 2,
}

impl<M, S> Mcl<M, S> {
    /// A filter without a belief yet; the vehicle can stand in `free_space`, of the same map that the sensor knows.
    ///
    /// # Errors
    /// Parameters that [`validate`](MclParams::validate) refuses.
    pub fn new(motion: M, sensor: S, free_space: FreeSpace, params: MclParams, seed: Seed) -> Result<Self, Error> {
        params.validate()?;
        let particles = ParticleSet::new(vec![Se2::identity(); params.particles])?;
        let diagnostics =
            MclDiagnostics { weights: WeightSummary::uniform(params.particles), resampled: false, updates: 0 };
        Ok(Self {
            motion,
            sensor,
            resampler: Systematic,
            resample_policy: params.resample,
            update_policy: params.update,
            free_space,
            par: Par::Seq,
            seed,
            log_likelihoods: vec![0.0; params.particles],
            belief: Belief {
                particles,
                initialized: false,
                step: 0,
                pending: None,
                stamp: None,
                due: false,
                moments: None,
                diagnostics,
            },
        })
    }
}

impl<M, S, R, P, U> Mcl<M, S, R, P, U> {
    /// The same filter on several threads; the results have the same bits.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// The same filter with another way and another time of resampling.
    #[must_use]
    pub fn with_resampling<R2, P2>(self, resampler: R2, resample_policy: P2) -> Mcl<M, S, R2, P2, U> {
        let Self { motion, sensor, update_policy, free_space, par, seed, belief, log_likelihoods, .. } = self;
        Mcl {
            motion,
            sensor,
            resampler,
            resample_policy,
            update_policy,
            free_space,
            par,
            seed,
            belief,
            log_likelihoods,
        }
    }

    /// The same filter with another rule for when an observation is taken in.
    #[must_use]
    pub fn with_update_policy<U2>(self, update_policy: U2) -> Mcl<M, S, R, P, U2> {
        let Self { motion, sensor, resampler, resample_policy, free_space, par, seed, belief, log_likelihoods, .. } =
            self;
        Mcl {
            motion,
            sensor,
            resampler,
            resample_policy,
            update_policy,
            free_space,
            par,
            seed,
            belief,
            log_likelihoods,
        }
    }

    /// The weighted poses.
    pub const fn particles(&self) -> &ParticleSet {
        &self.belief.particles
    }

    /// How the last update went.
    pub const fn diagnostics(&self) -> &MclDiagnostics {
        &self.belief.diagnostics
    }

    /// The sensor model.
    pub const fn sensor(&self) -> &S {
        &self.sensor
    }

    /// The motion model.
    pub const fn motion(&self) -> &M {
        &self.motion
    }

    /// Takes in the next observation even if the vehicle has not moved: for a vehicle that stands and is to be sure.
    pub fn request_update(&mut self) {
        self.belief.due = self.belief.initialized;
    }

    /// The seed of a kind of draw.
    pub(super) fn seed_for(&self, draw: Draw) -> Seed {
        self.seed.derive(draw as u64)
    }
}

impl<M, S, R, P, U> Mcl<M, S, R, P, U>
where
    M: MotionModel<Motion = OdometryIncrement>,
{
    /// Moves every particle by a draw of the pending motion.
    pub(super) fn propagate(&mut self) {
        if self.draw_motion() {
            self.adopt_motion();
        }
    }

    /// Writes where a draw of the pending motion takes the particles to their spare poses; false if none is pending.
    fn draw_motion(&mut self) -> bool {
        let seed = self.seed_for(Draw::Motion);
        let Some(motion) = &self.belief.pending else { return false };
        let step = self.belief.step;
        let sample = self.motion.condition(motion);
        self.belief.particles.fill_spare(self.par, |chunk, poses, moved| {
            let mut stream = seed.stream(step, chunk as u64);
            for (moved, pose) in moved.iter_mut().zip(poses) {
                *moved = sample(pose, &mut stream);
            }
        });
        true
    }

    /// Makes the spare poses that [`draw_motion`](Self::draw_motion) wrote the particles'.
    fn adopt_motion(&mut self) {
        self.belief.particles.adopt_spare();
        self.belief.pending = None;
        self.belief.step += 1;
        self.belief.moments = None;
    }

    /// Weighs, takes the moments and resamples; the belief is as it was if the observation is skipped.
    pub(super) fn correct<Z: Observation + ?Sized>(&mut self, observation: &Z) -> UpdateOutcome
    where
        S: WeighParticles<Z>,
        R: Resampler,
        P: ResamplePolicy,
        U: UpdatePolicy,
    {
        if !self.belief.due {
            return UpdateOutcome::Skipped(SkipReason::LittleMotion);
        }
        let moved = self.draw_motion();
        let particles = &mut self.belief.particles;
        let poses = if moved { particles.spare() } else { particles.poses() };
        if let Err(reason) = self.sensor.weigh(observation, poses, &mut self.log_likelihoods, self.par) {
            return UpdateOutcome::Skipped(reason);
        }
        let Some(weights) = particles.reweigh(&self.log_likelihoods, self.par) else {
            return UpdateOutcome::Skipped(SkipReason::Unexplained);
        };
        if moved {
            self.adopt_motion();
        }
        let seed = self.seed_for(Draw::Resampling);
        let Belief { particles, step, stamp, due, moments, diagnostics, .. } = &mut self.belief;
        // Before resampling, which adds variance and no knowledge.
        *moments = Some(particles.estimate(self.par));
        let resampled = self.resample_policy.is_due(&weights, particles.len());
        if resampled {
            particles.resample(&self.resampler, &mut seed.stream(*step, 0), self.par);
            *step += 1;
        }
        *diagnostics = MclDiagnostics { weights, resampled, updates: diagnostics.updates + 1 };
        *due = false;
        *stamp = stamp.or_else(|| observation.stamp());
        UpdateOutcome::Applied(UpdateReport::default())
    }
}
