use super::*;
use crate::pipeline::mapping::{KeyFrameMapper, KeyFrameParams, LoopParams, closures::closure};
use agv_core::{
    geometry::Se2,
    nalgebra::{SMatrix, Vector3},
    roles::{Alignment, AlignmentError, LidarOdometryStep, Registration, Termination},
    sensors::{PointCloud, PointSource},
    time::Stamp,
};

/// Finds every cloud where it is sought, but for those that are sought aside.
struct Lane;

impl Registration for Lane {
    fn set_target(&mut self, _: &dyn PointSource) -> Result<(), AlignmentError> {
        Ok(())
    }

    fn align(&mut self, _: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        let mut found = Alignment::unknown(*guess, Termination::Converged);
        found.information = Matrix6::identity() * 1e4;
        found.unobserved = Matrix6::zeros();
        found.inlier_ratio = if guess.translation().y.abs() < 0.5 { 1.0 } else { 0.0 };
        Ok(found)
    }
}

/// Nine metres out, four back to where key frame 5 is met, and aside from there.
fn driven(mapper: &mut KeyFrameMapper<Lane>, aside: f64) -> [Se3; 4] {
    let cloud = PointCloud::from_points((0..2000_u16).map(|i| {
        let (a, b) = (f32::from(i % 50), f32::from(i / 50));
        Vector3::new(0.2 * a - 5.0, 0.2 * b - 4.0, 1.0 + (0.7 * a).sin())
    }));
    let at = |x: i32, y: f64| Se3::from(Se2::new(f64::from(x), y, 0.0));
    let way = (0..10).chain((5..9).rev()).map(|x| at(x, 0.0));
    let mut seconds = 0.0;
    let mut go = |pose: Se3| {
        seconds += 1.0;
        let step = LidarOdometryStep { odom_from_base: pose, alignment: None };
        mapper.process(&step, &cloud.clone().with_stamp(Stamp::from_seconds(seconds))).unwrap()
    };
    let steps: Vec<_> = way.map(&mut go).collect();
    assert_eq!((steps[12].key, steps[12].met, steps[13].key, steps[13].met), (Some(12), None, None, Some(5)));
    assert_eq!(go(at(5, aside)).key, Some(13));
    [at(5, 0.0), at(6, 0.0), at(5, aside), at(5, 0.0)]
}

/// Information about four poses from relations whose residuals are zero.
fn joint(poses: &[Se3; 4], relations: &[(usize, usize, Matrix6<f64>)]) -> SMatrix<f64, 24, 24> {
    let mut sum = SMatrix::<f64, 24, 24>::zeros();
    for (from, to, information) in relations {
        let (by_from, by_to) = poses[*from].between_jacobians(&poses[*to]);
        for (i, a) in [(*from, by_from), (*to, by_to)] {
            for (j, b) in [(*from, by_from), (*to, by_to)] {
                let mut block = sum.fixed_view_mut::<6, 6>(6 * i, 6 * j);
                block += a.transpose() * information * b;
            }
        }
    }
    sum
}

/// Of the way back, the find and the way aside the graph knows no more than what a graph knows that has each of them once; and not
/// much less.
#[test]
fn what_was_found_counts_once() {
    let params = KeyFrameParams { loops: LoopParams { min_way: 8.0, ..Default::default() }, ..Default::default() };
    let mut mapper = KeyFrameMapper::new(Lane, params).unwrap();
    // Key frames 5, 12 and 13, and where the one was that was not kept.
    let poses = driven(&mut mapper, 1.5);
    let number = |key: u32| [5, 12, 13].iter().position(|kept| *kept == key);
    let told = mapper
        .map()
        .relations()
        .iter()
        .filter_map(|relation| Some((number(relation.from.0)?, number(relation.to.0)?, relation.information)));
    let told: Vec<_> = told.collect();
    assert_eq!(told.len(), 3);
    // Of the second and the third relative to the first.
    let told = joint(&poses, &told).fixed_view::<12, 12>(6, 6).into_owned();
    let way = |from: usize, to: usize| {
        let covariance = *params.drift.of(&poses[from].between(&poses[to]), None).covariance();
        (from, to, Se3::inverse_of(&covariance).unwrap())
    };
    let found = Lane.align(&PointCloud::default(), &Se3::identity()).unwrap();
    let find = closure(&found, 0, 3, &params).unwrap();
    let known = joint(&poses, &[way(1, 3), (0, 3, find.information), way(3, 2)]);
    // Without the pose that was not kept.
    let (own, cross) = (known.fixed_view::<6, 6>(18, 18).into_owned(), known.fixed_view::<12, 6>(6, 18).into_owned());
    let known = known.fixed_view::<12, 12>(6, 6) - cross * own.try_inverse().unwrap() * cross.transpose();
    let root = known.cholesky().unwrap().l().try_inverse().unwrap();
    let shares = (root * told * root.transpose()).symmetric_eigenvalues();
    assert!(shares.max() < 1.0 + 1e-6 && shares.min() > 0.4, "{shares}");
}

/// A find that is taken out leaves the key frame after it where odometry says.
#[test]
fn odometry_holds_what_a_find_held() {
    let params = KeyFrameParams { loops: LoopParams { min_way: 8.0, ..Default::default() }, ..Default::default() };
    let mut mapper = KeyFrameMapper::new(Lane, params).unwrap();
    driven(&mut mapper, 1.5);
    let of_odometry = |relation: &&Relation<Se3>| relation.to.0 == 13 && relation.kernel != KERNEL;
    let held: Vec<_> = mapper.map().relations().iter().filter(of_odometry).collect();
    let [held] = held[..] else { panic!("{held:?}") };
    let off = held.from_from_to.between(&Se2::new(-1.0, 1.5, 0.0).into()).log();
    assert!(held.from.0 == 12 && off.norm() < 1e-9, "{held:?}");
    // Neighbours of one drive are related; odometry over a long way does not keep a find from relating its ends.
    let mut map = mapper.into_map();
    assert!(map.is_related(13, 12) && map.is_related(5, 12) && !map.is_related(13, 4));
    map.keys[13].way += 100.0;
    assert!(!map.is_related(12, 13) && map.is_related(5, 13));
}
