//! The Rauch–Tung–Striebel smoother: what the end of a drive says of its beginning.
//!
//! A pass backwards over what an extended filter went through (Rauch, Tung and Striebel 1965), in increments at each filtered
//! state `x`, with the prediction `x̂⁺, P̂⁺` that followed it:
//!
//! ```text
//! G = P Fᵀ (P̂⁺)⁻¹        xˢ = x ⊞ G (xˢ⁺ ⊟ x̂⁺)        Pˢ = (I - G F) P (I - G F)ᵀ + G (Pˢ⁺ + Q) Gᵀ
//! ```
//!
//! which is `P + G (Pˢ⁺ - P̂⁺) Gᵀ`, as a sum of covariances. Maps, references and the tuning of noise are made offline with it.

use super::{Correction, Ekf, Gate, GaussianBelief, Manifold, MeasurementModel, ProcessModel, ekf::corrected, matrix};
use agv_core::{Error, check};
use nalgebra::SMatrix;

/// One prediction, and what was known before and after it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        try_from = "RawStep<X, N>",
        bound(serialize = "X: serde::Serialize", deserialize = "X: Manifold<N> + serde::Deserialize<'de>")
    )
)]
struct Step<X, const N: usize> {
    before: GaussianBelief<X, N>,
    jacobian: SMatrix<f64, N, N>,
    noise: SMatrix<f64, N, N>,
    predicted: GaussianBelief<X, N>,
}

/// A step as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(bound(deserialize = "X: Manifold<N> + serde::Deserialize<'de>"))]
struct RawStep<X, const N: usize> {
    before: GaussianBelief<X, N>,
    jacobian: SMatrix<f64, N, N>,
    noise: SMatrix<f64, N, N>,
    predicted: GaussianBelief<X, N>,
}

#[cfg(feature = "serde")]
impl<X, const N: usize> TryFrom<RawStep<X, N>> for Step<X, N> {
    type Error = Error;

    fn try_from(raw: RawStep<X, N>) -> Result<Self, Error> {
        let RawStep { before, jacobian, noise, predicted } = raw;
        check::all_finite("jacobian", jacobian.iter())?;
        check::covariance("noise", &noise)?;
        Ok(Self { before, jacobian, noise, predicted })
    }
}

/// An [`Ekf`] that remembers what it went through, to be smoothed.
///
/// It grows by a step with each prediction (about a kilobyte for five states), within the memory that it was
/// [given](Self::with_capacity) or has from an earlier drive ([`restart`](Self::restart)) without allocating.
///
/// ```
/// use agv_core::nalgebra::{Matrix1, Matrix2, RowVector2, Vector1, Vector2};
/// use agv_filters::kalman::{Gate, KalmanFilter, LinearMeasurement, LinearProcess, RtsSmoother};
///
/// let process = LinearProcess::new(Matrix2::new(1.0, 0.1, 0.0, 1.0), Vector2::zeros(), Matrix2::identity() * 1e-4)?;
/// let position = LinearMeasurement::new(RowVector2::new(1.0, 0.0), Matrix1::new(1e-2))?;
/// let mut smoother = RtsSmoother::new(KalmanFilter::new(Vector2::zeros(), Matrix2::identity())?);
/// for step in 1..=50 {
///     smoother.predict(&process, &Vector1::zeros(), 0.1)?;
///     smoother.update(&position, &Vector1::new(0.05 * f64::from(step)), &Gate::OPEN)?;
/// }
/// let smoothed = smoother.smooth()?;
/// assert_eq!(smoothed.len(), 51);
/// // The speed was not known at the beginning.
/// assert!((smoothed[0].state()[1] - 0.5).abs() < 0.1 && smoothed[0].sigma(1) < 0.1);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(serialize = "X: serde::Serialize", deserialize = "X: Manifold<N> + serde::Deserialize<'de>"))
)]
pub struct RtsSmoother<X, const N: usize> {
    ekf: Ekf<X, N>,
    steps: Vec<Step<X, N>>,
}

impl<X: Manifold<N>, const N: usize> RtsSmoother<X, N> {
    /// A smoother over what this filter will go through.
    pub const fn new(ekf: Ekf<X, N>) -> Self {
        Self { ekf, steps: Vec::new() }
    }

    /// The same smoother with room for as many predictions in all.
    #[must_use]
    pub fn with_capacity(mut self, predictions: usize) -> Self {
        self.steps.reserve(predictions.saturating_sub(self.steps.len()));
        self
    }

    /// Forgets the drive and begins another one with this filter; the memory is kept.
    pub fn restart(&mut self, ekf: Ekf<X, N>) {
        self.steps.clear();
        self.ekf = ekf;
    }

    /// The filter as it stands.
    pub const fn filter(&self) -> &Ekf<X, N> {
        &self.ekf
    }

    /// As [`Ekf::predict`].
    ///
    /// # Errors
    /// Those of [`Ekf::predict`]; nothing is remembered then.
    pub fn predict<P: ProcessModel<X, N>>(&mut self, model: &P, control: &P::Control, dt: f64) -> Result<(), Error> {
        check::non_negative("dt", dt)?;
        let before = *self.ekf.belief();
        let moved = model.linearize(before.state(), control, dt);
        self.ekf.advance(&moved)?;
        let predicted = *self.ekf.belief();
        self.steps.push(Step { before, jacobian: moved.jacobian, noise: moved.noise, predicted });
        Ok(())
    }

    /// As [`Ekf::update`].
    ///
    /// # Errors
    /// Those of [`Ekf::update`].
    pub fn update<const M: usize, H: MeasurementModel<X, N, M>>(
        &mut self,
        model: &H,
        measured: &H::Value,
        gate: &Gate,
    ) -> Result<Correction<M>, Error> {
        self.ekf.update(model, measured, gate)
    }

    /// Beliefs given all readings: at the start and after each prediction, in order of time.
    ///
    /// # Errors
    /// Those of [`smooth_into`](Self::smooth_into).
    pub fn smooth(&self) -> Result<Vec<GaussianBelief<X, N>>, Error> {
        let mut smoothed = Vec::new();
        self.smooth_into(&mut smoothed)?;
        Ok(smoothed)
    }

    /// As [`smooth`](Self::smooth), into memory of the caller's.
    ///
    /// What is known exactly, as a bias that was given with no variance, stays as it is.
    ///
    /// # Errors
    /// [`Error::NotFinite`] or [`Error::NotCovariance`] where rounding has left nothing to believe; nothing is written then.
    pub fn smooth_into(&self, smoothed: &mut Vec<GaussianBelief<X, N>>) -> Result<(), Error> {
        smoothed.clear();
        let mut later = *self.ekf.belief();
        smoothed.push(later);
        for step in self.steps.iter().rev() {
            later = step.smooth(&later).inspect_err(|_| smoothed.clear())?;
            smoothed.push(later);
        }
        smoothed.reverse();
        Ok(())
    }
}

impl<X: Manifold<N>, const N: usize> Step<X, N> {
    fn smooth(&self, later: &GaussianBelief<X, N>) -> Result<GaussianBelief<X, N>, Error> {
        let spread = &self.before.covariance;
        let cross = matrix::times_transposed(spread, &self.jacobian);
        let gain = matrix::Ldl::of_semidefinite(&self.predicted.covariance).right_divide(&cross);
        let increment = gain * later.state.boxminus(&self.predicted.state);
        let kept = SMatrix::<f64, N, N>::identity() - gain * self.jacobian;
        let learnt = matrix::sandwich_plus(&gain, &(later.covariance + self.noise), &SMatrix::zeros());
        corrected(&self.before.state, &increment, matrix::sandwich_plus(&kept, spread, &learnt))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{
        KalmanFilter, Landmark, LinearMeasurement, LinearProcess, PlanarPose, Unicycle, UnicycleParams,
    };
    use agv_core::{compute::Seed, geometry::Twist2, metrics::chi_square_quantile};
    use nalgebra::{Matrix1, Matrix2, Matrix3, RowVector2, Vector1, Vector2, Vector3};
    use rand_distr::{Distribution, StandardNormal};

    /// Against the least-squares solution over the whole drive at once: three states of two components, solved as a system of
    /// six by its normal equations.
    #[test]
    fn smoothed_states_are_those_of_the_whole_problem() {
        let (f, q) = (Matrix2::new(1.0, 0.5, -0.1, 0.9), Matrix2::new(0.2, 0.05, 0.05, 0.1));
        let (h, r) = (RowVector2::new(1.0, 0.3), Matrix1::new(0.4));
        let (start, prior) = (Vector2::new(0.5, -1.0), Matrix2::new(1.0, 0.3, 0.3, 2.0));
        let readings = [0.7, -0.4];
        let process = LinearProcess::new(f, Vector2::zeros(), q).unwrap();
        let mut smoother = RtsSmoother::new(KalmanFilter::new(start, prior).unwrap());
        for reading in readings {
            smoother.predict(&process, &Vector1::zeros(), 0.1).unwrap();
            let model = LinearMeasurement::new(h, r).unwrap();
            smoother.update(&model, &Vector1::new(reading), &Gate::OPEN).unwrap();
        }
        let mut information = SMatrix::<f64, 6, 6>::zeros();
        let mut vector = nalgebra::Vector6::zeros();
        let prior = prior.try_inverse().unwrap();
        let mut add = |row: usize, column: usize, block: Matrix2<f64>| {
            let mut view = information.fixed_view_mut::<2, 2>(2 * row, 2 * column);
            view += block;
        };
        add(0, 0, prior);
        vector.fixed_rows_mut::<2>(0).copy_from(&(prior * start));
        let weight = q.try_inverse().unwrap();
        for (step, reading) in readings.iter().enumerate() {
            add(step, step, f.transpose() * weight * f);
            add(step, step + 1, -f.transpose() * weight);
            add(step + 1, step, -weight * f);
            add(step + 1, step + 1, weight + h.transpose() * h / 0.4);
            vector.fixed_rows_mut::<2>(2 * step + 2).copy_from(&(h.transpose() * *reading / 0.4));
        }
        let covariance = information.try_inverse().unwrap();
        let states = covariance * vector;
        for (index, smoothed) in smoother.smooth().unwrap().iter().enumerate() {
            assert!((smoothed.state() - states.fixed_rows::<2>(2 * index)).amax() < 1e-12, "{index}");
            let block = covariance.fixed_view::<2, 2>(2 * index, 2 * index);
            assert!((smoothed.covariance() - block).amax() < 1e-12, "{index}");
        }
    }

    /// Errors in the middle of a drive, over 200 runs of the model: as large as stated, and less than the filter's.
    #[test]
    fn smoothed_errors_are_as_large_as_stated() {
        let sigmas = Vector2::new(0.05, 0.02);
        let drive =
            Unicycle::new(UnicycleParams { forward_density: 0.05, yaw_density: 0.05, ..Default::default() }).unwrap();
        let beacon = Landmark::new(Vector2::new(3.0, 1.0), &sigmas).unwrap();
        let (mut nees, mut filtered, mut smoothed, runs) = (0.0, 0.0, 0.0, 200);
        for run in 0..runs {
            let mut stream = Seed(run).stream(0, 0);
            let start = PlanarPose::from(Vector3::new(0.5, 0.2, 3.0));
            let mut smoother = RtsSmoother::new(Ekf::new(start, Matrix3::identity() * 1e-4).unwrap());
            let unit = Vector3::from_fn(|_, _| StandardNormal.sample(&mut stream));
            let mut truths = vec![start.boxplus(&(unit * 0.01))];
            for _ in 0..40 {
                let twist = Twist2::new(0.5, 0.0, 0.8);
                let truth = drive.sample(&truths[truths.len() - 1], &twist, 0.1, &mut stream);
                let noise = Vector2::from_fn(|_, _| StandardNormal.sample(&mut stream)).component_mul(&sigmas);
                smoother.predict(&drive, &twist, 0.1).unwrap();
                smoother.update(&beacon, &(beacon.predict(&truth) + noise), &Gate::OPEN).unwrap();
                truths.push(truth);
            }
            let states = smoother.smooth().unwrap();
            nees += states[20].nees(&truths[20]).unwrap();
            smoothed += truths[20].boxminus(states[20].state()).norm_squared();
            filtered += truths[20].boxminus(smoother.steps[20].before.state()).norm_squared();
        }
        let [low, high] = [1e-4, 1.0 - 1e-4].map(|p| chi_square_quantile(3.0 * runs as f64, p).unwrap());
        assert!(nees > low && nees < high, "NEES {nees} not in {low}..{high}");
        assert!(smoothed < 0.8 * filtered, "{smoothed} {filtered}");
    }

    #[test]
    fn what_is_known_exactly_stays_and_bad_steps_are_not_remembered() {
        let process =
            LinearProcess::new(Matrix2::new(1.0, 1.0, 0.0, 1.0), Vector2::zeros(), Matrix2::new(0.1, 0.0, 0.0, 0.0))
                .unwrap();
        let position = LinearMeasurement::new(RowVector2::new(1.0, 0.0), Matrix1::new(0.1)).unwrap();
        let known = Matrix2::new(1.0, 0.0, 0.0, 0.0);
        let mut smoother = RtsSmoother::new(KalmanFilter::new(Vector2::new(0.0, 0.3), known).unwrap());
        for _ in 0..5 {
            smoother.predict(&process, &Vector1::zeros(), 0.1).unwrap();
            smoother.update(&position, &Vector1::new(1.0), &Gate::OPEN).unwrap();
        }
        assert!(smoother.predict(&process, &Vector1::new(f64::NAN), 0.1).is_err());
        assert!(smoother.predict(&process, &Vector1::zeros(), -0.1).is_err());
        let smoothed = smoother.smooth().unwrap();
        assert_eq!(smoothed.len(), 6);
        assert!(smoothed.iter().all(|belief| belief.state()[1] == 0.3 && belief.sigma(1) == 0.0));
    }
}
