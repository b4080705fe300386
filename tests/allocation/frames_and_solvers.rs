//! The frame tree with a bounded history, and the small solvers.

use crate::counter;
use agv_nav::core::{
    frames::{FrameTree, FrameTreeParams, Insertion},
    geometry::{LieGroup, Se2},
    nalgebra::{RowVector2, Vector1, Vector2, Vector3},
    solve::{
        BandedCholesky, BandedMatrix, BandedNormalEquations, LeastSquares, LeastSquaresWorkspace, LevenbergMarquardt,
        LevenbergMarquardtParams, NormalEquations, NormalSystem, QuadraticParams, QuadraticSolver, QuadraticVectors,
        RobustKernel, StructuredLeastSquares,
    },
    time::Stamp,
};

#[test]
fn frame_tree() {
    let params = FrameTreeParams { history: 1.0, capacity: 50 };
    let mut tree = FrameTree::new(params).unwrap();
    tree.set_static("base_footprint", "lidar_link", Se2::new(0.3, 0.0, 0.1).into()).unwrap();
    for (parent, child) in [("map", "odom"), ("odom", "base_footprint")] {
        tree.insert(parent, child, Stamp::from_seconds(-0.1), Se2::identity().into()).unwrap();
    }
    let mut run = |from: i32, to: i32| {
        for step in from..to {
            let stamp = Stamp::from_seconds(0.05 * f64::from(step));
            let pose = Se2::new(0.1 * f64::from(step), 0.0, 0.01 * f64::from(step));
            assert_eq!(tree.insert("map", "odom", stamp, Se2::identity().into()), Ok(Insertion::Added));
            assert_eq!(tree.insert("odom", "base_footprint", stamp, pose.into()), Ok(Insertion::Added));
            let late = Stamp::from_seconds(0.05 * f64::from(step) - 0.02);
            tree.insert("odom", "base_footprint", late, pose.into()).unwrap();
            assert!(tree.lookup("map", "lidar_link", late).is_ok());
            assert!(tree.lookup_latest("lidar_link", "map").is_ok());
            assert!(tree.lookup_through(("lidar_link", stamp), ("lidar_link", late), "odom").is_ok());
        }
    };
    run(0, 2);
    // Long enough that the history turns over several times.
    assert_eq!(counter::count(|| run(2, 200)), 0);
}

#[test]
fn banded_cholesky() {
    for half_bandwidth in [3, 8, 11] {
        let (dimension, mut cholesky) = (120, BandedCholesky::new());
        let mut matrix = BandedMatrix::new(dimension, half_bandwidth);
        let mut b = vec![1.0; dimension];
        let mut run = |shift: f64| {
            matrix.reset(dimension, half_bandwidth);
            for row in 0..dimension {
                for column in row.saturating_sub(half_bandwidth)..=row {
                    let value = if row == column { 30.0 + shift } else { 1.0 };
                    *matrix.entry(row, column).unwrap() = value;
                }
            }
            b.fill(1.0);
            cholesky.factor(&matrix).unwrap();
            cholesky.factor_damped(&matrix, 0.1).unwrap();
            cholesky.solve(&mut b).unwrap();
        };
        run(0.0);
        assert_eq!(counter::count(|| (1..10).for_each(|shift| run(f64::from(shift)))), 0);
    }
}

#[test]
fn quadratic_programme() {
    // A chain of ten unknowns, pulled further than its limits let it go.
    let (mut hessian, mut rows) = ([0.0; 100], [0.0; 50]);
    for i in 0..10 {
        hessian[11 * i] = 2.5;
        if i > 0 {
            hessian[11 * i - 1] = -1.0;
        }
        rows[5 * i] = 1.0;
    }
    let mut solver = QuadraticSolver::new(10, 5, QuadraticParams::default()).unwrap();
    let (mut iterations, mut gradient) = (0, [0.0; 10]);
    // From the very first call.
    let count = counter::count(|| {
        for pull in [1.0, -3.0, 8.0, 2.0] {
            (0..10).for_each(|i| gradient[i] = pull * (i as f64 - 4.0));
            solver.set_matrices(&hessian, &rows).unwrap();
            let vectors = QuadraticVectors {
                gradient: &gradient,
                lower: &[-1.0; 10],
                upper: &[1.0; 10],
                row_lower: &[-0.5; 5],
                row_upper: &[0.5; 5],
            };
            let outcome = solver.solve(&vectors).unwrap();
            assert!(outcome.solved(), "{outcome:?}");
            iterations += outcome.iterations;
        }
    });
    assert_eq!(count, 0);
    assert!(iterations > 10, "{iterations}");
}

/// The pose from which landmarks are seen where they are.
struct Resection([Vector2<f64>; 4]);

impl Resection {
    fn residual(&self, pose: &Se2, truth: &Se2, i: usize) -> Vector2<f64> {
        pose.act(&self.0[i]) - truth.act(&self.0[i])
    }
}

const TRUTH: Vector3<f64> = Vector3::new(0.4, -0.2, 0.6);

impl LeastSquares<3> for Resection {
    type State = Se2;

    fn linearize(&mut self, state: &Se2, normal: &mut NormalEquations<3>) {
        for i in 0..self.0.len() {
            normal.add(&self.residual(state, &Se2::exp(&TRUTH), i), &state.act_jacobians(&self.0[i]).0, 1.0);
        }
    }

    fn cost(&mut self, state: &Se2) -> f64 {
        (0..self.0.len()).map(|i| 0.5 * self.residual(state, &Se2::exp(&TRUTH), i).norm_squared()).sum()
    }

    fn retract(&self, state: &Se2, step: &Vector3<f64>) -> Se2 {
        state.compose(&Se2::exp(step))
    }
}

#[test]
fn levenberg_marquardt() {
    let landmarks = [(1.0, 0.0), (0.0, 2.0), (-1.0, 1.0), (3.0, -2.0)].map(|(x, y)| Vector2::new(x, y));
    let solver = LevenbergMarquardt::new(LevenbergMarquardtParams::default()).unwrap();
    let mut iterations = 0;
    let count = counter::count(|| {
        let found = solver.minimize(&mut Resection(landmarks), Se2::identity()).unwrap();
        assert!(found.converged() && (found.state.log() - TRUTH).norm() < 1e-6);
        iterations = found.iterations;
    });
    assert_eq!(count, 0);
    assert!(iterations > 1);
    // The smallest problem has the smallest matrices: none of them may be on the heap either.
    let mut normal = NormalEquations::<1>::zeros();
    assert_eq!(counter::count(|| normal.add(&Vector1::new(1.0), &Vector1::new(2.0), 1.0)), 0);
}

/// A chain whose links are one long, seen at one end with an outlier.
struct Chain;

impl StructuredLeastSquares<BandedNormalEquations> for Chain {
    type State = Vec<f64>;

    fn linearize(&mut self, chain: &Vec<f64>, system: &mut BandedNormalEquations) {
        let kernel = RobustKernel::Cauchy { scale: 1.0 };
        system.add_robust_at(&[0], &Vector1::new(chain[0] - 5.0), &Vector1::new(1.0), 1.0, kernel);
        for (i, pair) in chain.windows(2).enumerate() {
            let jacobian = RowVector2::new(-2.0 * pair[0], 2.0 * pair[1]);
            system.add_at(&[i, i + 1], &Vector1::new(pair[1].powi(2) - pair[0].powi(2) - 1.0), &jacobian, 1.0);
        }
    }

    fn cost(&mut self, chain: &Vec<f64>) -> f64 {
        let links: f64 = chain.windows(2).map(|p| (p[1].powi(2) - p[0].powi(2) - 1.0).powi(2)).sum();
        0.5 * (RobustKernel::Cauchy { scale: 1.0 }.loss((chain[0] - 5.0).powi(2)) + links)
    }

    fn retract_into(&self, chain: &Vec<f64>, step: &[f64], trial: &mut Vec<f64>) {
        trial.clone_from(chain);
        trial.iter_mut().zip(step).for_each(|(x, step)| *x += step);
    }
}

#[test]
fn structured_levenberg_marquardt() {
    let solver = LevenbergMarquardt::new(LevenbergMarquardtParams::default()).unwrap();
    let mut workspace = LeastSquaresWorkspace::new(BandedNormalEquations::new(40, 1), vec![0.0; 40]);
    let mut chain = vec![1.0; 40];
    let mut run = |shift: f64| {
        workspace.system.reset(40, 1);
        chain.fill(4.0 + shift);
        let found = solver.minimize_structured(&mut Chain, &mut chain, &mut workspace).unwrap();
        assert!(found.termination.converged() && found.iterations > 2 && (chain[39] - 8.0).abs() < 1e-6);
    };
    run(0.0);
    assert_eq!(counter::count(|| (1..5).for_each(|k| run(0.1 * f64::from(k)))), 0);
}
