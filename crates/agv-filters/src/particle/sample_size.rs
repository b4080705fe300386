//! How many particles the next set has.

use super::{ParticleSet, set::ParticleState};
use agv_core::{compute::Stream, geometry::Se2};

/// How many particles are needed: asked whenever a new set is drawn, of the weighted old one.
///
/// KLD sampling is one: it counts the bins of a histogram that the weight falls in. A filter has room for
/// [`most`](Self::most) of them from the start, so that a change allocates nothing.
pub trait SampleSize<X = Se2> {
    /// Most particles that will ever be asked for; none for as many as the filter was built with. A belief that was just
    /// given has this many.
    fn most(&self) -> Option<usize>;

    /// Number of particles of the next set; beyond the filter's room, or below one, the nearest that it can have is taken.
    ///
    /// `stream` is for trial draws; it is not the one that the set is then drawn with.
    fn sample_size(&mut self, particles: &ParticleSet<X>, stream: &mut Stream) -> usize;

    /// The same of a set of which a `share` is drawn elsewhere, from `fresh` in their order.
    fn sample_size_with(&mut self, particles: &ParticleSet<X>, fresh: &[X], share: f64, stream: &mut Stream) -> usize {
        let _ = (fresh, share);
        self.sample_size(particles, stream)
    }
}

/// As many as there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SameSize;

impl<X: ParticleState> SampleSize<X> for SameSize {
    fn most(&self) -> Option<usize> {
        None
    }

    fn sample_size(&mut self, particles: &ParticleSet<X>, _: &mut Stream) -> usize {
        particles.len()
    }
}
