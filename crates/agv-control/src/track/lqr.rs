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
    follower::{Follower, FollowerParams},
    lateral::{LateralTable, TrackingWeights},
    observer::{Observer, ObserverParams},
    steering::{Steering, SteeringInput},
};
use crate::Error;
use agv_core::{check, geometry::Twist2, roles::TrackError};
use nalgebra::Vector4;

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
    /// How well pose and drives are known, and how they lag.
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
            follower: FollowerParams { bend_window: 0.2, max_yaw_slip: 0.0, ..FollowerParams::default() },
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

/// The linear quadratic tracker.
pub type Lqr = Follower<LqrSteering>;

impl Lqr {
    /// A tracker from its parameters: solves 33 Riccati equations.
    ///
    /// # Errors
    /// The first parameter that is out of its range; [`Error::NotStabilisable`] for weights too far apart for the numbers.
    pub fn new(params: LqrParams) -> Result<Self, Error> {
        check::in_range("max_approach", params.max_approach, 0.01, std::f64::consts::FRAC_PI_2)?;
        let observer = Observer::new(params.observer)?;
        let table = LateralTable::new(&params.weights, params.observer.lag, params.period, params.max_speed)?;
        Ok(Self::with_steering(params.follower, LqrSteering { params, table, observer, integral: 0.0 })?)
    }
}

impl Steering for LqrSteering {
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError> {
        let errors = TrackingErrors::of(&mut self.observer, input)?;
        let p = &self.params;
        let (here, speed) = (errors.arc_length, errors.actual.vx.max(0.0));
        let told = reachable_speed(input, input.speed);
        let gain = self.table.gain(speed);
        // Far from the path the feedback's direction of approach, K₁ y / K₂, would turn back on itself.
        let farthest = if gain[0] > 0.0 { p.max_approach * gain[1] / gain[0] } else { f64::INFINITY };
        let y = errors.cross_track.clamp(-farthest, farthest);
        let excess = errors.slip * errors.actual.yaw_rate - speed * curvature(input.course, here);
        let preview = here + speed * (p.observer.lag + 0.5 * input.dt);
        let feedback = (gain * Vector4::new(y, errors.heading, excess, self.integral))[0];
        let wanted = (told * curvature(input.course, preview) - feedback) / errors.slip;
        let twist = reachable(input, told, wanted);
        // Integrates only what the vehicle can act on.
        if p.weights.integral.is_finite() && twist.yaw_rate == wanted && y == errors.cross_track {
            self.integral += y * input.dt;
        }
        Ok(twist)
    }

    fn reset(&mut self) {
        self.observer.reset();
        self.integral = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = LqrParams::default();
        let observer = |lag, position_drift| ObserverParams { lag, position_drift, ..good.observer };
        for (name, params) in [
            ("max_approach", LqrParams { max_approach: 2.0, ..good }),
            ("period", LqrParams { period: f64::NAN, ..good }),
            ("max_speed", LqrParams { max_speed: 0.0, ..good }),
            ("cross_track", LqrParams { weights: TrackingWeights { cross_track: 0.0, ..good.weights }, ..good }),
            ("lag", LqrParams { observer: observer(-1.0, 0.1), ..good }),
            ("position_drift", LqrParams { observer: observer(0.1, 0.0), ..good }),
            ("bend_window", LqrParams { follower: FollowerParams { bend_window: 0.0, ..good.follower }, ..good }),
        ] {
            assert!(Lqr::new(params).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
