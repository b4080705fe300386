use super::*;
use crate::kinematics::DoubleAckermannParams;
use proptest::prelude::*;

/// Zero often: limits at zero and motions at rest are where joint limits go wrong.
fn maybe_zero(most: f64) -> impl Strategy<Value = f64> {
    prop_oneof![1 => Just(0.0), 6 => 0.0..most]
}

fn twists() -> impl Strategy<Value = Twist2> {
    let part = |most: f64| prop_oneof![1 => Just(0.0), 6 => -most..most];
    (part(3.0), part(1.5), part(3.0)).prop_map(|(vx, vy, w)| Twist2::new(vx, vy, w))
}

fn motions() -> impl Strategy<Value = Motion> {
    (twists(), prop::option::of(-1.4..1.4_f64)).prop_map(|(twist, steering)| Motion { twist, steering })
}

/// Vehicles of all classes, sensible and not.
fn vehicles() -> impl Strategy<Value = MotionLimits> {
    let twist = (
        maybe_zero(2.0),
        maybe_zero(1.0),
        maybe_zero(1.0),
        maybe_zero(2.0),
        0.05..3.0_f64,
        0.05..3.0_f64,
        0.1..4.0_f64,
    )
        .prop_map(
            |(forward_speed, reverse_speed, lateral_speed, yaw_rate, acceleration, deceleration, yaw_acceleration)| {
                TwistLimits {
                    forward_speed,
                    reverse_speed,
                    lateral_speed,
                    yaw_rate,
                    acceleration,
                    deceleration,
                    yaw_acceleration,
                }
            },
        );
    let steering = (0.2..3.0_f64, 0.01..1.5_f64, 0.05..2.0_f64)
        .prop_map(|(wheelbase, max_angle, max_rate)| SteeringLimits { wheelbase, max_angle, max_rate });
    (twist, prop::option::of(steering), prop::option::of(maybe_zero(2.0)))
        .prop_map(|(twist, steering, lateral_acceleration)| MotionLimits { twist, steering, lateral_acceleration })
}

/// A motion that the vehicle can drive on for ever.
fn sound(limits: &MotionLimits, motion: &Motion) -> Motion {
    let twist = limits.clamp(&motion.twist).unwrap();
    let steering =
        limits.steering.map(|s| if twist.vx == 0.0 { 0.0 } else { (s.wheelbase * twist.yaw_rate / twist.vx).atan() });
    Motion { twist, steering }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// From any motion, sound or not, a step is one that the limits allow.
    #[test]
    fn what_a_step_returns_is_allowed(limits in vehicles(), from in motions(), to in motions(), dt in maybe_zero(0.5)) {
        let next = limits.step(&from, &to, dt).unwrap();
        prop_assert!(limits.allows_step(&from, &next, dt), "{next:?}");
        // And once more from there, as in a drive.
        let then = limits.step(&next, &to, dt).unwrap();
        prop_assert!(limits.allows_step(&next, &then, dt), "{next:?} {then:?}");
    }

    /// From a sound motion every limit holds by itself, written out.
    #[test]
    fn every_limit_holds(limits in vehicles(), from in motions(), to in motions(), dt in 0.001..0.5_f64) {
        let from = sound(&limits, &from);
        let next = limits.step(&from, &to, dt).unwrap();
        let (l, t) = (limits.twist, next.twist);
        prop_assert!(t.vx <= l.forward_speed + 1e-9 && t.vx >= -l.reverse_speed - 1e-9 && t.vy.abs() <= l.lateral_speed + 1e-9);
        prop_assert!(t.yaw_rate.abs() <= l.yaw_rate + 1e-9);
        if let Some(limit) = limits.lateral_acceleration {
            prop_assert!(t.speed() * t.yaw_rate.abs() <= limit + 1e-9, "{next:?}");
        }
        let change = (t.vx - from.twist.vx).abs();
        prop_assert!(change <= l.acceleration.max(l.deceleration) * dt + 1e-9);
        if let Some(s) = limits.steering {
            let (before, after) = (from.steering.unwrap(), next.steering.unwrap());
            prop_assert!((after - before).abs() <= s.max_rate * dt + 1e-9 && after.abs() <= s.max_angle + 1e-9);
            prop_assert!((t.yaw_rate * s.wheelbase - t.vx * after.tan()).abs() <= 1e-9 && t.vy == 0.0);
        } else {
            prop_assert!((t.yaw_rate - from.twist.yaw_rate).abs() <= l.yaw_acceleration * dt + 1e-9);
        }
    }

    /// Whatever is in the way, repeated steps come to what the target means for this vehicle.
    #[test]
    fn steps_arrive(limits in vehicles(), from in motions(), to in twists()) {
        let goal = limits.clamp(&to).unwrap();
        let mut motion = from;
        for _ in 0..1500 {
            motion = limits.step(&motion, &goal.into(), 0.1).unwrap();
        }
        let error = (motion.twist.vx - goal.vx).abs() + (motion.twist.vy - goal.vy).abs() + (motion.twist.yaw_rate - goal.yaw_rate).abs();
        prop_assert!(error < 1e-6, "{motion:?} {goal:?}");
    }

    /// A stop in a bend is as short as one on a straight line, whatever steers.
    #[test]
    fn braking_keeps_the_stopping_distance(limits in vehicles(), from in motions(), dt in 0.01..0.3_f64) {
        let mut motion = sound(&limits, &from);
        let promised = limits.stopping_distance(motion.twist.speed(), dt).unwrap();
        let mut travelled = 0.0;
        for _ in 0..6000 {
            travelled += motion.twist.speed() * dt;
            motion = limits.brake(&motion, dt).unwrap();
            if motion.twist == Twist2::ZERO {
                break;
            }
        }
        prop_assert!(motion.twist.speed() == 0.0 && travelled <= promised + 1e-9, "{travelled} beyond {promised}");
    }

    #[test]
    fn clamping_is_idempotent_and_sound(limits in vehicles(), twist in twists()) {
        let once = limits.clamp(&twist).unwrap();
        let twice = limits.clamp(&once).unwrap();
        prop_assert!((once.vx - twice.vx).abs() < 1e-9 && (once.yaw_rate - twice.yaw_rate).abs() < 1e-9);
        prop_assert!(limits.allows_step(&once.into(), &once.into(), 0.1), "{once:?}");
        let curvature = once.yaw_rate.abs();
        prop_assert!(limits.steering.is_none_or(|s| curvature <= s.max_curvature() * once.vx.abs() + 1e-9));
    }

    /// A step that breaks one limit only, by a little, is not allowed.
    #[test]
    fn each_limit_is_seen(excess in 1e-6..0.5_f64) {
        let limits = MotionLimits {
            twist: TwistLimits { yaw_rate: 0.5, ..TwistLimits::default() },
            steering: Some(SteeringLimits::default()),
            lateral_acceleration: Some(0.25),
        };
        let at = |v: f64, angle: f64| {
            let curvature = SteeringLimits::default().curvature(angle);
            Motion { twist: Twist2::new(v, 0.0, v * curvature), steering: Some(angle) }
        };
        let max = SteeringLimits::default().max_angle;
        for (from, good, bad) in [
            (at(0.5, 0.0), at(0.55, 0.0), at(0.55 + excess, 0.0)),
            (at(0.5, 0.0), at(0.5, 0.05), at(0.5, 0.05 + excess)),
            (at(0.1, max), at(0.1, max), at(0.1, max + excess)),
        ] {
            prop_assert!(limits.allows_step(&from, &good, 0.1) && !limits.allows_step(&from, &bad, 0.1));
        }
        // Lateral: 0.25 / 0.8² = 0.39 1/m.
        let bend = (1.2 * 0.25 / 0.64_f64).atan();
        prop_assert!(limits.allows_step(&at(0.8, bend - 0.01), &at(0.8, bend), 0.1));
        prop_assert!(!limits.allows_step(&at(0.8, bend), &at(0.8 + 0.05 * excess, bend), 0.1));
        // A twist that its angle does not make.
        let slip = Motion { twist: Twist2::new(0.5, 0.0, excess), steering: Some(0.0) };
        prop_assert!(!limits.allows_step(&at(0.5, 0.0), &slip, 0.1));
    }
}

#[test]
fn wheels_turn_at_rest_when_told() {
    let truck = MotionLimits { steering: Some(SteeringLimits::default()), ..TwistLimits::default().into() };
    let target = Motion { twist: Twist2::ZERO, steering: Some(0.3) };
    let mut motion = Motion { twist: Twist2::ZERO, steering: Some(0.0) };
    for _ in 0..6 {
        motion = truck.step(&motion, &target, 0.1).unwrap();
    }
    assert!((motion.steering.unwrap() - 0.3).abs() < 1e-12 && motion.twist == Twist2::ZERO);
    assert_eq!(truck.brake(&motion, 0.1).unwrap(), motion, "the wheels stay in a stop");
}

#[test]
fn a_double_ackermann_vehicle_turns_on_half_the_radius() {
    let params = DoubleAckermannParams::default();
    let double = SteeringLimits::for_double_ackermann(&params, 0.5).unwrap();
    assert!((double.min_turning_radius() - 0.5 * SteeringLimits::default().min_turning_radius()).abs() < 1e-12);
    let limits = MotionLimits { steering: Some(double), ..TwistLimits::default().into() };
    assert!(!limits.turns_on_the_spot() && limits.max_curvature() > 1.0);
}

#[test]
fn a_vehicle_that_steers_an_axle_is_not_holonomic() {
    let free: MotionLimits = TwistLimits { lateral_speed: 0.3, ..TwistLimits::default() }.into();
    let steered = MotionLimits { steering: Some(SteeringLimits::default()), ..free };
    assert!(free.is_holonomic() && !steered.is_holonomic() && !MotionLimits::default().is_holonomic());
}

#[test]
fn bad_input_is_refused() {
    let good = MotionLimits { steering: Some(SteeringLimits::default()), ..TwistLimits::default().into() };
    let rest = Motion::REST;
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let flying = Motion { twist: Twist2::new(bad, 0.0, 0.0), steering: None };
        let bent = Motion { twist: Twist2::ZERO, steering: Some(bad) };
        for motion in [flying, bent] {
            assert!(
                !motion.is_finite()
                    && good.step(&motion, &rest, 0.1).is_err()
                    && good.step(&rest, &motion, 0.1).is_err()
            );
            assert!(!good.allows_step(&rest, &motion, 0.1));
        }
        assert!(good.step(&rest, &rest, bad).is_err() && good.clamp(&flying.twist).is_err());
        assert!(MotionLimits { lateral_acceleration: Some(bad), ..good }.validate().is_err());
    }
    assert!(good.step(&rest, &rest, -0.1).is_err());
    assert!(MotionLimits { lateral_acceleration: Some(-0.1), ..good }.step(&rest, &rest, 0.1).is_err());
    let broken = SteeringLimits { wheelbase: 0.0, ..SteeringLimits::default() };
    assert!(MotionLimits { steering: Some(broken), ..good }.clamp(&Twist2::ZERO).is_err());
}
