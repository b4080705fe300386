//! Recorded drives that the tests follow: with a map, the pose of the odometry, the scan and the reference pose, row by row.

use agv_core::{
    geometry::Se2,
    grid::{CellState, EvidenceGrid, Grid, GridLayout, InverseModelParams, OccupancyThresholds},
};
use agv_support::{
    log::{LogEntry, ScanLog, StampedPose, csv},
    map,
};
use std::path::{Path, PathBuf};

/// A drive, and the map to localise it in.
pub(crate) struct Drive {
    pub(crate) map: Grid<CellState>,
    pub(crate) entries: Vec<LogEntry>,
    pub(crate) reference: Vec<StampedPose>,
}

/// The whole log of the Intel Research Lab in its published map, if the shared data lies beside the repository.
pub(crate) fn shared_drive() -> Option<Drive> {
    let shared = |root: &Path| Some(root.join("shared/data/localization")).filter(|folder| folder.is_dir());
    let folder: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().find_map(shared)?;
    Some(Drive {
        map: map::read(folder.join("intel_map.yaml")).unwrap(),
        entries: ScanLog::read(folder.join("intel_scans.csv.gz")).unwrap().entries,
        reference: csv::read_reference(folder.join("intel_reference.csv.gz")).unwrap(),
    })
}

/// The shipped drive in a map that is built from the shipped mapping drive.
pub(crate) fn shipped_drive() -> Drive {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/intel");
    let read = |part: &str| {
        let log = ScanLog::read(folder.join(format!("{part}_scans.csv.gz"))).unwrap();
        let reference = csv::read_reference(folder.join(format!("{part}_reference.csv.gz"))).unwrap();
        (log.entries, reference)
    };
    let layout = GridLayout::new(64, 64, 0.05, Se2::default()).unwrap();
    let mut grid = EvidenceGrid::new(layout, InverseModelParams::default()).unwrap();
    let (entries, reference) = read("map");
    for (entry, reference) in entries.iter().zip(&reference) {
        grid.insert_scan(&entry.scan, &reference.pose).unwrap();
    }
    let (entries, reference) = read("drive");
    Drive { map: grid.states(&OccupancyThresholds::default()), entries, reference }
}
