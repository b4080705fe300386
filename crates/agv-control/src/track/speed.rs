//! How fast to drive: bends ahead, the stop ahead, and what the vehicle can do.

use super::course::Bend;
use agv_core::kinematics::TwistLimits;

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

#[cfg(test)]
mod tests {
    use super::*;

    /// Braking from the allowed speed over the distance to a bend ends at the bend's own speed.
    #[test]
    fn a_bend_is_entered_at_its_own_speed() {
        let limits = TwistLimits { yaw_rate: 0.5, yaw_acceleration: 100.0, ..TwistLimits::default() };
        let bend = Bend { curvature: 2.0, change: 0.0 };
        let speed = speed_for_bends([(0.3, bend)].into_iter(), &limits, 10.0, 1.0);
        let at_bend = (speed * speed - 2.0 * limits.deceleration * 0.3).sqrt();
        assert!((at_bend * bend.curvature - limits.yaw_rate).abs() < 1e-12);
        assert_eq!(speed_for_bends([(1.1, bend)].into_iter(), &limits, 10.0, 1.0), 1.0);
    }

    #[test]
    fn each_limit_of_the_vehicle_slows_it() {
        let limits = TwistLimits { yaw_rate: 1.0, yaw_acceleration: 0.5, ..TwistLimits::default() };
        assert_eq!(bend_speed(&Bend { curvature: 0.0, change: 0.0 }, &limits, 0.5), f64::INFINITY);
        assert_eq!(bend_speed(&Bend { curvature: 4.0, change: 0.0 }, &limits, 100.0), 0.25);
        assert_eq!(bend_speed(&Bend { curvature: 0.5, change: 0.0 }, &limits, 0.125), 0.5);
        assert_eq!(bend_speed(&Bend { curvature: 0.1, change: 8.0 }, &limits, 100.0), 0.25);
    }
}
