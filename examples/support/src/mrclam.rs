//! Logs of the UTIAS multi-robot cooperative localisation and mapping data set (MRCLAM; Leung, Halpern, Barfoot and Liu 2011,
//! *The UTIAS multi-robot cooperative localization and mapping dataset*): odometry, sightings of landmarks by a camera, and
//! the truth of a motion capture system.
//!
//! A folder holds `Barcodes.dat`, `Landmark_Groundtruth.dat` and, for each robot, `Robot<n>_Odometry.dat`,
//! `Robot<n>_Measurement.dat` and `Robot<n>_Groundtruth.dat`, each perhaps with `.gz`: numbers separated by blanks, `#`
//! comments, times in seconds. Sightings name barcodes; here they name subjects, as the map does.

use crate::{Error, Input, fields::Fields, log::StampedPose};
use agv_core::{geometry::Se2, nalgebra::Vector2, time::Stamp};
use std::{collections::BTreeMap, path::Path};

/// Velocities from a time on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Velocity {
    /// From when on.
    pub stamp: Stamp,
    /// Speed ahead, in m/s.
    pub forward: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
}

/// What the camera saw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenSubject {
    /// When.
    pub stamp: Stamp,
    /// Number of the subject, a robot or a landmark; none for a barcode that is not on the list.
    pub subject: Option<u32>,
    /// Range in metres.
    pub range: f64,
    /// Bearing in radians, counter-clockwise from ahead.
    pub bearing: f64,
}

/// The log of one robot among landmarks.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MrclamLog {
    /// Numbers and places of the landmarks, in metres.
    pub landmarks: Vec<(u32, Vector2<f64>)>,
    /// What the odometry says.
    pub odometry: Vec<Velocity>,
    /// What the camera saw, robots included.
    pub sightings: Vec<SeenSubject>,
    /// Where the robot was.
    pub reference: Vec<StampedPose<Se2>>,
}

impl MrclamLog {
    /// Reads the log of a robot from a folder.
    ///
    /// # Errors
    /// A file that cannot be read, or the first line that is not what it should be.
    pub fn read(folder: impl AsRef<Path>, robot: u32) -> Result<Self, Error> {
        let file = |name: &str| Input::read(folder.as_ref().join(name));
        let own = |kind: &str| file(&format!("Robot{robot}_{kind}.dat"));
        let subjects = subjects(&file("Barcodes.dat")?)?;
        Ok(Self {
            landmarks: landmarks(&file("Landmark_Groundtruth.dat")?)?,
            odometry: odometry(&own("Odometry")?)?,
            sightings: sightings(&own("Measurement")?, &subjects)?,
            reference: reference(&own("Groundtruth")?)?,
        })
    }
}

/// Makes a value of each line that is no comment.
fn rows<'a, T>(
    input: &'a Input,
    mut row: impl FnMut(&mut Fields<'a, std::str::SplitAsciiWhitespace<'a>>) -> Result<T, Error>,
) -> Result<Vec<T>, Error> {
    let parse = |line: Result<(usize, &'a str), Error>| {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        let value = row(&mut fields)?;
        fields.end()?;
        Ok(value)
    };
    input.data_lines().map(parse).collect()
}

fn number<'a, I: Iterator<Item = &'a str>>(fields: &mut Fields<'a, I>, name: &str) -> Result<u32, Error> {
    fields.count(name, u32::MAX as usize).map(|number| number as u32)
}

fn subjects(input: &Input) -> Result<BTreeMap<u32, u32>, Error> {
    let pairs = rows(input, |fields| {
        let subject = number(fields, "subject")?;
        Ok((number(fields, "barcode")?, subject))
    })?;
    Ok(pairs.into_iter().collect())
}

fn landmarks(input: &Input) -> Result<Vec<(u32, Vector2<f64>)>, Error> {
    rows(input, |fields| {
        let subject = number(fields, "subject")?;
        let [x, y, _, _] = fields.finite_array(["x", "y", "x std-dev", "y std-dev"])?;
        Ok((subject, Vector2::new(x, y)))
    })
}

fn odometry(input: &Input) -> Result<Vec<Velocity>, Error> {
    rows(input, |fields| {
        let stamp = fields.stamp("time")?;
        let [forward, yaw_rate] = fields.finite_array(["forward velocity", "angular velocity"])?;
        Ok(Velocity { stamp, forward, yaw_rate })
    })
}

fn sightings(input: &Input, subjects: &BTreeMap<u32, u32>) -> Result<Vec<SeenSubject>, Error> {
    rows(input, |fields| {
        let stamp = fields.stamp("time")?;
        let subject = subjects.get(&number(fields, "barcode")?).copied();
        let [range, bearing] = fields.finite_array(["range", "bearing"])?;
        Ok(SeenSubject { stamp, subject, range, bearing })
    })
}

fn reference(input: &Input) -> Result<Vec<StampedPose<Se2>>, Error> {
    rows(input, |fields| {
        Ok(StampedPose { stamp: fields.stamp("time")?, pose: fields.pose(["x", "y", "orientation"])? })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_and_barcodes_become_subjects() {
        let subjects = subjects(&Input::new("b", "# Subject # Barcode #\n  6 \t  63 \n 7 81\n")).unwrap();
        let seen = sightings(&Input::new("m", "10.5 \t 63 \t 2.5 \t -0.25 \n10.5 99 1 0\n"), &subjects).unwrap();
        assert_eq!(seen.iter().map(|one| one.subject).collect::<Vec<_>>(), [Some(6), None]);
        assert_eq!((seen[0].range, seen[0].bearing, seen[0].stamp), (2.5, -0.25, Stamp::from_seconds(10.5)));
        let places = landmarks(&Input::new("l", "6 0.5 -4.25 0.1 0.2\n")).unwrap();
        assert_eq!(places, [(6, Vector2::new(0.5, -4.25))]);
        assert_eq!(odometry(&Input::new("o", "1 0.1 0.2\n")).unwrap()[0].yaw_rate, 0.2);
        assert_eq!(reference(&Input::new("g", "1 2 3 0.5\n")).unwrap()[0].pose, Se2::new(2.0, 3.0, 0.5));
    }

    #[test]
    fn bad_lines_are_named() {
        for (bad, message) in [
            ("1 63 2", "m:1: the line ends before field 4 (bearing)"),
            ("1 x 2 3", "m:1: field 2 (barcode) must be a whole number, got `x`"),
            ("1 63 nan 3", "m:1: field 3 (range) must be finite, got NaN"),
            ("1 63 2 3 4", "m:1: `4` after the 4 fields"),
        ] {
            assert_eq!(sightings(&Input::new("m", bad), &BTreeMap::new()).unwrap_err().to_string(), message);
        }
        assert!(MrclamLog::read("no such folder", 1).is_err());
    }
}
