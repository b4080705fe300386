//! A target that grows while it is aligned with.

use super::NdtRegistration;
use crate::Error;
use crate::checks::finite_pose;
use crate::ndt::NdtMap;
use agv_core::{geometry::Se3, sensors::PointSource};

impl NdtRegistration {
    /// Adds the points of a cloud whose pose in the target is `map_from_source`, and says how many: those that are not finite, or out
    /// of reach, are left out. The target is then, to the bit, what one of all the points would be, but only the voxels that the cloud
    /// meets are looked at: linear in its points. Without a target the cloud makes one.
    ///
    /// # Errors
    /// A first cloud without enough points in any voxel, or a pose that is not finite; nothing is changed.
    pub fn insert(&mut self, points: &(impl PointSource + ?Sized), map_from_source: &Se3) -> Result<usize, Error> {
        finite_pose("map_from_source", map_from_source)?;
        self.spare.clear();
        let inserted = self.spare.insert(points, map_from_source);
        if self.map.is_empty() {
            self.take_spare()?;
            return Ok(inserted);
        }
        self.map.merge(&self.spare)?;
        for (doublings, level) in self.levels.iter_mut().enumerate() {
            level.update(&self.map, &self.spare, doublings as u32);
        }
        Ok(inserted)
    }

    /// The target, with all else given up.
    #[must_use]
    pub fn into_map(self) -> NdtMap {
        self.map
    }
}
