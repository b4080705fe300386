//! The filter: its particles, and where they come from.

mod update;

use super::{
    beams::Beams, insert::Scratch, map::TileMap, params::RbpfParams, proposal::Proposed, scan_odometry::ScanOdometry,
    trajectory::TrajectoryTree,
};
use crate::particle::{ParticleSet, WeightSummary};
use agv_core::{
    Error, check,
    compute::{Par, Seed},
    geometry::{LieGroup, Se2},
    grid::InverseModel,
    odometry::OdometryIncrement,
    roles::SkipReason,
    time::Stamp,
};
use update::Moved;

/// A Rao-Blackwellised particle filter: simultaneous localisation and mapping. See the [module](super).
///
/// [`predict`](Self::predict) takes what the odometry says, as often as it says something; [`update`](Self::update) takes scans, of
/// which those are taken in before which the vehicle has moved. Without odometry the scans alone do, if
/// [`RbpfParams::scan_odometry`] is there and scans come often enough for its window: from the start, or from the eighth scan on that
/// comes without any, from where the vehicle is then expected; until odometry comes again.
///
/// A call that returns an error has changed nothing. Stamps are kept for the trajectory and used for nothing else, so that clocks may
/// jump.
///
/// ```
/// use agv_core::{compute::Seed, geometry::Se2, odometry::OdometryIncrement, sensors::{LaserScan, ScanGeometry}, time::Stamp};
/// use agv_filters::{particle::{DifferentialOdometryModel, OdometryNoise}, slam::{Rbpf, RbpfParams}};
///
/// // A room of 8 m by 6 m, seen from along its middle.
/// let geometry = ScanGeometry { angle_min: -3.0, angle_increment: 0.02, ..Default::default() };
/// let seen_from = |t: f64, x: f64| {
///     let range = |a: f64| (((4.0_f64).copysign(a.cos()) - x) / a.cos()).min(3.0 / a.sin().abs()) as f32;
///     LaserScan::new(Stamp::from_seconds(t), geometry, (0..300).map(|i| range(geometry.angle(i))).collect())
/// };
/// let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.02))?;
/// let mut slam = Rbpf::new(motion, RbpfParams { particles: 5, ..Default::default() }, Seed(7))?;
/// slam.update(&seen_from(0.0, 0.0)?)?;
/// for i in 1..4 {
///     let (then, now) = (f64::from(i - 1), f64::from(i));
///     // The wheels slip: they say 0.45 m where it is 0.5 m.
///     let wheels = Se2::new(0.45, 0.0, 0.0);
///     slam.predict(&OdometryIncrement::between(Stamp::from_seconds(then), &Se2::default(), Stamp::from_seconds(now), &wheels)?)?;
///     slam.update(&seen_from(now, 0.5 * now)?)?;
/// }
/// assert!((slam.map_from_base().x() - 1.5).abs() < 0.03);
/// let map = slam.best_map().states(&Default::default())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Rbpf<M> {
    pub(super) motion: M,
    pub(super) params: RbpfParams,
    model: InverseModel,
    pub(super) seed: Seed,
    pub(super) par: Par,
    pub(super) belief: Belief,
    pub(super) scan_odometry: Option<ScanOdometry>,
    beams: Beams,
    proposed: Vec<Proposed>,
    log_weights: Vec<f64>,
    pub(super) scratch: Vec<Scratch>,
    /// Where a new set is put together; empty between.
    spare: (Vec<TileMap>, Vec<f64>),
}

/// Scans without odometry from which on there is none.
const PATIENCE: u32 = 8;

/// All that changes as the filter runs.
#[derive(Debug, Clone)]
pub(super) struct Belief {
    /// The base in the map when the first scan was taken.
    pub(super) start: Se2,
    pub(super) particles: ParticleSet,
    pub(super) maps: Vec<TileMap>,
    pub(super) tree: TrajectoryTree,
    /// Sums of the logarithms of the particles' weights, over their whole trajectories.
    pub(super) scores: Vec<f64>,
    /// What the last scan that was taken in made of the weights.
    pub(super) weights: WeightSummary,
    /// The motion since the last scan that was taken in, by the odometry, and by the scans where there was none.
    pub(super) pending: Option<OdometryIncrement>,
    /// Scans since the last odometry.
    pub(super) scans_without: u32,
    /// The motion since the last scan that was taken in to the last scan, and that between the last two scans.
    pub(super) walked: Se2,
    pub(super) drift: Se2,
    /// The motion before each scan that was taken in, by the odometry.
    pub(super) steps: Vec<Se2>,
    /// All scans.
    pub(super) seen: Vec<Seen>,
    pub(super) since_resampling: u64,
}

/// A scan, taken in or not.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Seen {
    pub(super) stamp: Stamp,
    /// Number of the scan before it, or itself, that was taken in.
    pub(super) step: u32,
    /// The motion since that one, by the odometry.
    pub(super) since: Se2,
}

/// What became of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RbpfUpdate {
    /// Why the scan was not taken in; none if it was.
    pub skipped: Option<SkipReason>,
    /// The weights after it, before a new set was drawn; those that are if it was not taken in.
    pub weights: WeightSummary,
    /// Whether a new set was drawn.
    pub resampled: bool,
    /// Particles that the scan placed; the others went where the motion model drew them. None if it was not taken in.
    pub matched: usize,
    /// Mean share of the matched beams that met the particles' maps; zero if it was not taken in.
    pub explained: f64,
}

impl<M> Rbpf<M> {
    /// A filter without a map, whose frame the base is at the origin of when the first scan comes.
    ///
    /// # Errors
    /// As [`RbpfParams::validate`].
    pub fn new(motion: M, params: RbpfParams, seed: Seed) -> Result<Self, Error> {
        params.validate()?;
        let scan_odometry = params.scan_odometry.map(ScanOdometry::new).transpose()?;
        Ok(Self {
            motion,
            model: params.inverse_model()?,
            belief: Belief::new(Se2::identity(), &params)?,
            params,
            seed,
            par: Par::Seq,
            scan_odometry,
            beams: Beams::default(),
            proposed: vec![Proposed::default(); params.particles],
            log_weights: vec![0.0; params.particles],
            scratch: vec![Scratch::default(); params.particles],
            spare: (Vec::with_capacity(params.particles), Vec::with_capacity(params.particles)),
        })
    }

    /// The same filter on several threads, with the same bits out.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// Its parameters.
    pub const fn params(&self) -> &RbpfParams {
        &self.params
    }

    /// Begins anew: without a map, and with the base at `map_from_base` when the next scan comes.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for the pose.
    pub fn reset(&mut self, map_from_base: Se2) -> Result<(), Error> {
        check::all_finite("map_from_base", &[map_from_base.x(), map_from_base.y(), map_from_base.yaw()])?;
        self.belief = Belief::new(map_from_base, &self.params)?;
        self.scan_odometry.iter_mut().for_each(ScanOdometry::clear);
        Ok(())
    }
}

impl Belief {
    pub(super) fn new(start: Se2, params: &RbpfParams) -> Result<Self, Error> {
        let count = params.particles;
        Ok(Self {
            start,
            particles: ParticleSet::new(vec![start; count])?,
            maps: vec![TileMap::new(params.resolution); count],
            tree: TrajectoryTree::default(),
            scores: vec![0.0; count],
            weights: WeightSummary::uniform(count),
            pending: None,
            scans_without: u32::MAX,
            walked: Se2::identity(),
            drift: Se2::identity(),
            steps: Vec::new(),
            seen: Vec::new(),
            since_resampling: 0,
        })
    }

    /// The motion since the last scan that was taken in.
    pub(super) fn since(&self) -> Se2 {
        self.pending.map_or(self.walked, |pending| pending.start_from_end)
    }

    /// Whether there is odometry: scans may come faster than it does.
    const fn has_odometry(&self) -> bool {
        self.scans_without < PATIENCE
    }

    /// The motion to a scan that is not taken in.
    fn walk(&mut self, moved: &Moved) {
        (self.walked, self.drift) = (moved.since, moved.drift);
        if let Some(pending) = &mut self.pending {
            pending.start_from_end = moved.since;
        }
    }

    fn note(&mut self, stamp: Stamp, since: Se2) {
        self.scans_without = self.scans_without.saturating_add(1);
        self.seen.push(Seen { stamp, step: self.steps.len().saturating_sub(1) as u32, since });
    }
}
