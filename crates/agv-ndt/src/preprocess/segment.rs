//! Clusters of a range image: neighbours that lie on one object share a label.
//!
//! Bogoslavskyi and Stachniss, *Fast range image-based segmentation of sparse 3D laser scans*, 2016, as LeGO-LOAM and paper 003 have it:
//! of two neighbouring beams at the angle `α`, with the ranges `d1 >= d2`, the angle
//!
//! ```text
//! β = atan2(d2 sin α, d1 - d2 cos α)
//! ```
//!
//! between the longer beam and the line through both points is large on one object and small across a gap. Clusters are filled from
//! cell to cell; small ones, as leaves make them, are dropped.

use crate::Error;
use agv_core::{check, sensors::RangeImage};
use std::f32::consts::TAU;

/// What makes a cluster.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SegmentParams {
    /// Least `β` of one object, in radians.
    pub min_angle: f64,
    /// Angle between neighbouring laser lines, in radians.
    pub line_angle: f64,
    /// Fewest cells of a cluster, ...
    pub min_cells: usize,
    /// ... or, for narrow ones as posts are, fewest cells ...
    pub min_narrow_cells: usize,
    /// ... and fewest laser lines that they are on.
    pub min_lines: usize,
}

impl Default for SegmentParams {
    /// LeGO-LOAM's: 60°; 30 cells, or 5 on 3 lines; the 2° of its 16 lines.
    fn default() -> Self {
        Self {
            min_angle: 60_f64.to_radians(),
            line_angle: 2_f64.to_radians(),
            min_cells: 30,
            min_narrow_cells: 5,
            min_lines: 3,
        }
    }
}

/// Labels the cells of range images; buffers are used again.
///
/// ```
/// use agv_core::{nalgebra::Vector3, sensors::{PointCloud, RangeImage, RangeImageParams}};
/// use agv_ndt::preprocess::{SegmentParams, Segmenter};
///
/// // Two posts, 30 cm wide, one behind the other and beside it.
/// let beam = |i: u16| (f32::from(i / 16) * 0.0035 - 0.1, (f32::from(i % 16) * 2.0_f32 - 15.0).to_radians());
/// let post = |(a, e): (f32, f32)| Vector3::new(a.cos(), a.sin(), e.tan()) * if a < 0.0 { 5.0 } else { 8.0 };
/// let cloud = PointCloud::from_points((0..900).map(beam).map(post)).with_ring((0..900).map(|i| i % 16).collect())?;
/// let mut image = RangeImage::new(RangeImageParams::default())?;
/// image.fill(&cloud)?;
/// let mut segmenter = Segmenter::new(SegmentParams::default())?;
/// assert_eq!(segmenter.segment(&image, |_, _| false), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Segmenter {
    params: SegmentParams,
    /// Row by row: zero for none.
    labels: Vec<u32>,
    columns: usize,
    queue: Vec<u32>,
}

/// Label of cells that were looked at and belong to no cluster.
const DROPPED: u32 = u32::MAX;

impl Segmenter {
    /// A segmenter with these parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: SegmentParams) -> Result<Self, Error> {
        check::in_range("min_angle", params.min_angle, 0.0, std::f64::consts::FRAC_PI_2)?;
        check::positive("line_angle", params.line_angle)?;
        check::in_range("line_angle", params.line_angle, 0.0, 0.5)?;
        check::at_least("min_cells", params.min_cells, 1)?;
        check::at_least("min_narrow_cells", params.min_narrow_cells, 1)?;
        Ok(Self { params, labels: Vec::new(), columns: 0, queue: Vec::new() })
    }

    /// Labels the image's cells, without those for which `leave_out(row, column)` is true, as the ground is; says how many clusters
    /// there are, numbered from 1 in the order of their first cells. Linear in the cells.
    pub fn segment(&mut self, image: &RangeImage, leave_out: impl Fn(usize, usize) -> bool) -> u32 {
        let (rows, columns) = (image.rows(), image.columns());
        self.columns = columns;
        self.labels.clear();
        self.labels.resize(rows * columns, 0);
        let (along, across) = (TAU / columns as f32, self.params.line_angle as f32);
        let tangent = self.params.min_angle.tan() as f32;
        let one_object = |a: f32, b: f32, angle: f32| {
            let (far, near) = (a.max(b), a.min(b));
            // tan β; beyond a right angle the other side is nearer than straight across.
            let ahead = far - near * angle.cos();
            ahead <= 0.0 || near * angle.sin() > tangent * ahead
        };
        let mut clusters = 0;
        for start in 0..rows * columns {
            let (row, column) = (start / columns, start % columns);
            if self.labels[start] != 0 || image.range(row, column).is_none() || leave_out(row, column) {
                continue;
            }
            let label = clusters + 1;
            self.queue.clear();
            self.queue.push(start as u32);
            self.labels[start] = label;
            let (mut next, mut lines, mut last_row) = (0, 0, usize::MAX);
            while let Some(&cell) = self.queue.get(next) {
                next += 1;
                let (row, column) = (cell as usize / columns, cell as usize % columns);
                let Some(here) = image.range(row, column) else { continue };
                // Neighbours of a full turn; none beyond the lowest and highest line.
                let neighbours = [
                    (row, (column + 1) % columns, along),
                    (row, (column + columns - 1) % columns, along),
                    (row + 1, column, across),
                    (row.wrapping_sub(1), column, across),
                ];
                for (row, column, angle) in neighbours {
                    let Some(range) = image.range(row, column) else { continue };
                    let cell = row * columns + column;
                    if self.labels[cell] == 0 && one_object(here, range, angle) && !leave_out(row, column) {
                        self.labels[cell] = label;
                        self.queue.push(cell as u32);
                    }
                }
            }
            self.queue.sort_unstable();
            for &cell in &self.queue {
                let row = cell as usize / columns;
                lines += usize::from(row != last_row);
                last_row = row;
            }
            let narrow = self.queue.len() >= self.params.min_narrow_cells && lines >= self.params.min_lines;
            if self.queue.len() >= self.params.min_cells || narrow {
                clusters = label;
            } else {
                self.queue.iter().for_each(|&cell| self.labels[cell as usize] = DROPPED);
            }
        }
        clusters
    }

    /// Label of a cell of the last image; `None` for one without return, left out, of a small cluster, or outside.
    pub fn label(&self, row: usize, column: usize) -> Option<u32> {
        let cell = (column < self.columns).then(|| row.checked_mul(self.columns)?.checked_add(column)).flatten()?;
        self.labels.get(cell).copied().filter(|&label| label != 0 && label != DROPPED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        geometry::Se3,
        sensors::{PointCloud, RangeImageParams},
    };
    use nalgebra::Vector3;

    /// An image of 16 lines 2° apart and 360 columns that look at what has this range; none for zero.
    fn image(range: impl Fn(usize, usize) -> f32) -> RangeImage {
        let (mut points, mut rings) = (Vec::new(), Vec::new());
        for (row, column) in (0..16).flat_map(|row| (0..360).map(move |column| (row, column))) {
            let azimuth = (column as f32 + 0.5) * TAU / 360.0 - TAU / 2.0;
            let elevation = (row as f32 * 2.0 - 15.0).to_radians();
            let direction =
                Vector3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
            if range(row, column) > 0.0 {
                points.push(direction * range(row, column));
                rings.push(row as u16);
            }
        }
        let cloud = PointCloud::from_points(points).with_ring(rings).unwrap().with_mount(Se3::default()).unwrap();
        let mut image = RangeImage::new(RangeImageParams { columns: 360, ..Default::default() }).unwrap();
        image.fill(&cloud).unwrap();
        image
    }

    fn segment(image: &RangeImage) -> (u32, Segmenter) {
        let mut segmenter = Segmenter::new(SegmentParams::default()).unwrap();
        (segmenter.segment(image, |_, _| false), segmenter)
    }

    #[test]
    fn objects_apart_in_depth_or_angle_are_clusters_and_specks_are_not() {
        // A round room with a box before its wall, and a speck of two cells in between.
        let image = image(|row, column| match (row, column) {
            (4..=9, 100..=119) => 4.0,
            (12, 200..=201) => 6.0,
            _ => 10.0,
        });
        let (clusters, segmenter) = segment(&image);
        assert_eq!(clusters, 2);
        assert_eq!(segmenter.label(0, 0), segmenter.label(15, 359), "the turn is closed");
        assert_eq!(segmenter.label(4, 100), segmenter.label(9, 119));
        assert_ne!(segmenter.label(4, 100), segmenter.label(4, 99));
        assert_eq!((segmenter.label(12, 200), segmenter.label(16, 0), segmenter.label(0, 360)), (None, None, None));
    }

    #[test]
    fn a_post_counts_by_its_lines_and_what_is_left_out_parts() {
        let post = image(|row, column| if row < 6 && column == 50 { 5.0 } else { 0.0 });
        assert_eq!(segment(&post).0, 1);
        let stroke = image(|row, column| if row == 3 && column < 6 { 5.0 } else { 0.0 });
        assert_eq!(segment(&stroke).0, 0);
        let room = image(|_, _| 8.0);
        let mut segmenter = Segmenter::new(SegmentParams::default()).unwrap();
        assert_eq!(segmenter.segment(&room, |row, _| row == 8), 2);
        assert_eq!(segmenter.label(8, 5), None);
        assert_eq!(segmenter.segment(&image(|_, _| 0.0), |_, _| false), 0);
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = SegmentParams::default();
        for bad in [
            SegmentParams { min_angle: f64::NAN, ..good },
            SegmentParams { line_angle: 0.0, ..good },
            SegmentParams { min_cells: 0, ..good },
            SegmentParams { min_narrow_cells: 0, ..good },
        ] {
            assert!(Segmenter::new(bad).is_err(), "{bad:?}");
        }
    }
}
