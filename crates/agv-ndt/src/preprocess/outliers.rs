//! Statistical outlier removal: points far from their neighbours, as rain, dust and the rims of objects make them.
//!
//! With the mean distance `d_i` of each point to its nearest neighbours, points with `d_i > mean + factor · sd` of all `d` go (Rusu et al.,
//! *Towards 3D point cloud based object maps for household environments*, 2008; PCL's filter of that name).

use super::kd_tree::{KdTree, MAX_NEIGHBOURS, Neighbour};
use crate::Error;
use agv_core::{
    check,
    compute::{CHUNK, Par},
    sensors::{PointCloud, PointSource},
};

/// What counts as an outlier.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OutlierParams {
    /// Neighbours that are looked at, the point itself not included: 1 to 31.
    pub neighbours: usize,
    /// Standard deviations beyond the mean.
    pub factor: f64,
}

impl Default for OutlierParams {
    /// 20 neighbours and two standard deviations.
    fn default() -> Self {
        Self { neighbours: 20, factor: 2.0 }
    }
}

/// Removes outliers from clouds; buffers are used again.
///
/// ```
/// use agv_core::{compute::Par, nalgebra::Vector3, sensors::PointCloud};
/// use agv_ndt::preprocess::{OutlierFilter, OutlierParams};
///
/// let floor = (0..900_u16).map(|i| Vector3::new(f32::from(i % 30) * 0.1, f32::from(i / 30) * 0.1, 0.0));
/// let mut cloud = PointCloud::from_points(floor.chain([Vector3::new(1.0, 1.0, 5.0)]));
/// assert_eq!(OutlierFilter::new(OutlierParams::default())?.filter(&mut cloud, Par::Seq), 1);
/// assert!(cloud.z().iter().all(|z| *z == 0.0));
/// # Ok::<(), agv_ndt::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct OutlierFilter {
    params: OutlierParams,
    tree: KdTree,
    distances: Vec<f32>,
}

impl OutlierFilter {
    /// A filter with these parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: OutlierParams) -> Result<Self, Error> {
        check::in_range("neighbours", params.neighbours as f64, 1.0, MAX_NEIGHBOURS as f64 - 1.0)?;
        check::non_negative("factor", params.factor)?;
        Ok(Self { params, tree: KdTree::default(), distances: Vec::new() })
    }

    /// Drops outliers and points that are not finite, with all channels, and says how many. O(n log n), parallel over points, the same
    /// for any number of threads.
    pub fn filter(&mut self, cloud: &mut PointCloud, par: Par) -> usize {
        let before = cloud.len();
        self.tree.rebuild(cloud);
        self.distances.clear();
        self.distances.resize(before, f32::NAN);
        let (tree, points, wanted) = (&self.tree, &*cloud, self.params.neighbours + 1);
        par.for_each_chunk(self.distances.as_mut_slice(), CHUNK, |chunk, distances| {
            for (offset, distance) in distances.iter_mut().enumerate() {
                let mut near = [Neighbour::default(); MAX_NEIGHBOURS];
                let count =
                    tree.nearest_into(&points.point(chunk * CHUNK + offset), f32::INFINITY, &mut near[..wanted]);
                // The nearest is the point itself.
                if count > 1 {
                    let sum: f32 = near[1..count].iter().map(|neighbour| neighbour.squared_distance.sqrt()).sum();
                    *distance = sum / (count - 1) as f32;
                }
            }
        });
        let known = || self.distances.iter().filter(|d| d.is_finite()).map(|&d| f64::from(d));
        let count = known().count().max(1) as f64;
        let mean = known().sum::<f64>() / count;
        let variance = known().map(|d| (d - mean) * (d - mean)).sum::<f64>() / count;
        // What rounding alone tells apart is no outlier.
        let most = mean + self.params.factor * variance.sqrt() + 1e-6 * mean;
        let distances = &self.distances;
        cloud.retain(|index, _| f64::from(distances[index]) <= most);
        before - cloud.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{ROOM, sheets};
    use nalgebra::Vector3;

    #[test]
    fn specks_go_surfaces_stay_for_any_threads() {
        let room: Vec<_> = sheets(&ROOM, 60.0, 0).iter().map(|p| p.cast::<f32>()).collect();
        let specks = (0..30_u8).map(|i| Vector3::new(20.0 + f32::from(i) * 3.0, -15.0, f32::from(i % 5)));
        let nowhere = [Vector3::repeat(f32::NAN), Vector3::repeat(f32::INFINITY)];
        let all = PointCloud::from_points(room.iter().copied().chain(specks).chain(nowhere));
        let run = |par| {
            let mut cloud = all.clone();
            let removed = OutlierFilter::new(OutlierParams::default()).unwrap().filter(&mut cloud, par);
            (removed, cloud)
        };
        let (removed, cloud) = run(Par::Seq);
        assert!((32..32 + room.len() / 20).contains(&removed), "{removed}");
        assert!(cloud.x().iter().all(|x| *x < 15.0));
        assert_eq!(run(Par::threads(3)), (removed, cloud));
    }

    #[test]
    fn few_points_and_even_grids_lose_nothing_that_is_finite() {
        let mut filter = OutlierFilter::new(OutlierParams::default()).unwrap();
        let mut pair = PointCloud::from_points([Vector3::zeros(), Vector3::repeat(1.0)]);
        assert_eq!((filter.filter(&mut pair, Par::Seq), pair.len()), (0, 2));
        let mut heap = PointCloud::from_points([Vector3::repeat(2.0); 50]);
        assert_eq!((filter.filter(&mut heap, Par::Seq), heap.len()), (0, 50));
        assert_eq!(filter.filter(&mut PointCloud::default(), Par::Seq), 0);
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = OutlierParams::default();
        for bad in [
            OutlierParams { neighbours: 0, ..good },
            OutlierParams { neighbours: 32, ..good },
            OutlierParams { factor: -1.0, ..good },
            OutlierParams { factor: f64::NAN, ..good },
        ] {
            assert!(OutlierFilter::new(bad).is_err(), "{bad:?}");
        }
    }
}
