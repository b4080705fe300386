//! Paper 000's scenario class: odometry that turns away, an IMU, and a particle filter that moves by one or by both.

#[path = "../../examples/fuse_odometry_imu/drive.rs"]
mod drive;
#[path = "../../examples/fuse_odometry_imu/estimates.rs"]
mod estimates;

use agv_nav::core::compute::Seed;
use agv_support::cli::CommonArgs;
use drive::{Drive, Hall};
use estimates::{Errors, Estimates};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// The example's arguments.
struct Args {
    particles: u32,
    prior_share: f64,
    imu_delay: f64,
    mean_of_particles: bool,
    common: CommonArgs,
}

#[test]
fn an_imu_halves_the_errors_and_more() {
    let common = CommonArgs { seed: 1, out: None, json: true, threads: 1 };
    let args = Args { particles: 500, prior_share: 0.02, imu_delay: 0.0, mean_of_particles: false, common };
    let hall = Hall::new(0.05).unwrap();
    for seed in args.common.seeds(10) {
        let drive = Drive::new(&hall, seed).unwrap();
        let estimates = Estimates::of(&drive, &hall, &args, seed).unwrap();
        let errors: Errors = estimates.errors(&drive).unwrap();
        let Seed(seed) = seed;
        assert!(errors.fused < (1.0 - 0.69) * errors.odometry, "seed {seed}: {} of {}", errors.fused, errors.odometry);
        assert!(errors.fused_heading < 0.2 * errors.odometry_heading, "seed {seed}");
        // Where the laser sees little, the motion decides.
        let ([with_prior, far_with_prior], [alone, far_alone]) = (errors.with_prior, errors.alone);
        assert!(with_prior <= 0.171 && with_prior <= alone, "seed {seed}, laser of 1 m: {with_prior}, {alone}");
        // What is worst in one of so many updates says little: on the whole drive, too.
        assert!(
            errors.with_prior_rms[0] <= errors.alone_rms[0],
            "seed {seed}: {:?}, {:?}",
            errors.with_prior_rms,
            errors.alone_rms
        );
        // Where it sees much, the scan does: both are right to the map's cells.
        assert!(far_with_prior < 0.06 && far_alone < 0.06, "seed {seed}, laser of 10 m: {far_with_prior}, {far_alone}");
    }
}
