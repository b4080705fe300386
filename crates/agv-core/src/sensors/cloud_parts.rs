//! Putting clouds together and taking parts of them, with all channels kept together.

use super::PointCloud;
use crate::{Error, check};

/// Appends a channel that both clouds have or both lack.
fn append_channel<T: Copy>(own: &mut Option<Vec<T>>, other: Option<&[T]>) {
    if let (Some(own), Some(other)) = (own, other) {
        own.extend_from_slice(other);
    }
}

/// Replaces a channel by the chosen values of another, reusing the memory.
fn select_channel<T: Copy>(from: Option<&[T]>, indices: &[usize], out: &mut Option<Vec<T>>) {
    match from {
        Some(from) => select(from, indices, out.get_or_insert_default()),
        None => *out = None,
    }
}

fn select<T: Copy>(from: &[T], indices: &[usize], out: &mut Vec<T>) {
    out.clear();
    out.extend(indices.iter().filter_map(|&index| from.get(index).copied()));
}

impl PointCloud {
    /// Drops all points; stamp, sensor, mount, channels and memory stay.
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
        self.intensity.iter_mut().for_each(Vec::clear);
        self.ring.iter_mut().for_each(Vec::clear);
        self.time.iter_mut().for_each(Vec::clear);
    }

    /// Adds the points of another cloud behind one's own; allocates only if the memory must grow.
    ///
    /// Coordinates are taken as they are: the caller sees to it that both clouds are in one frame
    /// ([`transform`](Self::transform)). Times are counted from this cloud's stamp afterwards. A cloud without points
    /// takes over the other's stamp, sensor, mount and channels.
    ///
    /// ```
    /// use agv_core::sensors::PointCloud;
    ///
    /// let left = PointCloud::new(vec![1.0], vec![0.5], vec![0.0])?.with_ring(vec![3])?;
    /// let right = PointCloud::new(vec![2.0], vec![-0.5], vec![0.0])?.with_ring(vec![7])?;
    /// let mut both = PointCloud::default();
    /// both.append(&left)?;
    /// both.append(&right)?;
    /// assert_eq!((both.x(), both.ring()), (&[1.0, 2.0][..], Some(&[3_u16, 7][..])));
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::LengthMismatch`] names a channel that only one of the clouds has; this cloud is then as it was.
    pub fn append(&mut self, other: &Self) -> Result<(), Error> {
        if other.is_empty() {
            return Ok(());
        }
        if self.is_empty() {
            self.copy_from(other);
            return Ok(());
        }
        for (name, own, others) in [
            ("intensity", self.intensity.is_some(), other.intensity.is_some()),
            ("ring", self.ring.is_some(), other.ring.is_some()),
            ("time", self.time.is_some(), other.time.is_some()),
        ] {
            let entries = |cloud: &Self, has: bool| if has { cloud.len() } else { 0 };
            if own != others {
                check::length(name, entries(self, own) + entries(other, others), self.len() + other.len())?;
            }
        }
        self.x.extend_from_slice(&other.x);
        self.y.extend_from_slice(&other.y);
        self.z.extend_from_slice(&other.z);
        append_channel(&mut self.intensity, other.intensity());
        append_channel(&mut self.ring, other.ring());
        if let (Some(own), Some(others)) = (&mut self.time, &other.time) {
            let later = other.stamp - self.stamp;
            own.extend(others.iter().map(|&time| (f64::from(time) + later) as f32));
        }
        Ok(())
    }

    /// Writes the points at `indices`, in that order and as often as they are named, to another cloud, with stamp,
    /// sensor, mount and all channels; its memory is reused. Linear in the indices.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the first index that is no point; `out` is then as it was.
    pub fn select_into(&self, indices: &[usize], out: &mut Self) -> Result<(), Error> {
        if let Some(&index) = indices.iter().find(|&&index| index >= self.len()) {
            let max = self.len() as f64 - 1.0;
            return Err(Error::OutOfRange { name: "index", value: index as f64, min: 0.0, max });
        }
        (out.stamp, out.sensor, out.base_from_sensor) = (self.stamp, self.sensor, self.base_from_sensor);
        select(&self.x, indices, &mut out.x);
        select(&self.y, indices, &mut out.y);
        select(&self.z, indices, &mut out.z);
        select_channel(self.intensity(), indices, &mut out.intensity);
        select_channel(self.ring(), indices, &mut out.ring);
        select_channel(self.time(), indices, &mut out.time);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        geometry::Se3,
        sensors::{LidarReturn, SensorId},
        time::Stamp,
    };
    use nalgebra::Vector3;

    /// Every channel of a point carries its number, so that a mix-up shows.
    fn numbered(numbers: std::ops::Range<u16>, stamp: f64) -> PointCloud {
        let mount = Se3::from_parts(Vector3::new(0.0, 0.0, stamp), crate::geometry::So3::default());
        let mut cloud = PointCloud::default().with_mount(mount).unwrap().with_sensor(SensorId(stamp as u16));
        cloud.refill(
            Stamp::from_seconds(stamp),
            numbers.map(|i| {
                let value = f32::from(i);
                LidarReturn { position: Vector3::repeat(value), intensity: value, ring: i, time: 0.25 * value }
            }),
        );
        cloud
    }

    #[test]
    fn what_is_put_together_is_taken_apart() {
        let (first, second) = (numbered(0..4, 2.0), numbered(4..9, 2.5));
        let mut both = numbered(0..2, 7.0);
        both.clear();
        assert!(both.is_empty() && both.ring() == Some(&[]) && both.stamp() == Stamp::from_seconds(7.0));
        both.append(&first).unwrap();
        both.append(&second).unwrap();
        both.append(&PointCloud::default()).unwrap();
        assert_eq!((both.stamp(), both.base_from_sensor()), (first.stamp(), first.base_from_sensor()));
        assert_eq!((both.len(), both.ring(), both.y()[8]), (9, Some(&[0, 1, 2, 3, 4, 5, 6, 7, 8_u16][..]), 8.0));
        assert_eq!(both.time().map(|t| (t[3], t[4])), Some((0.75, 1.5)), "from the first stamp on");
        let mut part = PointCloud::default();
        both.select_into(&[0, 1, 2, 3], &mut part).unwrap();
        assert_eq!(part, first);
        both.select_into(&[8, 8, 4], &mut part).unwrap();
        assert_eq!((part.x(), part.intensity()), (&[8.0, 8.0, 4.0][..], Some(&[8.0_f32, 8.0, 4.0][..])));
        PointCloud::from_points([Vector3::x()]).select_into(&[0], &mut part).unwrap();
        assert_eq!(part, PointCloud::from_points([Vector3::x()]));
    }

    #[test]
    fn what_does_not_fit_changes_nothing() {
        let bare = PointCloud::from_points([Vector3::x(); 3]);
        let mut cloud = numbered(0..4, 2.0);
        let before = cloud.clone();
        assert_eq!(cloud.append(&bare), Err(Error::LengthMismatch { name: "intensity", len: 4, expected: 7 }));
        let ringed = bare.clone().with_ring(vec![1; 3]).unwrap();
        assert_eq!(ringed.clone().append(&bare), Err(Error::LengthMismatch { name: "ring", len: 3, expected: 6 }));
        assert!(bare.select_into(&[0, 3], &mut cloud).is_err());
        assert!(PointCloud::default().select_into(&[0], &mut cloud).is_err());
        assert_eq!(cloud, before);
    }
}
