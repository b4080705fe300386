//! What the inputs of a vehicle are, how they turn it, and what limits them.

use super::{programme::InputLimits, stage::Stage};
use crate::track::steering::SteeringInput;
use agv_core::{
    geometry::Twist2,
    kinematics::{MotionLimits, SteeringLimits},
    path::Gear,
};

/// How the vehicle is told to turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Turn {
    /// By a turn rate.
    Rate,
    /// By a steering angle; in reverse, the other way round.
    Angle { steering: SteeringLimits, sign: f64 },
}

impl Turn {
    pub(super) const fn of(limits: &MotionLimits, gear: Gear) -> Self {
        match limits.steering {
            None => Self::Rate,
            Some(steering) => Self::Angle { steering, sign: if matches!(gear, Gear::Forward) { 1.0 } else { -1.0 } },
        }
    }

    /// The input that drives a curvature at a speed, with the slip made up for.
    pub(super) fn for_curvature(&self, curvature: f64, speed: f64, slip: f64) -> f64 {
        match self {
            Self::Rate => speed * curvature / slip,
            Self::Angle { steering, sign } => {
                (sign * steering.wheelbase * curvature / slip).atan().clamp(-steering.max_angle, steering.max_angle)
            }
        }
    }

    /// Turn rate that an input makes at a speed.
    pub(super) fn yaw_rate(&self, speed: f64, input: f64) -> f64 {
        match self {
            Self::Rate => input,
            Self::Angle { steering, sign } => sign * speed * steering.curvature(input),
        }
    }

    /// Linearises the turn rate about the path's curvature.
    pub(super) fn linearise(&self, stage: &mut Stage, slip: f64) {
        match self {
            Self::Rate => (stage.turn, stage.per_speed, stage.rest) = (slip, 0.0, 0.0),
            Self::Angle { steering, sign } => {
                let angle = self.for_curvature(stage.curvature, stage.speed, slip);
                let tan = angle.tan();
                stage.turn = slip * sign * stage.speed * (1.0 + tan * tan) / steering.wheelbase;
                stage.per_speed = slip * sign * tan / steering.wheelbase;
                stage.rest = -stage.turn * angle;
            }
        }
    }

    /// Greatest input at a speed, of either sign.
    pub(super) fn greatest(&self, limits: &MotionLimits, speed: f64) -> f64 {
        let speed = speed.abs().max(f64::MIN_POSITIVE);
        let sideways = limits.lateral_acceleration.map_or(f64::INFINITY, |a| a / speed);
        let rate = limits.twist.yaw_rate.min(sideways);
        match self {
            Self::Rate => rate,
            Self::Angle { steering, .. } => (steering.wheelbase * rate / speed).atan().min(steering.max_angle),
        }
    }
}

/// What the vehicle is told now, and how fast that may change: speed, turn and sideways speed.
pub(super) fn input_limits(input: &SteeringInput<'_>, turn: &Turn, step: f64) -> [InputLimits; 3] {
    let (limits, now, dt) = (&input.limits.twist, input.twist, input.dt);
    let (slow, fast) = (limits.deceleration, limits.acceleration);
    let first_rise = if now.vx < 0.0 { slow } else { fast };
    let (turn_now, rate) = match turn {
        Turn::Rate => (now.yaw_rate, limits.yaw_acceleration),
        Turn::Angle { steering, sign } => (present_angle(input, steering, *sign), steering.max_rate),
    };
    let sideways = slow.min(fast);
    [
        InputLimits { now: now.vx, first: [slow * dt, first_rise * dt], change: [slow * step, fast * step] },
        InputLimits { now: turn_now, first: [rate * dt; 2], change: [rate * step; 2] },
        InputLimits { now: now.vy, first: [sideways * dt; 2], change: [sideways * step; 2] },
    ]
}

/// The steering angle now, or what the twist says of it, as the limits of the motion read it.
fn present_angle(input: &SteeringInput<'_>, steering: &SteeringLimits, sign: f64) -> f64 {
    let Twist2 { vx, yaw_rate, .. } = input.twist;
    let read = if vx == 0.0 { 0.0 } else { (sign * steering.wheelbase * yaw_rate / vx).atan() };
    input.state.steering.unwrap_or(read)
}
