//! CARMEN logs: the text messages `FLASER`, `ROBOTLASER1`, `ODOM` and `PARAM` of the Carnegie Mellon navigation toolkit.
//!
//! ```text
//! FLASER n r_1..r_n  x y th  odom_x odom_y odom_th  ipc_time host logger_time
//! ROBOTLASER1 type start_angle fov step max_range accuracy remission_mode n r_1..r_n m e_1..e_m
//!     laser_x laser_y laser_th  robot_x robot_y robot_th  tv rv forward_dist side_dist turn_axis  ipc_time host logger_time
//! ODOM x y th  tv rv acceleration  ipc_time host logger_time
//! ```
//!
//! What the fields mean here: the odometry of `FLASER` is `odom_*`; `x y th` is where the logger or a SLAM program put
//! the laser and becomes [`LogEntry::corrected`]; the mount comes from `PARAM robot_frontlaser_offset`. `ROBOTLASER1`
//! states laser and robot pose, so their difference is the mount. A reading at `max_range` is *no return*. The time is
//! the logger's (seconds since the start of the log), or the message's own where the logger's is absent. Other messages
//! are skipped.

use super::{LogEntry, OdometryEntry, ScanLog, sick_geometry};
use crate::{Error, Input, fields::Fields};
use agv_core::{
    geometry::{LieGroup, Se2},
    sensors::{LaserScan, ScanGeometry, SensorId},
    time::Stamp,
};

type Line<'a> = Fields<'a, std::str::SplitAsciiWhitespace<'a>>;

/// Whether a log may start with this word.
pub(super) fn is_message(word: &str) -> bool {
    const OTHERS: [&str; 8] = ["PARAM", "SYNC", "ODOM", "TRUEPOS", "NEFF", "FLASER", "RLASER", "RAWLASER1"];
    OTHERS.contains(&word) || word.starts_with("ROBOTLASER") || word.starts_with("RAWLASER")
}

/// Reads a CARMEN log from memory.
///
/// # Errors
/// The first `FLASER`, `ROBOTLASER1` or `ODOM` line that is cut short, holds what is no number, or describes a scanner
/// that cannot be.
pub fn parse(input: &Input) -> Result<ScanLog, Error> {
    let mut log = ScanLog::default();
    let mut mount = Se2::default();
    for line in input.data_lines() {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        match fields.text("message")? {
            "PARAM" if fields.text("name").is_ok_and(|name| name == "robot_frontlaser_offset") => {
                mount = Se2::new(fields.finite("robot_frontlaser_offset")?, 0.0, 0.0);
            }
            "FLASER" => log.entries.push(flaser(fields, number, mount)?),
            "ROBOTLASER1" => log.entries.push(robot_laser(fields, number)?),
            "ODOM" => {
                let odom_from_base = fields.pose(["x", "y", "theta"])?;
                fields.finite_array(["tv", "rv", "acceleration"])?;
                let stamp = stamp(&mut fields)?;
                log.odometry.push(OdometryEntry { stamp, odom_from_base, scans_before: log.entries.len() });
            }
            _ => {}
        }
    }
    Ok(log)
}

fn flaser(mut fields: Line<'_>, line: usize, mount: Se2) -> Result<LogEntry, Error> {
    let beams = fields.count("num_readings", LaserScan::MAX_BEAMS)?;
    let ranges = fields.readings("range", beams)?;
    let corrected = fields.pose(["x", "y", "theta"])?;
    let odom_from_base = fields.pose(["odom_x", "odom_y", "odom_theta"])?;
    let stamp = stamp(&mut fields)?;
    let geometry = ScanGeometry { base_from_sensor: mount, ..sick_geometry(beams) };
    let scan = LaserScan::new(stamp, geometry, ranges).map_err(|error| fields.error(error))?;
    Ok(LogEntry { odom_from_base, scan, corrected: Some(corrected), line })
}

fn robot_laser(mut fields: Line<'_>, line: usize) -> Result<LogEntry, Error> {
    fields.text("laser_type")?;
    let [angle_min, _, angle_increment, range_max, _] =
        fields.finite_array(["start_angle", "field_of_view", "angular_resolution", "maximum_range", "accuracy"])?;
    fields.text("remission_mode")?;
    let beams = fields.count("num_readings", LaserScan::MAX_BEAMS)?;
    let mut ranges = fields.readings("range", beams)?;
    for range in &mut ranges {
        if f64::from(*range) >= range_max {
            *range = f32::INFINITY;
        }
    }
    let remissions = fields.count("num_remissions", LaserScan::MAX_BEAMS)?;
    fields.readings("remission", remissions)?;
    let odom_from_laser = fields.pose(["laser_x", "laser_y", "laser_theta"])?;
    let odom_from_base = fields.pose(["robot_x", "robot_y", "robot_theta"])?;
    fields.finite_array(["tv", "rv", "forward_safety_dist", "side_safety_dist", "turn_axis"])?;
    let stamp = stamp(&mut fields)?;
    let geometry = ScanGeometry {
        sensor: SensorId::default(),
        base_from_sensor: odom_from_base.between(&odom_from_laser),
        angle_min,
        angle_increment,
        range_min: 0.02_f64.min(range_max / 2.0),
        range_max,
        time_increment: 0.0,
    };
    let scan = LaserScan::new(stamp, geometry, ranges).map_err(|error| fields.error(error))?;
    Ok(LogEntry { odom_from_base, scan, corrected: None, line })
}

/// The end of every message: its own time, the host, the logger's time.
fn stamp(fields: &mut Line<'_>) -> Result<Stamp, Error> {
    let ipc = fields.stamp("ipc_timestamp")?;
    if fields.text("host").is_err() {
        return Ok(ipc);
    }
    let logger = fields.stamp("logger_timestamp")?;
    // GMapping writes 0 for the logger's time.
    Ok(if logger == Stamp::default() { ipc } else { logger })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{shared, survives_damage};
    use agv_core::sensors::Beam;

    const FLASER: &str = "PARAM robot_frontlaser_offset 0.3 h 0\n# c\nODOM 1 2 3 0 0 0 4 h 5\nFLASER 3 1.5 2.5 81.91 7 8 0.5 1 2 0.25 10 host 11\n";
    const ROBOT: &str = "ROBOTLASER1 0 -1.5708 3.1416 0.5 8 0.01 0 3 1 8 2 1 0 1.1 2 0 1 2 0 0 0 0.2 0.3 0 9 host 10\n";

    #[test]
    fn flaser_has_its_odometry_mount_and_corrected_pose() {
        let log = parse(&Input::new("c", FLASER)).unwrap();
        let entry = &log.entries[0];
        assert_eq!((entry.odom_from_base.x(), entry.corrected.unwrap().x()), (1.0, 7.0));
        assert_eq!(entry.scan.geometry().base_from_sensor, Se2::new(0.3, 0.0, 0.0));
        assert_eq!(entry.scan.stamp(), Stamp::from_seconds(11.0));
        assert_eq!(entry.scan.beams().last().unwrap().1, Beam::NoReturn);
        assert_eq!((log.odometry[0].scans_before, log.odometry[0].odom_from_base.y()), (0, 2.0));
    }

    #[test]
    fn robotlaser_states_its_scanner() {
        let entry = &parse(&Input::new("c", ROBOT)).unwrap().entries[0];
        let beams: Vec<Beam> = entry.scan.beams().map(|(_, beam)| beam).collect();
        assert_eq!(beams, [Beam::Hit(1.0), Beam::NoReturn, Beam::Hit(2.0)]);
        assert!((entry.scan.geometry().base_from_sensor.x() - 0.1).abs() < 1e-12);
        assert_eq!(entry.scan.geometry().angle_increment, 0.5);
    }

    #[test]
    fn faults_name_the_line() {
        for (text, reason) in [
            ("FLASER 3 1 2", ":1: the line ends before field 5 (range)"),
            ("FLASER 99999999999 1 2", "at most 65536 is allowed"),
            ("FLASER -1 1 2", "(num_readings) must be a whole number"),
            ("FLASER 1 1 0 0 0 0 nan 0 0 h 0", "(odom_y) must be finite"),
            ("ODOM 1 2 3 0 0 0 4 h 5\nODOM 1 2", ":2: the line ends before"),
            ("ROBOTLASER1 0 0 3 0 8 0.01 0 1 1 0 0 0 0 0 0 0 0 0 0 0 0 9 h 10", "angle_increment"),
            ("ROBOTLASER1 0 0 3 1 -8 0.01 0 1 1 0 0 0 0 0 0 0 0 0 0 0 0 9 h 10", "range_max"),
        ] {
            let error = parse(&Input::new("c", text)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error} / {reason}");
        }
        for good in [FLASER, ROBOT] {
            survives_damage(good.as_bytes(), |bytes| drop(ScanLog::parse(&Input::new("c", bytes))));
        }
    }

    #[test]
    fn the_radish_logs_are_as_their_notes_say() {
        for (name, scans, beams) in [("orebro", 237, 181), ("belgioioso", 395, 361)] {
            if let Some(path) = shared(&format!("slam2d/{name}_gmapping_corrected.log.gz")) {
                let log = ScanLog::read(path).unwrap();
                assert_eq!((log.entries.len(), log.entries[0].scan.len()), (scans, beams));
                assert!(log.odometry.len() > scans);
                assert!(log.with_odometry_readings().entries.len() >= scans - 1);
            }
        }
    }
}
