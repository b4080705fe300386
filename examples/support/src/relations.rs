//! Relations: measured relative poses between moments of a log.
//!
//! R. Kümmerle et al., *On measuring the accuracy of SLAM algorithms*, Autonomous Robots 27, 2009. A line is
//! `t1 t2 x y z roll pitch yaw`: the pose at `t2` in the frame of the pose at `t1`, in metres and radians.

use crate::{Error, Input, fields::Fields, input};
use agv_core::{
    geometry::{Se3, So3},
    nalgebra::Vector3,
    time::Stamp,
};
use std::{fmt::Write as _, path::Path};

/// A relative pose that a human verified.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relation {
    /// Time of the first pose; equals a stamp of the log.
    pub first: Stamp,
    /// Time of the second pose; equals a stamp of the log.
    pub second: Stamp,
    /// Pose at `second` in the frame of the pose at `first`.
    pub first_from_second: Se3,
}

/// Reads a file of relations.
///
/// # Errors
/// A file that cannot be read, or the first line that is not eight finite numbers.
pub fn read(path: impl AsRef<Path>) -> Result<Vec<Relation>, Error> {
    parse(&Input::read(path)?)
}

/// Reads relations from memory.
///
/// # Errors
/// As [`read`].
pub fn parse(input: &Input) -> Result<Vec<Relation>, Error> {
    input
        .data_lines()
        .map(|line| {
            let (number, text) = line?;
            let mut fields = Fields::blank_separated(input, number, text);
            let (first, second) = (fields.stamp("t1")?, fields.stamp("t2")?);
            let [x, y, z, roll, pitch, yaw] = fields.finite_array(["x", "y", "z", "roll", "pitch", "yaw"])?;
            fields.end()?;
            let rotation = So3::from_roll_pitch_yaw(roll, pitch, yaw);
            Ok(Relation { first, second, first_from_second: Se3::from_parts(Vector3::new(x, y, z), rotation) })
        })
        .collect()
}

/// Writes a file of relations, gzipped if `path` ends in `.gz`.
///
/// # Errors
/// The operating system's refusal.
pub fn write(path: impl AsRef<Path>, relations: &[Relation]) -> Result<(), Error> {
    let mut text = String::new();
    for relation in relations {
        let t = relation.first_from_second.translation();
        let (roll, pitch, yaw) = relation.first_from_second.rotation().roll_pitch_yaw();
        let (first, second) = (Seconds(relation.first), Seconds(relation.second));
        let _ = writeln!(text, "{first} {second} {} {} {} {roll} {pitch} {yaw}", t.x, t.y, t.z);
    }
    input::write(path, text.as_bytes())
}

/// A stamp as decimal seconds, to the microsecond: an `f64` would not keep the digits of a Unix time.
pub(crate) struct Seconds(pub(crate) Stamp);

impl std::fmt::Display for Seconds {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let microseconds = (i128::from(self.0.nanoseconds()) + 500).div_euclid(1000);
        let sign = if microseconds < 0 { "-" } else { "" };
        write!(f, "{sign}{}.{:06}", microseconds.abs() / 1_000_000, microseconds.abs() % 1_000_000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Scratch, shared, survives_damage};

    const GOOD: &str = "976052905.167303 976052911.885496 -0.05 -0.12 0 0 0 -1.68\n";

    #[test]
    fn a_round_trip_keeps_the_microsecond() {
        let relations = parse(&Input::new("r", GOOD)).unwrap();
        let scratch = Scratch::new("relations");
        write(scratch.path("r.gz"), &relations).unwrap();
        let again = read(scratch.path("r")).unwrap();
        assert_eq!((again[0].first.nanoseconds() + 500) / 1000, 976_052_905_167_303);
        assert!((again[0].first_from_second.to_planar().yaw() + 1.68).abs() < 1e-12);
    }

    #[test]
    fn faults_name_the_line() {
        for (text, reason) in [
            ("1 2 3", ":1: the line ends before field 4 (y)"),
            ("1 2 x 0 0 0 0 0", ":1: field 3 (x) must be a number, got `x`"),
            ("1 2 NaN 0 0 0 0 0", ":1: field 3 (x) must be finite"),
            ("1 2 0 0 0 0 0 0\n1 2 0 0 0 0 0 0 9", ":2: `9` after the 8 fields"),
        ] {
            let error = parse(&Input::new("r", text)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
        survives_damage(GOOD.as_bytes(), |bytes| drop(parse(&Input::new("r", bytes))));
    }

    #[test]
    fn the_intel_relations_are_all_there() {
        if let Some(path) = shared("localization/intel.relations.gz") {
            assert_eq!(read(path).unwrap().len(), 2984);
        }
    }
}
