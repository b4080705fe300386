//! Reference poses of pairs of clouds: `pair,target,source,kind` and the 16 values of `target_from_source`, row by row.

use crate::{Error, Input, fields::not_a_number};
use agv_core::{
    geometry::Se3,
    nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3},
};
use std::path::Path;

/// How far a matrix may be from a rotation: the files have about nine digits.
const ROUNDING: f64 = 1e-4;

/// A pair of clouds whose relative pose is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// Name of the pair.
    pub name: String,
    /// Name of the target cloud, without its suffix.
    pub target: String,
    /// Name of the source cloud, without its suffix.
    pub source: String,
    /// Where the pose comes from: `given` with the data, or a `consensus` of registrations.
    pub kind: String,
    /// Pose of the source in the target frame.
    pub target_from_source: Se3,
}

/// Reads a file of pairs.
///
/// # Errors
/// A file that cannot be read, or the first line that is not four names and a pose.
pub fn read(path: impl AsRef<Path>) -> Result<Vec<Pair>, Error> {
    parse(&Input::read(path)?)
}

/// Reads pairs from memory.
///
/// # Errors
/// As [`read`].
pub fn parse(input: &Input) -> Result<Vec<Pair>, Error> {
    input
        .data_lines()
        .map(|line| {
            let (number, text) = line?;
            let fields: Vec<_> = text.split(',').map(str::trim).collect();
            let [name, target, source, kind, values @ ..] = fields.as_slice() else {
                return Err(input.line_error(number, format_args!("{} fields, 20 are needed", fields.len())));
            };
            let values = values
                .iter()
                .enumerate()
                .map(|(i, token)| {
                    let value = token.parse().ok().filter(|value: &f64| value.is_finite());
                    value.ok_or_else(|| input.line_error(number, not_a_number(i + 5, "pose", token)))
                })
                .collect::<Result<Vec<_>, _>>()?;
            let values: [f64; 16] = values.try_into().map_err(|values: Vec<_>| {
                input.line_error(number, format_args!("{} numbers, 16 are needed", values.len()))
            })?;
            let target_from_source = pose(&values)
                .ok_or_else(|| input.line_error(number, "the 16 numbers are no rotation and translation"))?;
            let [name, target, source, kind] = [name, target, source, kind].map(|&text| text.to_owned());
            Ok(Pair { name, target, source, kind, target_from_source })
        })
        .collect()
}

/// The pose of a homogeneous matrix, given row by row.
fn pose(values: &[f64; 16]) -> Option<Se3> {
    let [a, b, c, x, d, e, f, y, g, h, i, z, last @ ..] = *values;
    let rotation = Matrix3::new(a, b, c, d, e, f, g, h, i);
    let rigid =
        (rotation * rotation.transpose() - Matrix3::identity()).norm() < ROUNDING && rotation.determinant() > 0.0;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    (rigid && last == [0.0, 0.0, 0.0, 1.0]).then(|| Se3::from_parts(Vector3::new(x, y, z), rotation.into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::shared;
    use agv_core::geometry::LieGroup;

    #[test]
    fn a_pose_is_read_row_by_row() {
        let text = "# pair,...\nyard,a,b,given,0,-1,0,2,1,0,0,3,0,0,1,4,0,0,0,1\n";
        let pairs = parse(&Input::new("pairs.csv", text)).unwrap();
        assert_eq!((pairs.len(), pairs[0].source.as_str(), pairs[0].kind.as_str()), (1, "b", "given"));
        let moved = pairs[0].target_from_source.act(&Vector3::x());
        assert!((moved - Vector3::new(2.0, 4.0, 4.0)).norm() < 1e-12);
    }

    #[test]
    fn what_is_no_pair_is_named_by_its_line() {
        for (line, reason) in [
            ("a,b,c", "3 fields"),
            ("a,b,c,d,1,2", "2 numbers"),
            ("a,b,c,d,1,0,0,0,0,1,0,0,0,0,x,0,0,0,0,1", "`x`"),
            ("a,b,c,d,1,0,0,0,0,1,0,0,0,0,nan,0,0,0,0,1", "`nan`"),
            ("a,b,c,d,1,0,0,0,0,1,0,0,0,0,-1,0,0,0,0,1", "no rotation"),
            ("a,b,c,d,1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,2", "no rotation"),
        ] {
            let error = parse(&Input::new("pairs.csv", line)).unwrap_err().to_string();
            assert!(error.contains("pairs.csv:1") && error.contains(reason), "{error}");
        }
    }

    #[test]
    fn the_shared_pairs_are_read() {
        if let Some(path) = shared("registration3d/pair_references.csv") {
            let pairs = read(path).unwrap();
            let hdl32 = pairs.iter().find(|pair| pair.name == "hdl32" && pair.kind == "consensus").unwrap();
            assert!((hdl32.target_from_source.translation().norm() - 0.5).abs() < 0.02);
            assert_eq!(pairs.len(), 14);
        }
    }
}
