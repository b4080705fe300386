//! What makes a map, and how it is run.

use super::{Args, Result, graph::Graph, load::Drive, particles::Particles};
use agv_nav::prelude::*;
use agv_support::{cli::Report, log::StampedPose, progress::Progress, timing::Timings};

/// The methods by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Kind {
    /// A particle filter whose particles have a map each
    Rbpf,
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
    /// Bytes of what it keeps: all that a stored state holds.
    fn kept(&self) -> usize;
    /// Bytes of what it works with beside that.
    fn working(&self) -> usize;
    /// Figures of its own.
    fn report(&self, report: &mut Report);
}

/// What a run leaves behind.
pub(crate) struct Run {
    pub(crate) map: Grid<CellState>,
    pub(crate) way: Vec<StampedPose>,
    pub(crate) timings: Timings,
    /// Bytes kept, and the most that was worked with beside them.
    pub(crate) kept: usize,
    pub(crate) working: usize,
    pub(crate) figures: Report,
}

/// Takes all scans of the drive.
pub(crate) fn run(args: &Args, drive: &Drive) -> Result<Run> {
    let mut method: Box<dyn Method> = match args.method {
        Kind::Rbpf => Box::new(Particles::new(args.particles, args.common.seed(), args.common.par())?),
        Kind::Graph => Box::new(Graph::new(args.common.par())?),
    };
    let (mut timings, mut working) = (Timings::default(), 0);
    let progress = Progress::new(drive.entries.len(), "mapping");
    for entry in progress.over(&drive.entries) {
        let odometry = (!args.no_odometry).then_some(&entry.odom_from_base);
        timings.time(|| method.process(&entry.scan, odometry))?;
        working = working.max(method.working());
    }
    method.finish()?;
    let poses = method.trajectory();
    // Before the first scan that says something, the vehicle is where the map begins.
    let first = poses.first().copied().unwrap_or_default();
    let missing = drive.entries.len().saturating_sub(poses.len());
    let poses = std::iter::repeat_n(first, missing).chain(poses);
    let way = drive.entries.iter().map(|entry| entry.scan.stamp()).zip(poses);
    let mut figures = Report::new("");
    method.report(&mut figures);
    Ok(Run {
        map: method.map()?,
        way: way.map(|(stamp, pose)| StampedPose { stamp, pose }).collect(),
        timings,
        kept: method.kept(),
        working,
        figures,
    })
}
