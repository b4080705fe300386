//! The model against the textbook, and its edges.

use super::*;
use agv_core::{
    geometry::{LieGroup, Se2},
    grid::{CellState, Grid, GridLayout, LikelihoodFieldParams},
    sensors::ScanGeometry,
    time::Stamp,
};
use proptest::prelude::*;

fn field() -> LikelihoodField {
    let layout = GridLayout::new(70, 50, 0.1, Se2::new(-2.0, 1.0, 0.3)).unwrap();
    let states = (0..layout.len()).map(|i| if i % 37 == 0 { CellState::Occupied } else { CellState::Free });
    let map = Grid::new(layout, states.collect()).unwrap();
    LikelihoodField::new(&map, LikelihoodFieldParams { sigma_hit: 0.1, ..Default::default() }).unwrap()
}

fn scan(ranges: Vec<f32>) -> LaserScan {
    let geometry = ScanGeometry {
        base_from_sensor: Se2::new(0.3, -0.1, 0.2),
        angle_min: -1.5,
        angle_increment: 0.03,
        ..Default::default()
    };
    LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
}

proptest! {
    /// The batch agrees with a plain reading of the table in the book, on and off the map.
    #[test]
    fn agrees_with_the_textbook(
        ranges in prop::collection::vec(0.1..6.0_f32, 5..100),
        poses in prop::collection::vec((-6.0..9.0_f64, -4.0..9.0_f64, -3.2..3.2_f64), 1..20),
    ) {
        let (field, scan) = (field(), scan(ranges));
        let poses: Vec<Se2> = poses.into_iter().map(|(x, y, yaw)| Se2::new(x, y, yaw)).collect();
        for form in [ScanForm::Product { independent_beams: 25.0 }, ScanForm::SumOfCubes] {
            let params = LikelihoodFieldModelParams { max_beams: 100, form, ..Default::default() };
            let mut model = LikelihoodFieldModel::new(&field, params).unwrap();
            let power = (25.0 / scan.len() as f64).min(1.0);
            let mut batch = vec![0.0; poses.len()];
            model.condition(&scan).unwrap().log_likelihoods(&poses, &mut batch);
            let term = |p: f64| if form == ScanForm::SumOfCubes { p.powi(3) } else { power * p.ln() };
            let bounds = [f64::from(field.off_map()), field.params().density(0.0)].map(term);
            // Each of the beams may be off by half of one of 255 levels.
            let off = scan.len() as f64 * (bounds[1] - bounds[0]) / 510.0;
            for (pose, got) in poses.iter().zip(batch) {
                let densities = scan.points_in_base().map(|point| {
                    let end = pose.act(&point);
                    // An end point on the edge of a cell may be rounded into either.
                    let shifts = [(0.0, 0.0), (1e-5, 1e-5), (-1e-5, -1e-5), (1e-5, -1e-5), (-1e-5, 1e-5)];
                    shifts.map(|(dx, dy)| f64::from(field.likelihood_at(&(end + nalgebra::Vector2::new(dx, dy)))))
                });
                let (low, high) = densities.fold((0.0, 0.0), |(low, high), p| {
                    let terms = p.map(term);
                    (low + terms.into_iter().fold(f64::INFINITY, f64::min), high + terms.into_iter().fold(f64::NEG_INFINITY, f64::max))
                });
                let (low, high) = (low - off, high + off);
                let low = if form == ScanForm::SumOfCubes { low.max(0.0) } else { low };
                let (low, high) = if form == ScanForm::SumOfCubes { (low.ln_1p(), high.ln_1p()) } else { (low, high) };
                prop_assert!(got > low - 1e-3 && got < high + 1e-3, "{low} <= {got} <= {high}");
            }
        }
    }

    /// One pose at a time or many at once, wherever they stand in the batch and with any instruction set: the same bits.
    #[test]
    fn the_batch_has_the_bits_of_the_single_call(
        near in prop::collection::vec((1.5..1.9_f64, 3.0..3.4_f64, -3.2..3.2_f64), 0..80),
        far in prop::collection::vec((-6.0..9.0_f64, -4.0..9.0_f64, -3.2..3.2_f64), 1..80),
        reach in 0.2..2.0_f32,
        beams in 20_usize..70,
    ) {
        let mut model = LikelihoodFieldModel::new(&field(), LikelihoodFieldModelParams::default()).unwrap();
        let scan = scan((0..beams).map(|i| reach + 0.02 * i as f32).collect());
        let poses: Vec<Se2> = near.into_iter().chain(far).map(|(x, y, yaw)| Se2::new(x, y, yaw)).collect();
        for arch in crate::particle::simd::archs() {
            model.arch = arch;
            let likelihood = model.condition(&scan).unwrap();
            let mut batch = vec![0.0; poses.len()];
            likelihood.log_likelihoods(&poses, &mut batch);
            let single: Vec<f64> = poses.iter().map(|pose| likelihood.log_likelihood(pose)).collect();
            prop_assert_eq!(batch, single);
        }
    }
}

/// No pose, however absurd, leads out of the table, alone or among others.
#[test]
fn one_absurd_pose_does_not_move_its_neighbours() {
    let mut model = LikelihoodFieldModel::new(&field(), LikelihoodFieldModelParams::default()).unwrap();
    let scan = scan(vec![0.5; 60]);
    let likelihood = model.condition(&scan).unwrap();
    let good = Se2::new(1.7, 3.2, 0.4);
    let expected = likelihood.log_likelihood(&good);
    for absurd in [1e300, -1e300, 1e7, -1e7, f64::NAN, -f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let turned =
            Se2::from_parts(good.translation(), nalgebra::UnitComplex::from_cos_sin_unchecked(absurd, 0.1).into());
        for bad in [Se2::new(absurd, 3.2, 0.4), Se2::new(1.7, absurd, 0.4), turned] {
            for place in [0, 40, 63, 70] {
                let mut poses = vec![good; 80];
                poses[place] = bad;
                let mut batch = vec![0.0; 80];
                likelihood.log_likelihoods(&poses, &mut batch);
                assert!(batch.iter().enumerate().all(|(i, &got)| i == place || got == expected), "{absurd} {place}");
                assert!(batch[place].is_finite());
            }
        }
    }
}

#[test]
fn scans_that_say_nothing_are_skipped() {
    let mut model = LikelihoodFieldModel::new(&field(), LikelihoodFieldModelParams::default()).unwrap();
    for ranges in [vec![], vec![f32::NAN; 50], vec![f32::INFINITY; 50], vec![-1.0; 50], vec![31.0; 50], vec![1.0; 4]] {
        let usable = if ranges.len() == 4 { 4 } else { 0 };
        assert_eq!(model.condition(&scan(ranges)).map(|_| ()), Err(SkipReason::TooFewReadings { usable, needed: 5 }));
    }
}

#[test]
fn absurd_poses_read_the_border() {
    let mut model = LikelihoodFieldModel::new(&field(), LikelihoodFieldModelParams::default()).unwrap();
    let scan = scan(vec![1.0; 60]);
    let likelihood = model.condition(&scan).unwrap();
    for pose in [Se2::new(1e300, 0.0, 0.0), Se2::new(-1e9, 1e9, 1.0), Se2::new(f64::NAN, 0.0, 0.0)] {
        assert!((likelihood.log_likelihood(&pose) - 18.0 * 0.005_f64.ln()).abs() < 1e-2);
    }
}

#[test]
fn bad_parameters_are_named() {
    let good = LikelihoodFieldModelParams::default();
    for (name, bad) in [
        ("max_beams", LikelihoodFieldModelParams { max_beams: 0, ..good }),
        ("max_range", LikelihoodFieldModelParams { max_range: f64::NAN, ..good }),
        ("explained_within", LikelihoodFieldModelParams { explained_within: 0.0, ..good }),
        (
            "independent_beams",
            LikelihoodFieldModelParams { form: ScanForm::Product { independent_beams: 0.0 }, ..good },
        ),
        (
            "independent_beams",
            LikelihoodFieldModelParams { form: ScanForm::Product { independent_beams: f64::NAN }, ..good },
        ),
    ] {
        let error = LikelihoodFieldModel::new(&field(), bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{error}");
    }
    // Beyond the field's reach all places are alike: every beam would be explained.
    let explained_within = field().params().max_distance;
    let blind = LikelihoodFieldModelParams { explained_within, ..good };
    assert!(matches!(LikelihoodFieldModel::new(&field(), blind), Err(Error::OutOfRange { .. })));
}

/// However dense the scan, its likelihood is that of as many independent beams.
#[test]
fn a_denser_scan_is_no_surer() {
    let field = field();
    let judge = |beams: usize| {
        let geometry = ScanGeometry { angle_min: -1.5, angle_increment: 3.0 / beams as f64, ..Default::default() };
        let scan = LaserScan::new(Stamp::default(), geometry, vec![2.0; beams]).unwrap();
        let params = LikelihoodFieldModelParams { max_beams: beams, ..Default::default() };
        let mut model = LikelihoodFieldModel::new(&field, params).unwrap();
        let judged = model.condition(&scan).unwrap();
        judged.log_likelihood(&Se2::new(1.0, 3.0, 0.2)) - judged.log_likelihood(&Se2::new(-30.0, 0.0, 0.0))
    };
    let [few, some, many] = [60, 180, 720].map(judge);
    assert!((some / few - 1.0).abs() < 0.15 && (many / some - 1.0).abs() < 0.05, "{few} {some} {many}");
    // With fewer beams than independent ones, each counts.
    assert!(judge(9) < 0.7 * some);
}

#[test]
fn beams_that_end_near_a_wall_are_explained() {
    // A wall 2 m ahead; half of the beams reach it, the others end a metre short of it.
    let mut map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::new(0.0, -1.5, 0.0)).unwrap(), CellState::Free);
    (0..60).for_each(|y| assert!(map.set(agv_core::grid::Cell::new(40, y), CellState::Occupied)));
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let geometry = ScanGeometry { angle_min: -0.1, angle_increment: 0.004, ..Default::default() };
    let ranges = (0..50).map(|i| if i % 2 == 0 { 2.0 } else { 1.0 }).collect();
    let scan = LaserScan::new(Stamp::default(), geometry, ranges).unwrap();
    for form in [ScanForm::Product { independent_beams: 5.0 }, ScanForm::SumOfCubes] {
        let params = LikelihoodFieldModelParams { form, ..Default::default() };
        let mut model = LikelihoodFieldModel::new(&field, params).unwrap();
        let judged = model.condition(&scan).unwrap();
        assert_eq!(judged.explained(&Se2::default()), Some(0.5));
        assert_eq!(judged.explained(&Se2::new(0.1, 0.0, 0.0)), Some(0.5));
        assert_eq!(judged.explained(&Se2::new(1.0, 0.0, 0.0)), Some(0.5), "now the others reach it");
        assert_eq!(judged.explained(&Se2::new(0.5, 0.0, 0.0)), Some(0.0));
        assert_eq!(judged.explained(&Se2::new(-50.0, 0.0, 0.0)), Some(0.0));
    }
}

#[test]
fn a_map_of_nothing_explains_nothing() {
    let map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::default()).unwrap(), CellState::Free);
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let mut model = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let scan = scan(vec![1.0; 60]);
    let judged = model.condition(&scan).unwrap();
    let pose = Se2::new(1.0, 1.0, 0.0);
    assert_eq!(judged.explained(&pose), Some(0.0));
    let floor = LikelihoodFieldParams::default().density(2.0).ln();
    assert!((judged.log_likelihood(&pose) - 18.0 * floor).abs() < 1e-5);
}

/// Levels are as fine as is said of them, whatever the densities' range: those that one pose is judged by, and the coarse ones.
#[test]
fn levels_are_fine() {
    for (sigma_hit, z_rand, tolerance) in [(0.2, 0.5, 4.1e-5), (0.05, 0.5, 5.2e-5), (0.2, 0.0005, 9.4e-5)] {
        let mut map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::default()).unwrap(), CellState::Free);
        assert!(map.set(agv_core::grid::Cell::new(30, 30), CellState::Occupied));
        let field =
            LikelihoodField::new(&map, LikelihoodFieldParams { sigma_hit, z_rand, ..Default::default() }).unwrap();
        let params = LikelihoodFieldModelParams {
            form: ScanForm::Product { independent_beams: 1.0 },
            min_hits: 1,
            ..Default::default()
        };
        let mut model = LikelihoodFieldModel::new(&field, params).unwrap();
        let table = model.table.clone();
        for (index, density) in field.values().iter().enumerate() {
            let term = table.terms[(index / 60 + 1) * table.stride as usize + index % 60 + 1];
            let off = table.sum(u32::from(term), 1) - f64::from(*density).ln();
            assert!(off.abs() < tolerance, "{index}");
        }
        let geometry = ScanGeometry { angle_min: 0.0, angle_increment: 0.1, ..Default::default() };
        let scan = LaserScan::new(Stamp::default(), geometry, vec![0.5]).unwrap();
        let judged = model.condition(&scan).unwrap();
        for i in 0..1000 {
            let pose = Se2::new(0.00137 * f64::from(i) + 0.3033, 1.3137 + 1.013e-4 * f64::from(i), 0.0);
            let expected = f64::from(field.likelihood_at(&pose.act(&[0.5, 0.0].into()))).ln();
            assert!((judged.log_likelihood(&pose) - expected).abs() < 257.0 * tolerance, "{i}");
        }
    }
}
