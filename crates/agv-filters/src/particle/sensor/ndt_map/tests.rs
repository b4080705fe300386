//! The model against its definition, its exponential, and bad input.

use super::*;
use agv_core::{
    grid::{Cell, GaussianParams, GridLayout},
    sensors::ScanGeometry,
    time::Stamp,
};
use nalgebra::Vector2;
use proptest::prelude::*;

/// Two walls, in a grid that is turned.
fn map() -> GaussianGrid {
    let layout = GridLayout::new(9, 7, 0.5, Se2::new(-1.0, -2.0, 0.4)).unwrap();
    let mut map = GaussianGrid::new(layout, GaussianParams::default()).unwrap();
    let wiggle = |i: i32| 0.01 * f64::from(i % 5);
    map.extend((0..300).map(|i| layout.to_map(&Vector2::new(0.5 + 0.025 * f64::from(i), 5.3 + wiggle(i)))));
    map.extend((0..200).map(|i| layout.to_map(&Vector2::new(7.6 + wiggle(i), 0.5 + 0.025 * f64::from(i)))));
    map
}

fn scan(ranges: Vec<f32>) -> LaserScan {
    let geometry = ScanGeometry {
        base_from_sensor: Se2::new(0.3, -0.1, 0.2),
        angle_min: -1.5,
        angle_increment: 0.07,
        ..Default::default()
    };
    LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
}

proptest! {
    /// The least distance over the four cells, from the grid's own distributions.
    #[test]
    fn agrees_with_the_definition(
        ranges in prop::collection::vec(0.1..5.0_f32, 5..50),
        x in -2.0..4.0_f64, y in -3.0..3.0_f64, yaw in -3.2..3.2_f64,
    ) {
        let (map, scan, pose) = (map(), scan(ranges), Se2::new(x, y, yaw));
        let params = NdtMapModelParams { form: ScanForm::Product { independent_beams: 100.0 }, ..Default::default() };
        let mut model = NdtMapModel::new(&map, params).unwrap();
        let got = model.condition(&scan).unwrap().log_likelihood(&pose);
        let widen = Matrix2::identity() * params.sigma * params.sigma;
        let mut expected = 0.0;
        for end in scan.points_in_base().map(|point| pose * point) {
            let in_cells = map.layout().to_grid(&end);
            let (i, j) = ((in_cells.x - 0.5).floor() as i32, (in_cells.y - 0.5).floor() as i32);
            let squared = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(a, b)| {
                map.gaussian(Cell::new(i + a, j + b)).map_or(f64::INFINITY, |g| {
                    let d = end - g.mean;
                    d.dot(&((g.covariance + widen).try_inverse().unwrap() * d))
                })
            });
            let least = squared.into_iter().fold(f64::INFINITY, f64::min);
            expected += ((1.0 - params.outlier) * (-0.5 * least).exp() + params.outlier).ln();
        }
        prop_assert!((got - expected).abs() < 2e-3 * expected.abs().max(1.0), "{} {}", got, expected);
    }
}

proptest! {
    /// One pose at a time or all at once, with any instruction set: the same bits.
    #[test]
    fn the_batch_has_the_bits_of_the_single_call(poses in prop::collection::vec((-3.0..5.0_f64, -4.0..4.0_f64, -3.2..3.2_f64), 1..20)) {
        let mut model = NdtMapModel::new(&map(), NdtMapModelParams::default()).unwrap();
        let scan = scan((0..70).map(|i| 0.5 + 0.05 * i as f32).collect());
        let likelihood = model.condition(&scan).unwrap();
        let poses: Vec<Se2> = poses.into_iter().map(|(x, y, yaw)| Se2::new(x, y, yaw)).collect();
        let mut batch = vec![0.0; poses.len()];
        likelihood.log_likelihoods(&poses, &mut batch);
        let single: Vec<f64> = poses.iter().map(|pose| likelihood.log_likelihood(pose)).collect();
        prop_assert_eq!(batch, single);
    }
}

#[test]
fn the_exponential_is_accurate() {
    for k in 0..8800 {
        let x = 0.01 * k as f32;
        let (got, expected) = (f64::from(exp_of_negative(x)), f64::from(-x).exp());
        // The argument itself is a float: its last bit is worth x · 6e-8.
        assert!((got / expected - 1.0).abs() < 3e-7 + 2e-7 * f64::from(x) || x >= 87.0, "{x}: {got} {expected}");
    }
    for x in [88.0, 1e9, f32::INFINITY, f32::NAN] {
        assert_eq!(exp_of_negative(x), 0.0);
    }
    assert_eq!(exp_of_negative(0.0), 1.0);
}

#[test]
fn scans_that_say_nothing_are_skipped_and_absurd_poses_read_the_outlier() {
    let mut model = NdtMapModel::new(&map(), NdtMapModelParams::default()).unwrap();
    for ranges in [vec![], vec![f32::NAN; 50], vec![f32::INFINITY; 50], vec![-1.0; 50], vec![1.0; 4]] {
        let usable = if ranges.len() == 4 { 4 } else { 0 };
        assert_eq!(model.condition(&scan(ranges)).map(|_| ()), Err(SkipReason::TooFewReadings { usable, needed: 5 }));
    }
    let scan = scan(vec![1.0; 40]);
    let judged = model.condition(&scan).unwrap();
    for pose in [Se2::new(1e300, 0.0, 0.0), Se2::new(-1e9, 1e9, 1.0), Se2::new(f64::NAN, 0.0, 0.0)] {
        assert!((judged.log_likelihood(&pose) - 18.0 * 0.005_f64.ln()).abs() < 1e-5, "{pose:?}");
        assert_eq!(judged.explained(&pose), Some(0.0));
    }
}

#[test]
fn bad_parameters_are_named() {
    let good = NdtMapModelParams::default();
    for (name, bad) in [
        ("sigma", NdtMapModelParams { sigma: 0.0, ..good }),
        ("outlier", NdtMapModelParams { outlier: 0.0, ..good }),
        ("outlier", NdtMapModelParams { outlier: 1.0, ..good }),
        ("max_beams", NdtMapModelParams { max_beams: 0, ..good }),
        ("max_range", NdtMapModelParams { max_range: f64::NAN, ..good }),
        ("explained_within", NdtMapModelParams { explained_within: -1.0, ..good }),
        ("independent_beams", NdtMapModelParams { form: ScanForm::Product { independent_beams: 0.0 }, ..good }),
    ] {
        let error = NdtMapModel::new(&map(), bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{error}");
    }
}
