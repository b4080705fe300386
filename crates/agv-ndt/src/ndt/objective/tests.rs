use super::super::gaussian::VoxelParams;
use super::super::map::NdtMap;
use super::*;
use crate::registration::{MotionSums, PointDerivatives};
use crate::scenes::scatter;
use agv_core::geometry::{LieGroup, So3};
use agv_core::sensors::PointCloud;
use nalgebra::Matrix3;

/// A floor, two walls and a pole, in a hall of 12 m whose corner is at `corner`.
fn hall(points: u32, corner: Vector3<f64>) -> Vec<Vector3<f64>> {
    let at = |i: u32| {
        let (a, b, noise) = (12.0 * scatter(3 * i + 1), 3.0 * scatter(3 * i + 2), 0.02 * scatter(3 * i + 3));
        match i % 4 {
            0 => Vector3::new(a, 4.0 * b, noise),
            1 => Vector3::new(a, noise, b),
            2 => Vector3::new(noise, a, b),
            _ => Vector3::new(5.0 + noise, 5.5 + 0.1 * scatter(i), b),
        }
    };
    (0..points).map(|i| at(i) + corner).collect()
}

const ALL: [VoxelSearch; 5] =
    [VoxelSearch::Direct1, VoxelSearch::Direct7, VoxelSearch::Direct8, VoxelSearch::Direct27, VoxelSearch::Radius];

/// A level of the hall, and a source in it.
struct Case {
    map: NdtMap,
    level: Level,
    source: SourcePoints,
    surroundings: Surroundings,
    pose: Se3,
}

fn case(corner: Vector3<f64>) -> Case {
    // In f64, so that a corner far away costs no digits.
    let local = PointCloud::from_points(hall(6000, Vector3::zeros()).into_iter().map(Vector3::cast::<f32>));
    let mut map = NdtMap::new(VoxelParams::default()).unwrap();
    map.insert(&local, &Se3::from_parts(corner, So3::default()));
    let mut level = Level::default();
    level.rebuild(&map, 0);
    let pose = Se3::from_parts(corner + Vector3::new(4.0, 3.0, 1.0), So3::from_roll_pitch_yaw(0.05, -0.08, 0.7));
    let seen = hall(1000, corner).into_iter().map(|p| (pose.inverse().act(&p) + Vector3::new(0.1, -0.05, 0.04)).cast());
    let mut source = SourcePoints::default();
    source.refill(&PointCloud::from_points(seen));
    Case { map, level, source, surroundings: Surroundings::default(), pose }
}

impl Case {
    fn objective(&mut self, search: VoxelSearch, curvature: f64) -> ScoreObjective<'_> {
        ScoreObjective {
            level: &self.level,
            source: &mut self.source,
            surroundings: &mut self.surroundings,
            mixture: Mixture::new(0.3, 1.0).unwrap(),
            search,
            curvature,
            par: Par::Seq,
            arch: Arch::new(),
        }
    }

    /// The definition, point by point in `f64`.
    fn reference(&self, pose: &Se3, search: VoxelSearch, curvature: f64) -> Quadratic {
        let (mixture, mut sums) = (Mixture::new(0.3, 1.0).unwrap(), MotionSums::default());
        for i in 0..self.source.len() {
            let p = self.source.point(i).cast::<f64>();
            let x = pose.act(&p);
            let shift = if search == VoxelSearch::Direct8 { 0.5 } else { 0.0 };
            let home = self.map.cell_at(&(x - Vector3::repeat(shift))).unwrap();
            let mut total =
                PointDerivatives { cost: 0.0, gradient: Vector3::zeros(), hessian: Matrix3::zeros(), curvature };
            let mut met = false;
            for offset in (0..27).map(|k| [k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1]) {
                let steps: i32 = offset.iter().map(|o: &i32| o.abs()).sum();
                let Some(gaussian) = self.map.gaussian([0, 1, 2].map(|axis| home[axis] + offset[axis])) else {
                    continue;
                };
                let d = x - gaussian.mean;
                let counts = match search {
                    VoxelSearch::Direct1 => steps == 0,
                    VoxelSearch::Direct7 => steps <= 1,
                    VoxelSearch::Direct8 => offset.iter().all(|&o| o >= 0),
                    VoxelSearch::Direct27 => true,
                    VoxelSearch::Radius => d.norm() <= 1.0,
                };
                met |= counts || search == VoxelSearch::Radius;
                if counts {
                    let q = gaussian.information * d;
                    let (a, b) = (-mixture.d1, mixture.d2);
                    let e = (-0.5 * b * d.dot(&q)).exp();
                    total.cost -= a * e;
                    total.gradient += q * (a * b * e);
                    total.hessian += (gaussian.information - q * q.transpose() * (b * curvature)) * (a * b * e);
                }
            }
            if met {
                sums.add(&pose.rotation().act(&p), &total);
            }
        }
        sums.quadratic(pose)
    }
}

fn close(a: &Quadratic, b: &Quadratic) -> bool {
    let tolerance = 2e-3;
    (a.cost - b.cost).abs() < tolerance * b.cost.abs()
        && (a.gradient - b.gradient).norm() < tolerance * b.gradient.norm()
        && (a.hessian - b.hessian).norm() < tolerance * b.hessian.norm()
        && a.matches == b.matches
}

#[test]
fn every_search_sums_what_its_definition_says() {
    for search in ALL {
        for curvature in [0.0, 0.5, 1.0] {
            let mut case = case(Vector3::new(-5.3, 2.2, -0.4));
            let pose = case.pose;
            let expected = case.reference(&pose, search, curvature);
            let mut objective = case.objective(search, curvature);
            objective.prepare(&pose);
            let found = objective.evaluate(&pose);
            assert!(close(&found, &expected), "{search:?}: {found:?} {expected:?}");
        }
    }
}

/// Far from the origin, where `f32` has a resolution of millimetres, and after the points have moved to other voxels.
#[test]
fn neither_distance_nor_drift_changes_the_sums() {
    let mut case = case(Vector3::new(40_000.3, -70_000.8, 120.0));
    let start = case.pose;
    let moved = start.plus(&nalgebra::Vector6::new(0.8, -0.6, 0.4, 0.02, -0.05, 0.2));
    let expected = case.reference(&moved, VoxelSearch::Direct7, 1.0);
    let mut objective = case.objective(VoxelSearch::Direct7, 1.0);
    objective.prepare(&start);
    let first = objective.evaluate(&moved);
    assert!(close(&first, &expected), "{first:?} {expected:?}");
    // The second time all blocks are known: not a bit may change.
    assert_eq!(objective.evaluate(&moved), first);
}

#[test]
fn threads_and_instruction_sets_change_no_bit() {
    let mut case = case(Vector3::zeros());
    let pose = case.pose;
    let mut objective = case.objective(VoxelSearch::Direct7, 0.5);
    objective.prepare(&pose);
    let expected = objective.evaluate(&pose);
    let mut archs = vec![Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    archs.extend(pulp::x86::V3::try_new().map(Arch::V3));
    for arch in archs {
        for threads in [1, 2, 3, 8] {
            (objective.par, objective.arch) = (Par::threads(threads), arch);
            assert_eq!(objective.evaluate(&pose), expected, "{threads} threads");
        }
    }
    let fit = objective.fit(&pose, 0.01, &nalgebra::Matrix6::identity());
    objective.par = Par::Seq;
    assert_eq!(objective.fit(&pose, 0.01, &nalgebra::Matrix6::identity()), fit);
}

#[test]
fn points_that_are_not_finite_are_left_out_and_thinning_keeps_one_of_so_many() {
    let mut source = SourcePoints::default();
    let points = [f32::NAN, 1.0, f32::INFINITY, 2.0, 3.0, 4.0].map(|x| Vector3::new(x, 0.0, 0.0));
    source.refill(&PointCloud::from_points(points));
    let mut thinned = SourcePoints::default();
    thinned.thin(&source, 2);
    assert_eq!(source.coordinates()[0], [1.0, 2.0, 3.0, 4.0]);
    assert_eq!(thinned.coordinates()[0], [1.0, 4.0]);
    thinned.thin(&source, 0);
    assert_eq!(thinned.len(), 4);
}
