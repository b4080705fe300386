//! Scans and reference poses from files.

use crate::{Args, Result};
use agv_nav::core::{geometry::Se3, sensors::PointCloud, time::Stamp};
use agv_support::{cloud, progress::Progress, trajectory};
use std::{collections::BTreeMap, path::Path};

/// Scans in order, and the pose of the base at each of them as far as that is known; the base of a scan from a file is its sensor.
pub(crate) struct Drive {
    pub(crate) scans: Vec<PointCloud>,
    pub(crate) truth: Vec<Option<Se3>>,
}

pub(crate) fn load(args: &Args) -> Result<Drive> {
    let progress = Progress::new(args.scans.len(), "reading");
    let mut scans = progress.over(&args.scans).map(cloud::read).collect::<std::result::Result<Vec<_>, _>>()?;
    let mut truth = vec![None; scans.len()];
    if let Some(path) = &args.poses {
        let poses = References::read(path)?;
        for (index, file) in args.scans.iter().enumerate() {
            let Some((stamp, pose)) = poses.of(index, file) else { continue };
            truth[index] = Some(pose);
            if let Some(stamp) = stamp.filter(|_| scans[index].stamp() == Stamp::default()) {
                scans[index] = std::mem::take(&mut scans[index]).with_stamp(stamp);
            }
        }
        if truth.iter().all(Option::is_none) {
            return Err(format!("{} has no pose of any of the scans", path.display()).into());
        }
    }
    Ok(Drive { scans, truth })
}

/// Reference poses by the scan's number or place.
enum References {
    ByNumber(BTreeMap<u64, (Option<Stamp>, Se3)>),
    InOrder(Vec<(Option<Stamp>, Se3)>),
}

impl References {
    /// Tells the formats apart by the first line of data.
    fn read(path: &Path) -> Result<Self> {
        let input = agv_support::Input::read(path)?;
        let first = input.data_lines().next().transpose()?.map(|(_, line)| line.to_owned()).unwrap_or_default();
        if first.contains(',') {
            let mut poses = BTreeMap::new();
            for line in input.data_lines() {
                let (number, line) = line?;
                let values: Vec<f64> = line.split(',').map_while(|field| field.trim().parse().ok()).collect();
                let wrong = || {
                    format!("{}:{number}: not a scan's number, its time and the 12 numbers of a pose", path.display())
                };
                let [index, seconds, rows @ ..] = values.as_slice() else { return Err(wrong().into()) };
                let rows: [f64; 12] = rows.try_into().map_err(|_| wrong())?;
                let pose = trajectory::pose_from_rows(&rows).ok_or_else(wrong)?;
                if !(seconds.is_finite() && *index >= 0.0) {
                    return Err(wrong().into());
                }
                poses.insert(*index as u64, (Some(Stamp::from_seconds(*seconds)), pose));
            }
            return Ok(Self::ByNumber(poses));
        }
        if first.split_whitespace().count() == 12 {
            return Ok(Self::InOrder(trajectory::parse_kitti(&input)?.into_iter().map(|pose| (None, pose)).collect()));
        }
        let poses = trajectory::parse_tum(&input)?;
        Ok(Self::InOrder(poses.into_iter().map(|at| (Some(at.stamp), at.pose)).collect()))
    }

    fn of(&self, index: usize, file: &Path) -> Option<(Option<Stamp>, Se3)> {
        match self {
            Self::ByNumber(poses) => poses.get(&number(file)?).copied(),
            Self::InOrder(poses) => poses.get(index).copied(),
        }
    }
}

/// The last run of digits in a file's name before its first dot.
fn number(file: &Path) -> Option<u64> {
    let name = file.file_name()?.to_string_lossy();
    let stem = name.split('.').next()?;
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end].rfind(|c: char| !c.is_ascii_digit()).map_or(0, |at| at + 1);
    stem[start..end].parse().ok()
}
