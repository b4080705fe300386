//! `SCAN` text logs, one scan per line:
//!
//! ```text
//! SCAN step time odo_x odo_y odo_phi n aperture rightToLeft sensor_x sensor_y sensor_yaw max_range r_0..r_(n-1)
//! ```
//!
//! Beam `i` looks at `-aperture/2 + i aperture/(n-1)` if `rightToLeft` is 1, mirrored if 0; a negative reading is invalid.

use super::{LogEntry, ScanLog};
use crate::{Error, Input, fields::Fields};
use agv_core::sensors::{LaserScan, ScanGeometry, SensorId};

/// Reads a `SCAN` log from memory.
///
/// # Errors
/// The first line that is not a `SCAN` line of `n` readings and a scanner that can be.
pub fn parse(input: &Input) -> Result<ScanLog, Error> {
    let mut log = ScanLog::default();
    for line in input.data_lines() {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        let word = fields.text("SCAN")?;
        if word != "SCAN" {
            return Err(fields.error(format_args!("expected SCAN, got `{}`", crate::fields::shorten(word))));
        }
        fields.text("step")?;
        let stamp = fields.stamp("time")?;
        let odom_from_base = fields.pose(["odo_x", "odo_y", "odo_phi"])?;
        let beams = fields.count("n", LaserScan::MAX_BEAMS)?;
        let aperture = fields.finite("aperture_rad")?;
        let sign = if fields.count("rightToLeft", 1)? == 1 { 1.0 } else { -1.0 };
        let base_from_sensor = fields.pose(["sensor_x", "sensor_y", "sensor_yaw"])?;
        let range_max = fields.finite("maxRange")?;
        let ranges = fields.readings("r", beams)?;
        let geometry = ScanGeometry {
            sensor: SensorId::default(),
            base_from_sensor,
            angle_min: -sign * aperture / 2.0,
            angle_increment: sign * aperture / (beams.max(2) - 1) as f64,
            range_min: 0.02_f64.min(range_max / 2.0),
            range_max,
            time_increment: 0.0,
        };
        let scan = LaserScan::new(stamp, geometry, ranges).map_err(|error| fields.error(error))?;
        fields.end()?;
        log.entries.push(LogEntry { odom_from_base, scan, corrected: None, line: number });
    }
    Ok(log)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{shared, survives_damage};
    use agv_core::sensors::Beam;

    const GOOD: &str = "SCAN 0 5.5 1 2 0.5 3 3.0 0 0.78 0 0 80 1.5 -1 90\n";

    #[test]
    fn beams_may_run_from_left_to_right() {
        let log = parse(&Input::new("s", GOOD)).unwrap();
        let beams: Vec<(f64, Beam)> = log.entries[0].scan.beams().collect();
        assert_eq!(beams, [(1.5, Beam::Hit(1.5)), (0.0, Beam::Invalid), (-1.5, Beam::NoReturn)]);
        assert_eq!(log.entries[0].scan.geometry().base_from_sensor.x(), 0.78);
    }

    #[test]
    fn faults_name_the_line() {
        for (text, reason) in [
            ("SCAN 0 5 1 2 0 3 3 1 0 0 0 80 1 2", ":1: the line ends before field 16 (r)"),
            ("SCAN 0 5 1 2 0 1 3 1 0 0 0 80 1 2", ":1: `2` after the 14 fields"),
            ("SCAN 0 5 1 2 0 1 3 2 0 0 0 80 1", "(rightToLeft) is 2"),
            ("SCAN 0 5 1 2 0 1 3 1 0 0 0 0 1", "range_max"),
            ("SCAN 0 5 1 2 0 2 0 1 0 0 0 80 1 1", "angle_increment"),
            ("SCAN 0 5 1 2 0 1 3 1 0 0 0 80 1\nSCUN", ":2: expected SCAN, got `SCUN`"),
        ] {
            let error = parse(&Input::new("s", text)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error} / {reason}");
        }
        survives_damage(GOOD.as_bytes(), |bytes| drop(ScanLog::parse(&Input::new("s", bytes))));
    }

    #[test]
    fn the_mrpt_logs_are_as_their_notes_say() {
        for (name, scans) in [("malaga_one_loop_scans", 225), ("mrpt_range030_bearing015_scans", 1460)] {
            if let Some(path) = shared(&format!("slam2d/{name}.txt.gz")) {
                let log = ScanLog::read(path).unwrap();
                assert_eq!((log.entries.len(), log.entries[0].scan.len()), (scans, 361));
            }
        }
    }
}
