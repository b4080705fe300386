//! Graph SLAM.

use super::{Result, methods::Method};
use agv_nav::{
    core::grid::OccupancyThresholds,
    filters::slam::graph::{GraphSlam, GraphSlamParams, TrackingOutcome},
    prelude::*,
};
use agv_support::cli::Report;

/// Graph SLAM with the library's defaults.
pub(crate) struct Graph {
    slam: GraphSlam,
    closures: usize,
    /// Scans that were searched for, and scans that were found nowhere near.
    searched: usize,
    missed: usize,
}

impl Graph {
    pub(crate) fn new(par: Par) -> Result<Self> {
        let slam = GraphSlam::new(GraphSlamParams::default())?.with_parallelism(par);
        Ok(Self { slam, closures: 0, searched: 0, missed: 0 })
    }
}

impl Method for Graph {
    fn process(&mut self, scan: &LaserScan, odom_from_base: Option<&Se2>) -> Result<()> {
        let step = self.slam.process(scan, odom_from_base)?;
        self.closures += step.closures;
        self.searched += usize::from(step.outcome == TrackingOutcome::Searched);
        self.missed += usize::from(step.outcome == TrackingOutcome::DeadReckoning);
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        self.slam.correct()?;
        Ok(())
    }

    fn map(&self) -> Result<Grid<CellState>> {
        Ok(self.slam.map()?.states(&OccupancyThresholds::default()))
    }

    fn trajectory(&self) -> Vec<Se2> {
        self.slam.trajectory().map(|(_, pose)| pose).collect()
    }

    fn kept(&self) -> usize {
        self.slam.memory()
    }

    fn working(&self) -> usize {
        self.slam.working_memory()
    }

    fn report(&self, report: &mut Report) {
        report
            .count("key_scans", self.slam.keys())
            .count("closures", self.closures)
            .count("searched", self.searched)
            .count("missed", self.missed);
    }
}
