//! The recorded log that the tests read where the shared data is present.

use agv_core::{
    geometry::Se2,
    grid::{CellState, Grid, GridLayout},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use flate2::read::GzDecoder;
use std::{
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

/// A log with the pose of the odometry, the scan and the reference pose, row by row.
pub(crate) struct IntelLog {
    pub(crate) map: Grid<CellState>,
    pub(crate) odometry: Vec<Se2>,
    pub(crate) scans: Vec<LaserScan>,
    pub(crate) reference: Vec<Se2>,
}

/// Reads the log of the Intel Research Lab, if the shared data lies beside the repository.
pub(crate) fn intel_log() -> Option<IntelLog> {
    let shared = |root: &Path| Some(root.join("shared/data/localization")).filter(|folder| folder.is_dir());
    let folder: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().find_map(shared)?;
    let read = |name: &str| {
        let mut bytes = Vec::new();
        GzDecoder::new(File::open(folder.join(name)).ok()?).read_to_end(&mut bytes).ok()?;
        Some(bytes)
    };
    let rows = |name: &str| {
        let text = String::from_utf8(read(name)?).ok()?;
        let numbers = |line: &str| line.split(',').map(|field| field.parse().unwrap()).collect::<Vec<f64>>();
        Some(text.lines().skip(1).map(numbers).collect::<Vec<_>>())
    };
    let geometry = ScanGeometry {
        angle_min: -90_f64.to_radians(),
        angle_increment: 1_f64.to_radians(),
        range_max: 81.0,
        ..Default::default()
    };
    let pose = |row: &Vec<f64>| Se2::new(row[1], row[2], row[3]);
    let log = rows("intel_scans.csv.gz")?;
    let scan = |row: &Vec<f64>| {
        let ranges = row[4..].iter().map(|&range| range as f32).collect();
        LaserScan::new(Stamp::from_seconds(row[0]), geometry, ranges).unwrap()
    };
    Some(IntelLog {
        map: pgm(&read("intel_map.pgm.gz")?),
        odometry: log.iter().map(pose).collect(),
        scans: log.iter().map(scan).collect(),
        reference: rows("intel_reference.csv.gz")?.iter().map(pose).collect(),
    })
}

/// The Intel map: header of three lines, 665 x 662 cells of 0.05 m, lower-left corner at (-12.5, -25.15).
fn pgm(bytes: &[u8]) -> Grid<CellState> {
    let layout = GridLayout::new(665, 662, 0.05, Se2::new(-12.5, -25.15, 0.0)).unwrap();
    let pixels = &bytes[bytes.len() - layout.len()..];
    let rows = pixels.chunks_exact(layout.width()).rev();
    let state = |&value: &u8| match value {
        0 => CellState::Occupied,
        254 => CellState::Free,
        _ => CellState::Unknown,
    };
    Grid::new(layout, rows.flatten().map(state).collect()).unwrap()
}
