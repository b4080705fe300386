//! What scans are matched against: points on surfaces, and for every cell near them which one is nearest.
//!
//! Distances are those to the points themselves and not to the cells that hold them, so that nothing is lost to the grid but where
//! two points are about as near.

use super::{params::CorrelativeParams, pyramid::Pyramid};
use agv_core::{Error, check, geometry::Se2, grid::GridLayout};
use nalgebra::{Matrix2, Vector2};

/// Points of the target, thinned, and look-ups of them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Target {
    pub(super) layout: GridLayout,
    points: Vec<Vector2<f64>>,
    /// Unit normals of the surfaces at the points; zero where the neighbours are on no line.
    normals: Vec<Vector2<f64>>,
    /// Variances of the directions of these, in rad².
    doubts: Vec<f64>,
    /// Nearest point of each cell, or [`NOTHING`].
    nearest: Vec<u32>,
    /// `255 exp(-d² / 2 σ²)` by the distance of a cell's centre.
    pub(super) pyramid: Pyramid,
}

const NOTHING: u32 = u32::MAX;

/// Standard deviations beyond which an end point meets nothing.
pub(super) const REACH: f64 = 3.0;

/// Most cells: some hundred metres each way at 0.05 m. Points farther apart than that are no one place.
const MAX_CELLS: usize = 1 << 26;

/// Variance across a surface, beside that along it, from which on neighbours are no line.
const THICKNESS: f64 = 0.1;

impl Target {
    /// Look-ups for these points, which are finite. O(points and cells).
    pub(super) fn new(points: &[Vector2<f64>], params: &CorrelativeParams) -> Result<Self, Error> {
        let points = thinned(points, 0.5 * params.resolution);
        check::at_least("usable end points of the target", points.len(), params.min_points)?;
        let reach = REACH * params.sigma;
        let margin = Vector2::repeat(reach + params.resolution);
        let least = points.iter().fold(Vector2::repeat(f64::INFINITY), |a, b| a.inf(b)) - margin;
        let most = points.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |a, b| a.sup(b)) + margin;
        let cells = ((most - least) / params.resolution).map(f64::ceil);
        if cells.x * cells.y > MAX_CELLS as f64 {
            return Err(Error::TooMany { name: "cells of the target", len: usize::MAX, max: MAX_CELLS });
        }
        let origin = Se2::new(least.x, least.y, 0.0);
        let layout = GridLayout::new(cells.x as usize, cells.y as usize, params.resolution, origin)?;
        let (points, normals, doubts) = surfaces(&points, params);

        let (nearest, squared) = nearest_points(&points, &layout, reach);
        let scale = -0.5 / (params.sigma * params.sigma);
        let values = nearest.iter().zip(&squared).map(|(&index, &squared)| {
            if index == NOTHING { 0 } else { (255.0 * (scale * f64::from(squared)).exp()).round() as u8 }
        });
        let pyramid = Pyramid::new(layout.width(), values.collect());
        Ok(Self { layout, points, normals, doubts, nearest, pyramid })
    }

    /// The surface nearest to a place.
    #[inline]
    pub(super) fn nearest(&self, place: &Vector2<f64>) -> Option<Surface> {
        let cell = self.layout.cell_at(place)?;
        let index = *self.nearest.get(self.layout.index(cell)?)? as usize;
        Some(Surface {
            point: *self.points.get(index)?,
            normal: *self.normals.get(index)?,
            doubt: *self.doubts.get(index)?,
        })
    }
}

/// A piece of surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Surface {
    pub(super) point: Vector2<f64>,
    /// Unit normal, or zero if it is on no line.
    pub(super) normal: Vector2<f64>,
    /// Variance of the normal's direction, in rad².
    pub(super) doubt: f64,
}

/// For each cell which point is nearest to its centre, or [`NOTHING`] within `reach`, and its squared distance. The grid's axes are the
/// map's.
pub(super) fn nearest_points(points: &[Vector2<f64>], layout: &GridLayout, reach: f64) -> (Vec<u32>, Vec<f32>) {
    let (resolution, least) = (layout.resolution(), layout.map_from_grid().translation());
    let mut nearest = vec![NOTHING; layout.len()];
    let mut squared = vec![(reach * reach) as f32; layout.len()];
    let around = (reach / resolution).ceil() as i32;
    let cell_area = (resolution * resolution) as f32;
    let centers =
        |low: i32, high: i32, most: usize| (low.max(0)..(high + 1).min(most as i32)).map(|i| (i, f64::from(i) + 0.5));
    for (index, point) in points.iter().enumerate() {
        let place = (point - least) / resolution;
        let middle = place.map(|v| v.floor() as i32);
        for (y, center) in centers(middle.y - around, middle.y + around, layout.height()) {
            let aside = (center - place.y).powi(2);
            let row = y as usize * layout.width();
            for (x, center) in centers(middle.x - around, middle.x + around, layout.width()) {
                let distance = ((center - place.x).powi(2) + aside) as f32 * cell_area;
                let cell = row + x as usize;
                if distance < squared[cell] {
                    (squared[cell], nearest[cell]) = (distance, index as u32);
                }
            }
        }
    }
    (nearest, squared)
}

/// Memory for thinning points: squares, and the index of a point in each.
pub(crate) type Squares = Vec<(i64, i64, usize)>;

/// The first point of each square of this edge, in the order in which they came.
pub(super) fn thinned(points: &[Vector2<f64>], edge: f64) -> Vec<Vector2<f64>> {
    let (mut squares, mut kept) = (Squares::new(), Vec::new());
    thin_into(points.iter().copied(), edge, &mut squares, &mut kept);
    kept
}

/// As [`thinned`], in memory that is there.
pub(crate) fn thin_into(
    points: impl Iterator<Item = Vector2<f64>>,
    edge: f64,
    squares: &mut Squares,
    kept: &mut Vec<Vector2<f64>>,
) {
    kept.clear();
    kept.extend(points);
    let square =
        |(i, point): (usize, &Vector2<f64>)| ((point.x / edge).floor() as i64, (point.y / edge).floor() as i64, i);
    squares.clear();
    squares.extend(kept.iter().enumerate().map(square));
    squares.sort_unstable();
    squares.dedup_by_key(|(x, y, _)| (*x, *y));
    squares.sort_unstable_by_key(|(_, _, i)| *i);
    // Squares are in the order of their points, none of which comes before its place: nothing is overwritten that is still needed.
    for (place, (_, _, i)) in squares.iter().enumerate() {
        kept[place] = kept[*i];
    }
    kept.truncate(squares.len());
}

/// The points, moved onto the lines through their neighbours, which hold less noise than they do; the normals of these lines, and the
/// variances of their directions.
fn surfaces(points: &[Vector2<f64>], params: &CorrelativeParams) -> (Vec<Vector2<f64>>, Vec<Vector2<f64>>, Vec<f64>) {
    let radius = params.normal_radius;
    let bucket = |v: f64| (v / radius).floor() as i64;
    let mut buckets: Vec<(i64, i64, usize)> =
        points.iter().enumerate().map(|(i, point)| (bucket(point.y), bucket(point.x), i)).collect();
    buckets.sort_unstable();
    let neighbours = |x: i64, y: i64| {
        let start = buckets.partition_point(|b| (b.0, b.1) < (y, x - 1));
        buckets[start..].iter().take_while(move |b| (b.0, b.1) <= (y, x + 1)).map(|b| points[b.2])
    };
    let surface = |point: &Vector2<f64>| {
        let (mut count, mut sum, mut squares) = (0.0, Vector2::zeros(), Matrix2::zeros());
        for y in bucket(point.y) - 1..=bucket(point.y) + 1 {
            for other in neighbours(bucket(point.x), y) {
                let offset = other - point;
                if offset.norm_squared() <= radius * radius {
                    (count, sum, squares) = (count + 1.0, sum + offset, squares + offset * offset.transpose());
                }
            }
        }
        let mean = sum / count;
        let covariance = squares / count - mean * mean.transpose();
        // Half of the angle of (a - c, 2 b) is the direction of the line (closed form of the eigenvectors).
        let (difference, twice) = (covariance[(0, 0)] - covariance[(1, 1)], 2.0 * covariance[(0, 1)]);
        let (trace, spread) = (covariance.trace(), difference.hypot(twice));
        if count < 3.0 || trace - spread > THICKNESS * (trace + spread) {
            return (*point, Vector2::zeros(), 0.0);
        }
        let along = 0.5 * twice.atan2(difference);
        let normal = Vector2::new(-along.sin(), along.cos());
        // Of a line through points that are that far across it, and spread that far along it.
        let across = (0.5 * (trace - spread)).max(params.range_sigma * params.range_sigma);
        (point + normal * normal.dot(&mean), normal, across / (0.5 * count * (trace + spread)))
    };
    let (mut moved, mut normals, mut doubts) = (Vec::new(), Vec::new(), Vec::new());
    for (point, normal, doubt) in points.iter().map(surface) {
        moved.push(point);
        normals.push(normal);
        doubts.push(doubt);
    }
    (moved, normals, doubts)
}
