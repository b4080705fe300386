//! PCD 0.7, the format of the Point Cloud Library: ascii, binary, and LZF-compressed (which stores column by column).
//!
//! `VIEWPOINT tx ty tz qw qx qy qz` is the pose of the sensor that the points were acquired from (PCL's `sensor_origin_` and
//! `sensor_orientation_`). It becomes the cloud's [`base_from_sensor`](PointCloud::base_from_sensor), and is written from it:
//! the points stay as they are stored, and `transform` by it does what PCL's `pcl_transform_from_viewpoint` does. Mind that
//! some programs store points that are in the world frame already, with the viewpoint for the orientation of normals
//! alone; nothing in a file tells the two apart.

use super::{
    Encoding, lzf,
    table::{Builder, Column, Scalar, columns_of, write_rows},
};
use crate::{
    Error, Input,
    fields::{Fields, shorten},
    input,
};
use agv_core::{
    geometry::{LieGroup, Se3},
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
    sensors::PointCloud,
};
use std::{fmt::Write as _, path::Path};

/// Most numbers per point: descriptors of features have some hundred.
const MAX_COLUMNS: usize = 4096;

#[derive(Clone, Copy, PartialEq)]
enum Data {
    Ascii,
    Binary,
    Compressed,
}

struct Header {
    columns: Vec<Column>,
    points: usize,
    data: Data,
    viewpoint: Se3,
    lines: usize,
    bytes: usize,
}

/// Reads a PCD file from memory.
///
/// # Errors
/// A header that is wrong or has no x, y, z; a point that is cut short or no number; damaged compression.
pub fn parse(input: &Input) -> Result<PointCloud, Error> {
    let header = header(input)?;
    let mut builder = Builder::new(input, &header.columns)?;
    let body = &input.bytes()[header.bytes..];
    match header.data {
        Data::Ascii => ascii(input, &header, &mut builder)?,
        Data::Binary => {
            let stride: usize = header.columns.iter().map(|column| column.scalar.size()).sum();
            let needed = header.points.saturating_mul(stride);
            let Some(body) = body.get(..needed) else {
                let reason = format!("{} points need {needed} bytes, {} are there", header.points, body.len());
                return Err(input.byte_error(input.bytes().len(), reason));
            };
            let mut row = Vec::with_capacity(header.columns.len());
            for bytes in body.chunks_exact(stride) {
                row.clear();
                let mut at = 0;
                for column in &header.columns {
                    row.extend(column.scalar.decode(&bytes[at..], false));
                    at += column.scalar.size();
                }
                builder.push(&row);
            }
        }
        Data::Compressed => compressed(input, &header, body, &mut builder)?,
    }
    Ok(builder.finish()?.with_mount(header.viewpoint)?)
}

fn ascii(input: &Input, header: &Header, builder: &mut Builder) -> Result<(), Error> {
    let mut lines = input.lines().skip(header.lines);
    let mut row = Vec::with_capacity(header.columns.len());
    for index in 0..header.points {
        let Some(line) = lines.next() else {
            return Err(input.file_error(format_args!("{index} points of {} are there", header.points)));
        };
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        row.clear();
        for column in &header.columns {
            row.push(fields.number(&column.name)?);
        }
        fields.end()?;
        builder.push(&row);
    }
    Ok(())
}

fn compressed(input: &Input, header: &Header, body: &[u8], builder: &mut Builder) -> Result<(), Error> {
    let size = |at: usize| Scalar::U32.decode(body.get(at..).unwrap_or_default(), false).map(|size| size as usize);
    let (Some(packed), Some(unpacked)) = (size(0), size(4)) else {
        return Err(input.byte_error(header.bytes, "the sizes of the compressed points are missing"));
    };
    let Some(data) = body.get(8..).and_then(|data| data.get(..packed)) else {
        return Err(input.byte_error(input.bytes().len(), format_args!("{packed} compressed bytes were announced")));
    };
    let stride: usize = header.columns.iter().map(|column| column.scalar.size()).sum();
    if header.points.checked_mul(stride) != Some(unpacked) {
        let reason = format!("{} points of {stride} bytes are not {unpacked} bytes", header.points);
        return Err(input.byte_error(header.bytes + 4, reason));
    }
    let Some(columns) = lzf::decompress(data, unpacked) else {
        return Err(input.byte_error(header.bytes + 8, "damaged compression"));
    };
    let mut row = Vec::with_capacity(header.columns.len());
    for index in 0..header.points {
        row.clear();
        let mut start = 0;
        for Column { scalar, .. } in &header.columns {
            row.extend(scalar.decode(&columns[start + index * scalar.size()..], false));
            start += header.points * scalar.size();
        }
        builder.push(&row);
    }
    Ok(())
}

/// Reads up to `DATA`. The body may be binary, so the lines are taken one by one.
fn header(input: &Input) -> Result<Header, Error> {
    let [mut names, mut sizes, mut types, mut counts] = [const { Vec::<String>::new() }; 4];
    let (mut points, mut viewpoint, mut lines, mut bytes) = (None, Se3::identity(), 0, 0);
    for raw in input.bytes().split_inclusive(|&byte| byte == b'\n') {
        lines += 1;
        bytes += raw.len();
        let Ok(text) = std::str::from_utf8(raw) else {
            return Err(input.line_error(lines, "not text before `DATA`"));
        };
        let mut words = text.split_ascii_whitespace();
        let key = words.next().unwrap_or_default();
        let mut rest = || words.by_ref().map(str::to_owned).collect::<Vec<_>>();
        match key {
            "" | "VERSION" | "WIDTH" | "HEIGHT" => {}
            _ if key.starts_with('#') => {}
            "FIELDS" => names = rest(),
            "SIZE" => sizes = rest(),
            "TYPE" => types = rest(),
            "COUNT" => counts = rest(),
            "POINTS" => {
                let mut fields = Fields::blank_separated(input, lines, text);
                fields.text(key)?;
                points = Some(fields.count("POINTS", usize::MAX)?);
            }
            "VIEWPOINT" => {
                let mut fields = Fields::blank_separated(input, lines, text);
                fields.text(key)?;
                let [x, y, z, w, i, j, k] = fields.finite_array(["tx", "ty", "tz", "qw", "qx", "qy", "qz"])?;
                let quaternion = Quaternion::new(w, i, j, k);
                let norm = quaternion.norm();
                // Written with six digits or so; anything else is a damaged file.
                if (norm - 1.0).abs() > 1e-3 {
                    return Err(fields.error(format_args!("the quaternion's norm is {norm}, not 1")));
                }
                viewpoint = Se3::from_parts(Vector3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion).into());
            }
            "DATA" => {
                let data = match rest().first().map(String::as_str) {
                    Some("ascii") => Data::Ascii,
                    Some("binary") => Data::Binary,
                    Some("binary_compressed") => Data::Compressed,
                    other => {
                        let reason = format!("unknown encoding `{}`", shorten(other.unwrap_or_default()));
                        return Err(input.line_error(lines, reason));
                    }
                };
                let columns = columns(&names, &sizes, &types, &counts).map_err(|why| input.line_error(lines, why))?;
                let points = points.ok_or_else(|| input.line_error(lines, "the header has no POINTS"))?;
                return Ok(Header { columns, points, data, viewpoint, lines, bytes });
            }
            word => return Err(input.line_error(lines, format_args!("`{}` is no header line", shorten(word)))),
        }
    }
    Err(input.file_error("the header has no `DATA`"))
}

/// A column per number: a field of several numbers has one of its name, the others unnamed.
fn columns(names: &[String], sizes: &[String], types: &[String], counts: &[String]) -> Result<Vec<Column>, String> {
    if sizes.len() != names.len() || types.len() != names.len() || !(counts.is_empty() || counts.len() == names.len()) {
        return Err("FIELDS, SIZE, TYPE and COUNT differ in length".into());
    }
    let mut columns = Vec::new();
    for (index, ((name, size), kind)) in names.iter().zip(sizes).zip(types).enumerate() {
        let scalar = match (kind.as_str(), size.as_str()) {
            ("I", "1") => Scalar::I8,
            ("U", "1") => Scalar::U8,
            ("I", "2") => Scalar::I16,
            ("U", "2") => Scalar::U16,
            ("I", "4") => Scalar::I32,
            ("U", "4") => Scalar::U32,
            ("I", "8") => Scalar::I64,
            ("U", "8") => Scalar::U64,
            ("F", "4") => Scalar::F32,
            ("F", "8") => Scalar::F64,
            _ => return Err(format!("field `{}` has unknown TYPE and SIZE", shorten(name))),
        };
        let count: usize = match counts.get(index).map(|count| count.parse()) {
            None => 1,
            Some(Ok(count @ 1..=MAX_COLUMNS)) => count,
            Some(_) => return Err(format!("field `{}` has a wrong COUNT", shorten(name))),
        };
        if columns.len() + count > MAX_COLUMNS {
            return Err(format!("more than {MAX_COLUMNS} numbers per point"));
        }
        columns.push(Column { name: name.clone(), scalar });
        columns.extend((1..count).map(|_| Column { name: String::new(), scalar }));
    }
    Ok(columns)
}

/// Writes a PCD file with all channels of the cloud and its mount as the viewpoint, gzipped if `path` ends in `.gz`.
///
/// # Errors
/// The operating system's refusal.
pub fn write(path: impl AsRef<Path>, cloud: &PointCloud, encoding: Encoding) -> Result<(), Error> {
    let columns = columns_of(cloud);
    let each = |of: &dyn Fn(&Column) -> String| columns.iter().map(of).collect::<Vec<_>>().join(" ");
    let mut header = String::from("# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n");
    let _ = writeln!(header, "FIELDS {}", each(&|column| column.name.clone()));
    let _ = writeln!(header, "SIZE {}", each(&|column| column.scalar.size().to_string()));
    let _ = writeln!(header, "TYPE {}", each(&|c| if c.scalar == Scalar::U16 { "U" } else { "F" }.into()));
    let _ = writeln!(header, "COUNT {}", each(&|_| "1".into()));
    let data = if encoding == Encoding::Ascii { "ascii" } else { "binary" };
    let points = cloud.len();
    let (t, rotation) =
        (cloud.base_from_sensor().translation(), UnitQuaternion::from(cloud.base_from_sensor().rotation()));
    let [qx, qy, qz, qw]: [f64; 4] = rotation.coords.into();
    let viewpoint = format!("{} {} {} {qw} {qx} {qy} {qz}", t.x, t.y, t.z);
    let _ = writeln!(header, "WIDTH {points}\nHEIGHT 1\nVIEWPOINT {viewpoint}\nPOINTS {points}\nDATA {data}");
    let mut bytes = header.into_bytes();
    write_rows(cloud, encoding, &mut bytes);
    input::write(path, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Scratch, survives_damage};
    use agv_core::geometry::So3;

    const ASCII: &str = "# .PCD v.7\nVERSION .7\nFIELDS x y z rgb n t\nSIZE 4 4 4 4 4 4\nTYPE F F F F F U\nCOUNT 1 1 1 1 2 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3 4 5 6 500000000\n";

    #[test]
    fn both_encodings_round_trip_with_all_channels() {
        let cloud = PointCloud::from_points([Vector3::new(1.5, -2.0, 0.1), Vector3::new(0.0, 0.0, 1e-9)]);
        let cloud = cloud.with_intensity(vec![0.5, 9.0]).unwrap().with_ring(vec![1, 65_535]).unwrap();
        let scratch = Scratch::new("pcd");
        for encoding in [Encoding::Ascii, Encoding::Binary] {
            write(scratch.path("a.pcd.gz"), &cloud, encoding).unwrap();
            assert_eq!(super::super::read(scratch.path("a.pcd")).unwrap(), cloud);
        }
    }

    #[test]
    fn the_viewpoint_is_the_sensor_s_pose() {
        // A sensor 2 m up that looks to the left: what lies 1 m before it lies on the vehicle's left.
        let turn = std::f64::consts::FRAC_1_SQRT_2;
        let text = format!("VIEWPOINT 0.5 0 2 {turn:.6} 0 0 {turn:.6}\nDATA ascii");
        let text = ASCII.replacen("DATA ascii", &text, 1).replacen("1 2 3", "1 0 0", 1);
        let mut cloud = parse(&Input::new("a.pcd", text.as_str())).unwrap();
        let stored = cloud.clone();
        assert_eq!(cloud.points().next(), Some(Vector3::new(1.0, 0.0, 0.0)));
        cloud.transform(&stored.base_from_sensor());
        let point = cloud.points().next().unwrap();
        assert!((point - Vector3::new(0.5, 1.0, 2.0)).norm() < 1e-5, "{point}");

        let attitude = So3::from_roll_pitch_yaw(0.1, -0.4, 2.0);
        let mount = Se3::from_parts(Vector3::new(1.0 / 3.0, -1e-9, 1e3), attitude);
        let scratch = Scratch::new("pcd-viewpoint");
        for encoding in [Encoding::Ascii, Encoding::Binary] {
            write(scratch.path("a.pcd"), &stored.clone().with_mount(mount).unwrap(), encoding).unwrap();
            let read = super::super::read(scratch.path("a.pcd")).unwrap();
            assert_eq!(read.base_from_sensor().translation(), mount.translation());
            assert!(read.base_from_sensor().minus(&mount).norm() < 1e-15);
        }
    }

    #[test]
    fn fields_of_several_numbers_and_integer_times() {
        let cloud = parse(&Input::new("a.pcd", ASCII)).unwrap();
        assert_eq!(cloud.points().next(), Some(Vector3::new(1.0, 2.0, 3.0)));
        assert_eq!(cloud.time(), Some(&[0.5_f32][..]));
    }

    #[test]
    fn times_of_an_epoch_become_offsets_from_the_stamp() {
        let text = "FIELDS x y z timestamp\nSIZE 4 4 4 8\nTYPE F F F F\nPOINTS 2\nDATA ascii\n1 2 3 1700000000.25\n1 2 3 1700000000.35\n";
        let cloud = parse(&Input::new("a.pcd", text)).unwrap();
        assert!((cloud.time().unwrap()[1] - 0.1).abs() < 1e-6);
        assert!((cloud.stamp().seconds() - 1_700_000_000.25).abs() < 1e-6);
    }

    fn compressed(points: usize, unpacked: u32, body: &[u8]) -> Vec<u8> {
        let mut file =
            format!("VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS {points}\nDATA binary_compressed\n")
                .into_bytes();
        file.extend((body.len() as u32).to_le_bytes());
        file.extend(unpacked.to_le_bytes());
        file.extend(body);
        file
    }

    #[test]
    fn compressed_points_are_stored_by_column() {
        let mut body = vec![23];
        for value in [1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0] {
            body.extend(value.to_le_bytes());
        }
        let cloud = parse(&Input::new("a", compressed(2, 24, &body))).unwrap();
        assert_eq!(cloud.points().collect::<Vec<_>>(), [Vector3::new(1.0, 3.0, 5.0), Vector3::new(2.0, 4.0, 6.0)]);
        survives_damage(&compressed(2, 24, &body), |bytes| drop(super::super::parse(&Input::new("a", bytes))));
        for (points, unpacked, reason) in [(3, 24, "3 points of 12 bytes are not 24"), (3, 36, "damaged compression")] {
            let error = parse(&Input::new("a", compressed(points, unpacked, &body))).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn faults_name_the_place() {
        for (from, to, reason) in [
            ("DATA ascii", "DATA odd", ":10: unknown encoding `odd`"),
            ("DATA ascii", "DATA binary", "byte "),
            ("POINTS 1", "POINTS x", ":9: field 2 (POINTS) must be a whole number"),
            ("POINTS 1", "POINTS 7", "1 points of 7 are there"),
            ("POINTS 1\n", "", "the header has no POINTS"),
            ("TYPE F", "TYPE Q", "unknown TYPE and SIZE"),
            ("COUNT 1 1", "COUNT 1", "differ in length"),
            ("COUNT 1 1", "COUNT 1 99999", "wrong COUNT"),
            ("FIELDS x", "FIELDS q", "the points have no `x`"),
            ("HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0", ":8: the line ends before field 8 (qz)"),
            ("HEIGHT 1", "VIEWPOINT 0 0 nan 1 0 0 0", ":8: field 4 (tz) must be finite"),
            ("HEIGHT 1", "VIEWPOINT 0 0 0 0 0 0 0", ":8: the quaternion's norm is 0, not 1"),
            ("WIDTH", "WEDTH", ":7: `WEDTH` is no header line"),
            ("1 2 3 4", "1 z 3 4", ":11: field 2 (y) must be a number, got `z`"),
        ] {
            let error = parse(&Input::new("a.pcd", ASCII.replacen(from, to, 1))).unwrap_err().to_string();
            assert!(error.contains(reason), "{error} / {reason}");
        }
        survives_damage(ASCII.as_bytes(), |bytes| drop(super::super::parse(&Input::new("a.pcd", bytes))));
    }
}
