//! Voxel down-sampling: one point per occupied cube, the centroid of what was in it.
//!
//! A [`CellTable`] maps a voxel's packed indices to its place in the output, so the cost is one look-up a
//! point and the order of the output is that in which the voxels first appeared; no sort, and no hash order in the
//! result. Sums are kept relative to the voxel's first point: a cloud far from its origin loses nothing.

use super::{
    PointCloud,
    cells::{self, CellTable, pack_within},
};
use crate::{Error, check};

/// Voxels to either side of the origin that the packed index holds.
const REACH: f32 = cells::REACH as f32;

/// Not the key of any voxel.
const NO_KEY: u64 = u64::MAX;

/// Down-samples clouds; the buffers are reused, so that nothing is allocated once they have grown.
///
/// Channels: intensity is the mean of the voxel's points; ring and time are those of its first point.
///
/// ```
/// use agv_core::sensors::{PointCloud, VoxelGrid};
///
/// let cloud = PointCloud::new(vec![0.25, 0.75, 1.5], vec![0.0; 3], vec![0.0; 3])?;
/// let mut out = PointCloud::default();
/// VoxelGrid::new(1.0)?.filter_into(&cloud, &mut out);
/// assert_eq!(out.x(), [0.5, 1.5]);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct VoxelGrid {
    leaf: f32,
    table: CellTable,
    sums: Vec<Sum>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    first: [f32; 3],
    offset: [f32; 3],
    intensity: f32,
    count: f32,
}

impl VoxelGrid {
    /// A filter with cubes of `leaf` metres.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] unless `leaf` is from 1 mm to 1 km.
    pub fn new(leaf: f32) -> Result<Self, Error> {
        check::in_range("leaf", f64::from(leaf), 0.001, 1000.0)?;
        Ok(Self { leaf, table: CellTable::default(), sums: Vec::new() })
    }

    /// Size of the cubes, in metres.
    pub const fn leaf(&self) -> f32 {
        self.leaf
    }

    /// Writes the down-sampled `cloud` to `out`, voxels in the order of their first points; linear in the points.
    ///
    /// Points with a coordinate that is not finite, or more than 2²⁰ voxels from the origin, are dropped.
    pub fn filter_into(&mut self, cloud: &PointCloud, out: &mut PointCloud) {
        (out.stamp, out.sensor, out.base_from_sensor) = (cloud.stamp, cloud.sensor, cloud.base_from_sensor);
        let mut ring = restart(&mut out.ring, cloud.ring.as_ref());
        let mut time = restart(&mut out.time, cloud.time.as_ref());
        self.sums.clear();
        self.table.clear();
        let per_leaf = 1.0 / self.leaf;
        // Neighbouring points of a scan line mostly share a voxel: the last one is tried before the table.
        let (mut last_key, mut last_voxel) = (NO_KEY, 0);
        for (index, ((&x, &y), &z)) in cloud.x.iter().zip(&cloud.y).zip(&cloud.z).enumerate() {
            let Some(key) = pack(x * per_leaf, y * per_leaf, z * per_leaf) else { continue };
            if key != last_key {
                (last_key, last_voxel) = (key, self.table.get_or_insert(key, self.sums.len() as u32) as usize);
            }
            if last_voxel == self.sums.len() {
                self.sums.push(Sum { first: [x, y, z], ..Sum::default() });
                if let (Some(to), Some(from)) = (&mut ring, &cloud.ring) {
                    to.push(from[index]);
                }
                if let (Some(to), Some(from)) = (&mut time, &cloud.time) {
                    to.push(from[index]);
                }
            }
            // The table gives at most the number of voxels, and that one was pushed just now.
            let sum = &mut self.sums[last_voxel];
            sum.offset[0] += x - sum.first[0];
            sum.offset[1] += y - sum.first[1];
            sum.offset[2] += z - sum.first[2];
            sum.count += 1.0;
            if let Some(intensity) = &cloud.intensity {
                sum.intensity += intensity[index];
            }
        }
        let centroid = |axis: usize| self.sums.iter().map(move |s| s.first[axis] + s.offset[axis] / s.count);
        refill(&mut out.x, centroid(0));
        refill(&mut out.y, centroid(1));
        refill(&mut out.z, centroid(2));
        if let Some(to) = restart(&mut out.intensity, cloud.intensity.as_ref()) {
            to.extend(self.sums.iter().map(|s| s.intensity / s.count));
        }
    }
}

/// Three voxel indices of 21 bits; `None` out of reach, and for NaN.
#[inline]
fn pack(x: f32, y: f32, z: f32) -> Option<u64> {
    // In `f32`: as `cells::floor`, without a conversion.
    let floor = |v: f32| {
        let whole = v as i32;
        whole - i32::from((whole as f32) > v)
    };
    if !(x.abs() < REACH && y.abs() < REACH && z.abs() < REACH) {
        return None;
    }
    Some(pack_within([floor(x), floor(y), floor(z)]))
}

/// Empties an optional channel of the output, or makes it absent as it is in the input.
fn restart<'a, T>(channel: &'a mut Option<Vec<T>>, like: Option<&Vec<T>>) -> Option<&'a mut Vec<T>> {
    if like.is_none() {
        *channel = None;
        return None;
    }
    let channel = channel.get_or_insert_default();
    channel.clear();
    Some(channel)
}

fn refill(channel: &mut Vec<f32>, values: impl Iterator<Item = f32>) {
    channel.clear();
    channel.extend(values);
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        /// Against sorted bins in f64: the same voxels, the same centroids, counts through the mean intensity.
        #[test]
        fn centroids_are_those_of_sorted_bins(
            points in prop::collection::vec(prop::array::uniform3(-3.0..3.0_f32), 0..300),
            shift in prop_oneof![Just(0.0_f32), Just(500.0), Just(-7e4)],
        ) {
            let points: Vec<Vector3<f32>> = points.iter().map(|p| Vector3::from(*p).add_scalar(shift)).collect();
            let intensity: Vec<f32> = (0..points.len()).map(|i| (i % 16) as f32).collect();
            let cloud = PointCloud::from_points(points.iter().copied()).with_intensity(intensity.clone()).unwrap();
            let mut out = PointCloud::default();
            VoxelGrid::new(0.5).unwrap().filter_into(&cloud, &mut out);

            let mut bins: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
            for (i, p) in points.iter().enumerate() {
                bins.entry([0, 1, 2].map(|k| (p[k] * 2.0).floor() as i64)).or_default().push(i);
            }
            let mut expected: Vec<&Vec<usize>> = bins.values().collect();
            expected.sort_by_key(|members| members[0]);
            prop_assert_eq!(out.len(), expected.len());
            for (k, members) in expected.iter().enumerate() {
                let n = members.len() as f64;
                let mean = members.iter().map(|&i| points[i].cast::<f64>()).sum::<Vector3<f64>>() / n;
                let value = members.iter().map(|&i| f64::from(intensity[i])).sum::<f64>() / n;
                let found = out.points().nth(k).unwrap().cast::<f64>();
                prop_assert!((found - mean).norm() < 1e-6 + 2e-7 * mean.norm(), "{} {}", found, mean);
                prop_assert!((f64::from(out.intensity().unwrap()[k]) - value).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn first_ring_and_time_are_kept_and_bad_points_dropped() {
        let x = vec![f32::NAN, 0.1, 0.2, f32::INFINITY, 5.0, 3e6, -3e6];
        let n = x.len() as u16;
        let cloud = PointCloud::new(x, vec![0.0; 7], vec![0.0; 7])
            .and_then(|c| c.with_ring((0..n).collect()))
            .and_then(|c| c.with_time((0..n).map(f32::from).collect()))
            .unwrap();
        let mut out = PointCloud::from_points([]).with_intensity(vec![]).unwrap();
        VoxelGrid::new(1.0).unwrap().filter_into(&cloud, &mut out);
        assert_eq!((out.ring(), out.time()), (Some(&[1_u16, 4][..]), Some(&[1.0_f32, 4.0][..])));
        assert_eq!(out.intensity(), None);
        out.remove_non_finite();
        assert_eq!(out.len(), 2);
    }

    /// More voxels than the first table holds, and a second run that gives the same bits.
    #[test]
    fn the_table_grows_and_runs_repeat() {
        let points = (0..20_000_i32).map(|i| Vector3::new((i % 200) as f32, (i / 200) as f32, 0.5));
        let cloud = PointCloud::from_points(points);
        let (mut grid, mut a, mut b) = (VoxelGrid::new(1.0).unwrap(), PointCloud::default(), PointCloud::default());
        grid.filter_into(&cloud, &mut a);
        grid.filter_into(&cloud, &mut b);
        assert_eq!(a.len(), 20_000);
        assert_eq!(a, b);
        grid.filter_into(&PointCloud::default(), &mut a);
        assert!(a.is_empty());
    }

    #[test]
    fn bad_leaves_are_refused() {
        for leaf in [0.0, -1.0, 1e-6, 1e9, f32::NAN, f32::INFINITY] {
            assert!(VoxelGrid::new(leaf).is_err(), "{leaf}");
        }
    }
}
