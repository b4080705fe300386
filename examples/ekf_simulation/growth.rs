//! Paper 001, Eq. 9: the test of van der Merwe, Doucet, de Freitas and Wan (*The unscented particle filter*, 2000).
//!
//! ```text
//! x_k = 1 + sin(0.04 π k) + 0.5 x_(k-1) + v,  v ~ Gamma(3, 2)
//! y_k = 0.2 x_k² + n  up to k = 30,  0.5 x_k - 2 + n  after,   n ~ N(0, 1e-5)
//! ```
//!
//! `Gamma(3, 2)` has a scale of 2 or, as a rate, of a half: both readings. The Gaussian filters are told its mean `3 s` and its
//! variance `3 s²`. With a state that is never negative the square has one root, but readings of 3 mm make a particle of a
//! hundred explain anything.

use crate::{Result, mean_and_error};
use agv_nav::{
    core::compute::Stream,
    filters::kalman::{
        BootstrapFilter, Ekf, Gate, GaussianBelief, IterationParams, MeasurementModel, ProcessModel, Ukf, UkfParams,
    },
    nalgebra::{Matrix1, Vector1},
    prelude::*,
};
use agv_support::{
    cli::Report,
    plot::{Color, TimeSeries},
};
use rand_distr::{Distribution, Gamma, StandardNormal};
use std::{f64::consts::PI, path::Path};

/// Steps of the original; the paper runs 1000.
const STEPS: [u32; 2] = [60, 1000];
const READING_VARIANCE: f64 = 1e-5;

/// The process; its control is the number of the step.
struct Growth {
    scale: f64,
    gamma: Gamma<f64>,
}

impl Growth {
    fn new(scale: f64) -> Result<Self> {
        Ok(Self { scale, gamma: Gamma::new(3.0, scale)? })
    }

    fn without_noise(x: f64, k: u32) -> f64 {
        1.0 + (0.04 * PI * f64::from(k)).sin() + 0.5 * x
    }
}

impl ProcessModel<Vector1<f64>, 1> for Growth {
    type Control = u32;

    fn transition(&self, x: &Vector1<f64>, k: &u32, _: f64) -> Vector1<f64> {
        Vector1::new(Self::without_noise(x[0], *k) + 3.0 * self.scale)
    }

    fn jacobian(&self, _: &Vector1<f64>, _: &u32, _: f64) -> Matrix1<f64> {
        Matrix1::new(0.5)
    }

    fn noise(&self, _: &Vector1<f64>, _: &u32, _: f64) -> Matrix1<f64> {
        Matrix1::new(3.0 * self.scale * self.scale)
    }

    fn sample(&self, x: &Vector1<f64>, k: &u32, _: f64, stream: &mut Stream) -> Vector1<f64> {
        Vector1::new(Self::without_noise(x[0], *k) + self.gamma.sample(stream))
    }
}

/// The sensor at a step.
struct Reader {
    squares: bool,
}

impl MeasurementModel<Vector1<f64>, 1, 1> for Reader {
    type Value = f64;

    fn predict(&self, x: &Vector1<f64>) -> f64 {
        if self.squares { 0.2 * x[0] * x[0] } else { 0.5 * x[0] - 2.0 }
    }

    fn jacobian(&self, x: &Vector1<f64>) -> Matrix1<f64> {
        Matrix1::new(if self.squares { 0.4 * x[0] } else { 0.5 })
    }

    fn noise(&self, _: &Vector1<f64>) -> Matrix1<f64> {
        Matrix1::new(READING_VARIANCE)
    }

    fn residual(&self, measured: &f64, expected: &f64) -> Vector1<f64> {
        Vector1::new(measured - expected)
    }
}

/// Who estimates.
const FILTERS: [&str; 6] = ["bootstrap_200", "bootstrap_1000", "ekf", "iekf", "ukf", "reading_inverted"];

/// States of a run, true and by each filter.
struct Track {
    truth: Vec<f64>,
    found: [Vec<f64>; FILTERS.len()],
}

fn run(model: &Growth, steps: u32, seed: Seed) -> Result<Track> {
    let mut stream = seed.stream(0, 0);
    let start = GaussianBelief::new(Vector1::new(1.0), Matrix1::new(1e-4))?;
    let mut truth = *start.state();
    let mut few = BootstrapFilter::around(&start, 200, seed.derive(1))?;
    let mut many = BootstrapFilter::around(&start, 1000, seed.derive(2))?;
    let mut ekf = Ekf::from(start);
    let mut iekf = Ekf::from(start);
    // As in the original: α = 1, β = 0, κ = 2.
    let mut ukf = Ukf::new(*start.state(), *start.covariance(), &UkfParams { alpha: 1.0, beta: 0.0, kappa: 2.0 })?;
    let mut track = Track { truth: Vec::new(), found: Default::default() };
    for k in 1..=steps {
        truth = model.sample(&truth, &k, 1.0, &mut stream);
        let reader = Reader { squares: k <= 30 };
        let noise: f64 = StandardNormal.sample(&mut stream);
        let seen = reader.predict(&truth) + READING_VARIANCE.sqrt() * noise;
        let inverted = if reader.squares { (5.0 * seen.max(0.0)).sqrt() } else { 2.0 * (seen + 2.0) };
        for filter in [&mut few, &mut many] {
            filter.predict(model, &k, 1.0)?;
            filter.update(&reader, &seen)?;
        }
        ekf.predict(model, &k, 1.0)?;
        ekf.update(&reader, &seen, &Gate::OPEN)?;
        iekf.predict(model, &k, 1.0)?;
        iekf.update_iterated(&reader, &seen, &Gate::OPEN, &IterationParams { max_iterations: 50, tolerance: 1e-6 })?;
        ukf.predict(model, &k, 1.0)?;
        ukf.update(&reader, &seen, &Gate::OPEN)?;
        let found = [
            few.estimate()?.state()[0],
            many.estimate()?.state()[0],
            ekf.state()[0],
            iekf.state()[0],
            ukf.state()[0],
            inverted,
        ];
        track.truth.push(truth[0]);
        track.found.iter_mut().zip(found).for_each(|(track, value)| track.push(value));
    }
    Ok(track)
}

/// Both readings of Gamma, over both lengths.
pub(crate) fn experiment(seeds: &[Seed], out: &Path) -> Result<Vec<Report>> {
    let mut reports = Vec::new();
    for (reading, scale) in [("rate", 0.5), ("scale", 2.0)] {
        let model = Growth::new(scale)?;
        for steps in STEPS {
            let tracks = seeds.iter().map(|&seed| run(&model, steps, seed)).collect::<Result<Vec<_>>>()?;
            let mut report = Report::new("Growth of Eq. 9");
            report.text("gamma", format!("{reading} 2")).count("steps", steps as usize);
            for (index, name) in FILTERS.iter().enumerate() {
                let errors: Vec<f64> =
                    tracks.iter().map(|track| mean_square(&track.truth, &track.found[index])).collect();
                report.number(&format!("mse_{name}"), mean_and_error(&errors).0);
            }
            reports.push(report);
            if let (Some(track), 60) = (tracks.first(), steps) {
                draw(track, reading, out)?;
            }
        }
    }
    Ok(reports)
}

fn mean_square(truth: &[f64], found: &[f64]) -> f64 {
    truth.iter().zip(found).map(|(truth, found)| (truth - found).powi(2)).sum::<f64>() / truth.len() as f64
}

fn draw(track: &Track, reading: &str, out: &Path) -> Result<()> {
    // The states themselves lie on one another.
    let errors = |found: &[f64]| {
        let errors = (1..).zip(track.truth.iter().zip(found)).map(|(k, (truth, found))| (f64::from(k), found - truth));
        errors.collect::<Vec<_>>()
    };
    TimeSeries::new(format!("Errors in Eq. 9, Gamma(3, 2) as a {reading}"), "step", "estimate less state")
        .curve("200 particles", Color::Green, errors(&track.found[0]))
        .curve("extended", Color::Blue, errors(&track.found[2]))
        .curve("unscented", Color::Orange, errors(&track.found[4]))
        .write(out.join(format!("growth_{reading}.svg")))?;
    Ok(())
}
