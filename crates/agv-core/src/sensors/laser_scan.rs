//! A planar laser scan, with the meaning of every reading stated.

use super::SensorId;
use crate::{Error, check, geometry::Se2, time::Stamp};
use nalgebra::Vector2;

/// How a planar scanner looks at the world; the same for all its scans.
///
/// An upside-down scanner has a negative `angle_increment`: seen from above, its beams run clockwise.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ScanGeometry {
    /// Which scanner of the vehicle it is.
    #[cfg_attr(feature = "serde", serde(default))]
    pub sensor: SensorId,
    /// Pose of the scanner on the vehicle.
    pub base_from_sensor: Se2,
    /// Direction of the first beam in the sensor frame, in radians.
    pub angle_min: f64,
    /// Angle from one beam to the next, in radians; negative if the beams run clockwise.
    pub angle_increment: f64,
    /// Least range that the scanner can measure, in metres.
    pub range_min: f64,
    /// Range from which on a reading is no surface, in metres.
    pub range_max: f64,
    /// Time from one beam to the next, in seconds; zero if the scan is instantaneous or already deskewed.
    pub time_increment: f64,
}

impl Default for ScanGeometry {
    /// A 270° scanner of 1081 beams and 30 m range, as safety scanners of AGVs have, at the vehicle's origin.
    fn default() -> Self {
        Self {
            sensor: SensorId::default(),
            base_from_sensor: Se2::default(),
            angle_min: -135_f64.to_radians(),
            angle_increment: 0.25_f64.to_radians(),
            range_min: 0.02,
            range_max: 30.0,
            time_increment: 0.0,
        }
    }
}

impl ScanGeometry {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is not finite, a zero `angle_increment`, or `range_min` not below `range_max`.
    pub fn validate(&self) -> Result<(), Error> {
        let mount = self.base_from_sensor;
        check::all_finite("base_from_sensor", &[mount.x(), mount.y(), mount.yaw()])?;
        check::finite("angle_min", self.angle_min)?;
        check::finite("angle_increment", self.angle_increment)?;
        check::positive("angle_increment (magnitude)", self.angle_increment.abs())?;
        check::positive("range_max", self.range_max)?;
        check::in_range("range_min", self.range_min, 0.0, self.range_max.next_down())?;
        check::non_negative("time_increment", self.time_increment)?;
        Ok(())
    }

    /// Direction of beam `index` in the sensor frame, in radians.
    #[inline]
    pub fn angle(&self, index: usize) -> f64 {
        self.angle_min + index as f64 * self.angle_increment
    }
}

/// What one beam says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Beam {
    /// A surface at this range, in metres.
    Hit(f64),
    /// Nothing before the scanner's `range_max`: free space, if the surfaces there reflect at all.
    NoReturn,
    /// No statement: NaN, negative, or below `range_min`.
    Invalid,
}

/// A planar laser scan.
///
/// Readings are stored as the driver gave them and read through [`Beam`]: a range in `[range_min, range_max)` is a
/// hit, one of `range_max` or more (or +∞) is *no return*, and NaN, −∞ or one below `range_min` says nothing. Drivers
/// report the greatest range where nothing answers, so that it is no hit, as in AMCL; both limits are rounded to `f32`
/// like the readings, so that a reading of 8.1 m is at a limit of 8.1 m.
///
/// ```
/// use agv_core::sensors::{Beam, LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
///
/// let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![1.5, f32::INFINITY, f32::NAN])?;
/// let beams: Vec<Beam> = scan.beams().map(|(_, beam)| beam).collect();
/// assert_eq!(beams, [Beam::Hit(1.5), Beam::NoReturn, Beam::Invalid]);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawScan"))]
pub struct LaserScan {
    stamp: Stamp,
    geometry: ScanGeometry,
    #[cfg_attr(feature = "serde", serde(with = "crate::stored_readings"))]
    ranges: Vec<f32>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawScan {
    stamp: Stamp,
    geometry: ScanGeometry,
    #[serde(with = "crate::stored_readings")]
    ranges: Vec<f32>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawScan> for LaserScan {
    type Error = Error;

    fn try_from(raw: RawScan) -> Result<Self, Error> {
        Self::new(raw.stamp, raw.geometry, raw.ranges)
    }
}

impl LaserScan {
    /// Most beams that a scan may have: ten times the densest planar scanner.
    pub const MAX_BEAMS: usize = 1 << 16;

    /// A scan of `ranges` in metres, in the order of the beams; `stamp` is the time of the first beam.
    ///
    /// An empty scan is allowed (a driver that lost its sensor sends them): consumers skip it.
    ///
    /// # Errors
    /// An invalid `geometry`, or more than [`MAX_BEAMS`](Self::MAX_BEAMS) ranges.
    pub fn new(stamp: Stamp, geometry: ScanGeometry, ranges: Vec<f32>) -> Result<Self, Error> {
        geometry.validate()?;
        if ranges.len() > Self::MAX_BEAMS {
            return Err(Error::TooMany { name: "ranges", len: ranges.len(), max: Self::MAX_BEAMS });
        }
        Ok(Self { stamp, geometry, ranges })
    }

    /// Replaces stamp and readings, keeping the geometry and the memory.
    ///
    /// # Errors
    /// More than [`MAX_BEAMS`](Self::MAX_BEAMS) ranges; the scan is then as it was.
    pub fn refill(&mut self, stamp: Stamp, ranges: impl ExactSizeIterator<Item = f32>) -> Result<(), Error> {
        if ranges.len() > Self::MAX_BEAMS {
            return Err(Error::TooMany { name: "ranges", len: ranges.len(), max: Self::MAX_BEAMS });
        }
        self.stamp = stamp;
        self.ranges.clear();
        self.ranges.extend(ranges);
        Ok(())
    }

    /// Becomes a copy of `other` in which the beams that are not kept say nothing, in this scan's memory.
    pub fn copy_masked(&mut self, other: &Self, mut keep: impl FnMut(usize) -> bool) {
        (self.stamp, self.geometry) = (other.stamp, other.geometry);
        self.ranges.clear();
        self.ranges.extend(other.ranges.iter().enumerate().map(|(i, &range)| if keep(i) { range } else { f32::NAN }));
    }

    /// Time of the first beam.
    pub const fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Which scanner of the vehicle took it.
    pub const fn sensor(&self) -> SensorId {
        self.geometry.sensor
    }

    /// How the scanner looks at the world.
    pub const fn geometry(&self) -> &ScanGeometry {
        &self.geometry
    }

    /// Readings as the driver gave them, in metres.
    pub fn ranges(&self) -> &[f32] {
        &self.ranges
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.ranges.len()
    }

    /// Whether there are no beams.
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// What a raw reading in metres means to this scanner.
    #[inline]
    pub fn interpret(&self, range: f32) -> Beam {
        if range >= self.geometry.range_max as f32 {
            Beam::NoReturn
        } else if range >= self.geometry.range_min as f32 {
            Beam::Hit(f64::from(range))
        } else {
            Beam::Invalid
        }
    }

    /// Each beam with its direction in the sensor frame, in radians.
    pub fn beams(&self) -> impl ExactSizeIterator<Item = (f64, Beam)> + '_ {
        self.ranges.iter().enumerate().map(|(i, &range)| (self.geometry.angle(i), self.interpret(range)))
    }

    /// End points of all hits in the base frame, in metres, in the order of the beams.
    pub fn points_in_base(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let mount = self.geometry.base_from_sensor;
        self.beams().filter_map(move |(angle, beam)| match beam {
            Beam::Hit(range) => {
                let (sin, cos) = angle.sin_cos();
                Some(mount * Vector2::new(range * cos, range * sin))
            }
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_geometry_is_named() {
        let good = ScanGeometry::default();
        for (name, bad) in [
            ("angle_min", ScanGeometry { angle_min: f64::NAN, ..good }),
            ("angle_increment (magnitude)", ScanGeometry { angle_increment: 0.0, ..good }),
            ("range_max", ScanGeometry { range_max: 0.0, ..good }),
            ("range_min", ScanGeometry { range_min: 30.0, ..good }),
            ("range_min", ScanGeometry { range_min: f64::NAN, ..good }),
            ("time_increment", ScanGeometry { time_increment: -1.0, ..good }),
            ("base_from_sensor", ScanGeometry { base_from_sensor: Se2::new(f64::INFINITY, 0.0, 0.0), ..good }),
        ] {
            let error = LaserScan::new(Stamp::default(), bad, vec![1.0]).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
    }

    /// Whichever way the limits round to `f32`.
    #[test]
    fn a_reading_of_the_greatest_range_is_no_return_and_one_of_the_least_a_hit() {
        for (max, range_max) in [(4.1_f32, 4.1), (5.6, 5.6), (8.1, 8.1), (30.0, 30.0), (81.83, 81.83)] {
            let geometry = ScanGeometry { range_max, range_min: 0.1 * range_max, ..Default::default() };
            let scan = LaserScan::new(Stamp::default(), geometry, vec![]).unwrap();
            let below = max.next_down();
            assert_eq!(scan.interpret(max), Beam::NoReturn, "{max}");
            assert_eq!(scan.interpret(below), Beam::Hit(f64::from(below)));
            let least = geometry.range_min as f32;
            assert_eq!(scan.interpret(least), Beam::Hit(f64::from(least)), "{least}");
            assert_eq!(scan.interpret(least.next_down()), Beam::Invalid);
        }
    }

    #[test]
    fn too_many_beams_leave_the_scan_as_it_was() {
        let mut scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![1.0]).unwrap();
        let before = scan.clone();
        assert!(scan.refill(Stamp::default(), vec![1.0; LaserScan::MAX_BEAMS + 1].into_iter()).is_err());
        assert_eq!(scan, before);
    }

    #[test]
    fn a_masked_copy_keeps_what_it_is_told_to() {
        let geometry = ScanGeometry { sensor: SensorId(3), ..Default::default() };
        let full = LaserScan::new(Stamp::from_seconds(1.0), geometry, vec![1.0, 2.0, 3.0, f32::INFINITY]).unwrap();
        let mut masked = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![9.0; 7]).unwrap();
        masked.copy_masked(&full, |beam| beam % 2 == 1);
        assert_eq!((masked.stamp(), masked.geometry()), (full.stamp(), full.geometry()));
        let beams: Vec<Beam> = masked.beams().map(|(_, beam)| beam).collect();
        assert_eq!(beams, [Beam::Invalid, Beam::Hit(2.0), Beam::Invalid, Beam::NoReturn]);
    }

    #[test]
    fn an_upside_down_scanner_mirrors_its_points() {
        let geometry = ScanGeometry { angle_min: 0.5, angle_increment: -0.5, ..Default::default() };
        let scan = LaserScan::new(Stamp::default(), geometry, vec![1.0; 3]).unwrap();
        let y: Vec<f64> = scan.points_in_base().map(|p| p.y).collect();
        assert!(y[0] > 0.0 && y[1] == 0.0 && y[2] < 0.0);
    }
}
