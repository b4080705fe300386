//! Where the first particles are drawn.
//!
//! Paper 001 calls an *improved swarm* what it starts from: particles that are spread over the pose space and drawn again by
//! the first scans, instead of a Gaussian around a guess. Here the two halves are apart: [`InitialPoses`] says where particles may
//! be (around a pose, anywhere, anywhere and evenly, or a blend of these), an [`ImprovedSwarm`] spreads many more candidates there than the
//! filter has particles, weighs them by what is seen from where the vehicle stands, and keeps as many as the filter holds.
//!
//! ```text
//! candidates xᵢ ~ poses, i = 1..c n        wᵢ ∝ (Π p(z | xᵢ))^τ        particles: n draws in proportion to wᵢ
//! ```
//!
//! with the greatest power `τ ≤ 1` that leaves a given share of `n` effective: one scan cannot tell like places from each
//! other, and no candidate is quite right.

use super::{FreeSpace, gaussian::PoseGaussian};
use agv_core::{
    Error, check,
    compute::Stream,
    geometry::{Se2, UncertainPose},
};

/// Where the first particles may be.
pub trait InitialPoses: Sync {
    /// Draws the pose `index` of `count`; it may lie off the map.
    fn draw(&self, free_space: &FreeSpace, index: usize, count: usize, stream: &mut Stream) -> Se2;

    /// Whether the vehicle may be anywhere, so that an adaptive filter is to go on searching.
    fn is_anywhere(&self) -> bool;
}

/// Around a pose: a Gaussian of its right increment.
#[derive(Debug, Clone, Copy)]
pub struct AroundPose(PoseGaussian);

impl AroundPose {
    /// Draws with the mean and covariance of this pose.
    pub fn new(pose: &UncertainPose<Se2>) -> Self {
        Self(PoseGaussian::new(pose))
    }
}

impl InitialPoses for AroundPose {
    fn draw(&self, _: &FreeSpace, _: usize, _: usize, stream: &mut Stream) -> Se2 {
        self.0.sample(stream)
    }

    fn is_anywhere(&self) -> bool {
        false
    }
}

/// Anywhere in free space, each by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct UniformPoses;

impl InitialPoses for UniformPoses {
    fn draw(&self, free_space: &FreeSpace, _: usize, _: usize, stream: &mut Stream) -> Se2 {
        free_space.sample(stream)
    }

    fn is_anywhere(&self) -> bool {
        true
    }
}

/// Anywhere in free space, evenly over area and heading ([`FreeSpace::sample_stratum`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StratifiedPoses;

impl InitialPoses for StratifiedPoses {
    fn draw(&self, free_space: &FreeSpace, index: usize, count: usize, stream: &mut Stream) -> Se2 {
        free_space.sample_stratum(index, count, stream)
    }

    fn is_anywhere(&self) -> bool {
        true
    }
}

/// Part of the particles by one distribution, the rest by another: around where the vehicle was parked, and anywhere in case it
/// was moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlendedPoses<A, B> {
    first: A,
    share: f64,
    second: B,
}

impl<A: InitialPoses, B: InitialPoses> BlendedPoses<A, B> {
    /// A `share` of the particles by `first`, the others by `second`.
    ///
    /// # Errors
    /// A share outside [0, 1].
    pub fn new(first: A, share: f64, second: B) -> Result<Self, Error> {
        check::in_range("share", share, 0.0, 1.0)?;
        Ok(Self { first, share, second })
    }
}

impl<A: InitialPoses, B: InitialPoses> InitialPoses for BlendedPoses<A, B> {
    fn draw(&self, free_space: &FreeSpace, index: usize, count: usize, stream: &mut Stream) -> Se2 {
        let by_first = (self.share * count as f64).round() as usize;
        match index.checked_sub(by_first) {
            None => self.first.draw(free_space, index, by_first, stream),
            Some(index) => self.second.draw(free_space, index, count.saturating_sub(by_first), stream),
        }
    }

    fn is_anywhere(&self) -> bool {
        (self.share > 0.0 && self.first.is_anywhere()) || (self.share < 1.0 && self.second.is_anywhere())
    }
}

/// Parameters of an [`ImprovedSwarm`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SwarmParams {
    /// Candidates for each particle.
    pub candidates: usize,
    /// Share of the particles that stays effective at least, in (0, 1]: how many different places outlive the first scans.
    pub effective: f64,
}

impl Default for SwarmParams {
    /// Eight candidates for each particle; one particle in ten another place.
    fn default() -> Self {
        Self { candidates: 8, effective: 0.1 }
    }
}

impl SwarmParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// No candidates or more than 1000 for each particle, or a share outside (0, 1].
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("candidates", self.candidates as f64, 1.0, 1000.0)?;
        check::in_range("effective", self.effective, f64::MIN_POSITIVE, 1.0)?;
        Ok(())
    }
}

/// 001's improved swarm: first particles that are spread over `P` and weighed by the first scans.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams};
/// use agv_core::nalgebra::Matrix3;
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::particle::*;
///
/// // A corner: walls at x = 2 m and y = 1 m, seen from the origin over a quarter turn to the left.
/// let mut map = Grid::filled(GridLayout::new(80, 80, 0.05, Se2::new(-2.0, -3.0, 0.0))?, CellState::Free);
/// for i in 0..80 {
///     map.set(Cell::new(79, i), CellState::Occupied);
///     map.set(Cell::new(i, 79), CellState::Occupied);
/// }
/// let geometry = ScanGeometry { angle_min: 0.01, angle_increment: 0.03, ..Default::default() };
/// let range = |i: i32| { let a = 0.01 + 0.03 * f64::from(i); (1.975 / a.cos()).min(0.975 / a.sin()) as f32 };
/// let scan = LaserScan::new(Stamp::default(), geometry, (0..52).map(range).collect())?;
///
/// let field = LikelihoodField::new(&map, LikelihoodFieldParams::default())?;
/// let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
/// let motion = DifferentialOdometryModel::new(OdometryNoise::default())?;
/// let mut mcl = Mcl::new(motion, sensor, FreeSpace::new(&map, 0.3)?, MclParams::default(), Seed(7))?;
/// let swarm = ImprovedSwarm::new(StratifiedPoses, SwarmParams::default())?;
/// mcl.initialize_swarm(&swarm, &[&scan])?;
/// let near = mcl.particles().states().iter().filter(|pose| pose.translation().norm() < 0.5).count();
/// assert!(near > 200, "{near} of 2000, where 0.8 m² of the free 13 m² hold 120");
///
/// // Parked at the origin, if nobody has moved it; without a scan, as the distribution says.
/// let parked = AroundPose::new(&UncertainPose::new(Se2::default(), Matrix3::identity() * 0.01)?);
/// let swarm = ImprovedSwarm::new(BlendedPoses::new(parked, 0.5, StratifiedPoses)?, SwarmParams::default())?;
/// mcl.initialize_swarm::<LaserScan, _>(&swarm, &[])?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImprovedSwarm<P = StratifiedPoses> {
    pub(super) poses: P,
    pub(super) params: SwarmParams,
}

impl<P: InitialPoses> ImprovedSwarm<P> {
    /// A swarm over these poses.
    ///
    /// # Errors
    /// Parameters that [`validate`](SwarmParams::validate) refuses.
    pub fn new(poses: P, params: SwarmParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { poses, params })
    }

    /// Whether the vehicle may be anywhere.
    pub(super) fn is_anywhere(&self) -> bool {
        self.poses.is_anywhere()
    }
}

impl Default for ImprovedSwarm {
    /// Anywhere, with the default parameters.
    fn default() -> Self {
        Self { poses: StratifiedPoses, params: SwarmParams::default() }
    }
}
