//! Errors are as large as the filter says, and so are innovations.

use super::*;
use agv_core::metrics::chi_square_quantile;

/// What one run leaves: squared errors of pose and velocity, of the bias, of the motions handed out, weighed by their covariances,
/// and how consistent each source was.
struct Run {
    pose: f64,
    twist: f64,
    bias: f64,
    motions: Vec<f64>,
    consistency: [f64; 3],
}

fn weighed(error: &Vector3<f64>, covariance: &Matrix3<f64>) -> f64 {
    error.dot(&(covariance.try_inverse().unwrap() * error))
}

/// Two seconds of odometry at 50 Hz, a gyro at 100 Hz, and a pose twice a second, all of which come 0 to 60 ms late.
fn run(seed: u64) -> Run {
    let params = FusionParams { motion: MotionParams::omnidirectional(), ..FusionParams::default() };
    let mut truth = Wanderer::new(params, seed);
    let mut filter = FusionFilter::new(params).unwrap();
    let wheels = filter.add_source(bare(SourceParams::wheels())).unwrap();
    let gyro = filter.add_source(bare(SourceParams::imu())).unwrap();
    let tracker = filter.add_source(bare(SourceParams::pose())).unwrap();
    filter.initialize_at(at(0.0), &belief(Se2::default())).unwrap();
    filter.take_motion().unwrap();
    let (by_wheels, by_tracker, by_gyro) = ([2e-3, 2e-3, 1e-3], [0.02, 0.02, 0.01], 2e-3);
    let (mut last, mut taken) = ((0.0, truth.pose), truth.pose);
    let mut motions = Vec::new();
    for step in 1..=200 {
        truth.step();
        let now = truth.time();
        let rate = truth.twist.yaw_rate + truth.bias + by_gyro * normal(&mut truth.stream);
        filter.fuse(gyro, rates(now, rate, by_gyro)).unwrap();
        // The odometry of this step comes after the gyro of the same time.
        if step % 2 == 0 {
            let read = last.1.between(&truth.pose).plus(&truth.noisy(by_wheels));
            let moved = motion(last.0, &Se2::default(), now, &read, squares(by_wheels));
            filter.fuse(wheels, moved).unwrap();
            last = (now, truth.pose);
        }
        if step % 50 == 0 {
            let error = truth.noisy(by_tracker);
            let pose = truth.pose.plus(&error);
            filter.fuse(tracker, seen(now, pose, squares(by_tracker))).unwrap();
            let motion = filter.take_motion().unwrap().unwrap();
            let error = taken.between(&truth.pose).minus(&motion.start_from_end);
            motions.push(weighed(&error, &motion.covariance));
            taken = truth.pose;
        }
    }
    let state = filter.state().unwrap();
    let (bias, sigma) = state.gyro_bias;
    let twist = Vector3::from(truth.twist) - Vector3::from(state.twist);
    Run {
        pose: weighed(&truth.pose.minus(state.pose.mean()), state.pose.covariance()),
        twist: weighed(&twist, &state.twist_covariance),
        bias: ((truth.bias - bias) / sigma).powi(2),
        motions,
        consistency: [wheels, gyro, tracker].map(|source| filter.diagnostics(source).unwrap().consistency.unwrap()),
    }
}

/// Sums over 200 independent runs are chi-square distributed: all inside a band that chance leaves once in 10 000 tests.
#[test]
fn errors_are_as_large_as_stated() {
    let runs: Vec<Run> = (0..200).map(run).collect();
    let count = runs.len() as f64;
    let sum = |of: &dyn Fn(&Run) -> f64| runs.iter().map(of).sum::<f64>();
    for (name, value, degrees) in [
        ("pose", sum(&|run| run.pose), 3.0 * count),
        ("twist", sum(&|run| run.twist), 3.0 * count),
        ("bias", sum(&|run| run.bias), count),
        ("first motion", sum(&|run| run.motions[0]), 3.0 * count),
        ("last motion", sum(&|run| run.motions[3]), 3.0 * count),
    ] {
        let [low, high] = [5e-5, 1.0 - 5e-5].map(|p| chi_square_quantile(degrees, p).unwrap());
        assert!(value > low && value < high, "{name}: {value} of {degrees}, [{low}, {high}]");
    }
    // 200 runs x 100, 200 and 4 measurements of 3, 1 and 3 numbers.
    for (source, numbers) in [(0, 60_000.0), (1, 40_000.0), (2, 2400.0)] {
        let mean = sum(&|run| run.consistency[source]) / count;
        assert!((mean - 1.0).abs() < 4.0 * (2.0_f64 / numbers).sqrt(), "source {source}: {mean}");
    }
}

/// Wheels that misread by 4 % and 6 % are found out by poses in the map, within what the filter says of it.
#[test]
fn scales_of_wheels_are_found() {
    let params = FusionParams { distance_scale_sigma: 0.05, yaw_scale_sigma: 0.05, ..FusionParams::default() };
    let mut filter = FusionFilter::new(params).unwrap();
    let wheels = filter.add_source(SourceParams { gate: 1.0, ..SourceParams::wheels() }).unwrap();
    let tracker = filter.add_source(bare(SourceParams::pose())).unwrap();
    filter.initialize_at(at(0.0), &belief(Se2::default())).unwrap();
    let (mut pose, mut stream) = (Se2::default(), Seed(4).stream(0, 0));
    for step in 0..1500_u32 {
        let twist = Twist2::new(0.8, 0.0, 0.5 * (f64::from(step) * 0.01).sin());
        pose = pose * twist.integrate(0.02);
        let read = Twist2::new(twist.vx / 1.04, 0.0, twist.yaw_rate / 0.94).integrate(0.02);
        let (start, end) = (0.02 * f64::from(step), 0.02 * f64::from(step + 1));
        filter.fuse(wheels, motion(start, &Se2::default(), end, &read, Matrix3::zeros())).unwrap();
        if step % 10 == 9 {
            let noise = Vector3::new(0.02, 0.02, 0.01).map(|sigma| sigma * normal(&mut stream));
            filter.fuse(tracker, seen(end, pose.plus(&noise), squares([0.02, 0.02, 0.01]))).unwrap();
        }
    }
    let state = filter.state().unwrap();
    for ((found, sigma), truth) in [(state.distance_scale, 0.04), (state.yaw_scale, -0.06)] {
        assert!(sigma < 0.01 && (found - truth).abs() < 4.0 * sigma, "{found} ± {sigma}, {truth}");
    }
}

/// Poses that are 0.15 s older than their stamps are found out, and the vehicle is where it is and not where it was: within what the
/// filter says of both, over ten drives that speed up and slow down.
#[test]
fn latency_of_poses_is_found() {
    const LATE: f64 = 0.15;
    let params = FusionParams { latency_sigma: 0.2, ..FusionParams::default() };
    let (mut squares_of_latency, mut worst) = (0.0, 0.0_f64);
    for seed in 0..10 {
        let mut filter = FusionFilter::new(params).unwrap();
        let wheels = filter.add_source(SourceParams { gate: 1.0, ..SourceParams::wheels() }).unwrap();
        let tracker = filter.add_source(SourceParams { late: true, ..bare(SourceParams::pose()) }).unwrap();
        filter.initialize_at(at(0.0), &belief(Se2::default())).unwrap();
        let (mut poses, mut stream) = (vec![Se2::default()], Seed(seed).stream(0, 0));
        for step in 0..1500_u32 {
            let time = 0.02 * f64::from(step);
            let twist = Twist2::new(0.8 + 0.3 * time.sin(), 0.0, 0.5 * (0.5 * time).sin());
            let moved = twist.integrate(0.02);
            poses.push(poses[step as usize] * moved);
            filter.fuse(wheels, motion(time, &Se2::default(), time + 0.02, &moved, Matrix3::zeros())).unwrap();
            if step % 10 == 9 {
                // Between the poses of 0.14 and 0.16 s ago.
                let old = (f64::from(step + 1) - LATE / 0.02).floor() as usize;
                let then = poses[old].interpolate(&poses[old + 1], 0.5);
                let noise = Vector3::new(0.02, 0.02, 0.01).map(|sigma| sigma * normal(&mut stream));
                filter.fuse(tracker, seen(time + 0.02, then.plus(&noise), squares([0.02, 0.02, 0.01]))).unwrap();
            }
        }
        let state = filter.state().unwrap();
        let (found, sigma) = state.latency;
        assert!(sigma < 0.01, "{sigma}");
        squares_of_latency += ((found - LATE) / sigma).powi(2);
        worst = worst.max((state.pose.mean().translation() - poses[1500].translation()).norm());
    }
    // Chi-square of ten degrees of freedom, 99.99 %; without the state the error is 0.08 to 0.16 m.
    assert!(squares_of_latency < 35.6 && worst < 0.04, "{squares_of_latency}, {worst}");
}
