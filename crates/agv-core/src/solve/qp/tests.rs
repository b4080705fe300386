//! Optimality by the conditions of Karush, Kuhn and Tucker, and against every active set there is.

#![expect(clippy::disallowed_types, reason = "the dense reference")]

use super::*;
use crate::compute::Seed;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use rand_distr::{Distribution, StandardNormal};

const FREE: f64 = f64::INFINITY;

/// A programme with memory of its own.
#[derive(Debug, Clone)]
struct Programme {
    n: usize,
    hessian: Vec<f64>,
    rows: Vec<f64>,
    gradient: Vec<f64>,
    /// Unknowns first, then rows.
    limits: Vec<(f64, f64)>,
}

impl Programme {
    /// Unlimited, with `H = ½ G Gᵀ + weight I` of a random `G`.
    fn random(seed: u64, n: usize, m: usize, weight: f64) -> Self {
        let mut stream = Seed(seed).stream(0, 0);
        let mut draw = || -> f64 { StandardNormal.sample(&mut stream) };
        let root = DMatrix::from_fn(n, n, |_, _| draw());
        let hessian = &root * root.transpose() * 0.5 + DMatrix::identity(n, n) * weight;
        let rows = (0..n * m).map(|_| draw()).collect();
        let gradient = (0..n).map(|_| 3.0 * draw()).collect();
        Self { n, hessian: hessian.as_slice().to_vec(), rows, gradient, limits: vec![(-FREE, FREE); n + m] }
    }

    /// With random limits around a point, which keeps them all; some are absent and some are equations.
    fn around(mut self, seed: u64, equations: usize) -> Self {
        let mut stream = Seed(seed).stream(1, 0);
        let mut draw = || -> f64 { StandardNormal.sample(&mut stream) };
        let point: Vec<f64> = (0..self.n).map(|_| draw()).collect();
        let (n, count) = (self.n, self.limits.len());
        for index in 0..count {
            let value = DVector::from_vec(self.normal(index)).dot(&DVector::from_column_slice(&point));
            let mut side = |sign: f64| if draw() > -0.5 { value + sign * draw().abs() * 0.5 } else { sign * FREE };
            self.limits[index] =
                if index >= n && index < n + equations.min(n / 2) { (value, value) } else { (side(-1.0), side(1.0)) };
        }
        self
    }

    fn normal(&self, index: usize) -> Vec<f64> {
        match index.checked_sub(self.n) {
            None => (0..self.n).map(|j| f64::from(u8::from(j == index))).collect(),
            Some(row) => self.rows[row * self.n..][..self.n].to_vec(),
        }
    }

    fn solver(&self) -> QuadraticSolver {
        let rows = self.limits.len() - self.n;
        let mut solver = QuadraticSolver::new(self.n, rows, QuadraticParams::default()).unwrap();
        solver.set_matrices(&self.hessian, &self.rows).unwrap();
        solver
    }

    fn solve(&self, solver: &mut QuadraticSolver) -> QuadraticOutcome {
        let (lower, upper): (Vec<f64>, Vec<f64>) = self.limits.iter().copied().unzip();
        solver
            .solve(&QuadraticVectors {
                gradient: &self.gradient,
                lower: &lower[..self.n],
                upper: &upper[..self.n],
                row_lower: &lower[self.n..],
                row_upper: &upper[self.n..],
            })
            .unwrap()
    }

    /// `H x + g`.
    fn slope(&self, x: &DVector<f64>) -> DVector<f64> {
        DMatrix::from_column_slice(self.n, self.n, &self.hessian) * x + DVector::from_column_slice(&self.gradient)
    }

    /// Greatest violation of an optimality condition by a solver's answer.
    fn kkt_error(&self, solver: &QuadraticSolver) -> f64 {
        let x = DVector::from_column_slice(solver.solution());
        let mut slope = self.slope(&x);
        let mut error = 0.0_f64;
        let multipliers = solver.multipliers().iter().chain(solver.row_multipliers());
        for (index, (&multiplier, &(lower, upper))) in multipliers.zip(&self.limits).enumerate() {
            let normal = DVector::from_vec(self.normal(index));
            let value = normal.dot(&x);
            slope -= normal * multiplier;
            error = error.max(lower - value).max(value - upper);
            // Multipliers push away from the limit that they belong to, and only when it is met.
            let slack = if multiplier > 0.0 { value - lower } else { upper - value };
            error = error.max(if multiplier == 0.0 { 0.0 } else { slack.abs() });
        }
        error.max(slope.amax())
    }

    /// The minimum by trying every set of limits as the active one; none if there is no feasible point.
    fn enumerated(&self) -> Option<DVector<f64>> {
        let count = self.limits.len();
        let hessian = DMatrix::from_column_slice(self.n, self.n, &self.hessian);
        (0..3_usize.pow(count as u32)).find_map(|code| {
            let side = |index: usize| code / 3_usize.pow(index as u32) % 3;
            let active: Vec<usize> = (0..count).filter(|&index| side(index) != 0).collect();
            let bound = |index: usize| if side(index) == 1 { self.limits[index].0 } else { self.limits[index].1 };
            if active.len() > self.n || active.iter().any(|&index| !bound(index).is_finite()) {
                return None;
            }
            let size = self.n + active.len();
            let (mut system, mut rhs) = (DMatrix::zeros(size, size), DVector::zeros(size));
            system.view_mut((0, 0), (self.n, self.n)).copy_from(&hessian);
            rhs.rows_mut(0, self.n).copy_from(&-DVector::from_column_slice(&self.gradient));
            for (k, &index) in active.iter().enumerate() {
                for (j, v) in self.normal(index).into_iter().enumerate() {
                    system[(self.n + k, j)] = v;
                    system[(j, self.n + k)] = -v;
                }
                rhs[self.n + k] = bound(index);
            }
            let solution = system.full_piv_lu().solve(&rhs)?;
            let x = solution.rows(0, self.n).into_owned();
            let signs = active.iter().enumerate().all(|(k, &index)| {
                let multiplier = solution[self.n + k];
                let equation = self.limits[index].0 == self.limits[index].1;
                equation || if side(index) == 1 { multiplier >= -1e-9 } else { multiplier <= 1e-9 }
            });
            let kept = (0..count).all(|index| {
                let value = DVector::from_vec(self.normal(index)).dot(&x);
                value >= self.limits[index].0 - 1e-8 && value <= self.limits[index].1 + 1e-8
            });
            (signs && kept).then_some(x)
        })
    }
}

proptest! {
    #[test]
    fn answers_meet_the_conditions_of_optimality(
        seed in any::<u64>(), n in 1..40_usize, m in 0..80_usize, equations in 0..4_usize, weight in 1e-3..1.0_f64,
    ) {
        let programme = Programme::random(seed, n, m, weight).around(seed, equations.min(m));
        let mut solver = programme.solver();
        let outcome = programme.solve(&mut solver);
        prop_assert!(outcome.solved(), "{outcome:?}");
        let size = 1.0 + solver.multipliers().iter().chain(solver.row_multipliers()).fold(0.0, |a: f64, v| a.max(v.abs()));
        prop_assert!(programme.kkt_error(&solver) < 1e-7 * size, "{} of {size}", programme.kkt_error(&solver));
        let x = DVector::from_column_slice(solver.solution());
        let cost = 0.5 * (programme.slope(&x) + DVector::from_column_slice(&programme.gradient)).dot(&x);
        prop_assert!((outcome.cost - cost).abs() < 1e-9 * (1.0 + cost.abs()));
        // From its own working set it is there at once.
        let cold = solver.solution().to_vec();
        let again = programme.solve(&mut solver);
        prop_assert_eq!(again.iterations, 0);
        prop_assert!(solver.solution().iter().zip(&cold).all(|(a, b)| (a - b).abs() < 1e-8 * size));
    }

    /// Random limits, which contradict each other in a part of the cases: the verdict is that of the enumeration.
    #[test]
    fn every_active_set_was_worth_a_try(seed in any::<u64>(), n in 1..4_usize, m in 0..4_usize, shift in -1.5..0.5_f64) {
        let mut programme = Programme::random(seed, n, m, 0.1).around(seed, 1.min(m));
        // The same row twice, with limits that may exclude each other.
        if m > 1 {
            let first = programme.normal(n);
            programme.rows[n..2 * n].copy_from_slice(&first);
            let lower = programme.limits[n].0;
            programme.limits[n + 1] = (-FREE, if lower.is_finite() { lower + shift } else { shift });
        }
        let mut solver = programme.solver();
        let outcome = programme.solve(&mut solver);
        match programme.enumerated() {
            Some(x) => {
                prop_assert!(outcome.solved(), "{outcome:?}, {x}");
                prop_assert!((DVector::from_column_slice(solver.solution()) - &x).amax() < 1e-6, "{programme:?} {x}");
            }
            None => prop_assert!(matches!(outcome.status, QuadraticStatus::Infeasible { .. }), "{outcome:?}"),
        }
    }

    /// Any working set is a start, also one that has nothing to do with the programme.
    #[test]
    fn a_wrong_start_costs_time_only(seed in any::<u64>(), n in 1..12_usize, m in 0..20_usize) {
        let programme = Programme::random(seed, n, m, 0.1).around(seed, 2.min(m));
        let mut solver = programme.solver();
        prop_assert!(programme.solve(&mut solver).solved());
        let expected = solver.solution().to_vec();
        let mut stream = Seed(seed).stream(2, 0);
        let start: Vec<Bound> = (0..n + m)
            .map(|_| StandardNormal.sample(&mut stream))
            .map(|draw: f64| if draw > 0.5 { Bound::Lower } else if draw < -0.5 { Bound::Upper } else { Bound::Free })
            .collect();
        solver.warm_start(&start).unwrap();
        prop_assert!(programme.solve(&mut solver).solved());
        prop_assert!(solver.solution().iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}

/// A vehicle's offset and heading along a line, condensed: `n` steps of a bounded yaw rate from an offset.
fn steering(n: usize, offset: f64, heading: f64) -> Programme {
    let (dt, speed) = (0.1, 1.0);
    let mut rows = vec![0.0; n * n];
    let mut constant = vec![0.0; n];
    for k in 0..n {
        // Offset after k + 1 steps: each rate turns the vehicle for the rest of the time.
        constant[k] = offset + heading * speed * dt * (k + 1) as f64;
        for j in 0..=k {
            rows[k * n + j] = speed * dt * dt * ((k - j) as f64 + 0.5);
        }
    }
    let prediction = DMatrix::from_row_slice(n, n, &rows);
    let hessian = prediction.transpose() * &prediction + DMatrix::identity(n, n) * 1e-4;
    let gradient = prediction.transpose() * DVector::from_column_slice(&constant);
    let mut limits = vec![(-1.0, 1.0); n];
    // The offset must not overshoot to the other side.
    limits.extend(constant.iter().map(|c| (-0.002 - c, FREE)));
    Programme { n, hessian: hessian.as_slice().to_vec(), rows, gradient: gradient.as_slice().to_vec(), limits }
}

/// Runs the controller for some cycles; returns the iterations of all cycles but the first.
fn drive(mut before: impl FnMut(&mut QuadraticSolver)) -> usize {
    let mut solver = steering(30, 0.4, 0.0).solver();
    let (mut offset, mut heading, mut iterations) = (0.4, 0.0, 0);
    for cycle in 0..60 {
        let programme = steering(30, offset, heading);
        solver.set_matrices(&programme.hessian, &programme.rows).unwrap();
        before(&mut solver);
        let outcome = programme.solve(&mut solver);
        assert!(outcome.solved(), "cycle {cycle}: {outcome:?}");
        assert!(programme.kkt_error(&solver) < 1e-9, "{}", programme.kkt_error(&solver));
        iterations += if cycle > 0 { outcome.iterations } else { 0 };
        let rate = solver.solution()[0];
        offset += 0.1 * heading + 0.005 * rate;
        heading += 0.1 * rate;
    }
    assert!(offset.abs() < 0.01, "{offset}");
    iterations
}

#[test]
fn a_controller_s_next_cycle_starts_from_its_last() {
    let cold = drive(QuadraticSolver::cold_start);
    let warm = drive(|_| {});
    // What binds in the second stage binds in the first one cycle later.
    let shifted = drive(|solver| {
        let mut set = [Bound::Free; 60];
        set.copy_from_slice(solver.working_set());
        for half in set.chunks_exact_mut(30) {
            half.copy_within(1.., 0);
        }
        solver.warm_start(&set).unwrap();
    });
    assert!(warm < cold && 3 * shifted < cold, "cold {cold}, warm {warm}, shifted {shifted}");
}

#[test]
fn limits_that_say_the_same_do_no_harm() {
    // The corner (1, 1) of six lines, twice each, some as equations.
    let mut programme = Programme::random(1, 2, 12, 0.1);
    programme.hessian = vec![1.0, 0.0, 0.0, 1.0];
    programme.gradient = vec![-3.0, -3.0];
    for (row, (a, b)) in
        [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (2.0, 1.0), (1.0, 2.0), (1.0, 1e-7)].into_iter().enumerate()
    {
        for copy in [row, row + 6] {
            programme.rows[2 * copy..][..2].copy_from_slice(&[a, b]);
            programme.limits[2 + copy] = (-FREE, a + b);
        }
    }
    programme.limits[0] = (-FREE, 1.0);
    for equation in [None, Some(4), Some(10)] {
        let mut programme = programme.clone();
        if let Some(index) = equation {
            programme.limits[index].0 = programme.limits[index].1;
        }
        let mut solver = programme.solver();
        let outcome = programme.solve(&mut solver);
        assert!(outcome.solved() && outcome.iterations < 20, "{outcome:?}");
        assert!(solver.solution().iter().all(|x| (x - 1.0).abs() < 1e-9), "{:?}", solver.solution());
        assert!(programme.kkt_error(&solver) < 1e-9);
    }
    // The same equation twice, and then with another right-hand side.
    programme.limits[4] = (2.0, 2.0);
    programme.limits[10] = (2.0, 2.0);
    let mut solver = programme.solver();
    assert!(programme.solve(&mut solver).solved());
    programme.limits[10] = (1.5, 1.5);
    let outcome = programme.solve(&mut solver);
    assert!(
        matches!(outcome.status, QuadraticStatus::Infeasible { constraint: Constraint::Row(8 | 2) }),
        "{outcome:?}"
    );
}

#[test]
fn costs_without_curvature_are_solved_too() {
    // A linear programme: least 2x + y with x + y ≥ 1, x - y ≤ 0.2, x ≥ 0.1, y ≤ 5; the corner (0.1, 0.9).
    let programme = Programme {
        n: 2,
        hessian: vec![0.0; 4],
        rows: vec![1.0, 1.0, 1.0, -1.0],
        gradient: vec![2.0, 1.0],
        limits: vec![(0.1, FREE), (-FREE, 5.0), (1.0, FREE), (-FREE, 0.2)],
    };
    let mut solver = programme.solver();
    let outcome = programme.solve(&mut solver);
    assert!(outcome.solved() && outcome.dual_residual < 1e-8, "{outcome:?}");
    assert!((solver.solution()[0] - 0.1).abs() < 1e-9 && (solver.solution()[1] - 0.9).abs() < 1e-9);
    // Curvature along one of two directions.
    let flat = Programme { hessian: vec![1.0, -1.0, -1.0, 1.0], gradient: vec![0.0, 1.0], ..programme.clone() };
    let mut solver = flat.solver();
    assert!(flat.solve(&mut solver).solved());
    assert!(flat.kkt_error(&solver) < 1e-8, "{}", flat.kkt_error(&solver));
    // No least value at all: an outcome, not a loop.
    let endless = Programme { limits: vec![(-FREE, FREE); 4], ..programme };
    assert_eq!(endless.solve(&mut endless.solver()).status, QuadraticStatus::IterationLimit);
}

#[test]
fn the_iteration_limit_is_an_outcome() {
    let programme = steering(20, 0.4, 0.3);
    let params = QuadraticParams { max_iterations: 3, ..QuadraticParams::default() };
    let mut solver = QuadraticSolver::new(20, 20, params).unwrap();
    solver.set_matrices(&programme.hessian, &programme.rows).unwrap();
    let outcome = programme.solve(&mut solver);
    assert_eq!((outcome.status, outcome.iterations), (QuadraticStatus::IterationLimit, 3));
    assert!(outcome.primal_residual > 1e-3 && outcome.cost.is_finite());
    // It goes on from there.
    let calls = (1..100).find(|_| programme.solve(&mut solver).solved());
    assert!(calls.is_some_and(|calls| calls > 1));
    assert!(programme.kkt_error(&solver) < 1e-9);
}

#[test]
fn bad_input_is_named() {
    let params = QuadraticParams::default();
    assert!(matches!(QuadraticSolver::new(0, 3, params), Err(Error::TooFew { .. })));
    for value in [0.0, -1.0, f64::NAN] {
        let bad = QuadraticParams { feasibility_tolerance: value, ..params };
        assert!(matches!(QuadraticSolver::new(1, 0, bad), Err(Error::NotPositive { .. })));
        let bad = QuadraticParams { stationarity_tolerance: value, ..params };
        assert!(matches!(QuadraticSolver::new(1, 0, bad), Err(Error::NotPositive { .. })));
    }
    let mut solver = QuadraticSolver::new(2, 1, params).unwrap();
    let good = QuadraticVectors {
        gradient: &[1.0, 1.0],
        lower: &[0.0; 2],
        upper: &[1.0; 2],
        row_lower: &[-FREE],
        row_upper: &[FREE],
    };
    assert_eq!(solver.solve(&good), Err(Error::Empty { name: "matrices" }));
    let (unit, row) = ([1.0, 0.0, 0.0, 1.0], [1.0, 1.0]);
    assert!(matches!(solver.set_matrices(&unit[1..], &row), Err(Error::LengthMismatch { .. })));
    assert!(matches!(solver.set_matrices(&unit, &row[1..]), Err(Error::LengthMismatch { .. })));
    assert!(matches!(solver.set_matrices(&[f64::NAN; 4], &row), Err(Error::NotFinite { .. })));
    assert!(matches!(solver.set_matrices(&unit, &[f64::INFINITY; 2]), Err(Error::NotFinite { .. })));
    for hollow in [[1.0, 2.0, 2.0, 1.0], [1.0, 0.0, 0.0, -1e-3], [0.0, 1.0, 1.0, 0.0], [-1.0, 0.0, 0.0, -1.0]] {
        assert!(matches!(solver.set_matrices(&hollow, &row), Err(Error::Singular { .. })), "{hollow:?}");
    }
    assert!(solver.solve(&good).is_err(), "no matrices are left behind");
    solver.set_matrices(&unit, &row).unwrap();
    assert!(solver.solve(&good).unwrap().solved());
    let nan = [f64::NAN; 2];
    for (bad, what) in [
        (QuadraticVectors { gradient: &nan, ..good }, "gradient"),
        (QuadraticVectors { gradient: &[0.0], ..good }, "short gradient"),
        (QuadraticVectors { lower: &nan, ..good }, "lower"),
        (QuadraticVectors { upper: &nan, ..good }, "upper"),
        (QuadraticVectors { lower: &[2.0; 2], ..good }, "reversed"),
        (QuadraticVectors { lower: &[FREE; 2], upper: &[FREE; 2], ..good }, "infinite equation"),
        (QuadraticVectors { row_lower: &[], ..good }, "short rows"),
        (QuadraticVectors { row_upper: &[f64::NAN], ..good }, "row"),
        (QuadraticVectors { row_upper: &[-FREE], ..good }, "wrong infinity"),
    ] {
        assert!(solver.solve(&bad).is_err(), "{what}");
        assert_eq!(solver.solution(), [0.0; 2], "{what}");
    }
    assert!(matches!(solver.warm_start(&[Bound::Free]), Err(Error::LengthMismatch { .. })));
}
