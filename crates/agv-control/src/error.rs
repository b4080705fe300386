//! The crate's one error type.

/// Why a controller, a plant, or a part or test of them was refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value was refused.
    #[error(transparent)]
    Core(#[from] agv_core::Error),
    /// A transfer function whose numerator has the higher degree would differentiate its input.
    #[error("a transfer function of degree {numerator} over degree {denominator} is improper")]
    Improper {
        /// Degree of the numerator.
        numerator: usize,
        /// Degree of the denominator.
        denominator: usize,
    },
    /// No stand-in plant has this name.
    #[error("no such plant: p1, p2, p3 or load")]
    NoSuchPlant,
    /// The tracker's model follows the direction of the path: a vehicle that faces elsewhere is beyond it.
    #[error("this tracker faces along the path only")]
    FacingNotSupported,
    /// Numbers left their range: the plant is unstable, or its coefficients are too far apart.
    #[error("{name} left the range of numbers")]
    Overflow {
        /// What was computed.
        name: &'static str,
    },
    /// No feedback of finite cost keeps the model at rest: something that grows is out of reach of the inputs, or costs nothing.
    #[error("the model cannot be stabilised: after {doublings} doublings the closed loop still has the norm {norm}")]
    NotStabilisable {
        /// Doublings of the horizon that were tried.
        doublings: usize,
        /// Norm of the closed loop over that horizon, which should vanish.
        norm: f64,
    },
}
