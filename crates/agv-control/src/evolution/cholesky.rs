//! A lower triangular factor of a covariance, `C = A Aᵀ`, of any size, that is updated in place.

/// The factor, row by row; entries right of the diagonal are zero and stay so.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct CholeskyFactor {
    dimension: usize,
    rows: Vec<f64>,
}

impl CholeskyFactor {
    pub(super) fn identity(dimension: usize) -> Self {
        let mut factor = Self { dimension, rows: vec![0.0; dimension * dimension] };
        factor.reset();
        factor
    }

    /// Whether a factor from elsewhere is one: of the right size, finite, lower triangular, with a positive diagonal.
    #[cfg(feature = "serde")]
    pub(super) fn check(&self, dimension: usize) -> Result<(), agv_core::Error> {
        use agv_core::check;

        check::at_least("factor", self.dimension, 1)?;
        check::length("factor", self.dimension, dimension)?;
        check::length("rows of the factor", self.rows.len(), dimension.saturating_mul(dimension))?;
        for (at, &entry) in self.rows.iter().enumerate() {
            match (at / dimension).cmp(&(at % dimension)) {
                std::cmp::Ordering::Less => check::in_range("right of the factor's diagonal", entry, 0.0, 0.0)?,
                std::cmp::Ordering::Equal => check::positive("diagonal of the factor", entry)?,
                std::cmp::Ordering::Greater => check::finite("factor", entry)?,
            };
        }
        Ok(())
    }

    pub(super) fn reset(&mut self) {
        self.rows.fill(0.0);
        self.rows.iter_mut().step_by(self.dimension + 1).for_each(|diagonal| *diagonal = 1.0);
    }

    /// `A z`, into `out`.
    pub(super) fn apply(&self, z: &[f64], out: &mut [f64]) {
        for ((i, row), out) in self.rows.chunks_exact(self.dimension).enumerate().zip(out) {
            *out = row[..=i].iter().zip(z).map(|(a, z)| a * z).sum();
        }
    }

    /// Replaces `y` by `A⁻¹ y`.
    pub(super) fn solve(&self, y: &mut [f64]) {
        for (i, row) in self.rows.chunks_exact(self.dimension).enumerate() {
            let known: f64 = row[..i].iter().zip(y.iter()).map(|(a, z)| a * z).sum();
            y[i] = (y[i] - known) / row[i];
        }
    }

    /// `C ← s² C`.
    pub(super) fn scale(&mut self, s: f64) {
        self.rows.iter_mut().for_each(|a| *a *= s);
    }

    /// `C ← C + weight v vᵀ` for a weight above zero; `v` is used up. O(n²), Krause, Arbonès and Igel (2016), Algorithm 2.
    pub(super) fn add_rank_one(&mut self, weight: f64, v: &mut [f64]) {
        let n = self.dimension;
        let mut b = 1.0;
        for j in 0..n {
            let diagonal = self.rows[j * n + j];
            let new = (diagonal * diagonal + weight / b * v[j] * v[j]).sqrt();
            let gamma = diagonal * diagonal * b + weight * v[j] * v[j];
            let share = v[j] / diagonal;
            for (i, v) in v.iter_mut().enumerate().skip(j + 1) {
                let a = &mut self.rows[i * n + j];
                *v -= share * *a;
                *a = new / diagonal * *a + new * weight * share * diagonal / gamma * *v;
            }
            self.rows[j * n + j] = new;
            b += weight * share * share;
        }
    }

    /// Greatest standard deviation of a coordinate.
    pub(super) fn max_deviation(&self) -> f64 {
        let norm = |row: &[f64]| row.iter().map(|a| a * a).sum::<f64>().sqrt();
        self.rows.chunks_exact(self.dimension).map(norm).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn covariance(factor: &CholeskyFactor) -> Vec<f64> {
        let (n, rows) = (factor.dimension, &factor.rows);
        let entry = |i: usize, j: usize| (0..n).map(|k| rows[i * n + k] * rows[j * n + k]).sum();
        (0..n * n).map(|at| entry(at / n, at % n)).collect()
    }

    proptest! {
        #[test]
        fn rank_one_updates_add_up(updates in prop::collection::vec((0.01..2.0_f64, prop::array::uniform4(-3.0..3.0_f64)), 1..8)) {
            let mut factor = CholeskyFactor::identity(4);
            let mut expected = covariance(&factor);
            for (weight, v) in updates {
                factor.scale(0.9);
                factor.add_rank_one(weight, &mut v.clone());
                for (at, c) in expected.iter_mut().enumerate() {
                    *c = 0.81 * *c + weight * v[at / 4] * v[at % 4];
                }
            }
            for (c, e) in covariance(&factor).iter().zip(&expected) {
                prop_assert!((c - e).abs() < 1e-9 * (1.0 + e.abs()), "{c} instead of {e}");
            }
            let z = [0.3, -1.0, 2.0, 0.7];
            let mut back = [0.0; 4];
            factor.apply(&z, &mut back);
            factor.solve(&mut back);
            prop_assert!(z.iter().zip(back).all(|(z, b)| (z - b).abs() < 1e-9));
        }
    }
}
