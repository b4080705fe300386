//! PLY, the polygon file format of Stanford: ascii, and binary of either byte order. Only the element `vertex` is read.

use super::{
    Encoding,
    table::{Builder, Column, Scalar, columns_of, write_rows},
};
use crate::{
    Error, Input,
    fields::{Fields, shorten},
    input,
};
use agv_core::sensors::PointCloud;
use std::{fmt::Write as _, path::Path};

/// An element of the header.
struct Element {
    name: String,
    count: usize,
    columns: Vec<Column>,
    has_list: bool,
}

#[derive(Clone, Copy, PartialEq)]
enum Format {
    Ascii,
    Little,
    Big,
}

struct Header {
    format: Format,
    elements: Vec<Element>,
    /// Lines and bytes of the header.
    lines: usize,
    bytes: usize,
}

/// Reads a PLY file from memory.
///
/// # Errors
/// A header that is wrong or has no vertices with x, y, z; a point that is cut short or no number.
pub fn parse(input: &Input) -> Result<PointCloud, Error> {
    let header = header(input)?;
    let Some(at) = header.elements.iter().position(|element| element.name == "vertex") else {
        return Err(input.file_error("the header has no element `vertex`"));
    };
    let (before, vertex) = (&header.elements[..at], &header.elements[at]);
    if vertex.has_list || (header.format != Format::Ascii && before.iter().any(|element| element.has_list)) {
        return Err(input.file_error("lists in or before `vertex` are not read"));
    }
    let mut builder = Builder::new(input, &vertex.columns)?;
    let mut row = Vec::with_capacity(vertex.columns.len());

    if header.format == Format::Ascii {
        // `before` may count to any number: saturate, and find the file too short.
        let skip = before.iter().fold(header.lines, |sum, element| sum.saturating_add(element.count));
        let mut lines = input.lines().skip(skip);
        for index in 0..vertex.count {
            let Some(line) = lines.next() else {
                return Err(input.file_error(format_args!("{index} points of {} are there", vertex.count)));
            };
            let (number, text) = line?;
            let mut fields = Fields::blank_separated(input, number, text);
            row.clear();
            for column in &vertex.columns {
                row.push(fields.number(&column.name)?);
            }
            fields.end()?;
            builder.push(&row);
        }
        return builder.finish();
    }

    let stride = |element: &Element| element.columns.iter().map(|column| column.scalar.size()).sum::<usize>();
    let start = before.iter().fold(header.bytes, |sum, e| sum.saturating_add(e.count.saturating_mul(stride(e))));
    let needed = vertex.count.saturating_mul(stride(vertex));
    let data = input.bytes().get(start..).unwrap_or_default();
    if data.len() < needed {
        let reason = format!("{} points need {needed} bytes, {} are there", vertex.count, data.len());
        return Err(input.byte_error(input.bytes().len(), reason));
    }
    for bytes in data[..needed].chunks_exact(stride(vertex)) {
        row.clear();
        let mut at = 0;
        for column in &vertex.columns {
            row.extend(column.scalar.decode(&bytes[at..], header.format == Format::Big));
            at += column.scalar.size();
        }
        builder.push(&row);
    }
    builder.finish()
}

/// Reads up to `end_header`. The body may be binary, so the lines are taken one by one.
fn header(input: &Input) -> Result<Header, Error> {
    let mut header = Header { format: Format::Ascii, elements: Vec::new(), lines: 0, bytes: 0 };
    let mut format = None;
    for raw in input.bytes().split_inclusive(|&byte| byte == b'\n') {
        header.lines += 1;
        header.bytes += raw.len();
        let Ok(text) = std::str::from_utf8(raw) else {
            return Err(input.line_error(header.lines, "not text before `end_header`"));
        };
        let mut fields = Fields::blank_separated(input, header.lines, text);
        match text.split_ascii_whitespace().next().unwrap_or_default() {
            "ply" | "comment" | "obj_info" => {}
            "end_header" => {
                header.format = format.ok_or_else(|| input.line_error(header.lines, "the header has no `format`"))?;
                return Ok(header);
            }
            "format" => {
                fields.text("format")?;
                format = Some(match fields.text("encoding")? {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::Little,
                    "binary_big_endian" => Format::Big,
                    other => return Err(fields.error(format_args!("unknown encoding `{}`", shorten(other)))),
                });
            }
            "element" => {
                fields.text("element")?;
                let name = fields.text("name")?.to_owned();
                let count = fields.count("count", usize::MAX)?;
                header.elements.push(Element { name, count, columns: Vec::new(), has_list: false });
            }
            "property" => {
                fields.text("property")?;
                let Some(element) = header.elements.last_mut() else {
                    return Err(fields.error("a property before any element"));
                };
                match fields.text("type")? {
                    "list" => element.has_list = true,
                    name => {
                        let scalar = scalar(name)
                            .ok_or_else(|| fields.error(format_args!("unknown type `{}`", shorten(name))))?;
                        element.columns.push(Column { name: fields.text("name")?.to_owned(), scalar });
                    }
                }
            }
            word => return Err(fields.error(format_args!("`{}` is no header line", shorten(word)))),
        }
    }
    Err(input.file_error("the header has no `end_header`"))
}

fn scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

/// Writes a PLY file with all channels of the cloud, gzipped if `path` ends in `.gz`.
///
/// # Errors
/// The operating system's refusal.
pub fn write(path: impl AsRef<Path>, cloud: &PointCloud, encoding: Encoding) -> Result<(), Error> {
    let format = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Binary => "binary_little_endian",
    };
    let mut header = format!("ply\nformat {format} 1.0\nelement vertex {}\n", cloud.len());
    for column in columns_of(cloud) {
        let kind = if column.scalar == Scalar::U16 { "ushort" } else { "float" };
        let _ = writeln!(header, "property {kind} {}", column.name);
    }
    header.push_str("end_header\n");
    let mut bytes = header.into_bytes();
    write_rows(cloud, encoding, &mut bytes);
    input::write(path, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Scratch, survives_damage};
    use agv_core::nalgebra::Vector3;

    const ASCII: &str = "ply\nformat ascii 1.0\ncomment c\nelement vertex 2\nproperty double x\nproperty float y\nproperty float z\nproperty uchar intensity\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n1 2 3 4\n5 6 nan 8\n3 0 1 1\n";

    #[test]
    fn both_encodings_round_trip_with_all_channels() {
        let cloud = PointCloud::from_points([Vector3::new(1.5, -2.0, 0.1), Vector3::new(f32::INFINITY, 0.0, 1e-9)]);
        let cloud = cloud.with_intensity(vec![0.5, 9.0]).unwrap().with_ring(vec![1, 65_535]).unwrap();
        let cloud = cloud.with_time(vec![0.0, 0.1]).unwrap();
        let scratch = Scratch::new("ply");
        for encoding in [Encoding::Ascii, Encoding::Binary] {
            write(scratch.path("a.ply"), &cloud, encoding).unwrap();
            assert_eq!(super::super::read(scratch.path("a.ply")).unwrap(), cloud);
        }
    }

    #[test]
    fn big_endian_and_unread_columns() {
        let mut bytes = b"ply\nformat binary_big_endian 1.0\nelement a 1\nproperty char q\nelement vertex 1\nproperty float x\nproperty ushort skip\nproperty float y\nproperty float z\nend_header\n\x07".to_vec();
        for part in [&1.5_f32.to_be_bytes()[..], &[9, 9], &2.5_f32.to_be_bytes(), &(-3.0_f32).to_be_bytes()] {
            bytes.extend(part);
        }
        let cloud = parse(&Input::new("a.ply", bytes)).unwrap();
        assert_eq!(cloud.points().next(), Some(Vector3::new(1.5, 2.5, -3.0)));
    }

    #[test]
    fn faults_name_the_place() {
        for (from, to, reason) in [
            ("format ascii", "format odd", ":2: unknown encoding `odd`"),
            ("vertex 2", "vertex -2", ":4: field 3 (count) must be a whole number"),
            ("vertex 2", "vertex 99999999999999", "3 points of 99999999999999 are there"),
            ("property double x", "property wide x", ":5: unknown type `wide`"),
            ("property double x", "property double q", "the points have no `x`"),
            ("5 6 nan 8", "5 6 nan", ":13: the line ends before field 4 (intensity)"),
            ("5 6 nan 8", "5 6 q 8", ":13: field 3 (z) must be a number, got `q`"),
            ("end_header", "end", ":11: `end` is no header line"),
            ("element vertex", "element corner", "no element `vertex`"),
            ("ascii", "binary_little_endian", "points need 34 bytes"),
            ("element vertex 2\n", "", ":4: a property before any element"),
        ] {
            let error = parse(&Input::new("a.ply", ASCII.replacen(from, to, 1))).unwrap_err().to_string();
            assert!(error.contains(reason), "{error} / {reason}");
        }
        let huge = "ply\nformat binary_little_endian 1.0\nelement vertex 18446744073709551615\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
        assert!(parse(&Input::new("a.ply", huge)).unwrap_err().to_string().contains("0 are there"));
        survives_damage(ASCII.as_bytes(), |bytes| drop(super::super::parse(&Input::new("a.ply", bytes))));
    }
}
