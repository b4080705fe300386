//! What scans are matched against: points on surfaces, and for every cell near them which one is nearest.
//!
//! Distances are those to the points themselves and not to the cells that hold them, so that nothing is lost to the grid but where
//! two points are about as near.

use super::{line::LineSums, params::CorrelativeParams, pyramid::Pyramid};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    grid::GridLayout,
    roles::TargetScan,
    sensors::LaserScan,
};
use nalgebra::Vector2;

/// Points of the target, thinned, and look-ups of them.
#[derive(Debug, Clone)]
pub(super) struct Target {
    pub(super) layout: GridLayout,
    points: Vec<Vector2<f64>>,
    /// Unit normals of the surfaces at the points; zero where the neighbours are on no line.
    normals: Vec<Vector2<f64>>,
    /// Variances of the directions of these, in rad².
    doubts: Vec<f64>,
    /// Nearest point of each cell, or [`NOTHING`], and its squared distance from the cell's centre.
    near: Nearest,
    /// `255 exp(-d² / 2 σ²)` by the distance of a cell's centre.
    pub(super) pyramid: Pyramid,
}

const NOTHING: u32 = u32::MAX;

/// Standard deviations beyond which an end point meets nothing.
pub(super) const REACH: f64 = 3.0;

/// Most cells: some hundred metres each way at 0.05 m. Points farther apart than that are no one place.
const MAX_CELLS: usize = 1 << 26;

/// All end points of some scans, in the target frame.
pub(super) fn end_points(scans: &[TargetScan<'_>]) -> Result<Vec<Vector2<f64>>, Error> {
    if scans.is_empty() {
        return Err(Error::Empty { name: "target" });
    }
    let mut points = Vec::new();
    for TargetScan { target_from_base: pose, scan } in scans {
        check::all_finite("target_from_base", &[pose.x(), pose.y(), pose.yaw()])?;
        points.extend(scan.points_in_base().map(|point| pose.act(&point)));
    }
    Ok(points)
}

/// A grid over some points and `margin` metres around them, whose axes are those of their frame.
pub(super) fn layout_around(points: &[Vector2<f64>], margin: f64, resolution: f64) -> Result<GridLayout, Error> {
    let margin = Vector2::repeat(margin);
    let least = points.iter().fold(Vector2::repeat(f64::INFINITY), |a, b| a.inf(b)) - margin;
    let most = points.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |a, b| a.sup(b)) + margin;
    let cells = ((most - least) / resolution).map(f64::ceil);
    if cells.x * cells.y > MAX_CELLS as f64 {
        return Err(Error::TooMany { name: "cells of the target", len: usize::MAX, max: MAX_CELLS });
    }
    GridLayout::new(cells.x as usize, cells.y as usize, resolution, Se2::new(least.x, least.y, 0.0))
}

impl Target {
    /// Look-ups for these points, which are finite. O(points and cells).
    pub(super) fn new(points: &[Vector2<f64>], params: &CorrelativeParams) -> Result<Self, Error> {
        Self::after(&mut None, points, params)
    }

    /// The same in the memory of one that is done with, which is as it was where that fails: large grids from the system cost more
    /// than what is written into them.
    pub(super) fn after(
        before: &mut Option<Self>,
        points: &[Vector2<f64>],
        params: &CorrelativeParams,
    ) -> Result<Self, Error> {
        let points = thinned(points, 0.5 * params.resolution);
        check::at_least("usable end points of the target", points.len(), params.min_points)?;
        let reach = REACH * params.sigma;
        let layout = layout_around(&points, reach + params.resolution, params.resolution)?;
        // Nothing fails from here on.
        let (points, normals, doubts) = surfaces(&points, params);
        let mut before = before.take();
        let mut before = before.as_mut();

        let near = before.as_mut().map_or_else(Nearest::default, |before| std::mem::take(&mut before.near));
        let near = near.renewed(&points, &layout, reach);
        let scale = -0.5 / (params.sigma * params.sigma);
        let value = |(&index, &squared): (&u32, &f32)| {
            if index == NOTHING { 0 } else { (255.0 * (scale * f64::from(squared)).exp()).round() as u8 }
        };
        let pyramid = before.map_or_else(Pyramid::default, |before| std::mem::take(&mut before.pyramid));
        let pyramid = pyramid.renewed(layout.width(), near.index.iter().zip(&near.squared).map(value));
        Ok(Self { layout, points, normals, doubts, near, pyramid })
    }

    /// The surface nearest to a place.
    #[inline]
    pub(super) fn nearest(&self, place: &Vector2<f64>) -> Option<Surface> {
        let cell = self.layout.cell_at(place)?;
        let index = *self.near.index.get(self.layout.index(cell)?)? as usize;
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

/// For each cell which point is nearest to its centre, or [`NOTHING`], and its squared distance.
#[derive(Debug, Clone, Default)]
pub(super) struct Nearest {
    pub(super) index: Vec<u32>,
    pub(super) squared: Vec<f32>,
}

impl Nearest {
    /// The points nearest to the cells of a grid, whose axes are the map's; nothing beyond `reach`.
    pub(super) fn renewed(mut self, points: &[Vector2<f64>], layout: &GridLayout, reach: f64) -> Self {
        self.index.clear();
        self.index.resize(layout.len(), NOTHING);
        self.squared.clear();
        self.squared.resize(layout.len(), (reach * reach) as f32);
        self.stamp(points, layout, reach);
        self
    }

    fn stamp(&mut self, points: &[Vector2<f64>], layout: &GridLayout, reach: f64) {
        let (resolution, least) = (layout.resolution(), layout.map_from_grid().translation());
        let around = (reach / resolution).ceil() as i32;
        let clipped = |middle: i32, most: usize| (middle - around).max(0)..(middle + around + 1).min(most as i32);
        // Squared offsets of the columns, in square metres.
        let mut aside = vec![0.0_f32; 2 * around as usize + 1];
        for (index, point) in (0_u32..).zip(points) {
            let place = (point - least) / resolution;
            let middle = place.map(|v| v.floor() as i32);
            let off = |cell: i32, place: f64| (((f64::from(cell) + 0.5 - place) * resolution) as f32).powi(2);
            let columns = clipped(middle.x, layout.width());
            if columns.is_empty() {
                continue;
            }
            aside.clear();
            aside.extend(columns.clone().map(|x| off(x, place.x)));
            for y in clipped(middle.y, layout.height()) {
                let above = off(y, place.y);
                let row = y as usize * layout.width() + columns.start as usize;
                let row = row..row + aside.len();
                // Without branches, so that several cells go at once.
                for ((least, nearest), aside) in
                    self.squared[row.clone()].iter_mut().zip(&mut self.index[row]).zip(&aside)
                {
                    let distance = aside + above;
                    let is_nearer = distance < *least;
                    *nearest = if is_nearer { index } else { *nearest };
                    *least = if is_nearer { distance } else { *least };
                }
            }
        }
    }
}

/// Memory for thinning points: squares, and the index of a point in each.
pub(crate) type Squares = Vec<(i64, i64, usize)>;

/// The end points of a scan, a point per square, in memory that is used again.
#[derive(Debug, Clone, Default)]
pub(super) struct ThinnedScan {
    pub(super) points: Vec<Vector2<f64>>,
    squares: Squares,
}

impl ThinnedScan {
    /// Takes another scan, thinned out to squares of this edge.
    pub(super) fn refill(&mut self, scan: &LaserScan, edge: f64) {
        thin_into(scan.points_in_base(), edge, &mut self.squares, &mut self.points);
    }
}

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
    // Side by side as they are read.
    let ordered: Vec<Vector2<f64>> = buckets.iter().map(|bucket| points[bucket.2]).collect();
    let mut found = vec![(Vector2::zeros(), Vector2::zeros(), 0.0); points.len()];
    for same in buckets.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        // Three rows of three buckets each are the neighbours of all points of one.
        let (row, column, _) = same[0];
        let rows = [row - 1, row, row + 1].map(|row| {
            let start = buckets.partition_point(|b| (b.0, b.1) < (row, column - 1));
            let length = buckets[start..].partition_point(|b| (b.0, b.1) <= (row, column + 1));
            &ordered[start..start + length]
        });
        for &(.., index) in same {
            found[index] = surface(&points[index], rows, params);
        }
    }
    let (mut moved, mut normals, mut doubts) = (Vec::new(), Vec::new(), Vec::new());
    for (point, normal, doubt) in found {
        moved.push(point);
        normals.push(normal);
        doubts.push(doubt);
    }
    (moved, normals, doubts)
}

/// The surface at a point: of its neighbours among these.
fn surface(
    point: &Vector2<f64>,
    rows: [&[Vector2<f64>]; 3],
    params: &CorrelativeParams,
) -> (Vector2<f64>, Vector2<f64>, f64) {
    let radius = params.normal_radius;
    let mut sums = LineSums::default();
    for offset in rows.into_iter().flatten().map(|other| other - point) {
        if offset.norm_squared() <= radius * radius {
            sums.add(&offset);
        }
    }
    let Some(line) = sums.line() else { return (*point, Vector2::zeros(), 0.0) };
    // Of a line through points that are that far across it, and spread that far along it.
    let across = line.across.max(params.range_sigma * params.range_sigma);
    (point + line.normal * line.normal.dot(&line.mean), line.normal, across / (line.count * line.along))
}
