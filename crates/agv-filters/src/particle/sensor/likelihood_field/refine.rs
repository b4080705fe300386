//! The best pose near a guess: the particles are few and their mean is off by that, the peak of the likelihood is not.
//!
//! The pose `x` minimises, by Gauss-Newton steps from the guess `x₀` with covariance `Σ = P + diag(2k²/m, 2k²/m, 0)`,
//!
//! ```text
//! ½ |x ⊖ x₀|²_Σ + a Σ_i (1 - exp(-d_i² / 2k²))        k = σ_hit / √3
//! ```
//!
//! with `d_i` the distance of an end point from the nearest obstacle, as the field has it, and `a` the weight of a beam. The second
//! term grows as `a d² / 2k²` and levels off (Welsch's kernel; Barron, *A general and adaptive robust loss function*, 2019, α → -∞;
//! it is the sum of cubes again): what the map does not show pulls no more. The product of the beams' likelihoods goes on pulling up to three
//! deviations, and the mean of the particles with it.
//!
//! `P` is what was known before the scan, and `2k²/m`, with `m` the beams that the scan counts as, what the scan leaves open of the
//! position as bluntly as it counts for the particles: the guess is their mean, which has followed the scan no nearer than that, while the
//! peak is right to a centimetre. Without it a motion that is known well, as wheels and gyro together know it, holds the mean tighter than
//! it deserves, and the estimate off the peak. Between the centres of cells the distance is interpolated, so that the
//! pose is not tied to them.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{
    kernel::{EndPoints, GROUP},
    table::Table,
};
use crate::particle::exp::exp;
use agv_core::geometry::{LieGroup, Se2, UncertainPose};
use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};

/// Steps at most; five are usual.
const STEPS: usize = 10;

/// A step this short, in metres and radians, is the last.
const SHORT: f64 = 1e-4;

/// An end point this many deviations from everything pulls no more.
const FAR: f64 = 2.5;

/// A scan, ready to pull a pose to where it fits.
pub(super) struct Refiner<'a> {
    pub(super) table: &'a Table,
    pub(super) ends: &'a EndPoints,
    /// What a beam counts.
    pub(super) weight: f64,
    pub(super) arch: Arch,
}

/// The normal equations at a pose.
struct Normal {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    cost: f64,
}

impl Refiner<'_> {
    /// The pose; none if it is not better than the guess.
    pub(super) fn refine(&self, guess: &UncertainPose<Se2>) -> Option<Se2> {
        let information = (guess.covariance() + self.bluntness()).try_inverse()?;
        let mut pose = *guess.mean();
        let mut normal = self.normal(&pose, guess.mean(), &information);
        let first = normal.cost;
        for _ in 0..STEPS {
            let step = -normal.hessian.cholesky()?.solve(&normal.gradient);
            pose = pose.plus(&step);
            normal = self.normal(&pose, guess.mean(), &information);
            if step.amax() < SHORT {
                break;
            }
        }
        // NaN is not better.
        (normal.cost < first).then_some(pose)
    }

    /// What the scan leaves open where it is taken in as particles are weighed, `m` beams counting for one axis or the other: `2k² / m`.
    fn bluntness(&self) -> Matrix3<f64> {
        let beams = self.weight * self.ends.len() as f64;
        let variance = 2.0 * self.table.sigma * self.table.sigma / (3.0 * beams.max(1.0));
        Matrix3::from_diagonal(&Vector3::new(variance, variance, 0.0))
    }

    fn normal(&self, pose: &Se2, guess: &Se2, information: &Matrix3<f64>) -> Normal {
        let off = pose.minus(guess);
        let pull = information * off;
        let [near, gx, gy, gt, xx, xy, xt, yy, yt, tt] =
            self.arch.dispatch(Pull { refiner: self, in_grid: self.table.grid_from_map.compose(pose) });
        Normal {
            hessian: information + Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt) * self.weight,
            gradient: pull + Vector3::new(gx, gy, gt) * self.weight,
            cost: 0.5 * off.dot(&pull) + self.weight * (self.ends.len() as f64 - near),
        }
    }
}

/// What the beams of a scan pull at a pose, in units of one beam: `Σ exp(-d² / 2k²)`, the gradient, and the upper triangle of the
/// Hessian.
///
/// A group of beams goes side by side; the sums run in fixed lanes, so that the bits do not depend on the instruction set.
struct Pull<'a> {
    refiner: &'a Refiner<'a>,
    in_grid: Se2,
}

/// Adding 2⁵² to a number in [0, 2³²) leaves its nearest whole number in the low bits of the sum.
const ROUNDER: f64 = 4_503_599_627_370_496.0;

impl WithSimd for Pull<'_> {
    type Output = [f64; 10];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; 10] {
        let Refiner { table, ends, .. } = *self.refiner;
        // In the table's cells, whose centres are whole numbers.
        let origin = self.in_grid.translation() * table.cells_per_metre;
        let (cos, sin) = (self.in_grid.rotation().cos(), self.in_grid.rotation().sin());
        let last = table.last.map(f64::from);
        let (stride, metres) = (table.stride as usize, table.cells_per_metre.recip());
        let (far, sharpness) = (FAR * table.sigma, 3.0 / (table.sigma * table.sigma));
        let mut sums = [[0.0; GROUP]; 10];
        for (end_x, end_y, used) in ends.groups() {
            let (mut u, mut v, mut is_used) = ([0.0; GROUP], [0.0; GROUP], [false; GROUP]);
            let mut corners = [[0_u32; GROUP]; 2];
            for lane in 0..GROUP {
                let (x, y) = (f64::from(end_x[lane]), f64::from(end_y[lane]));
                let at = [origin.x + 0.5 + (cos * x - sin * y), origin.y + 0.5 + (sin * x + cos * y)];
                // NaN fails all comparisons.
                let is_inside = at[0] >= 0.0 && at[1] >= 0.0 && at[0] < last[0] && at[1] < last[1];
                is_used[lane] = is_inside && lane < used;
                let [a, b] = at.map(|at| if is_inside { at } else { 0.0 });
                let [(column, left), (row, below)] = [a, b].map(floor);
                (u[lane], v[lane], corners[0][lane], corners[1][lane]) = (left, below, column, row);
            }
            let mut levels = [[0_u32; GROUP]; 4];
            for lane in 0..GROUP {
                let first = corners[1][lane] as usize * stride + corners[0][lane] as usize;
                for (levels, offset) in levels.iter_mut().zip([0, 1, stride, stride + 1]) {
                    levels[lane] = u32::from(table.terms[first + offset]);
                }
            }
            for lane in 0..GROUP {
                let [d00, d10, d01, d11] = levels.map(|levels| table.distance(levels[lane]));
                let (u, v) = (u[lane], v[lane]);
                let distance = (1.0 - v) * ((1.0 - u) * d00 + u * d10) + v * ((1.0 - u) * d01 + u * d11);
                let along = [(1.0 - v) * (d10 - d00) + v * (d11 - d01), (1.0 - u) * (d01 - d00) + u * (d11 - d10)];
                let counts = is_used[lane] && distance <= far;
                let kernel = exp(-0.5 * sharpness * distance * distance);
                let kernel = if counts { kernel } else { 0.0 };
                // The slope in the base frame, per metre, and by the heading.
                let x = (cos * along[0] + sin * along[1]) * table.cells_per_metre;
                let y = (cos * along[1] - sin * along[0]) * table.cells_per_metre;
                let turn = (y * f64::from(end_x[lane]) - x * f64::from(end_y[lane])) * metres;
                let sharp = sharpness * kernel;
                let (sx, sy, st, pull) = (sharp * x, sharp * y, sharp * turn, sharp * distance);
                let terms =
                    [kernel, pull * x, pull * y, pull * turn, sx * x, sx * y, sx * turn, sy * y, sy * turn, st * turn];
                sums.iter_mut().zip(terms).for_each(|(sum, term)| sum[lane] += term);
            }
        }
        sums.map(|[a, b, c, d]| (a + b) + (c + d))
    }
}

/// The greatest whole number not above a number in [0, 2³²), and the rest.
#[inline(always)]
fn floor(at: f64) -> (u32, f64) {
    let shifted = at + ROUNDER;
    let nearest = shifted - ROUNDER;
    let is_above = nearest > at;
    let floor = if is_above { nearest - 1.0 } else { nearest };
    ((shifted.to_bits() as u32).wrapping_sub(u32::from(is_above)), at - floor)
}

impl Table {
    /// Distance from what the map shows, in metres, where a term has this level.
    ///
    /// A term is `ln(peak exp(-d² / 2σ²) + floor)`: as long as the first summand is the larger one, `d² = 2σ² (greatest - term)`.
    #[inline(always)]
    fn distance(&self, level: u32) -> f64 {
        let below = self.greatest - self.sum(level, 1);
        self.sigma * (2.0 * if below > 0.0 { below } else { 0.0 }).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use crate::particle::{LikelihoodFieldModel, LikelihoodFieldModelParams, SensorModel};
    use agv_core::{
        geometry::{LieGroup, Se2, UncertainPose},
        grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams},
        sensors::{LaserScan, ScanGeometry},
        time::Stamp,
    };
    use nalgebra::{Matrix3, Vector3};

    /// A room of 6 m by 4 m about the origin, its walls centred on cells; a corridor along x without `ends`.
    fn model(ends: bool) -> LikelihoodFieldModel {
        let layout = GridLayout::new(141, 101, 0.05, Se2::new(-3.525, -2.525, 0.0)).unwrap();
        let mut map = Grid::filled(layout, CellState::Free);
        for i in 0..141 {
            for y in [10, 90] {
                map.set(Cell::new(i, y), CellState::Occupied);
            }
        }
        for i in (10..=90).filter(|_| ends) {
            for x in [10, 130] {
                map.set(Cell::new(x, i), CellState::Occupied);
            }
        }
        let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
        LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap()
    }

    /// What a scanner sees all around from `pose`; every seventh beam is blocked half a metre before the wall.
    fn scan(pose: &Se2, ends: bool) -> LaserScan {
        let geometry = ScanGeometry { angle_min: -3.1, angle_increment: 0.1, ..Default::default() };
        let range = |i: usize| {
            let (sin, cos) = (pose.yaw() + geometry.angle(i)).sin_cos();
            let to = |wall: f64, at: f64, slope: f64| {
                if slope.abs() < 1e-9 { 1e9 } else { (wall.copysign(slope) - at) / slope }
            };
            let across = to(2.0, pose.y(), sin);
            let range = if ends { across.min(to(3.0, pose.x(), cos)) } else { across };
            (if i.is_multiple_of(7) { range - 0.5 } else { range }) as f32
        };
        LaserScan::new(Stamp::default(), geometry, (0..63).map(range).collect()).unwrap()
    }

    fn guess(mean: Se2, deviation: f64) -> UncertainPose<Se2> {
        let variances = Vector3::repeat(deviation * deviation);
        UncertainPose::new(mean, Matrix3::from_diagonal(&variances)).unwrap()
    }

    #[test]
    fn the_peak_is_found_between_the_cells_and_what_the_map_lacks_does_not_pull() {
        let mut model = model(true);
        for truth in [Se2::new(0.012, -0.017, 0.0), Se2::new(1.033, 0.521, 0.7), Se2::new(-2.0, 0.9, -2.9)] {
            let scan = scan(&truth, true);
            for off in [Vector3::new(0.08, -0.06, 0.05), Vector3::new(-0.1, 0.1, -0.08)] {
                let found = model.refine(&scan, &guess(truth.plus(&off), 0.3)).unwrap();
                let error = found.minus(&truth);
                assert!(error.xy().norm() < 0.01 && error.z.abs() < 0.005, "{truth:?}: {error}");
            }
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let mut model = model(true);
        let truth = Se2::new(1.033, 0.521, 0.7);
        let (scan, guess) = (scan(&truth, true), guess(truth.plus(&Vector3::new(0.08, -0.06, 0.05)), 0.3));
        let found = model.refine(&scan, &guess);
        for arch in crate::particle::simd::archs() {
            model.arch = arch;
            assert_eq!(model.refine(&scan, &guess), found, "{arch:?}");
        }
    }

    #[test]
    fn where_the_scan_says_nothing_the_guess_stays() {
        let mut model = model(false);
        let truth = Se2::new(0.0, 0.3, 0.0);
        let found =
            model.refine(&scan(&truth, false), &guess(truth.plus(&Vector3::new(0.1, 0.08, 0.03)), 0.1)).unwrap();
        assert!((found.x() - 0.1).abs() < 0.02 && (found.y() - 0.3).abs() < 0.015, "{found:?}");
    }

    /// The mean of the particles has followed the scan as bluntly as the scan counts for them, however tight the motion before it: the
    /// estimate goes half of the way that is left.
    #[test]
    fn a_tight_guess_does_not_hold_the_estimate_off_the_peak() {
        let mut model = model(true);
        let truth = Se2::new(0.3, -0.2, 0.0);
        let off = 0.06;
        let tight = guess(truth.plus(&Vector3::new(off, 0.0, 0.0)), 0.002);
        let left = model.refine(&scan(&truth, true), &tight).unwrap().minus(&truth).x;
        assert!((0.3 * off..0.8 * off).contains(&left), "{left}");
    }

    #[test]
    fn what_cannot_be_refined_is_not() {
        let mut model = model(true);
        let truth = Se2::default();
        let seen = scan(&truth, true);
        assert_eq!(model.refine(&seen, &guess(truth, 0.0)), None, "known exactly");
        assert_eq!(model.refine(&seen, &guess(Se2::new(1e7, 0.0, 0.0), 0.1)), None, "off the map");
        let blind = LaserScan::new(Stamp::default(), *seen.geometry(), vec![f32::NAN; 63]).unwrap();
        assert_eq!(model.refine(&blind, &guess(truth, 0.1)), None, "no hits");
    }
}
