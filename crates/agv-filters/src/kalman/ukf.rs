//! The unscented Kalman filter: no Jacobians, but models evaluated at points spread around the estimate.
//!
//! `2N + 1` sigma points `x ⊞ 0, x ⊞ ±γ Lᵢ`, with `L Lᵀ = P` (Julier and Uhlmann 2004; Wan and van der Merwe 2000):
//!
//! ```text
//! λ = α² (N + κ) - N        γ = √(N + λ)        w₀ = λ / (N + λ)        w₀ᶜ = w₀ + 1 - α² + β        wᵢ = 1 / 2(N + λ)
//! ```
//!
//! Means are taken of increments from the image of the middle point, which is what makes them means on a circle or of poses
//! (Hertzberg et al. 2013). The corrected covariance is the weighted spread of the points after each is corrected by what it
//! expects, plus `K R Kᵀ`: the counterpart of Joseph's form, and a covariance whenever no weight is negative.

use super::{
    Correction, Gate, GaussianBelief, Innovation, Manifold, MeasurementModel, ProcessModel, ekf::corrected, matrix,
};
use crate::particle::semidefinite_root;
use agv_core::{Error, check};
use nalgebra::{SMatrix, SVector};

/// Where the sigma points lie and how they count.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct UkfParams {
    /// `α`: how far out the points lie, as a share of their natural distance; above zero.
    pub alpha: f64,
    /// `β`: what is known of the fourth moment; two is best for a Gaussian.
    pub beta: f64,
    /// `κ`: weight of the middle point, as a number of others; above `-N`.
    pub kappa: f64,
}

impl Default for UkfParams {
    /// The cubature points of Arasaratnam and Haykin (2009): all weights are positive, so that the covariance always is one.
    fn default() -> Self {
        Self { alpha: 1.0, beta: 0.0, kappa: 0.0 }
    }
}

/// Weights of the points, derived from the parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Weights {
    spread: f64,
    middle_mean: f64,
    middle_covariance: f64,
    other: f64,
}

impl Weights {
    fn new(params: &UkfParams, n: usize) -> Result<Self, Error> {
        check::positive("alpha", params.alpha)?;
        check::finite("beta", params.beta)?;
        let n = n as f64;
        // N + λ
        let scale = params.alpha * params.alpha * check::positive("number of states and kappa", n + params.kappa)?;
        check::positive("scale of the sigma points", scale)?;
        let middle = (scale - n) / scale;
        Ok(Self {
            spread: scale.sqrt(),
            middle_mean: middle,
            middle_covariance: middle + 1.0 - params.alpha * params.alpha + params.beta,
            other: 0.5 / scale,
        })
    }
}

/// An unscented Kalman filter for a state `X` of `N` degrees of freedom, over the same models as [`Ekf`](super::Ekf).
///
/// Needs no Jacobians (a model that is only used here may return zeros) and is exact to the third order where the extended
/// filter is to the first, for three to four times the work with three to five states. Steps that return an error, and readings beyond the gate, leave the
/// belief as it was. Nothing allocates.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::nalgebra::{Matrix3, Vector2, Vector3};
/// use agv_filters::kalman::{Gate, Landmark, PlanarPose, Ukf, UkfParams, Unicycle, UnicycleParams};
///
/// let start = PlanarPose::from(Vector3::zeros());
/// let mut ukf = Ukf::new(start, Matrix3::identity() * 0.04, &UkfParams::default())?;
/// ukf.predict(&Unicycle::new(UnicycleParams::default())?, &Twist2::new(0.5, 0.0, 0.2), 0.1)?;
/// let reflector = Landmark::new(Vector2::new(4.0, 1.0), &Vector2::new(0.05, 0.01))?;
/// let seen = ukf.update(&reflector, &Vector2::new(4.1, 0.22), &Gate::at_probability(0.999)?)?;
/// assert!(seen.accepted);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        try_from = "RawUkf<X, N>",
        bound(serialize = "X: serde::Serialize", deserialize = "X: Manifold<N> + serde::Deserialize<'de>")
    )
)]
pub struct Ukf<X, const N: usize> {
    belief: GaussianBelief<X, N>,
    params: UkfParams,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    weights: Weights,
}

/// A filter as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(bound(deserialize = "X: Manifold<N> + serde::Deserialize<'de>"))]
struct RawUkf<X, const N: usize> {
    belief: GaussianBelief<X, N>,
    params: UkfParams,
}

#[cfg(feature = "serde")]
impl<X, const N: usize> TryFrom<RawUkf<X, N>> for Ukf<X, N> {
    type Error = Error;

    fn try_from(RawUkf { belief, params }: RawUkf<X, N>) -> Result<Self, Error> {
        Ok(Self { belief, params, weights: Weights::new(&params, N)? })
    }
}

impl<X: Manifold<N>, const N: usize> Ukf<X, N> {
    /// A filter that starts at a state with this covariance.
    ///
    /// # Errors
    /// Those of [`GaussianBelief::new`]; [`Error::NotPositive`] for `alpha` or `N + kappa`, [`Error::NotFinite`].
    pub fn new(state: X, covariance: SMatrix<f64, N, N>, params: &UkfParams) -> Result<Self, Error> {
        let belief = GaussianBelief::new(state, covariance)?;
        Ok(Self { belief, params: *params, weights: Weights::new(params, N)? })
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &UkfParams {
        &self.params
    }

    /// What is known.
    pub const fn belief(&self) -> &GaussianBelief<X, N> {
        &self.belief
    }

    /// Best estimate.
    pub const fn state(&self) -> &X {
        self.belief.state()
    }

    /// Covariance of the increment from the best estimate to the truth.
    pub const fn covariance(&self) -> &SMatrix<f64, N, N> {
        self.belief.covariance()
    }

    /// The columns of `γ L`.
    fn offsets(&self) -> SMatrix<f64, N, N> {
        semidefinite_root(&self.belief.covariance) * self.weights.spread
    }

    /// Moves the belief `dt` seconds on. The noise is that at the middle point.
    ///
    /// # Errors
    /// Those of [`Ekf::predict`](super::Ekf::predict).
    pub fn predict<P: ProcessModel<X, N>>(&mut self, model: &P, control: &P::Control, dt: f64) -> Result<(), Error> {
        check::non_negative("dt", dt)?;
        let (start, w) = (&self.belief.state, &self.weights);
        let middle = model.transition(start, control, dt);
        let offsets = self.offsets();
        let images =
            Points::new(&offsets, |offset| model.transition(&start.boxplus(offset), control, dt).boxminus(&middle));
        let mean = images.sum() * w.other;
        let mut covariance = model.noise(start, control, dt);
        images.each(|_, image| add_square(&mut covariance, &(image - mean), w.other));
        add_square(&mut covariance, &mean, w.middle_covariance);
        self.belief = corrected(&middle, &mean, covariance)?;
        Ok(())
    }

    /// Corrects the belief by a reading, unless it is beyond the gate.
    ///
    /// # Errors
    /// Those of [`Ekf::update`](super::Ekf::update).
    pub fn update<const M: usize, H: MeasurementModel<X, N, M>>(
        &mut self,
        model: &H,
        measured: &H::Value,
        gate: &Gate,
    ) -> Result<Correction<M>, Error> {
        let (state, w) = (&self.belief.state, &self.weights);
        let (middle, noise) = (model.predict(state), model.noise(state));
        let offsets = self.offsets();
        let readings = Points::new(&offsets, |offset| model.residual(&model.predict(&state.boxplus(offset)), &middle));
        let mean = readings.sum() * w.other;
        let (mut spread, mut cross) = (noise, SMatrix::<f64, N, M>::zeros());
        readings.each(|offset, reading| {
            let deviation = reading - mean;
            add_square(&mut spread, &deviation, w.other);
            cross += offset * deviation.transpose() * w.other;
        });
        add_square(&mut spread, &mean, w.middle_covariance);
        let residual = model.residual(measured, &middle) - mean;
        if !matrix::is_finite(&residual) {
            return Err(Error::NotFinite { name: "innovation", value: residual.sum() });
        }
        let factor = matrix::Ldl::new("covariance of the innovation", &spread)?;
        let nis = check::finite("normalised innovation squared", factor.squared_norm(&residual))?;
        let limit = gate.limit(model.degrees());
        let accepted = nis <= limit;
        if accepted {
            let gain = factor.right_divide(&cross);
            let mut covariance = matrix::sandwich_plus(&gain, &noise, &SMatrix::zeros());
            readings.each(|offset, reading| add_square(&mut covariance, &(offset - gain * (reading - mean)), w.other));
            add_square(&mut covariance, &(gain * mean), w.middle_covariance);
            self.belief = corrected(state, &(gain * residual), covariance)?;
        }
        let innovation = Innovation { residual, covariance: spread, nis, degrees: model.degrees() };
        Ok(Correction { innovation, limit, accepted })
    }
}

/// Images of the sigma points around the middle one, in pairs.
struct Points<const N: usize, const M: usize> {
    offsets: SMatrix<f64, N, N>,
    images: [[SVector<f64, M>; 2]; N],
}

impl<const N: usize, const M: usize> Points<N, M> {
    fn new(offsets: &SMatrix<f64, N, N>, image: impl Fn(&SVector<f64, N>) -> SVector<f64, M>) -> Self {
        let images = std::array::from_fn(|i| {
            let offset = offsets.column(i).into_owned();
            [image(&offset), image(&-offset)]
        });
        Self { offsets: *offsets, images }
    }

    fn sum(&self) -> SVector<f64, M> {
        self.images.iter().flatten().sum()
    }

    /// Calls with each point's offset and image.
    fn each(&self, mut call: impl FnMut(&SVector<f64, N>, &SVector<f64, M>)) {
        for (i, [plus, minus]) in self.images.iter().enumerate() {
            let offset = self.offsets.column(i).into_owned();
            call(&offset, plus);
            call(&-offset, minus);
        }
    }
}

/// `matrix += weight v vᵀ`, symmetric to the last bit.
fn add_square<const N: usize>(matrix: &mut SMatrix<f64, N, N>, v: &SVector<f64, N>, weight: f64) {
    for j in 0..N {
        let scaled = v[j] * weight;
        for i in 0..N {
            // The same product on both sides of the diagonal.
            matrix[(i, j)] += if i < j { v[i] * weight * v[j] } else { v[i] * scaled };
        }
    }
}

#[cfg(test)]
mod tests;
