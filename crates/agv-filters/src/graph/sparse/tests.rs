//! Against full matrices.
#![expect(clippy::disallowed_types, reason = "the dense reference")]

use super::*;
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, Vector3};

/// Some numbers, all different.
fn wave<const R: usize, const C: usize>(k: usize) -> SMatrix<f64, R, C> {
    SMatrix::from_fn(|r, c| (1.3 * r as f64 + 2.1 * c as f64 + k as f64).sin())
}

const PAIRS: [(u32, u32); 4] = [(0, 1), (3, 1), (2, 3), (3, 1)];

fn empty() -> SparseNormalEquations {
    let mut system = SparseNormalEquations::default();
    system.reset(Layout::uniform(3, 4), PAIRS).unwrap();
    system
}

/// The sums that are to come out, on full matrices.
struct Full(DMatrix<f64>, DVector<f64>);

impl Full {
    /// Adds a residual of two blocks, each with its Jacobian.
    fn add(&mut self, blocks: [u32; 2], jacobians: [&Matrix3<f64>; 2], residual: &Vector3<f64>, weight: f64) {
        let mut spread = DMatrix::zeros(3, 12);
        for (block, jacobian) in blocks.iter().zip(jacobians) {
            spread.fixed_view_mut::<3, 3>(0, 3 * *block as usize).copy_from(jacobian);
        }
        self.0 += spread.transpose() * &spread * weight;
        self.1 += spread.transpose() * residual * weight;
    }

    fn agrees(&self, system: &mut SparseNormalEquations) {
        assert!(system.check().is_ok());
        assert!((DVector::from_column_slice(system.gradient()) - &self.1).norm() < 1e-12);
        assert!((0..12).all(|i| (system.diagonal(i) - self.0[(i, i)]).abs() < 1e-12));
        // Off the diagonal by what is solved from it, damped and plain.
        let (scale, mut step) = ([2.0; 12], [0.0; 12]);
        assert!(system.solve_damped(0.5, &scale, &mut step));
        let damped = &self.0 + DMatrix::identity(12, 12);
        assert!((damped * DVector::from_column_slice(&step) + &self.1).norm() < 1e-12);
        let mut solved = self.1.as_slice().to_vec();
        assert!(system.factorize() && system.substitute(&mut solved));
        assert!((&self.0 * DVector::from_vec(solved) - &self.1).norm() < 1e-9);
    }
}

/// Blocks that are said of the upper half, of the lower and of the diagonal, in any order.
#[test]
fn blocks_are_those_of_full_matrices_whichever_way_they_are_said() {
    for turned in [false, true] {
        let mut system = empty();
        let mut full = Full(DMatrix::zeros(12, 12), DVector::zeros(12));
        for (k, pair) in PAIRS.into_iter().chain([(1, 0), (3, 2)]).enumerate() {
            let [a, b] = if turned { [pair.1, pair.0] } else { [pair.0, pair.1] };
            let (first, second): (Matrix3<f64>, Matrix3<f64>) = (wave(k), wave(k + 9) + Matrix3::identity());
            let residual: Vector3<f64> = wave(k + 20);
            full.add([a, b], [&first, &second], &residual, 1.0);
            system.add_block(a, a, (first.transpose() * first).as_slice());
            system.add_block(b, b, (second.transpose() * second).as_slice());
            system.add_block(a, b, (first.transpose() * second).as_slice());
            system.add_gradient(a, (first.transpose() * residual).as_slice());
            system.add_gradient(b, (second.transpose() * residual).as_slice());
        }
        full.agrees(&mut system);
    }
}

#[test]
fn residuals_by_unknown_add_up_to_the_same() {
    let mut system = empty();
    let mut full = Full(DMatrix::zeros(12, 12), DVector::zeros(12));
    for (k, (a, b)) in PAIRS.into_iter().chain([(1, 0), (3, 2)]).enumerate() {
        let (first, second): (Matrix3<f64>, Matrix3<f64>) = (wave(k), wave(k + 9) + Matrix3::identity());
        let residual: Vector3<f64> = wave(k + 20);
        full.add([a, b], [&first, &second], &residual, 0.7);
        let both = SMatrix::<f64, 3, 6>::from_fn(|r, c| if c < 3 { first[(r, c)] } else { second[(r, c - 3)] });
        let (a, b) = (3 * a as usize, 3 * b as usize);
        system.accumulate(&[a, a + 1, a + 2, b, b + 1, b + 2], &residual, &both, 0.7);
        // What is given adds nothing.
        system.accumulate(&[FIXED; 6], &residual, &both, 0.7);
    }
    full.agrees(&mut system);
}

#[test]
fn what_has_no_place_is_a_fault() {
    let mut system = empty();
    assert!(system.reset(Layout::uniform(3, 4), [(0, 4)]).is_err() && system.reset(Layout::uniform(0, 4), []).is_err());
    let unit = Matrix3::<f64>::identity();
    system = empty();
    system.add_block(0, 2, unit.as_slice());
    assert!(matches!(system.check(), Err(Error::OutOfRange { .. })));
    system.clear();
    system.accumulate(&[0, 6], &Vector3::x(), &SMatrix::<f64, 3, 2>::repeat(1.0), 1.0);
    assert!(matches!(system.check(), Err(Error::OutOfRange { .. })));
    system.clear();
    system.accumulate(&[12], &Vector3::x(), &Vector3::x(), 1.0);
    assert!(system.check().is_err() && !system.substitute(&mut [0.0; 11]));
    system.clear();
    system.add_block(0, 0, (unit * f64::NAN).as_slice());
    assert!(matches!(system.check(), Err(Error::NotFinite { .. })));
    system.clear();
    assert!(system.check().is_ok() && !system.factorize(), "empty sums determine nothing");
}

/// Two poses and two points: every way in which blocks of two sizes meet.
#[test]
fn blocks_of_two_sizes_are_those_of_full_matrices() {
    let layout = Layout { size: 3, large: 2, small_size: 2, small: 2 };
    let mut system = SparseNormalEquations::default();
    system.reset(layout, [(0, 1), (0, 2), (1, 2), (1, 3)]).unwrap();
    let (mut full, mut slope) = (DMatrix::<f64>::identity(10, 10) * 0.0, DVector::<f64>::zeros(10));
    for (k, (pose, point)) in [(0, 2), (1, 2), (1, 3)].into_iter().enumerate() {
        let (by_pose, by_point): (SMatrix<f64, 2, 3>, SMatrix<f64, 2, 2>) = (wave(k), wave(k + 5));
        let residual: SMatrix<f64, 2, 1> = wave(k + 9);
        system.add_block(pose, pose, (by_pose.transpose() * by_pose + Matrix3::identity()).as_slice());
        system.add_block(point, point, (by_point.transpose() * by_point).as_slice());
        if k == 1 {
            system.add_block(pose, point, (by_pose.transpose() * by_point).as_slice());
        } else {
            system.add_block(point, pose, (by_point.transpose() * by_pose).as_slice());
        }
        system.add_gradient(pose, (by_pose.transpose() * residual).as_slice());
        system.add_gradient(point, (by_point.transpose() * residual).as_slice());
        let (at_pose, at_point) = (layout.first_of(pose as usize), layout.first_of(point as usize));
        let mut spread = DMatrix::zeros(2, 10);
        spread.view_mut((0, at_pose), (2, 3)).copy_from(&by_pose);
        spread.view_mut((0, at_point), (2, 2)).copy_from(&by_point);
        full += spread.transpose() * &spread;
        slope += spread.transpose() * residual;
        for i in 0..3 {
            full[(at_pose + i, at_pose + i)] += 1.0;
        }
    }
    // Single unknowns: of a pose with one of the other, of a pose with a point, and of the points.
    for (k, unknowns) in [[1, 5], [4, 9], [6, 7], [8, 8]].into_iter().enumerate() {
        let pair = if unknowns[0] == unknowns[1] { [unknowns[0], FIXED] } else { unknowns };
        let (jacobian, residual): (SMatrix<f64, 1, 2>, SMatrix<f64, 1, 1>) = (wave(k + 20), wave(k + 30));
        system.accumulate(&pair, &residual, &jacobian, 2.0);
        let mut spread = DMatrix::zeros(1, 10);
        for (i, &unknown) in pair.iter().enumerate().filter(|(_, unknown)| **unknown != FIXED) {
            spread[(0, unknown)] = jacobian[i];
        }
        full += spread.transpose() * &spread * 2.0;
        slope += spread.transpose() * residual * 2.0;
    }
    assert!(system.check().is_ok());
    assert!((DVector::from_column_slice(system.gradient()) - &slope).norm() < 1e-12);
    assert!((0..10).all(|i| (system.diagonal(i) - full[(i, i)]).abs() < 1e-12));
    let mut solved = slope.as_slice().to_vec();
    assert!(system.factorize() && system.substitute(&mut solved));
    assert!((full * DVector::from_vec(solved) - slope).norm() < 1e-9);
}
