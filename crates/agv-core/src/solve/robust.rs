//! Robust kernels: least squares that outliers cannot pull away.
//!
//! In place of the squared residual `s = w |r|²` a cost sums `ϱ(s)`, which is `s` near zero and grows more slowly beyond
//! `c²`. Its slope `ϱ'(s)` is the factor of the residual's weight in the normal equations (iteratively reweighted least
//! squares: Zhang, *Parameter estimation techniques: a tutorial*, 1997, Table 1; Triggs et al., *Bundle adjustment*, 2000,
//! section 4.3, without the second-order term, so that the equations stay definite):
//!
//! | kernel | ϱ(s) | ϱ'(s) | an outlier's pull |
//! |---|---|---|---|
//! | Huber | s; 2 c √s - c² beyond c² | 1; c / √s | is bounded |
//! | Cauchy | c² ln(1 + s/c²) | c² / (c² + s) | falls with its distance |
//! | Geman–McClure | c² s / (c² + s) | (c² / (c² + s))² | falls with its cube |
//! | dynamic covariance scaling | s; c² (3 s - c²) / (c² + s) beyond c² | 1; (2 c² / (c² + s))² | falls with its cube |
//!
//! The last scales a residual by the greatest switch from 0 to 1, `min(1, 2 c² / (c² + s))`, with which keeping it costs no more than
//! the price `c²` of turning it off (Agarwal et al., *Robust map optimization using dynamic covariance scaling*, 2013); the best
//! switch would give Geman–McClure.

use crate::{Error, check};

/// How a squared residual counts. The scale `c` is in the unit of the weighted residual: standard deviations, where the
/// weight is an information.
///
/// ```
/// use agv_core::solve::RobustKernel;
///
/// let huber = RobustKernel::Huber { scale: 2.0 }.checked()?;
/// // An inlier counts in full, a residual of ten standard deviations by a fifth.
/// assert_eq!((huber.weight(1.0), huber.weight(100.0)), (1.0, 0.2));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum RobustKernel {
    /// Plain least squares.
    #[default]
    Square,
    /// Linear beyond the scale; the cost stays convex where the residuals are linear. 1.345 keeps 95 % of the efficiency on
    /// Gaussian residuals.
    Huber {
        /// Residual at which the cost becomes linear.
        scale: f64,
    },
    /// Logarithmic beyond the scale. 2.385 keeps 95 % of the efficiency on Gaussian residuals.
    Cauchy {
        /// Residual whose weight is halved.
        scale: f64,
    },
    /// Bounded: a residual far beyond the scale adds a constant, and pulls no more. Needs a start that is near.
    GemanMcClure {
        /// Residual whose weight is quartered.
        scale: f64,
    },
    /// Bounded, and plain least squares within the scale: inliers count in full. Needs a start that is near.
    DynamicCovarianceScaling {
        /// Residual beyond which the weight falls.
        scale: f64,
    },
}

impl RobustKernel {
    /// Accepts the kernel if its scale is finite and positive.
    ///
    /// # Errors
    /// [`Error::NotPositive`].
    pub fn checked(self) -> Result<Self, Error> {
        if let Some(scale) = self.scale() {
            check::positive("scale of the robust kernel", scale)?;
        }
        Ok(self)
    }

    /// The scale `c`; none for plain least squares.
    #[inline]
    pub const fn scale(self) -> Option<f64> {
        match self {
            Self::Square => None,
            Self::Huber { scale }
            | Self::Cauchy { scale }
            | Self::GemanMcClure { scale }
            | Self::DynamicCovarianceScaling { scale } => Some(scale),
        }
    }

    /// The kernel of the same kind whose scale is `factor` times this one's: nearer to plain least squares the greater it is.
    #[inline]
    #[must_use]
    pub const fn widened(mut self, factor: f64) -> Self {
        match &mut self {
            Self::Square => {}
            Self::Huber { scale }
            | Self::Cauchy { scale }
            | Self::GemanMcClure { scale }
            | Self::DynamicCovarianceScaling { scale } => *scale *= factor,
        }
        self
    }

    /// `ϱ(s)` of a squared residual; half of it is what the cost takes.
    #[inline]
    pub fn loss(self, squared: f64) -> f64 {
        match self {
            Self::Square => squared,
            Self::Huber { scale } if squared <= scale * scale => squared,
            Self::Huber { scale } => scale * (2.0 * squared.sqrt() - scale),
            Self::Cauchy { scale } => scale * scale * (squared / (scale * scale)).ln_1p(),
            Self::GemanMcClure { scale } => squared / (1.0 + squared / (scale * scale)),
            Self::DynamicCovarianceScaling { scale } if squared <= scale * scale => squared,
            Self::DynamicCovarianceScaling { scale } => {
                // In parts of c²: the squares of large numbers overflow.
                let ratio = scale * scale / squared;
                scale * scale * (3.0 - ratio) / (1.0 + ratio)
            }
        }
    }

    /// `ϱ'(s)`: the factor of the residual's weight.
    #[inline]
    pub fn weight(self, squared: f64) -> f64 {
        match self {
            Self::Square => 1.0,
            Self::Huber { scale } if squared <= scale * scale => 1.0,
            Self::Huber { scale } => scale / squared.sqrt(),
            Self::Cauchy { scale } => 1.0 / (1.0 + squared / (scale * scale)),
            Self::GemanMcClure { scale } => (1.0 + squared / (scale * scale)).powi(-2),
            Self::DynamicCovarianceScaling { scale } if squared <= scale * scale => 1.0,
            Self::DynamicCovarianceScaling { scale } => (0.5 + 0.5 * squared / (scale * scale)).powi(-2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kernels(scale: f64) -> [RobustKernel; 5] {
        use RobustKernel::{Cauchy, DynamicCovarianceScaling, GemanMcClure, Huber, Square};
        [Square, Huber { scale }, Cauchy { scale }, GemanMcClure { scale }, DynamicCovarianceScaling { scale }]
    }

    #[test]
    fn wider_kernels_are_those_of_a_wider_scale_and_bounded_ones_stay_bounded() {
        for (kernel, wide) in kernels(0.5).into_iter().zip(kernels(2.0)) {
            assert_eq!(kernel.widened(4.0), wide);
            assert!(wide.loss(9.0) >= kernel.loss(9.0) && wide.scale().is_none_or(|scale| scale == 2.0));
        }
        for bounded in &kernels(2.0)[3..] {
            assert!(bounded.loss(1e300) <= 12.0 && bounded.weight(1e300) < 1e-300, "{bounded:?}");
        }
    }

    proptest! {
        #[test]
        fn weights_are_the_slopes_of_the_losses(scale in 0.1..10.0_f64, ratio in 0.0..30.0_f64) {
            let (s, h) = (ratio * scale * scale, 1e-6 * scale * scale);
            for kernel in kernels(scale) {
                let slope = (kernel.loss(s + h) - kernel.loss(s)) / h;
                prop_assert!((slope - kernel.weight(s + 0.5 * h)).abs() < 1e-6, "{kernel:?} {s}: {slope}");
                prop_assert!(kernel.weight(s) <= 1.0 && kernel.loss(s) <= s * (1.0 + 1e-12));
            }
        }
    }

    #[test]
    fn scales_are_checked_and_small_residuals_count_in_full() {
        for kernel in kernels(1.5) {
            assert!((kernel.loss(1e-12) / 1e-12 - 1.0).abs() < 1e-9 && kernel.weight(0.0) == 1.0, "{kernel:?}");
            assert_eq!(kernel.checked(), Ok(kernel));
        }
        for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(kernels(scale)[1..].iter().all(|k| matches!(k.checked(), Err(Error::NotPositive { .. }))));
        }
    }
}
