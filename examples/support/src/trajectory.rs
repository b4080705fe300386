//! Trajectories as the evaluation tools of the field exchange them.
//!
//! - TUM: `t x y z qx qy qz qw` per line (seconds, metres, unit quaternion), `#` comments;
//! - KITTI: twelve numbers per line, the rows of the 3x4 matrix of the pose, without time.

use crate::{Error, Input, fields::Fields, input, log::StampedPose, relations::Seconds};
use agv_core::{
    geometry::{Se3, So3},
    nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3},
};
use std::{fmt::Write as _, path::Path};

/// Deviation of a norm or of a matrix from a rotation that files with six digits have, with margin.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// Reads a TUM trajectory.
///
/// # Errors
/// A file that cannot be read, or the first line that is not eight finite numbers with a unit quaternion.
pub fn read_tum(path: impl AsRef<Path>) -> Result<Vec<StampedPose<Se3>>, Error> {
    parse_tum(&Input::read(path)?)
}

/// Reads a TUM trajectory from memory.
///
/// # Errors
/// As [`read_tum`].
pub fn parse_tum(input: &Input) -> Result<Vec<StampedPose<Se3>>, Error> {
    input
        .data_lines()
        .map(|line| {
            let (number, text) = line?;
            let mut fields = Fields::blank_separated(input, number, text);
            let stamp = fields.stamp("timestamp")?;
            let [x, y, z, i, j, k, w] = fields.finite_array(["tx", "ty", "tz", "qx", "qy", "qz", "qw"])?;
            fields.end()?;
            let quaternion = Quaternion::new(w, i, j, k);
            let norm = quaternion.norm();
            // A norm that overflowed lies outside, too.
            if !(1.0 - ROTATION_TOLERANCE..=1.0 + ROTATION_TOLERANCE).contains(&norm) {
                return Err(input.line_error(number, format_args!("the quaternion's norm is {norm}, not 1")));
            }
            let rotation = UnitQuaternion::from_quaternion(quaternion).into();
            Ok(StampedPose { stamp, pose: Se3::from_parts(Vector3::new(x, y, z), rotation) })
        })
        .collect()
}

/// Writes a TUM trajectory, gzipped if `path` ends in `.gz`.
///
/// # Errors
/// The operating system's refusal.
pub fn write_tum(path: impl AsRef<Path>, poses: &[StampedPose<Se3>]) -> Result<(), Error> {
    let mut text = String::from("# timestamp tx ty tz qx qy qz qw\n");
    for StampedPose { stamp, pose } in poses {
        let t = pose.translation();
        let q = UnitQuaternion::from(pose.rotation());
        let _ = writeln!(text, "{} {} {} {} {} {} {} {}", Seconds(*stamp), t.x, t.y, t.z, q.i, q.j, q.k, q.w);
    }
    input::write(path, text.as_bytes())
}

/// Reads a KITTI trajectory.
///
/// # Errors
/// A file that cannot be read, or the first line that is not twelve finite numbers with a rotation in them.
pub fn read_kitti(path: impl AsRef<Path>) -> Result<Vec<Se3>, Error> {
    parse_kitti(&Input::read(path)?)
}

/// Reads a KITTI trajectory from memory.
///
/// # Errors
/// As [`read_kitti`].
pub fn parse_kitti(input: &Input) -> Result<Vec<Se3>, Error> {
    input
        .data_lines()
        .map(|line| {
            let (number, text) = line?;
            let mut fields = Fields::blank_separated(input, number, text);
            let names = ["r11", "r12", "r13", "tx", "r21", "r22", "r23", "ty", "r31", "r32", "r33", "tz"];
            let rows = fields.finite_array(names)?;
            fields.end()?;
            pose_from_rows(&rows).ok_or_else(|| input.line_error(number, "the 3x3 part is not a rotation"))
        })
        .collect()
}

/// The pose of a 3x4 matrix given row by row; none if its left part is no rotation.
pub fn pose_from_rows(rows: &[f64; 12]) -> Option<Se3> {
    let m = rows;
    let matrix = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let deviation = (matrix.transpose() * matrix - Matrix3::identity()).norm();
    if !(deviation <= ROTATION_TOLERANCE && matrix.determinant() > 0.0) {
        return None;
    }
    let rotation: So3 = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)).into();
    Some(Se3::from_parts(Vector3::new(m[3], m[7], m[11]), rotation))
}

/// Writes a KITTI trajectory, gzipped if `path` ends in `.gz`.
///
/// # Errors
/// The operating system's refusal.
pub fn write_kitti(path: impl AsRef<Path>, poses: &[Se3]) -> Result<(), Error> {
    let mut text = String::new();
    for pose in poses {
        let (r, t) = (pose.rotation().matrix(), pose.translation());
        for row in 0..3 {
            let end = if row == 2 { '\n' } else { ' ' };
            let _ = write!(text, "{} {} {} {}{end}", r[(row, 0)], r[(row, 1)], r[(row, 2)], t[row]);
        }
    }
    input::write(path, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Scratch, survives_damage};
    use agv_core::{geometry::LieGroup, nalgebra::Vector6, time::Stamp};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn both_formats_round_trip(v in prop::array::uniform6(-3.0..3.0_f64), seconds in 0..2_000_000_000_i64) {
            let pose = Se3::exp(&Vector6::from(v));
            let stamp = Stamp::from_nanoseconds(seconds * 1_000_000_000 + 123_456_000);
            let scratch = Scratch::new("trajectory");
            write_tum(scratch.path("t.tum"), &[StampedPose { stamp, pose }]).unwrap();
            let tum = read_tum(scratch.path("t.tum")).unwrap();
            prop_assert!((tum[0].stamp - stamp).abs() < 1e-6);
            prop_assert!(tum[0].pose.minus(&pose).norm() < 1e-12);
            write_kitti(scratch.path("k.txt"), &[pose]).unwrap();
            prop_assert!(read_kitti(scratch.path("k.txt")).unwrap()[0].minus(&pose).norm() < 1e-9);
        }
    }

    #[test]
    fn what_is_no_pose_is_refused_with_its_line() {
        let tum = |text: &str| parse_tum(&Input::new("t", text)).unwrap_err().to_string();
        assert!(tum("# head\n0 0 0 0 0 0 0 0").contains("t:2: the quaternion's norm is 0"));
        assert!(tum("0 0 0 0 0 0 1e200 1e200").contains("norm"));
        assert!(tum("0 0 0 inf 0 0 0 1").contains("(tz) must be finite"));
        let kitti = |text: &str| parse_kitti(&Input::new("k", text)).unwrap_err().to_string();
        assert!(kitti("1 0 0 0 0 1 0 0 0 0 -1 0").contains("k:1: the 3x3 part is not a rotation"));
        assert!(kitti("1 0 0 0 0 1 0 0").contains("ends before field 9"));
    }

    #[test]
    fn damage_never_panics() {
        survives_damage(b"# t\n1.5 1 2 3 0 0 0 1\n", |bytes| drop(parse_tum(&Input::new("t", bytes))));
        survives_damage(b"1 0 0 5 0 1 0 6 0 0 1 7\n", |bytes| drop(parse_kitti(&Input::new("k", bytes))));
    }
}
