//! What closing loops makes of the odometry.

use crate::{Args, Result, load::Drive};
use agv_nav::{
    core::{
        geometry::{LieGroup as _, Se3},
        metrics::TrajectoryPose as _,
        roles::LidarOdometryStep,
        sensors::PointCloud,
        solve::RobustKernel,
    },
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
    /// Scans that became key frames.
    keys: Vec<usize>,
    /// Scans that were found at a key frame of before, so that they became none.
    met: usize,
    scans: usize,
}

impl Loops {
    pub(crate) fn new(args: &Args) -> Result<Self> {
        let registration = NdtRegistration::new(NdtParams::default())?.with_parallelism(args.common.par());
        let mapper = KeyFrameMapper::new(registration, KeyFrameParams::default())?;
        Ok(Self { mapper, times: Timings::default(), closures: 0, keys: Vec::new(), met: 0, scans: 0 })
    }

    pub(crate) fn process(&mut self, step: &LidarOdometryStep, scan: &PointCloud) -> Result<()> {
        let mut once = Timings::default();
        let made = once.time(|| self.mapper.process(step, scan))?;
        self.closures += made.closures;
        if made.key.is_some() {
            self.keys.push(self.scans);
        }
        self.met += usize::from(made.met.is_some());
        if made.key.is_some() || made.met.is_some() {
            self.times.append(once);
        }
        self.scans += 1;
        Ok(())
    }

    /// Poses of all clouds as they are known in the end.
    pub(crate) fn poses(&self) -> Vec<Se3> {
        self.mapper.map().trajectory().map(|(_, pose)| pose).collect()
    }

    /// How far the closure that is farthest off puts its key frames from where the reference has them, in metres; none without any.
    fn worst_loop(&self, drive: &Drive) -> Option<f64> {
        let map = self.mapper.map();
        let truth = |key: usize| self.keys.get(key).and_then(|&scan| drive.truth.get(scan).copied().flatten());
        // Odometry's relations have no kernel.
        let finds = map.relations().iter().filter(|relation| relation.kernel != RobustKernel::Square);
        let errors = finds.filter_map(|find| {
            let between = truth(find.from.index())?.between(&truth(find.to.index())?);
            Some(between.between(&find.from_from_to).distance())
        });
        errors.max_by(f64::total_cmp)
    }

    /// Reports the corrected trajectory beside the odometry's, and what the map is made of.
    pub(crate) fn report(&self, drive: &Drive, report: &mut Report) -> Result<()> {
        let map: &KeyFrameMap = self.mapper.map();
        let tiles = map.tiles(VoxelParams::default(), TILE)?;
        report
            .count("key_frames", self.keys.len())
            .count("key_frames_met_again", self.met)
            .count("loops", self.closures)
            .count("loops_kept", map.closures().len())
            .count("map_tiles", tiles.loaded().count())
            .count("map_voxels", tiles.len())
            .number("key_frame_ms_p50", self.times.milliseconds(50.0))
            .number("key_frame_ms_p99", self.times.milliseconds(99.0));
        if let Some(worst) = self.worst_loop(drive) {
            report.number("loop_worst_error_m", worst);
        }
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
