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

/// Bends bands; keeps its memory. The time of a step is proportional to the number of poses.
#[derive(Debug, Clone, Default)]
pub struct BandSolver {
    matrix: BandedMatrix,
    factor: BandedCholesky,
    gradient: Vec<f64>,
    step: Vec<f64>,
    trial: Band,
    /// Equations of the last band while those of a trial are in their place.
    kept: (BandedMatrix, Vec<f64>),
    times: Vec<f64>,
    nearest: Vec<usize>,
}

/// Shortest interval, in seconds: the time between two poses neither vanishes nor runs backwards.
const SHORTEST: f64 = 0.01;
/// Farthest that a step moves any unknown, in metres, radians or seconds.
const FARTHEST: f64 = 0.5;
/// Share of the cost by which a step must lower it, else the band is as good as it gets.
const LEAST_GAIN: f64 = 5e-3;
/// Damping at which no step leads downhill any more.
const MOST_DAMPING: f64 = 1e8;

impl BandSolver {
    /// Moves all but the ends of a band downhill, with at most `max_iterations` steps.
    pub(super) fn solve(&mut self, problem: &Problem<'_>, band: &mut Band, max_iterations: usize) -> BandReport {
        let mut report = BandReport::default();
        if band.len() < 2 {
            return report;
        }
        self.prepare(problem, band);
        let mut cost = self.linearize(problem, band);
        report.cost[0] = cost;
        let mut damping = 1e-2;
        while report.iterations < max_iterations && damping < MOST_DAMPING {
            report.iterations += 1;
            self.step.clear();
            self.step.extend(self.gradient.iter().map(|g| -g));
            let solved = self.factor.factor_damped(&self.matrix, damping).is_ok();
            if !solved || self.factor.solve(&mut self.step).is_err() || self.step.iter().any(|s| !s.is_finite()) {
                damping *= 10.0;
                continue;
            }
            self.take_step(band);
            // Most steps are taken, so that their equations are needed next.
            std::mem::swap(&mut self.matrix, &mut self.kept.0);
            std::mem::swap(&mut self.gradient, &mut self.kept.1);
            let trial = std::mem::take(&mut self.trial);
            let next = self.linearize(problem, &trial);
            self.trial = trial;
            if next < cost {
                std::mem::swap(band, &mut self.trial);
                damping = (0.2 * damping).max(1e-6);
                let gain = cost - next;
                cost = next;
                if gain < LEAST_GAIN * next {
                    report.converged = true;
                    break;
                }
            } else {
                std::mem::swap(&mut self.matrix, &mut self.kept.0);
                std::mem::swap(&mut self.gradient, &mut self.kept.1);
                damping *= 8.0;
            }
        }
        report.cost[1] = cost;
        report
    }

    /// Cost and normal equations of a band.
    fn linearize(&mut self, problem: &Problem<'_>, band: &Band) -> f64 {
        let Self { times, nearest, matrix, gradient, .. } = self;
        problem.linearize(band, &Stages { times, nearest }, matrix, gradient)
    }

    /// What is taken as given in a solution: times, and which pose is nearest to a point to pass.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::teb::{TebParams, edges::Circle};
    use agv_core::{
        geometry::{Se2, Twist2},
        grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams, cost},
        kinematics::{MotionLimits, TwistLimits},
    };
    use nalgebra::Vector2;

    /// A straight band of poses a spacing apart, far too slow.
    fn straight() -> Band {
        let mut band = Band::new();
        for i in 0..20 {
            band.push(Vector2::new(1.0 + 0.15 * f64::from(i), 2.0), 0.0, 0.5);
        }
        band
    }

    fn solve(obstacle: Option<Cell>, via: &[Vector2<f64>]) -> (Band, BandReport) {
        let start = Twist2::new(1.0, 0.0, 0.0);
        solve_from(start, &MotionLimits::default(), obstacle.as_slice(), via)
    }

    fn solve_from(
        start: Twist2,
        limits: &MotionLimits,
        obstacles: &[Cell],
        via: &[Vector2<f64>],
    ) -> (Band, BandReport) {
        let layout = GridLayout::new(100, 80, 0.05, Se2::default()).unwrap();
        let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        for cell in obstacles {
            costmap.set(*cell, cost::LETHAL);
        }
        let map = LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
        let params = TebParams::for_footprint(Footprint::circle(0.2).unwrap());
        let problem = Problem {
            params: &params,
            limits,
            map: &map,
            circles: &[Circle { center: Vector2::zeros(), radius: 0.2 }],
            obstacles: &[],
            gear: 1.0,
            start,
            stops: false,
            goal_heading: true,
            via,
            rotation: 0.0,
        };
        let mut band = straight();
        let report = BandSolver::default().solve(&problem, &mut band, 100);
        (band, report)
    }

    #[test]
    fn a_free_band_is_driven_at_about_the_greatest_speed() {
        let (band, report) = solve(None, &[]);
        assert!(report.converged && report.cost[1] < 0.5 * report.cost[0], "{report:?}");
        assert_eq!((band.pose(0), band.pose(19)), (straight().pose(0), straight().pose(19)));
        let speed = band.length() / band.duration();
        assert!((0.8..1.2).contains(&speed), "{speed}");
        assert!((0..20).all(|i| (band.pose(i).unwrap().y() - 2.0).abs() < 1e-9));
    }

    /// Half a cell off its middle, so that it knows where to go.
    #[test]
    fn a_band_gives_way_to_a_post_and_bends_to_a_point() {
        let (band, _) = solve(Some(Cell::new(50, 39)), &[]);
        let post = Vector2::new(2.525, 1.975);
        let nearest = (0..20).map(|i| (band.pose(i).unwrap().translation() - post).norm()).fold(9.0, f64::min);
        assert!(nearest > 0.2 + 0.025, "{nearest}");
        let (pulled, _) = solve(None, &[Vector2::new(2.5, 2.4)]);
        assert!((0..20).any(|i| pulled.pose(i).unwrap().y() > 2.005));
    }

    /// A vehicle that drives sideways goes on as it does, within what it can change; so does one ahead.
    #[test]
    fn bands_begin_with_the_vehicles_velocity() {
        let twist = TwistLimits { lateral_speed: 1.0, ..TwistLimits::default() };
        for vy in [0.0, 0.6, -0.6] {
            let (band, _) = solve_from(Twist2::new(0.5, vy, 0.0), &twist.into(), &[], &[]);
            let (a, b) = (band.pose(0).unwrap(), band.pose(1).unwrap());
            let begin = (b.translation() - a.translation()) / band.interval(0).unwrap();
            let change = Vector2::new(begin.x - 0.5, begin.y - vy) / (0.5 * band.interval(0).unwrap());
            // Limits are soft, and the goal ahead draws.
            let most = 2.0 * twist.acceleration.max(twist.deceleration);
            assert!(change.x.abs() < most && change.y.abs() < most, "{vy}: {begin} {change}");
            assert!(vy == 0.0 || begin.y * vy > 0.0, "{vy}: {begin}");
        }
    }

    /// Beside a wall at half of the clearance from which on it drives freely.
    #[test]
    fn near_obstacles_bands_are_slower() {
        let limits = TwistLimits { forward_speed: 2.0, acceleration: 9.0, deceleration: 9.0, ..TwistLimits::default() };
        let start = Twist2::new(1.5, 0.0, 0.0);
        let (free, _) = solve_from(start, &limits.into(), &[], &[]);
        let wall: Vec<_> =
            [32, 47].iter().flat_map(|&row| (0..100).map(move |column| Cell::new(column, row))).collect();
        let (narrow, _) = solve_from(start, &limits.into(), &wall, &[]);
        let speed = |band: &Band| 0.15 / band.interval(10).unwrap();
        // Half a metre per second at no clearance, two at 0.3 m, and 0.15 m of it here.
        assert!(speed(&free) > 1.7 && (1.0..1.5).contains(&speed(&narrow)), "{} {}", speed(&free), speed(&narrow));
    }
}
