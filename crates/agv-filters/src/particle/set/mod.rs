//! The particles: an array of states beside arrays of weights.
//!
//! A state is kept whole (a pose is x, y, cosine, sine: half a cache line), so that resampling copies it at once; passes
//! that work on many states side by side take them apart block by block, at a nanosecond each. Weights live beside the
//! states, as logarithms and as normalised numbers: products of many small likelihoods would underflow.
//!
//! New states are written to spare memory and then change places with the old ones, so that a step that fails half-way
//! has changed nothing.

#[cfg(feature = "serde")]
mod checkpoint;
mod comb;
mod reweigh;
mod state;
mod weighed;

use super::Resampler;
use agv_core::{
    Error,
    compute::{CHUNK, Par, Stream},
    geometry::Se2,
};

pub(super) use reweigh::WeightSums;
pub use state::ParticleState;
pub(super) use weighed::WeighedSums;

/// Weighted samples of a state, of `map_from_base` unless said otherwise.
///
/// The number of particles may change each time that new ones are drawn, up to the set's capacity; all memory is
/// allocated at construction.
///
/// ```
/// use agv_core::compute::{Par, Seed};
/// use agv_core::geometry::Se2;
/// use agv_filters::particle::{ParticleSet, Systematic};
///
/// let mut set = ParticleSet::new(vec![Se2::new(0.0, 0.0, 0.0), Se2::new(1.0, 0.0, 0.0)])?.with_capacity(8)?;
/// // The second particle explains the observation three times as well.
/// let summary = set.reweigh(&[0.0, 3_f64.ln()], Par::Seq).expect("likelihoods are finite");
/// assert!((set.weights()[1] - 0.75).abs() < 1e-12);
/// assert!((summary.effective_sample_size - 1.6).abs() < 1e-12);
/// // Eight particles in proportion to the weights, and where each came from.
/// let ancestors = set.resample(8, &Systematic, &mut Seed(1).stream(0, 0), Par::Seq);
/// assert_eq!(ancestors, [0, 0, 1, 1, 1, 1, 1, 1]);
/// assert_eq!(set.states()[7].x(), 1.0);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        try_from = "checkpoint::StoredSet<X>",
        into = "checkpoint::StoredSet<X>",
        bound(
            serialize = "X: ParticleState + serde::Serialize",
            deserialize = "X: ParticleState + serde::Deserialize<'de>"
        )
    )
)]
pub struct ParticleSet<X = Se2> {
    /// Particles in use; the arrays are as long as the capacity.
    count: usize,
    states: Vec<X>,
    /// Normalised: their exponentials sum to one.
    log_weights: Vec<f64>,
    /// Exponentials of `log_weights`.
    weights: Vec<f64>,
    /// Where new states are written, before the two change places.
    spare: Vec<X>,
    /// Where new weights are written as long as the old ones are read.
    spare_weights: Vec<f64>,
    ancestors: Vec<u32>,
    /// Scratch: the running sum of the weights at the begin of each chunk, and at the end of the last.
    sums: Vec<f64>,
}

impl<X: PartialEq> PartialEq for ParticleSet<X> {
    /// States and weights; spare memory does not count.
    fn eq(&self, other: &Self) -> bool {
        self.count == other.count
            && self.states[..self.count] == other.states[..self.count]
            && self.log_weights[..self.count] == other.log_weights[..self.count]
            && self.weights[..self.count] == other.weights[..self.count]
    }
}

impl ParticleSet<Se2> {
    /// Most particles that a set may have: an ancestor's index then fits 32 bits with room to spare.
    pub const MAX_PARTICLES: usize = 1 << 24;

    /// Accepts a number of particles.
    ///
    /// # Errors
    /// Zero, or more than [`MAX_PARTICLES`](Self::MAX_PARTICLES).
    pub fn check_count(count: usize) -> Result<usize, Error> {
        match count {
            0 => Err(Error::Empty { name: "particles" }),
            len if len > Self::MAX_PARTICLES => {
                Err(Error::TooMany { name: "particles", len, max: Self::MAX_PARTICLES })
            }
            len => Ok(len),
        }
    }
}

impl<X: ParticleState> ParticleSet<X> {
    /// A set of equally weighted states, with room for no more.
    ///
    /// # Errors
    /// No states, more than [`MAX_PARTICLES`](ParticleSet::MAX_PARTICLES), or one that is not finite.
    pub fn new(states: Vec<X>) -> Result<Self, Error> {
        let count = ParticleSet::check_count(states.len())?;
        if states.iter().any(|state| !state.is_finite()) {
            return Err(Error::NotFinite { name: "particle", value: f64::NAN });
        }
        let mut set = Self {
            count,
            spare: states.clone(),
            log_weights: vec![0.0; count],
            weights: vec![0.0; count],
            spare_weights: vec![0.0; count],
            ancestors: vec![0; count],
            sums: Vec::with_capacity(count.div_ceil(CHUNK) + 1),
            states,
        };
        set.equalize();
        Ok(set)
    }

    /// The same set with room for `capacity` particles, if it had less.
    ///
    /// # Errors
    /// More than [`MAX_PARTICLES`](ParticleSet::MAX_PARTICLES).
    pub fn with_capacity(mut self, capacity: usize) -> Result<Self, Error> {
        let capacity = ParticleSet::check_count(capacity.max(self.capacity()))?;
        let filler = self.states[0];
        self.states.resize(capacity, filler);
        self.spare.resize(capacity, filler);
        self.log_weights.resize(capacity, 0.0);
        self.weights.resize(capacity, 0.0);
        self.spare_weights.resize(capacity, 0.0);
        self.ancestors.resize(capacity, 0);
        self.sums.clear();
        self.sums.reserve(capacity.div_ceil(CHUNK) + 1);
        Ok(self)
    }

    /// Number of particles, at least one.
    #[expect(clippy::len_without_is_empty, reason = "a set has at least one particle")]
    pub const fn len(&self) -> usize {
        self.count
    }

    /// Most particles that the set can have.
    pub fn capacity(&self) -> usize {
        self.states.len()
    }

    /// The states.
    pub fn states(&self) -> &[X] {
        &self.states[..self.count]
    }

    /// Normalised weights.
    pub fn weights(&self) -> &[f64] {
        &self.weights[..self.count]
    }

    /// Logarithms of the normalised weights.
    pub fn log_weights(&self) -> &[f64] {
        &self.log_weights[..self.count]
    }

    /// Writes a new state for each particle with `write(index of chunk, states, new states)`; they wait as
    /// [`proposed`](Self::proposed) until [`adopt`](Self::adopt) makes them the set's.
    pub fn propose(&mut self, par: Par, write: impl Fn(usize, &[X], &mut [X]) + Sync) {
        let pairs = (&self.states[..self.count], &mut self.spare[..self.count]);
        par.for_each_chunk(pairs, CHUNK, |chunk, (states, spare): (&[X], &mut [X])| write(chunk, states, spare));
    }

    /// The states that were proposed last; what they are after anything else was drawn is not defined.
    pub fn proposed(&self) -> &[X] {
        &self.spare[..self.count]
    }

    /// Makes the proposed states the set's; weights stay.
    pub fn adopt(&mut self) {
        std::mem::swap(&mut self.states, &mut self.spare);
    }

    /// Sets the weights as a checkpoint had them, bit for bit.
    #[cfg(feature = "serde")]
    pub(super) fn restore_weights(&mut self, log_weights: &[f64], weights: &[f64]) -> Result<(), Error> {
        use agv_core::check;

        check::length("log_weights", log_weights.len(), self.count)?;
        check::length("weights", weights.len(), self.count)?;
        for (&log_weight, &weight) in log_weights.iter().zip(weights) {
            check::in_range("weight", weight, 0.0, 1.0 + 1e-9)?;
            check::in_range("weight less the exponential of its logarithm", weight - log_weight.exp(), -1e-9, 1e-9)?;
        }
        check::in_range("sum of weights", weights.iter().sum(), 1.0 - 1e-6, 1.0 + 1e-6)?;
        self.log_weights[..self.count].copy_from_slice(log_weights);
        self.weights[..self.count].copy_from_slice(weights);
        Ok(())
    }

    /// Writes `count` new states (at least one, at most the capacity) with `write(index of chunk, chunk)`, and takes them
    /// if `accept` does; the set is else as it was.
    ///
    /// Returns whether they were taken; weights are then equal.
    pub fn refill(
        &mut self,
        count: usize,
        par: Par,
        write: impl Fn(usize, &mut [X]) + Sync,
        accept: impl Fn(&[X]) -> bool,
    ) -> bool {
        let count = count.clamp(1, self.capacity());
        par.for_each_chunk(&mut self.spare[..count], CHUNK, |chunk, states: &mut [X]| write(chunk, states));
        let accepted = accept(&self.spare[..count]);
        if accepted {
            self.adopt();
            self.count = count;
            self.equalize();
        }
        accepted
    }

    /// Gives every particle the same weight.
    pub fn equalize(&mut self) {
        let weight = (self.count as f64).recip();
        self.weights[..self.count].fill(weight);
        self.log_weights[..self.count].fill(weight.ln());
    }

    /// Draws `count` new particles (at least one, at most the capacity) in proportion to the weights, which are equal
    /// afterwards.
    ///
    /// Returns where each new particle came from, in increasing order: what else belongs to particles, as the maps of a
    /// Rao-Blackwellised filter, is to follow.
    pub fn resample(
        &mut self,
        count: usize,
        resampler: &(impl Resampler + ?Sized),
        stream: &mut Stream,
        par: Par,
    ) -> &[u32] {
        let count = count.clamp(1, self.capacity());
        if let Some(offset) = resampler.first_of_equally_spaced(stream) {
            return self.resample_by_comb(count, offset, par);
        }
        self.resample_by(par, |_, weights, ancestors| {
            resampler.resample(weights, stream, &mut ancestors[..count]);
            count
        })
    }

    /// As [`resample`](Self::resample) with a choice of one's own: `choose(states, weights, ancestors)` writes indices
    /// of particles to the front of `ancestors`, which is as long as the capacity, and returns how many. For filters that
    /// look at what they have drawn to decide whether they need more.
    pub fn resample_by(&mut self, par: Par, choose: impl FnOnce(&[X], &[f64], &mut [u32]) -> usize) -> &[u32] {
        let (old, states) = (self.count, &self.states);
        let count = choose(&states[..old], &self.weights[..old], &mut self.ancestors).clamp(1, states.len());
        let weight = (count as f64).recip();
        let log_weight = weight.ln();
        let weights = (&mut self.weights[..count], &mut self.log_weights[..count]);
        let data = (&mut self.spare[..count], &mut self.ancestors[..count], weights);
        par.for_each_chunk(data, CHUNK, |_, (spare, ancestors, (weights, log_weights)): Drawn<'_, X>| {
            for (state, ancestor) in spare.iter_mut().zip(ancestors) {
                *ancestor = (*ancestor).min(old as u32 - 1);
                *state = states[*ancestor as usize];
            }
            weights.fill(weight);
            log_weights.fill(log_weight);
        });
        self.adopt();
        self.count = count;
        &self.ancestors[..count]
    }
}

impl<X: ParticleState> ParticleSet<X> {
    /// Adds states, as many as there is room for, and gives all particles the same weight.
    pub fn extend(&mut self, states: &[X]) {
        let end = (self.count + states.len()).min(self.capacity());
        self.states[self.count..end].copy_from_slice(&states[..end - self.count]);
        self.count = end;
        self.equalize();
    }
}

/// New states, where each came from, and its weight with its logarithm.
type Drawn<'a, X> = (&'a mut [X], &'a mut [u32], (&'a mut [f64], &'a mut [f64]));

/// The entries of chunk `index`.
pub(super) fn chunk_of<T>(values: &[T], index: usize) -> &[T] {
    let start = (index * CHUNK).min(values.len());
    &values[start..(start + CHUNK).min(values.len())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particle::Systematic;
    use agv_core::compute::Seed;

    fn line(count: usize) -> ParticleSet {
        ParticleSet::new((0..count).map(|i| Se2::new(i as f64, 0.0, 0.0)).collect()).unwrap()
    }

    #[test]
    fn bad_sets_are_named() {
        assert_eq!(ParticleSet::<Se2>::new(vec![]), Err(Error::Empty { name: "particles" }));
        assert!(ParticleSet::new(vec![Se2::new(f64::NAN, 0.0, 0.0)]).is_err());
        assert!(ParticleSet::check_count(ParticleSet::MAX_PARTICLES + 1).is_err());
    }

    #[test]
    fn impossible_particles_do_not_survive_resampling() {
        let mut set = line(1000);
        let log_likelihoods: Vec<f64> = (0..1000).map(|i| if i % 3 == 0 { 0.0 } else { f64::NEG_INFINITY }).collect();
        set.reweigh(&log_likelihoods, Par::Seq).unwrap();
        set.resample(1000, &Systematic, &mut Seed(1).stream(0, 0), Par::Seq);
        assert!(set.states().iter().all(|pose| pose.x() % 3.0 == 0.0));
        assert_eq!(set.weights()[0], 0.001);
    }

    #[test]
    fn the_number_of_particles_follows_each_draw_within_the_capacity() {
        let mut set = line(3).with_capacity(700).unwrap();
        set.reweigh(&[0.0, 2_f64.ln(), f64::NEG_INFINITY], Par::Seq).unwrap();
        for (asked, count) in [(600, 600), (0, 1), (5000, 700), (6, 6)] {
            let origins: Vec<u32> = set.resample(asked, &Systematic, &mut Seed(2).stream(0, 0), Par::Seq).to_vec();
            assert_eq!(
                (origins.len(), set.len(), set.weights().len(), set.states().len()),
                (count, count, count, count)
            );
            assert!((set.weights().iter().sum::<f64>() - 1.0).abs() < 1e-9);
            assert!(set.states().iter().all(|pose| pose.x() < 2.0), "the third was ruled out");
        }
        assert_eq!((set.capacity(), line(3).with_capacity(2).unwrap().capacity()), (700, 3));
        assert!(line(3).with_capacity(ParticleSet::MAX_PARTICLES + 1).is_err());
    }

    #[test]
    fn ancestors_say_what_else_is_to_follow() {
        let mut set = line(600);
        let mut maps: Vec<f64> = set.states().iter().map(Se2::x).collect();
        set.reweigh(&(0..600).map(|i| f64::from(i) * 0.01).collect::<Vec<_>>(), Par::Seq).unwrap();
        let ancestors = set.resample(400, &Systematic, &mut Seed(1).stream(0, 0), Par::Seq);
        assert!(ancestors.is_sorted());
        maps = ancestors.iter().map(|&ancestor| maps[ancestor as usize]).collect();
        assert!(set.states().iter().map(Se2::x).eq(maps));
        // Indices beyond the set are the last.
        let ancestors = set.resample_by(Par::Seq, |_, _, ancestors| {
            ancestors[..2].copy_from_slice(&[7, 900]);
            2
        });
        assert_eq!(ancestors, [7, 399]);
    }

    #[test]
    fn proposals_change_nothing_until_they_are_adopted() {
        let mut set = line(300);
        let before = set.clone();
        set.propose(Par::Seq, |_, states, moved| {
            moved.iter_mut().zip(states).for_each(|(moved, state)| *moved = *state * Se2::new(0.0, 1.0, 0.0));
        });
        assert!(set == before && set.proposed()[299].y() == 1.0);
        set.adopt();
        assert!(set.states()[299].y() == 1.0 && set.weights() == before.weights());
        assert!(!set.refill(5, Par::Seq, |_, states| states.fill(Se2::default()), |_| false));
        assert_eq!((set.len(), set.states()[299].y()), (300, 1.0));
    }

    #[test]
    fn states_may_be_vectors() {
        use nalgebra::Vector4;
        let mut set = ParticleSet::new(vec![Vector4::zeros(), Vector4::repeat(1.0)]).unwrap();
        set.reweigh(&[f64::NEG_INFINITY, 0.0], Par::Seq).unwrap();
        set.resample(2, &Systematic, &mut Seed(1).stream(0, 0), Par::Seq);
        assert_eq!(set.states(), [Vector4::repeat(1.0); 2]);
        assert!(ParticleSet::new(vec![Vector4::repeat(f64::NAN)]).is_err());
    }
}
