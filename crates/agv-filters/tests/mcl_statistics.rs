//! What the parts of Monte Carlo localisation promise in the mean, over many draws and seeds.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2},
    odometry::OdometryIncrement,
    time::Stamp,
};
use agv_filters::particle::{DifferentialOdometryModel, MotionModel, OdometryNoise, Resampler, Systematic};
use nalgebra::{Matrix3, Vector3};
use rand::RngExt;

fn motion(start_from_end: Se2) -> OdometryIncrement {
    OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &start_from_end).unwrap()
}

/// Draws of the motion model have the odometry's mean and the covariance that the model states, as long as the noise is
/// small enough for first order.
#[test]
fn motion_draws_have_the_stated_moments() {
    let model = DifferentialOdometryModel::new(OdometryNoise {
        turn_per_turn: 4e-4,
        turn_per_run: 1e-3,
        run_per_run: 2e-3,
        run_per_turn: 1e-4,
        drift_per_turn: 3e-4,
    })
    .unwrap();
    let draws = 20_000;
    for (key, start_from_end) in
        [Se2::new(0.5, 0.0, 0.0), Se2::new(0.3, 0.1, 0.7), Se2::new(-0.4, 0.05, -0.2), Se2::new(0.0, 0.0, 1.2)]
            .into_iter()
            .enumerate()
    {
        let motion = motion(start_from_end);
        let expected = model.covariance(&motion);
        let sample = model.condition(&motion);
        let start = Se2::new(3.0, -1.0, 2.0);
        let mut stream = Seed(11).stream(key as u64, 0);
        let errors: Vec<Vector3<f64>> =
            (0..draws).map(|_| sample(&start, &mut stream).minus(&(start * start_from_end))).collect();
        let mean = errors.iter().sum::<Vector3<f64>>() / f64::from(draws);
        let covariance =
            errors.iter().map(|e| (e - mean) * (e - mean).transpose()).sum::<Matrix3<f64>>() / f64::from(draws);
        for i in 0..3 {
            // Five standard errors of a mean, and the second order of a turn: the mean of a cosine.
            let second_order = expected[(2, 2)] * (0.5 + start_from_end.translation().norm());
            let bound = 5.0 * (expected[(i, i)] / f64::from(draws)).sqrt() + second_order;
            assert!(mean[i].abs() < bound, "{start_from_end:?}: mean {i} {} > {bound}", mean[i]);
            for j in 0..=i {
                // Variance of a sample covariance of Gaussians: (Σii Σjj + Σij²) / n.
                let spread = (expected[(i, i)] * expected[(j, j)] + expected[(i, j)].powi(2)) / f64::from(draws);
                let bound = 5.0 * spread.sqrt() + 0.02 * (expected[(i, i)] * expected[(j, j)]).sqrt() + 1e-7;
                let error = (covariance[(i, j)] - expected[(i, j)]).abs();
                assert!(error < bound, "{start_from_end:?}: covariance {i}{j} off by {error} > {bound}");
            }
        }
        // With the stated covariance the squared Mahalanobis distances are chi-square with 3 degrees of freedom each:
        // their sum has mean 3 n and variance 6 n.
        if let Some(information) = expected.try_inverse() {
            let sum: f64 = errors.iter().map(|e| (e.transpose() * information * e).x).sum();
            let deviation = (sum / f64::from(draws) - 3.0) / (6.0 / f64::from(draws)).sqrt();
            assert!(deviation.abs() < 10.0, "{start_from_end:?}: {deviation} standard errors");
        }
    }
}

/// Each particle gets `n w` copies in the mean, and never more than one copy more or less; multinomial draws have the
/// variance `n w (1 - w)`, which systematic ones must not exceed.
#[test]
fn systematic_resampling_is_unbiased_and_of_low_variance() {
    let (particles, rounds) = (40, 20_000);
    let mut stream = Seed(5).stream(0, 0);
    let raw: Vec<f64> = (0..particles).map(|i| if i % 7 == 0 { 0.0 } else { stream.random::<f64>().powi(4) }).collect();
    let total: f64 = raw.iter().sum();
    let weights: Vec<f64> = raw.iter().map(|w| w / total).collect();
    let (mut sums, mut squares) = (vec![0.0; particles], vec![0.0; particles]);
    let mut ancestors = vec![0; particles];
    for round in 0..rounds {
        Systematic.resample(&weights, &mut Seed(6).stream(round, 0), &mut ancestors);
        assert!(ancestors.is_sorted());
        let mut counts = vec![0_u32; particles];
        for &ancestor in &ancestors {
            counts[ancestor as usize] += 1;
        }
        for (i, &count) in counts.iter().enumerate() {
            let expected = weights[i] * particles as f64;
            assert!((f64::from(count) - expected).abs() < 1.0 + 1e-9, "{count} copies of weight {expected}");
            sums[i] += f64::from(count);
            squares[i] += f64::from(count).powi(2);
        }
    }
    let rounds = rounds as f64;
    let (mut statistic, mut degrees) = (0.0, 0.0);
    for i in 0..particles {
        let expected = weights[i] * particles as f64;
        let (mean, variance) = (sums[i] / rounds, squares[i] / rounds - (sums[i] / rounds).powi(2));
        // Five standard errors of a sample variance of a rare event.
        let sampling = 5.0 * (expected / rounds).sqrt();
        assert!(variance <= expected * (1.0 - weights[i]) + sampling, "variance {variance} of weight {expected}");
        // Copies are ⌊n w⌋ or one more: a Bernoulli variable of known variance.
        let bernoulli = expected.fract() * (1.0 - expected.fract());
        if bernoulli > 1e-3 {
            statistic += (mean - expected).powi(2) / (bernoulli / rounds);
            degrees += 1.0;
        } else {
            assert!((mean - expected).abs() < 5.0 * (1e-3_f64 / rounds).sqrt());
        }
    }
    // The counts share one draw and are correlated, so the sum spreads more than chi-square: ten deviations.
    assert!((statistic - degrees) / (2.0 * degrees).sqrt() < 10.0, "{statistic} with {degrees} degrees of freedom");
}

/// Resampling to another number of particles, and sums of weights that miss one by rounding.
#[test]
fn systematic_resampling_fills_every_slot() {
    for (weights, count) in [
        (vec![1.0], 5),
        (vec![0.1; 10], 3),
        (vec![0.0, 0.0, 1.0, 0.0], 1000),
        (vec![1.0 / 3.0; 3], 7),
        (vec![0.5 + 1e-13, 0.5, 0.0], 64),
    ] {
        for key in 0..200 {
            let mut ancestors = vec![u32::MAX; count];
            Systematic.resample(&weights, &mut Seed(1).stream(key, 0), &mut ancestors);
            assert!(ancestors.iter().all(|&a| weights[a as usize] > 0.0), "{weights:?}");
        }
    }
}
