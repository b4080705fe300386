//! The timed elastic band: poses and the times between them, bent and stretched until the vehicle can follow them quickly
//! (Rösmann, Feiten, Wösch, Hoffmann and Bertram 2012; 2013; Rösmann, Hoffmann and Bertram 2017).
//!
//! ```text
//! B = (x₀ y₀ θ₀ Δt₀) (x₁ y₁ θ₁ Δt₁) … (xₙ yₙ θₙ)        min Σ |rₖ(B)|²
//! ```
//!
//! Every residual ([`edges`]) ties up to three poses that follow each other and the times between them, so that the normal
//! equations have a band of eleven entries and the time of a step of Levenberg and Marquardt's grows with the number of poses only.
//!
//! Where something blocks the path, also something that moves and will be there then, bands of several homotopy classes are optimised
//! beside each other: the least detours by the free stretches across the path, told apart by their H-signatures. The class of the last
//! cycle is kept until another is much quicker, or it is blocked for long.
//!
//! The residuals are soft, and a band alone breaks limits by as much as it pays. What [`Teb`] returns is therefore not the band but
//! a [`Rollout`]: the ideal vehicle that follows it, cycle by cycle, with motions that
//! [`MotionLimits`](agv_core::kinematics::MotionLimits) allow exactly, each of them checked against the obstacles with the footprint
//! swept. The band says where to go; the roll-out says what is true.

mod band;
mod drive;
pub mod edges;
mod lanes;
mod line;
mod params;
mod planner;
mod problem;
mod rollout;
mod sample;
mod signature;
mod slot;
mod solver;

pub use band::Band;
pub use params::{TebParams, TebWeights};
pub use planner::{Teb, TebPlan};
pub use rollout::Rollout;
pub use solver::{BandReport, BandSolver};
