//! Minima that are known: by construction, or certified.

use super::*;
use crate::geometry::{LieGroup, Se2};
use crate::solve::{BandedNormalEquations, FIXED, RobustKernel};
use nalgebra::{Matrix2x3, RowVector2, RowVector3, Vector1, Vector2, Vector3};

fn solver() -> LevenbergMarquardt {
    LevenbergMarquardt::new(LevenbergMarquardtParams::default()).unwrap()
}

/// Residuals of a vector problem, one at a time: `(r, dr/dx)`.
struct Curve<F>(F, usize);

impl<const N: usize, F: Fn(usize, &SVector<f64, N>) -> (f64, SVector<f64, N>)> LeastSquares<N> for Curve<F> {
    type State = SVector<f64, N>;

    fn linearize(&mut self, x: &Self::State, normal: &mut NormalEquations<N>) {
        for i in 0..self.1 {
            let (residual, slope) = self.0(i, x);
            normal.add(&Vector1::new(residual), &slope.transpose(), 1.0);
        }
    }

    fn cost(&mut self, x: &Self::State) -> f64 {
        (0..self.1).map(|i| 0.5 * self.0(i, x).0.powi(2)).sum()
    }

    fn retract(&self, x: &Self::State, step: &Self::State) -> Self::State {
        x + step
    }
}

#[test]
fn rosenbrock_s_valley_is_walked_to_its_end() {
    let mut valley = Curve(
        |i, x: &Vector2<f64>| match i {
            0 => (10.0 * (x.y - x.x * x.x), Vector2::new(-20.0 * x.x, 10.0)),
            _ => (1.0 - x.x, Vector2::new(-1.0, 0.0)),
        },
        2,
    );
    let found = solver().minimize(&mut valley, Vector2::new(-1.2, 1.0)).unwrap();
    assert!(found.converged() && (found.state - Vector2::new(1.0, 1.0)).norm() < 1e-10, "{found:?}");
    assert!(found.iterations < 40, "{}", found.iterations);
}

#[test]
fn a_circle_is_found_from_an_arc() {
    let (centre, radius) = (Vector2::new(1.5, -2.0), 3.0);
    let on = |i: usize| centre + Vector2::new((0.1 * i as f64).cos(), (0.1 * i as f64).sin()) * radius;
    let mut circle = Curve(
        |i, x: &Vector3<f64>| {
            let away = x.xy() - on(i);
            let slope = away.normalize();
            (away.norm() - x.z, Vector3::new(slope.x, slope.y, -1.0))
        },
        15,
    );
    let found = solver().minimize(&mut circle, Vector3::new(0.0, 0.0, 1.0)).unwrap();
    assert!(found.converged() && (found.state - Vector3::new(1.5, -2.0, 3.0)).norm() < 1e-9, "{found:?}");
}

/// NIST Statistical Reference Datasets, Misra1a: y = b1 (1 - exp(-b2 x)); lower difficulty, certified to 11 digits.
const MISRA1A: [(f64, f64); 14] = [
    (10.07, 77.6),
    (14.73, 114.9),
    (17.94, 141.1),
    (23.93, 190.8),
    (29.61, 239.9),
    (35.18, 289.0),
    (40.02, 332.8),
    (44.82, 378.4),
    (50.76, 434.8),
    (55.05, 477.3),
    (61.01, 536.8),
    (66.40, 593.1),
    (75.47, 689.1),
    (81.78, 760.0),
];

#[test]
fn misra1a_meets_its_certified_values() {
    let mut curve = Curve(
        |i, b: &Vector2<f64>| {
            let (y, x): (f64, f64) = MISRA1A[i];
            let decay = f64::exp(-b.y * x);
            (b.x * (1.0 - decay) - y, Vector2::new(1.0 - decay, b.x * x * decay))
        },
        MISRA1A.len(),
    );
    for start in [Vector2::new(500.0, 1e-4), Vector2::new(250.0, 5e-4)] {
        let found = solver().minimize(&mut curve, start).unwrap();
        assert!(found.converged(), "{found:?}");
        let relative = |value: f64, certified: f64| (value / certified - 1.0).abs();
        assert!(relative(found.state.x, 2.389_421_291_8e2) < 1e-9, "{}", found.state);
        assert!(relative(found.state.y, 5.501_564_318_1e-4) < 1e-9, "{}", found.state);
        let squares = 2.0 * found.normal.cost;
        assert!(relative(squares, 1.245_513_889_4e-1) < 1e-10, "{squares}");
        let covariance = found.normal.hessian.try_inverse().unwrap() * (squares / 12.0);
        assert!(relative(covariance.m11.sqrt(), 2.707_007_524_1) < 1e-7);
        assert!(relative(covariance.m22.sqrt(), 7.266_868_843_6e-6) < 1e-7);
    }
}

/// A pose from points seen in two frames.
struct Correspondences(Vec<(Vector2<f64>, Vector2<f64>)>);

impl LeastSquares<3> for Correspondences {
    type State = Se2;

    fn linearize(&mut self, pose: &Se2, normal: &mut NormalEquations<3>) {
        for (target, source) in &self.0 {
            let (jacobian, _): (Matrix2x3<f64>, _) = pose.act_jacobians(source);
            normal.add(&(pose.act(source) - target), &jacobian, 2.0);
        }
    }

    fn cost(&mut self, pose: &Se2) -> f64 {
        self.0.iter().map(|(target, source)| (pose.act(source) - target).norm_squared()).sum()
    }

    fn retract(&self, pose: &Se2, step: &Vector3<f64>) -> Se2 {
        pose.plus(step)
    }
}

#[test]
fn a_pose_is_found_on_its_manifold() {
    let truth = Se2::new(3.0, -1.0, 3.0);
    let points = [(0.0, 0.0), (4.0, 1.0), (2.0, 5.0), (-1.0, 2.0)].map(|(x, y)| Vector2::new(x, y));
    let mut problem = Correspondences(points.iter().map(|p| (truth.act(p), *p)).collect());
    // Starts all round the circle, across the cut at half a turn.
    for yaw in [-3.0, -1.5, 0.0, 1.5] {
        let found = solver().minimize(&mut problem, Se2::new(0.0, 0.0, yaw)).unwrap();
        assert!(found.converged() && found.state.minus(&truth).norm() < 1e-9, "{yaw}: {found:?}");
    }
}

#[test]
fn ends_are_told_apart() {
    let parabola = |slope: f64| Curve(move |_, x: &Vector1<f64>| (x.x.powi(2) + 1.0, Vector1::new(slope * x.x)), 1);
    let found = solver().minimize(&mut parabola(2.0), Vector1::new(3.0)).unwrap();
    assert!(found.converged() && found.state.x.abs() < 1e-5);
    // A Jacobian of the wrong sign leads uphill only.
    let wrong = solver().minimize(&mut parabola(-2.0), Vector1::new(3.0)).unwrap();
    assert_eq!((wrong.termination, wrong.state), (LeastSquaresTermination::Stalled, Vector1::new(3.0)));
    let short = LevenbergMarquardtParams { max_iterations: 1, ..LevenbergMarquardtParams::default() };
    let ended = LevenbergMarquardt::new(short).unwrap().minimize(&mut parabola(2.0), Vector1::new(3.0)).unwrap();
    assert_eq!((ended.termination, ended.iterations), (LeastSquaresTermination::MaxIterations, 1));
    let coarse = LevenbergMarquardtParams { step_tolerance: 0.5, ..LevenbergMarquardtParams::default() };
    let ended = LevenbergMarquardt::new(coarse).unwrap().minimize(&mut parabola(2.0), Vector1::new(0.1)).unwrap();
    assert_eq!(ended.termination, LeastSquaresTermination::Step);
}

#[test]
fn unknowns_without_influence_stay() {
    let mut line = Curve(|_, x: &Vector2<f64>| (x.x - 2.0, RowVector2::new(1.0, 0.0).transpose()), 1);
    let found = solver().minimize(&mut line, Vector2::new(0.0, 7.0)).unwrap();
    assert!(found.converged() && (found.state - Vector2::new(2.0, 7.0)).norm() < 1e-9);
}

#[test]
fn bad_input_is_named() {
    let mut nan = Curve(|_, x: &Vector3<f64>| (x.x / 0.0 * 0.0, RowVector3::zeros().transpose()), 1);
    assert!(matches!(solver().minimize(&mut nan, Vector3::zeros()), Err(Error::NotFinite { name: "cost", .. })));
    for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let params = LevenbergMarquardtParams { initial_damping: value, ..LevenbergMarquardtParams::default() };
        assert!(matches!(LevenbergMarquardt::new(params), Err(Error::NotPositive { .. })), "{value}");
    }
    for value in [-1.0, f64::NAN] {
        let params = LevenbergMarquardtParams { cost_tolerance: value, ..LevenbergMarquardtParams::default() };
        assert!(matches!(LevenbergMarquardt::new(params), Err(Error::Negative { .. })), "{value}");
    }
}

/// A smoothed track: positions near noisy readings, with small second differences, and its first position given.
struct Smoothing {
    readings: Vec<f64>,
    kernel: RobustKernel,
}

impl Smoothing {
    const STIFFNESS: f64 = 30.0;

    /// Every residual with its unknowns and its slopes.
    fn residuals(&self, track: &[f64], mut add: impl FnMut(bool, [usize; 3], f64, [f64; 3])) {
        let unknown = |i: usize| i.checked_sub(1).unwrap_or(FIXED);
        for (i, (x, reading)) in track.iter().zip(&self.readings).enumerate() {
            add(true, [unknown(i), FIXED, FIXED], x - reading, [1.0, 0.0, 0.0]);
        }
        for i in 2..track.len() {
            let bend = track[i] - 2.0 * track[i - 1] + track[i - 2];
            add(false, [i, i - 1, i - 2].map(unknown), bend, [1.0, -2.0, 1.0]);
        }
    }
}

impl<S: NormalSystem> StructuredLeastSquares<S> for Smoothing {
    type State = Vec<f64>;

    fn linearize(&mut self, track: &Vec<f64>, system: &mut S) {
        self.residuals(track, |reading, unknowns, residual, slopes| {
            let (residual, jacobian) = (Vector1::new(residual), RowVector3::from(slopes));
            if reading {
                system.add_robust_at(&unknowns, &residual, &jacobian, 1.0, self.kernel);
            } else {
                system.add_at(&unknowns, &residual, &jacobian, Self::STIFFNESS);
            }
        });
    }

    fn cost(&mut self, track: &Vec<f64>) -> f64 {
        let mut cost = 0.0;
        self.residuals(track, |reading, _, r, _| {
            cost += 0.5 * if reading { self.kernel.loss(r * r) } else { Self::STIFFNESS * r * r };
        });
        cost
    }

    fn retract_into(&self, track: &Vec<f64>, step: &[f64], trial: &mut Vec<f64>) {
        trial.clone_from(track);
        trial[1..].iter_mut().zip(step).for_each(|(x, step)| *x += step);
    }
}

/// A ramp with a ripple, and a few readings far off.
fn track(kernel: RobustKernel) -> Smoothing {
    let reading = |i: usize| 0.1 * i as f64 + 0.05 * (7.0 * i as f64).sin() + if i % 9 == 5 { 3.0 } else { 0.0 };
    Smoothing { readings: (0..25).map(reading).collect(), kernel }
}

#[test]
fn a_band_and_a_dense_matrix_lead_to_the_same_minimum() {
    for kernel in [RobustKernel::Square, RobustKernel::Huber { scale: 0.3 }, RobustKernel::Cauchy { scale: 0.3 }] {
        let mut problem = track(kernel);
        let start = vec![0.0; 25];
        let mut banded = LeastSquaresWorkspace::new(BandedNormalEquations::new(24, 2), start.clone());
        let mut dense = LeastSquaresWorkspace::new(NormalEquations::<24>::zeros(), start.clone());
        let (mut smooth, mut reference) = (start.clone(), start);
        let found = solver().minimize_structured(&mut problem, &mut smooth, &mut banded).unwrap();
        let expected = solver().minimize_structured(&mut problem, &mut reference, &mut dense).unwrap();
        assert!(found.termination.converged() && expected.termination.converged(), "{found:?} {expected:?}");
        assert!((found.cost / expected.cost - 1.0).abs() < 1e-10, "{found:?} {expected:?}");
        let apart = smooth.iter().zip(&reference).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-6, "{kernel:?}: {apart}");
        assert_eq!(smooth[0], 0.0, "the first position is given");
    }
}

#[test]
fn robust_kernels_see_through_outliers() {
    let worst = |kernel: RobustKernel| {
        let mut problem = track(kernel);
        let mut smooth = problem.readings.clone();
        smooth[0] = 0.0;
        let mut workspace = LeastSquaresWorkspace::new(BandedNormalEquations::new(24, 2), smooth.clone());
        let found = solver().minimize_structured(&mut problem, &mut smooth, &mut workspace).unwrap();
        assert!(found.termination.converged(), "{kernel:?} {found:?}");
        smooth.iter().enumerate().map(|(i, x)| (x - 0.1 * i as f64).abs()).fold(0.0, f64::max)
    };
    assert!(worst(RobustKernel::Square) > 0.5);
    assert!(worst(RobustKernel::Huber { scale: 0.1 }) < 0.2);
    assert!(worst(RobustKernel::Cauchy { scale: 0.1 }) < 0.1);
}

#[test]
fn a_structure_that_is_too_narrow_is_named() {
    let mut problem = track(RobustKernel::Square);
    let (mut smooth, before) = (vec![0.0; 25], vec![0.0; 25]);
    let mut workspace = LeastSquaresWorkspace::new(BandedNormalEquations::new(24, 1), smooth.clone());
    let found = solver().minimize_structured(&mut problem, &mut smooth, &mut workspace);
    assert!(matches!(found, Err(Error::OutOfRange { .. })) && smooth == before);
    // The same memory serves another size.
    workspace.system.reset(24, 2);
    assert!(solver().minimize_structured(&mut problem, &mut smooth, &mut workspace).is_ok());
}
