//! Odometry motion model of a vehicle that steers: cars, tuggers, forklifts.
//!
//! Between two updates such a vehicle runs `s` along an arc that turns by `θ` (the logarithm of the motion; the base frame is
//! in the middle of the axle that does not steer). It errs in what it can get wrong: the run, the steering angle, and the
//! slip of the tyres to the side. With the curvature `κ = tan δ / L = θ / s` of the bicycle model,
//!
//! ```text
//! ∂κ/∂δ = (1 + tan² δ) / L = 1/L + L κ²
//!
//! var run  = run_per_run s²
//! var side = slip_per_run s²
//! var turn = (1/L + L κ²)² σ_δ² s² + turn_per_turn θ²
//! end      = start exp((s, side, θ) + noise)
//! ```
//!
//! Without a run there is no error but that of a turn that was measured: unlike [`DifferentialOdometryModel`](super::DifferentialOdometryModel) the
//! particles of a vehicle that stands, or creeps, do not turn on the spot.

use super::{MotionModel, check_factors, stored_as};
use agv_core::{
    Error,
    compute::Stream,
    geometry::{LieGroup, Se2, propagate_covariance},
    kinematics::SteeringLimits,
    odometry::OdometryIncrement,
};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// Geometry and noise of an [`AckermannOdometryModel`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AckermannOdometryParams {
    /// Distance between the axles, in metres.
    pub wheelbase: f64,
    /// Greatest steering angle to either side, in radians; above zero and below a quarter turn. A motion that turns more,
    /// as one made of a run ahead and one back, errs as on the tightest arc.
    pub max_steering: f64,
    /// Standard deviation of the steering angle over an update, in radians.
    pub steering_sigma: f64,
    /// Variance of the run per squared run, in m²/m².
    pub run_per_run: f64,
    /// Variance to the side per squared run, in m²/m².
    pub slip_per_run: f64,
    /// Variance of the turn per squared turn, in rad²/rad².
    pub turn_per_turn: f64,
}

impl Default for AckermannOdometryParams {
    /// The tugger of [`AckermannParams`](agv_core::kinematics::AckermannParams). The run and the turn err by the customary 0.2
    /// of `nav2_amcl`; 0.1 rad is the play of worn steering, and a tyre slips to the side by a third of
    /// what the run errs, 0.14 of it.
    fn default() -> Self {
        let SteeringLimits { wheelbase, max_angle, .. } = SteeringLimits::default();
        Self {
            wheelbase,
            max_steering: max_angle,
            steering_sigma: 0.1,
            run_per_run: 0.2,
            slip_per_run: 0.02,
            turn_per_turn: 0.2,
        }
    }
}

impl AckermannOdometryParams {
    fn limits(&self) -> SteeringLimits {
        SteeringLimits { wheelbase: self.wheelbase, max_angle: self.max_steering, max_rate: 1.0 }
    }
}

/// The odometry motion model of a vehicle that steers one axle.
///
/// The covariance that an increment may carry is not used: the model states the noise.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{AckermannOdometryModel, AckermannOdometryParams, MotionModel};
///
/// let model = AckermannOdometryModel::new(AckermannOdometryParams::default())?;
/// let arc = Twist2::new(0.5, 0.0, 0.1).integrate(0.4);
/// let motion = OdometryIncrement::between(Stamp::default(), &Se2::default(), Stamp::default(), &arc)?;
/// let moved = model.condition(&motion)(&Se2::new(5.0, 0.0, 0.0), &mut Seed(7).stream(0, 0));
/// assert!((moved.x() - 5.2).abs() < 0.5);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "AckermannOdometryParams", into = "AckermannOdometryParams")
)]
pub struct AckermannOdometryModel {
    params: AckermannOdometryParams,
}

stored_as!(AckermannOdometryParams => AckermannOdometryModel.params);

impl AckermannOdometryModel {
    /// Checks the parameters.
    ///
    /// # Errors
    /// A wheelbase that is not positive, a steering angle outside (0, π/2), or a noise that is negative or not finite.
    pub fn new(params: AckermannOdometryParams) -> Result<Self, Error> {
        params.limits().validate()?;
        check_factors!(params: steering_sigma, run_per_run, slip_per_run, turn_per_turn);
        Ok(Self { params })
    }

    /// Geometry and noise.
    pub const fn params(&self) -> &AckermannOdometryParams {
        &self.params
    }

    /// The motion as a tangent, and the deviations of its three entries.
    fn spread(&self, start_from_end: &Se2) -> (Vector3<f64>, Vector3<f64>) {
        let tangent = start_from_end.log();
        let (run2, turn2) = (tangent.x * tangent.x, tangent.z * tangent.z);
        let p = &self.params;
        // The limit also serves a run of zero, where the quotient is infinite or not a number.
        let tightest = p.limits().max_curvature();
        let curvature = (tangent.z / tangent.x).abs().min(tightest);
        let by_steering = p.steering_sigma * (p.wheelbase.recip() + p.wheelbase * curvature * curvature);
        let sigma = Vector3::new(
            (p.run_per_run * run2).sqrt(),
            (p.slip_per_run * run2).sqrt(),
            (by_steering * by_steering * run2 + p.turn_per_turn * turn2).sqrt(),
        );
        (tangent, sigma)
    }
}

impl MotionModel for AckermannOdometryModel {
    type Motion = OdometryIncrement;

    fn condition<'a>(&'a self, motion: &'a OdometryIncrement) -> impl Fn(&Se2, &mut Stream) -> Se2 + Sync + 'a {
        let (tangent, sigma) = self.spread(&motion.start_from_end);
        move |pose, stream| {
            let noise = Vector3::from_fn(|_, _| StandardNormal.sample(stream));
            pose.plus(&(tangent + sigma.component_mul(&noise)))
        }
    }

    fn covariance(&self, motion: &OdometryIncrement) -> Matrix3<f64> {
        let (tangent, sigma) = self.spread(&motion.start_from_end);
        let spread = Matrix3::from_diagonal(&sigma.component_mul(&sigma));
        propagate_covariance::<Se2>(&Se2::right_jacobian(&tangent), &spread)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{kinematics::Ackermann, time::Stamp};

    fn motion(start_from_end: Se2) -> OdometryIncrement {
        OdometryIncrement::between(Stamp::default(), &Se2::default(), Stamp::default(), &start_from_end).unwrap()
    }

    /// The turn's deviation is what a steering angle that is off by its deviation does to the bicycle model.
    #[test]
    fn steering_errors_turn_as_the_bicycle_does() {
        use agv_core::kinematics::{AckermannParams, AckermannWheels, Kinematics};
        let truck = Ackermann::new(AckermannParams::default()).unwrap();
        let sigma = 1e-5;
        let params = AckermannOdometryParams { steering_sigma: sigma, turn_per_turn: 0.0, ..Default::default() };
        let model = AckermannOdometryModel::new(params).unwrap();
        for steering in [-0.55, -0.2, 0.0, 0.4] {
            let drive = |steering: f64| truck.forward(&AckermannWheels { drive: 2.0, steering }).integrate(1.0);
            let off = drive(steering + sigma).yaw() - drive(steering - sigma).yaw();
            let stated = model.covariance(&motion(drive(steering)))[(2, 2)].sqrt();
            assert!((stated / (0.5 * off) - 1.0).abs() < 1e-4, "{steering}: {stated} {off}");
        }
    }

    #[test]
    fn a_vehicle_that_stands_does_not_turn() {
        let model = AckermannOdometryModel::new(AckermannOdometryParams::default()).unwrap();
        assert_eq!(model.covariance(&motion(Se2::default())), Matrix3::zeros());
        let jitter = model.covariance(&motion(Se2::new(1e-4, 0.0, 1e-3)));
        assert!(jitter[(2, 2)].sqrt() < 1e-3, "{jitter}");
        // Ahead and back: the turn stays, the run does not.
        let shunted = model.covariance(&motion(Se2::new(0.0, 0.05, 0.3)));
        assert!(shunted.iter().all(|v| v.is_finite()) && shunted[(2, 2)] > 0.0);
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = AckermannOdometryParams::default();
        for (name, bad) in [
            ("wheelbase", AckermannOdometryParams { wheelbase: 0.0, ..good }),
            ("max_angle", AckermannOdometryParams { max_steering: 1.6, ..good }),
            ("steering_sigma", AckermannOdometryParams { steering_sigma: -0.1, ..good }),
            ("run_per_run", AckermannOdometryParams { run_per_run: f64::NAN, ..good }),
            ("slip_per_run", AckermannOdometryParams { slip_per_run: f64::INFINITY, ..good }),
            ("turn_per_turn", AckermannOdometryParams { turn_per_turn: -1.0, ..good }),
        ] {
            assert!(AckermannOdometryModel::new(bad).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
