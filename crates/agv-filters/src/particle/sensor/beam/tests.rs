//! The model against ray casting by hand, the fit against drawn readings, and the edges of both.

use super::*;
use agv_core::{
    compute::Seed,
    grid::{Cell, GridLayout},
    sensors::ScanGeometry,
    time::Stamp,
};
use proptest::prelude::*;
use rand::RngExt;
use rand_distr::{Distribution, Exp1, StandardNormal};

/// A wall of one cell 2 m ahead of the origin, free before it, unobserved beyond.
fn wall() -> Grid<CellState> {
    let mut map = Grid::filled(GridLayout::new(80, 60, 0.05, Se2::new(0.0, -1.5, 0.0)).unwrap(), CellState::Free);
    for y in 0..60 {
        map.set(Cell::new(40, y), CellState::Occupied);
        (41..80).for_each(|x| assert!(map.set(Cell::new(x, y), CellState::Unknown)));
    }
    map
}

fn scan(ranges: Vec<f32>) -> LaserScan {
    let geometry = ScanGeometry {
        base_from_sensor: Se2::new(0.1, 0.0, 0.0),
        angle_min: -0.2,
        angle_increment: 0.4 / ranges.len().max(1) as f64,
        range_max: 10.0,
        ..Default::default()
    };
    LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
}

fn log_likelihood(model: &mut BeamModel, scan: &LaserScan, pose: &Se2) -> f64 {
    model.condition(scan).unwrap().log_likelihood(pose)
}

proptest! {
    /// The sum of the logarithms of the mixture's densities at the ranges to the wall, by geometry.
    #[test]
    fn agrees_with_geometry(x in 0.1..1.5_f64, y in -0.5..0.5_f64, yaw in -0.2..0.2_f64, ranges in prop::collection::vec(0.1..3.0_f32, 8..40)) {
        let params = BeamModelParams { form: ScanForm::Product { independent_beams: 100.0 }, ..Default::default() };
        let mut model = BeamModel::new(&wall(), params).unwrap();
        let (scan, pose) = (scan(ranges), Se2::new(x, y, yaw));
        let mixture = Mixture::new(&params, 10.0);
        let sensor = pose * scan.geometry().base_from_sensor;
        let expected: f64 = scan.beams().map(|(angle, beam)| {
            let Beam::Hit(z) = beam else { unreachable!() };
            mixture.likelihood(Some(z), Expected::Surface((2.0 - sensor.x()) / (yaw + angle).cos())).ln()
        }).sum();
        let got = log_likelihood(&mut model, &scan, &pose);
        prop_assert!((got - expected).abs() < 1e-6 * expected.abs().max(1.0), "{} {}", got, expected);
    }
}

/// A beam that does not come back speaks for open space, one that comes from behind a wall against it: what a likelihood
/// field does not see.
#[test]
fn walls_stop_beams_and_open_space_does_not_answer() {
    let mut model = BeamModel::new(&wall(), BeamModelParams::default()).unwrap();
    let (before, away) = (Se2::new(1.0, 0.0, 0.0), Se2::new(1.0, 0.0, 3.1));
    let mut ranges = vec![f32::INFINITY; 30];
    ranges[..5].fill(0.3);
    let lost = scan(ranges);
    assert!(log_likelihood(&mut model, &lost, &away) > log_likelihood(&mut model, &lost, &before) + 5.0);
    let behind = scan(vec![1.9; 30]);
    let facing = scan(vec![0.9; 30]);
    assert!(log_likelihood(&mut model, &facing, &before) > log_likelihood(&mut model, &behind, &before) + 5.0);
}

#[test]
fn unobserved_space_is_what_the_parameter_says() {
    // Beyond the wall of `wall()` only: look from there.
    let pose = Se2::new(1.0, 0.0, 0.0);
    let mut map = wall();
    (0..60).for_each(|y| assert!(map.set(Cell::new(40, y), CellState::Unknown)));
    let judge = |unknown, range: f32| {
        let mut model = BeamModel::new(&map, BeamModelParams { unknown, ..Default::default() }).unwrap();
        let mut ranges = vec![range; 20];
        ranges[..5].fill(0.3);
        log_likelihood(&mut model, &scan(ranges), &pose)
    };
    let at_edge = 0.9;
    assert!(judge(UnknownSpace::Obstacle, at_edge) > judge(UnknownSpace::Uniform, at_edge));
    assert!(judge(UnknownSpace::Uniform, at_edge) > judge(UnknownSpace::Free, at_edge));
    assert!((judge(UnknownSpace::Uniform, 3.0) - judge(UnknownSpace::Uniform, 5.0)).abs() < 1e-9, "anywhere beyond");
    assert!(judge(UnknownSpace::Uniform, 3.0) > judge(UnknownSpace::Obstacle, 3.0));
    let lost = f32::INFINITY;
    assert!(judge(UnknownSpace::Free, lost) > judge(UnknownSpace::Uniform, lost));
    assert!(judge(UnknownSpace::Uniform, lost) > judge(UnknownSpace::Obstacle, lost));
}

#[test]
fn beams_that_agree_are_explained() {
    let mut model = BeamModel::new(&wall(), BeamModelParams::default()).unwrap();
    let mut ranges = vec![0.9; 20];
    ranges[..5].fill(0.4);
    ranges[18..].fill(f32::INFINITY);
    let scan = scan(ranges);
    let judged = model.condition(&scan).unwrap();
    assert_eq!(judged.explained(&Se2::new(1.0, 0.0, 0.0)), Some(13.0 / 18.0));
    assert_eq!(judged.explained(&Se2::new(-3.0, 0.0, 3.0)), Some(0.0));
}

#[test]
fn scans_that_say_nothing_are_skipped_and_absurd_poses_stay_finite() {
    let mut model = BeamModel::new(&wall(), BeamModelParams::default()).unwrap();
    for ranges in [vec![], vec![f32::NAN; 50], vec![f32::INFINITY; 50], vec![-1.0; 50], vec![11.0; 50], vec![1.0; 4]] {
        let usable = if ranges.len() == 4 { 4 } else { 0 };
        assert_eq!(model.condition(&scan(ranges)).map(|_| ()), Err(SkipReason::TooFewReadings { usable, needed: 5 }));
    }
    for form in [ScanForm::SumOfCubes, ScanForm::Product { independent_beams: 5.0 }] {
        let mut model = BeamModel::new(&wall(), BeamModelParams { form, ..Default::default() }).unwrap();
        let scan = scan(vec![0.0, 0.02, 1.0, 2.0, 9.99, f32::INFINITY, 1.0]);
        for pose in [
            Se2::new(1e300, 0.0, 0.0),
            Se2::new(-1e9, 1e9, 1.0),
            Se2::new(2.025, 0.0, 0.0),
            Se2::new(1.9, 0.0, 0.0),
            Se2::new(f64::NAN, 0.0, 0.0),
        ] {
            let judged = log_likelihood(&mut model, &scan, &pose);
            assert!(judged.is_finite(), "{pose:?}: {judged}");
        }
    }
}

#[test]
fn bad_parameters_are_named() {
    let good = BeamModelParams::default();
    for (name, bad) in [
        ("z_hit", BeamModelParams { z_hit: -0.1, ..good }),
        ("z_short", BeamModelParams { z_short: f64::NAN, ..good }),
        ("z_max", BeamModelParams { z_max: 0.0, ..good }),
        ("z_rand", BeamModelParams { z_rand: 0.0, ..good }),
        ("sum of the shares", BeamModelParams { z_hit: f64::MAX, z_short: f64::MAX, ..good }),
        ("sigma_hit", BeamModelParams { sigma_hit: 0.0, ..good }),
        ("lambda_short", BeamModelParams { lambda_short: f64::INFINITY, ..good }),
        ("max_beams", BeamModelParams { max_beams: 0, ..good }),
        ("max_range", BeamModelParams { max_range: -1.0, ..good }),
        ("explained_within", BeamModelParams { explained_within: 0.0, ..good }),
        ("independent_beams", BeamModelParams { form: ScanForm::Product { independent_beams: 0.0 }, ..good }),
    ] {
        let error = BeamModel::new(&wall(), bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{error}");
        let unfitted = BeamFit::new(&bad, &[BeamSample { measured: None, expected: None }], 1).unwrap_err();
        assert_eq!(unfitted.to_string(), error.to_string());
    }
    assert_eq!(BeamFit::new(&good, &[], 1), Err(Error::Empty { name: "beam samples" }));
    for bad in [f64::NAN, -1.0, f64::INFINITY] {
        assert!(BeamFit::new(&good, &[BeamSample { measured: Some(bad), expected: None }], 1).is_err());
        assert!(BeamFit::new(&good, &[BeamSample { measured: None, expected: Some(bad) }], 1).is_err());
    }
}

/// Readings drawn from a known mixture, of surfaces from 1 to 9 m.
fn drawn(count: usize) -> Vec<BeamSample> {
    let mut stream = Seed(4).stream(0, 0);
    let draw = |_| {
        let expected = 1.0 + 8.0 * stream.random::<f64>();
        let cause: f64 = stream.random();
        let measured = if cause < 0.6 {
            let z: f64 = StandardNormal.sample(&mut stream);
            Some(expected + 0.05 * z)
        } else if cause < 0.8 {
            // Short readings, drawn until one lies before the surface.
            let mut draw = || -> f64 { Exp1.sample(&mut stream) };
            std::iter::repeat_with(|| 2.0 * draw()).find(|&z| z <= expected)
        } else if cause < 0.85 {
            None
        } else {
            Some(12.0 * stream.random::<f64>())
        };
        BeamSample { measured, expected: Some(expected) }
    };
    (0..count).map(draw).collect()
}

/// What was drawn is found again, from a start that is far off. A share's standard error is √(w (1 - w) / n) if the causes are
/// seen, a deviation's σ / √(2 n w), a rate's about twice λ / √(n w) where a surface cuts it off; five of
/// them, and as much again for causes that must be guessed.
#[test]
fn the_fit_finds_what_was_drawn() {
    let samples = drawn(20_000);
    let n = samples.len() as f64;
    let start = BeamModelParams { max_range: 12.0, sigma_hit: 0.5, lambda_short: 3.0, ..Default::default() };
    let fit = BeamFit::new(&start, &samples, 500).unwrap();
    assert!(fit.converged, "{fit:?}");
    let p = fit.params;
    for (got, share) in [(p.z_hit, 0.6), (p.z_short, 0.2), (p.z_max, 0.05), (p.z_rand, 0.15_f64)] {
        assert!((got - share).abs() < 10.0 * (share * (1.0 - share) / n).sqrt(), "{p:?}");
    }
    assert!((p.sigma_hit - 0.05).abs() < 10.0 * 0.05 / (2.0 * n * 0.6).sqrt(), "{p:?}");
    assert!((p.lambda_short - 0.5).abs() < 10.0 * 2.0 * 0.5 / (n * 0.2).sqrt(), "{p:?}");
    let truth = BeamModelParams {
        z_hit: 0.6,
        z_short: 0.2,
        z_max: 0.05,
        z_rand: 0.15,
        sigma_hit: 0.05,
        lambda_short: 0.5,
        ..start
    };
    let at_truth = BeamFit::new(&truth, &samples, 0).unwrap();
    assert!(fit.log_likelihood >= at_truth.log_likelihood, "the best explains the readings better than the truth");
}

/// Expectation and maximisation never lose.
#[test]
fn every_round_of_the_fit_gains() {
    let samples = drawn(500);
    let start = BeamModelParams { max_range: 12.0, ..Default::default() };
    let gains: Vec<f64> =
        (0..30).map(|rounds| BeamFit::new(&start, &samples, rounds).unwrap().log_likelihood).collect();
    assert!(gains.is_sorted(), "{gains:?}");
}

/// Learned from scans taken in the map that the model knows.
#[test]
fn scans_at_known_poses_become_samples() {
    let mut model = BeamModel::new(&wall(), BeamModelParams::default()).unwrap();
    let mut samples = Vec::new();
    model.samples_into(&scan(vec![0.9, f32::NAN, f32::INFINITY]), &Se2::new(1.0, 0.0, 0.2), &mut samples);
    assert_eq!(samples.len(), 2);
    assert_eq!(samples[0].measured, Some(f64::from(0.9_f32)));
    assert!((samples[0].expected.unwrap() - (1.0 - 0.1 * 0.2_f64.cos())).abs() < 1e-6, "{samples:?}");
    assert_eq!(samples[1].measured, None);
}
