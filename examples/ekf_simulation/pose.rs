//! Paper 000, Eqs. 15 and 16: a vehicle at 0.1 m/s and 0.1 rad/s, 600 steps of 0.1 s.
//!
//! ```text
//! c' = c + U + w        U = (v cos θ, v sin θ, ω) dt        o = c' + R n,  R = diag(0.25 m, 0.25 m, 0.007 rad)
//! ```
//!
//! `w` is `√0.001 randn` per step as printed, or that times `dt`: noise of the velocities. Each component is nearly a random
//! walk of variance q that is read with variance r, whose filter settles at the positive root of `P² + q P - q r = 0`.

use crate::{Result, mean_and_error};
use agv_nav::{
    core::metrics::chi_square_quantile,
    filters::kalman::{Ekf, Gate, Manifold, PlanarPose, PlanarState, PoseReading, ProcessModel},
    nalgebra::{Matrix3, Vector2, Vector3},
    prelude::*,
};
use agv_support::{
    cli::Report,
    plot::{Color, Scene, TimeSeries},
};
use rand_distr::{Distribution, StandardNormal};
use std::path::Path;

const DT: f64 = 0.1;
const STEPS: usize = 600;
const SPEED: f64 = 0.1;
const YAW_RATE: f64 = 0.1;
/// Standard deviations of a reading: R of Eq. 15, which multiplies unit noise.
const READING: [f64; 3] = [0.25, 0.25, 0.007];

/// Eq. 16 with its missing `dt`, and the Jacobian of Eq. 18; the noise has the same variance on all three components.
struct Eq16 {
    variance: f64,
}

impl ProcessModel<PlanarPose, 3> for Eq16 {
    type Control = ();

    fn transition(&self, pose: &PlanarPose, (): &(), dt: f64) -> PlanarPose {
        let (sin, cos) = pose[2].sin_cos();
        pose.boxplus(&(Vector3::new(SPEED * cos, SPEED * sin, YAW_RATE) * dt))
    }

    fn jacobian(&self, pose: &PlanarPose, (): &(), dt: f64) -> Matrix3<f64> {
        let (sin, cos) = pose[2].sin_cos();
        Matrix3::new(1.0, 0.0, -SPEED * sin * dt, 0.0, 1.0, SPEED * cos * dt, 0.0, 0.0, 1.0)
    }

    fn noise(&self, _: &PlanarPose, (): &(), _: f64) -> Matrix3<f64> {
        Matrix3::identity() * self.variance
    }
}

/// What one run shows: its means over all steps.
struct Run {
    /// Mean squares of the errors along x and y and of the heading.
    squares: [f64; 3],
    /// Mean absolute errors of the same.
    absolute: [f64; 3],
    distance: f64,
    nees: f64,
    nees_at_end: f64,
    nis: f64,
}

fn draw(stream: &mut agv_nav::core::compute::Stream) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(stream))
}

/// The poses of a run: true and estimated.
type Track = Vec<(Se2, Se2)>;

/// One run that starts in the steady state, its first error drawn from the covariance.
fn run(model: &Eq16, settled: &Matrix3<f64>, seed: Seed) -> Result<(Run, Track)> {
    let mut stream = seed.stream(0, 0);
    let sensor = PoseReading::new(Matrix3::from_diagonal(&Vector3::from(READING).map(|sigma| sigma * sigma)))?;
    let start = PlanarPose::from(Vector3::zeros());
    let mut ekf = Ekf::new(start, *settled)?;
    let root = settled.cholesky().ok_or("the settled covariance is not definite")?.l();
    let mut truth = start.boxplus(&(root * draw(&mut stream)));
    let mut sums = Run { squares: [0.0; 3], absolute: [0.0; 3], distance: 0.0, nees: 0.0, nees_at_end: 0.0, nis: 0.0 };
    let (share, mut track) = (1.0 / STEPS as f64, Vec::with_capacity(STEPS));
    for _ in 0..STEPS {
        truth = model.sample(&truth, &(), DT, &mut stream);
        let noise = draw(&mut stream).component_mul(&Vector3::from(READING));
        let seen = truth.boxplus(&noise);
        ekf.predict(model, &(), DT)?;
        let correction = ekf.update(&sensor, &seen, &Gate::OPEN)?;
        let error = truth.boxminus(ekf.state());
        for (axis, value) in error.iter().enumerate() {
            sums.squares[axis] += value * value * share;
            sums.absolute[axis] += value.abs() * share;
        }
        sums.distance += error.xy().norm() * share;
        sums.nees_at_end = ekf.belief().nees(&truth)?;
        sums.nees += sums.nees_at_end * share;
        sums.nis += correction.innovation.nis * share;
        track.push((truth.pose(), ekf.state().pose()));
    }
    Ok((sums, track))
}

/// The filter's covariance after an update, once it no longer changes.
fn settled(model: &Eq16) -> Result<Matrix3<f64>> {
    let sensor = PoseReading::new(Matrix3::from_diagonal(&Vector3::from(READING).map(|sigma| sigma * sigma)))?;
    let mut ekf = Ekf::new(PlanarPose::from(Vector3::zeros()), Matrix3::identity() * 0.01)?;
    for _ in 0..20_000 {
        ekf.predict(model, &(), DT)?;
        let expected = *ekf.state();
        ekf.update(&sensor, &expected, &Gate::OPEN)?;
    }
    Ok(*ekf.covariance())
}

/// Both readings of the noise.
pub(crate) fn experiment(seeds: &[Seed], out: &Path) -> Result<Vec<Report>> {
    let mut reports = Vec::new();
    for (reading, variance) in [("per step", 1e-3), ("times dt", 1e-3 * DT * DT)] {
        let model = Eq16 { variance };
        let settled = settled(&model)?;
        let runs = seeds.iter().map(|&seed| run(&model, &settled, seed)).collect::<Result<Vec<_>>>()?;
        reports.push(report(reading, variance, &runs.iter().map(|(run, _)| run).collect::<Vec<_>>())?);
        if let Some((_, track)) = runs.first() {
            draw_run(reading, track, out)?;
        }
    }
    Ok(reports)
}

fn report(reading: &str, variance: f64, runs: &[&Run]) -> Result<Report> {
    let riccati = |r: f64| 0.5 * variance * ((1.0 + 4.0 * r * r / variance).sqrt() - 1.0);
    let of = |value: &dyn Fn(&Run) -> f64| mean_and_error(&runs.iter().map(|run| value(run)).collect::<Vec<_>>());
    let along_axes = of(&|run| 0.5 * (run.squares[0] + run.squares[1]));
    let heading = of(&|run| run.squares[2]);
    let expected = [riccati(READING[0]), riccati(READING[2])];
    let degrees = 3.0 * runs.len() as f64;
    let band =
        [chi_square_quantile(degrees, 0.025)?, chi_square_quantile(degrees, 0.975)?].map(|v| v / runs.len() as f64);
    let at_end = of(&|run| run.nees_at_end).0;
    let absolute = of(&|run| 0.5 * (run.absolute[0] + run.absolute[1])).0;
    let mut report = Report::new("Pose of Eqs. 15 and 16");
    report
        .text("noise", reading)
        .number("riccati_sigma_m", expected[0].sqrt())
        .number("rmse_per_axis_m", along_axes.0.sqrt())
        .number("off_by_standard_errors_position", (along_axes.0 - expected[0]) / along_axes.1)
        .number("riccati_sigma_rad", expected[1].sqrt())
        .number("rmse_heading_rad", heading.0.sqrt())
        .number("off_by_standard_errors_heading", (heading.0 - expected[1]) / heading.1)
        .number("mean_error_per_axis_m", absolute)
        .number("mean_distance_m", of(&|run| run.distance).0)
        .number("mean_heading_error_rad", of(&|run| run.absolute[2]).0)
        .number("runs_within_paper_position", share(runs, |run| 0.5 * (run.absolute[0] + run.absolute[1]) <= 0.025))
        .number("runs_within_paper_heading", share(runs, |run| run.absolute[2] <= 0.0035))
        .number("nees_mean", of(&|run| run.nees).0)
        .number("nees_at_end_mean", at_end)
        .numbers("nees_band_95", &band)
        .flag("nees_in_band", at_end > band[0] && at_end < band[1])
        .number("nis_mean", of(&|run| run.nis).0);
    Ok(report)
}

fn share(runs: &[&Run], holds: impl Fn(&Run) -> bool) -> f64 {
    runs.iter().filter(|run| holds(run)).count() as f64 / runs.len() as f64
}

/// The paper's pictures of one run: from above, and the errors over time.
fn draw_run(reading: &str, track: &Track, out: &Path) -> Result<()> {
    let name = reading.replace(' ', "_");
    Scene::new(format!("Eqs. 15 and 16, noise {reading}"))
        .trajectory("truth", Color::Black, track.iter().map(|(truth, _)| truth))
        .trajectory("extended filter", Color::Blue, track.iter().map(|(_, estimate)| estimate))
        .write(out.join(format!("pose_{name}.svg")))?;
    let errors = || {
        track.iter().enumerate().map(|(i, (truth, found))| {
            let distance: Vector2<f64> = truth.translation() - found.translation();
            (i as f64 * DT, distance.norm(), found.between(truth).yaw().abs())
        })
    };
    TimeSeries::new(format!("Errors, noise {reading}"), "time, s", "error, m or rad")
        .curve("position", Color::Blue, errors().map(|(t, position, _)| (t, position)))
        .curve("heading", Color::Orange, errors().map(|(t, _, heading)| (t, heading)))
        .write(out.join(format!("pose_{name}_errors.svg")))?;
    Ok(())
}
