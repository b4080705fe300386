//! Binary rows without a header, little-endian; the format is the file's name.

use super::table::{Builder, Column, Scalar};
use crate::{Error, Input, input};
use agv_core::sensors::PointCloud;
use half::f16;
use std::path::Path;

/// How a row is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// x, y, z as `f32`, in metres (`.xyz.f32`).
    Xyz,
    /// x, y, z, intensity as `f32` (KITTI's `.bin`, `.xyzi.f32`).
    Xyzi,
    /// x, y, z as `i16` in steps of 2 mm (`.xyz.i16mm2`).
    Millimetres2,
    /// x, y, z as `f16`, intensity and laser number as `u8`, time in nanoseconds as `i32` (`.rec12`).
    Record12,
}

impl Layout {
    /// The layout that a file's name, without `.gz`, tells.
    pub fn of_name(name: &str) -> Option<Self> {
        [
            (".xyz.f32", Self::Xyz),
            (".xyzi.f32", Self::Xyzi),
            (".bin", Self::Xyzi),
            (".xyz.i16mm2", Self::Millimetres2),
            (".rec12", Self::Record12),
        ]
        .into_iter()
        .find_map(|(suffix, layout)| name.ends_with(suffix).then_some(layout))
    }

    const fn row_size(self) -> usize {
        match self {
            Self::Xyz | Self::Record12 => 12,
            Self::Xyzi => 16,
            Self::Millimetres2 => 6,
        }
    }

    const fn names(self) -> &'static [&'static str] {
        match self {
            Self::Xyz | Self::Millimetres2 => &["x", "y", "z"],
            Self::Xyzi => &["x", "y", "z", "intensity"],
            Self::Record12 => &["x", "y", "z", "intensity", "ring", "time"],
        }
    }

    /// Decodes a row of [`row_size`](Self::row_size) bytes into the numbers of [`names`](Self::names), in SI units.
    fn decode(self, row: &[u8], numbers: &mut Vec<f64>) {
        let pair = |at: usize| [row[at], row[at + 1]];
        let quad = |at: usize| [row[at], row[at + 1], row[at + 2], row[at + 3]];
        numbers.clear();
        match self {
            Self::Xyz | Self::Xyzi => {
                numbers.extend((0..row.len()).step_by(4).map(|at| f64::from(f32::from_le_bytes(quad(at)))));
            }
            Self::Millimetres2 => {
                numbers.extend([0, 2, 4].map(|at| f64::from(i16::from_le_bytes(pair(at))) * 0.002));
            }
            Self::Record12 => {
                numbers.extend([0, 2, 4].map(|at| f16::from_le_bytes(pair(at)).to_f64()));
                let nanoseconds = f64::from(i32::from_le_bytes(quad(8)));
                numbers.extend([f64::from(row[6]), f64::from(row[7]), nanoseconds * 1e-9]);
            }
        }
    }
}

/// Reads rows from memory.
///
/// # Errors
/// A size that is not a whole number of rows.
pub fn parse(input: &Input, layout: Layout) -> Result<PointCloud, Error> {
    let rows = input.bytes().chunks_exact(layout.row_size());
    let rest = rows.remainder().len();
    if rest > 0 {
        let reason = format!("the file ends {rest} bytes into a row of {}", layout.row_size());
        return Err(input.byte_error(input.bytes().len() - rest, reason));
    }
    let columns: Vec<_> =
        layout.names().iter().map(|&name| Column { name: name.into(), scalar: Scalar::F64 }).collect();
    let mut builder = Builder::new(input, &columns)?;
    let mut numbers = Vec::with_capacity(columns.len());
    for row in rows {
        layout.decode(row, &mut numbers);
        builder.push(&numbers);
    }
    builder.finish()
}

/// Writes rows, gzipped if `path` ends in `.gz`; an absent channel is written as zeros.
///
/// Steps of 2 mm saturate at ±65.5 m, half precision rounds to about 3 digits.
///
/// # Errors
/// The operating system's refusal.
pub fn write(path: impl AsRef<Path>, cloud: &PointCloud, layout: Layout) -> Result<(), Error> {
    let mut bytes = Vec::with_capacity(cloud.len() * layout.row_size());
    for (index, point) in cloud.points().enumerate() {
        let xyz = [point.x, point.y, point.z];
        let intensity = cloud.intensity().map_or(0.0, |values| values[index]);
        match layout {
            Layout::Xyz => bytes.extend(xyz.into_iter().flat_map(f32::to_le_bytes)),
            Layout::Xyzi => bytes.extend(xyz.into_iter().chain([intensity]).flat_map(f32::to_le_bytes)),
            Layout::Millimetres2 => {
                bytes.extend(xyz.into_iter().flat_map(|value| ((value / 0.002).round() as i16).to_le_bytes()));
            }
            Layout::Record12 => {
                bytes.extend(xyz.into_iter().flat_map(|value| f16::from_f32(value).to_le_bytes()));
                bytes.push(intensity as u8);
                bytes.push(cloud.ring().map_or(0, |ring| ring[index].min(255) as u8));
                let seconds = cloud.time().map_or(0.0, |time| f64::from(time[index]));
                bytes.extend(((seconds * 1e9).round() as i32).to_le_bytes());
            }
        }
    }
    input::write(path, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Scratch;
    use agv_core::nalgebra::Vector3;

    #[test]
    fn every_layout_round_trips_to_its_precision() {
        let points = [Vector3::new(1.25_f32, -2.5, 0.5), Vector3::new(30.0, 0.0, -1.0)];
        let cloud = PointCloud::from_points(points).with_intensity(vec![7.0, 200.0]).unwrap();
        let cloud = cloud.with_ring(vec![3, 63]).unwrap().with_time(vec![0.0, 0.05]).unwrap();
        let scratch = Scratch::new("raw");
        for (name, layout) in [
            ("a.xyz.f32", Layout::Xyz),
            ("a.bin", Layout::Xyzi),
            ("a.xyz.i16mm2", Layout::Millimetres2),
            ("a.rec12", Layout::Record12),
        ] {
            write(scratch.path(&format!("{name}.gz")), &cloud, layout).unwrap();
            let again = super::super::read(scratch.path(name)).unwrap();
            assert!(again.points().zip(points).all(|(a, b)| (a - b).norm() < 1e-6), "{name}");
            if layout == Layout::Record12 {
                assert_eq!((again.ring(), again.intensity()), (cloud.ring(), cloud.intensity()));
                assert!((again.time().unwrap()[1] - 0.05).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_cut_row_is_named_by_its_byte() {
        for layout in [Layout::Xyz, Layout::Xyzi, Layout::Millimetres2, Layout::Record12] {
            let error = parse(&Input::new("a", vec![1; layout.row_size() * 2 + 1]), layout).unwrap_err().to_string();
            assert!(error.contains(&format!("byte {}", 2 * layout.row_size())), "{error}");
            assert!(parse(&Input::new("a", ""), layout).unwrap().is_empty());
        }
    }
}
