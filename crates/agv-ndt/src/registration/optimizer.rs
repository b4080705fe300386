//! The optimisers by name.

use super::{Descent, DescentParams, Objective, gauss_newton, newton, trust_region};
use agv_core::geometry::Se3;
use nalgebra::Matrix6;

/// How a cost is walked down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Optimizer {
    /// Damped steps (Levenberg and Marquardt): one evaluation a step.
    #[default]
    TrustRegion,
    /// Newton's direction and Moré and Thuente's line search, as Magnusson 2009 has it: one to a few evaluations a step.
    LineSearch,
    /// Steps as they come (Gauss and Newton), for costs whose pairs change from pose to pose.
    GaussNewton,
}

impl Optimizer {
    /// Walks from `start` down to a minimum along the tangents that `keep` leaves: the projector onto the directions that may
    /// change, the unit matrix for all. Parameters are taken as they are: [`DescentParams::validate`] checks them.
    pub fn minimize(
        self,
        objective: &mut impl Objective,
        params: &DescentParams,
        start: &Se3,
        keep: &Matrix6<f64>,
    ) -> Descent {
        match self {
            Self::TrustRegion => trust_region::minimize(objective, params, start, keep),
            Self::LineSearch => newton::minimize(objective, params, start, keep),
            Self::GaussNewton => gauss_newton::minimize(objective, params, start, keep),
        }
    }
}
