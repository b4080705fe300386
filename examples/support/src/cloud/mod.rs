//! Point clouds: PLY, PCD, KITTI's `.bin`, and the raw binary rows of the shared data.
//!
//! | format | told by | module |
//! |---|---|---|
//! | PLY, ascii and binary of either byte order | `ply` at the start | [`ply`] |
//! | PCD 0.7, ascii, binary, compressed | `# .PCD` or `VERSION` at the start | [`pcd`] |
//! | `.bin` and `.xyzi.f32`: rows of x, y, z, intensity | name | [`raw`] |
//! | `.xyz.f32`: rows of x, y, z; `.xyz.i16mm2`: the same in steps of 2 mm | name | [`raw`] |
//! | `.rec12`: half-precision x, y, z, then intensity, laser, time | name | [`raw`] |
//!
//! A cloud may hold points that are not finite, as drivers mark missing returns.

mod lzf;
pub mod pcd;
pub mod ply;
pub mod raw;
mod table;

use crate::{Error, Input};
use agv_core::sensors::PointCloud;
use std::path::Path;

/// How the points are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Numbers as text.
    Ascii,
    /// Numbers as little-endian bytes.
    Binary,
}

/// Reads a cloud of any of the formats.
///
/// # Errors
/// A file that cannot be read, is of none of the formats, or is wrong; the place is named.
pub fn read(path: impl AsRef<Path>) -> Result<PointCloud, Error> {
    parse(&Input::read(path)?)
}

/// Reads a cloud of any of the formats from memory; raw rows are told apart by the input's name.
///
/// # Errors
/// As [`read`].
pub fn parse(input: &Input) -> Result<PointCloud, Error> {
    let bytes = input.bytes();
    // A download that failed, and not a cloud without points.
    if bytes.is_empty() {
        return Err(input.file_error("there is nothing in it"));
    }
    if bytes.starts_with(b"ply") {
        return ply::parse(input);
    }
    if bytes.starts_with(b"# .PCD") || bytes.starts_with(b"VERSION") {
        return pcd::parse(input);
    }
    let name = input.path().to_string_lossy();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    match raw::Layout::of_name(name) {
        Some(layout) => raw::parse(input, layout),
        None => Err(input.file_error("neither PLY nor PCD, and the name tells no other format")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::shared;
    use agv_core::sensors::PointSource;

    #[test]
    fn the_shared_clouds_have_their_points() {
        for (name, least, most) in [
            ("hdl32_source.xyz.f32", 60_000, 72_000),
            ("kitti00_000000.xyzi.f32", 124_000, 125_000),
            ("os0_030.xyz.i16mm2", 80_000, 86_000),
            ("av2_source.rec12", 98_000, 100_000),
            ("sim_020.xyz.f32", 28_000, 29_000),
        ] {
            if let Some(path) = shared(&format!("registration3d/{name}.gz")) {
                let cloud = read(path).unwrap();
                assert!((least..most).contains(&PointSource::len(&cloud)), "{name}: {}", cloud.len());
                assert!(cloud.points().all(|point| point.norm() < 300.0), "{name}");
            }
        }
    }

    #[test]
    fn what_is_no_cloud_is_said() {
        let error = parse(&Input::new("a.txt", "hello")).unwrap_err().to_string();
        assert!(error.contains("a.txt: neither PLY nor PCD"), "{error}");
        for name in ["a.xyz.f32", "a.xyz.f32.gz", "a.ply"] {
            let error = parse(&Input::new(name, "")).unwrap_err().to_string();
            assert!(error.contains(&format!("{name}: there is nothing in it")), "{error}");
        }
    }
}
