//! Every resampler draws in proportion to the weights, and never a particle without weight.

use agv_core::compute::Seed;
use agv_filters::particle::{Multinomial, Resampler, Residual, Stratified, Systematic};
use rand::RngExt;

fn all() -> [(&'static str, Box<dyn Resampler>); 4] {
    [
        ("multinomial", Box::new(Multinomial)),
        ("stratified", Box::new(Stratified)),
        ("residual", Box::new(Residual)),
        ("systematic", Box::new(Systematic)),
    ]
}

/// Uneven weights with some zeros among them.
fn weights(count: usize) -> Vec<f64> {
    let mut stream = Seed(5).stream(0, 0);
    let raw: Vec<f64> = (0..count).map(|i| if i % 7 == 0 { 0.0 } else { stream.random::<f64>().powi(4) }).collect();
    let total: f64 = raw.iter().sum();
    raw.iter().map(|w| w / total).collect()
}

/// The particle in a slot that is chosen at random is a draw from the weights, independent from round to round: Pearson's
/// statistic is chi-square, whatever the resampler does within a round.
#[test]
fn a_random_slot_holds_a_draw_from_the_weights() {
    let (weights, rounds) = (weights(40), 60_000);
    for (name, resampler) in all() {
        // As many slots as particles, fewer and more.
        for slots in [40, 11, 97] {
            let mut counts = vec![0.0; weights.len()];
            let mut ancestors = vec![0; slots];
            let mut choice = Seed(9).stream(0, 0);
            for round in 0..rounds {
                resampler.resample(&weights, &mut Seed(6).stream(round, 0), &mut ancestors);
                counts[ancestors[choice.random_range(0..slots)] as usize] += 1.0;
            }
            // Pearson's statistic needs five expected entries: rarer particles are counted together.
            let (mut statistic, mut bins, mut rare) = (0.0, 0.0, (0.0, 0.0));
            let mut term = |count: f64, expected: f64| {
                statistic += (count - expected).powi(2) / expected;
                bins += 1.0;
            };
            for (&count, &weight) in counts.iter().zip(&weights) {
                let expected = weight * rounds as f64;
                if expected >= 5.0 {
                    term(count, expected);
                } else {
                    rare = (rare.0 + count, rare.1 + expected);
                }
            }
            if rare.1 > 0.0 {
                term(rare.0, rare.1);
            }
            // 99.99 % quantile of chi-square by Wilson and Hilferty: z = 3.719.
            let degrees: f64 = bins - 1.0;
            let spread = 2.0 / (9.0 * degrees);
            let limit = degrees * (1.0 - spread + 3.719 * spread.sqrt()).powi(3);
            assert!(statistic < limit, "{name}, {slots} slots: {statistic} > {limit}");
        }
    }
}

/// Copies stay within what each resampler promises, and their variance within that of independent draws, which multinomial
/// ones must have.
#[test]
fn copies_vary_as_promised() {
    let (count, rounds) = (40, 20_000);
    let weights = weights(count);
    for (name, resampler) in all() {
        let (mut sums, mut squares) = (vec![0.0; count], vec![0.0; count]);
        let mut ancestors = vec![0; count];
        for round in 0..rounds {
            resampler.resample(&weights, &mut Seed(16).stream(round, 0), &mut ancestors);
            assert!(ancestors.is_sorted(), "{name}");
            let mut copies = vec![0_u32; count];
            ancestors.iter().for_each(|&ancestor| copies[ancestor as usize] += 1);
            for (i, &copies) in copies.iter().enumerate() {
                let (copies, expected) = (f64::from(copies), weights[i] * count as f64);
                let range = match name {
                    "multinomial" => 0.0..=f64::INFINITY,
                    "residual" => (expected - 1e-6).floor()..=f64::INFINITY,
                    "stratified" => expected.floor() - 1.0..=expected.ceil() + 1.0,
                    _ => expected.floor()..=expected.ceil(),
                };
                assert!(range.contains(&copies), "{name}: {copies} copies of {expected}");
                sums[i] += copies;
                squares[i] += copies * copies;
            }
        }
        let rounds = rounds as f64;
        for i in 0..count {
            let expected = weights[i] * count as f64;
            let variance = squares[i] / rounds - (sums[i] / rounds).powi(2);
            let independent = expected * (1.0 - weights[i]);
            // Five standard errors of a sample variance: about Poisson, its fourth moment is 3 m² + m.
            let sampling = 5.0 * ((2.0 * independent * independent + independent) / rounds).sqrt() + 1e-9;
            assert!(variance <= independent + sampling, "{name}: {variance} > {independent}");
            if name == "multinomial" {
                assert!(variance >= independent - sampling, "{name}: {variance} < {independent}");
            }
        }
    }
}

/// To any number of particles, from sums of weights that miss one by rounding or by far, and with zeros at both ends.
#[test]
fn every_slot_is_filled_with_a_particle_of_weight() {
    for (weights, slots) in [
        (vec![1.0], 5),
        (vec![0.1; 10], 3),
        (vec![0.0, 0.0, 1.0, 0.0], 1000),
        (vec![1.0 / 3.0; 3], 7),
        (vec![1.0 / 3.0; 3], 3),
        (vec![0.0, 0.5 + 1e-13, 0.5, 0.0], 64),
        (vec![3.0, 0.0, 1.0], 8),
        (vec![1e-300, 1.0, 1e-300], 50),
        (vec![0.3, 0.7], 0),
    ] {
        for (name, resampler) in all() {
            for key in 0..200 {
                let mut ancestors = vec![u32::MAX; slots];
                resampler.resample(&weights, &mut Seed(1).stream(key, 0), &mut ancestors);
                let sound = ancestors.iter().all(|&a| weights.get(a as usize).is_some_and(|&w| w > 0.0));
                assert!(sound && ancestors.is_sorted(), "{name} of {weights:?}: {ancestors:?}");
            }
        }
    }
}

/// Three equal particles and three slots: without chance.
#[test]
fn equal_weights_are_copied_once_where_nothing_is_left_to_chance() {
    for count in [3, 7, 49, 1000] {
        let weights = vec![(count as f64).recip(); count];
        let mut ancestors = vec![0; count];
        Residual.resample(&weights, &mut Seed(2).stream(0, 0), &mut ancestors);
        assert!(ancestors.iter().enumerate().all(|(i, &a)| a as usize == i), "{count}");
    }
}
