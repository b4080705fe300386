//! Rounds among posts that look alike, and a beacon of which only ranges are measured.

use agv_nav::core::{
    compute::Seed,
    geometry::{LieGroup, Se2},
    nalgebra::{Matrix3, Vector2, Vector3},
    odometry::OdometryIncrement,
    time::Stamp,
};
use agv_nav::filters::slam::landmark::{LandmarkReading, LandmarkSighting, LandmarkSlam, LandmarkSlamParams};
use rand_distr::{Distribution, StandardNormal};

/// A motion, and what is seen after it.
pub(crate) type Look = (OdometryIncrement, Vec<LandmarkSighting>);

/// Rounds of sixty steps.
pub(crate) fn rounds(steps: usize) -> Vec<Look> {
    let mut stream = Seed(4).stream(0, 0);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut stream) };
    let posts: Vec<_> = (0..24)
        .map(|k| (0.55 * f64::from(k), if k % 2 == 0 { 9.0 } else { 3.0 }))
        .map(|(angle, radius)| Vector2::new(radius * angle.cos(), 6.0 + radius * angle.sin()))
        .collect();
    let (beacon, now) = (Vector2::new(9.0, 14.0), Stamp::default());
    let motion = Se2::exp(&Vector3::new(0.63, 0.0, 0.63 / 6.0));
    let mut truth = Se2::default();
    (0..steps)
        .map(|_| {
            truth = truth * motion;
            let noise = Vector3::new(0.01 * normal(), 0.01 * normal(), 0.003 * normal());
            let covariance = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5));
            let odometry = OdometryIncrement { start: now, end: now, start_from_end: motion.plus(&noise), covariance };
            let in_sight = posts.iter().map(|post| truth.inverse().act(post)).filter(|q| q.norm() < 7.0);
            let mut seen: Vec<_> = in_sight
                .map(|q| (q.norm() + 0.03 * normal(), q.y.atan2(q.x) + 0.005 * normal()))
                .map(|(range, bearing)| LandmarkReading::range_bearing(range, bearing, [0.03, 0.005]).unwrap())
                .map(|reading| LandmarkSighting::new(None, reading))
                .collect();
            let range = (beacon - truth.translation()).norm() + 0.1 * normal();
            seen.push(LandmarkSighting::new(Some(7), LandmarkReading::range(range, 0.1).unwrap()));
            (odometry, seen)
        })
        .collect()
}

/// A filter with a map of nothing.
pub(crate) fn filter() -> LandmarkSlam {
    LandmarkSlam::new(LandmarkSlamParams::default()).unwrap()
}

/// Runs it; the number of sightings that were matched.
pub(crate) fn run(slam: &mut LandmarkSlam, looks: &[Look]) -> usize {
    let take = |(odometry, seen): &Look| {
        slam.predict(odometry).unwrap();
        slam.update(seen).unwrap().matched
    };
    looks.iter().map(take).sum()
}
