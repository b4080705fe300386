//! The simulation of paper 000, Eqs. 15 and 16, against theory: errors as large as the Riccati equation says, and as the filter
//! states.

use agv_core::{
    compute::{Seed, Stream},
    metrics::chi_square_quantile,
};
use agv_filters::kalman::{Ekf, Gate, Manifold, PlanarPose, PoseReading, ProcessModel};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};

const DT: f64 = 0.1;
const STEPS: usize = 600;
const RUNS: u64 = 200;
/// Standard deviations of a reading, in metres and radians.
const READING: [f64; 3] = [0.25, 0.25, 0.007];

/// 0.1 m/s and 0.1 rad/s, with noise of this variance per step on each component.
struct Eq16(f64);

impl ProcessModel<PlanarPose, 3> for Eq16 {
    type Control = ();

    fn transition(&self, pose: &PlanarPose, (): &(), dt: f64) -> PlanarPose {
        let (sin, cos) = pose[2].sin_cos();
        pose.boxplus(&(Vector3::new(0.1 * cos, 0.1 * sin, 0.1) * dt))
    }

    fn jacobian(&self, pose: &PlanarPose, (): &(), dt: f64) -> Matrix3<f64> {
        let (sin, cos) = pose[2].sin_cos();
        Matrix3::new(1.0, 0.0, -0.1 * sin * dt, 0.0, 1.0, 0.1 * cos * dt, 0.0, 0.0, 1.0)
    }

    fn noise(&self, _: &PlanarPose, (): &(), _: f64) -> Matrix3<f64> {
        Matrix3::identity() * self.0
    }
}

fn draw(stream: &mut Stream) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(stream))
}

/// The positive root of `P² + q P - q r = 0`: where a random walk of variance `q`, read with the deviation `sigma`, settles.
fn riccati(q: f64, sigma: f64) -> f64 {
    0.5 * q * ((1.0 + 4.0 * sigma * sigma / q).sqrt() - 1.0)
}

/// Mean squares of a run's position error (along an axis) and heading error, NEES at its end and mean NIS.
fn run(model: &Eq16, settled: &Matrix3<f64>, seed: u64) -> [f64; 4] {
    let mut stream = Seed(seed).stream(0, 0);
    let sensor = PoseReading::new(Matrix3::from_diagonal(&Vector3::from(READING).map(|s| s * s))).unwrap();
    let start = PlanarPose::from(Vector3::zeros());
    let mut ekf = Ekf::new(start, *settled).unwrap();
    let mut truth = start.boxplus(&(settled.cholesky().unwrap().l() * draw(&mut stream)));
    let mut sums = [0.0; 4];
    for _ in 0..STEPS {
        truth = model.sample(&truth, &(), DT, &mut stream);
        let seen = truth.boxplus(&draw(&mut stream).component_mul(&Vector3::from(READING)));
        ekf.predict(model, &(), DT).unwrap();
        let correction = ekf.update(&sensor, &seen, &Gate::OPEN).unwrap();
        let error = truth.boxminus(ekf.state());
        sums[0] += 0.5 * error.xy().norm_squared() / STEPS as f64;
        sums[1] += error.z * error.z / STEPS as f64;
        sums[3] += correction.innovation.nis / STEPS as f64;
    }
    sums[2] = ekf.belief().nees(&truth).unwrap();
    sums
}

#[test]
fn both_readings_of_the_noise_match_their_riccati_values() {
    for variance in [1e-3, 1e-3 * DT * DT] {
        let model = Eq16(variance);
        let expected = [riccati(variance, READING[0]), riccati(variance, READING[2])];
        let settled = Matrix3::from_diagonal(&Vector3::new(expected[0], expected[0], expected[1]));
        let runs: Vec<_> = (0..RUNS).map(|seed| run(&model, &settled, seed)).collect();
        let mean = |index: usize| runs.iter().map(|run| run[index]).sum::<f64>() / RUNS as f64;
        for (index, expected) in expected.into_iter().enumerate() {
            let variance = runs.iter().map(|run| (run[index] - mean(index)).powi(2)).sum::<f64>() / (RUNS - 1) as f64;
            let off = (mean(index) - expected) / (variance / RUNS as f64).sqrt();
            assert!(off.abs() < 3.0, "component {index}: {} for {expected}, {off} standard errors", mean(index));
        }
        // Independent runs: their NEES sums to chi-square with three degrees of freedom each.
        let degrees = 3.0 * RUNS as f64;
        let [low, high] = [0.025, 0.975].map(|p| chi_square_quantile(degrees, p).unwrap() / RUNS as f64);
        assert!(mean(2) > low && mean(2) < high, "NEES {} not in {low}..{high}", mean(2));
        // Innovations are white: all of them are independent.
        let degrees = 3.0 * (RUNS as usize * STEPS) as f64;
        let [low, high] = [0.025, 0.975].map(|p| 3.0 * chi_square_quantile(degrees, p).unwrap() / degrees);
        assert!(mean(3) > low && mean(3) < high, "NIS {} not in {low}..{high}", mean(3));
    }
}
