//! Scan logs and reference poses as plain CSV with a header line; columns are found by name, in any order.
//!
//! - scans: `t` in s, `odom_x, odom_y` in m, `odom_th` in rad, `r0..rN` in m; the beams are a forward-looking SICK's;
//! - reference: `t` in s, `x, y` in m, `th` in rad, one row per scan; other columns are ignored.

use super::{LogEntry, ScanLog, StampedPose, sick_geometry};
use crate::{
    Error, Input,
    fields::{not_a_number, shorten},
    input,
    relations::Seconds,
};
use agv_core::{geometry::Se2, sensors::LaserScan, time::Stamp};
use std::{fmt::Write as _, path::Path};

/// A header, and the rows below it.
struct Table<'a> {
    input: &'a Input,
    header: Vec<&'a str>,
    header_line: usize,
}

impl<'a> Table<'a> {
    fn new(input: &'a Input) -> Result<Self, Error> {
        match input.data_lines().next() {
            Some(line) => line.map(|(header_line, text)| Self {
                input,
                header: text.split(',').map(str::trim).collect(),
                header_line,
            }),
            None => Err(input.file_error("the file is empty")),
        }
    }

    fn column(&self, name: &str) -> Result<usize, Error> {
        self.header
            .iter()
            .position(|&column| column == name)
            .ok_or_else(|| self.input.line_error(self.header_line, format_args!("the header has no column `{name}`")))
    }

    /// Hands `row` the numbers of each row; they are as many as the header has columns.
    fn rows(&self, mut row: impl FnMut(usize, &[f64]) -> Result<(), Error>) -> Result<(), Error> {
        let mut values = Vec::with_capacity(self.header.len());
        for line in self.input.data_lines().skip(1) {
            let (number, text) = line?;
            values.clear();
            for (index, token) in text.split(',').map(str::trim).enumerate() {
                let Some(name) = self.header.get(index) else { break };
                values.push(
                    token.parse().map_err(|_| self.input.line_error(number, not_a_number(index + 1, name, token)))?,
                );
            }
            let fields = text.split(',').count();
            if fields != self.header.len() {
                let reason = format!("{fields} fields, the header has {}", self.header.len());
                return Err(self.input.line_error(number, reason));
            }
            row(number, &values)?;
        }
        Ok(())
    }

    /// Time and pose from four columns of a row.
    fn stamped_pose(&self, line: usize, row: &[f64], columns: [usize; 4]) -> Result<StampedPose, Error> {
        let [t, x, y, yaw] = columns.map(|column| row[column]);
        for (value, column) in [t, x, y, yaw].into_iter().zip(columns) {
            if !value.is_finite() {
                let name = shorten(self.header[column]);
                let reason = format!("field {} ({name}) must be finite, got {value}", column + 1);
                return Err(self.input.line_error(line, reason));
            }
        }
        Ok(StampedPose { stamp: Stamp::from_seconds(t), pose: Se2::new(x, y, yaw) })
    }
}

/// Reads a CSV scan log from memory.
///
/// # Errors
/// A missing column, or the first row that has a wrong number of fields, a field that is no number, or a time or pose
/// that is not finite. Ranges may be NaN or infinite, as drivers write them.
pub fn parse(input: &Input) -> Result<ScanLog, Error> {
    let table = Table::new(input)?;
    let pose = [table.column("t")?, table.column("odom_x")?, table.column("odom_y")?, table.column("odom_th")?];
    let is_range = |name: &&str| name.strip_prefix('r').is_some_and(|digits| digits.parse::<usize>().is_ok());
    let beams = table.header.iter().filter(|name| is_range(name)).count();
    if beams == 0 || beams > LaserScan::MAX_BEAMS {
        let reason = format!("the header has {beams} columns r0, r1, ...: 1 to {} are read", LaserScan::MAX_BEAMS);
        return Err(input.line_error(table.header_line, reason));
    }
    let first = table.column("r0")?;
    let expected = (0..beams).map(|beam| format!("r{beam}"));
    if !table.header[first..].iter().zip(expected).all(|(&column, name)| column == name)
        || first + beams > table.header.len()
    {
        return Err(input.line_error(table.header_line, "columns r0, r1, ... must follow each other without a gap"));
    }

    let geometry = sick_geometry(beams);
    let mut log = ScanLog::default();
    table.rows(|line, row| {
        let StampedPose { stamp, pose: odom_from_base } = table.stamped_pose(line, row, pose)?;
        let ranges = row[first..first + beams].iter().map(|&range| range as f32).collect();
        let scan = LaserScan::new(stamp, geometry, ranges)?;
        log.entries.push(LogEntry { odom_from_base, scan, corrected: None, line });
        Ok(())
    })?;
    Ok(log)
}

/// Writes a CSV scan log, gzipped if `path` ends in `.gz`; ranges to the millimetre, poses to a tenth of one.
///
/// # Errors
/// The operating system's refusal.
pub fn write(path: impl AsRef<Path>, log: &ScanLog) -> Result<(), Error> {
    let mut text = String::from("t,odom_x,odom_y,odom_th");
    for beam in 0..log.entries.first().map_or(0, |entry| entry.scan.len()) {
        let _ = write!(text, ",r{beam}");
    }
    text.push('\n');
    for LogEntry { odom_from_base: pose, scan, .. } in &log.entries {
        let _ = write!(text, "{},{}", Seconds(scan.stamp()), pose_fields(pose));
        for &range in scan.ranges() {
            let _ = write!(text, ",{}", (f64::from(range) * 1e3).round() / 1e3);
        }
        text.push('\n');
    }
    input::write(path, text.as_bytes())
}

/// Reads reference poses: the vehicle in the map.
///
/// # Errors
/// As [`parse`].
pub fn read_reference(path: impl AsRef<Path>) -> Result<Vec<StampedPose>, Error> {
    parse_reference(&Input::read(path)?)
}

/// Reads reference poses from memory.
///
/// # Errors
/// As [`parse`].
pub fn parse_reference(input: &Input) -> Result<Vec<StampedPose>, Error> {
    let table = Table::new(input)?;
    let columns = [table.column("t")?, table.column("x")?, table.column("y")?, table.column("th")?];
    let mut poses = Vec::new();
    table.rows(|line, row| {
        poses.push(table.stamped_pose(line, row, columns)?);
        Ok(())
    })?;
    Ok(poses)
}

/// Writes reference poses, gzipped if `path` ends in `.gz`.
///
/// # Errors
/// The operating system's refusal.
pub fn write_reference(path: impl AsRef<Path>, poses: &[StampedPose]) -> Result<(), Error> {
    let mut text = String::from("t,x,y,th\n");
    for StampedPose { stamp, pose } in poses {
        let _ = writeln!(text, "{},{}", Seconds(*stamp), pose_fields(pose));
    }
    input::write(path, text.as_bytes())
}

/// `x,y,yaw` to a tenth of a millimetre and a hundred-thousandth of a radian.
fn pose_fields(pose: &Se2) -> String {
    let round = |value: f64, scale: f64| (value * scale).round() / scale;
    format!("{},{},{}", round(pose.x(), 1e4), round(pose.y(), 1e4), round(pose.yaw(), 1e5))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Scratch, shared, survives_damage};

    const GOOD: &str = "t,odom_x,odom_y,odom_th,r0,r1,r2\n976052857.337530,1.5,-2,0.25,3.25,81.91,nan\n";

    #[test]
    fn columns_are_found_by_name_in_any_order() {
        let swapped = "r0,r1,odom_th,odom_y,odom_x,t,note\n1,2,0.5,-1,3,10,7\n";
        let entry = &parse(&Input::new("s", swapped)).unwrap().entries[0];
        assert_eq!((entry.odom_from_base.x(), entry.odom_from_base.y()), (3.0, -1.0));
        assert_eq!(entry.scan.ranges(), [1.0, 2.0]);
        assert_eq!(entry.line, 2);
    }

    #[test]
    fn a_round_trip_keeps_scans_and_poses() {
        let scratch = Scratch::new("csv");
        let log = parse(&Input::new("s", GOOD)).unwrap();
        write(scratch.path("s.csv.gz"), &log).unwrap();
        let again = ScanLog::read(scratch.path("s.csv")).unwrap();
        assert_eq!(again.entries[0].odom_from_base, log.entries[0].odom_from_base);
        assert_eq!(again.entries[0].scan.stamp().nanoseconds() / 1000, 976_052_857_337_530);
        assert_eq!(again.entries[0].scan.ranges()[..2], log.entries[0].scan.ranges()[..2]);
        assert!(again.entries[0].scan.ranges()[2].is_nan());
        let poses = vec![StampedPose { stamp: log.entries[0].scan.stamp(), pose: Se2::new(1.0, -2.5, 0.125) }];
        write_reference(scratch.path("r.csv"), &poses).unwrap();
        assert_eq!(read_reference(scratch.path("r.csv")).unwrap()[0].pose, poses[0].pose);
    }

    #[test]
    fn faults_name_line_and_column() {
        let head = "t,odom_x,odom_y,odom_th,r0\n";
        for (text, reason) in [
            (String::new(), "empty"),
            ("t,odom_x,odom_y,r0\n".into(), ":1: the header has no column `odom_th`"),
            ("t,odom_x,odom_y,odom_th\n".into(), ":1: the header has 0 columns r0"),
            ("t,odom_x,odom_y,odom_th,r0,r2\n".into(), ":1: columns r0, r1, ... must follow"),
            (format!("{head}0,0,0,0,1\n1,2,3\n"), ":3: 3 fields, the header has 5"),
            (format!("{head}0,0,0,0,1,5\n"), ":2: 6 fields, the header has 5"),
            (format!("{head}0,0,0,0,x\n"), ":2: field 5 (r0) must be a number, got `x`"),
            (format!("{head}0,NaN,0,0,1\n"), ":2: field 2 (odom_x) must be finite"),
            (format!("{head}0,0,0,0,\u{7}\n"), "got `?`"),
        ] {
            let error = parse(&Input::new("s", text)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error} / {reason}");
        }
    }

    #[test]
    fn damage_never_panics() {
        survives_damage(GOOD.as_bytes(), |bytes| drop(ScanLog::parse(&Input::new("s", bytes))));
        survives_damage(b"t,x,y,th\n1,2,3,4\n", |bytes| drop(parse_reference(&Input::new("r", bytes))));
    }

    #[test]
    fn the_intel_log_is_as_its_notes_say() {
        if let (Some(scans), Some(reference)) =
            (shared("localization/intel_scans.csv.gz"), shared("localization/intel_relations_reference.csv.gz"))
        {
            let log = ScanLog::read(scans).unwrap();
            assert_eq!((log.entries.len(), log.entries[0].scan.len()), (13_631, 180));
            let stamps = |i: usize| log.entries[i].scan.stamp();
            assert_eq!((1..13_631).filter(|&i| stamps(i) < stamps(i - 1)).count(), 631);
            assert_eq!(read_reference(reference).unwrap().len(), 13_631);
        }
    }
}
