//! The vehicle beside its path, as a linear model by speed, with the feedback that is optimal for it.
//!
//! With `y` to the left of the path, the heading error `θ` and the excess `r = ω - v κ` of the turn rate, which follows its
//! command `u` with the actuators' lag `τ`,
//!
//! ```text
//! y' = v θ        θ' = r        r' = (u - r) / τ        [z' = y]
//! minimise ∫ (y / y₀)² + (θ / θ₀)² + (u / (v κ₀))² [+ (z / z₀)²] dt
//! ```
//!
//! The input is weighed as a curvature, so that the way back to the path has the same shape at every speed, up to where the lag
//! forbids it. The model is sampled exactly; Riccati equations are solved at construction at evenly spaced speeds, and
//! gains and costs to go are interpolated between.

use super::riccati::{Regulator, riccati};
use crate::Error;
use agv_core::check;
use nalgebra::{Matrix3, Matrix4, RowVector4, SMatrix, SVector, Vector3, Vector4};

/// Errors and effort that are worth the same.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TrackingWeights {
    /// Cross-track error, in metres.
    pub cross_track: f64,
    /// Heading error, in radians.
    pub heading: f64,
    /// Curvature beyond that of the path, in 1/m.
    pub curvature: f64,
    /// Integrated cross-track error, in metre seconds; none for no integral action.
    pub integral: Option<f64>,
}

impl Default for TrackingWeights {
    /// Five centimetres are worth a curvature of 1/m and 20°, which leads back within about half a metre; no integral action: the slip
    /// of the turn rate, which it would be for, is estimated.
    fn default() -> Self {
        Self { cross_track: 0.05, heading: 0.35, curvature: 1.0, integral: None }
    }
}

impl TrackingWeights {
    fn validate(&self) -> Result<(), agv_core::Error> {
        check::positive("cross_track", self.cross_track)?;
        check::positive("heading", self.heading)?;
        check::positive("curvature", self.curvature)?;
        self.integral.map_or(Ok(()), |worth| check::positive("integral", worth).map(|_| ()))
    }

    /// Costs of `y`, `θ` and the turn rate at a speed.
    pub(super) fn costs(&self, speed: f64) -> [f64; 3] {
        [self.cross_track, self.heading, self.curvature * speed.max(LEAST_SPEED)].map(|worth| 1.0 / (worth * worth))
    }
}

/// Speed below which the gains fall to zero: a vehicle at rest cannot get to its path, however it turns.
pub(super) const LEAST_SPEED: f64 = 0.1;

/// Intervals of the table.
const INTERVALS: usize = 32;

/// Integrals over a step of what decays with the lag, and of what follows a held command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sampled {
    pub(super) dt: f64,
    /// Share of the old value at the end of the step.
    pub(super) kept: f64,
    /// `∫` of the old value and of the command, in seconds.
    pub(super) once: [f64; 2],
    /// `∫∫` of them, in seconds squared.
    pub(super) twice: [f64; 2],
}

impl Sampled {
    pub(super) fn new(lag: f64, dt: f64) -> Self {
        let kept = if lag > 0.0 { (-dt / lag).exp() } else { 0.0 };
        let once = lag * (1.0 - kept);
        let twice = lag * (dt - once);
        Self { dt, kept, once: [once, dt - once], twice: [twice, 0.5 * dt * dt - twice] }
    }
}

/// `x⁺ = A x + B u` for `(y, θ, r, z)` at a speed.
pub(super) fn model(speed: f64, step: &Sampled) -> (Matrix4<f64>, Vector4<f64>) {
    let Sampled { dt, kept, once, twice } = *step;
    #[rustfmt::skip]
    let a = Matrix4::new(
        1.0, speed * dt, speed * twice[0], 0.0,
        0.0, 1.0, once[0], 0.0,
        0.0, 0.0, kept, 0.0,
        dt, 0.5 * speed * dt * dt, 0.0, 1.0,
    );
    (a, Vector4::new(speed * twice[1], once[1], 1.0 - kept, 0.0))
}

/// Gains and costs to go by speed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LateralTable {
    spacing: f64,
    nodes: Vec<Regulator<4, 1>>,
}

impl LateralTable {
    /// Solves for speeds up to `max_speed` metres per second, with the input held for `dt` seconds.
    pub(super) fn new(weights: &TrackingWeights, lag: f64, dt: f64, max_speed: f64) -> Result<Self, Error> {
        weights.validate()?;
        check::non_negative("lag", lag)?;
        check::positive("period", dt)?;
        check::finite("max_speed", max_speed)?;
        check::in_range("max_speed", max_speed, 2.0 * LEAST_SPEED, f64::MAX)?;
        let spacing = (max_speed - LEAST_SPEED) / INTERVALS as f64;
        let step = Sampled::new(lag, dt);
        let nodes = (0..=INTERVALS)
            .map(|node| solve(weights, LEAST_SPEED + node as f64 * spacing, &step))
            .collect::<Result<_, _>>()?;
        Ok(Self { spacing, nodes })
    }

    /// Feedback on `(y, θ, r, z)` at a speed.
    pub(super) fn gain(&self, speed: f64) -> RowVector4<f64> {
        let (low, high, share) = self.between(speed);
        (low.gain * (1.0 - share) + high.gain * share) * (speed.max(0.0) / LEAST_SPEED).min(1.0)
    }

    /// Cost to go from `(y, θ, r)` at a speed, without integral action.
    pub(super) fn cost(&self, speed: f64) -> Matrix3<f64> {
        let (low, high, share) = self.between(speed);
        (low.cost * (1.0 - share) + high.cost * share).fixed_view::<3, 3>(0, 0).into_owned()
    }

    fn between(&self, speed: f64) -> (&Regulator<4, 1>, &Regulator<4, 1>, f64) {
        let place = ((speed - LEAST_SPEED) / self.spacing).clamp(0.0, INTERVALS as f64);
        // At the end of the table the share is one.
        let node = (place as usize).min(INTERVALS - 1);
        (&self.nodes[node], &self.nodes[node + 1], place - node as f64)
    }
}

/// The regulator at a speed; without integral action that of the first three states.
fn solve(weights: &TrackingWeights, speed: f64, step: &Sampled) -> Result<Regulator<4, 1>, Error> {
    let (a, b) = model(speed, step);
    let [y, heading, turn] = weights.costs(speed);
    let r = SMatrix::<f64, 1, 1>::new(turn);
    if let Some(worth) = weights.integral {
        let z = 1.0 / (worth * worth);
        return riccati(&a, &b, &Matrix4::from_diagonal(&Vector4::new(y, heading, 0.0, z)), &r);
    }
    let a3: Matrix3<f64> = a.fixed_view::<3, 3>(0, 0).into_owned();
    let b3: SVector<f64, 3> = b.fixed_rows::<3>(0).into_owned();
    let three = riccati(&a3, &b3, &Matrix3::from_diagonal(&Vector3::new(y, heading, 0.0)), &r)?;
    let (mut gain, mut cost) = (RowVector4::zeros(), Matrix4::zeros());
    gain.fixed_columns_mut::<3>(0).copy_from(&three.gain);
    cost.fixed_view_mut::<3, 3>(0, 0).copy_from(&three.cost);
    Ok(Regulator { gain, cost })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without lag and for short steps the gains are those of the double integrator, solved on paper.
    #[test]
    fn gains_without_lag_are_known() {
        let weights = TrackingWeights { cross_track: 0.1, heading: 0.5, curvature: 2.0, integral: None };
        let table = LateralTable::new(&weights, 0.0, 1e-4, 2.0).unwrap();
        for speed in [0.1, 0.7, 2.0] {
            // In metres of path: κ = -k₁ y - k₂ θ with k₁ = κ₀ / y₀, k₂² = 2 k₁ + (κ₀ / θ₀)².
            let (first, second) = (20.0, f64::sqrt(40.0 + 16.0));
            let gain = table.gain(speed) / speed;
            assert!((gain[0] / first - 1.0).abs() < 0.01 && (gain[1] / second - 1.0).abs() < 0.01, "{gain}");
        }
        assert_eq!(table.gain(0.0), RowVector4::zeros());
    }

    /// Between the nodes, too, the loop is stable at every speed, also with integral action.
    #[test]
    fn interpolated_gains_are_stable() {
        for integral in [None, Some(0.1)] {
            let weights = TrackingWeights { integral, ..TrackingWeights::default() };
            let table = LateralTable::new(&weights, 0.15, 0.02, 2.0).unwrap();
            for k in 1..60 {
                let speed = 0.05 * f64::from(k);
                let (a, b) = model(speed.min(2.0), &Sampled::new(0.15, 0.02));
                let mut x = Vector4::new(0.1, 0.0, 0.0, 0.0);
                for _ in 0..20_000 {
                    x = a * x - b * (table.gain(speed.min(2.0)) * x)[0];
                    if integral.is_none() {
                        x[3] = 0.0;
                    }
                }
                assert!(x.norm() < 1e-6, "{speed} m/s: {x}");
            }
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = TrackingWeights::default();
        for (name, weights, lag, dt, speed) in [
            ("cross_track", TrackingWeights { cross_track: 0.0, ..good }, 0.1, 0.02, 1.0),
            ("heading", TrackingWeights { heading: f64::NAN, ..good }, 0.1, 0.02, 1.0),
            ("curvature", TrackingWeights { curvature: -1.0, ..good }, 0.1, 0.02, 1.0),
            ("integral", TrackingWeights { integral: Some(0.0), ..good }, 0.1, 0.02, 1.0),
            ("lag", good, -0.1, 0.02, 1.0),
            ("period", good, 0.1, 0.0, 1.0),
            ("max_speed", good, 0.1, 0.02, 0.0),
            ("max_speed", good, 0.1, 0.02, f64::INFINITY),
        ] {
            let error = LateralTable::new(&weights, lag, dt, speed).unwrap_err();
            assert!(error.to_string().starts_with(name), "{name}: {error}");
        }
    }
}
