//! A particle filter over the models of the Kalman filters.
//!
//! The bootstrap filter of Gordon, Salmond and Smith (1993): particles move by draws of the process model
//! ([`ProcessModel::sample`]), are weighed by the likelihood of the reading ([`MeasurementModel::log_likelihood`]) and drawn
//! anew where their weights have become uneven. What it is for: noise that is not Gaussian, readings that leave more than one
//! place, and the judgement of the other filters.

use super::{GaussianBelief, Manifold, MeasurementModel, ProcessModel};
#[cfg(feature = "serde")]
use crate::particle::ParticleState;
use crate::particle::{
    EffectiveSampleSizeBelow, ParticleSet, ResampleContext, ResamplePolicy, Resampler, Systematic, WeightSummary,
    semidefinite_root,
};
use agv_core::{
    Error, check,
    compute::{CHUNK, Par, Seed},
    geometry::Se2,
};
use nalgebra::{SMatrix, SVector};
use rand_distr::{Distribution, StandardNormal};

/// A bootstrap filter for a state `X` of `N` degrees of freedom.
///
/// Nothing allocates after construction. The same seed and the same calls give the same bits for any number of threads.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Twist2;
/// use agv_core::nalgebra::{Matrix3, Vector2, Vector3};
/// use agv_filters::kalman::{BootstrapFilter, GaussianBelief, Landmark, PlanarPose, Unicycle, UnicycleParams};
///
/// let start = PlanarPose::from(Vector3::zeros());
/// let belief = GaussianBelief::new(start, Matrix3::identity() * 0.04)?;
/// let mut filter = BootstrapFilter::around(&belief, 1000, Seed(7))?;
/// filter.predict(&Unicycle::new(UnicycleParams::default())?, &Twist2::new(0.5, 0.0, 0.2), 0.1)?;
/// let reflector = Landmark::new(Vector2::new(4.0, 1.0), &Vector2::new(0.05, 0.02))?;
/// let weights = filter.update(&reflector, &Vector2::new(4.1, 0.22))?.expect("some particle explains it");
/// assert!(weights.effective_sample_size > 10.0);
/// assert!(filter.estimate()?.sigma(0) < 0.2);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// A filter that was stored goes on with the same bits.
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        from = "RawFilter<X, R, P>",
        bound(
            serialize = "X: ParticleState + serde::Serialize, R: serde::Serialize, P: serde::Serialize",
            deserialize = "X: ParticleState + serde::Deserialize<'de>, R: serde::Deserialize<'de>, P: serde::Deserialize<'de>"
        )
    )
)]
pub struct BootstrapFilter<X, const N: usize, R = Systematic, P = EffectiveSampleSizeBelow> {
    particles: ParticleSet<X>,
    resampler: R,
    policy: P,
    /// Scratch, as long as the set's capacity.
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    log_likelihoods: Vec<f64>,
    seed: Seed,
    step: u64,
    /// Updates since the particles were last drawn anew.
    updates: u64,
    par: Par,
}

/// A filter as it is stored.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(bound(
    deserialize = "X: ParticleState + serde::Deserialize<'de>, R: serde::Deserialize<'de>, P: serde::Deserialize<'de>"
))]
struct RawFilter<X, R, P> {
    particles: ParticleSet<X>,
    resampler: R,
    policy: P,
    seed: Seed,
    step: u64,
    updates: u64,
    par: Par,
}

#[cfg(feature = "serde")]
impl<X: ParticleState, const N: usize, R, P> From<RawFilter<X, R, P>> for BootstrapFilter<X, N, R, P> {
    fn from(raw: RawFilter<X, R, P>) -> Self {
        let RawFilter { particles, resampler, policy, seed, step, updates, par } = raw;
        let log_likelihoods = vec![0.0; particles.capacity()];
        Self { particles, resampler, policy, log_likelihoods, seed, step, updates, par }
    }
}

impl<X: Manifold<N>, const N: usize> BootstrapFilter<X, N> {
    /// A filter of `count` particles, drawn from a Gaussian.
    ///
    /// # Errors
    /// Those of [`ParticleSet::new`].
    pub fn around(belief: &GaussianBelief<X, N>, count: usize, seed: Seed) -> Result<Self, Error> {
        ParticleSet::check_count(count)?;
        let root = semidefinite_root(belief.covariance());
        let mut stream = seed.derive(Part::Start as u64).stream(0, 0);
        let draw = |_| {
            let unit = SVector::<f64, N>::from_fn(|_, _| StandardNormal.sample(&mut stream));
            belief.state().boxplus(&(root * unit))
        };
        Ok(Self::new(ParticleSet::new((0..count).map(draw).collect())?, seed))
    }

    /// A filter over particles of the caller's, which resamples systematically below half of the effective sample size.
    pub fn new(particles: ParticleSet<X>, seed: Seed) -> Self {
        Self {
            log_likelihoods: vec![0.0; particles.capacity()],
            particles,
            resampler: Systematic,
            policy: EffectiveSampleSizeBelow::default(),
            seed,
            step: 0,
            updates: 0,
            par: Par::Seq,
        }
    }
}

/// What random numbers are drawn for.
#[derive(Debug, Clone, Copy)]
enum Part {
    Start,
    Motion,
    Resampling,
}

impl<X, const N: usize, R, P> BootstrapFilter<X, N, R, P> {
    /// The same filter with another way to draw new particles, and another rule when to.
    pub fn with_resampling<S: Resampler, Q: ResamplePolicy>(
        self,
        resampler: S,
        policy: Q,
    ) -> BootstrapFilter<X, N, S, Q> {
        let Self { particles, log_likelihoods, seed, step, updates, par, .. } = self;
        BootstrapFilter { particles, resampler, policy, log_likelihoods, seed, step, updates, par }
    }

    /// The same filter with its loops on this many threads.
    pub fn with_parallelism(self, par: Par) -> Self {
        Self { par, ..self }
    }

    /// The particles.
    pub const fn particles(&self) -> &ParticleSet<X> {
        &self.particles
    }
}

impl<X: Manifold<N>, const N: usize, R: Resampler, P: ResamplePolicy> BootstrapFilter<X, N, R, P> {
    /// Moves each particle `dt` seconds on by a draw of the model.
    ///
    /// # Errors
    /// [`Error::Negative`] for a `dt` below zero or not finite; [`Error::NotFinite`] if a particle would not be. The particles
    /// are then as they were.
    pub fn predict<F>(&mut self, model: &F, control: &F::Control, dt: f64) -> Result<(), Error>
    where
        F: ProcessModel<X, N> + Sync,
        F::Control: Sync,
    {
        check::non_negative("dt", dt)?;
        let (seed, step) = (self.seed.derive(Part::Motion as u64), self.step);
        self.particles.propose(self.par, |chunk, states, moved| {
            let mut stream = seed.stream(step, chunk as u64);
            for (moved, state) in moved.iter_mut().zip(states) {
                *moved = model.sample(state, control, dt, &mut stream);
            }
        });
        if self.particles.proposed().iter().any(|state| !state.is_finite()) {
            return Err(Error::NotFinite { name: "particle", value: f64::NAN });
        }
        self.particles.adopt();
        self.step += 1;
        Ok(())
    }

    /// Weighs the particles by a reading, and draws new ones if the policy asks for it. Returns the weights before that; none,
    /// with the particles as they were, if no particle explains the reading at all.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if a likelihood is no number, as that of a reading is that is none. The particles are then as they
    /// were.
    pub fn update<const M: usize, H>(&mut self, model: &H, measured: &H::Value) -> Result<Option<WeightSummary>, Error>
    where
        H: MeasurementModel<X, N, M> + Sync,
        H::Value: Sync,
    {
        let count = self.particles.len();
        let log_likelihoods = &mut self.log_likelihoods[..count];
        let data = (&mut log_likelihoods[..], self.particles.states());
        self.par.for_each_chunk(data, CHUNK, |_, (values, states): (&mut [f64], &[X])| {
            for (value, state) in values.iter_mut().zip(states) {
                *value = model.log_likelihood(state, measured);
            }
        });
        if log_likelihoods.iter().any(|value| value.is_nan()) {
            return Err(Error::NotFinite { name: "log-likelihood", value: f64::NAN });
        }
        let Some(weights) = self.particles.reweigh(log_likelihoods, self.par) else { return Ok(None) };
        self.updates += 1;
        if self.policy.is_due(&ResampleContext::new(weights, count, self.updates, Se2::default())) {
            let mut stream = self.seed.derive(Part::Resampling as u64).stream(self.step, 0);
            self.particles.resample(count, &self.resampler, &mut stream, self.par);
            self.step += 1;
            self.updates = 0;
        }
        Ok(Some(weights))
    }

    /// Mean and covariance of the particles: the state from which their increments have the mean zero.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if the particles are too far apart for their squares to be numbers.
    pub fn estimate(&self) -> Result<GaussianBelief<X, N>, Error> {
        let (states, weights) = (self.particles.states(), self.particles.weights());
        let mut mean = states.first().copied().ok_or(Error::Empty { name: "particles" })?;
        let mut scatter = SMatrix::<f64, N, N>::zeros();
        for _ in 0..MOST_PASSES {
            let (mut offset, mut squares) = (SVector::<f64, N>::zeros(), SMatrix::<f64, N, N>::zeros());
            for (state, &weight) in states.iter().zip(weights) {
                let increment = state.boxminus(&mean);
                offset += increment * weight;
                squares += increment * increment.transpose() * weight;
            }
            scatter = squares - offset * offset.transpose();
            mean = mean.boxplus(&offset);
            if (0..N).all(|i| offset[i] * offset[i] <= 1e-18 * squares[(i, i)]) {
                break;
            }
        }
        // Rounding, and increments that bend, may leave the difference of the squares slightly indefinite.
        GaussianBelief::new(mean, scatter).or_else(|_| {
            check::all_finite("covariance of the particles", scatter.iter())?;
            let root = semidefinite_root(&scatter);
            GaussianBelief::new(mean, root * root.transpose())
        })
    }
}

/// Passes over the particles until their mean has settled; vectors need two.
const MOST_PASSES: usize = 20;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Ekf, Gate, LinearMeasurement, LinearProcess, PlanarPose, YawReading};
    use crate::particle::EveryNth;
    use nalgebra::{Matrix1, Matrix2, Matrix3, RowVector2, Vector1, Vector2, Vector3};

    fn models() -> (LinearProcess<2, 1>, LinearMeasurement<2, 1>) {
        let process =
            LinearProcess::new(Matrix2::new(1.0, 0.1, 0.0, 1.0), Vector2::zeros(), Matrix2::identity() * 1e-3);
        (process.unwrap(), LinearMeasurement::new(RowVector2::new(1.0, 0.0), Matrix1::new(0.04)).unwrap())
    }

    /// Of linear models with Gaussian noise the exact answer is Kalman's. The mean of n particles is off by about σ/√n, with
    /// resampling a few times that; the bound is six.
    #[test]
    fn linear_models_are_kalmans() {
        let (process, model) = models();
        let mut ekf = Ekf::new(Vector2::new(0.0, 1.0), Matrix2::identity() * 0.1).unwrap();
        let mut filter = BootstrapFilter::around(ekf.belief(), 20_000, Seed(3)).unwrap();
        for step in 0..20 {
            let reading = Vector1::new(0.1 * f64::from(step));
            ekf.predict(&process, &Vector1::zeros(), 0.1).unwrap();
            ekf.update(&model, &reading, &Gate::OPEN).unwrap();
            filter.predict(&process, &Vector1::zeros(), 0.1).unwrap();
            filter.update(&model, &reading).unwrap().unwrap();
        }
        let estimate = filter.estimate().unwrap();
        for i in 0..2 {
            let sigma = ekf.belief().sigma(i);
            let off = (estimate.state()[i] - ekf.state()[i]) / sigma;
            assert!(off.abs() < 6.0 / 20_000_f64.sqrt(), "{i}: {off}");
            assert!((estimate.sigma(i) / sigma - 1.0).abs() < 0.05, "{i}: {} {sigma}", estimate.sigma(i));
        }
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let (process, model) = models();
        let belief = GaussianBelief::new(Vector2::new(0.0, 1.0), Matrix2::identity() * 0.1).unwrap();
        let run = |par: Par| {
            let mut filter = BootstrapFilter::around(&belief, 1500, Seed(3)).unwrap().with_parallelism(par);
            for _ in 0..5 {
                filter.predict(&process, &Vector1::zeros(), 0.1).unwrap();
                filter.update(&model, &Vector1::new(0.3)).unwrap().unwrap();
            }
            filter.particles().clone()
        };
        assert!(run(Par::Seq) == run(Par::threads(3)));
    }

    #[test]
    fn headings_are_averaged_on_the_circle() {
        let belief =
            GaussianBelief::new(PlanarPose::from(Vector3::new(1.0, 2.0, 3.1)), Matrix3::identity() * 0.04).unwrap();
        let filter = BootstrapFilter::around(&belief, 4000, Seed(1)).unwrap();
        let estimate = filter.estimate().unwrap();
        let off = estimate.state().boxminus(belief.state());
        assert!(off.amax() < 5.0 * 0.2 / 4000_f64.sqrt(), "{off}");
        assert!((estimate.covariance() - belief.covariance()).amax() < 0.04 * 5.0 * (2.0_f64 / 4000.0).sqrt());
        let policy = filter.with_resampling(Systematic, EveryNth(1));
        assert_eq!(policy.particles().len(), 4000);
    }

    #[test]
    fn bad_input_changes_nothing() {
        let (process, model) = models();
        let belief = GaussianBelief::new(Vector2::zeros(), Matrix2::identity()).unwrap();
        assert!(BootstrapFilter::around(&belief, 0, Seed(1)).is_err());
        let mut filter = BootstrapFilter::around(&belief, 300, Seed(1)).unwrap();
        let before = filter.particles().clone();
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(filter.predict(&process, &Vector1::zeros(), bad).is_err());
            assert!(filter.update(&model, &Vector1::new(f64::NAN)).is_err());
        }
        let nothing =
            LinearProcess::new(Matrix2::identity() * f64::MAX, Vector2::zeros(), Matrix2::identity()).unwrap();
        assert!(filter.predict(&nothing, &Vector1::zeros(), 0.1).is_err());
        assert_eq!(filter.update(&model, &Vector1::new(f64::INFINITY)), Ok(None));
        assert!(*filter.particles() == before);
        let pose = GaussianBelief::new(PlanarPose::from(Vector3::zeros()), Matrix3::identity()).unwrap();
        let mut poses = BootstrapFilter::around(&pose, 10, Seed(1)).unwrap();
        assert!(poses.update(&YawReading::new(0.1).unwrap(), &f64::NAN).is_err());
    }
}
