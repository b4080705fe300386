//! The constants of Magnusson's mixture of a normal and a uniform distribution.
//!
//! A point's likelihood is `p(x) = c1 exp(-½ m) + c2` with the outliers' share in `c2`. Its negative logarithm has no second
//! derivative that is easy to sum, so it is approximated by a Gaussian function that agrees at `m = 0`, `m = 1` and far away
//! (Biber et al. 2004; Magnusson 2009, Eq. 6.8):
//!
//! ```text
//! -log p(x) ≈ d1 exp(-½ d2 m) + d3
//! c1 = 10 (1 - o),  c2 = o / V,  d3 = -log c2,  d1 = -log(c1 + c2) - d3,  d2 = -2 log((-log(c1 exp(-½) + c2) - d3) / d1)
//! ```

use crate::Error;
use agv_core::check;

/// Constants of the score.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mixture {
    /// Negative: depth of a distribution's well.
    pub(crate) d1: f64,
    /// Positive: what the squared Mahalanobis distance is multiplied with.
    pub(crate) d2: f64,
}

impl Mixture {
    /// Of voxels of `edge` metres and a share of outliers between 0 and 1.
    pub(crate) fn new(outlier_ratio: f64, edge: f64) -> Result<Self, Error> {
        Self::of_volume(outlier_ratio, edge.powi(3))
    }

    /// Of the cells of a plane.
    pub(crate) fn planar(outlier_ratio: f64, edge: f64) -> Result<Self, Error> {
        Self::of_volume(outlier_ratio, edge * edge)
    }

    fn of_volume(outlier_ratio: f64, volume: f64) -> Result<Self, Error> {
        check::in_range("outlier_ratio", outlier_ratio, 0.001, 0.999)?;
        let (c1, c2) = (10.0 * (1.0 - outlier_ratio), outlier_ratio / volume);
        let d3 = -c2.ln();
        let d1 = -(c1 + c2).ln() - d3;
        let d2 = -2.0 * ((-(c1 * (-0.5_f64).exp() + c2).ln() - d3) / d1).ln();
        Ok(Self { d1, d2 })
    }
}
