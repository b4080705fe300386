//! The estimates that are compared, at every step of a drive.

use super::{
    Args, Result,
    drive::{Drive, Hall, RADIUS},
};
use agv_nav::{
    core::{
        geometry::wrap_angle,
        grid::{LikelihoodField, LikelihoodFieldParams},
        metrics::Statistics,
    },
    filters::{
        fusion::{FusionFilter, FusionParams, MotionNoise, SourceParams},
        particle::{
            DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
            OdometryNoise, PriorMotionModel, PriorNoise,
        },
    },
    nalgebra::{Matrix3, Vector3},
    prelude::*,
};

/// Names and ranges of the lasers, in metres: as the paper prints it, and as it probably was.
pub(crate) const LASERS: [(&str, f64); 2] = [("1m", 1.0), ("10m", 10.0)];

/// Poses of every estimate after each step.
pub(crate) struct Estimates {
    /// Odometry alone.
    pub(crate) odometry: Vec<Se2>,
    /// Odometry and IMU in a Kalman filter.
    pub(crate) fused: Vec<Se2>,
    /// Particles that move by the odometry, with each laser.
    pub(crate) alone: [Vec<Se2>; 2],
    /// Particles that move by the Kalman filter.
    pub(crate) with_prior: [Vec<Se2>; 2],
}

impl Estimates {
    pub(crate) fn of(drive: &Drive, hall: &Hall, args: &Args, seed: Seed) -> Result<Self> {
        let mut odometry = vec![];
        let mut pose = drive.start;
        for step in &drive.steps {
            pose = pose * step.odometry.start_from_end;
            odometry.push(pose);
        }
        let (fused, motions) = fuse(drive, args.imu_delay)?;
        let by_odometry: Vec<_> = drive.steps.iter().map(|step| step.odometry).collect();
        let mut estimates = Self { odometry, fused, alone: [vec![], vec![]], with_prior: [vec![], vec![]] };
        for laser in 0..LASERS.len() {
            let seed = seed.derive(laser as u64);
            let wheels = DifferentialOdometryModel::new(OdometryNoise::default())?;
            estimates.alone[laser] = localize(drive, hall, args, laser, &by_odometry, wheels, seed)?;
            let prior = PriorMotionModel::new(prior_noise(args.prior_share))?;
            estimates.with_prior[laser] = localize(drive, hall, args, laser, &motions, prior, seed)?;
        }
        Ok(estimates)
    }

    pub(crate) fn errors(&self, drive: &Drive) -> Result<Errors> {
        let truth = drive.truths();
        let largest = |poses: &[Se2]| Ok::<_, agv_nav::core::Error>(Statistics::new(distances(poses, &truth))?.max());
        let rms = |poses: &[Se2]| {
            let squares = distances(poses, &truth).iter().map(|d| d * d).sum::<f64>();
            (squares / truth.len().max(1) as f64).sqrt()
        };
        let turned = |poses: &[Se2]| {
            let turns = poses.iter().zip(&truth).map(|(a, b)| wrap_angle(a.yaw() - b.yaw()).abs().to_degrees());
            turns.fold(0.0, f64::max)
        };
        Ok(Errors {
            odometry: largest(&self.odometry)?,
            fused: largest(&self.fused)?,
            odometry_heading: turned(&self.odometry),
            fused_heading: turned(&self.fused),
            alone: [largest(&self.alone[0])?, largest(&self.alone[1])?],
            with_prior: [largest(&self.with_prior[0])?, largest(&self.with_prior[1])?],
            alone_rms: [rms(&self.alone[0]), rms(&self.alone[1])],
            with_prior_rms: [rms(&self.with_prior[0]), rms(&self.with_prior[1])],
        })
    }
}

/// Largest errors over a drive, in metres and degrees, and root mean squares of the particle filters' ones.
pub(crate) struct Errors {
    pub(crate) odometry: f64,
    pub(crate) fused: f64,
    pub(crate) odometry_heading: f64,
    pub(crate) fused_heading: f64,
    pub(crate) alone: [f64; 2],
    pub(crate) with_prior: [f64; 2],
    pub(crate) alone_rms: [f64; 2],
    pub(crate) with_prior_rms: [f64; 2],
}

/// Distances between poses, in metres.
pub(crate) fn distances(poses: &[Se2], truth: &[Se2]) -> Vec<f64> {
    poses.iter().zip(truth).map(|(a, b)| (a.translation() - b.translation()).norm()).collect()
}

/// What the filter states of its motions, and this share of them at least, so that particles keep room between them.
fn prior_noise(share: f64) -> PriorNoise {
    let least = share * share;
    PriorNoise { inflation: 1.0, position_per_run: least, turn_per_run: least, turn_per_turn: least }
}

/// A belief around the start: 5 cm and 0.02 rad.
fn around(start: Se2) -> Result<PoseBelief<Se2>> {
    let sigmas = Vector3::new(0.05, 0.05, 0.02);
    Ok(PoseBelief::around(start, Matrix3::from_diagonal(&sigmas.component_mul(&sigmas)))?)
}

/// The Kalman filter: its pose after each step, and the motion that it hands to the particles.
fn fuse(drive: &Drive, imu_delay: f64) -> Result<(Vec<Se2>, Vec<OdometryIncrement>)> {
    let mut filter = FusionFilter::new(FusionParams { yaw_scale_sigma: 0.05, ..FusionParams::default() })?;
    // The variances that the vehicle's odometry has at its rate; the drift in headings counts as noise.
    let motion =
        MotionNoise { position_per_metre: 3e-4, yaw_per_metre: 1e-3, yaw_per_radian: 1e-3, position_per_radian: 1e-4 };
    let wheels = filter.add_source(SourceParams { motion, ..SourceParams::wheels() })?;
    let imu = filter.add_source(SourceParams::imu())?;
    filter.initialize(&around(drive.start)?)?;
    let (mut poses, mut motions, mut arrived) = (Vec::new(), Vec::new(), 0);
    for step in &drive.steps {
        filter.fuse(wheels, step.odometry)?;
        // Samples come when they come; each is taken in at its own time.
        while let Some(late) = drive.steps.get(arrived).filter(|s| s.imu.stamp() + imu_delay <= step.truth.stamp) {
            filter.fuse(imu, late.imu)?;
            arrived += 1;
        }
        poses.push(*filter.state().ok_or("the filter has no belief")?.pose.mean());
        // The first call only says from where to count: the filter was then where it began, give or take one step.
        motions.push(filter.take_motion()?.unwrap_or(step.odometry));
    }
    Ok((poses, motions))
}

/// The particle filter, moved by `motions`: its pose after each step.
fn localize<M: agv_nav::filters::particle::MotionModel<Motion = OdometryIncrement>>(
    drive: &Drive,
    hall: &Hall,
    args: &Args,
    laser: usize,
    motions: &[OdometryIncrement],
    model: M,
    seed: Seed,
) -> Result<Vec<Se2>> {
    let field = LikelihoodField::new(&hall.map, LikelihoodFieldParams::default())?;
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
    let free_space = FreeSpace::new(&hall.map, RADIUS)?.reached_from(&drive.start.translation())?;
    let params =
        MclParams { particles: args.particles as usize, refine: !args.mean_of_particles, ..MclParams::default() };
    let mut mcl = Mcl::new(model, sensor, free_space, params, seed)?.with_parallelism(args.common.par());
    mcl.initialize(&around(drive.start)?)?;
    let mut poses = Vec::new();
    for (step, motion) in drive.steps.iter().zip(motions) {
        mcl.predict(motion)?;
        if let Some(scan) = step.scans.get(laser) {
            mcl.update(scan)?;
        }
        poses.push(*mcl.estimate().ok_or("the localizer has no belief")?.map_from_base());
    }
    Ok(poses)
}
