//! Where the vehicle really is, and what it really does: a Kalman filter over noisy poses and the commands that were given.
//!
//! An optimal tracker is as good as the state that it is given. Speeds and steering follow their commands with a first-order lag,
//!
//! ```text
//! a' = (command - a) / lag
//! ```
//!
//! and the pose follows from them, with a turn rate that slips by an unknown factor `g`. The error is kept in the base frame (a
//! right error on SE(2), Solà, *A micro Lie theory*, 2018), where neither the noise nor the model depends on the heading:
//!
//! ```text
//! pose⁺ = pose · exp((v, w, g ω) dt)        ξ⁺ = Ad(exp(·))⁻¹ ξ + (0, 0, ω dt) δg        residual = log(pose⁻¹ measured)
//! ```

use super::lateral::Sampled;
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, Twist2},
    kinematics::Motion,
    roles::VehicleState,
};
use nalgebra::{Matrix3, Matrix4, SMatrix, Vector4};

/// How well poses and the model are known.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ObserverParams {
    /// Standard deviation of a measured position, in metres along each axis; zero to take poses as they are.
    pub position_noise: f64,
    /// Standard deviation of a measured heading, in radians.
    pub yaw_noise: f64,
    /// How far the vehicle strays from the model, in metres per √second.
    pub position_drift: f64,
    /// How far its heading strays, in radians per √second.
    pub yaw_drift: f64,
    /// How fast the slip of the turn rate changes, as a factor per √second; zero for none.
    pub slip_drift: f64,
}

impl Default for ObserverParams {
    /// A localizer with 1 cm and half a degree, and a floor whose slip changes by a percent within a few seconds: the filter then
    /// averages over about a second.
    fn default() -> Self {
        Self { position_noise: 0.01, yaw_noise: 0.0087, position_drift: 0.005, yaw_drift: 0.01, slip_drift: 0.005 }
    }
}

impl ObserverParams {
    pub(super) fn validate(&self) -> Result<(), Error> {
        check::non_negative("position_noise", self.position_noise)?;
        check::non_negative("yaw_noise", self.yaw_noise)?;
        check::positive("position_drift", self.position_drift)?;
        check::positive("yaw_drift", self.yaw_drift)?;
        check::non_negative("slip_drift", self.slip_drift)?;
        Ok(())
    }
}

/// Initial uncertainty of the slip factor, and deviations beyond which a pose is a new beginning.
const SLIP_SIGMA: f64 = 0.03;
const GATE: f64 = 5.0;

/// The filter: predicts by the commands, corrects by the poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Observer {
    params: ObserverParams,
    /// Time constant with which the drives follow their commands, in seconds.
    lag: f64,
    /// Greatest share by which the slip factor differs from one; zero for not learning it.
    max_slip: f64,
    pose: Option<Se2>,
    /// What the vehicle does, as its wheels have it.
    actual: Motion,
    /// Turn rate of the vehicle per turn rate of its wheels.
    slip: f64,
    covariance: Matrix4<f64>,
}

impl Observer {
    pub(super) fn new(params: ObserverParams, lag: f64, max_slip: f64) -> Result<Self, Error> {
        params.validate()?;
        check::in_range("max_yaw_slip", max_slip, 0.0, 0.5)?;
        Ok(Self { params, lag, max_slip, pose: None, actual: Motion::REST, slip: 1.0, covariance: Matrix4::zeros() })
    }

    /// The pose and the motion that are most likely, as of the last update.
    pub(super) fn estimate(&self) -> (Se2, Motion) {
        (self.pose.unwrap_or_default(), self.actual)
    }

    pub(super) const fn slip(&self) -> f64 {
        self.slip
    }

    /// Takes the measured state, whose twist is the command of the last `dt` seconds; the pose and the motion that are most
    /// likely. `O(1)`.
    pub(super) fn update(&mut self, state: &VehicleState, dt: f64) -> (Se2, Motion) {
        let p = self.params;
        let measured = state.map_from_base;
        let Some(pose) = self.pose else {
            self.begin(state);
            return (measured, self.actual);
        };
        let Sampled { kept, once, .. } = Sampled::new(self.lag, dt);
        let mean = |was: f64, command: f64| command + (was - command) * once[0] / dt;
        let next = |was: f64, command: f64| command + (was - command) * kept;
        let (was, told) = (self.actual.twist, state.twist);
        let turned = mean(was.yaw_rate, told.yaw_rate);
        let moved = Twist2::new(mean(was.vx, told.vx), mean(was.vy, told.vy), self.slip * turned).integrate(dt);
        self.actual.twist =
            Twist2::new(next(was.vx, told.vx), next(was.vy, told.vy), next(was.yaw_rate, told.yaw_rate));
        self.actual.steering = state.steering.map(|told| next(self.actual.steering.unwrap_or(told), told));

        let mut model = Matrix4::identity();
        model.fixed_view_mut::<3, 3>(0, 0).copy_from(&moved.inverse().adjoint());
        model[(2, 3)] = turned * dt;
        let slip_drift = if self.max_slip > 0.0 { p.slip_drift } else { 0.0 };
        let drift = [p.position_drift, p.position_drift, p.yaw_drift, slip_drift].map(|d| d * d * dt);
        let predicted =
            model * self.covariance * model.transpose() + Matrix4::from_diagonal(&Vector4::from_column_slice(&drift));
        let pose = pose.compose(&moved);
        let residual = pose.inverse().compose(&measured).log();
        let [xy, yaw] = [p.position_noise, p.yaw_noise].map(|sigma| sigma * sigma);
        let innovation: Matrix3<f64> =
            predicted.fixed_view::<3, 3>(0, 0) + Matrix3::from_diagonal(&nalgebra::Vector3::new(xy, xy, yaw));
        // Put so that what is not a number is not usual either.
        let usual = (0..3).all(|i| residual[i] * residual[i] <= GATE * GATE * innovation[(i, i)]);
        let Some(factor) = innovation.cholesky().filter(|_| usual) else {
            self.begin(state);
            return (measured, self.actual);
        };
        let gain: SMatrix<f64, 4, 3> = factor.solve(&predicted.fixed_rows::<3>(0)).transpose();
        let correction = gain * residual;
        if !correction.iter().all(|c| c.is_finite()) || !self.actual.is_finite() {
            self.begin(state);
            return (measured, self.actual);
        }
        let updated = predicted - gain * predicted.fixed_rows::<3>(0);
        self.covariance = 0.5 * (updated + updated.transpose());
        self.slip = (self.slip + correction[3]).clamp(1.0 - self.max_slip, 1.0 + self.max_slip);
        let pose = pose.compose(&Se2::exp(&correction.fixed_rows::<3>(0).into_owned()));
        self.pose = Some(pose);
        (pose, self.actual)
    }

    /// Begins at a pose, at the speed that was commanded.
    fn begin(&mut self, state: &VehicleState) {
        let p = self.params;
        let slip_variance = match self.covariance[(3, 3)] {
            _ if p.slip_drift == 0.0 || self.max_slip == 0.0 => 0.0,
            known if known > 0.0 && known.is_finite() => known,
            _ => SLIP_SIGMA * SLIP_SIGMA,
        };
        let [xy, yaw] = [p.position_noise, p.yaw_noise].map(|sigma| sigma * sigma);
        self.covariance = Matrix4::from_diagonal(&Vector4::new(xy, xy, yaw, slip_variance));
        self.pose = Some(state.map_from_base);
        self.actual = state.motion();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Seed;
    use rand_distr::{Distribution, StandardNormal};

    /// Drives a lagging, slipping vehicle in a bend and asks the filter where it is.
    #[test]
    fn lag_slip_and_noise_are_seen_through() {
        let (dt, lag, slip) = (0.02, 0.15, 0.97);
        let mut observer = Observer::new(ObserverParams::default(), 0.15, 0.1).unwrap();
        let mut stream = Seed(3).stream(0, 0);
        let mut noise = |sigma: f64| -> f64 { sigma * Distribution::<f64>::sample(&StandardNormal, &mut stream) };
        let (mut pose, mut actual, mut command) = (Se2::default(), Twist2::ZERO, Twist2::ZERO);
        let (mut square, mut count) = (0.0, 0.0);
        for k in 0..1500 {
            let measured = pose * Se2::new(noise(0.01), noise(0.01), noise(0.0087));
            let (estimate, motion) = observer.update(&VehicleState::new(measured, command), dt);
            if k > 250 {
                square += (estimate.translation() - pose.translation()).norm_squared();
                count += 1.0;
                assert!((motion.twist.yaw_rate - actual.yaw_rate).abs() < 1e-9);
            }
            command = Twist2::new(0.8, 0.0, (f64::from(k) * 0.01).sin());
            let kept = (-dt / lag).exp();
            let early = lag * (1.0 - kept) / dt;
            let mean = |was: f64, told: f64| told + (was - told) * early;
            let moved = Twist2::new(mean(actual.vx, command.vx), 0.0, slip * mean(actual.yaw_rate, command.yaw_rate));
            pose = pose * moved.integrate(dt);
            actual.vx = command.vx + (actual.vx - command.vx) * kept;
            actual.yaw_rate = command.yaw_rate + (actual.yaw_rate - command.yaw_rate) * kept;
        }
        let rmse = f64::sqrt(square / count);
        assert!(rmse < 0.005, "{rmse} m");
        assert!((observer.slip() - slip).abs() < 0.01, "{}", observer.slip());
    }

    #[test]
    fn a_jump_is_a_new_beginning() {
        let mut observer = Observer::new(ObserverParams::default(), 0.15, 0.1).unwrap();
        for _ in 0..20 {
            observer.update(&VehicleState::default(), 0.02);
        }
        let there = Se2::new(3.0, 0.0, 2.0);
        assert_eq!(observer.update(&VehicleState::new(there, Twist2::ZERO), 0.02).0, there);
    }

    #[test]
    fn without_noise_poses_are_taken_as_they_are() {
        let params = ObserverParams { position_noise: 0.0, yaw_noise: 0.0, ..ObserverParams::default() };
        let mut observer = Observer::new(params, 0.15, 0.1).unwrap();
        for k in 0..20 {
            let there = Se2::new(0.001 * f64::from(k), 0.0, 0.0);
            let (pose, _) = observer.update(&VehicleState::new(there, Twist2::new(0.05, 0.0, 0.0)), 0.02);
            assert!((pose.translation() - there.translation()).norm() < 1e-9);
        }
    }
}
