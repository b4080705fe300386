//! What makes a map, and how it is run.

use super::{Args, Result, load::Drive};
use agv_nav::{
    core::grid::OccupancyThresholds,
    filters::slam::graph::{GraphSlam, GraphSlamParams, TrackingOutcome},
    prelude::*,
};
use agv_support::{cli::Report, log::StampedPose, progress::Progress, timing::Timings};

/// The methods by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Kind {
    /// Key scans in a pose graph
    Graph,
}

/// A method that makes a map of scans that come one after the other.
pub(crate) trait Method {
    /// Takes a scan, and where the vehicle is in the odometry's frame, if there is odometry.
    fn process(&mut self, scan: &LaserScan, odom_from_base: Option<&Se2>) -> Result<()>;
    /// Called once after the last scan.
    fn finish(&mut self) -> Result<()>;
    /// The map.
    fn map(&self) -> Result<Grid<CellState>>;
    /// The poses of all scans, in their order.
    fn trajectory(&self) -> Vec<Se2>;
    /// Bytes of what it keeps.
    fn memory(&self) -> usize;
    /// Figures of its own.
    fn report(&self, report: &mut Report);
}

/// What a run leaves behind.
pub(crate) struct Run {
    pub(crate) map: Grid<CellState>,
    pub(crate) way: Vec<StampedPose>,
    pub(crate) timings: Timings,
    pub(crate) memory: usize,
    pub(crate) figures: Report,
}

/// Takes all scans of the drive.
pub(crate) fn run(args: &Args, drive: &Drive) -> Result<Run> {
    let mut method: Box<dyn Method> = match args.method {
        Kind::Graph => Box::new(Graph::new(args.common.par())?),
    };
    let mut timings = Timings::default();
    let progress = Progress::new(drive.entries.len(), "mapping");
    for entry in progress.over(&drive.entries) {
        let odometry = (!args.no_odometry).then_some(&entry.odom_from_base);
        timings.time(|| method.process(&entry.scan, odometry))?;
    }
    method.finish()?;
    let way = drive.entries.iter().map(|entry| entry.scan.stamp()).zip(method.trajectory());
    let mut figures = Report::new("");
    method.report(&mut figures);
    Ok(Run {
        map: method.map()?,
        way: way.map(|(stamp, pose)| StampedPose { stamp, pose }).collect(),
        timings,
        memory: method.memory(),
        figures,
    })
}

/// Graph SLAM with the library's defaults.
struct Graph {
    slam: GraphSlam,
    closures: usize,
    /// Scans that were searched for, and scans that were found nowhere near.
    searched: usize,
    missed: usize,
}

impl Graph {
    fn new(par: Par) -> Result<Self> {
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

    fn memory(&self) -> usize {
        self.slam.memory()
    }

    fn report(&self, report: &mut Report) {
        report
            .count("key_scans", self.slam.keys())
            .count("closures", self.closures)
            .count("searched", self.searched)
            .count("missed", self.missed);
    }
}
