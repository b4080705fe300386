//! The crate's one error type.

/// Why a controller, or a part of one, was refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value was refused.
    #[error(transparent)]
    Core(#[from] agv_core::Error),
    /// No feedback of finite cost keeps the model at rest: something that grows is out of reach of the inputs, or costs nothing.
    #[error("the model cannot be stabilised: after {doublings} doublings the closed loop still has the norm {norm}")]
    NotStabilisable {
        /// Doublings of the horizon that were tried.
        doublings: usize,
        /// Norm of the closed loop over that horizon, which should vanish.
        norm: f64,
    },
}
