//! Position tracking on a recorded drive of 508 m, as the shared data's README describes it: start at the first reference
//! pose with standard deviations of 0.5 m and 15°, update each 0.2 m or 0.2 rad of odometry, 60 beams, errors without
//! alignment. The whole log is skipped where the shared data is not present; the shipped part of it always runs.

mod support;

use agv_core::{
    compute::Seed,
    geometry::angle_difference,
    grid::{LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
};
use agv_filters::particle::{
    DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
    OdometryNoise, ScanForm,
};
use nalgebra::{Matrix3, Vector3};
use support::{Drive, shared_drive, shipped_drive};

struct Figures {
    updates: usize,
    position_rmse: f64,
    position_max: f64,
    heading_rmse: f64,
}

fn track(drive: &Drive, form: ScanForm, particles: usize, seed: u64) -> Figures {
    let field = LikelihoodField::new(&drive.map, LikelihoodFieldParams::default()).unwrap();
    let sensor = LikelihoodFieldModelParams { form, ..Default::default() };
    let sensor = LikelihoodFieldModel::new(&field, sensor).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let params = MclParams { particles, ..Default::default() };
    let mut mcl = Mcl::new(motion, sensor, FreeSpace::new(&drive.map).unwrap(), params, Seed(seed)).unwrap();
    let sigma = Vector3::new(0.5, 0.5, 15_f64.to_radians());
    let covariance = Matrix3::from_diagonal(&sigma.component_mul(&sigma));
    mcl.initialize(&PoseBelief::around(drive.reference[0].pose, covariance)).unwrap();

    let (mut updates, mut squares, mut worst, mut heading_squares) = (0, 0.0, 0.0_f64, 0.0);
    let mut last = &drive.entries[0];
    for (entry, reference) in drive.entries.iter().zip(&drive.reference) {
        let (start, end) = (last.scan.stamp(), entry.scan.stamp());
        let motion = OdometryIncrement::between(start, &last.odom_from_base, end, &entry.odom_from_base).unwrap();
        mcl.predict(&motion).unwrap();
        last = entry;
        let reference = reference.pose;
        if matches!(mcl.update(&entry.scan).unwrap(), UpdateOutcome::Applied(_)) {
            let estimate = mcl.estimate().map_from_base;
            let error = (estimate.translation() - reference.translation()).norm();
            updates += 1;
            squares += error * error;
            worst = worst.max(error);
            heading_squares += angle_difference(estimate.yaw(), reference.yaw()).powi(2);
        }
    }
    let root_mean = |sum: f64| (sum / updates as f64).sqrt();
    Figures {
        updates,
        position_rmse: root_mean(squares),
        position_max: worst,
        heading_rmse: root_mean(heading_squares).to_degrees(),
    }
}

#[test]
fn tracks_the_intel_log() {
    let Some(drive) = shared_drive() else {
        eprintln!("skipped: the Intel log is not beside the repository");
        return;
    };
    let default = LikelihoodFieldModelParams::default().form;
    for (name, form, position_bound, heading_bound) in [
        ("default", default, 0.08, 1.6),
        ("product", ScanForm::Product { tempering: 1.0 }, 0.08, 1.6),
        ("sum of cubes", ScanForm::SumOfCubes, 0.16, 3.5),
    ] {
        for seed in 0..3 {
            let f = track(&drive, form, 500, seed);
            eprintln!(
                "{name}, seed {seed}: {} updates, position rmse {:.4} m, max {:.2} m, heading rmse {:.2}°",
                f.updates, f.position_rmse, f.position_max, f.heading_rmse
            );
            assert!(f.position_rmse < position_bound && f.heading_rmse < heading_bound, "{name}, seed {seed}");
        }
    }
}

#[test]
fn tracks_the_shipped_drive() {
    let drive = shipped_drive();
    for seed in 0..5 {
        let f = track(&drive, LikelihoodFieldModelParams::default().form, 2000, seed);
        eprintln!(
            "seed {seed}: {} updates, position rmse {:.4} m, max {:.2} m, heading rmse {:.2}°",
            f.updates, f.position_rmse, f.position_max, f.heading_rmse
        );
        assert!(f.position_rmse < 0.12 && f.position_max < 0.5 && f.heading_rmse < 2.0, "seed {seed}");
    }
}
