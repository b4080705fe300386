//! Scan logs: odometry and laser scans in recording order, whatever the file format.
//!
//! [`ScanLog::read`] tells the formats apart by content: [`csv`], CARMEN ([`carmen`]) and `SCAN` text ([`scan_text`]).

pub mod carmen;
pub mod csv;
pub mod scan_text;

use crate::{Error, Input};
use agv_core::{
    geometry::Se2,
    sensors::{LaserScan, ScanGeometry, SensorId},
    time::Stamp,
};
use std::path::Path;

/// A pose with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedPose<P = Se2> {
    /// When.
    pub stamp: Stamp,
    /// Where.
    pub pose: P,
}

/// A laser scan, and where the odometry was when it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct LogEntry {
    /// Pose of the vehicle in the odometry frame.
    pub odom_from_base: Se2,
    /// The scan; its stamp is the time of the entry.
    pub scan: LaserScan,
    /// The pose that a SLAM program wrote into the log, if the format has room for one.
    pub corrected: Option<Se2>,
    /// Line of the file, for messages.
    pub line: usize,
}

/// Odometry between scans.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryEntry {
    /// Time of the reading.
    pub stamp: Stamp,
    /// Pose of the vehicle in the odometry frame.
    pub odom_from_base: Se2,
    /// Number of scans in the log before this reading.
    pub scans_before: usize,
}

/// A recorded drive, in recording order.
///
/// Time stamps of real logs step backwards now and then; they are kept as they are, and the order is the file's.
///
/// ```
/// use agv_support::{Input, log::ScanLog};
///
/// let log = ScanLog::parse(&Input::new("a.csv", "t,odom_x,odom_y,odom_th,r0,r1\n0.5,1,2,0,3.0,81.9\n"))?;
/// assert_eq!(log.entries[0].odom_from_base.x(), 1.0);
/// assert_eq!(log.entries[0].scan.len(), 2);
/// # Ok::<(), agv_support::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScanLog {
    /// The scans.
    pub entries: Vec<LogEntry>,
    /// Odometry between the scans, if the format has it.
    pub odometry: Vec<OdometryEntry>,
}

impl ScanLog {
    /// Reads a log of any of the formats.
    ///
    /// # Errors
    /// A file that cannot be read, that none of the formats explains, or the first line that is wrong.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, Error> {
        Self::parse(&Input::read(path)?)
    }

    /// Reads a log of any of the formats from memory.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(input: &Input) -> Result<Self, Error> {
        let Some(first) = input.data_lines().next() else {
            return Err(input.file_error("the file is empty"));
        };
        let (line, text) = first?;
        match text.split([',', ' ', '\t']).next().unwrap_or_default() {
            "SCAN" => scan_text::parse(input),
            _ if text.contains(',') => csv::parse(input),
            word if carmen::is_message(word) => carmen::parse(input),
            _ => Err(input.line_error(line, "neither a CSV header, nor a CARMEN message, nor a SCAN line")),
        }
    }

    /// The same log with each scan's odometry taken from the last odometry reading before it.
    ///
    /// Logs that a SLAM program wrote may repeat the corrected pose in the scan records, with raw odometry left only
    /// in the readings between them. Scans before the first reading are dropped.
    #[must_use]
    pub fn with_odometry_readings(mut self) -> Self {
        let mut readings = self.odometry.iter().peekable();
        let mut last = None;
        let mut index = 0;
        self.entries.retain_mut(|entry| {
            while let Some(reading) = readings.next_if(|reading| reading.scans_before <= index) {
                last = Some(reading.odom_from_base);
            }
            index += 1;
            last.map(|pose| entry.odom_from_base = pose).is_some()
        });
        self.odometry.clear();
        self
    }
}

/// Geometry of a forward-looking SICK LMS 200 from its number of beams, as CARMEN knows it: 180° in steps of 1° or 0.5°,
/// 100° in steps of 0.25°. Other numbers spread over 180°, ends included.
///
/// Readings above 80 m, the scanner's limit, are *no return* (the device sends 81.83 m and the like).
pub(crate) fn sick_geometry(beams: usize) -> ScanGeometry {
    let (start, step) = match beams {
        180 | 181 => (-90.0, 1.0),
        360 | 361 => (-90.0, 0.5),
        401 => (-50.0, 0.25),
        _ => (-90.0, 180.0 / (beams.max(2) - 1) as f64),
    };
    ScanGeometry {
        sensor: SensorId::default(),
        base_from_sensor: Se2::default(),
        angle_min: f64::to_radians(start),
        angle_increment: f64::to_radians(step),
        range_min: 0.02,
        range_max: 80.0,
        time_increment: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_told_apart_by_content() {
        let beams = |text: &str| ScanLog::parse(&Input::new("f", text)).map(|log| log.entries[0].scan.len());
        assert_eq!(beams("# c\nt,odom_x,odom_y,odom_th,r0\n0,0,0,0,1\n").unwrap(), 1);
        assert_eq!(beams("# c\nPARAM a b\nFLASER 2 1 1 0 0 0 0 0 0 5 host 5\n").unwrap(), 2);
        assert_eq!(beams("SCAN 0 1 0 0 0 3 3.14 1 0 0 0 80 1 2 3\n").unwrap(), 3);
        for text in ["", "\n\n", "hello world", "\u{1}\u{2}"] {
            assert!(beams(text).is_err());
        }
    }

    #[test]
    fn raw_odometry_replaces_the_corrected_pose() {
        let text = "FLASER 1 1 9 9 9 9 9 9 0 h 0\nODOM 1 0 0 0 0 0 1 h 1\nFLASER 1 1 9 9 9 9 9 9 2 h 2\n";
        let log = ScanLog::parse(&Input::new("f", text)).unwrap().with_odometry_readings();
        assert_eq!(log.entries.len(), 1);
        assert_eq!(log.entries[0].odom_from_base, Se2::new(1.0, 0.0, 0.0));
    }
}
