//! Linear plants against closed forms and against a reference integration.

use super::*;
use nalgebra::SMatrix;
use proptest::prelude::*;

fn plant(numerator: &[f64], denominator: &[f64]) -> LinearPlant {
    LinearPlant::new(TransferFunction::new(numerator, denominator).unwrap()).unwrap()
}

#[test]
fn first_order_step() {
    for (gain, time) in [(2.0, 0.5), (-3.0, 1e-4), (1e-9, 1e4)] {
        let mut lag = plant(&[gain], &[time, 1.0]);
        for k in 1..=50 {
            let dt = 0.1 * time;
            let expected = -gain * (-0.1 * f64::from(k)).exp_m1();
            assert!((lag.step(1.0, dt).unwrap() - expected).abs() < 1e-13 * gain.abs());
        }
    }
}

#[test]
fn second_order_step_at_any_dt() {
    let (zeta, omega) = (0.3_f64, 20.0);
    let root = (1.0 - zeta * zeta).sqrt();
    let expected =
        |t: f64| 1.0 - (-zeta * omega * t).exp() * ((omega * root * t).cos() + zeta / root * (omega * root * t).sin());
    let mut swing = plant(&[omega * omega], &[1.0, 2.0 * zeta * omega, omega * omega]);
    let mut t = 0.0;
    for dt in [0.001, 0.02, 0.02, 0.3, 0.007, 1.0].into_iter().cycle().take(60) {
        t += dt;
        assert!((swing.step(1.0, dt).unwrap() - expected(t)).abs() < 1e-12, "{t}");
    }
}

#[test]
fn unstable_and_integrating_plants_grow_as_they_should() {
    let (mut growing, mut triple) = (plant(&[1.0], &[1.0, -2.0]), plant(&[6.0], &[1.0, 0.0, 0.0, 0.0]));
    for k in 1..=100 {
        let t = 0.1 * f64::from(k);
        let expected = 0.5 * (2.0 * t).exp_m1();
        assert!((growing.step(1.0, 0.1).unwrap() - expected).abs() < 1e-11 * expected);
        assert!((triple.step(1.0, 0.1).unwrap() - t.powi(3)).abs() < 1e-10 * t.powi(3));
    }
}

#[test]
fn direct_feed_through_and_static_gains() {
    // (2 s + 3) / (s + 1) = 2 + 1 / (s + 1).
    let mut lead = plant(&[2.0, 3.0], &[1.0, 1.0]);
    assert!((lead.step(1.0, 1e-9).unwrap() - 2.0).abs() < 1e-8);
    assert!((lead.step(1.0, 50.0).unwrap() - 3.0).abs() < 1e-12);
    let mut gain = plant(&[5.0], &[2.0]).with_dead_time(0.1).unwrap();
    assert_eq!(gain.step(1.0, 0.1).unwrap(), 0.0);
    assert_eq!(gain.step(2.0, 0.1).unwrap(), 2.5);
}

/// Dead times, whole and fractional: the response is the one without, later.
#[test]
fn dead_time_shifts_the_response() {
    let dt = 0.02;
    for dead_time in [0.0, 0.02, 0.05, 0.013, 0.333, 0.06] {
        let mut late = plant(&[1.0], &[1.0, 1.0]).with_dead_time(dead_time).unwrap();
        for k in 1..=100 {
            let t = (f64::from(k) * dt - dead_time).max(0.0);
            let y = late.step(1.0, dt).unwrap();
            assert!((y + (-t).exp_m1()).abs() < 1e-12, "{dead_time} {k}: {y}");
        }
    }
}

/// A pulse under way in the dead time arrives when it should although `dt` is halved meanwhile.
#[test]
fn inputs_under_way_survive_a_change_of_dt() {
    let mut late = plant(&[1.0], &[1.0, 0.0]).with_dead_time(0.4).unwrap();
    late.step(1.0, 0.1).unwrap();
    late.step(0.0, 0.1).unwrap();
    let outputs: Vec<f64> = (0..10).map(|_| late.step(0.0, 0.05).unwrap()).collect();
    // From 0.4 s to 0.5 s the integrator rises by 0.1; the outputs are those at 0.25, 0.3, ...
    for (k, expected) in [0.0, 0.0, 0.0, 0.0, 0.05, 0.1, 0.1, 0.1, 0.1, 0.1].into_iter().enumerate() {
        assert!((outputs[k] - expected).abs() < 1e-12, "{outputs:?}");
    }
}

#[test]
fn the_actuator_limits_range_and_rate() {
    let limits = ActuatorLimits { min: -1.0, max: 2.0, rate: 5.0 };
    let mut integrator = plant(&[1.0], &[1.0, 0.0]).with_actuator(limits).unwrap();
    // 0.5, 1.0, 1.5, 2.0, 2.0 times 0.1.
    let rising: Vec<f64> = (0..5).map(|_| integrator.step(1e9, 0.1).unwrap()).collect();
    for (y, expected) in rising.iter().zip([0.05, 0.15, 0.3, 0.5, 0.7]) {
        assert!((y - expected).abs() < 1e-12, "{rising:?}");
    }
}

proptest! {
    /// Any plant of order up to eight against the exponential by nalgebra of the companion matrix, written down apart
    /// from ours and not scaled.
    #[test]
    fn zero_order_hold_is_exact(
        denominator in prop::collection::vec(-4.0..4.0_f64, 8),
        numerator in prop::collection::vec(-4.0..4.0_f64, 8),
        order in 1_usize..=8,
        inputs in prop::collection::vec(-1.0..1.0_f64, 10),
        dt in 0.001..0.3_f64,
    ) {
        let mut a = SMatrix::<f64, 9, 9>::zeros();
        for i in 0..order - 1 {
            a[(i, i + 1)] = dt;
        }
        for i in 0..order {
            a[(order - 1, i)] = -denominator[i] * dt;
        }
        a[(order - 1, 8)] = dt;
        let step = a.exp();
        let highest_first = |c: &[f64]| c[..order].iter().rev().copied().collect::<Vec<_>>();
        let mut full = vec![1.0];
        full.extend(highest_first(&denominator));
        let mut ours = plant(&highest_first(&numerator), &full);
        let mut state = SMatrix::<f64, 9, 1>::zeros();
        let mut scale = 1.0_f64;
        for input in inputs {
            state[8] = input;
            state = step * state;
            let expected: f64 = (0..order).map(|i| numerator[i] * state[i]).sum();
            scale = scale.max(state.amax());
            prop_assert!((ours.step(input, dt).unwrap() - expected).abs() < 1e-10 * scale);
        }
        ours.reset();
        prop_assert_eq!(ours.output(), 0.0);
    }

    #[test]
    fn reset_forgets_and_clones_go_on_alike(inputs in prop::collection::vec(-1.0..1.0_f64, 1..30)) {
        let mut one = StandIn::P1.plant().unwrap().with_dead_time(0.035).unwrap();
        let run = |plant: &mut LinearPlant| inputs.iter().map(|&u| plant.step(u, 0.01).unwrap()).collect::<Vec<_>>();
        let first = run(&mut one);
        let mut other = one.clone();
        prop_assert_eq!(run(&mut one), run(&mut other));
        one.reset();
        prop_assert_eq!(run(&mut one), first);
    }
}

#[test]
fn bad_transfer_functions_are_refused() {
    let new = |numerator: &[f64], denominator: &[f64]| TransferFunction::new(numerator, denominator);
    assert_eq!(new(&[1.0, 0.0], &[1.0]), Err(Error::Improper { numerator: 1, denominator: 0 }));
    assert_eq!(new(&[1.0, 0.0, 0.0], &[0.0, 1.0, 1.0]), Err(Error::Improper { numerator: 2, denominator: 1 }));
    assert!(new(&[1.0], &[]).is_err() && new(&[1.0], &[0.0, 0.0]).is_err());
    assert!(new(&[f64::NAN], &[1.0]).is_err() && new(&[1.0], &[1.0, f64::INFINITY]).is_err());
    assert!(new(&[1.0], &[1.0; 10]).is_err(), "order nine");
    assert!(new(&[1e300], &[1e-300, 1.0]).is_err(), "not monic in numbers");
    assert_eq!(new(&[], &[2.0, 1.0]).unwrap().dc_gain(), 0.0);
    assert_eq!(new(&[0.0, 0.0, 3.0], &[0.0, 2.0, 1.0]).unwrap().order(), 1, "leading zeros do not count");
}

#[test]
fn bad_steps_are_refused_and_change_nothing() {
    let mut p1 = StandIn::P1.plant().unwrap().with_dead_time(0.03).unwrap();
    p1.step(1.0, 0.01).unwrap();
    let before = p1.clone();
    for (input, dt) in [(f64::NAN, 0.01), (f64::INFINITY, 0.01), (0.0, 0.0), (0.0, -0.01), (0.0, f64::NAN), (0.0, 1e-9)]
    {
        assert!(p1.step(input, dt).is_err(), "{input} {dt}");
        assert_eq!(p1, before);
    }
    assert!(p1.clone().with_dead_time(-0.1).is_err() && p1.clone().with_dead_time(f64::NAN).is_err());
    for (min, max, rate) in [(1.0, 2.0, 1.0), (-1.0, -0.5, 1.0), (f64::NAN, 1.0, 1.0), (-1.0, 1.0, 0.0)] {
        assert!(p1.clone().with_actuator(ActuatorLimits { min, max, rate }).is_err());
    }
    // Grown beyond all numbers, which is an outcome.
    let mut growing = plant(&[1.0], &[1.0, -1.0]);
    assert!((0..1000).any(|_| !growing.step(1.0, 1.0).unwrap().is_finite()));
}

#[test]
fn stand_ins_are_what_they_say() {
    for stand_in in StandIn::ALL {
        assert_eq!(stand_in.name().parse(), Ok(stand_in));
        assert!(stand_in.step_test().is_ok());
    }
    assert!("p9".parse::<StandIn>().is_err());
}
