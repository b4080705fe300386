//! Leaving points out, in place, with all channels kept together and the order kept.

use super::PointCloud;
use crate::{Error, check};
use nalgebra::Vector3;

impl PointCloud {
    /// Keeps the points for which `keep(index, point)` is true; linear, without allocation.
    ///
    /// ```
    /// use agv_core::sensors::PointCloud;
    ///
    /// let mut cloud = PointCloud::new(vec![1.0, 2.0, 3.0], vec![0.0; 3], vec![0.0; 3])?.with_ring(vec![0, 1, 2])?;
    /// cloud.retain(|_, point| point.x != 2.0);
    /// assert_eq!((cloud.x(), cloud.ring()), (&[1.0, 3.0][..], Some(&[0_u16, 2][..])));
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    pub fn retain(&mut self, mut keep: impl FnMut(usize, Vector3<f32>) -> bool) {
        let mut kept = 0;
        for index in 0..self.x.len() {
            // The write position never overtakes the read position, and all channels have one length.
            let point = Vector3::new(self.x[index], self.y[index], self.z[index]);
            if !keep(index, point) {
                continue;
            }
            (self.x[kept], self.y[kept], self.z[kept]) = (point.x, point.y, point.z);
            if let Some(intensity) = &mut self.intensity {
                intensity[kept] = intensity[index];
            }
            if let Some(ring) = &mut self.ring {
                ring[kept] = ring[index];
            }
            if let Some(time) = &mut self.time {
                time[kept] = time[index];
            }
            kept += 1;
        }
        self.x.truncate(kept);
        self.y.truncate(kept);
        self.z.truncate(kept);
        self.intensity.iter_mut().for_each(|channel| channel.truncate(kept));
        self.ring.iter_mut().for_each(|channel| channel.truncate(kept));
        self.time.iter_mut().for_each(|channel| channel.truncate(kept));
    }

    /// Drops points with a coordinate that is not finite.
    pub fn remove_non_finite(&mut self) {
        self.retain(|_, point| point.iter().all(|v| v.is_finite()));
    }

    /// Keeps the points in the box from `min` to `max` (both included) of the cloud's own frame; points that are not
    /// finite are dropped.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if `min` exceeds `max` along an axis, or for NaN; the cloud is then as it was. An infinite
    /// bound is none.
    pub fn crop_box(&mut self, min: &Vector3<f32>, max: &Vector3<f32>) -> Result<(), Error> {
        check_box(min, max)?;
        self.retain(|_, p| inside(&p, min, max));
        Ok(())
    }

    /// Keeps the points outside the box: the vehicle's own body, for instance. Points that are not finite are dropped.
    ///
    /// # Errors
    /// As [`crop_box`](Self::crop_box).
    pub fn cut_out_box(&mut self, min: &Vector3<f32>, max: &Vector3<f32>) -> Result<(), Error> {
        check_box(min, max)?;
        self.retain(|_, p| p.iter().all(|v| v.is_finite()) && !inside(&p, min, max));
        Ok(())
    }

    /// Keeps the points at a distance from `min` to `max` metres (both included) from the origin of the cloud's frame;
    /// points that are not finite are dropped.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] unless `0 <= min <= max`; the cloud is then as it was.
    pub fn crop_range(&mut self, min: f32, max: f32) -> Result<(), Error> {
        check::in_range("min range", f64::from(min), 0.0, f64::from(max))?;
        let (least, greatest) = (min * min, max * max);
        self.retain(|_, p| {
            let square = p.norm_squared();
            square >= least && square <= greatest && square.is_finite()
        });
        Ok(())
    }
}

fn check_box(min: &Vector3<f32>, max: &Vector3<f32>) -> Result<(), Error> {
    for (&low, &high) in min.iter().zip(max.iter()) {
        check::in_range("box min", f64::from(low), f64::NEG_INFINITY, f64::from(high))?;
    }
    Ok(())
}

fn inside(p: &Vector3<f32>, min: &Vector3<f32>, max: &Vector3<f32>) -> bool {
    p.iter().zip(min.iter().zip(max.iter())).all(|(v, (low, high))| v >= low && v <= high && v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every channel of point `i` carries `i`, so that a mix-up shows.
    fn tagged(points: &[[f32; 3]]) -> PointCloud {
        let n = points.len() as u16;
        PointCloud::from_points(points.iter().map(|p| Vector3::from(*p)))
            .with_ring((0..n).collect())
            .and_then(|c| c.with_intensity((0..n).map(f32::from).collect()))
            .and_then(|c| c.with_time((0..n).map(f32::from).collect()))
            .unwrap()
    }

    proptest! {
        #[test]
        fn channels_stay_together(points in prop::collection::vec(prop::array::uniform3(-2.0..2.0_f32), 0..80)) {
            let mut cloud = tagged(&points);
            let (min, max) = (Vector3::new(-1.0, -1.5, f32::NEG_INFINITY), Vector3::new(1.0, 1.5, f32::INFINITY));
            cloud.crop_box(&min, &max).unwrap();
            let expected: Vec<u16> = (0..points.len() as u16)
                .filter(|&i| points[i as usize][0].abs() <= 1.0 && points[i as usize][1].abs() <= 1.5)
                .collect();
            prop_assert_eq!(cloud.ring().unwrap(), &expected[..]);
            for (k, &i) in expected.iter().enumerate() {
                prop_assert_eq!(cloud.points().nth(k).unwrap(), Vector3::from(points[i as usize]));
                prop_assert_eq!((cloud.intensity().unwrap()[k], cloud.time().unwrap()[k]), (f32::from(i), f32::from(i)));
            }
        }

        /// A box and its complement share the finite points out between them.
        #[test]
        fn box_and_complement_share_the_points(points in prop::collection::vec(prop::array::uniform3(-2.0..2.0_f32), 0..80)) {
            let (min, max) = (Vector3::repeat(-1.0), Vector3::repeat(1.0));
            let (mut inside, mut outside) = (tagged(&points), tagged(&points));
            inside.crop_box(&min, &max).unwrap();
            outside.cut_out_box(&min, &max).unwrap();
            prop_assert_eq!(inside.len() + outside.len(), points.len());
        }
    }

    #[test]
    fn points_that_are_not_finite_are_dropped() {
        let points = [[f32::NAN, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [0.0, 0.0, 9.0]];
        let mut cloud = tagged(&points);
        cloud.remove_non_finite();
        assert_eq!(cloud.ring(), Some(&[1_u16, 3][..]));
        let mut cloud = tagged(&points);
        cloud.crop_range(0.5, f32::INFINITY).unwrap();
        assert_eq!(cloud.ring(), Some(&[1_u16, 3][..]));
        let mut cloud = tagged(&points);
        cloud.cut_out_box(&Vector3::repeat(-0.1), &Vector3::repeat(1.0)).unwrap();
        assert_eq!(cloud.ring(), Some(&[3_u16][..]));
    }

    #[test]
    fn bad_bounds_leave_the_cloud() {
        let mut cloud = tagged(&[[1.0, 2.0, 3.0]]);
        let before = cloud.clone();
        for bad in [2.0, f32::NAN] {
            assert!(cloud.crop_box(&Vector3::repeat(bad), &Vector3::repeat(1.0)).is_err());
            assert!(cloud.cut_out_box(&Vector3::repeat(bad), &Vector3::repeat(1.0)).is_err());
            assert!(cloud.crop_range(bad, 1.0).is_err());
        }
        assert!(cloud.crop_range(-1.0, 1.0).is_err() && cloud.crop_range(0.0, f32::NAN).is_err());
        assert_eq!(cloud, before);
    }
}
