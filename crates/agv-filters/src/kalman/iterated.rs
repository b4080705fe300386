//! The iterated update: the reading is linearised again where the correction leads, until it leads nowhere else.
//!
//! A Gauss–Newton iteration for the most probable state (Bell and Cathey 1993; Bar-Shalom, Li and Kirubarajan 2001, section
//! 10.5.2), with `δ` the increment from the prediction `x̂` and `J` the reset's Jacobian at `δ`:
//!
//! ```text
//! x = x̂ ⊞ δ        H = ∂h/∂x J        K = P Hᵀ (H P Hᵀ + R)⁻¹        δ ← K (z ⊟ h(x) + H δ)
//! ```
//!
//! Worth its price where the reading is bent over the width of the belief: a landmark near by, seen more precisely than
//! the pose is known. The gate is asked about the first innovation, that of the prediction.

use super::{Correction, Ekf, Gate, Manifold, MeasurementModel, ekf::corrected, innovation::Surprise, matrix};
use agv_core::{Error, check};
use nalgebra::SVector;

/// When an iterated update ends.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct IterationParams {
    /// Most times that the reading is linearised, at least one; one is the plain update.
    pub max_iterations: usize,
    /// Change of the state, as a share of the standard deviation that each component had before the reading, below which
    /// nothing more is gained.
    pub tolerance: f64,
}

impl Default for IterationParams {
    /// Ten, of which a reading needs two to five; a thousandth of a deviation.
    fn default() -> Self {
        Self { max_iterations: 10, tolerance: 1e-3 }
    }
}

/// What became of a reading that was linearised repeatedly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IteratedCorrection<const M: usize> {
    /// Innovation of the prediction, and whether the belief has taken it in.
    pub correction: Correction<M>,
    /// How often the reading was linearised.
    pub iterations: usize,
    /// Whether the last iteration changed less than the tolerance.
    pub converged: bool,
}

impl<X: Manifold<N>, const N: usize> Ekf<X, N> {
    /// As [`update`](Self::update), linearised anew where each iteration leads.
    ///
    /// An iteration that does not settle is used as far as it came, and reported.
    ///
    /// ```
    /// use agv_core::geometry::Se2;
    /// use agv_core::nalgebra::{Matrix3, Vector2};
    /// use agv_filters::kalman::{Ekf, Gate, IterationParams, Landmark};
    ///
    /// // A pose known to a metre sees a pillar 2 m ahead, to a centimetre and half a degree.
    /// let pillar = Landmark::new(Vector2::new(2.0, 0.0), &Vector2::new(0.01, 0.01))?;
    /// let mut ekf = Ekf::new(Se2::default(), Matrix3::identity())?;
    /// let seen = ekf.update_iterated(&pillar, &Vector2::new(1.2, 0.9), &Gate::OPEN, &IterationParams::default())?;
    /// assert!(seen.converged);
    /// assert!((ekf.state().between(&Se2::new(2.0, 0.0, 0.0)).translation().norm() - 1.2).abs() < 0.01);
    /// # use agv_core::geometry::LieGroup;
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// Those of [`update`](Self::update); [`Error::Empty`] for no iterations, [`Error::Negative`] for the tolerance.
    pub fn update_iterated<const M: usize, H: MeasurementModel<X, N, M>>(
        &mut self,
        model: &H,
        measured: &H::Value,
        gate: &Gate,
        params: &IterationParams,
    ) -> Result<IteratedCorrection<M>, Error> {
        if params.max_iterations == 0 {
            return Err(Error::Empty { name: "iterations" });
        }
        check::non_negative("tolerance", params.tolerance)?;
        let (state, covariance) = (self.state(), self.covariance());
        let mut surprise = Surprise::new(state, covariance, model, measured)?;
        let innovation = surprise.innovation;
        let limit = gate.limit(innovation.degrees);
        let accepted = innovation.nis <= limit;
        let correction = Correction { innovation, limit, accepted };
        if !accepted {
            return Ok(IteratedCorrection { correction, iterations: 1, converged: true });
        }
        let mut gain = surprise.factor.right_divide(&surprise.cross);
        let mut increment = gain * innovation.residual;
        let (mut iterations, mut converged) = (1, params.max_iterations == 1);
        while iterations < params.max_iterations && !converged {
            surprise = Surprise::after(state, &increment, covariance, model, measured)?;
            gain = surprise.factor.right_divide(&surprise.cross);
            let next = gain * (surprise.innovation.residual + surprise.jacobian * increment);
            converged = is_settled(&(next - increment), covariance, params.tolerance);
            increment = next;
            iterations += 1;
        }
        let spread = matrix::joseph(covariance, &surprise.cross, &surprise.jacobian, &surprise.noise, &gain);
        *self = corrected(state, &increment, spread)?.into();
        Ok(IteratedCorrection { correction, iterations, converged })
    }
}

/// Whether all components change by less than a share of their deviations.
fn is_settled<const N: usize>(
    change: &SVector<f64, N>,
    covariance: &nalgebra::SMatrix<f64, N, N>,
    tolerance: f64,
) -> bool {
    (0..N).all(|i| change[i] * change[i] <= tolerance * tolerance * covariance[(i, i)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Landmark, LinearMeasurement, PlanarPose};
    use agv_core::geometry::{LieGroup, Se2};
    use nalgebra::{Matrix1, Matrix2, Matrix3, RowVector2, Vector1, Vector2, Vector3};
    use proptest::prelude::*;

    proptest! {
        /// It ends where the probability is greatest: no small step in any direction improves the sum of the squares.
        #[test]
        fn the_most_probable_state_is_found(range in 1.0..3.0_f64, bearing in -1.0..1.0_f64, yaw in -3.0..3.0_f64) {
            let pillar = Landmark::new(Vector2::new(2.0, 0.0), &Vector2::new(0.02, 0.02)).unwrap();
            let (start, spread) = (Se2::new(0.0, 0.0, yaw), Matrix3::identity() * 0.09);
            let measured = Vector2::new(range, agv_core::geometry::wrap_angle(bearing * 0.3 - yaw));
            let mut ekf = Ekf::new(start, spread).unwrap();
            let params = IterationParams { max_iterations: 50, tolerance: 1e-9 };
            let seen = ekf.update_iterated(&pillar, &measured, &Gate::OPEN, &params).unwrap();
            prop_assert!(seen.converged);
            let cost = |pose: &Se2| {
                let d = pose.minus(&start);
                let r = MeasurementModel::<Se2, 3, 2>::residual(&pillar, &measured, &pillar.predict(pose));
                d.norm_squared() / 0.09 + r.norm_squared() / 4e-4
            };
            let best = cost(ekf.state());
            for direction in 0..3 {
                for step in [-1e-4, 1e-4] {
                    let mut increment = Vector3::zeros();
                    increment[direction] = step;
                    prop_assert!(cost(&ekf.state().plus(&increment)) >= best - 1e-9);
                }
            }
        }
    }

    #[test]
    fn one_iteration_and_linear_readings_are_the_plain_update() {
        let model = LinearMeasurement::new(RowVector2::new(1.0, 0.5), Matrix1::new(0.1)).unwrap();
        let start = Ekf::new(Vector2::new(1.0, 2.0), Matrix2::new(1.0, 0.2, 0.2, 0.5)).unwrap();
        let (mut plain, mut iterated) = (start, start);
        plain.update(&model, &Vector1::new(3.0), &Gate::OPEN).unwrap();
        let seen =
            iterated.update_iterated(&model, &Vector1::new(3.0), &Gate::OPEN, &IterationParams::default()).unwrap();
        assert!(seen.converged && seen.iterations == 2);
        assert!((plain.state() - iterated.state()).amax() < 1e-14);

        let pillar = Landmark::new(Vector2::new(2.0, 0.0), &Vector2::new(0.02, 0.02)).unwrap();
        let start = Ekf::new(PlanarPose::from(Vector3::zeros()), Matrix3::identity()).unwrap();
        let (mut plain, mut once) = (start, start);
        plain.update(&pillar, &Vector2::new(1.5, 0.4), &Gate::OPEN).unwrap();
        let params = IterationParams { max_iterations: 1, ..Default::default() };
        once.update_iterated(&pillar, &Vector2::new(1.5, 0.4), &Gate::OPEN, &params).unwrap();
        assert_eq!(plain, once);
    }

    #[test]
    fn bad_parameters_and_outliers_change_nothing() {
        let pillar = Landmark::new(Vector2::new(2.0, 0.0), &Vector2::new(0.02, 0.02)).unwrap();
        let mut ekf = Ekf::new(Se2::default(), Matrix3::identity() * 0.01).unwrap();
        let (before, reading) = (ekf, Vector2::new(2.0, 0.0));
        let none = IterationParams { max_iterations: 0, ..Default::default() };
        assert!(ekf.update_iterated(&pillar, &reading, &Gate::OPEN, &none).is_err());
        for tolerance in [-1.0, f64::NAN] {
            let params = IterationParams { tolerance, ..Default::default() };
            assert!(ekf.update_iterated(&pillar, &reading, &Gate::OPEN, &params).is_err());
        }
        let gate = Gate::at_probability(0.99).unwrap();
        let far = ekf.update_iterated(&pillar, &Vector2::new(9.0, 0.0), &gate, &IterationParams::default()).unwrap();
        assert!(!far.correction.accepted);
        assert!(
            ekf.update_iterated(&pillar, &Vector2::new(f64::NAN, 0.0), &gate, &IterationParams::default()).is_err()
        );
        assert_eq!(ekf, before);
    }
}
