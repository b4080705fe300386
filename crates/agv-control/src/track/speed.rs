//! How fast to drive: bends ahead, the stop ahead, and what the vehicle can do.

use super::course::Bend;
use agv_core::kinematics::TwistLimits;

/// Speed from which a stop after `distance` metres is possible when `dt` seconds pass at it first: the root of
/// `v dt + v² / (2 a) = distance`.
pub(super) fn stopping_speed(distance: f64, deceleration: f64, dt: f64) -> f64 {
    let distance = distance.max(0.0);
    deceleration * ((dt * dt + 2.0 * distance / deceleration).sqrt() - dt)
}

/// Speed allowed in a bend by the turn rate, by the lateral acceleration, and, where the bend begins or ends, by the
/// yaw acceleration `v² dκ/ds`.
pub(super) fn bend_speed(bend: &Bend, limits: &TwistLimits, lateral_acceleration: f64) -> f64 {
    let limit = |limit: f64, per: f64| if per > 0.0 { limit / per } else { f64::INFINITY };
    limit(limits.yaw_rate, bend.curvature)
        .min(limit(lateral_acceleration, bend.curvature).sqrt())
        .min(limit(limits.yaw_acceleration, bend.change).sqrt())
}

/// Greatest speed now, so that every bend ahead can be entered at its own speed by braking.
///
/// `bends` yields the distance to each bend, in metres, in order; the search ends where the vehicle could stop.
pub(super) fn speed_for_bends(
    bends: impl Iterator<Item = (f64, Bend)>,
    limits: &TwistLimits,
    lateral_acceleration: f64,
    top_speed: f64,
) -> f64 {
    let braking_distance = top_speed * top_speed / (2.0 * limits.deceleration);
    bends.take_while(|&(ahead, _)| ahead <= braking_distance).fold(top_speed, |speed, (ahead, bend)| {
        let there = bend_speed(&bend, limits, lateral_acceleration);
        speed.min((there * there + 2.0 * limits.deceleration * ahead).sqrt())
    })
}

/// The value nearest to `wanted` that can be reached from `now` in `dt` seconds, told apart by whether the magnitude
/// grows or shrinks. Across zero the vehicle stops first.
pub(super) fn reachable_speed(now: f64, wanted: f64, limits: &TwistLimits, dt: f64) -> f64 {
    if now * wanted < 0.0 || wanted.abs() < now.abs() {
        let target = if now * wanted < 0.0 { 0.0 } else { wanted.abs() };
        (now.abs() - limits.deceleration * dt).max(target).copysign(now)
    } else {
        let direction = if wanted == 0.0 { now } else { wanted };
        (now.abs() + limits.acceleration * dt).min(wanted.abs()).copysign(direction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::Twist2;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_stopping_speed_stops_at_the_distance(distance in 0.0..20.0_f64, a in 0.1..3.0_f64, dt in 0.001..0.2_f64) {
            let v = stopping_speed(distance, a, dt);
            prop_assert!((v * dt + v * v / (2.0 * a) - distance).abs() < 1e-9);
        }

        #[test]
        fn reachable_speeds_keep_to_the_limits(now in -0.3..1.0_f64, wanted in -0.3..1.0_f64, dt in 0.001..0.5_f64) {
            let limits = TwistLimits { acceleration: 0.4, deceleration: 0.9, ..TwistLimits::default() };
            let next = reachable_speed(now, wanted, &limits, dt);
            let step = |v| Twist2::new(v, 0.0, 0.0);
            prop_assert!(limits.allows_step(&step(now), &step(next), dt), "{} -> {}", now, next);
            prop_assert!((next - wanted).abs() <= (now - wanted).abs() + 1e-12);
        }
    }
}
