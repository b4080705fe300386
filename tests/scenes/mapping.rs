//! Both ways to make a map, on the drive of the shared room.

use agv_nav::{
    core::{
        compute::{Par, Seed},
        geometry::{LieGroup, Se2},
        odometry::OdometryIncrement,
        sensors::LaserScan,
    },
    filters::{
        particle::{DifferentialOdometryModel, EffectiveSampleSizeBelow, OdometryNoise},
        slam::{GraphSlam, GraphSlamParams, Rbpf, RbpfParams},
    },
};

/// A particle filter with a map in each particle.
pub(crate) type ParticleSlam = Rbpf<DifferentialOdometryModel>;

/// Few particles, and new sets as often as there may be one.
pub(crate) fn particle_slam(par: Par) -> ParticleSlam {
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let resample = EffectiveSampleSizeBelow { ratio: 1.0 };
    let params = RbpfParams { particles: 9, resample, ..Default::default() };
    Rbpf::new(motion, params, Seed(3)).unwrap().with_parallelism(par)
}

/// Maps along a drive by wheels that slip, or by the scans alone; how often a new set was drawn.
pub(crate) fn map_by_particles(
    slam: &mut ParticleSlam,
    drive: &[(OdometryIncrement, LaserScan)],
    with_wheels: bool,
) -> usize {
    let mut resampled = 0;
    for (motion, scan) in drive {
        if with_wheels {
            let slipping = motion.start_from_end * Se2::new(0.02, 0.0, 0.01);
            slam.predict(&OdometryIncrement { start_from_end: slipping, ..*motion }).unwrap();
        }
        resampled += usize::from(slam.update(scan).unwrap().resampled);
    }
    resampled
}

/// Graph SLAM with its defaults.
pub(crate) fn graph_slam(par: Par) -> GraphSlam {
    GraphSlam::new(GraphSlamParams::default()).unwrap().with_parallelism(par)
}

/// Maps from the `first` scan of a drive on, by odometry that drifts; how many closures were believed.
pub(crate) fn map_by_graph(slam: &mut GraphSlam, drive: &[(OdometryIncrement, LaserScan)], first: usize) -> usize {
    let drift = Se2::new(0.002, 0.0, 0.001);
    let mut odometry = drive[..first].iter().fold(Se2::identity(), |pose, step| pose * step.0.start_from_end * drift);
    let mut closures = 0;
    for (motion, scan) in &drive[first..] {
        odometry = odometry * motion.start_from_end * drift;
        closures += slam.process(scan, Some(&odometry)).unwrap().closures;
    }
    closures
}
