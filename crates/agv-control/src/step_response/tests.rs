//! The fast step test against the loop of its parts.

use super::*;
use crate::pid::{AntiWindup, Pid, PidParams};
use crate::plant::{ActuatorLimits, LinearPlant, Plant, StandIn, TransferFunction};
use proptest::prelude::*;

#[test]
fn the_fixed_point_of_p1() {
    let cost = StandIn::P1.step_test().unwrap().cost([3.18, 3.4, 1.61].into());
    assert!((cost - 1.03717).abs() < 1e-5, "{cost}");
}

/// The sheet's recursion, word for word, on the closed form of P1's response to a held input: two poles
/// `-0.75 ± i ω`, which is neither our matrix exponential nor our kernel.
fn sheet_cost(kp: f64, ki: f64, kd: f64) -> f64 {
    let (dt, tf): (f64, f64) = (0.01, 0.02);
    let a = tf / (tf + dt);
    let w = (1.6_f64 - 0.75 * 0.75).sqrt();
    let (decay, cos, sin) = ((-0.75 * dt).exp(), (w * dt).cos(), (w * dt).sin());
    let (mut e, mut e_prev, mut integral, mut d, mut y, mut v, mut cost) = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for k in 1..=1000 {
        integral += e * dt;
        d = a * d + (1.0 - a) * (e - e_prev) / dt;
        e_prev = e;
        let u = (kp * e + ki * integral + kd * d).clamp(-10.0, 10.0);
        // With z = y - u: z'' + 1.5 z' + 1.6 z = 0.
        let z: f64 = y - u;
        let b = (v + 0.75 * z) / w;
        y = u + decay * (z * cos + b * sin);
        v = decay * ((-0.75 * z + w * b) * cos - (0.75 * b + w * z) * sin);
        e = 1.0 - y;
        cost += f64::from(k) * dt * f64::abs(e) * dt;
    }
    cost
}

proptest! {
    #[test]
    fn p1_is_the_recursion_of_the_sheet(kp in 0.0..50.0_f64, ki in 0.0..50.0_f64, kd in 0.0..50.0_f64) {
        let (ours, sheet) = (StandIn::P1.step_test().unwrap().cost([kp, ki, kd].into()), sheet_cost(kp, ki, kd));
        // A loop on its limits may swing long, and amplify rounding as it does.
        prop_assert!((ours - sheet).abs() <= 1e-6 * sheet, "{ours} {sheet}");
    }

    /// Every variant of the kernel against `LinearPlant` under `Pid`, and side by side against alone.
    #[test]
    fn the_kernel_is_the_loop_of_its_parts(
        gains in prop::collection::vec((0.0..3.0_f64, 0.0..1.5_f64, 0.0..0.5_f64), 1..20),
        order in 1_usize..8,
        dead_time in prop::sample::select(vec![0.0, 0.05, 0.073, 0.5]),
        rate in prop::sample::select(vec![f64::MAX, 4.0]),
        feed_through in prop::sample::select(vec![0.0, 0.1]),
        set_point in prop::sample::select(vec![1.0, -2.0]),
    ) {
        // Poles at -1, -2, ...; gain one.
        let mut denominator = vec![1.0];
        for pole in 1..=order {
            denominator.push(0.0);
            for i in (1..denominator.len()).rev() {
                denominator[i] += pole as f64 * denominator[i - 1];
            }
        }
        let mut numerator: Vec<f64> = denominator.iter().map(|c| feed_through * c).collect();
        *numerator.last_mut().unwrap() = *denominator.last().unwrap();
        let mut plant = LinearPlant::new(TransferFunction::new(&numerator, &denominator).unwrap())
            .unwrap()
            .with_dead_time(dead_time)
            .unwrap()
            .with_actuator(ActuatorLimits { min: -2.5, max: 3.0, rate })
            .unwrap();
        let params = StepTestParams { set_point, dt: 0.02, horizon: 5.0, filter_time: 0.05 };
        let test = StepTest::new(&plant, params).unwrap();
        let gains: Vec<PidGains> = gains.into_iter().map(|(p, i, d)| [p, i, d].into()).collect();
        let mut costs = vec![0.0; gains.len()];
        let mut figures = vec![StepFigures::default(); gains.len()];
        test.cost_batch(&gains, &mut costs).unwrap();
        test.figures_batch(&gains, &mut figures).unwrap();
        for ((gains, cost), figures) in gains.iter().zip(&costs).zip(&figures) {
            prop_assert_eq!(test.cost(*gains).to_bits(), cost.to_bits());
            prop_assert_eq!(test.figures(*gains), *figures);
            prop_assert_eq!(figures.itae.to_bits(), cost.to_bits());

            let mut pid = Pid::new(test.controller(*gains)).unwrap();
            let mut response = StepResponse::default();
            simulate_step(&mut plant, &mut pid, set_point, 0.02, 5.0, &mut response).unwrap();
            let parts = response.figures();
            for (ours, theirs) in [
                (figures.iae, parts.iae),
                (figures.ise, parts.ise),
                (figures.itae, parts.itae),
                (figures.itse, parts.itse),
                (figures.overshoot, parts.overshoot),
                (figures.final_error, parts.final_error),
            ] {
                prop_assert!((ours - theirs).abs() <= 1e-7 * theirs.max(1.0), "{ours} {theirs}");
            }
        }
    }
}

#[test]
fn gains_that_are_no_numbers_lose() {
    for stand_in in StandIn::ALL {
        let test = stand_in.step_test().unwrap();
        let good = PidGains { proportional: 1.0, integral: 0.1, derivative: 1.0 };
        let mut gains = vec![good; 11];
        for (slot, bad) in gains.iter_mut().zip([f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX]) {
            slot.proportional = bad;
        }
        (gains[4].integral, gains[5].derivative) = (f64::NAN, f64::INFINITY);
        let mut costs = vec![0.0; gains.len()];
        test.cost_batch(&gains, &mut costs).unwrap();
        assert!(costs[..6].iter().all(|&cost| cost == f64::INFINITY), "{costs:?}");
        assert!(costs[6..].iter().all(|cost| cost.to_bits() == test.cost(good).to_bits() && cost.is_finite()));
        assert!(gains[..6].iter().all(|&gains| test.cost(gains) == f64::INFINITY));
        assert_eq!(test.figures(gains[0]), StepFigures::DIVERGED);
        assert!(test.cost_batch(&gains, &mut costs[1..]).is_err());
    }
}

/// P3 under no control grows as its unstable pole says, and over a long time beyond all numbers.
#[test]
fn an_unstable_loop_is_simulated_and_loses() {
    let plant = StandIn::P3.plant().unwrap();
    let none = PidGains { proportional: 1e-9, ..PidGains::default() };
    let short = StepTest::new(&plant, StepTestParams { horizon: 20.0, ..Default::default() }).unwrap();
    let long = StepTest::new(&plant, StepTestParams { horizon: 9000.0, ..Default::default() }).unwrap();
    assert!(short.cost(none).is_finite() && short.cost(none) > 100.0);
    assert_eq!(long.cost(none), f64::INFINITY);
    let mut pid = Pid::new(long.controller(none)).unwrap();
    let mut response = StepResponse::default();
    simulate_step(&mut plant.clone(), &mut pid, 1.0, 0.01, 9000.0, &mut response).unwrap();
    assert!(response.diverged && response.outputs.iter().all(|y| y.is_finite()));
    assert_eq!(response.figures(), StepFigures::DIVERGED);
}

#[test]
fn bad_tests_are_refused() {
    let plant = StandIn::P1.plant().unwrap();
    let good = StepTestParams::default();
    for params in [
        StepTestParams { set_point: f64::NAN, ..good },
        StepTestParams { dt: 0.0, ..good },
        StepTestParams { dt: -0.1, ..good },
        StepTestParams { dt: f64::NAN, ..good },
        StepTestParams { horizon: 0.001, ..good },
        StepTestParams { horizon: f64::INFINITY, ..good },
        StepTestParams { horizon: 1e9, ..good },
        StepTestParams { filter_time: -0.1, ..good },
    ] {
        assert!(StepTest::new(&plant, params).is_err(), "{params:?}");
        let mut pid = Pid::new(PidParams { anti_windup: AntiWindup::Off, ..Default::default() }).unwrap();
        let StepTestParams { set_point, dt, horizon, filter_time } = params;
        if filter_time >= 0.0 {
            let mut response = StepResponse::default();
            assert!(simulate_step(&mut plant.clone(), &mut pid, set_point, dt, horizon, &mut response).is_err());
        }
    }
    assert_eq!(plant.output(), 0.0);
}
