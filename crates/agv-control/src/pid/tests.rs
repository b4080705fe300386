//! What both forms promise.

use super::*;
use agv_core::roles::{Controller, laws};
use proptest::prelude::*;

fn full() -> PidParams {
    PidParams { proportional: 2.0, integral: 1.0, derivative: 0.3, filter_time: 0.05, ..Default::default() }
}

#[test]
fn obeys_the_laws_of_its_role() {
    laws::controller(&mut Pid::new(full()).unwrap()).unwrap();
    let limited = PidParams { output_min: -1.0, output_max: 0.5, output_rate: 3.0, ..full() };
    laws::controller(&mut Pid::new(limited).unwrap()).unwrap();
    laws::controller(&mut VelocityPid::new(limited).unwrap()).unwrap();
}

/// The closed loop of an integrator `y' = u` under PI has the poles of `s² + Kp s + Ki`: with Kp = 2 and Ki = 1 a
/// double pole at -1, whose step response is known.
#[test]
fn matches_the_continuous_loop() {
    let dt = 1e-4;
    let params = PidParams { proportional: 2.0, integral: 1.0, ..Default::default() };
    let (mut pid, mut y) = (Pid::new(params).unwrap(), 0.0);
    for k in 0..50_000 {
        let t = f64::from(k) * dt;
        let expected = 1.0 - (1.0 - t) * (-t).exp();
        assert!((y - expected).abs() < 5e-4, "{t} s: {y} instead of {expected}");
        y += pid.update(1.0, y, dt).unwrap() * dt;
    }
}

#[test]
fn a_step_of_the_set_point_does_not_kick_the_derivative() {
    let mut pid = Pid::new(PidParams { proportional: 0.0, derivative: 1.0, ..Default::default() }).unwrap();
    pid.update(0.0, 0.0, 0.01).unwrap();
    assert_eq!(pid.update(1.0, 0.0, 0.01).unwrap(), 0.0);
    assert!((pid.update(1.0, 0.02, 0.01).unwrap() + 2.0).abs() < 1e-12);
}

#[test]
fn the_integral_does_not_wind_up() {
    for anti_windup in [AntiWindup::Clamping, AntiWindup::BackCalculation { tracking_time: 0.5 }] {
        let params = PidParams { output_min: -1.0, output_max: 1.0, anti_windup, ..full() };
        let mut pid = Pid::new(params).unwrap();
        for _ in 0..10_000 {
            assert_eq!(pid.update(10.0, 0.0, 0.01).unwrap(), 1.0);
        }
        // Released, the output leaves its limit within a second; wound up it would take a hundred.
        let back = (0..100).any(|_| pid.update(0.0, 0.5, 0.01).unwrap() < 0.0);
        assert!(back, "{anti_windup:?}");
    }
}

proptest! {
    #[test]
    fn output_respects_limit_and_rate(inputs in prop::collection::vec((-5.0..5.0_f64, -5.0..5.0_f64, 0.001..0.2_f64), 1..60)) {
        let params = PidParams { output_min: -1.5, output_max: 2.0, output_rate: 4.0, ..full() };
        let (mut positional, mut velocity) = (Pid::new(params).unwrap(), VelocityPid::new(params).unwrap());
        for pid in [&mut positional as &mut dyn Controller, &mut velocity] {
            let mut last: Option<f64> = None;
            for &(set_point, measurement, dt) in &inputs {
                let output = pid.update(set_point, measurement, dt).unwrap();
                prop_assert!((-1.5..=2.0).contains(&output));
                if let Some(last) = last {
                    prop_assert!((output - last).abs() <= 4.0 * dt + 1e-12);
                }
                last = Some(output);
            }
        }
    }
}

/// The velocity form sums up what the positional form computes, as long as nothing is limited.
#[test]
fn both_forms_agree_without_limits() {
    let params = PidParams { set_point_weight: 0.7, ..full() };
    let (mut positional, mut velocity) = (Pid::new(params).unwrap(), VelocityPid::new(params).unwrap());
    for k in 0..200 {
        let (t, dt) = (0.05 * f64::from(k), if k % 3 == 0 { 0.02 } else { 0.05 });
        let (set_point, measurement) = ((0.7 * t).sin() + 1.0, (1.3 * t).cos());
        let outputs = [
            positional.update(set_point, measurement, dt).unwrap(),
            velocity.update(set_point, measurement, dt).unwrap(),
        ];
        assert!((outputs[0] - outputs[1]).abs() < 1e-11, "{k}: {outputs:?}");
    }
}

#[test]
fn new_gains_do_not_bump_the_output() {
    let mut pid = Pid::new(full()).unwrap();
    let mut last = 0.0;
    for k in 0..50 {
        last = pid.update(1.0, 0.01 * f64::from(k), 0.01).unwrap();
    }
    let mut unmoved = pid.clone();
    unmoved.set_params(*pid.params()).unwrap();
    assert_eq!(unmoved, pid);
    let (old, growth) = (pid.clone(), 0.01 * 0.51);
    pid.set_params(PidParams { proportional: 9.0, integral: 3.0, derivative: 0.1, ..full() }).unwrap();
    // The measurement stands still, so that only the integral moves, and the derivative decays.
    let next = pid.update(1.0, 0.49, 0.01).unwrap();
    let decay = 0.1 * old.rate() * (1.0 - 0.05 / 0.06);
    assert!((next - last - 3.0 * growth - decay).abs() < 1e-12, "{last} {next}");
    // A controller without integral action keeps no bias that nothing would remove.
    pid.set_params(PidParams { integral: 0.0, ..full() }).unwrap();
    assert_eq!(pid.integral(), 0.0);
    let before = pid.clone();
    assert!(pid.set_params(PidParams { filter_time: -1.0, ..full() }).is_err());
    assert_eq!(pid, before);
}

#[test]
fn automatic_goes_on_from_the_manual_output() {
    let limits = PidParams { output_min: -2.0, output_max: 2.0, ..full() };
    let mut pid = Pid::new(limits).unwrap();
    let mut velocity = VelocityPid::new(limits).unwrap();
    for _ in 0..500 {
        assert_eq!(pid.follow(1.2, 3.0, 0.5, 0.01).unwrap(), 1.2);
        assert_eq!(velocity.follow(1.2, 3.0, 0.5).unwrap(), 1.2);
    }
    // Both differ from the manual output by one step of the integral, 1 * 2.5 * 0.01.
    assert!((pid.update(3.0, 0.5, 0.01).unwrap() - 1.225).abs() < 1e-12);
    assert!((velocity.update(3.0, 0.5, 0.01).unwrap() - 1.225).abs() < 1e-12);
    assert_eq!(pid.follow(99.0, 0.0, 0.0, 0.01).unwrap(), 2.0, "by hand within the limits too");
    assert_eq!(velocity.follow(99.0, 0.0, 0.0).unwrap(), 2.0);
    for (output, set_point, measurement, dt) in
        [(f64::NAN, 0.0, 0.0, 0.01), (0.0, f64::NAN, 0.0, 0.01), (0.0, 0.0, f64::INFINITY, 0.01), (0.0, 0.0, 0.0, 0.0)]
    {
        let before = pid.clone();
        assert!(pid.follow(output, set_point, measurement, dt).is_err());
        assert_eq!(pid, before);
    }
}

#[test]
fn feed_forward_adds_to_the_output_and_is_limited_with_it() {
    let params = PidParams { output_max: 3.0, ..full() };
    let mut plain = Pid::new(params).unwrap();
    let mut fed = plain.clone();
    let (without, with) = (plain.update(0.5, 0.0, 0.01).unwrap(), fed.update_with(0.5, 0.0, 0.75, 0.01).unwrap());
    assert!((with - without - 0.75).abs() < 1e-12);
    assert_eq!(fed.update_with(0.5, 0.0, 99.0, 0.01).unwrap(), 3.0);
    assert!(fed.update_with(0.5, 0.0, f64::NAN, 0.01).unwrap_err().to_string().starts_with("feed_forward"));
}

#[test]
fn a_narrowed_range_holds_at_once() {
    let mut pid = Pid::new(PidParams { output_rate: 1.0, ..full() }).unwrap();
    pid.update(5.0, 0.0, 0.1).unwrap();
    pid.set_params(PidParams { output_rate: 1.0, output_max: 1.0, ..full() }).unwrap();
    assert_eq!(pid.update(5.0, 0.0, 0.1).unwrap(), 1.0);
}

/// Even where every gain is zero and nothing of the value would reach the output.
#[test]
fn a_value_that_is_refused_is_named() {
    let mut pid = Pid::new(PidParams { proportional: 0.0, set_point_weight: 0.0, ..PidParams::default() }).unwrap();
    for (set_point, measurement, dt, name) in [
        (f64::NAN, 0.0, 0.01, "set_point"),
        (f64::INFINITY, 0.0, 0.01, "set_point"),
        (0.0, f64::NEG_INFINITY, 0.01, "measurement"),
        (0.0, 0.0, f64::NAN, "dt"),
        (0.0, 0.0, 0.0, "dt"),
        (0.0, 0.0, -0.01, "dt"),
        (0.0, 0.0, f64::INFINITY, "dt"),
    ] {
        let error = pid.update(set_point, measurement, dt).unwrap_err();
        assert!(error.to_string().starts_with(name), "{error}");
    }
    assert_eq!(pid, Pid::new(*pid.params()).unwrap());
}

#[test]
fn bad_parameters_are_named() {
    for (name, params) in [
        ("proportional", PidParams { proportional: f64::NAN, ..full() }),
        ("integral", PidParams { integral: f64::INFINITY, ..full() }),
        ("derivative", PidParams { derivative: f64::NAN, ..full() }),
        ("filter_time", PidParams { filter_time: -1.0, ..full() }),
        ("set_point_weight", PidParams { set_point_weight: 1.5, ..full() }),
        ("output_min", PidParams { output_min: 1.0, output_max: 0.0, ..full() }),
        ("output_max", PidParams { output_max: f64::NAN, ..full() }),
        ("output_rate", PidParams { output_rate: 0.0, ..full() }),
        ("output_rate", PidParams { output_rate: f64::INFINITY, ..full() }),
        ("tracking_time", PidParams { anti_windup: AntiWindup::BackCalculation { tracking_time: 0.0 }, ..full() }),
    ] {
        let error = Pid::new(params).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
        assert!(VelocityPid::new(params).is_err(), "{name}");
    }
}

#[test]
fn an_output_beyond_all_numbers_is_an_error_and_changes_nothing() {
    let mut pid = Pid::new(PidParams { proportional: f64::MAX, ..Default::default() }).unwrap();
    assert!(pid.update(1e10, 0.0, 0.1).is_err());
    assert_eq!(pid, Pid::new(*pid.params()).unwrap());
}

/// What is fed forward counts as it changes: the same output as of the positional form.
#[test]
fn both_forms_feed_forward_alike() {
    let params =
        PidParams { proportional: 2.0, integral: 1.0, derivative: 0.1, filter_time: 0.05, ..PidParams::default() };
    let (mut positional, mut velocity) = (Pid::new(params).unwrap(), VelocityPid::new(params).unwrap());
    for k in 0..100 {
        let (y, f) = ((0.1 * f64::from(k)).sin(), (0.05 * f64::from(k)).cos());
        let [a, b] =
            [positional.update_with(0.5, y, f, 0.01), velocity.update_with(0.5, y, f, 0.01)].map(Result::unwrap);
        assert!((a - b).abs() < 1e-12, "{k}: {a} {b}");
    }
    let before = velocity.clone();
    assert!(velocity.update_with(0.5, 0.0, f64::NAN, 0.01).is_err());
    assert_eq!(velocity, before);
}
