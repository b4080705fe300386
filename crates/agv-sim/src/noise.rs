//! Draws that every sensor needs.

use agv_core::compute::Stream;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// A draw from a normal distribution of mean zero and standard deviation `sigma`.
#[inline]
pub(crate) fn normal(sigma: f64, stream: &mut Stream) -> f64 {
    let standard: f64 = StandardNormal.sample(stream);
    sigma * standard
}

/// Whether an event of this `probability` happens.
#[inline]
pub(crate) fn happens(probability: f64, stream: &mut Stream) -> bool {
    stream.random::<f64>() < probability
}
