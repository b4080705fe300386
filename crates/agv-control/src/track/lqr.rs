//! Linear quadratic regulator with curvature feed-forward.
//!
//! The turn rate of the bend, read ahead by the lag, and an optimal feedback of what the vehicle is off it,
//!
//! ```text
//! g u = v κ(s + v (τ + dt/2)) - K(v) (y, θ, g ω - v κ(s) [, ∫ y])
//! ```
//!
//! where `K` solves the Riccati equation of the model with the actuators' lag `τ` as a state, and
//! pose, turn rate and slip `g` are those of a Kalman filter, so that the noise of single poses does not
//! shake the vehicle (certainty equivalence: Åström, *Introduction to stochastic control theory*, 1970). Snider, *Automatic steering
//! methods for autonomous automobile path tracking*, 2009, compares such laws.

use super::{
    errors::{TrackingErrors, curvature, reachable, reachable_speed},
    follower::{Facing, Follower, FollowerParams},
    lateral::{LateralTable, TrackingWeights},
    observer::{Observer, ObserverParams},
    steering::{BRAKING_SHARE, Steering, SteeringInput},
};
use crate::Error;
use agv_core::{
    check,
    geometry::Twist2,
    kinematics::stopping_speed,
    roles::{TrackError, VehicleState},
};

/// Parameters of [`Lqr`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LqrParams {
    /// What the errors cost.
    pub weights: TrackingWeights,
    /// Time between two commands that the feedback is computed for, in seconds.
    pub period: f64,
    /// Greatest speed that it is computed for, in metres per second; beyond it the gains stay.
    pub max_speed: f64,
    /// Greatest angle at which the path is approached, in radians.
    pub max_approach: f64,
    /// How well poses and the floor are known.
    pub observer: ObserverParams,
    /// What all trackers share.
    pub follower: FollowerParams,
}

impl Default for LqrParams {
    /// 50 Hz, up to 2 m/s; corners read as bends over 20 cm only, as the feed-forward is to be exact.
    fn default() -> Self {
        Self {
            weights: TrackingWeights::default(),
            period: 0.02,
            max_speed: 2.0,
            max_approach: 0.7,
            observer: ObserverParams::default(),
            follower: FollowerParams { bend_window: 0.2, ..FollowerParams::default() },
        }
    }
}

/// The steering law of [`Lqr`].
#[derive(Debug, Clone, PartialEq)]
pub struct LqrSteering {
    params: LqrParams,
    table: LateralTable,
    observer: Observer,
    /// Integrated cross-track error, in metre seconds.
    integral: f64,
}

/// The linear quadratic tracker. O(1) per command; the twist of the states is to be the last command, as a drive that lags makes
/// it the one thing that is known exactly.
///
/// ```
/// use agv_control::track::{Lqr, LqrParams};
/// use agv_core::{geometry::{Se2, Twist2}, kinematics::MotionLimits, nalgebra::Vector2, path::Path};
/// use agv_core::roles::{PathTracker, VehicleState};
///
/// let mut tracker = Lqr::new(LqrParams::default())?;
/// tracker.set_path(&Path::from_positions(&[Vector2::new(0.0, 0.0), Vector2::new(5.0, 0.0)])?)?;
/// let beside = VehicleState::new(Se2::new(1.0, 0.1, 0.0), Twist2::new(0.8, 0.0, 0.0));
/// let command = tracker.command(&beside, &MotionLimits::default(), 0.02)?;
/// assert!(command.motion.twist.yaw_rate < 0.0); // back to the right
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type Lqr = Follower<LqrSteering>;

impl Lqr {
    /// A tracker from its parameters: solves 33 Riccati equations.
    ///
    /// # Errors
    /// The first parameter that is out of its range; [`Error::NotStabilisable`] for weights too far apart for the numbers.
    pub fn new(params: LqrParams) -> Result<Self, Error> {
        check::in_range("max_approach", params.max_approach, 0.01, std::f64::consts::FRAC_PI_2)?;
        let lag = check::non_negative("response_time", params.follower.response_time)?;
        let observer = Observer::new(params.observer, lag, params.follower.max_yaw_slip)?;
        let table = LateralTable::new(&params.weights, lag, params.period, params.max_speed)?;
        // The observer makes up for the slip; the follower must not do so again.
        let follower = FollowerParams { max_yaw_slip: 0.0, ..params.follower };
        Ok(Self::with_steering(follower, LqrSteering { params, table, observer, integral: 0.0 })?)
    }
}

impl Steering for LqrSteering {
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError> {
        let errors = TrackingErrors::of(&self.observer, input)?;
        let p = &self.params;
        let (here, speed) = (errors.arc_length, errors.actual.vx.max(0.0));
        let told = reachable_speed(input, input.speed);
        let gain = self.table.gain(speed);
        // The feedback turns to a direction of approach, K₁ y / K₂, no steeper than the vehicle can turn out of again.
        let turning = input.turning_acceleration();
        let linear = if gain[1] > 0.0 { gain[0] * errors.cross_track / gain[1] } else { 0.0 };
        let most = steepest_approach(errors.cross_track, speed, turning).min(p.max_approach);
        let approach = linear.max(-most).min(most);
        if let Some(Facing::Path) = input.facing {
            return input.sideways(Facing::Path, &input.predicted()?, -approach);
        }
        let angle = errors.heading + approach;
        let stoppable = stopping_speed(angle.abs(), BRAKING_SHARE * turning, input.dt);
        let excess = errors.slip * errors.actual.yaw_rate - speed * curvature(input.course, here);
        let preview = here + speed * (p.follower.response_time + 0.5 * input.dt);
        let feedback = (gain[1] * angle).max(-stoppable).min(stoppable) + gain[2] * excess + gain[3] * self.integral;
        let wanted = (told * curvature(input.course, preview) - feedback) / errors.slip;
        let twist = reachable(input, told, wanted);
        // Integrates only what the vehicle can act on.
        if p.weights.integral.is_some() && twist.yaw_rate == wanted && approach == linear {
            self.integral += errors.cross_track * input.dt;
        }
        Ok(twist)
    }

    fn observe(&mut self, state: &VehicleState, dt: f64) {
        self.observer.update(state, dt);
    }

    fn reset(&mut self) {
        self.integral = 0.0;
    }
}

/// Share of the turning acceleration that coming back to the path may take: turning in, turning out, and mending what noise makes of it.
const APPROACH_SHARE: f64 = 0.25;

/// Steepest angle at the distance `y` from which the vehicle can turn to the path at a steady change `a` of its turn rate: from
/// `θ = a t²/2` and `y = v a t³/6`, `θ = a/2 (6 y / (v a))^(2/3)`.
fn steepest_approach(y: f64, speed: f64, turning: f64) -> f64 {
    let change = APPROACH_SHARE * turning;
    if speed * change <= 0.0 {
        return f64::INFINITY; // without speed there is no feedback
    }
    let time = (6.0 * y.abs() / (speed * change)).cbrt();
    0.5 * change * time * time
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = LqrParams::default();
        for (name, params) in [
            ("max_approach", LqrParams { max_approach: 2.0, ..good }),
            ("period", LqrParams { period: f64::NAN, ..good }),
            ("max_speed", LqrParams { max_speed: 0.0, ..good }),
            ("cross_track", LqrParams { weights: TrackingWeights { cross_track: 0.0, ..good.weights }, ..good }),
            (
                "position_noise",
                LqrParams { observer: ObserverParams { position_noise: -0.1, ..good.observer }, ..good },
            ),
            ("position_drift", LqrParams { observer: ObserverParams { position_drift: 0.0, ..good.observer }, ..good }),
            ("response_time", LqrParams { follower: FollowerParams { response_time: -0.1, ..good.follower }, ..good }),
            ("max_yaw_slip", LqrParams { follower: FollowerParams { max_yaw_slip: 0.6, ..good.follower }, ..good }),
            ("bend_window", LqrParams { follower: FollowerParams { bend_window: 0.0, ..good.follower }, ..good }),
        ] {
            assert!(Lqr::new(params).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
