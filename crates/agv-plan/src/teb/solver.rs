//! Levenberg's and Marquardt's method on a band.

use super::{
    band::Band,
    problem::{Problem, Stages},
};
use agv_core::solve::{BandedCholesky, BandedMatrix};

/// How a band was optimised.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BandReport {
    /// Steps that were tried.
    pub iterations: usize,
    /// Half the sum of the squared residuals, before and after.
    pub cost: [f64; 2],
    /// Whether the last step changed too little to go on.
    pub converged: bool,
}

/// Bends bands; keeps its memory. Each step costs some microseconds per ten poses.
#[derive(Debug, Clone, Default)]
pub struct BandSolver {
    matrix: BandedMatrix,
    factor: BandedCholesky,
    gradient: Vec<f64>,
    step: Vec<f64>,
    trial: Band,
    times: Vec<f64>,
    nearest: Vec<usize>,
}

/// Shortest interval, in seconds: the time between two poses neither vanishes nor runs backwards.
const SHORTEST: f64 = 0.01;
/// Farthest that a step moves any unknown, in metres, radians or seconds.
const FARTHEST: f64 = 0.5;
/// Share of the cost by which a step must lower it, else the band is as good as it gets.
const LEAST_GAIN: f64 = 1e-3;

impl BandSolver {
    /// Moves all but the ends of a band downhill, with at most `max_iterations` steps.
    pub(super) fn solve(&mut self, problem: &Problem<'_>, band: &mut Band, max_iterations: usize) -> BandReport {
        let mut report = BandReport::default();
        if band.len() < 2 {
            return report;
        }
        let mut damping = 1e-2;
        let mut fresh = true;
        let mut cost = 0.0;
        while report.iterations < max_iterations {
            if fresh {
                self.prepare(problem, band);
                let state = Stages { times: &self.times, nearest: &self.nearest };
                cost = problem.linearize(band, &state, &mut self.matrix, &mut self.gradient);
                if report.iterations == 0 {
                    report.cost[0] = cost;
                }
                fresh = false;
            }
            report.iterations += 1;
            self.step.clear();
            self.step.extend(self.gradient.iter().map(|g| -g));
            let solved = self.factor.factor_damped(&self.matrix, damping).is_ok();
            if !solved || self.factor.solve(&mut self.step).is_err() || self.step.iter().any(|s| !s.is_finite()) {
                damping *= 10.0;
                continue;
            }
            self.take_step(band);
            let state = Stages { times: &self.times, nearest: &self.nearest };
            let next = problem.cost(&self.trial, &state);
            if next < cost {
                band.copy_from(&self.trial);
                damping = (0.2 * damping).max(1e-6);
                fresh = true;
                let gain = cost - next;
                cost = next;
                if gain < LEAST_GAIN * next {
                    report.converged = true;
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e8 {
                    report.converged = true;
                    break;
                }
            }
        }
        report.cost[1] = cost;
        report
    }

    /// What is taken as given in a step: times, and which pose is nearest to a point to pass.
    fn prepare(&mut self, problem: &Problem<'_>, band: &Band) {
        self.times.clear();
        let mut time = 0.0;
        for node in band.nodes() {
            self.times.push(time);
            time += node[3];
        }
        self.nearest.clear();
        for point in problem.via {
            let square = |node: &[f64; 4]| (node[0] - point.x).powi(2) + (node[1] - point.y).powi(2);
            let nearest = band.nodes().iter().map(square).enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
            self.nearest.push(nearest.map_or(0, |(i, _)| i));
        }
    }

    fn take_step(&mut self, band: &Band) {
        self.trial.copy_from(band);
        let longest = self.step.iter().fold(0.0_f64, |longest, s| longest.max(s.abs()));
        let scale = if longest > FARTHEST { FARTHEST / longest } else { 1.0 };
        for (value, step) in self.trial.unknowns_mut().iter_mut().zip(&self.step) {
            *value += scale * step;
        }
        for node in self.trial.nodes_mut() {
            node[3] = node[3].max(SHORTEST);
        }
    }
}
