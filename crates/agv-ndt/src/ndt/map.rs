//! The map of the normal distributions transform: point sums per voxel, over a hash table of voxels.

use super::gaussian::{Gaussian3, STEPS, VoxelParams, VoxelSums, regularized};
use crate::Error;
#[cfg(feature = "serde")]
use crate::cells::REACH;
use crate::cells::{CellTable, floor, pack, pack_within};
#[cfg(feature = "serde")]
use agv_core::check;
use agv_core::{
    geometry::{LieGroup, Se3},
    sensors::PointSource,
};
use nalgebra::{Matrix3, Vector3};

/// A map that clouds are added to, and that can be merged with others of the same voxels: in any order, to the same bits.
///
/// Voxel `(i, j, k)` spans `i` to `i + 1` times the resolution along x, and so on; there is no bound but 2²⁰ voxels to either
/// side of the origin. About 150 bytes a voxel; adding is linear in the points.
///
/// ```
/// use agv_core::{geometry::Se3, nalgebra::Vector3, sensors::PointCloud};
/// use agv_ndt::ndt::{NdtMap, VoxelParams};
///
/// // A floor.
/// let points = (0..400).map(|i| Vector3::new((i % 20) as f32 * 0.1, (i / 20) as f32 * 0.1, 0.3));
/// let mut map = NdtMap::new(VoxelParams::default())?;
/// map.insert(&PointCloud::from_points(points), &Se3::default());
/// let floor = map.gaussian([1, 1, 0]).ok_or("no points there")?;
/// assert!((floor.mean - Vector3::new(1.45, 1.45, 0.3)).norm() < 1e-3);
/// assert!(floor.covariance[(2, 2)] < 0.02 * floor.covariance[(0, 0)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawMap", into = "RawMap")
)]
pub struct NdtMap {
    params: VoxelParams,
    table: CellTable,
    cells: Vec<[i32; 3]>,
    sums: Vec<VoxelSums>,
}

/// A map as it is stored.
#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
struct RawMap {
    params: VoxelParams,
    voxels: Vec<([i32; 3], VoxelSums)>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawMap> for NdtMap {
    type Error = Error;

    fn try_from(raw: RawMap) -> Result<Self, Error> {
        let mut map = Self::new(raw.params)?;
        for (number, (cell, sums)) in raw.voxels.into_iter().enumerate() {
            check::at_least("points of a stored voxel", sums.count() as usize, 1)?;
            for index in cell {
                check::in_range("index of a stored voxel", f64::from(index), f64::from(-REACH), f64::from(REACH - 1))?;
            }
            if let Some(slot) = map.voxel_mut(cell) {
                *slot = sums;
            }
            // One that was there already is none the more.
            check::length("voxels that differ", map.len(), number + 1)?;
        }
        Ok(map)
    }
}

#[cfg(feature = "serde")]
impl From<NdtMap> for RawMap {
    fn from(map: NdtMap) -> Self {
        Self { params: map.params, voxels: map.cells.into_iter().zip(map.sums).collect() }
    }
}

/// Maps are equal if they hold the same sums, in whatever order the voxels were met.
impl PartialEq for NdtMap {
    fn eq(&self, other: &Self) -> bool {
        let same = |(cell, sums): (&[i32; 3], &VoxelSums)| other.sums(*cell) == Some(sums);
        self.params == other.params && self.len() == other.len() && self.cells.iter().zip(&self.sums).all(same)
    }
}

impl NdtMap {
    /// A map without points.
    ///
    /// # Errors
    /// A resolution that is not from 1 cm to 1 km, fewer than 3 points a voxel, a ratio outside (0, 1], or a `min_sigma` that is
    /// not from 0.1 mm to the resolution.
    pub fn new(params: VoxelParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self::alike(&params))
    }

    /// A map without points, of parameters that were accepted before.
    pub(super) fn alike(params: &VoxelParams) -> Self {
        Self { params: *params, table: CellTable::default(), cells: Vec::new(), sums: Vec::new() }
    }

    /// The parameters.
    pub const fn params(&self) -> &VoxelParams {
        &self.params
    }

    /// Voxels with points.
    pub const fn len(&self) -> usize {
        self.sums.len()
    }

    /// Whether there are no points.
    pub const fn is_empty(&self) -> bool {
        self.sums.is_empty()
    }

    /// Forgets all points; the memory stays.
    pub fn clear(&mut self) {
        self.table.clear();
        self.cells.clear();
        self.sums.clear();
    }

    /// Adds the points of a cloud whose pose in the map is `map_from_source`, and says how many: those that are not finite, or
    /// out of reach, are left out.
    pub fn insert(&mut self, points: &(impl PointSource + ?Sized), map_from_source: &Se3) -> usize {
        let (rotation, translation) = (map_from_source.rotation().matrix(), map_from_source.translation());
        let identity = *map_from_source == Se3::identity();
        let per_voxel = 1.0 / self.params.resolution;
        let (mut inserted, mut last_cell, mut last_voxel) = (0, [i32::MIN; 3], None);
        for index in 0..points.len() {
            let point = points.point(index).map(f64::from);
            let scaled = if identity { point } else { rotation * point + translation } * per_voxel;
            if !(scaled.x.is_finite() && scaled.y.is_finite() && scaled.z.is_finite()) {
                continue;
            }
            let cell = [floor(scaled.x), floor(scaled.y), floor(scaled.z)];
            if cell != last_cell {
                (last_cell, last_voxel) = (cell, self.voxel_index(cell));
            }
            if let Some(sums) = last_voxel.and_then(|voxel| self.sums.get_mut(voxel)) {
                let step =
                    |value: f64, corner: i32| (((value - f64::from(corner)) * STEPS) as u32).min(STEPS as u32 - 1);
                sums.add([step(scaled.x, cell[0]), step(scaled.y, cell[1]), step(scaled.z, cell[2])]);
                inserted += 1;
            }
        }
        inserted
    }

    /// Adds all points of another map of the same parameters.
    ///
    /// # Errors
    /// [`Error::MapMismatch`]; the map is then as it was.
    pub fn merge(&mut self, other: &Self) -> Result<(), Error> {
        self.check_like(other)?;
        for (cell, sums) in other.voxels() {
            self.merge_voxel(cell, sums);
        }
        Ok(())
    }

    /// Accepts a map of the same parameters.
    pub(super) fn check_like(&self, other: &Self) -> Result<(), Error> {
        let (own, theirs) = (&self.params, &other.params);
        for (name, left, right) in [
            ("resolution", own.resolution, theirs.resolution),
            ("min_points", f64::from(own.min_points), f64::from(theirs.min_points)),
            ("min_eigenvalue_ratio", own.min_eigenvalue_ratio, theirs.min_eigenvalue_ratio),
            ("min_sigma", own.min_sigma, theirs.min_sigma),
        ] {
            if left != right {
                return Err(Error::MapMismatch { name, left, right });
            }
        }
        Ok(())
    }

    /// Adds all points of a voxel.
    pub(super) fn merge_voxel(&mut self, cell: [i32; 3], sums: &VoxelSums) {
        if let Some(slot) = self.voxel_mut(cell) {
            slot.merge(sums);
        }
    }

    /// Keeps the voxels that `keep` says, as a sliding map or one of tiles does. Linear in the voxels.
    pub fn retain(&mut self, mut keep: impl FnMut([i32; 3]) -> bool) {
        let mut kept = 0;
        for index in 0..self.cells.len() {
            if keep(self.cells[index]) {
                (self.cells[kept], self.sums[kept]) = (self.cells[index], self.sums[index]);
                kept += 1;
            }
        }
        self.cells.truncate(kept);
        self.sums.truncate(kept);
        self.table.clear();
        for (index, cell) in self.cells.iter().enumerate() {
            self.table.get_or_insert(pack_within(*cell), index as u32);
        }
    }

    /// The voxel of a point of the map, in metres; `None` for one that is not finite or out of reach.
    pub fn cell_at(&self, point: &Vector3<f64>) -> Option<[i32; 3]> {
        let scaled = point / self.params.resolution;
        let cell = [floor(scaled.x), floor(scaled.y), floor(scaled.z)];
        (scaled.iter().all(|v| v.is_finite()) && pack(cell).is_some()).then_some(cell)
    }

    /// The sums of a voxel; `None` if it has no points.
    pub fn sums(&self, cell: [i32; 3]) -> Option<&VoxelSums> {
        self.sums.get(self.table.get(pack(cell)?)? as usize)
    }

    /// All voxels with points, in the order in which they were met.
    pub fn voxels(&self) -> impl ExactSizeIterator<Item = ([i32; 3], &VoxelSums)> + '_ {
        self.cells.iter().copied().zip(&self.sums)
    }

    /// The distribution of a voxel; `None` with too few points.
    pub fn gaussian(&self, cell: [i32; 3]) -> Option<Gaussian3> {
        let sums = self.sums(cell)?;
        let moments = self.distribution(sums.count(), || sums.moments(), self.params.resolution)?;
        let corner = Vector3::from(cell.map(f64::from)) * self.params.resolution;
        Some(Gaussian3 {
            mean: corner + moments.mean,
            covariance: moments.covariance,
            information: moments.information,
        })
    }

    /// The distribution of `count` points with these mean and scatter, in voxels of `unit` metres; its mean is from their corner.
    pub(super) fn distribution(
        &self,
        count: u32,
        moments: impl FnOnce() -> Option<(Vector3<f64>, Matrix3<f64>)>,
        unit: f64,
    ) -> Option<Moments> {
        if count < self.params.min_points {
            return None;
        }
        let (mean, scatter) = moments()?;
        let raw = scatter * (unit * unit / (f64::from(count) - 1.0));
        let (covariance, information) =
            regularized(&raw, self.params.min_eigenvalue_ratio, self.params.min_sigma.powi(2));
        Some(Moments { mean: mean * unit, covariance, information })
    }

    /// Place of the voxel in the lists; a new one without points if it was not there. `None` out of reach.
    fn voxel_index(&mut self, cell: [i32; 3]) -> Option<usize> {
        let key = pack(cell)?;
        let next = self.sums.len() as u32;
        let index = self.table.get_or_insert(key, next);
        if index == next {
            self.cells.push(cell);
            self.sums.push(VoxelSums::default());
        }
        Some(index as usize)
    }

    fn voxel_mut(&mut self, cell: [i32; 3]) -> Option<&mut VoxelSums> {
        let index = self.voxel_index(cell)?;
        self.sums.get_mut(index)
    }
}

/// A regularised distribution.
pub(super) struct Moments {
    pub(super) mean: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    pub(super) information: Matrix3<f64>,
}

#[cfg(test)]
mod tests;
