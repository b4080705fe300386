//! MRPB: floor plans with pairs of start and goal (Wen et al., ICRA 2021).

use crate::{
    Error, Input,
    map::{MapMeta, Mode, assemble},
    table::Table,
};
use agv_core::{
    geometry::Se2,
    grid::{CellState, Grid},
};
use std::path::Path;

/// A start and a goal in one of the maps.
#[derive(Debug, Clone, PartialEq)]
pub struct MrpbTest {
    /// Name of the map: its file without folder and extension.
    pub map: String,
    /// Number of the test in its map.
    pub number: usize,
    /// Where the vehicle starts, in the map frame.
    pub start: Se2,
    /// Where it is to go.
    pub goal: Se2,
    /// Edge of a pixel, in metres.
    pub resolution: f64,
    /// Position of the lower-left corner of the image, in metres.
    pub origin: (f64, f64),
}

/// Reads a table of tests (`map, test, sx_m, sy_m, syaw_rad, gx_m, gy_m, gyaw_rad, res_m, origin_x, origin_y`).
///
/// # Errors
/// A file that cannot be read, or a line that is none.
pub fn read_mrpb_tests(tests: impl AsRef<Path>) -> Result<Vec<MrpbTest>, Error> {
    let input = Input::read(tests)?;
    let columns =
        ["map", "test", "sx_m", "sy_m", "syaw_rad", "gx_m", "gy_m", "gyaw_rad", "res_m", "origin_x", "origin_y"];
    let table = Table::new(&input, &columns)?;
    table
        .rows()
        .map(|row| {
            let row = row?;
            let resolution = row.number("res_m")?;
            if resolution <= 0.0 {
                return Err(row.error("res_m must be positive"));
            }
            Ok(MrpbTest {
                map: row.text("map")?.into(),
                number: row.count("test", usize::MAX)?,
                start: Se2::new(row.number("sx_m")?, row.number("sy_m")?, row.number("syaw_rad")?),
                goal: Se2::new(row.number("gx_m")?, row.number("gy_m")?, row.number("gyaw_rad")?),
                resolution,
                origin: (row.number("origin_x")?, row.number("origin_y")?),
            })
        })
        .collect()
}

/// Reads the image of a map, as one of its tests says where it lies: 254 is free, 0 occupied, 205 unknown.
///
/// # Errors
/// An image that cannot be read.
pub fn read_mrpb_map(image: impl AsRef<Path>, test: &MrpbTest) -> Result<Grid<CellState>, Error> {
    let meta = MapMeta {
        image: test.map.clone(),
        resolution: test.resolution,
        origin: [test.origin.0, test.origin.1, 0.0],
        mode: Mode::Trinary,
        negate: false,
        occupied_threshold: 0.65,
        free_threshold: 0.196,
    };
    let occupancy = assemble(&meta, &Input::read(image)?)?;
    Ok(occupancy.map(|&occupancy| match occupancy {
        0 => CellState::Free,
        100 => CellState::Occupied,
        _ => CellState::Unknown,
    }))
}
