//! The Rao-Blackwellised particle filter.

use super::{Result, methods::Method};
use agv_nav::{
    core::grid::OccupancyThresholds,
    filters::{
        particle::{DifferentialOdometryModel, OdometryNoise},
        slam::{Rbpf, RbpfParams},
    },
    prelude::*,
};
use agv_support::cli::Report;

/// The filter with the library's defaults, but for the number of particles.
pub(crate) struct Particles {
    slam: Rbpf<DifferentialOdometryModel>,
    last: Option<(Stamp, Se2)>,
    taken: usize,
    resampled: usize,
}

impl Particles {
    pub(crate) fn new(particles: usize, seed: Seed, par: Par) -> Result<Self> {
        let motion = DifferentialOdometryModel::new(OdometryNoise::default())?;
        let slam = Rbpf::new(motion, RbpfParams { particles, ..Default::default() }, seed)?.with_parallelism(par);
        Ok(Self { slam, last: None, taken: 0, resampled: 0 })
    }
}

impl Method for Particles {
    fn process(&mut self, scan: &LaserScan, odom_from_base: Option<&Se2>) -> Result<()> {
        if let Some(odometry) = odom_from_base {
            if let Some((then, before)) = self.last {
                self.slam.predict(&OdometryIncrement::between(then, &before, scan.stamp(), odometry)?)?;
            }
            self.last = Some((scan.stamp(), *odometry));
        }
        let done = self.slam.update(scan)?;
        self.taken += usize::from(done.skipped.is_none());
        self.resampled += usize::from(done.resampled);
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }

    fn map(&self) -> Result<Grid<CellState>> {
        Ok(self.slam.best_map().states(&OccupancyThresholds::default())?)
    }

    fn trajectory(&self) -> Vec<Se2> {
        self.slam.trajectory().into_iter().map(|(_, pose)| pose).collect()
    }

    fn kept(&self) -> usize {
        self.slam.memory()
    }

    fn working(&self) -> usize {
        self.slam.working_memory()
    }

    fn report(&self, report: &mut Report) {
        report
            .count("particles", self.slam.weights().len())
            .count("updates", self.taken)
            .count("resampled", self.resampled);
    }
}
