//! The correction by a measurement of up to four numbers.
//!
//! ```text
//! S = H P Hᵀ + R        K = P Hᵀ S⁻¹        NIS = νᵀ S⁻¹ ν
//! A = (I - K H) P       P ← A (I - K H)ᵀ + K R Kᵀ = A - (A Hᵀ - K R) Kᵀ
//! ```
//!
//! which is Joseph's form, written as two updates of low rank: what the second one subtracts would vanish if the numbers did not
//! round, and takes back what the first one lost by it. Rows of `H` have few entries, and zeros are passed over, as are anchors that are
//! not there. A pose that was
//! turned by a correction has its errors turned back by it, since they are along its axes.

use super::state::{Covariance, DIMENSION, POSE, Row, State, anchor_at};

/// Most numbers of a measurement.
pub(super) const MOST_ROWS: usize = 4;

/// A measurement, compared with what the state predicts of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Innovation {
    rows: usize,
    residual: [f64; MOST_ROWS],
    jacobian: [Row; MOST_ROWS],
    noise: [[f64; MOST_ROWS]; MOST_ROWS],
}

impl Innovation {
    pub(super) const fn empty() -> Self {
        let zeros = [0.0; MOST_ROWS];
        Self { rows: 0, residual: zeros, jacobian: [[0.0; DIMENSION]; MOST_ROWS], noise: [zeros; MOST_ROWS] }
    }

    /// Adds a number: what was measured less what is predicted, how the prediction moves with the errors, and the covariances of
    /// its noise with that of the numbers before it, its own variance last.
    pub(super) fn push(&mut self, residual: f64, jacobian: Row, noise: &[f64]) {
        let row = self.rows;
        (self.residual[row], self.jacobian[row]) = (residual, jacobian);
        for (other, covariance) in noise.iter().enumerate().take(row + 1) {
            self.noise[row][other] = *covariance;
            self.noise[other][row] = *covariance;
        }
        self.rows += 1;
    }

    /// Numbers that it has.
    pub(super) const fn rows(&self) -> usize {
        self.rows
    }

    #[cfg(test)]
    pub(super) fn parts(&self) -> (&[f64], &[Row]) {
        (&self.residual[..self.rows], &self.jacobian[..self.rows])
    }
}

/// What the gate needs, and the correction that follows if it lets it pass.
#[derive(Debug)]
pub(super) struct Weighed {
    innovation: Innovation,
    /// `H P`.
    projected: [Row; MOST_ROWS],
    /// Lower root of `S`.
    root: [[f64; MOST_ROWS]; MOST_ROWS],
    /// Normalised innovation squared.
    pub(super) nis: f64,
}

/// Weighs an innovation; none if its covariance is not positive definite, as rounding may make it.
pub(super) fn weigh(state: &State, innovation: &Innovation) -> Option<Weighed> {
    let (rows, used) = (innovation.rows, state.used());
    let mut projected = [[0.0; DIMENSION]; MOST_ROWS];
    let mut spread = innovation.noise;
    for (projection, jacobian) in projected.iter_mut().zip(&innovation.jacobian).take(rows) {
        *projection = times(&state.covariance, jacobian, used);
    }
    for (row, projection) in spread.iter_mut().zip(&projected).take(rows) {
        for (entry, jacobian) in row.iter_mut().zip(&innovation.jacobian).take(rows) {
            *entry += dot(projection, jacobian);
        }
    }
    let mut root = [[0.0; MOST_ROWS]; MOST_ROWS];
    for i in 0..rows {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| root[i][k] * root[j][k]).sum();
            let rest = spread[i][j] - known;
            if i == j {
                if !(rest > 0.0 && rest.is_finite()) {
                    return None;
                }
                root[i][i] = rest.sqrt();
            } else {
                root[i][j] = rest / root[j][j];
            }
        }
    }
    let mut nis = 0.0;
    let mut whitened = [0.0; MOST_ROWS];
    for i in 0..rows {
        let known: f64 = (0..i).map(|k| root[i][k] * whitened[k]).sum();
        whitened[i] = (innovation.residual[i] - known) / root[i][i];
        nis += whitened[i] * whitened[i];
    }
    nis.is_finite().then_some(Weighed { innovation: *innovation, projected, root, nis })
}

/// Corrects the state.
pub(super) fn apply(state: &mut State, weighed: &Weighed) {
    let Weighed { innovation, projected, root, .. } = weighed;
    let (rows, used) = (innovation.rows, state.used());
    // Kᵀ = S⁻¹ H P: forwards and backwards through the root.
    let mut gain = *projected;
    for i in 0..rows {
        for k in 0..i {
            let known = gain[k];
            add(&mut gain[i], &known, -root[i][k], used);
        }
        gain[i].iter_mut().for_each(|entry| *entry /= root[i][i]);
    }
    for i in (0..rows).rev() {
        for k in i + 1..rows {
            let known = gain[k];
            add(&mut gain[i], &known, -root[k][i], used);
        }
        gain[i].iter_mut().for_each(|entry| *entry /= root[i][i]);
    }

    let mut correction = [0.0; DIMENSION];
    for (weights, residual) in gain.iter().zip(&innovation.residual).take(rows) {
        add(&mut correction, weights, *residual, used);
    }

    let covariance = &mut state.covariance;
    for (projection, weights) in projected.iter().zip(&gain).take(rows) {
        for (column, weight) in covariance.iter_mut().zip(projection).take(used) {
            add(column, weights, -weight, used);
        }
    }
    // A Hᵀ - K R, which only rounding leaves.
    let mut rests = [[0.0; DIMENSION]; MOST_ROWS];
    for (rest, (jacobian, noise)) in rests.iter_mut().zip(innovation.jacobian.iter().zip(&innovation.noise)).take(rows)
    {
        *rest = times(covariance, jacobian, used);
        for (weights, variance) in gain.iter().zip(noise).take(rows) {
            add(rest, weights, -variance, used);
        }
    }
    for (rest, weights) in rests.iter().zip(&gain).take(rows) {
        for (column, weight) in covariance.iter_mut().zip(weights).take(used) {
            add(column, rest, -weight, used);
        }
    }
    symmetrize(covariance, used);

    state.shift(&correction);
    let covariance = &mut state.covariance;
    turn_back(covariance, POSE, correction[POSE + 2]);
    for (slot, _) in state.anchors.iter().enumerate().filter(|(_, anchor)| anchor.is_some()) {
        let at = anchor_at(slot);
        turn_back(covariance, at, correction[at + 2]);
    }
}

fn dot(a: &Row, b: &Row) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `P hᵀ`, for a row of few entries, over the first `used` errors.
#[inline]
fn times(covariance: &Covariance, jacobian: &Row, used: usize) -> Row {
    let mut product = [0.0; DIMENSION];
    for (column, weight) in covariance.iter().zip(jacobian).take(used) {
        if *weight != 0.0 {
            add(&mut product, column, *weight, used);
        }
    }
    product
}

#[inline]
fn add(target: &mut Row, source: &Row, weight: f64, used: usize) {
    for (entry, value) in target.iter_mut().zip(source).take(used) {
        *entry += weight * value;
    }
}

/// Takes the mean of each pair of mirrored entries.
fn symmetrize(covariance: &mut Covariance, used: usize) {
    for (i, j) in (1..used).flat_map(|i| (0..i).map(move |j| (i, j))) {
        let mean = 0.5 * (covariance[i][j] + covariance[j][i]);
        covariance[i][j] = mean;
        covariance[j][i] = mean;
    }
}

/// Turns the axes of two errors that lie in the plane.
fn turn_back(covariance: &mut Covariance, at: usize, angle: f64) {
    let (sin, cos) = angle.sin_cos();
    let (x, y) = (covariance[at], covariance[at + 1]);
    for i in 0..DIMENSION {
        covariance[at][i] = cos * x[i] + sin * y[i];
        covariance[at + 1][i] = cos * y[i] - sin * x[i];
    }
    for column in covariance.iter_mut() {
        let (x, y) = (column[at], column[at + 1]);
        column[at] = cos * x + sin * y;
        column[at + 1] = cos * y - sin * x;
    }
    // Both turns round the corner alike, but for its two mirrored entries.
    let mean = 0.5 * (covariance[at][at + 1] + covariance[at + 1][at]);
    (covariance[at][at + 1], covariance[at + 1][at]) = (mean, mean);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::state::{ANCHORS, MAX_ANCHORS};
    use agv_core::{compute::Seed, geometry::Se2, time::Stamp};
    use nalgebra::{Matrix3, SMatrix};
    use rand_distr::{Distribution, StandardNormal};

    /// The dense form of the textbook, with an inverse, but for the reset, of which the correction is small enough.
    #[test]
    fn it_is_josephs_form() {
        let mut stream = Seed(3).stream(0, 0);
        let mut draw = || -> f64 { StandardNormal.sample(&mut stream) };
        let root = SMatrix::<f64, DIMENSION, DIMENSION>::from_fn(|_, _| draw());
        let (p, h) = (root * root.transpose(), SMatrix::<f64, 3, DIMENSION>::from_fn(|_, _| draw()));
        let noise_root = SMatrix::<f64, 3, 3>::from_fn(|_, _| draw());
        let r = noise_root * noise_root.transpose() + SMatrix::identity();
        let residual = SMatrix::<f64, 3, 1>::from_fn(|_, _| 1e-7 * draw());

        let pose = Matrix3::identity();
        let mut state = State::new(Stamp::default(), Se2::default(), &pose, &[0.0; ANCHORS]);
        (0..MAX_ANCHORS).for_each(|slot| state.drop_anchor(slot, Se2::default(), &pose));
        for column in 0..DIMENSION {
            for row in 0..DIMENSION {
                state.covariance[column][row] = p[(row, column)];
            }
        }
        let mut innovation = Innovation::empty();
        for i in 0..3 {
            let row: Vec<f64> = h.row(i).iter().copied().collect();
            innovation.push(residual[i], row.try_into().unwrap(), &[r[(i, 0)], r[(i, 1)], r[(i, 2)]][..=i]);
        }
        let weighed = weigh(&state, &innovation).unwrap();
        apply(&mut state, &weighed);

        let s = h * p * h.transpose() + r;
        let inverse = s.try_inverse().unwrap();
        let gain = p * h.transpose() * inverse;
        let keep = SMatrix::<f64, DIMENSION, DIMENSION>::identity() - gain * h;
        let joseph = keep * p * keep.transpose() + gain * r * gain.transpose();
        let correction = gain * residual;
        assert!((weighed.nis - residual.dot(&(inverse * residual))).abs() < 1e-12 * weighed.nis);
        for i in 0..DIMENSION {
            for j in 0..DIMENSION {
                let scale = (joseph[(i, i)] * joseph[(j, j)]).sqrt();
                assert!((state.covariance[i][j] - joseph[(i, j)]).abs() < 1e-5 * scale, "{i} {j}");
                assert_eq!(state.covariance[i][j], state.covariance[j][i]);
            }
        }
        assert!((state.twist.vx - correction[3]).abs() < 1e-15 && (state.gyro_bias - correction[8]).abs() < 1e-15);
    }

    #[test]
    fn a_covariance_that_is_none_weighs_nothing() {
        let state = State::new(Stamp::default(), Se2::default(), &Matrix3::zeros(), &[0.0; ANCHORS]);
        for noise in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut innovation = Innovation::empty();
            innovation.push(1.0, [0.0; DIMENSION], &[noise]);
            assert!(weigh(&state, &innovation).is_none(), "{noise}");
        }
    }
}
