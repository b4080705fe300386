//! What closing loops makes of the odometry.

use crate::{Args, Result, load::Drive};
use agv_nav::{
    core::{geometry::Se3, roles::LidarOdometryStep, sensors::PointCloud},
    ndt::ndt::{NdtParams, NdtRegistration, VoxelParams},
    pipeline::mapping::{KeyFrameMap, KeyFrameMapper, KeyFrameParams},
};
use agv_support::{cli::Report, timing::Timings};

/// Voxels along the edge of a tile of the map.
const TILE: usize = 32;

pub(crate) struct Loops {
    mapper: KeyFrameMapper<NdtRegistration>,
    times: Timings,
    closures: usize,
    /// Clouds that became key frames, of which the times are the mapper's.
    keys: usize,
}

impl Loops {
    pub(crate) fn new(args: &Args) -> Result<Self> {
        let registration = NdtRegistration::new(NdtParams::default())?.with_parallelism(args.common.par());
        let mapper = KeyFrameMapper::new(registration, KeyFrameParams::default())?;
        Ok(Self { mapper, times: Timings::default(), closures: 0, keys: 0 })
    }

    pub(crate) fn process(&mut self, step: &LidarOdometryStep, scan: &PointCloud) -> Result<()> {
        let mut once = Timings::default();
        let made = once.time(|| self.mapper.process(step, scan))?;
        self.closures += made.closures;
        if made.key.is_some() {
            self.keys += 1;
            self.times.append(once);
        }
        Ok(())
    }

    /// Poses of all clouds as they are known in the end.
    pub(crate) fn poses(&self) -> Vec<Se3> {
        self.mapper.map().trajectory().map(|(_, pose)| pose).collect()
    }

    /// Reports the corrected trajectory beside the odometry's, and what the map is made of.
    pub(crate) fn report(&self, drive: &Drive, report: &mut Report) -> Result<()> {
        let map: &KeyFrameMap = self.mapper.map();
        let tiles = map.tiles(VoxelParams::default(), TILE)?;
        report
            .count("key_frames", self.keys)
            .count("loops", self.closures)
            .count("loops_kept", map.closures().len())
            .count("map_tiles", tiles.loaded().count())
            .count("map_voxels", tiles.len())
            .number("key_frame_ms_p50", self.times.milliseconds(50.0))
            .number("key_frame_ms_p99", self.times.milliseconds(99.0));
        if let Some(errors) = crate::judge::trajectory(drive, &self.poses())? {
            report
                .number("corrected_end_error_m", errors.end.0)
                .number("corrected_end_error_deg", errors.end.1)
                .number("corrected_worst_error_m", errors.worst)
                .number("corrected_ate_rmse_m", errors.ate);
        }
        Ok(())
    }
}
