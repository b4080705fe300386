//! Drawing a new set in proportion to the weights.

mod inverse;
mod multinomial;
mod residual;
mod stratified;
mod systematic;

use agv_core::compute::Stream;

pub use multinomial::Multinomial;
pub use residual::Residual;
pub use stratified::Stratified;
pub use systematic::Systematic;
pub(super) use systematic::{Comb, possible, sum};

/// Chooses which particles live on.
pub trait Resampler {
    /// Fills `ancestors` with indices into `weights`, in increasing order, so that each index is expected to appear
    /// `ancestors.len()` times its weight.
    ///
    /// `weights` are normalised up to rounding; an index of weight zero never appears. The two lengths may differ:
    /// adaptive filters change the number of particles here.
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]);

    /// Where the first of equally spaced points stands, as a share of their distance in [0, 1), if these are all that is drawn:
    /// a [`ParticleSet`](super::ParticleSet) then lays them on several threads. Takes from the stream what
    /// [`resample`](Self::resample) takes; none, and nothing, for other ways to draw.
    fn first_of_equally_spaced(&self, stream: &mut Stream) -> Option<f64> {
        let _ = stream;
        None
    }
}

impl<R: Resampler + ?Sized> Resampler for Box<R> {
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]) {
        (**self).resample(weights, stream, ancestors);
    }

    fn first_of_equally_spaced(&self, stream: &mut Stream) -> Option<f64> {
        (**self).first_of_equally_spaced(stream)
    }
}
