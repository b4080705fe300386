//! Which sensor an observation came from.

use std::fmt;

/// One sensor's stream of observations, as the caller numbers it.
///
/// A stream is identified by the kind of its observations and this number: two lasers need two numbers, a laser and a
/// camera may share one, and a vehicle with one sensor of each kind needs none (zero is the default). The number stays
/// with the device, whatever its mount: stamps are in order, and latency, noise and bias have one truth, within a stream
/// and not across.
///
/// ```
/// use agv_core::sensors::{LaserScan, ScanGeometry, SensorId};
/// use agv_core::time::Stamp;
///
/// let rear = ScanGeometry { sensor: SensorId(1), ..Default::default() };
/// let scan = LaserScan::new(Stamp::default(), rear, vec![])?;
/// assert_eq!(scan.sensor().to_string(), "sensor 1");
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct SensorId(pub u16);

impl fmt::Display for SensorId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "sensor {}", self.0)
    }
}
