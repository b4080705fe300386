//! Logs of drives among landmarks: odometry, sightings, and the truth as far as it is known.
//!
//! | format | lines | files |
//! |---|---|---|
//! | [graph](read_graph) | `ODOMETRY i j dx dy dyaw` and `LANDMARK pose landmark dx dy`, each with a covariance: Victoria Park as GTSAM has it | one |
//! | [ranges](read_ranges) | `time distance turn` and `time sender beacon range`: CMU's Plaza | `..._DR.txt`, `..._TD.txt` |
//! | [sightings](read_sightings) | `RB step time x y yaw landmark range bearing pitch`: MRPT's simulated demo | `..._rb.txt`, and for the truth `..._path_gt.txt`, `..._landmarks_gt.txt` |
//!
//! [`read`] tells them apart by their lines, and finds the other files beside the first.

mod graph;
mod ranges;
mod sightings;

use crate::{Error, Input, fields::Fields};
use agv_core::{
    geometry::Se2,
    nalgebra::{Matrix2, Matrix3, Vector2},
    time::Stamp,
};
use std::path::{Path, PathBuf};

pub use graph::read_graph;
pub use ranges::read_ranges;
pub use sightings::read_sightings;

/// What was measured of a landmark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SeenAs {
    /// Distance in metres, and direction in radians, counter-clockwise from ahead.
    RangeBearing(f64, f64),
    /// Place in the frame of the vehicle, in metres, with its covariance.
    Place(Vector2<f64>, Matrix2<f64>),
    /// Distance in metres.
    Range(f64),
}

/// A landmark that was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Which one it is; none if the log does not know.
    pub id: Option<u32>,
    /// What was measured.
    pub measured: SeenAs,
}

/// A motion, and what was seen at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkStep {
    /// When; the number of the pose where the log has no times.
    pub stamp: Stamp,
    /// Motion since the step before, by odometry.
    pub motion: Se2,
    /// Its covariance; zero where the log does not state it.
    pub covariance: Matrix3<f64>,
    /// What was seen.
    pub seen: Vec<Seen>,
}

/// A drive among landmarks.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LandmarkLog {
    /// In their order.
    pub steps: Vec<LandmarkStep>,
    /// Where the vehicle truly was; empty if that is not known.
    pub reference: Vec<(Stamp, Se2)>,
    /// Where the landmarks truly are; empty if that is not known.
    pub landmarks: Vec<(u32, Vector2<f64>)>,
}

/// The formats by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LandmarkFormat {
    /// Odometry and places with covariances: Victoria Park
    Victoria,
    /// Dead reckoning and ranges: Plaza
    Plaza,
    /// Odometry with ranges and bearings: MRPT's demo
    Mrpt,
}

/// Reads a log: `path` is one of its files, the others lie beside it. The format is told by the first line unless it is given.
///
/// # Errors
/// A file that cannot be read, or the first line that is not what it should be.
pub fn read(path: impl AsRef<Path>, format: Option<LandmarkFormat>) -> Result<LandmarkLog, Error> {
    let path = path.as_ref();
    let input = Input::read(path)?;
    let format = match format {
        Some(format) => format,
        None => detect(&input)?,
    };
    match format {
        LandmarkFormat::Victoria => read_graph(&input),
        LandmarkFormat::Plaza => {
            let (dead_reckoning, ranges) = (sibling(path, "_TD", "_DR"), sibling(path, "_DR", "_TD"));
            let other = |found: Option<PathBuf>| found.map_or_else(|| Ok(input.clone()), Input::read);
            read_ranges(&other(dead_reckoning)?, &other(ranges)?)
        }
        LandmarkFormat::Mrpt => {
            let mut log = read_sightings(&input)?;
            if let Some(path) = sibling(path, "_rb", "_path_gt").filter(|path| exists(path)) {
                sightings::read_path(&Input::read(path)?, &mut log)?;
            }
            if let Some(path) = sibling(path, "_rb", "_landmarks_gt").filter(|path| exists(path)) {
                log.landmarks = read_places(&path)?;
            }
            Ok(log)
        }
    }
}

/// Reads places of landmarks: `id x y`, or at least seven columns with x and y first and the number last, as MRPT writes them.
///
/// # Errors
/// A file that cannot be read, or the first line that is neither.
pub fn read_places(path: impl AsRef<Path>) -> Result<Vec<(u32, Vector2<f64>)>, Error> {
    let input = Input::read(path)?;
    let place = |line: Result<(usize, &str), Error>| {
        let (number, text) = line?;
        let columns = text.split_ascii_whitespace().count();
        let mut fields = Fields::blank_separated(&input, number, text);
        if columns == 3 {
            let id = fields.count("landmark", u32::MAX as usize)? as u32;
            let [x, y] = fields.finite_array(["x", "y"])?;
            return Ok((id, Vector2::new(x, y)));
        }
        let [x, y] = fields.finite_array(["x", "y"])?;
        for _ in 3..columns {
            fields.number("a column that is not used")?;
        }
        Ok((fields.count("landmark", u32::MAX as usize)? as u32, Vector2::new(x, y)))
    };
    input.data_lines().filter(is_data).map(place).collect()
}

/// MRPT's comments begin with `%`.
fn is_data(line: &Result<(usize, &str), Error>) -> bool {
    line.as_ref().map_or(true, |(_, text)| !text.trim_start().starts_with('%'))
}

fn detect(input: &Input) -> Result<LandmarkFormat, Error> {
    let Some(first) = input.data_lines().next() else { return Err(input.file_error("no line with data")) };
    let (number, text) = first?;
    let mut columns = text.split_ascii_whitespace();
    match (columns.next().unwrap_or_default(), columns.count()) {
        ("ODOMETRY" | "LANDMARK", _) => Ok(LandmarkFormat::Victoria),
        ("RB", _) => Ok(LandmarkFormat::Mrpt),
        (word, 2 | 3) if word.parse::<f64>().is_ok() => Ok(LandmarkFormat::Plaza),
        _ => Err(input.line_error(number, "neither ODOMETRY, LANDMARK, RB, nor three or four numbers")),
    }
}

/// The file with another ending of its stem, if the stem has the one that is expected.
fn sibling(path: &Path, ending: &str, other: &str) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?;
    let at = name.rfind(ending)?;
    let (head, tail) = (&name[..at], &name[at + ending.len()..]);
    let tail = tail.strip_suffix(".gz").unwrap_or(tail);
    Some(path.with_file_name(format!("{head}{other}{tail}")))
}

fn exists(path: &Path) -> bool {
    let mut zipped = path.as_os_str().to_owned();
    zipped.push(".gz");
    path.exists() || Path::new(&zipped).exists()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::survives_damage;

    #[test]
    fn formats_are_told_apart() {
        let format = |text: &str| detect(&Input::new("f", text)).ok();
        assert_eq!(format("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1"), Some(LandmarkFormat::Victoria));
        assert_eq!(format("# c\nRB 0 1 0 0 0 3 1 0 0"), Some(LandmarkFormat::Mrpt));
        assert_eq!(format("1 2 3"), Some(LandmarkFormat::Plaza));
        assert_eq!(format("1.5e3\t2 3 4"), Some(LandmarkFormat::Plaza));
        for bad in ["", "x y z", "1 2", "EDGE 1 2 3"] {
            assert_eq!(format(bad), None, "{bad}");
        }
    }

    #[test]
    fn files_beside_are_found() {
        let beside = |path: &str, a, b| sibling(Path::new(path), a, b).map(|path| path.display().to_string());
        assert_eq!(beside("d/P_DR.txt.gz", "_DR", "_TD"), Some("d/P_TD.txt".into()));
        assert_eq!(beside("d_rb/x.txt", "_rb", "_gt"), None);
    }

    #[test]
    fn damage_never_panics() {
        let graph = b"ODOMETRY 0 1 1 0 0 1e-4 0 0 1e-4 0 1e-4\nLANDMARK 1 2 3 4 0.4 0 0.4\n";
        survives_damage(graph, |bytes| drop(read_graph(&Input::new("g", bytes))));
        let rows = b"RB 0 1.5 0 0 0 7 3.5 0.1 0\nRB 1 1.6 0.1 0 0 7 3.4 0.1 0\n";
        survives_damage(rows, |bytes| drop(read_sightings(&Input::new("s", bytes))));
        let ranges = Input::new("t", "2.5 2 5 3.5\n");
        survives_damage(b"1 0.1 0\n2 0.1 0.1\n3 0.1 0\n", |bytes| drop(read_ranges(&Input::new("d", bytes), &ranges)));
    }
}
