//! Moving clouds.

use super::PointCloud;
use crate::geometry::{LieGroup, Se3};

/// Moves points given as three slices of equal length, in `f32`: the loop that the compiler vectorises.
pub(super) fn move_slices(target_from_source: &Se3, x: &mut [f32], y: &mut [f32], z: &mut [f32]) {
    let rotation = target_from_source.rotation().matrix().cast::<f32>();
    let t = target_from_source.translation().cast::<f32>();
    for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
        let (a, b, c) = (*x, *y, *z);
        *x = rotation.m11 * a + rotation.m12 * b + rotation.m13 * c + t.x;
        *y = rotation.m21 * a + rotation.m22 * b + rotation.m23 * c + t.y;
        *z = rotation.m31 * a + rotation.m32 * b + rotation.m33 * c + t.z;
    }
}

impl PointCloud {
    /// Moves the points and leaves the mount: the caller says what frame they are in.
    pub(super) fn move_points(&mut self, target_from_source: &Se3) {
        move_slices(target_from_source, &mut self.x, &mut self.y, &mut self.z);
    }

    /// Expresses the cloud in another frame, in place; `base_from_sensor` becomes the pose of that frame, so that the
    /// points stay where they are on the vehicle. Points that are not finite stay so.
    ///
    /// ```
    /// use agv_core::geometry::{LieGroup, Se2, Se3};
    /// use agv_core::sensors::PointCloud;
    ///
    /// let mount = Se3::from(Se2::new(0.5, 0.0, 0.0));
    /// let mut cloud = PointCloud::new(vec![1.0], vec![0.0], vec![0.0])?.with_mount(mount)?;
    /// cloud.transform(&mount); // from the sensor to the base frame
    /// assert_eq!((cloud.x()[0], cloud.base_from_sensor()), (1.5, Se3::identity()));
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    pub fn transform(&mut self, target_from_source: &Se3) {
        self.move_points(target_from_source);
        self.base_from_sensor = self.base_from_sensor.compose(&target_from_source.inverse());
    }

    /// As [`transform`](Self::transform), into another cloud whose memory is reused.
    pub fn transform_into(&self, target_from_source: &Se3, out: &mut Self) {
        out.copy_from(self);
        out.transform(target_from_source);
    }

    /// Makes this cloud equal to `other`, reusing the memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.copy_without_time(other);
        self.time.clone_from(&other.time);
    }

    /// As [`copy_from`](Self::copy_from), but leaves the time channel as it is: one that is dropped afterwards would be
    /// allocated anew every time.
    pub(super) fn copy_without_time(&mut self, other: &Self) {
        (self.stamp, self.sensor) = (other.stamp, other.sensor);
        self.base_from_sensor = other.base_from_sensor;
        self.x.clone_from(&other.x);
        self.y.clone_from(&other.y);
        self.z.clone_from(&other.z);
        self.intensity.clone_from(&other.intensity);
        self.ring.clone_from(&other.ring);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::So3;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    proptest! {
        /// The points move as the group says, to the rounding of f32, and stay where they are on the vehicle.
        #[test]
        fn points_stay_on_the_vehicle(v in prop::array::uniform6(-3.0..3.0_f64), p in prop::array::uniform3(-50.0..50.0_f32)) {
            let pose = Se3::from_parts(Vector3::new(v[0], v[1], v[2]), So3::from_roll_pitch_yaw(v[3], v[4] / 3.0, v[5]));
            let mount = Se3::from_parts(Vector3::new(0.1, 0.2, 0.3), So3::from_roll_pitch_yaw(0.1, 0.2, 0.3));
            let point = Vector3::from(p);
            let cloud = PointCloud::from_points([point]).with_mount(mount).unwrap().with_ring(vec![3]).unwrap();
            let mut out = PointCloud::default();
            cloud.transform_into(&pose, &mut out);
            let moved = out.points().next().unwrap().cast::<f64>();
            prop_assert!((moved - pose.act(&point.cast())).norm() < 5e-5);
            prop_assert!((out.base_from_sensor().act(&moved) - mount.act(&point.cast())).norm() < 5e-5);
            prop_assert_eq!(out.ring(), cloud.ring());
        }
    }

    #[test]
    fn copies_reuse_memory() {
        let cloud = PointCloud::from_points(vec![Vector3::repeat(1.0); 100]).with_time(vec![0.0; 100]).unwrap();
        let mut out = cloud.clone();
        let before = (out.x().as_ptr(), out.time().unwrap().as_ptr());
        out.copy_from(&cloud);
        assert_eq!((out.x().as_ptr(), out.time().unwrap().as_ptr()), before);
    }
}
