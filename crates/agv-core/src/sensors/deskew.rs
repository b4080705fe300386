//! Undoing the vehicle's motion during a sweep.
//!
//! Beam `i` of a scan was taken at `stamp + i time_increment`, when the base stood elsewhere. With the motion known,
//!
//! ```text
//! p_reference = reference_from_base(t_i) · base_from_sensor · p_i
//! ```
//!
//! brings every end point into the base frame of one reference time. A vehicle that turns by 1 rad/s under a 40 Hz
//! scanner smears a wall 10 m away by 25 cm otherwise.

use super::{Beam, BodyMotion, LaserScan, PointCloud, ScanBins};
use crate::{
    Error,
    geometry::{LieGroup, Se2, Se3, So2},
};
use nalgebra::Vector2;

/// Deskews scans and clouds; the buffers are reused.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::sensors::{ConstantTwist, Deskew, LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
///
/// let geometry = ScanGeometry { time_increment: 25e-6, ..Default::default() };
/// let scan = LaserScan::new(Stamp::default(), geometry, vec![5.0; 1081])?;
/// let motion = ConstantTwist::planar(scan.stamp(), &Twist2::new(1.0, 0.0, 0.5))?;
/// let mut points = Vec::new();
/// Deskew::points_into(&scan, &motion, &mut points);
/// assert_eq!(points.len(), 1081);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Deskew {
    bins: ScanBins,
}

impl Deskew {
    /// End points of all hits, in metres, in the base frame of the motion's reference time, in the order of the beams.
    pub fn points_into(scan: &LaserScan, motion: &impl BodyMotion<Se2>, points: &mut Vec<Vector2<f64>>) {
        points.clear();
        for_each_beam(scan, motion, |reference_from_sensor, direction, beam| {
            if let Beam::Hit(range) = beam {
                points.push(reference_from_sensor.act(&(direction * range)));
            }
        });
    }

    /// The scan that a scanner of `out`'s geometry, mount and number of beams would have taken at once at the
    /// motion's reference time, as far as the beams of `scan` tell: the nearest end point in every direction, *no
    /// return* where a beam came back empty, NaN where none looked. `out` should have a `time_increment` of zero.
    ///
    /// # Errors
    /// None in practice: `out` keeps its size.
    pub fn scan_into(
        &mut self,
        scan: &LaserScan,
        motion: &impl BodyMotion<Se2>,
        out: &mut LaserScan,
    ) -> Result<(), Error> {
        self.bins.begin(out, f32::NAN);
        let sensor_from_base = out.geometry().base_from_sensor.inverse();
        let far = scan.geometry().range_max;
        for_each_beam(scan, motion, |reference_from_sensor, direction, beam| {
            let seen = |range: f64| sensor_from_base.act(&reference_from_sensor.act(&(direction * range)));
            match beam {
                Beam::Hit(range) => self.bins.add_hit(&seen(range)),
                Beam::NoReturn => self.bins.add_no_return(&seen(far)),
                Beam::Invalid => {}
            }
        });
        self.bins.finish(motion.reference(), out)
    }

    /// The cloud as if taken at once at the motion's reference time, in the sensor frame of that time. Intensity and
    /// ring are kept, the time channel is dropped. A cloud without times is taken at its stamp; a point whose time is
    /// not finite becomes NaN. Points that share a time (one firing of all lines) share the work.
    pub fn cloud_into(cloud: &PointCloud, motion: &impl BodyMotion<Se3>, out: &mut PointCloud) {
        out.copy_without_time(cloud);
        out.time = None;
        out.stamp = motion.reference();
        let offset = cloud.stamp - motion.reference();
        let (mount, unmount) = (cloud.base_from_sensor, cloud.base_from_sensor.inverse());
        let pose_at =
            |time: f32| unmount.compose(&motion.reference_from_base(offset + f64::from(time))).compose(&mount);
        let Some(times) = &cloud.time else {
            out.move_points(&pose_at(0.0));
            return;
        };
        let mut start = 0;
        while let Some(&time) = times.get(start) {
            let same = times[start..].iter().take_while(|t| t.to_bits() == time.to_bits()).count();
            let span = start..start + same;
            super::cloud_transform::move_slices(
                &pose_at(time),
                &mut out.x[span.clone()],
                &mut out.y[span.clone()],
                &mut out.z[span],
            );
            start += same;
        }
    }
}

/// Calls `body(reference_from_sensor, direction in the sensor frame, beam)` for each beam.
fn for_each_beam(scan: &LaserScan, motion: &impl BodyMotion<Se2>, mut body: impl FnMut(&Se2, Vector2<f64>, Beam)) {
    let geometry = scan.geometry();
    let offset = scan.stamp() - motion.reference();
    for (index, (angle, beam)) in scan.beams().enumerate() {
        let base = motion.reference_from_base(offset + index as f64 * geometry.time_increment);
        let direction = So2::from_angle(angle);
        body(&base.compose(&geometry.base_from_sensor), Vector2::new(direction.cos(), direction.sin()), beam);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{So3, Twist2, Twist3};
    use crate::sensors::{ConstantTwist, ScanGeometry};
    use crate::time::Stamp;
    use nalgebra::Vector3;

    /// Distance from `origin` along `direction` to the walls of the room [-4, 6] x [-3, 5].
    fn room(origin: &Vector2<f64>, direction: &Vector2<f64>) -> f64 {
        let reach = |o: f64, d: f64, low: f64, high: f64| if d > 0.0 { (high - o) / d } else { (low - o) / d };
        reach(origin.x, direction.x, -4.0, 6.0).min(reach(origin.y, direction.y, -3.0, 5.0))
    }

    /// Sweep of the room by a moving vehicle that stands in the room's origin at 20 ms.
    fn sweep(twist: &Twist2) -> (LaserScan, Stamp) {
        let geometry =
            ScanGeometry { base_from_sensor: Se2::new(0.3, 0.1, 0.2), time_increment: 25e-6, ..Default::default() };
        let (stamp, reference) = (Stamp::from_seconds(100.0), Stamp::from_seconds(100.02));
        let ranges = (0..1081).map(|i| {
            let base = twist.integrate(f64::from(i) * geometry.time_increment + (stamp - reference));
            let sensor = base.compose(&geometry.base_from_sensor);
            let (sin, cos) = geometry.angle(i as usize).sin_cos();
            room(&sensor.translation(), &sensor.rotation().act(&Vector2::new(cos, sin))) as f32
        });
        (LaserScan::new(stamp, geometry, ranges.collect()).unwrap(), reference)
    }

    /// Every end point lies on a wall again, to 1e-9 beyond the rounding of its stored range; raw, walls are off by
    /// centimetres.
    #[test]
    fn motion_in_a_known_room_is_undone() {
        let twist = Twist2::new(1.5, 0.0, 1.0);
        let (scan, reference) = sweep(&twist);
        let off_wall = |p: &Vector2<f64>| {
            [p.x + 4.0, p.x - 6.0, p.y + 3.0, p.y - 5.0].iter().fold(9.0, |d: f64, w| d.min(w.abs()))
        };
        let mut points = Vec::new();
        Deskew::points_into(&scan, &ConstantTwist::planar(reference, &twist).unwrap(), &mut points);
        assert_eq!(points.len(), scan.len());
        for (point, range) in points.iter().zip(scan.ranges()) {
            let rounding = 0.5 * f64::from(range.next_up() - range);
            assert!(off_wall(point) < rounding + 1e-9, "{point}");
        }
        assert!(scan.points_in_base().map(|p| off_wall(&p)).fold(0.0, f64::max) > 0.05);
    }

    #[test]
    fn a_resampled_scan_is_that_of_a_standing_vehicle() {
        let twist = Twist2::new(1.5, 0.0, 1.0);
        let (scan, reference) = sweep(&twist);
        let (still, _) = sweep(&Twist2::ZERO);
        let geometry = ScanGeometry { time_increment: 0.0, ..*still.geometry() };
        let mut out = LaserScan::new(reference, geometry, vec![0.0; still.len()]).unwrap();
        Deskew::default().scan_into(&scan, &ConstantTwist::planar(reference, &twist).unwrap(), &mut out).unwrap();
        assert_eq!(out.stamp(), reference);
        let mut compared = 0;
        for (a, b) in out.ranges().iter().zip(still.ranges()) {
            if a.is_finite() {
                // Half a beam of angle on a wall seen at a slant.
                assert!((a - b).abs() < 0.02 * b, "{a} {b}");
                compared += 1;
            }
        }
        assert!(compared > 1000, "{compared}");
    }

    #[test]
    fn empty_beams_stay_empty() {
        let geometry = ScanGeometry::default();
        let scan = LaserScan::new(Stamp::default(), geometry, vec![f32::INFINITY, f32::NAN, 2.0]).unwrap();
        let mut out = scan.clone();
        let rest = ConstantTwist::planar(Stamp::default(), &Twist2::ZERO).unwrap();
        Deskew::default().scan_into(&scan, &rest, &mut out).unwrap();
        assert_eq!(out.ranges()[0], f32::INFINITY);
        assert!(out.ranges()[1].is_nan() && (out.ranges()[2] - 2.0).abs() < 1e-6);
    }

    #[test]
    fn a_clouds_motion_is_undone() {
        let twist = Twist3 { linear: Vector3::new(2.0, 0.1, 0.0), angular: Vector3::new(0.0, 0.1, 0.8) };
        let mount = Se3::from_parts(Vector3::new(0.2, 0.0, 1.5), So3::from_roll_pitch_yaw(0.0, 0.1, 0.3));
        let (stamp, reference) = (Stamp::from_seconds(7.0), Stamp::from_seconds(7.1));
        let truth: Vec<_> =
            (0..300).map(|i| Vector3::new(10.0 + f64::from(i) * 0.1, f64::from(i % 17), -1.0)).collect();
        let time: Vec<f32> = (0..300_u16).map(|i| f32::from(i / 3) * 1e-3).collect();
        let seen = truth.iter().zip(&time).map(|(p, &t)| {
            let base = twist.integrate(f64::from(t) + (stamp - reference));
            base.compose(&mount).inverse().act(&mount.act(p)).cast::<f32>()
        });
        let cloud = PointCloud::from_points(seen).with_stamp(stamp).with_time(time).unwrap().with_mount(mount).unwrap();
        let cloud = cloud.with_ring((0..300).collect()).unwrap();
        let mut out = PointCloud::default();
        Deskew::cloud_into(&cloud, &ConstantTwist::spatial(reference, &twist).unwrap(), &mut out);
        for (p, q) in out.points().zip(&truth) {
            assert!((p.cast::<f64>() - q).norm() < 2e-5, "{p} {q}");
        }
        assert_eq!((out.stamp(), out.time(), out.ring()), (reference, None, cloud.ring()));
    }
}
