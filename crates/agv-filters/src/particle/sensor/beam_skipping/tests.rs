//! What is skipped, what is not, and bad input.

use super::*;
use crate::particle::{LikelihoodFieldModel, LikelihoodFieldModelParams, ScanForm};
use agv_core::grid::{Cell, LikelihoodField, LikelihoodFieldParams};

/// A room of 4 m by 3 m.
fn room() -> Grid<CellState> {
    let mut map = Grid::filled(GridLayout::new(80, 60, 0.05, Se2::default()).unwrap(), CellState::Free);
    for x in 0..80 {
        for y in 0..60 {
            if x == 0 || y == 0 || x == 79 || y == 59 {
                map.set(Cell::new(x, y), CellState::Occupied);
            }
        }
    }
    map
}

fn model(max_beams: usize) -> LikelihoodFieldModel {
    let field = LikelihoodField::new(&room(), LikelihoodFieldParams::default()).unwrap();
    let form = ScanForm::Product { independent_beams: max_beams as f64 };
    LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams { max_beams, form, ..Default::default() }).unwrap()
}

fn skipping(max_beams: usize, params: BeamSkippingParams) -> BeamSkipping<LikelihoodFieldModel> {
    BeamSkipping::new(model(max_beams), &room(), params).unwrap()
}

/// Seen from the middle of the room, ahead; `blocked` of the 40 beams end after 0.5 m.
fn scan(blocked: usize) -> LaserScan {
    let geometry = ScanGeometry { angle_min: -0.4, angle_increment: 0.02, ..Default::default() };
    let range = |i: usize| if i < blocked { 0.5 } else { (1.95 / geometry.angle(i).cos()) as f32 };
    LaserScan::new(Stamp::default(), geometry, (0..40).map(range).collect()).unwrap()
}

fn poses() -> Vec<Se2> {
    (0..600).map(|i| Se2::new(2.0 + 1e-4 * f64::from(i - 300), 1.5, 1e-5 * f64::from(i))).collect()
}

fn weigh(model: &mut impl WeighParticles<LaserScan>, scan: &LaserScan, poses: &[Se2], par: Par) -> Vec<f64> {
    let mut out = vec![0.0; poses.len()];
    model.weigh(scan, poses, &mut out, par).unwrap();
    out
}

/// Blocked beams say nothing: the weights are those of the scan without them.
#[test]
fn beams_that_nobody_explains_do_not_weigh() {
    let poses = poses();
    let mut skipping = skipping(40, BeamSkippingParams::default());
    for par in [Par::Seq, Par::threads(2)] {
        let got = weigh(&mut skipping, &scan(12), &poses, par);
        assert_eq!(skipping.skipped(), 12);
        let mut without = scan(12);
        without.copy_masked(&scan(12), |beam| beam >= 12);
        assert_eq!(got, weigh(&mut model(40), &without, &poses, Par::Seq));
    }
    // Where all beams fit nothing changes.
    assert_eq!(weigh(&mut skipping, &scan(0), &poses, Par::Seq), weigh(&mut model(40), &scan(0), &poses, Par::Seq));
    assert_eq!(skipping.skipped(), 0);
}

#[test]
fn a_set_that_is_spread_or_wrong_uses_all_beams() {
    let mut spread = poses();
    spread[7] = Se2::new(2.0, 2.2, 0.0);
    let mut skipping = skipping(40, BeamSkippingParams::default());
    for (scan, poses) in [(scan(12), spread), (scan(37), poses())] {
        let got = weigh(&mut skipping, &scan, &poses, Par::Seq);
        assert_eq!((skipping.skipped(), got), (0, weigh(&mut model(40), &scan, &poses, Par::Seq)));
    }
    // Not wrong, but too few beams are left for the model.
    let mut skipping = self::skipping(40, BeamSkippingParams { error_threshold: 1.0, ..Default::default() });
    let got = weigh(&mut skipping, &scan(37), &poses(), Par::Seq);
    assert_eq!((skipping.skipped(), got), (0, weigh(&mut model(40), &scan(37), &poses(), Par::Seq)));
}

/// Walls at the edge of a map explain beams that end a little beyond it.
#[test]
fn the_edge_of_the_map_is_no_edge_of_its_obstacles() {
    let beyond: Vec<Se2> = poses().iter().map(|pose| Se2::new(pose.x() + 0.4, pose.y(), 0.0)).collect();
    let mut skipping = skipping(40, BeamSkippingParams::default());
    weigh(&mut skipping, &scan(12), &beyond, Par::Seq);
    assert_eq!(skipping.skipped(), 12);
}

/// The beams that are judged are those that the model reads.
#[test]
fn thinned_scans_are_judged_on_the_beams_that_are_used() {
    let mut skipping = skipping(10, BeamSkippingParams::default());
    let got = weigh(&mut skipping, &scan(12), &poses(), Par::Seq);
    assert_eq!(skipping.skipped(), 3);
    let mut without = scan(12);
    without.copy_masked(&scan(12), |beam| beam >= 12);
    assert_eq!(got, weigh(&mut model(10), &without, &poses(), Par::Seq));
}

#[test]
fn bad_input_is_named_or_survived() {
    let good = BeamSkippingParams::default();
    for (name, bad) in [
        ("beam skipping distance", BeamSkippingParams { distance: 0.0, ..good }),
        ("threshold", BeamSkippingParams { threshold: -0.1, ..good }),
        ("error_threshold", BeamSkippingParams { error_threshold: f64::NAN, ..good }),
        ("converged_within", BeamSkippingParams { converged_within: -1.0, ..good }),
        ("grid has", BeamSkippingParams { distance: 1e300, ..good }),
    ] {
        let error = BeamSkipping::new(model(40), &room(), bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{error}");
    }
    let mut skipping = skipping(40, good);
    for ranges in [vec![], vec![f32::NAN; 40], vec![f32::INFINITY; 40]] {
        let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), ranges).unwrap();
        let expected = Err(SkipReason::TooFewReadings { usable: 0, needed: 5 });
        assert_eq!(skipping.weigh(&scan, &poses(), &mut [0.0; 600], Par::Seq), expected);
    }
    skipping.weigh(&scan(3), &[], &mut [], Par::Seq).unwrap();
    for pose in [Se2::new(1e300, 0.0, 0.0), Se2::new(-1e9, 1e9, 0.0), Se2::new(f64::NAN, 0.0, 0.0)] {
        assert!(weigh(&mut skipping, &scan(3), &[pose; 3], Par::Seq).iter().all(|l| l.is_finite()));
    }
}
