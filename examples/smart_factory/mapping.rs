//! Stage 1: one drive through all aisles maps the hall.

use crate::{Args, Result, drive, hall::Hall};
use agv_nav::{
    core::{
        grid::OccupancyThresholds,
        metrics::Statistics,
        sensors::{Deskew, PoseTrack},
    },
    ndt::ndt::NdtMap,
    pipeline::csns::{Site, SiteMapper, SiteMapperParams},
    prelude::{CellState, Grid, LieGroup as _, PointCloud, Se2, Se3},
};
use agv_support::{cli::Report, timing::Timings};

/// Greatest speed of the mapping drive, in metres per second.
const SPEED: f64 = 2.0;

pub(crate) struct Mapped {
    pub(crate) site: Site,
    pub(crate) grid: Grid<CellState>,
    /// The same clouds at their true poses.
    pub(crate) true_map: NdtMap,
    pub(crate) truths: Vec<Se2>,
    pub(crate) estimates: Vec<Se2>,
    pub(crate) times: Vec<f64>,
    /// Points of the 3D map, for pictures.
    pub(crate) cloud: PointCloud,
}

impl Mapped {
    pub(crate) fn errors(&self) -> Vec<f64> {
        let apart = |(a, b): (&Se2, &Se2)| (a.translation() - b.translation()).norm();
        self.estimates.iter().zip(&self.truths).map(apart).collect()
    }
}

pub(crate) fn run(args: &Args, hall: &Hall, report: &mut Report) -> Result<Mapped> {
    let params = SiteMapperParams::default();
    let start = hall.tour.points().first().ok_or("an empty tour")?.pose;
    let mut mapper = SiteMapper::new(params.clone(), start.into())?;
    let (mut odometry, mut true_map) = (drive::odometry()?, NdtMap::new(params.localizer.ndt.voxels)?);
    let (mut timings, mut straight, mut points) = (Timings::default(), PointCloud::default(), Vec::new());
    let (mut truths, mut estimates, mut times, mut skipped) = (vec![], vec![], vec![], 0);
    drive::along(args, hall.factory.world(), &hall.tour, SPEED, args.common.seed(), |seen| {
        if let Some(motion) = odometry.update(&seen.odometry, seen.imu_samples())? {
            mapper.predict(&motion)?;
        }
        for (cloud, _) in seen.clouds() {
            let step = timings.time(|| mapper.insert(cloud))?;
            truths.push(seen.truth.map_from_base);
            estimates.push(step.map_from_base.to_planar());
            times.push(seen.truth.stamp.seconds());
            skipped += usize::from(matches!(step.outcome, Some(agv_nav::prelude::UpdateOutcome::Skipped(_))));
            if step.mapped {
                let truth = Se3::from(seen.truth.map_from_base);
                Deskew::cloud_into(cloud, &PoseTrack::new(seen.track(), seen.truth.stamp)?, &mut straight);
                let map_from_sensor = truth.compose(&straight.base_from_sensor());
                true_map.insert(&straight, &map_from_sensor);
                let own = step.map_from_base.compose(&straight.base_from_sensor());
                let near = |p: &agv_nav::nalgebra::Vector3<f32>| p.z > 0.1 && p.z < 4.0;
                points.extend(straight.points().step_by(5).map(|p| own.act(&p.cast()).cast::<f32>()).filter(near));
            }
        }
        Ok(())
    })?;
    let site = mapper.finish();
    let grid = site.grid.states(&OccupancyThresholds::default());
    let cloud = PointCloud::from_points(points);
    let mapped = Mapped { site, grid, true_map, truths, estimates, times, cloud };
    let errors = Statistics::new(mapped.errors())?;
    report
        .number("mapping_path_m", hall.tour.length())
        .count("mapping_clouds", mapped.truths.len())
        .count("mapping_skipped", skipped)
        .count("map_voxels", mapped.site.map.len())
        .number("mapping_min_m", errors.min())
        .number("mapping_mean_m", errors.mean())
        .number("mapping_max_m", errors.max())
        .number("mapping_ms_p50", timings.milliseconds(50.0))
        .number("mapping_ms_p99", timings.milliseconds(99.0));
    Ok(mapped)
}
