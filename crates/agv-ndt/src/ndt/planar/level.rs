//! Cells of one size, four times: each grid is shifted by half a cell along x, y or both, so that a wall near the border of a cell
//! lies in the middle of another's (Biber and Straßer 2003, section III).
//!
//! With `d = x - mean`, `q = C⁻¹ d` and `e = exp(-½ b dᵀq)` a distribution adds `-a e` to the cost of a point at `x`, and with
//! `J = ∂x/∂τ` of the right increment `a b e Jᵀq` to its gradient and `a b e JᵀC⁻¹J` to the Hessian of Gauss and Newton.

use super::super::mixture::Mixture;
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2},
    grid::{Gaussian2, GaussianGrid, GaussianParams, Grid, GridLayout},
};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

/// 95 % quantile of χ² with two degrees of freedom.
const INLIER: f64 = 5.991;

/// Shifts of the four grids, in cells.
const SHIFTS: [[f64; 2]; 4] = [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]];

/// Most cells of a grid: 500 x 500 m of them, with edges of half a metre.
const MOST_CELLS: usize = 1 << 20;

/// The distributions of a target.
#[derive(Debug, Clone)]
pub(super) struct Level {
    pub(super) edge: f64,
    mixture: Mixture,
    grids: Vec<Grid<Option<Gaussian2>>>,
}

/// What a scan adds up to at a pose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Quadratic {
    pub(super) cost: f64,
    pub(super) gradient: Vector3<f64>,
    pub(super) hessian: Matrix3<f64>,
    /// Points that meet a distribution.
    pub(super) matches: usize,
}

/// How a scan fits at a pose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Fit {
    pub(super) inliers: usize,
    /// Sum of `JᵀFJ`, where `F` has eigenvalue 1 across a point's wall and nearly 0 along it.
    pub(super) facing: Matrix3<f64>,
    pub(super) matches: usize,
}

impl Level {
    /// The distributions of points in cells of `edge` metres; refuses points that lie too far apart.
    pub(super) fn new(
        points: &[Vector2<f64>],
        edge: f64,
        params: GaussianParams,
        outlier_ratio: f64,
    ) -> Result<Self, Error> {
        let corner = |pick: fn(f64, f64) -> f64, start| {
            points.iter().fold(Vector2::repeat(start), |best: Vector2<f64>, p| best.zip_map(p, pick))
        };
        let (low, high) = (corner(f64::min, f64::INFINITY), corner(f64::max, f64::NEG_INFINITY));
        let (width, height) = ((high.x - low.x) / edge + 3.0, (high.y - low.y) / edge + 3.0);
        let cells = width * height;
        if cells.is_nan() || cells > MOST_CELLS as f64 {
            let (name, max) = ("cells of the target", MOST_CELLS);
            return Err(agv_core::Error::TooMany { name, len: cells as usize, max }.into());
        }
        let (width, height) = (width as usize, height as usize);
        let mixture = Mixture::planar(outlier_ratio, edge)?;
        let grid = |shift: [f64; 2]| {
            let origin = Se2::new(low.x - (1.0 - shift[0]) * edge, low.y - (1.0 - shift[1]) * edge, 0.0);
            let mut grid = GaussianGrid::new(GridLayout::new(width, height, edge, origin)?, params)?;
            grid.extend(points.iter().copied());
            Ok(grid.gaussians())
        };
        Ok(Self { edge, mixture, grids: SHIFTS.map(grid).into_iter().collect::<Result<_, agv_core::Error>>()? })
    }

    /// Whether any cell has a distribution.
    pub(super) fn is_empty(&self) -> bool {
        self.grids.iter().all(|grid| grid.values().iter().all(Option::is_none))
    }

    /// The distributions around a point of the target frame.
    fn around(&self, point: Vector2<f64>) -> impl Iterator<Item = &Gaussian2> + '_ {
        self.grids.iter().filter_map(move |grid| grid.get(grid.layout().cell_at(&point)?)?.as_ref())
    }

    pub(super) fn evaluate(&self, points: &[Vector2<f64>], pose: &Se2) -> Quadratic {
        let (amplitude, b) = (-self.mixture.d1, self.mixture.d2);
        let mut sum = Quadratic::default();
        for point in points {
            let (at, jacobian) = (pose.act(point), jacobian(pose, point));
            let before = sum.cost;
            for gaussian in self.around(at) {
                let q = gaussian.information * (at - gaussian.mean);
                let e = amplitude * (-0.5 * b * q.dot(&(at - gaussian.mean))).exp();
                sum.cost -= e;
                sum.gradient += jacobian.transpose() * q * (b * e);
                sum.hessian += jacobian.transpose() * gaussian.information * jacobian * (b * e);
            }
            sum.matches += usize::from(sum.cost < before);
        }
        sum
    }

    pub(super) fn fit(&self, points: &[Vector2<f64>], pose: &Se2) -> Fit {
        let mut fit = Fit::default();
        for point in points {
            let at = pose.act(point);
            let distance = |gaussian: &&Gaussian2| gaussian.mahalanobis_squared(&at);
            let nearest = self.around(at).min_by(|a, b| distance(a).total_cmp(&distance(b)));
            let Some(nearest) = nearest else { continue };
            let relative: Matrix2<f64> = nearest.information / nearest.information.trace();
            let jacobian = jacobian(pose, point);
            fit.facing += jacobian.transpose() * relative * relative * jacobian;
            fit.inliers += usize::from(distance(&nearest) <= INLIER);
            fit.matches += 1;
        }
        fit
    }
}

/// How a point of the target frame moves with the right increment of the pose.
fn jacobian(pose: &Se2, point: &Vector2<f64>) -> Matrix2x3<f64> {
    let rotation = pose.rotation();
    let (c, s) = (rotation.cos(), rotation.sin());
    let turned = rotation.act(&Vector2::new(-point.y, point.x));
    Matrix2x3::new(c, -s, turned.x, s, c, turned.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gradient against differences of the cost; the Hessian of Gauss and Newton is positive semi-definite.
    #[test]
    fn the_gradient_is_that_of_the_cost() {
        let wall = |i: i32| {
            let t = 0.05 * f64::from(i % 100);
            if i < 100 { Vector2::new(t, 0.03 * (7.0 * t).sin()) } else { Vector2::new(0.02 * (9.0 * t).cos(), t) }
        };
        let points: Vec<_> = (0..200).map(wall).collect();
        let level = Level::new(&points, 0.7, GaussianParams::default(), 0.3).unwrap();
        let (pose, h) = (Se2::new(0.03, -0.02, 0.01), 1e-6);
        let here = level.evaluate(&points, &pose);
        for axis in 0..3 {
            let step = Vector3::ith(axis, h);
            let [more, less] = [step, -step].map(|step| level.evaluate(&points, &pose.plus(&step)).cost);
            let slope = (more - less) / (2.0 * h);
            assert!((slope - here.gradient[axis]).abs() < 1e-3 * here.gradient.norm(), "{slope} {}", here.gradient);
        }
        assert!(here.hessian.symmetric_eigenvalues().min() > 0.0 && here.matches == 200);
        assert!(level.fit(&points, &Se2::default()).inliers > 180);
    }
}
