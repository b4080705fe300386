//! Point clouds as a structure of arrays.

use super::SensorId;
use crate::{Error, check, geometry::Se3, time::Stamp};
use nalgebra::Vector3;

/// Anything that registration and mapping can take points from.
pub trait PointSource: Sync {
    /// Number of points.
    fn len(&self) -> usize;

    /// Whether there are no points.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Point `index`, in metres; `index` is below [`len`](Self::len).
    fn point(&self, index: usize) -> Vector3<f32>;
}

impl PointSource for [Vector3<f32>] {
    fn len(&self) -> usize {
        <[Vector3<f32>]>::len(self)
    }

    fn point(&self, index: usize) -> Vector3<f32> {
        self[index]
    }
}

/// One return of a spinning lidar, with all the channels a [`PointCloud`] can hold.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LidarReturn {
    /// Where the surface is, in the sensor frame, in metres.
    pub position: Vector3<f32>,
    /// Reflectivity, in the sensor's unit.
    pub intensity: f32,
    /// Laser line, counted from the lowest.
    pub ring: u16,
    /// Time after the cloud's stamp, in seconds.
    pub time: f32,
}

/// A point cloud in the sensor frame: coordinates, and optional channels of the same length.
///
/// Points may be non-finite (drivers mark missing returns so); consumers skip those.
///
/// ```
/// use agv_core::sensors::PointCloud;
///
/// let cloud = PointCloud::new(vec![1.0, 2.0], vec![0.0, 0.0], vec![0.5, 0.5])?.with_ring(vec![0, 1])?;
/// assert_eq!(cloud.len(), 2);
/// assert_eq!(cloud.ring(), Some(&[0_u16, 1][..]));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawCloud"))]
pub struct PointCloud {
    pub(super) stamp: Stamp,
    pub(super) sensor: SensorId,
    pub(super) base_from_sensor: Se3,
    #[cfg_attr(feature = "serde", serde(with = "crate::stored_readings"))]
    pub(super) x: Vec<f32>,
    #[cfg_attr(feature = "serde", serde(with = "crate::stored_readings"))]
    pub(super) y: Vec<f32>,
    #[cfg_attr(feature = "serde", serde(with = "crate::stored_readings"))]
    pub(super) z: Vec<f32>,
    #[cfg_attr(feature = "serde", serde(with = "crate::stored_readings::optional"))]
    pub(super) intensity: Option<Vec<f32>>,
    pub(super) ring: Option<Vec<u16>>,
    #[cfg_attr(feature = "serde", serde(with = "crate::stored_readings::optional"))]
    pub(super) time: Option<Vec<f32>>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawCloud {
    stamp: Stamp,
    #[serde(default)]
    sensor: SensorId,
    base_from_sensor: Se3,
    #[serde(with = "crate::stored_readings")]
    x: Vec<f32>,
    #[serde(with = "crate::stored_readings")]
    y: Vec<f32>,
    #[serde(with = "crate::stored_readings")]
    z: Vec<f32>,
    #[serde(default, with = "crate::stored_readings::optional")]
    intensity: Option<Vec<f32>>,
    ring: Option<Vec<u16>>,
    #[serde(default, with = "crate::stored_readings::optional")]
    time: Option<Vec<f32>>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawCloud> for PointCloud {
    type Error = Error;

    fn try_from(raw: RawCloud) -> Result<Self, Error> {
        let cloud = Self::new(raw.x, raw.y, raw.z)?.with_stamp(raw.stamp).with_sensor(raw.sensor);
        let mut cloud = cloud.with_mount(raw.base_from_sensor)?;
        if let Some(intensity) = raw.intensity {
            cloud = cloud.with_intensity(intensity)?;
        }
        if let Some(ring) = raw.ring {
            cloud = cloud.with_ring(ring)?;
        }
        if let Some(time) = raw.time {
            cloud = cloud.with_time(time)?;
        }
        Ok(cloud)
    }
}

impl PointCloud {
    /// A cloud from its coordinates in metres, without optional channels.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`] if the three differ in length.
    pub fn new(x: Vec<f32>, y: Vec<f32>, z: Vec<f32>) -> Result<Self, Error> {
        check::length("y", y.len(), x.len())?;
        check::length("z", z.len(), x.len())?;
        Ok(Self { x, y, z, ..Self::default() })
    }

    /// A cloud from points in metres.
    pub fn from_points(points: impl IntoIterator<Item = Vector3<f32>>) -> Self {
        let mut cloud = Self::default();
        for point in points {
            cloud.x.push(point.x);
            cloud.y.push(point.y);
            cloud.z.push(point.z);
        }
        cloud
    }

    /// The same cloud, taken at `stamp` (the time of its first point).
    #[must_use]
    pub fn with_stamp(mut self, stamp: Stamp) -> Self {
        self.stamp = stamp;
        self
    }

    /// The same cloud, from this sensor of the vehicle.
    #[must_use]
    pub const fn with_sensor(mut self, sensor: SensorId) -> Self {
        self.sensor = sensor;
        self
    }

    /// The same cloud, from a sensor mounted at `base_from_sensor`.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn with_mount(mut self, base_from_sensor: Se3) -> Result<Self, Error> {
        check::all_finite("base_from_sensor", base_from_sensor.translation().iter())?;
        check::all_finite("base_from_sensor", base_from_sensor.rotation().matrix().iter())?;
        self.base_from_sensor = base_from_sensor;
        Ok(self)
    }

    /// The same cloud with the reflectivity of each point, in the sensor's unit.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`].
    pub fn with_intensity(mut self, intensity: Vec<f32>) -> Result<Self, Error> {
        check::length("intensity", intensity.len(), self.len())?;
        self.intensity = Some(intensity);
        Ok(self)
    }

    /// The same cloud with the laser line of each point, counted from the lowest.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`].
    pub fn with_ring(mut self, ring: Vec<u16>) -> Result<Self, Error> {
        check::length("ring", ring.len(), self.len())?;
        self.ring = Some(ring);
        Ok(self)
    }

    /// The same cloud with the time of each point after the cloud's stamp, in seconds.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`].
    pub fn with_time(mut self, time: Vec<f32>) -> Result<Self, Error> {
        check::length("time", time.len(), self.len())?;
        self.time = Some(time);
        Ok(self)
    }

    /// Replaces stamp and points, and gives the cloud all optional channels; keeps sensor, mount and memory.
    pub fn refill(&mut self, stamp: Stamp, returns: impl IntoIterator<Item = LidarReturn>) {
        self.stamp = stamp;
        let intensity = self.intensity.get_or_insert_default();
        let ring = self.ring.get_or_insert_default();
        let time = self.time.get_or_insert_default();
        self.x.clear();
        self.y.clear();
        self.z.clear();
        intensity.clear();
        ring.clear();
        time.clear();
        for point in returns {
            self.x.push(point.position.x);
            self.y.push(point.position.y);
            self.z.push(point.position.z);
            intensity.push(point.intensity);
            ring.push(point.ring);
            time.push(point.time);
        }
    }

    /// Time of the first point.
    pub const fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Which sensor of the vehicle took it.
    pub const fn sensor(&self) -> SensorId {
        self.sensor
    }

    /// Pose of the sensor on the vehicle.
    pub const fn base_from_sensor(&self) -> Se3 {
        self.base_from_sensor
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Coordinates along x, in metres.
    pub fn x(&self) -> &[f32] {
        &self.x
    }

    /// Coordinates along y, in metres.
    pub fn y(&self) -> &[f32] {
        &self.y
    }

    /// Coordinates along z, in metres.
    pub fn z(&self) -> &[f32] {
        &self.z
    }

    /// Reflectivity of each point, in the sensor's unit.
    pub fn intensity(&self) -> Option<&[f32]> {
        self.intensity.as_deref()
    }

    /// Laser line of each point, counted from the lowest.
    pub fn ring(&self) -> Option<&[u16]> {
        self.ring.as_deref()
    }

    /// Time of each point after [`stamp`](Self::stamp), in seconds.
    pub fn time(&self) -> Option<&[f32]> {
        self.time.as_deref()
    }

    /// The points, in metres.
    pub fn points(&self) -> impl ExactSizeIterator<Item = Vector3<f32>> + '_ {
        self.x.iter().zip(&self.y).zip(&self.z).map(|((&x, &y), &z)| Vector3::new(x, y, z))
    }
}

impl PointSource for PointCloud {
    fn len(&self) -> usize {
        self.x.len()
    }

    fn point(&self, index: usize) -> Vector3<f32> {
        Vector3::new(self.x[index], self.y[index], self.z[index])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refilled_cloud_keeps_its_memory_and_its_mount() {
        let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 2.0), crate::geometry::So3::default());
        let mut cloud = PointCloud::default().with_mount(mount).unwrap().with_sensor(SensorId(2));
        let echo = LidarReturn { ring: 3, time: 0.1, ..Default::default() };
        cloud.refill(Stamp::from_seconds(1.0), vec![echo; 50]);
        let memory = cloud.x().as_ptr();
        cloud.refill(Stamp::from_seconds(2.0), vec![echo; 20]);
        assert_eq!((cloud.len(), cloud.stamp()), (20, Stamp::from_seconds(2.0)));
        assert_eq!((cloud.base_from_sensor(), cloud.sensor()), (mount, SensorId(2)));
        assert_eq!((cloud.ring(), cloud.time()), (Some(&[3_u16; 20][..]), Some(&[0.1_f32; 20][..])));
        assert_eq!(cloud.x().as_ptr(), memory);
    }

    #[test]
    fn channels_must_match_the_points() {
        let cloud = || PointCloud::from_points([Vector3::zeros(); 2]);
        assert!(PointCloud::new(vec![0.0], vec![], vec![0.0]).is_err());
        assert!(cloud().with_intensity(vec![0.0]).is_err());
        assert!(cloud().with_ring(vec![0; 3]).is_err());
        assert!(cloud().with_time(vec![]).is_err());
        let nowhere = Se3::from_parts(Vector3::new(0.0, f64::NAN, 0.0), crate::geometry::So3::default());
        assert!(matches!(cloud().with_mount(nowhere), Err(Error::NotFinite { name: "base_from_sensor", .. })));
        let spun = crate::geometry::So3::from_roll_pitch_yaw(f64::NAN, 0.0, 0.0);
        assert!(cloud().with_mount(Se3::from_parts(Vector3::zeros(), spun)).is_err());
    }
}
