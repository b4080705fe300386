//! What LOAM-style odometry may be told.

use super::features::FeatureParams;
use super::mapping::LocalMapParams;
use crate::registration::DescentParams;
use agv_core::{Error, check};

/// What a cloud is aligned with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum LoamTarget {
    /// The features of the last cloud alone: drift adds up with every cloud.
    LastCloud,
    /// The local map.
    #[default]
    LocalMap,
    /// The last cloud, and from there the local map: LOAM's odometry and mapping at one rate.
    LastCloudThenMap,
}

/// What is solved for at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum LoamSolve {
    /// All six degrees of freedom, by surfaces and edges.
    #[default]
    Joint,
    /// Height, roll and pitch by level surfaces, then x, y and yaw by edges (LeGO-LOAM; paper 003). For vehicles on a floor, in
    /// places with edges enough: a step with fewer than ten matches takes all of them. Upright walls and level edges do not take part,
    /// so that it is less accurate than the joint solve, which ends it on the local map, as LeGO-LOAM's mapping does.
    TwoStep,
}

/// Parameters of [`LoamOdometry`](super::LoamOdometry).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LoamParams {
    /// Which points are features.
    pub features: FeatureParams,
    /// What the local map keeps.
    pub map: LocalMapParams,
    /// What a cloud is aligned with.
    pub target: LoamTarget,
    /// What is solved for at once; on the local map two steps are followed by a joint solve, after an alignment with the last cloud it is
    /// all there is.
    pub solve: LoamSolve,
    /// Most surface points of a cloud that are matched.
    pub max_surfaces: usize,
    /// Most edges of a cloud that are matched.
    pub max_edges: usize,
    /// Most rounds of matching on the finest level.
    pub max_rounds: usize,
    /// When the improvement of a pose with fixed matches stops; its tolerances also end the rounds.
    pub descent: DescentParams,
    /// Deviation from the prediction that is expected before any was seen, in metres.
    pub initial_sigma: f64,
    /// Scale of the robust kernel in the end, in metres: distances well beyond it count for nothing.
    pub kernel: f64,
    /// Distance up to which a match is an inlier, in metres.
    pub inlier_distance: f64,
    /// Share of inliers among the matched features, below which a result is [`PoorFit`](agv_core::roles::Termination::PoorFit).
    pub min_agreement: f64,
    /// Share of the matches that must face a direction for it to be observed. What is not keeps the prediction.
    pub min_facing_share: f64,
}

impl Default for LoamParams {
    /// The joint solve on the local map. The first deviation is that of `KISS-ICP` (2 m); the kernel is five times a lidar's noise.
    fn default() -> Self {
        Self {
            features: FeatureParams::default(),
            map: LocalMapParams::default(),
            target: LoamTarget::LocalMap,
            solve: LoamSolve::Joint,
            max_surfaces: 2500,
            max_edges: 500,
            max_rounds: 10,
            descent: DescentParams { max_iterations: 5, ..DescentParams::default() },
            initial_sigma: 2.0,
            kernel: 0.1,
            inlier_distance: 0.1,
            min_agreement: 0.6,
            min_facing_share: 0.01,
        }
    }
}

impl LoamParams {
    pub(super) fn validate(&self) -> Result<(), Error> {
        self.features.validate()?;
        self.map.validate()?;
        self.descent.validate()?;
        check::in_range("max_surfaces", self.max_surfaces as f64, 10.0, 1e6)?;
        check::in_range("max_edges", self.max_edges as f64, 0.0, 1e6)?;
        check::at_least("max_rounds", self.max_rounds, 1)?;
        check::positive("initial_sigma", self.initial_sigma)?;
        check::positive("kernel", self.kernel)?;
        check::positive("inlier_distance", self.inlier_distance)?;
        check::in_range("min_agreement", self.min_agreement, 0.0, 1.0)?;
        check::positive("min_facing_share", self.min_facing_share)?;
        check::in_range("min_facing_share", self.min_facing_share, 0.0, 1.0)?;
        Ok(())
    }
}
