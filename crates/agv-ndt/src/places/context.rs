//! The descriptor: how high the surroundings reach, by ring and sector (Kim and Kim, *Scan Context*, 2018).
//!
//! The floor around the base is cut into rings and sectors, and each of their cells gets the greatest height of its points. Turning
//! the vehicle shifts the sectors round, so that two views of one place differ by a shift alone, and the mean height of each ring,
//! the *ring key*, by nothing at all. The mean height of each sector, the *sector key*, tells the shift at a glance.

use agv_core::{Error, check, sensors::PointCloud};
use std::f64::consts::{PI, TAU};

/// Columns are filled up to a multiple of this, so that products of them run in whole registers.
const LANES: usize = 8;

/// How clouds are described.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ScanContextParams {
    /// Rings around the base; at most 256.
    pub rings: usize,
    /// Sectors of a turn; at most 1024.
    pub sectors: usize,
    /// Outer radius of the outermost ring, in metres.
    pub max_range: f64,
    /// Height in the base frame that counts as zero, in metres; lower points are left out.
    pub floor: f64,
    /// Height in the base frame above which points are left out, in metres: below a roof, which hides what stands under it.
    pub ceiling: f64,
    /// Places whose ring keys are nearest, of which the sectors are compared.
    pub candidates: usize,
    /// Share of all shifts that is tried around the one that the sector keys suggest, in (0, 1].
    pub shifts: f64,
}

impl Default for ScanContextParams {
    /// 20 rings and 60 sectors, ten candidates and a tenth of the shifts (Kim and Kim 2018); 40 m instead of their 80, and up to 8 m,
    /// for halls instead of streets.
    fn default() -> Self {
        Self { rings: 20, sectors: 60, max_range: 40.0, floor: -0.5, ceiling: 8.0, candidates: 10, shifts: 0.1 }
    }
}

impl ScanContextParams {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("rings", self.rings as f64, 1.0, 256.0)?;
        check::in_range("sectors", self.sectors as f64, 1.0, 1024.0)?;
        check::positive("max_range", self.max_range)?;
        check::finite("floor", self.floor)?;
        check::finite("ceiling", self.ceiling)?;
        check::positive("ceiling above the floor", self.ceiling - self.floor)?;
        check::at_least("candidates", self.candidates, 1)?;
        check::positive("shifts", self.shifts)?;
        check::in_range("shifts", self.shifts, 0.0, 1.0)?;
        Ok(())
    }

    /// Values of a column with those that fill it up.
    pub(super) const fn column(&self) -> usize {
        self.rings.next_multiple_of(LANES)
    }
}

/// What one cloud looks like. Its memory is used again.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScanContext {
    /// Heights by sector, each sector from the innermost ring on, scaled to unit length; zeros where nothing stands.
    pub(super) columns: Vec<f32>,
    /// Mean height of each ring, in metres, filled up as a column is.
    pub(super) ring_key: Vec<f32>,
    /// Mean height of each sector, in metres.
    pub(super) sector_key: Vec<f32>,
}

impl ScanContext {
    /// Whether no point of the cloud was within reach: it looks like nothing.
    pub fn is_empty(&self) -> bool {
        self.ring_key.iter().all(|height| *height == 0.0)
    }

    /// Describes a cloud; parameters are valid.
    pub(super) fn rebuild(&mut self, cloud: &PointCloud, params: &ScanContextParams) {
        let (rings, sectors, column) = (params.rings, params.sectors, params.column());
        refill(&mut self.columns, sectors * column);
        refill(&mut self.ring_key, column);
        refill(&mut self.sector_key, sectors);
        let mount = cloud.base_from_sensor();
        let (rotation, translation) = (mount.rotation().matrix(), mount.translation());
        let (per_metre, per_radian) = (rings as f64 / params.max_range, sectors as f64 / TAU);
        for point in cloud.points() {
            let point = rotation * point.cast::<f64>() + translation;
            let range = point.x.hypot(point.y);
            let inside = range < params.max_range && point.z > params.floor && point.z <= params.ceiling;
            // As NaN is not.
            if !inside {
                continue;
            }
            let ring = ((range * per_metre) as usize).min(rings - 1);
            let sector = (((point.y.atan2(point.x) + PI) * per_radian) as usize).min(sectors - 1);
            let cell = &mut self.columns[sector * column + ring];
            *cell = cell.max((point.z - params.floor) as f32);
        }
        for (heights, mean) in self.columns.chunks_exact_mut(column).zip(&mut self.sector_key) {
            for (sum, height) in self.ring_key.iter_mut().zip(&*heights) {
                *sum += height / sectors as f32;
            }
            *mean = heights.iter().sum::<f32>() / rings as f32;
            let square: f32 = heights.iter().map(|height| height * height).sum();
            if square > 0.0 {
                let scale = 1.0 / square.sqrt();
                for height in heights {
                    *height *= scale;
                }
            }
        }
    }
}

fn refill(values: &mut Vec<f32>, len: usize) {
    values.clear();
    values.resize(len, 0.0);
}

/// Squared distance of two lists.
pub(super) fn square_distance(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; LANES];
    for (a, b) in a.chunks(LANES).zip(b.chunks(LANES)) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += (a - b) * (a - b);
        }
    }
    sums.iter().sum()
}

/// Product of two columns.
pub(super) fn product(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::{Se3, So3};
    use nalgebra::Vector3;

    #[test]
    fn a_cell_has_the_greatest_height_of_its_points() {
        let params = ScanContextParams { rings: 4, sectors: 4, max_range: 8.0, floor: -1.0, ..Default::default() };
        let points = [[3.0, 0.5, 0.5], [3.0, 0.6, 2.0], [-7.0, -1.0, 0.0], [9.0, 0.0, 1.0], [1.0, 1.0, 9.0]];
        let unseen = [[f32::NAN, 0.0, 1.0], [0.0, f32::INFINITY, 1.0], [1.0, 0.1, f32::NAN], [1.0, 0.1, -2.1]];
        let cloud = PointCloud::from_points(points.into_iter().chain(unseen).map(Vector3::from));
        let mut context = ScanContext::default();
        context.rebuild(&cloud, &params);
        // Sector 2 begins at the x axis, sector 0 opposite; rings are 2 m wide.
        assert_eq!(context.sector_key, [0.25, 0.0, 0.75, 0.0]);
        assert_eq!(context.ring_key[..4], [0.0, 0.75, 0.0, 0.25]);
        let mounted = cloud.with_mount(Se3::from_parts(Vector3::new(0.0, 0.0, 1.0), So3::default())).unwrap();
        context.rebuild(&mounted, &params);
        assert_eq!(context.ring_key[..4], [0.0, 1.0, 0.0, 0.5], "heights are those above the base");
        context.rebuild(&PointCloud::default(), &params);
        assert!(context.is_empty());
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = ScanContextParams::default();
        assert_eq!(good.validate(), Ok(()));
        for bad in [
            ScanContextParams { rings: 0, ..good },
            ScanContextParams { rings: 257, ..good },
            ScanContextParams { sectors: 0, ..good },
            ScanContextParams { sectors: 1025, ..good },
            ScanContextParams { max_range: 0.0, ..good },
            ScanContextParams { max_range: f64::NAN, ..good },
            ScanContextParams { floor: f64::NEG_INFINITY, ..good },
            ScanContextParams { ceiling: f64::NAN, ..good },
            ScanContextParams { ceiling: good.floor, ..good },
            ScanContextParams { candidates: 0, ..good },
            ScanContextParams { shifts: 0.0, ..good },
            ScanContextParams { shifts: 1.1, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
