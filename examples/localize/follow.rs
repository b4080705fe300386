//! The filter on the drive.

use super::{Args, Result, load::Drive};
use agv_nav::{
    core::grid::{LikelihoodField, LikelihoodFieldParams},
    filters::particle::{
        Amcl, AmclParams, DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams,
        OdometryNoise,
    },
    nalgebra::{Matrix3, Vector3},
    prelude::*,
};
use agv_support::{progress::Progress, timing::Timings};

/// What is run: odometry of a differential drive, likelihood field, as many particles as needed.
pub(crate) type Filter = Amcl<DifferentialOdometryModel, LikelihoodFieldModel>;

/// Radius of the free space that the middle of the robot needs, in metres.
const ROOM: f64 = 0.2;

/// Deviations of a known start: in metres and radians.
const START: (f64, f64) = (0.5, 15.0_f64.to_radians());

/// Frames of the particle clouds, and particles of a frame, that are kept at most.
const FRAMES: usize = 300;
const SHOWN: usize = 300;

/// The estimate after an applied update.
pub(crate) struct Update {
    /// Row of the log.
    pub(crate) row: usize,
    pub(crate) map_from_base: Se2,
    pub(crate) particles: usize,
    pub(crate) explained: Option<f64>,
    pub(crate) status: LocalizationStatus,
}

/// A particle cloud.
pub(crate) struct Frame {
    pub(crate) row: usize,
    pub(crate) poses: Vec<Se2>,
    pub(crate) weights: Vec<f64>,
}

/// What a run leaves behind.
#[derive(Default)]
pub(crate) struct Run {
    pub(crate) updates: Vec<Update>,
    /// The estimate at every row.
    pub(crate) way: Vec<Se2>,
    pub(crate) frames: Vec<Frame>,
    pub(crate) timings: Timings,
    /// Updates that were taken in by degrees, and updates that drew particles elsewhere.
    pub(crate) tempered: usize,
    pub(crate) recovering: usize,
}

/// What filters on one map share.
pub(crate) struct Parts {
    sensor: LikelihoodFieldModel,
    space: FreeSpace,
}

impl Parts {
    /// The vehicle can stand where it can come to from the first reference pose, without one in the largest free area.
    pub(crate) fn new(drive: &Drive, par: Par) -> Result<Self> {
        let field = LikelihoodField::build(&drive.map, LikelihoodFieldParams::default(), par)?;
        let free = FreeSpace::new(&drive.map, ROOM)?;
        let first = drive.reference.first().map(|first| free.reached_from(&first.pose.translation()));
        let space = first.and_then(std::result::Result::ok).unwrap_or_else(|| free.largest());
        Ok(Self { sensor: LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?, space })
    }

    /// The filter with the library's defaults.
    pub(crate) fn filter(&self, par: Par, seed: Seed) -> Result<Filter> {
        let motion = DifferentialOdometryModel::new(OdometryNoise::default())?;
        let amcl = Amcl::new(motion, self.sensor.clone(), self.space.clone(), AmclParams::default(), seed)?;
        Ok(amcl.with_parallelism(par))
    }
}

/// Follows the whole drive.
pub(crate) fn run(args: &Args, drive: &Drive) -> Result<Run> {
    let start = drive.reference.first().map(|first| first.pose);
    let mut filter = Parts::new(drive, args.common.par())?.filter(args.common.par(), args.common.seed())?;
    filter.initialize(&match start.filter(|_| !args.global) {
        Some(start) => {
            let variances = Vector3::new(START.0, START.0, START.1).map(|deviation| deviation * deviation);
            PoseBelief::around(start, Matrix3::from_diagonal(&variances))?
        }
        None => PoseBelief::Anywhere,
    })?;

    let (mut run, mut last) = (Run::default(), &drive.log.entries[0]);
    let rows_per_frame = drive.log.entries.len().div_ceil(FRAMES);
    let progress = Progress::new(drive.log.entries.len(), "localising");
    for (row, entry) in progress.over(drive.log.entries.iter().enumerate()) {
        let (from, to) = (last.scan.stamp(), entry.scan.stamp());
        filter.predict(&OdometryIncrement::between(from, &last.odom_from_base, to, &entry.odom_from_base)?)?;
        last = entry;
        let mut attempt = Timings::default();
        let outcome = attempt.time(|| filter.update(&entry.scan))?;
        let map_from_base = *filter.estimate().ok_or("the filter has no belief")?.map_from_base();
        run.way.push(map_from_base);
        if let UpdateOutcome::Applied(report) = outcome {
            run.timings.append(attempt);
            let particles = filter.particles();
            run.updates.push(Update {
                row,
                map_from_base,
                particles: particles.len(),
                explained: report.explained,
                status: filter.status(),
            });
            run.tempered += usize::from(filter.diagnostics().degrees > 1);
            run.recovering += usize::from(filter.diagnostics().fresh > 0);
            if run.frames.last().is_none_or(|frame: &Frame| row >= frame.row + rows_per_frame) {
                let stride = particles.len().div_ceil(SHOWN);
                run.frames.push(Frame {
                    row,
                    poses: particles.states().iter().copied().step_by(stride).collect(),
                    weights: particles.weights().iter().copied().step_by(stride).collect(),
                });
            }
        }
    }
    if run.updates.is_empty() {
        return Err("not one scan was taken in: the drive is too short, or its scans have too few readings".into());
    }
    Ok(run)
}
