//! The planar pose from odometry and measured poses: an error-state Kalman filter on SE(2).
//!
//! The state is the pose and the scale by which the odometry misreads turns (wheels that scrub, a track that is not as
//! measured), the error is a right increment of the pose (Solà, Deray and Atchuthan 2018, section IV; Solà 2017, *Quaternion
//! kinematics for the error-state Kalman filter*, section 6):
//!
//! ```text
//! motion       τ = (x, y, (1 + s) θ)           from the odometry's exp(x, y, θ)
//! predict      X ← X exp(τ)                    P ← F P Fᵀ + Q          F = [ Ad(exp(τ))⁻¹  Jr(τ) (0, 0, θ)ᵀ ]
//!                                                                          [ 0             1               ]
//! innovation   z = log(X⁻¹ Y)                  S = P_xx + R            H = [ I 0 ]
//! correct      δ = K z, X ← X exp(δ_x), s ← s + δ_s                    P ← G [(I - K H) P (I - K H)ᵀ + K R Kᵀ] Gᵀ
//! ```
//!
//! with `G` the Jacobian of the reset, `Jr(δ_x)` on the pose.

use super::{AugmentedPose, Ekf, Gate, MeasurementModel, ProcessModel, Transition};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainPose},
    odometry::OdometryIncrement,
    roles::{
        Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, PoseEstimate, StatusMonitor,
        StatusParams, UpdateOutcome,
    },
    sensors::PoseObservation,
    time::Stamp,
};
use nalgebra::{Matrix3, Matrix3x4, Matrix4, Vector1, Vector3};

/// Parameters of a [`PoseFilter`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PoseFilterParams {
    /// Variance of the position along each axis per metre driven, in m²/m, beside what the odometry states of itself.
    pub position_variance_per_metre: f64,
    /// Variance of the heading per metre driven, in rad²/m, beside what the odometry states of itself.
    pub yaw_variance_per_metre: f64,
    /// Variance of the heading per radian turned, in rad²/rad, beside what the odometry states of itself.
    pub yaw_variance_per_radian: f64,
    /// Standard deviation of the yaw scale at the beginning, as a fraction; zero for odometry that is known to have none.
    pub yaw_scale_sigma: f64,
    /// Variance of the yaw scale's wandering per radian turned, in 1/rad.
    pub yaw_scale_walk: f64,
    /// Normalised innovation squared above which a measured pose is left out; infinity for never.
    pub gate: f64,
    /// When the estimate is to be trusted.
    pub status: StatusParams,
}

impl Default for PoseFilterParams {
    /// Wheels on a hard floor: 3 mm and 0.2° after a metre, which is half of what Chong and Kleeman (1997) measured, since
    /// their figures hold systematic errors that the scale takes up; 5 % of scale, wandering by 0.3 % in a radian; a gate
    /// that a sound measurement passes in all but one of ten thousand cases (χ² of three degrees of freedom).
    fn default() -> Self {
        Self {
            position_variance_per_metre: 1e-5,
            yaw_variance_per_metre: 1e-5,
            yaw_variance_per_radian: 1e-5,
            yaw_scale_sigma: 0.05,
            yaw_scale_walk: 1e-5,
            gate: 21.1,
            status: StatusParams::default(),
        }
    }
}

/// The pose and the odometry's yaw scale.
type State = AugmentedPose<1>;

/// A Kalman filter for the pose; the roles [`Localizer`] and [`Correct<PoseObservation<Se2>>`].
///
/// What a path tracker should be fed with where the pose is measured with noise: white noise of 1 cm at 50 Hz becomes 2 mm. Call
/// [`predict`](Localizer::predict) with every increment and [`update`](Correct::update) with every measured pose. A pose is
/// treated as measured at the end of the last motion: predict up to its stamp first. Nothing allocates.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_core::nalgebra::{Matrix3, Vector3};
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::roles::{Correct, Localizer, PoseBelief};
/// use agv_core::sensors::PoseObservation;
/// use agv_core::time::Stamp;
/// use agv_filters::kalman::{PoseFilter, PoseFilterParams};
///
/// let noise = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-4));
/// let mut filter = PoseFilter::new(PoseFilterParams::default())?;
/// filter.initialize(&PoseBelief::around(Se2::default(), noise)?)?;
/// let (mut odom, mut now) = (Se2::default(), Stamp::default());
/// for _ in 0..100 {
///     let next = odom * Se2::new(0.02, 0.0, 0.0);
///     filter.predict(&OdometryIncrement::between(now, &odom, now + 0.02, &next)?)?;
///     (odom, now) = (next, now + 0.02);
///     filter.update(&PoseObservation::new(now, UncertainPose::new(odom, noise)?))?;
/// }
/// let estimate = filter.estimate().expect("initialised");
/// assert!((estimate.map_from_base().x() - 2.0).abs() < 1e-9);
/// assert!(estimate.pose.position_deviation() < 0.005); // of 1 cm along each axis that a single pose has
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawFilter"))]
pub struct PoseFilter {
    params: PoseFilterParams,
    ekf: Option<Ekf<State, 4>>,
    stamp: Option<Stamp>,
    monitor: StatusMonitor,
}

/// A [`PoseFilter`] as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawFilter {
    params: PoseFilterParams,
    ekf: Option<Ekf<State, 4>>,
    stamp: Option<Stamp>,
    monitor: StatusMonitor,
}

#[cfg(feature = "serde")]
impl TryFrom<RawFilter> for PoseFilter {
    type Error = Error;

    fn try_from(raw: RawFilter) -> Result<Self, Error> {
        let fresh = Self::new(raw.params)?;
        if let Some(ekf) = &raw.ekf {
            check::in_range("yaw_scale", ekf.state().extra[0], -MOST_SCALE, MOST_SCALE)?;
        }
        Ok(Self { ekf: raw.ekf, stamp: raw.stamp, monitor: raw.monitor, ..fresh })
    }
}

/// Longest motion and largest deviation, in metres: beyond, the numbers have no meaning.
const LARGEST: f64 = 1e6;

/// Greatest yaw scale: an odometry that reads turns half as large again, or half, is not one to be calibrated on the way.
const MOST_SCALE: f64 = 0.5;

impl PoseFilter {
    /// A filter without a belief.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: PoseFilterParams) -> Result<Self, Error> {
        check::non_negative("position_variance_per_metre", params.position_variance_per_metre)?;
        check::non_negative("yaw_variance_per_metre", params.yaw_variance_per_metre)?;
        check::non_negative("yaw_variance_per_radian", params.yaw_variance_per_radian)?;
        check::in_range("yaw_scale_sigma", params.yaw_scale_sigma, 0.0, MOST_SCALE)?;
        check::non_negative("yaw_scale_walk", params.yaw_scale_walk)?;
        Gate::at_limit(params.gate)?;
        Ok(Self { params, ekf: None, stamp: None, monitor: StatusMonitor::new(params.status)? })
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &PoseFilterParams {
        &self.params
    }

    /// Share by which turns are greater than the odometry says, and its standard deviation: -0.03 where 3 % of every turn is
    /// lost. None before there is a belief.
    pub fn yaw_scale(&self) -> Option<(f64, f64)> {
        self.ekf.map(|ekf| (ekf.state().extra[0], ekf.belief().sigma(3)))
    }
}

fn pose_of(ekf: &Ekf<State, 4>) -> Result<UncertainPose<Se2>, Error> {
    UncertainPose::new(ekf.state().map_from_base, ekf.covariance().fixed_view::<3, 3>(0, 0).into_owned())
}

/// Odometry that misreads turns by the state's scale.
struct ScaledOdometry(PoseFilterParams);

impl ProcessModel<State, 4> for ScaledOdometry {
    type Control = OdometryIncrement;

    fn transition(&self, state: &State, odometry: &OdometryIncrement, dt: f64) -> State {
        self.linearize(state, odometry, dt).state
    }

    fn jacobian(&self, state: &State, odometry: &OdometryIncrement, dt: f64) -> Matrix4<f64> {
        self.linearize(state, odometry, dt).jacobian
    }

    fn noise(&self, state: &State, odometry: &OdometryIncrement, dt: f64) -> Matrix4<f64> {
        self.linearize(state, odometry, dt).noise
    }

    fn linearize(&self, state: &State, odometry: &OdometryIncrement, _: f64) -> Transition<State, 4> {
        let read = odometry.start_from_end.log();
        let moved = Vector3::new(read.x, read.y, read.z * (1.0 + state.extra[0]));
        let step = Se2::exp(&moved);
        let mut jacobian = Matrix4::identity();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&step.inverse().adjoint());
        let by_scale = Se2::right_jacobian(&moved) * Vector3::new(0.0, 0.0, read.z);
        jacobian.fixed_view_mut::<3, 1>(0, 3).copy_from(&by_scale);

        let (p, driven, turned) = (&self.0, read.x.hypot(read.y), read.z.abs());
        let position = p.position_variance_per_metre * driven;
        let yaw = p.yaw_variance_per_metre * driven + p.yaw_variance_per_radian * turned;
        let own = Matrix3::from_diagonal(&Vector3::new(position, position, yaw));
        let mut noise = Matrix4::zeros();
        noise.fixed_view_mut::<3, 3>(0, 0).copy_from(&(odometry.covariance + own));
        noise[(3, 3)] = if p.yaw_scale_sigma > 0.0 { p.yaw_scale_walk * turned } else { 0.0 };
        Transition { state: AugmentedPose { map_from_base: state.map_from_base * step, ..*state }, jacobian, noise }
    }
}

/// A pose whose difference from the expected one is taken along the axes of the vehicle, as its covariance is.
struct OnVehicle(Matrix3<f64>);

impl MeasurementModel<State, 4, 3> for OnVehicle {
    type Value = Se2;

    fn predict(&self, state: &State) -> Se2 {
        state.map_from_base
    }

    fn jacobian(&self, _: &State) -> Matrix3x4<f64> {
        Matrix3x4::identity()
    }

    fn noise(&self, _: &State) -> Matrix3<f64> {
        self.0
    }

    fn residual(&self, measured: &Se2, expected: &Se2) -> Vector3<f64> {
        measured.minus(expected)
    }
}

impl Localizer for PoseFilter {
    type Pose = Se2;

    /// Takes a pose with its covariance, and forgets the yaw scale.
    ///
    /// # Errors
    /// [`Error::Empty`] for [`PoseBelief::Anywhere`], which no Gaussian is; a variance above (1000 km)².
    fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        let PoseBelief::Around(pose) = belief else { return Err(Error::Empty { name: "pose of the belief" }.into()) };
        check::in_range("covariance", pose.covariance().amax(), 0.0, LARGEST * LARGEST)?;
        let mut covariance = Matrix4::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(pose.covariance());
        covariance[(3, 3)] = self.params.yaw_scale_sigma * self.params.yaw_scale_sigma;
        let state = AugmentedPose { map_from_base: *pose.mean(), extra: Vector1::zeros() };
        (self.ekf, self.stamp) = (Some(Ekf::new(state, covariance)?), None);
        self.monitor.initialized(pose);
        Ok(())
    }

    fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
        let mut ekf = self.ekf.ok_or(LocalizationError::NotInitialized)?;
        let motion = odometry.start_from_end;
        check::all_finite("odometry", &[motion.x(), motion.y(), motion.yaw()])?;
        check::in_range("odometry run", motion.translation().norm(), 0.0, LARGEST)?;
        check::covariance("odometry covariance", &odometry.covariance)?;
        check::in_range("odometry covariance", odometry.covariance.amax(), 0.0, LARGEST * LARGEST)?;
        // The motion counts, not its duration: clocks of logs step back.
        ekf.predict(&ScaledOdometry(self.params), odometry, 0.0)?;
        let pose = pose_of(&ekf)?;
        (self.ekf, self.stamp) = (Some(ekf), Some(odometry.end));
        self.monitor.moved(&pose);
        Ok(())
    }

    fn estimate(&self) -> Option<PoseEstimate<Se2>> {
        let pose = pose_of(self.ekf.as_ref()?).ok()?;
        Some(PoseEstimate { stamp: self.stamp, ..PoseEstimate::new(pose) })
    }

    fn status(&self) -> LocalizationStatus {
        self.monitor.status()
    }
}

impl Correct<PoseObservation<Se2>> for PoseFilter {
    /// Skipped if it contradicts the belief beyond the gate; one within it counts as explained. The report has the normalised
    /// innovation squared.
    ///
    /// # Errors
    /// [`LocalizationError::NotInitialized`]; a measured pose whose covariance leaves nothing to weigh by: it and the
    /// belief's are both singular.
    fn update(&mut self, observation: &PoseObservation<Se2>) -> Result<UpdateOutcome, LocalizationError> {
        let mut ekf = self.ekf.ok_or(LocalizationError::NotInitialized)?;
        let (seen, gate) = (observation.map_from_base(), Gate::at_limit(self.params.gate)?);
        let correction = ekf.update(&OnVehicle(*seen.covariance()), seen.mean(), &gate)?;
        let scale = ekf.state().extra[0];
        if scale.abs() > MOST_SCALE {
            let state = AugmentedPose { extra: Vector1::new(scale.clamp(-MOST_SCALE, MOST_SCALE)), ..*ekf.state() };
            ekf = Ekf::new(state, *ekf.covariance())?;
        }
        let pose = pose_of(&ekf)?;
        if correction.accepted {
            (self.ekf, self.stamp) = (Some(ekf), self.stamp.or(Some(observation.stamp())));
        }
        let outcome = correction.into();
        self.monitor.updated(&pose, &outcome);
        Ok(outcome)
    }
}

#[cfg(test)]
mod tests;
