//! The covariance of all that is estimated together: pose, parameters and points.
//!
//! Only one triangle is held, row after row: it stays symmetric by construction, a point that is added is two more rows at the end,
//! and every large operation is one sweep over the rows,
//!
//! ```text
//! P += s Σₖ leftₖ rightₖᵀ        of as many pairs of columns as there are, four at a time
//! ```
//!
//! in plain loops over rows, compiled for the instruction set found at run time. Each entry is summed in the same order on all of them.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

#[cfg(feature = "serde")]
use agv_core::{Error, check};
use pulp::{Arch, Simd, WithSimd};

/// A symmetric matrix that grows, shrinks, and takes products of columns.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawJoint"))]
pub(super) struct JointCovariance {
    size: usize,
    /// The lower triangle by rows.
    entries: Vec<f64>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawJoint {
    size: usize,
    entries: Vec<f64>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawJoint> for JointCovariance {
    type Error = Error;

    fn try_from(raw: RawJoint) -> Result<Self, Error> {
        check::in_range("size", raw.size as f64, 0.0, 1e6)?;
        check::length("entries of the covariance", raw.entries.len(), start(raw.size))?;
        check::all_finite("covariance", &raw.entries)?;
        let joint = Self { size: raw.size, entries: raw.entries };
        for i in 0..joint.size {
            check::non_negative("variance", joint.get(i, i))?;
        }
        Ok(joint)
    }
}

/// Where a row begins: the rows above it have 1, 2, ... entries.
#[inline(always)]
const fn start(row: usize) -> usize {
    row * (row + 1) / 2
}

impl JointCovariance {
    /// Number of rows.
    pub(super) const fn size(&self) -> usize {
        self.size
    }

    #[inline]
    pub(super) fn get(&self, i: usize, j: usize) -> f64 {
        let (row, column) = if i >= j { (i, j) } else { (j, i) };
        self.entries[start(row) + column]
    }

    #[inline]
    pub(super) fn set(&mut self, i: usize, j: usize, value: f64) {
        let (row, column) = if i >= j { (i, j) } else { (j, i) };
        self.entries[start(row) + column] = value;
    }

    #[inline]
    pub(super) fn add(&mut self, i: usize, j: usize, value: f64) {
        let (row, column) = if i >= j { (i, j) } else { (j, i) };
        self.entries[start(row) + column] += value;
    }

    /// Another row, which correlates with nothing.
    pub(super) fn push(&mut self, variance: f64) {
        self.entries.resize(self.entries.len() + self.size, 0.0);
        self.entries.push(variance);
        self.size += 1;
    }

    /// Another row, of the quantity that is that of `of` and `factor` times that of `other`.
    pub(super) fn push_sum(&mut self, of: usize, other: usize, factor: f64) {
        let row = self.size;
        self.push(0.0);
        for j in 0..row {
            let value = self.get(of, j) + factor * self.get(other, j);
            self.entries[start(row) + j] = value;
        }
        let variance = self.get(of, row) + factor * self.get(other, row);
        self.entries[start(row) + row] = variance;
    }

    /// Leaves out two rows from `first` on.
    pub(super) fn remove_pair(&mut self, first: usize) {
        let mut kept = 0;
        for i in (0..self.size).filter(|&i| i != first && i != first + 1) {
            for j in (0..=i).filter(|&j| j != first && j != first + 1) {
                self.entries[kept] = self.entries[start(i) + j];
                kept += 1;
            }
        }
        self.entries.truncate(kept);
        self.size -= 2;
    }

    /// The column of `b` less that of `a`.
    pub(super) fn difference_into(&self, b: usize, a: usize, out: &mut [f64]) {
        for (i, out) in out.iter_mut().enumerate() {
            *out = self.get(i, b) - self.get(i, a);
        }
    }

    /// One column.
    pub(super) fn column_into(&self, of: usize, out: &mut [f64]) {
        for (i, out) in out.iter_mut().enumerate() {
            *out = self.get(i, of);
        }
    }

    /// Adds `sign` times the sum of the products of the columns of `left` and `right`, one after the other in each; the sum is to be
    /// symmetric.
    pub(super) fn add_products(&mut self, left: &[f64], right: &[f64], sign: f64) {
        if self.size > 0 {
            Arch::new().dispatch(Products { joint: self, left, right, sign });
        }
    }
}

struct Products<'a> {
    joint: &'a mut JointCovariance,
    left: &'a [f64],
    right: &'a [f64],
    sign: f64,
}

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Products { joint, left, right, sign } = self;
        let n = joint.size;
        let mut rest = joint.entries.as_mut_slice();
        for i in 0..n {
            let (row, below) = rest.split_at_mut(i + 1);
            rest = below;
            let mut lefts = left.chunks_exact(4 * n);
            let mut rights = right.chunks_exact(4 * n);
            for (l, r) in lefts.by_ref().zip(rights.by_ref()) {
                let f = [sign * l[i], sign * l[n + i], sign * l[2 * n + i], sign * l[3 * n + i]];
                let (a, b) = (&r[..=i], &r[n..=n + i]);
                let (c, d) = (&r[2 * n..=2 * n + i], &r[3 * n..=3 * n + i]);
                for ((((p, a), b), c), d) in row.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                    *p += (f[0] * a + f[1] * b) + (f[2] * c + f[3] * d);
                }
            }
            for (l, r) in lefts.remainder().chunks_exact(n).zip(rights.remainder().chunks_exact(n)) {
                let f = sign * l[i];
                row.iter_mut().zip(r).for_each(|(p, r)| *p += f * r);
            }
        }
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_types, reason = "the dense reference")]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn wave(n: usize, k: usize) -> Vec<f64> {
        (0..n * k).map(|i| (1.3 * i as f64).sin()).collect()
    }

    fn dense(joint: &JointCovariance) -> DMatrix<f64> {
        DMatrix::from_fn(joint.size(), joint.size(), |i, j| joint.get(i, j))
    }

    /// Against dense matrices, for all remainders of the columns.
    #[test]
    fn products_are_those_of_dense_matrices() {
        for (n, k) in [(1, 1), (5, 3), (8, 4), (9, 7), (33, 13)] {
            let mut joint = JointCovariance::default();
            (0..n).for_each(|i| joint.push(1.0 + i as f64));
            let before = dense(&joint);
            let columns = wave(n, k);
            joint.add_products(&columns, &columns, -0.5);
            let w = DMatrix::from_column_slice(n, k, &columns);
            assert!((dense(&joint) - (before - &w * w.transpose() * 0.5)).amax() < 1e-12, "{n} {k}");
        }
    }

    #[test]
    fn rows_come_and_go() {
        let mut joint = JointCovariance::default();
        (0..5).for_each(|i| joint.push(1.0 + f64::from(i)));
        let columns = wave(5, 2);
        joint.add_products(&columns, &columns, 1.0);
        let before = dense(&joint);
        joint.push_sum(1, 0, 0.0);
        joint.push_sum(3, 2, 0.5);
        let grown = dense(&joint);
        assert_eq!(grown.view((0, 0), (5, 5)), before);
        assert_eq!(grown.row(5), grown.row(1));
        let mut map = DMatrix::zeros(7, 5);
        (0..5).for_each(|i| map[(i, i)] = 1.0);
        (map[(5, 1)], map[(6, 3)], map[(6, 2)]) = (1.0, 1.0, 0.5);
        assert!((&grown - &map * before * map.transpose()).amax() < 1e-14);
        joint.remove_pair(2);
        let keep = [0, 1, 4, 5, 6];
        assert_eq!(dense(&joint), DMatrix::from_fn(5, 5, |i, j| grown[(keep[i], keep[j])]));
    }
}
