//! The best pose near a guess: the particles are few and their mean is off by that, the peak of the likelihood is not.
//!
//! The pose `x` minimises, by Gauss-Newton steps from the guess `x₀` with covariance `Σ`,
//!
//! ```text
//! ½ |x ⊖ x₀|²_Σ + a Σ_i (1 - exp(-d_i² / 2k²))        k = σ_hit / √3
//! ```
//!
//! with `d_i` the distance of an end point from the nearest obstacle, as the field has it, and `a` the weight of a beam. The second
//! term grows as `a d² / 2k²` and levels off (Welsch's kernel; Barron, *A general and adaptive robust loss function*, 2019, α → -∞;
//! it is the sum of cubes again): what the map does not show pulls no more. The product of the beams' likelihoods goes on pulling up to three
//! deviations, and the mean of the particles with it. Between the centres of cells the distance is interpolated, so that the
//! pose is not tied to them.

use super::table::Table;
use agv_core::geometry::{LieGroup, Se2, UncertainPose};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Steps at most; five are usual.
const STEPS: usize = 10;

/// A step this short, in metres and radians, is the last.
const SHORT: f64 = 1e-4;

/// An end point this many deviations from everything pulls no more.
const FAR: f64 = 2.5;

/// A scan, ready to pull a pose to where it fits.
pub(super) struct Refiner<'a, E> {
    pub(super) table: &'a Table,
    /// End points in the base frame, in cells.
    pub(super) ends: E,
    /// What a beam counts.
    pub(super) weight: f64,
}

/// The normal equations at a pose.
struct Normal {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    cost: f64,
}

impl<E: Iterator<Item = Vector2<f64>> + Clone> Refiner<'_, E> {
    /// The pose; none if it is not better than the guess.
    pub(super) fn refine(&self, guess: &UncertainPose<Se2>) -> Option<Se2> {
        let information = guess.covariance().try_inverse()?;
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

    fn normal(&self, pose: &Se2, guess: &Se2, information: &Matrix3<f64>) -> Normal {
        let off = pose.minus(guess);
        let pull = information * off;
        let mut normal = Normal { hessian: *information, gradient: pull, cost: 0.5 * off.dot(&pull) };
        let table = self.table;
        let in_grid = table.grid_from_map.compose(pose);
        // In the table's cells, whose centres are whole numbers.
        let origin = in_grid.translation() * table.cells_per_metre + Vector2::repeat(0.5);
        let (turn, turn_back) = (in_grid.rotation(), in_grid.rotation().inverse());
        let sharpness = 3.0 / (table.sigma * table.sigma);
        for end in self.ends.clone() {
            normal.cost += self.weight;
            let Some((distance, slope)) = table.distance(&(origin + turn.act(&end))) else { continue };
            if distance > FAR * table.sigma {
                continue;
            }
            let kernel = self.weight * (-0.5 * sharpness * distance * distance).exp();
            normal.cost -= kernel;
            let (slope, arm) = (turn_back.act(&slope), end / table.cells_per_metre);
            let slope = Vector3::new(slope.x, slope.y, slope.y * arm.x - slope.x * arm.y);
            normal.gradient += slope * (sharpness * kernel * distance);
            normal.hessian += slope * slope.transpose() * (sharpness * kernel);
        }
        normal
    }
}

impl Table {
    /// Distance from what the map shows at a point in cells of the table, and its gradient in the grid's frame; none off the map.
    ///
    /// A term is `ln(peak exp(-d² / 2σ²) + floor)`: as long as the first summand is the larger one, `d² = 2σ² (greatest - term)`.
    fn distance(&self, at: &Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let corner = at.map(f64::floor);
        let [last_x, last_y] = self.last.map(f64::from);
        // NaN fails all comparisons.
        if !(corner.x >= 0.0 && corner.y >= 0.0 && corner.x < last_x && corner.y < last_y) {
            return None;
        }
        let (u, v) = (at.x - corner.x, at.y - corner.y);
        let stride = self.stride as usize;
        let first = corner.y as usize * stride + corner.x as usize;
        let scale = self.sigma * std::f64::consts::SQRT_2;
        let distance = |index: usize| {
            Some(scale * (self.greatest - self.sum(u32::from(*self.terms.get(index)?), 1)).max(0.0).sqrt())
        };
        let (d00, d10) = (distance(first)?, distance(first + 1)?);
        let (d01, d11) = (distance(first + stride)?, distance(first + stride + 1)?);
        let value = (1.0 - v) * ((1.0 - u) * d00 + u * d10) + v * ((1.0 - u) * d01 + u * d11);
        let along = Vector2::new((1.0 - v) * (d10 - d00) + v * (d11 - d01), (1.0 - u) * (d01 - d00) + u * (d11 - d10));
        Some((value, along * self.cells_per_metre))
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
    fn where_the_scan_says_nothing_the_guess_stays() {
        let mut model = model(false);
        let truth = Se2::new(0.0, 0.3, 0.0);
        let found =
            model.refine(&scan(&truth, false), &guess(truth.plus(&Vector3::new(0.1, 0.08, 0.03)), 0.1)).unwrap();
        assert!((found.x() - 0.1).abs() < 0.02 && (found.y() - 0.3).abs() < 0.015, "{found:?}");
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
