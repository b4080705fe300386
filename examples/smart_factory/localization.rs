//! Stage 2: laps at several speeds, localised in the map that was made and in one of true poses.

use crate::{Args, Result, drive, hall::Hall, mapping::Mapped};
use agv_nav::{
    core::{geometry::wrap_angle, metrics::Statistics},
    nalgebra::{Matrix6, Vector6},
    ndt::ndt::{NdtLocalizer, NdtLocalizerParams, NdtMap},
    prelude::{Correct as _, Localizer as _, PoseBelief, Se2, Se3, Seed, UpdateOutcome},
};
use agv_support::{cli::Report, progress::Progress, timing::Timings};

/// Errors at one speed.
pub(crate) struct Lap {
    pub(crate) speed: f64,
    /// True poses and times of the clouds of the first run.
    pub(crate) truths: Vec<Se2>,
    pub(crate) times: Vec<f64>,
    pub(crate) own: Errors,
    pub(crate) clean: Errors,
    /// Mean error of each run in the own map.
    pub(crate) runs: Vec<f64>,
    /// Where each run ended, with its error: x and y in metres, and the heading in radians.
    pub(crate) ends: Vec<[f64; 3]>,
}

/// Errors along the map's axes in metres, and of the heading in radians.
#[derive(Default)]
pub(crate) struct Errors {
    pub(crate) estimates: Vec<Se2>,
    pub(crate) x: Vec<f64>,
    pub(crate) y: Vec<f64>,
    pub(crate) heading: Vec<f64>,
    skipped: usize,
}

impl Errors {
    pub(crate) fn add(&mut self, estimate: &Se2, truth: &Se2) {
        self.estimates.push(*estimate);
        self.x.push((estimate.x() - truth.x()).abs());
        self.y.push((estimate.y() - truth.y()).abs());
        self.heading.push(wrap_angle(estimate.yaw() - truth.yaw()).abs());
    }

    pub(crate) fn distances(&self) -> impl Iterator<Item = f64> + '_ {
        self.x.iter().zip(&self.y).map(|(x, y)| x.hypot(*y))
    }
}

pub(crate) fn run(args: &Args, hall: &Hall, mapped: &Mapped, report: &mut Report) -> Result<Vec<Lap>> {
    let (mut laps, mut timings) = (Vec::new(), Timings::default());
    let progress = Progress::new(args.speeds.len() * args.runs as usize, "localising");
    for &speed in &args.speeds {
        let (own, clean) = (Errors::default(), Errors::default());
        let mut lap = Lap { speed, truths: vec![], times: vec![], own, clean, runs: vec![], ends: vec![] };
        for run in 0..args.runs {
            let seed = args.common.seed().derive(1000 + run);
            drive_lap(args, hall, mapped, seed, run == 0, &mut lap, &mut timings)?;
            progress.step();
        }
        laps.push(lap);
    }
    summarize(&laps, report)?;
    report.number("localize_ms_p50", timings.milliseconds(50.0)).number("localize_ms_p99", timings.milliseconds(99.0));
    Ok(laps)
}

fn localizer(map: &NdtMap, start: &Se2, args: &Args) -> Result<NdtLocalizer> {
    let mut localizer = NdtLocalizer::new(map, NdtLocalizerParams::default())?.with_parallelism(args.common.par());
    let sigma = Vector6::new(0.05, 0.05, 0.02, 0.01, 0.01, 0.02);
    let covariance = Matrix6::from_diagonal(&sigma.component_mul(&sigma));
    localizer.initialize(&PoseBelief::around(Se3::from(*start), covariance)?)?;
    Ok(localizer)
}

fn drive_lap(
    args: &Args,
    hall: &Hall,
    mapped: &Mapped,
    seed: Seed,
    first: bool,
    lap: &mut Lap,
    timings: &mut Timings,
) -> Result<()> {
    let start = hall.lap.points().first().ok_or("an empty lap")?.pose;
    // As somebody who parks it may have told.
    let told = start * Se2::new(0.04, -0.03, 0.01);
    let mut own = localizer(&mapped.site.map, &told, args)?;
    let mut clean = localizer(&mapped.true_map, &told, args)?;
    let (mut odometry, before) = (drive::odometry()?, lap.own.x.len());
    drive::along(args, hall.factory.world(), &hall.lap, lap.speed, seed, |seen| {
        if let Some(motion) = odometry.update(&seen.odometry, seen.imu_samples())? {
            own.predict(&motion)?;
            clean.predict(&motion)?;
        }
        for (cloud, _) in seen.clouds() {
            let truth = seen.truth.map_from_base;
            if first {
                lap.truths.push(truth);
                lap.times.push(seen.truth.stamp.seconds());
            }
            for (localizer, errors) in [(&mut own, &mut lap.own), (&mut clean, &mut lap.clean)] {
                let outcome = timings.time(|| localizer.update(cloud))?;
                errors.skipped += usize::from(matches!(outcome, UpdateOutcome::Skipped(_)));
                let estimate = localizer.estimate().ok_or("initialised above")?;
                errors.add(&estimate.map_from_base().to_planar(), &truth);
            }
        }
        Ok(())
    })?;
    let run: Vec<f64> = lap.own.distances().skip(before).collect();
    lap.runs.push(Statistics::new(run)?.mean());
    let last = |errors: &[f64]| errors.last().copied().ok_or("a lap without clouds");
    lap.ends.push([last(&lap.own.x)?, last(&lap.own.y)?, last(&lap.own.heading)?]);
    Ok(())
}

fn summarize(laps: &[Lap], report: &mut Report) -> Result<()> {
    let all = |of: fn(&Lap) -> &[f64]| Statistics::new(laps.iter().flat_map(|lap| of(lap).iter().copied()).collect());
    for (name, x, y, heading) in [
        ("localization", all(|lap| &lap.own.x)?, all(|lap| &lap.own.y)?, all(|lap| &lap.own.heading)?),
        ("true_map_localization", all(|lap| &lap.clean.x)?, all(|lap| &lap.clean.y)?, all(|lap| &lap.clean.heading)?),
    ] {
        report.number(&format!("{name}_x_mean_m"), x.mean()).number(&format!("{name}_x_max_m"), x.max());
        report.number(&format!("{name}_y_mean_m"), y.mean()).number(&format!("{name}_y_max_m"), y.max());
        report.number(&format!("{name}_heading_mean_deg"), heading.mean().to_degrees());
        report.number(&format!("{name}_heading_max_deg"), heading.max().to_degrees());
    }
    let per_lap = |of: &dyn Fn(&Lap) -> f64| laps.iter().map(of).collect::<Vec<_>>();
    let mean = |errors: &Errors| errors.distances().sum::<f64>() / errors.x.len().max(1) as f64;
    report.numbers("speeds_mps", &per_lap(&|lap| lap.speed));
    report.numbers("speed_error_mean_m", &per_lap(&|lap| mean(&lap.own)));
    report.numbers("speed_error_max_m", &per_lap(&|lap| lap.own.distances().fold(0.0, f64::max)));
    let spread = |lap: &Lap| {
        let (least, greatest) = lap.runs.iter().fold((f64::INFINITY, 0.0_f64), |(l, g), v| (l.min(*v), g.max(*v)));
        greatest - least
    };
    report.numbers("speed_run_spread_m", &per_lap(&spread));
    // As somebody with a tape measure would find them at the goal.
    for (part, name) in ["end_x_mean_m", "end_y_mean_m", "end_heading_mean_deg"].iter().enumerate() {
        let mean = |lap: &Lap| lap.ends.iter().map(|end| end[part]).sum::<f64>() / lap.ends.len().max(1) as f64;
        let unit = if part == 2 { 1_f64.to_degrees() } else { 1.0 };
        report.numbers(&format!("speed_{name}"), &per_lap(&|lap| unit * mean(lap)));
    }
    report.count("localization_skipped", laps.iter().map(|lap| lap.own.skipped + lap.clean.skipped).sum());
    Ok(())
}
