//! How sure landmark SLAM may be: errors against stated covariances, over simulated loops of many seeds.
//!
//! A vehicle goes two and a half times around a circle among posts, no two drives alike in noise or posts, with the noise that the filter is
//! told. Errors in the group and in each coordinate by itself (as in textbooks), posts with names and without, odometry of three
//! qualities. `-- --nocapture` prints the table of `docs/experiments.md`.

use agv_core::{
    compute::{Seed, Stream},
    geometry::{LieGroup, Se2, wrap_angle},
    metrics::chi_square_quantile,
    odometry::OdometryIncrement,
    time::Stamp,
};
use agv_filters::slam::landmark::{LandmarkReading, LandmarkSighting, LandmarkSlam, LandmarkSlamParams, SlamErrors};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

const DRIVES: usize = 60;
const RADIUS: f64 = 15.0;
const STEP: f64 = 0.5;
/// Of a round, in steps; two and a half rounds.
const ROUND: usize = 188;
const STEPS: usize = ROUND * 5 / 2;
/// Of a step's odometry: ahead and to the side, in metres, and in radians.
const DRIFT: [f64; 3] = [0.03, 0.01, 0.01];
/// Of range and bearing.
const SIGHT: [f64; 2] = [0.05, 0.01];
/// How far posts are seen, in metres.
const VIEW: f64 = 7.0;
const POSTS: usize = 28;

fn normal(stream: &mut Stream) -> f64 {
    StandardNormal.sample(stream)
}

/// To both sides of the way, two and a half metres apart at least.
fn posts(stream: &mut Stream) -> Vec<Vector2<f64>> {
    let mut posts: Vec<Vector2<f64>> = Vec::new();
    while posts.len() < POSTS {
        let (sin, cos) = stream.random_range(0.0..TAU).sin_cos();
        let radius = RADIUS + stream.random_range(-5.0..5.0);
        let post = Vector2::new(radius * sin, RADIUS - radius * cos);
        if posts.iter().all(|other| (other - post).norm() > 2.5) {
            posts.push(post);
        }
    }
    posts
}

/// Errors of one drive at every step: squares by the stated covariance, then in place and heading.
struct Drive {
    nees: Vec<f64>,
    place: Vec<f64>,
    heading: Vec<f64>,
    landmarks: usize,
}

/// What is done in a drive.
#[derive(Clone, Copy)]
struct Kind {
    errors: SlamErrors,
    named: bool,
    /// Factor of the odometry's noise.
    slip: f64,
    lead: f64,
}

fn drive(seed: u64, Kind { errors, named, slip, lead }: Kind) -> Drive {
    let mut stream = Seed(seed).stream(0, 0);
    let posts = posts(&mut stream);
    let mut slam = LandmarkSlam::new(LandmarkSlamParams { errors, lead, ..Default::default() }).unwrap();
    let (motion, now, mut truth) =
        (Se2::exp(&Vector3::new(STEP, 0.0, STEP / RADIUS)), Stamp::default(), Se2::default());
    let sigmas = DRIFT.map(|sigma| slip * sigma);
    let covariance = Matrix3::from_diagonal(&sigmas.map(|sigma| sigma * sigma).into());
    let mut run = Drive { nees: Vec::new(), place: Vec::new(), heading: Vec::new(), landmarks: 0 };
    for _ in 0..STEPS {
        let noise = Vector3::from(sigmas.map(|sigma| sigma * normal(&mut stream)));
        let odometry = OdometryIncrement { start: now, end: now, start_from_end: motion, covariance };
        slam.predict(&odometry).unwrap();
        // The truth is off the odometry, so that ways differ too.
        truth = truth * motion.plus(&noise);
        let mut seen = Vec::new();
        for (id, post) in (0..).zip(&posts) {
            let q = truth.inverse().act(post);
            let noise = [normal(&mut stream), normal(&mut stream)];
            if q.norm() < VIEW && q.x > 0.0 {
                let (range, bearing) = (q.norm() + SIGHT[0] * noise[0], q.y.atan2(q.x) + SIGHT[1] * noise[1]);
                let reading = LandmarkReading::range_bearing(range.max(0.0), bearing, SIGHT).unwrap();
                seen.push(LandmarkSighting::new(named.then_some(id), reading));
            }
        }
        slam.update(&seen).unwrap();
        let estimate = slam.estimate().unwrap();
        let (mean, off) = (estimate.mean(), truth.translation() - estimate.mean().translation());
        let turn = wrap_angle(truth.yaw() - mean.yaw());
        // Each filter by its own error.
        let error = match errors {
            SlamErrors::Invariant => truth.minus(mean),
            SlamErrors::Additive => {
                let ahead = mean.rotation().inverse().act(&off);
                Vector3::new(ahead.x, ahead.y, turn)
            }
        };
        run.nees.push(error.dot(&estimate.covariance().cholesky().unwrap().solve(&error)));
        run.place.push(off.norm());
        run.heading.push(turn);
    }
    run.landmarks = slam.landmarks().filter(|landmark| landmark.confirmed).count();
    run
}

/// What all drives of a kind come to.
struct Study {
    /// Mean over the drives at each step.
    nees: Vec<f64>,
    /// Share of steps whose mean is within the band of 95 % of so many drives, and of single squares within theirs.
    within: [f64; 2],
    /// In metres and in radians.
    rmse: [f64; 2],
    /// Drives whose last error is beyond what one in ten thousand may have.
    lost: usize,
    /// Landmarks too many or too few, a drive.
    landmarks_off: f64,
}

/// Of the mean of so many squares of three degrees of freedom.
fn band(drives: usize, outside: f64) -> [f64; 2] {
    let degrees = 3.0 * drives as f64;
    [0.5 * outside, 1.0 - 0.5 * outside].map(|p| chi_square_quantile(degrees, p).unwrap() / drives as f64)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    sum / f64::from(count)
}

fn study(kind: Kind) -> Study {
    let drives: Vec<Drive> = (0..DRIVES as u64).map(|seed| drive(seed, kind)).collect();
    let nees: Vec<f64> = (0..STEPS).map(|k| mean(drives.iter().map(|drive| drive.nees[k]))).collect();
    let inside = |value: f64, [low, high]: [f64; 2]| f64::from(u8::from((low..=high).contains(&value)));
    let [all, single] = [band(DRIVES, 0.05), band(1, 0.05)];
    let within = [
        mean(nees.iter().map(|nees| inside(*nees, all))),
        mean(drives.iter().flat_map(|drive| &drive.nees).map(|nees| inside(*nees, single))),
    ];
    let rmse = [|drive: &Drive| drive.place.clone(), |drive: &Drive| drive.heading.clone()]
        .map(|of| mean(drives.iter().flat_map(of).map(|error| error * error)).sqrt());
    let farthest = chi_square_quantile(3.0, 0.9999).unwrap();
    let lost = drives.iter().filter(|drive| drive.nees[STEPS - 1] > farthest).count();
    let landmarks_off = mean(drives.iter().map(|drive| (drive.landmarks as f64 - POSTS as f64).abs()));
    let study = Study { nees, within, rmse, lost, landmarks_off };
    study.print(kind);
    study
}

impl Study {
    /// Mean over the steps of each half of a round.
    fn halves(&self) -> impl Iterator<Item = f64> + '_ {
        self.nees.chunks(ROUND / 2).map(|part| mean(part.iter().copied()))
    }

    fn print(&self, Kind { errors, named, slip, lead }: Kind) {
        let halves: Vec<_> = self.halves().map(|nees| format!("{nees:.2}")).collect();
        println!(
            "| {slip} | {} | {errors:?} | {lead} | {} | {:.0}, {:.0} % | {:.3} m, {:.2}° | {} | {:.2} |",
            if named { "known" } else { "joint" },
            halves.join(", "),
            100.0 * self.within[0],
            100.0 * self.within[1],
            self.rmse[0],
            self.rmse[1].to_degrees(),
            self.lost,
            self.landmarks_off
        );
    }

    /// Each half's mean is within the band of 99 % of one step, and single squares are in theirs as often as they ought to be, were
    /// all of a drive the same.
    fn is_consistent(&self) -> bool {
        let [low, high] = band(DRIVES, 0.01);
        let share = 0.95 - 2.58 * (0.95 * 0.05 / DRIVES as f64).sqrt();
        self.halves().all(|nees| low < nees && nees < high) && self.within[1] > share
    }
}

const LEAD: f64 = 9.21;

/// With names, however bad the odometry is. Errors in each coordinate by itself are not: the heading is thought to be better known than it is.
#[test]
fn errors_in_the_group_are_as_large_as_stated() {
    for slip in [0.25, 0.5, 1.0] {
        let of = |errors| study(Kind { errors, named: true, slip, lead: LEAD });
        let [group, textbook] = [SlamErrors::Invariant, SlamErrors::Additive].map(of);
        assert!(group.is_consistent() && group.lost == 0, "{slip}");
        if slip > 0.25 {
            assert!(!textbook.is_consistent() && group.rmse[0] < textbook.rmse[0], "{slip}");
        }
    }
}

/// Without names, as long as the vehicle knows where it is to less than posts are apart; where it does not, errors in the group and doubt
/// keep more of the drives.
#[test]
fn loops_close_without_names_as_far_as_they_can() {
    let of = |errors, slip, lead| study(Kind { errors, named: false, slip, lead });
    let fair = of(SlamErrors::Invariant, 0.25, LEAD);
    assert!(fair.is_consistent() && fair.lost == 0 && fair.landmarks_off == 0.0);
    of(SlamErrors::Additive, 0.25, LEAD);
    of(SlamErrors::Invariant, 0.5, LEAD);
    of(SlamErrors::Additive, 0.5, LEAD);
    let poor = of(SlamErrors::Invariant, 1.0, LEAD);
    let textbook = of(SlamErrors::Additive, 1.0, LEAD);
    assert!(poor.lost < textbook.lost && poor.rmse[0] < textbook.rmse[0]);
    let without_doubt = of(SlamErrors::Invariant, 1.0, 0.0);
    assert!(poor.lost < without_doubt.lost && poor.rmse[0] < without_doubt.rmse[0]);
}
