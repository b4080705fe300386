//! Features against a map of features: rounds of matching and of improving the pose, coarse to fine.

use super::mapping::{LocalMap, PlacedFeatures};
use super::objective::{Match, MatchFit, MatchObjective, Selection, associate, choose};
use super::params::{LoamParams, LoamSolve};
use crate::odometry::Tracked;
use crate::registration::{Descent, Freedom, Objective, Optimizer};
use agv_core::{
    compute::Par,
    geometry::{LieGroup, Se3, observed_information},
    roles::{Alignment, Termination},
};
use nalgebra::Matrix6;

/// Surfaces that take part on coarse levels.
const COARSE_SURFACES: usize = 800;

/// Rounds on each coarse level.
const COARSE_ROUNDS: usize = 4;

/// Fewest matches of a step.
pub(super) const FEWEST: usize = 10;

/// Least share of the features that lie where the map has them.
const LEAST: f64 = 0.1;

/// Agreement below which a result may be a false optimum, though it is taken if nothing better is found.
const SUSPICIOUS: f64 = 0.85;

/// Owner of the matches.
#[derive(Debug, Clone)]
pub(super) struct Aligner {
    params: LoamParams,
    par: Par,
    matches: Vec<Match>,
}

impl Aligner {
    pub(super) const fn new(params: LoamParams) -> Self {
        Self { params, par: Par::Seq, matches: Vec::new() }
    }

    pub(super) const fn spread_over(&mut self, par: Par) {
        self.par = par;
    }

    /// The pose of `features` in `map` near `guess`, which is `sigma` metres off or so, by one solve after the other.
    pub(super) fn align(
        &mut self,
        features: &PlacedFeatures,
        map: &LocalMap,
        guess: &Se3,
        sigma: f64,
        solves: &[LoamSolve],
    ) -> Tracked {
        // The coarsest level that is needed is the first to reach three sigma.
        let reach = 3.0 * sigma;
        let coarsest =
            (0..LocalMap::COARSEST).find(|&level| map.level(level).reach() >= reach).unwrap_or(LocalMap::COARSEST);
        let (mut pose, mut iterations) = self.approach(features, map, guess, coarsest);
        choose(features, self.params.max_surfaces, self.params.max_edges, &mut self.matches);
        // In places that are more clutter than surface the coarse levels may lead away from a good guess.
        if coarsest > 0 && self.inliers(guess, map) >= self.inliers(&pose, map) {
            pose = *guess;
        }
        let all = Matrix6::identity();
        let (first, others) = solves.split_first().unwrap_or((&LoamSolve::Joint, &[]));
        let mut found = self.rounds(&pose, map, *first, &all);
        iterations += found.iterations;
        for solve in others {
            // What the solve before has made no better is not where to begin.
            let start = if self.inliers(&pose, map) >= self.inliers(&found.pose, map) { pose } else { found.pose };
            found = self.rounds(&start, map, *solve, &all);
            iterations += found.iterations;
        }
        let mut fit = self.fit(&found.pose);
        let held = fit.unobserved;
        if held.trace() > 0.5 {
            // What is known of the pose is kept, and the guess's place along the rest (Zhang, Kaess and Singh 2016).
            let start = found.pose.plus(&(held * guess.minus(&found.pose)));
            found = self.rounds(&start, map, LoamSolve::Joint, &(all - held));
            iterations += found.iterations;
            fit = MatchFit { unobserved: held, ..self.fit(&found.pose) };
        }
        found.iterations = iterations;
        let alignment = self.conclude(&found, &fit, guess);
        let is_usable = alignment.converged();
        Tracked { alignment, is_usable, is_clear: is_usable && fit.agreement >= SUSPICIOUS }
    }

    /// Through the coarse levels by surfaces; the pose, and the iterations that it took.
    fn approach(&mut self, features: &PlacedFeatures, map: &LocalMap, guess: &Se3, coarsest: usize) -> (Se3, usize) {
        let (mut pose, mut iterations) = (*guess, 0);
        for level in (1..=coarsest).rev() {
            choose(features, COARSE_SURFACES, 0, &mut self.matches);
            let spacing = map.level(level).spacing();
            for round in 0..COARSE_ROUNDS {
                associate(&mut self.matches, map, level, &pose, self.par);
                let kernel = (0.5 * spacing / f64::from(1_u32 << round.min(2))).max(self.params.kernel);
                let found = self.improve(&pose, Selection::All, kernel, &Matrix6::identity());
                iterations += found.iterations;
                let step = pose.minus(&found.pose);
                pose = found.pose;
                if step.norm() < 0.02 * spacing {
                    break;
                }
            }
        }
        (pose, iterations)
    }

    /// Rounds on the finest level, until the pose is at rest.
    fn rounds(&mut self, start: &Se3, map: &LocalMap, solve: LoamSolve, keep: &Matrix6<f64>) -> Descent {
        let (params, reach) = (self.params, map.level(0).reach());
        let (mut pose, mut iterations, mut round) = (*start, 0, 0);
        loop {
            associate(&mut self.matches, map, 0, &pose, self.par);
            let kernel = (0.4 * reach / f64::from(1_u32 << round.min(8))).max(params.kernel);
            let mut found = match solve {
                LoamSolve::Joint => self.improve(&pose, Selection::All, kernel, keep),
                LoamSolve::TwoStep => self.two_steps(&pose, kernel),
            };
            iterations += found.iterations;
            found.iterations = iterations;
            let step = found.pose.minus(&pose);
            pose = found.pose;
            if matches!(found.termination, Termination::TooFewPoints | Termination::Degenerate) {
                return found;
            }
            let (line, turn) = (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm());
            let within = |times: f64| {
                line <= times * params.descent.translation_tolerance
                    && turn <= times * params.descent.rotation_tolerance
            };
            round += 1;
            if (within(2.0) && kernel <= params.kernel) || round >= params.max_rounds {
                // That a few matches change to the end is no reason to distrust a pose that hardly moves.
                found.termination = if within(20.0) { Termination::Converged } else { Termination::IterationLimit };
                return found;
            }
        }
    }

    /// Height, roll and pitch by what is level; then x, y and yaw by edges.
    fn two_steps(&self, pose: &Se3, kernel: f64) -> Descent {
        let enough = |selection| {
            let count = self.objective(selection, kernel).count();
            if count >= FEWEST { selection } else { Selection::All }
        };
        let vertical = Matrix6::identity() - Freedom::Planar.projector(pose);
        let upright = self.improve(pose, enough(Selection::Level), kernel, &vertical);
        // A pose that is not upright would be taken for one that is.
        if matches!(upright.termination, Termination::TooFewPoints | Termination::Degenerate) {
            return upright;
        }
        let planar = Freedom::Planar.projector(&upright.pose);
        let found = self.improve(&upright.pose, enough(Selection::Edges), kernel, &planar);
        Descent { iterations: upright.iterations + found.iterations, ..found }
    }

    fn improve(&self, pose: &Se3, selection: Selection, kernel: f64, keep: &Matrix6<f64>) -> Descent {
        let mut objective = self.objective(selection, kernel);
        Optimizer::TrustRegion.minimize(&mut objective, &self.params.descent, pose, keep)
    }

    const fn objective(&self, selection: Selection, kernel: f64) -> MatchObjective<'_> {
        MatchObjective { matches: self.matches.as_slice(), selection, kernel, par: self.par }
    }

    fn fit(&self, pose: &Se3) -> MatchFit {
        let LoamParams { kernel, inlier_distance, min_facing_share, .. } = self.params;
        self.objective(Selection::All, kernel).fit(pose, inlier_distance, min_facing_share)
    }

    /// Features that lie where the finest level has them.
    fn inliers(&mut self, pose: &Se3, map: &LocalMap) -> usize {
        associate(&mut self.matches, map, 0, pose, self.par);
        self.objective(Selection::All, self.params.kernel).inliers(pose, self.params.inlier_distance)
    }

    fn conclude(&self, found: &Descent, fit: &MatchFit, guess: &Se3) -> Alignment<Se3> {
        let params = &self.params;
        let quadratic = self.objective(Selection::All, params.kernel).evaluate(&found.pose);
        if quadratic.matches < FEWEST || !found.pose.is_finite() {
            let mut lost = Alignment::unknown(*guess, Termination::TooFewPoints);
            lost.iterations = found.iterations;
            return lost;
        }
        let mut result = Alignment::unknown(found.pose, found.termination);
        let poor = fit.agreement < params.min_agreement || fit.inlier_ratio < LEAST;
        if poor && matches!(found.termination, Termination::Converged | Termination::Degenerate) {
            result.termination = Termination::PoorFit;
        }
        result.iterations = found.iterations;
        result.unobserved = fit.unobserved;
        // Distances as the matches have them, but no better than a millimetre.
        let information = quadratic.hessian / fit.variance.max(1e-6);
        result.information = observed_information::<Se3>(&information, &fit.unobserved);
        result.inlier_ratio = fit.inlier_ratio;
        result.score = -quadratic.cost / quadratic.matches as f64;
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// Walls, and a floor or none: without it nothing holds the height, however well the walls fix x, y and yaw.
    #[test]
    fn two_steps_do_not_converge_where_the_first_does_not() {
        let mut aligner = Aligner::new(LoamParams::default());
        let at = |i: u32| (f64::from(i % 5) - 2.0, f64::from(i / 5) - 2.0);
        let sheet = |along: fn(f64, f64) -> Vector3<f64>, normal: Vector3<f64>| {
            (0..25).map(at).map(move |(a, b)| Match::on_plane(along(a, b), normal))
        };
        let walls = sheet(|a, b| Vector3::new(4.0, a, b), Vector3::x());
        aligner.matches = walls.chain(sheet(|a, b| Vector3::new(a, -3.0, b), Vector3::y())).collect();
        let start = Se3::exp(&nalgebra::Vector6::new(0.02, 0.01, 0.0, 0.0, 0.0, 0.01));
        let planar = aligner.improve(&start, Selection::All, 0.1, &Freedom::Planar.projector(&start));
        assert_eq!(planar.termination, Termination::Converged);
        assert_eq!(aligner.two_steps(&start, 0.1).termination, Termination::Degenerate);
        aligner.matches.extend(sheet(|a, b| Vector3::new(a, b, -1.0), Vector3::z()));
        let found = aligner.two_steps(&start, 0.1);
        assert_eq!(found.termination, Termination::Converged);
        assert!(found.pose.log().norm() < 1e-3, "{:?}", found.pose);
    }
}
