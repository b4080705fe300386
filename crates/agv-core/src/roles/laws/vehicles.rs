//! The vehicles that a law should be tried with.

use crate::kinematics::{DoubleAckermannParams, MotionLimits, SteeringLimits, TwistLimits};

/// One vehicle of each class that moves differently, by name, with limits as AGVs have them: a differential drive, an Ackermann
/// and a double Ackermann vehicle, and an omnidirectional one. All limit their acceleration to the side.
pub fn vehicles() -> [(&'static str, MotionLimits); 4] {
    let twist = TwistLimits::default();
    let free = MotionLimits { lateral_acceleration: Some(0.6), ..twist.into() };
    let single = SteeringLimits { wheelbase: 0.6, max_rate: 1.0, ..SteeringLimits::default() };
    let geometry = DoubleAckermannParams { front: 0.4, rear: 0.4, ..DoubleAckermannParams::default() };
    // The geometry is a sound one.
    let double = SteeringLimits::for_double_ackermann(&geometry, 1.0).unwrap_or(single);
    [
        ("differential", free),
        ("ackermann", MotionLimits { steering: Some(single), ..free }),
        ("double ackermann", MotionLimits { steering: Some(double), ..free }),
        ("omnidirectional", MotionLimits { twist: TwistLimits { lateral_speed: 0.5, ..twist }, ..free }),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_vehicles_are_sound_and_differ() {
        let all = vehicles();
        assert!(all.iter().all(|(_, limits)| limits.validate().is_ok()));
        assert!(all[1].1.max_curvature() < all[2].1.max_curvature());
        assert!(all[0].1.turns_on_the_spot() && !all[2].1.turns_on_the_spot());
    }
}
