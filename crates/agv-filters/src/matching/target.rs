//! What scans are matched against: points on surfaces, and for every cell near them which one is nearest.
//!
//! Distances are those to the points themselves and not to the cells that hold them, so that nothing is lost to the grid but where
//! two points are about as near.

use super::{
    nearest::{NOTHING, Nearest},
    params::CorrelativeParams,
    pyramid::Pyramid,
    squares::thinned,
    surfaces::surfaces,
};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    grid::GridLayout,
    roles::TargetScan,
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
    /// Standard deviation of an end point around the surfaces, in metres.
    sigma: f64,
    /// `255 exp(-d² / 2 σ²)` by the distance of a cell's centre; made when something is sought.
    pyramid: Pyramid,
}

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
        let mut pyramid = before.map_or_else(Pyramid::default, |before| std::mem::take(&mut before.pyramid));
        pyramid.clear();
        Ok(Self { layout, points, normals, doubts, near, sigma: params.sigma, pyramid })
    }

    /// What a search goes by, with its levels up to this one; they are made once.
    pub(super) fn pyramid(&mut self, level: usize) -> &Pyramid {
        if self.pyramid.is_empty() {
            let scale = -0.5 / (self.sigma * self.sigma);
            let value = |(&index, &squared): (&u32, &f32)| {
                // To the nearest: a call of the system's rounding would take as long as the rest.
                if index == NOTHING { 0 } else { (255.0 * (scale * f64::from(squared)).exp() + 0.5) as u8 }
            };
            self.pyramid.renew(self.layout.width(), self.near.index.iter().zip(&self.near.squared).map(value));
        }
        self.pyramid.grow(level);
        &self.pyramid
    }

    /// Bytes of its memory: most of it that of the grids.
    pub(super) fn memory(&self) -> usize {
        let surfaces = self.points.capacity() * size_of::<Surface>();
        surfaces + self.near.memory() + self.pyramid.memory()
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
