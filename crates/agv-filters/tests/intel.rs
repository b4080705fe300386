//! Position tracking on a recorded drive of 508 m.

mod support;

use agv_core::{
    compute::Seed,
    geometry::{Se2, angle_difference},
    grid::{LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
};
use agv_filters::particle::{
    DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
    OdometryNoise, ScanForm,
};
use nalgebra::{Matrix3, Vector3};
use support::{IntelLog, intel_log};

#[derive(Debug, Clone, Copy)]
struct Setting { form: ScanForm, alpha: f64, particles: usize, sigma: f64, resample: f64, zr: f64, rm: f64 }

fn track(log: &IntelLog, s: Setting, seed: u64) -> (usize, f64, f64, f64, f64) {
    let field = LikelihoodField::new(&log.map, LikelihoodFieldParams { sigma_hit: s.sigma, z_rand: s.zr, range_max: s.rm, ..Default::default() }).unwrap();
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams { form: s.form, ..Default::default() }).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(s.alpha)).unwrap();
    let mut params = MclParams { particles: s.particles, ..Default::default() };
    params.resample.ratio = s.resample;
    let mut mcl = Mcl::new(motion, sensor, FreeSpace::new(&log.map).unwrap(), params, Seed(seed)).unwrap();
    let sd = Vector3::new(0.5, 0.5, 15_f64.to_radians());
    mcl.initialize(&PoseBelief::around(log.reference[0], Matrix3::from_diagonal(&sd.component_mul(&sd)))).unwrap();
    let (mut n, mut sq, mut sqh, mut max, mut neff) = (0, 0.0, 0.0, 0.0_f64, 0.0);
    for i in 0..log.scans.len() {
        if i > 0 {
            mcl.predict(&OdometryIncrement::between(log.scans[i - 1].stamp(), &log.odometry[i - 1], log.scans[i].stamp(), &log.odometry[i]).unwrap()).unwrap();
        }
        if mcl.update(&log.scans[i]).unwrap() == UpdateOutcome::Applied {
            let e = mcl.estimate().map_from_base;
            let r: Se2 = log.reference[i];
            let d = (e.translation() - r.translation()).norm();
            n += 1;
            sq += d * d;
            if n > 20 {max = max.max(d);}
            sqh += angle_difference(e.yaw(), r.yaw()).powi(2);
            neff += mcl.diagnostics().weights.effective_sample_size / s.particles as f64;
        }
    }
    (n, (sq / n as f64).sqrt(), (sqh / n as f64).sqrt().to_degrees(), max, neff / n as f64)
}

#[test]
fn scratch() {
    let log = intel_log().unwrap();
    let base = Setting { form: ScanForm::Product { tempering: 1.0 }, alpha: 0.2, particles: 500, sigma: 0.2, resample: 0.5, zr: 0.5, rm: 30.0 };
    let t = |t| ScanForm::Product { tempering: t };
    for s in [
        Setting { form: ScanForm::SumOfCubes, ..base },
        base,
        Setting { alpha: 0.05, ..base },
        Setting { form: t(0.3), ..base },
        Setting { form: t(0.1), ..base },
        Setting { sigma: 0.1, ..base },
        Setting { sigma: 0.05, ..base },
        Setting { sigma: 0.1, form: t(0.3), ..base },
        Setting { sigma: 0.05, form: t(0.3), ..base },
        Setting { sigma: 0.1, form: t(0.1), ..base },
        Setting { sigma: 0.05, form: t(0.1), ..base },
        Setting { sigma: 0.05, form: t(0.3), alpha: 0.05, ..base },
        Setting { resample: 1.0, ..base },
        Setting { particles: 2000, ..base },
    ] {
        let start = std::time::Instant::now();
        for seed in 0..2 {
            println!("{s:?} {:?} {:?}", track(&log, s, seed), start.elapsed());
        }
    }
}
