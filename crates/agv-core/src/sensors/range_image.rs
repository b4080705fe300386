//! The cloud of a spinning lidar as an image: rows are laser lines from the lowest up, columns are directions.
//!
//! Column `c` of `n` covers the azimuths `-π + 2π c / n` to `-π + 2π (c + 1) / n`, counter-clockwise seen from above.
//! Of several points in one cell the nearest counts, as for an obstacle.

use super::PointCloud;
use crate::{Error, check};
use std::f32::consts::{PI, TAU};

/// How the row of a point is found; with elevations, points more than half a line outside of the lines are left out.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum RowSource {
    /// From the cloud's ring channel.
    Ring,
    /// From the elevation, for lines at equal angles.
    Uniform {
        /// Elevation of the lowest line, in radians.
        bottom: f32,
        /// Elevation of the highest line, in radians.
        top: f32,
    },
    /// From the elevation, to the nearest of these, in radians, each greater than the one before. At the edge, the
    /// distance to the neighbour counts as a line; a line without neighbours takes every elevation.
    Angles(Vec<f32>),
}

/// Size of a range image.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RangeImageParams {
    /// Number of laser lines.
    pub rows: usize,
    /// Number of directions of a full turn.
    pub columns: usize,
    /// How the row of a point is found.
    pub row_source: RowSource,
}

impl Default for RangeImageParams {
    /// A 16-line lidar at 10 Hz: 0.2° from column to column (paper 003; a VLP-16 measures 1800 directions a turn).
    fn default() -> Self {
        Self { rows: 16, columns: 1800, row_source: RowSource::Ring }
    }
}

/// A range image with the way back to the points.
///
/// ```
/// use agv_core::sensors::{PointCloud, RangeImage, RangeImageParams};
///
/// let cloud = PointCloud::new(vec![3.0, 4.0], vec![0.01, 0.01], vec![-1.0, 0.0])?.with_ring(vec![0, 8])?;
/// let mut image = RangeImage::new(RangeImageParams::default())?;
/// image.fill(&cloud)?;
/// let column = image.columns() / 2; // straight ahead
/// assert_eq!(image.point_index(8, column), Some(1));
/// assert!(image.range(0, column) > Some(3.1) && image.range(1, column).is_none());
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RangeImage {
    params: RangeImageParams,
    /// Row by row; +∞ where there is no point.
    ranges: Vec<f32>,
    /// Index of the point; `EMPTY` where there is none.
    points: Vec<u32>,
}

const EMPTY: u32 = u32::MAX;

impl RangeImage {
    /// Most cells that an image may have: 128 lines of 16384 directions.
    pub const MAX_CELLS: usize = 1 << 21;

    /// An empty image.
    ///
    /// # Errors
    /// No rows or columns, too many cells, elevations that do not increase, or as many of them as there are not rows.
    pub fn new(params: RangeImageParams) -> Result<Self, Error> {
        check::at_least("rows", params.rows, 1)?;
        check::at_least("columns", params.columns, 1)?;
        let cells = params.rows.saturating_mul(params.columns);
        if cells > Self::MAX_CELLS {
            return Err(Error::TooMany { name: "range image", len: cells, max: Self::MAX_CELLS });
        }
        match &params.row_source {
            RowSource::Ring => {}
            RowSource::Uniform { bottom, top } => {
                check::finite("top", f64::from(*top))?;
                check::in_range("bottom", f64::from(*bottom), -2.0, f64::from(top.next_down()))?;
            }
            RowSource::Angles(angles) => {
                check::length("angles", angles.len(), params.rows)?;
                let mut least = f64::NEG_INFINITY;
                for &angle in angles {
                    check::finite("angle", f64::from(angle))?;
                    check::in_range("angle", f64::from(angle), least, 2.0)?;
                    least = f64::from(angle.next_up());
                }
            }
        }
        Ok(Self { ranges: vec![f32::INFINITY; cells], points: vec![EMPTY; cells], params })
    }

    /// Replaces the image by that of `cloud`; linear in points and cells, without allocation.
    ///
    /// Points that are not finite, and those whose line is beyond the image, are left out.
    ///
    /// # Errors
    /// [`Error::Empty`] if rows come from the ring channel and the cloud has none, [`Error::TooMany`] beyond 2³² - 2
    /// points; the image is then as it was.
    pub fn fill(&mut self, cloud: &PointCloud) -> Result<(), Error> {
        if cloud.len() >= EMPTY as usize {
            return Err(Error::TooMany { name: "cloud", len: cloud.len(), max: EMPTY as usize - 1 });
        }
        let ring = match (&self.params.row_source, cloud.ring()) {
            (RowSource::Ring, None) => return Err(Error::Empty { name: "ring channel" }),
            (RowSource::Ring, ring) => ring,
            _ => None,
        };
        self.ranges.fill(f32::INFINITY);
        self.points.fill(EMPTY);
        for (index, point) in cloud.points().enumerate() {
            let range = point.norm();
            if !(range.is_finite() && range > 0.0) {
                continue;
            }
            let row = match ring {
                Some(ring) => ring.get(index).map(|&row| usize::from(row)),
                None => self.row_at((point.z / range).asin()),
            };
            let Some(row) = row.filter(|&row| row < self.params.rows) else { continue };
            let cell = row * self.params.columns + self.column_at(point.y.atan2(point.x));
            // Row and column are below the image's size, so the cell exists.
            if range < self.ranges[cell] {
                (self.ranges[cell], self.points[cell]) = (range, index as u32);
            }
        }
        Ok(())
    }

    /// Number of laser lines.
    pub const fn rows(&self) -> usize {
        self.params.rows
    }

    /// Number of directions.
    pub const fn columns(&self) -> usize {
        self.params.columns
    }

    /// Range in metres; `None` where nothing was measured or outside the image.
    #[inline]
    pub fn range(&self, row: usize, column: usize) -> Option<f32> {
        self.cell(row, column).and_then(|cell| self.ranges.get(cell)).copied().filter(|range| range.is_finite())
    }

    /// Index of the cell's point in the cloud; `None` where nothing was measured or outside the image.
    #[inline]
    pub fn point_index(&self, row: usize, column: usize) -> Option<usize> {
        let point = self.cell(row, column).and_then(|cell| self.points.get(cell)).copied()?;
        (point != EMPTY).then_some(point as usize)
    }

    /// Ranges row by row, in metres; +∞ where nothing was measured.
    pub fn ranges(&self) -> &[f32] {
        &self.ranges
    }

    /// The column of an azimuth in radians, which is in [-π, π].
    #[inline]
    pub fn column_at(&self, azimuth: f32) -> usize {
        let column = (azimuth + PI) * (self.params.columns as f32 / TAU);
        // π itself, and what rounds up to the full turn, is the first column again.
        if column < self.params.columns as f32 { column as usize } else { 0 }
    }

    fn cell(&self, row: usize, column: usize) -> Option<usize> {
        (row < self.params.rows && column < self.params.columns).then(|| row * self.params.columns + column)
    }

    /// The line nearest to an elevation in radians; `None` more than half a line outside of the field of view.
    fn row_at(&self, elevation: f32) -> Option<usize> {
        match &self.params.row_source {
            RowSource::Ring => None,
            RowSource::Uniform { bottom, top } => {
                let lines = self.params.rows.max(2) - 1;
                let row = ((elevation - bottom) * (lines as f32 / (top - bottom))).round();
                (row >= 0.0).then_some(row as usize)
            }
            RowSource::Angles(angles) => {
                let last = angles.len() - 1;
                if last == 0 {
                    return elevation.is_finite().then_some(0);
                }
                // Outside, these are the two lines at the edge.
                let after = angles.partition_point(|angle| *angle < elevation).clamp(1, last);
                let (below, above) = (angles[after - 1], angles[after]);
                let (up, down) = (elevation - below, above - elevation);
                let between = up >= 0.0 && down >= 0.0;
                let near = between || up.abs().min(down.abs()) <= 0.5 * (above - below);
                near.then_some(if up < down { after - 1 } else { after })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A full turn of every line, in firing order; distances differ from cell to cell.
    fn spin(rows: usize, columns: usize, angle: impl Fn(usize) -> f32) -> PointCloud {
        let cells = (0..columns).flat_map(|c| (0..rows).map(move |r| (r, c)));
        let points = cells.clone().map(|(r, c)| {
            let azimuth = (c as f32 + 0.5) / columns as f32 * TAU - PI;
            let (elevation, range) = (angle(r), 5.0 + (r * 7 + c) as f32 * 1e-3);
            let flat = range * elevation.cos();
            Vector3::new(flat * azimuth.cos(), flat * azimuth.sin(), range * elevation.sin())
        });
        PointCloud::from_points(points).with_ring(cells.map(|(r, _)| r as u16).collect()).unwrap()
    }

    /// Every point of 16, 32 and 64 lines is found in its own cell, whichever way rows are told.
    #[test]
    fn every_point_has_its_cell() {
        for rows in [16, 32, 64] {
            let columns = 360;
            let (bottom, top) = (-15_f32.to_radians(), 15_f32.to_radians());
            let uniform = move |r: usize| bottom + r as f32 * (top - bottom) / (rows - 1) as f32;
            let uneven = |r: usize| 0.2 * (r as f32 / 64.0).powi(2) - 0.1 + r as f32 * 1e-3;
            for (source, cloud) in [
                (RowSource::Ring, spin(rows, columns, uneven)),
                (RowSource::Uniform { bottom, top }, spin(rows, columns, uniform)),
                (RowSource::Angles((0..rows).map(uneven).collect()), spin(rows, columns, uneven)),
            ] {
                let mut image = RangeImage::new(RangeImageParams { rows, columns, row_source: source }).unwrap();
                image.fill(&cloud).unwrap();
                for c in 0..columns {
                    for r in 0..rows {
                        assert_eq!(image.point_index(r, c), Some(c * rows + r));
                        assert!((image.range(r, c).unwrap() - 5.0 - (r * 7 + c) as f32 * 1e-3).abs() < 1e-5);
                    }
                }
            }
        }
    }

    #[test]
    fn the_nearest_point_of_a_cell_counts_and_bad_ones_do_not() {
        let x = vec![5.0, 3.0, 4.0, f32::NAN, 0.0, 1.0];
        let cloud = PointCloud::new(x, vec![0.0; 6], vec![0.0; 6]).unwrap().with_ring(vec![0, 0, 0, 0, 0, 99]).unwrap();
        let mut image = RangeImage::new(RangeImageParams::default()).unwrap();
        image.fill(&cloud).unwrap();
        assert_eq!((image.point_index(0, 900), image.range(0, 900)), (Some(1), Some(3.0)));
        assert_eq!(image.ranges().iter().filter(|r| r.is_finite()).count(), 1);
        assert_eq!((image.range(16, 0), image.point_index(0, 1800)), (None, None));
        assert_eq!((image.column_at(PI), image.column_at(-PI)), (0, 0));
    }

    /// Half a line outside belongs to the line, more does not, whichever way elevations are told.
    #[test]
    fn what_is_far_from_every_line_is_left_out() {
        for source in [RowSource::Uniform { bottom: -0.1, top: 0.1 }, RowSource::Angles(vec![-0.1, 0.0, 0.1])] {
            let params = RangeImageParams { rows: 3, columns: 10, row_source: source };
            let image = RangeImage::new(params.clone()).unwrap();
            let rows = [-1.5, -0.16, -0.14, -0.06, -0.04, 0.04, 0.06, 0.14].map(|elevation| image.row_at(elevation));
            assert_eq!(rows, [None, None, Some(0), Some(0), Some(1), Some(1), Some(2), Some(2)], "{params:?}");
            assert!(image.row_at(0.16).is_none_or(|row| row >= 3) && image.row_at(1.5).is_none_or(|row| row >= 3));
            assert_eq!(image.row_at(f32::NAN), None);
        }
        let one = RangeImageParams { rows: 1, columns: 10, row_source: RowSource::Angles(vec![0.0]) };
        assert_eq!(RangeImage::new(one).unwrap().row_at(-1.2), Some(0));
    }

    #[test]
    fn bad_input_is_refused() {
        let good = RangeImageParams::default();
        let uniform = |bottom, top| RowSource::Uniform { bottom, top };
        for bad in [
            RangeImageParams { rows: 0, ..good.clone() },
            RangeImageParams { columns: 0, ..good.clone() },
            RangeImageParams { columns: usize::MAX, ..good.clone() },
            RangeImageParams { row_source: uniform(0.1, 0.1), ..good.clone() },
            RangeImageParams { row_source: uniform(f32::NAN, 0.1), ..good.clone() },
            RangeImageParams { row_source: uniform(0.0, f32::INFINITY), ..good.clone() },
            RangeImageParams { row_source: RowSource::Angles(vec![0.0]), ..good.clone() },
            RangeImageParams { rows: 2, row_source: RowSource::Angles(vec![0.1, 0.0]), ..good.clone() },
            RangeImageParams { rows: 2, row_source: RowSource::Angles(vec![0.1, 0.1]), ..good.clone() },
        ] {
            assert!(RangeImage::new(bad.clone()).is_err(), "{bad:?}");
        }
        let mut image = RangeImage::new(good).unwrap();
        assert!(image.fill(&PointCloud::from_points([Vector3::x()])).is_err());
    }
}
