//! Features against a map of features: rounds of matching and of improving the pose, coarse to fine.

use super::mapping::{LocalMap, PlacedFeatures};
use super::objective::{Match, MatchFit, MatchObjective, Selection, associate, choose};
use super::params::{LoamParams, LoamSolve};
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
const FEWEST: usize = 10;

/// Least share of the features that lie where the map has them.
const LEAST: f64 = 0.1;

/// Agreement below which a result may be a false optimum, though it is taken if nothing better is found.
const SUSPICIOUS: f64 = 0.85;

/// The pose of a cloud, and what became of its features.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aligned {
    pub(super) alignment: Alignment<Se3>,
    /// Share of the matched features that lie where the map has them.
    agreement: f64,
}

impl Aligned {
    /// Whether there is no reason to look any further.
    pub(super) fn is_clear(&self) -> bool {
        self.alignment.converged() && self.agreement >= SUSPICIOUS
    }

    /// Whether this explains more of the cloud than another result.
    pub(super) fn beats(&self, other: &Self) -> bool {
        let rank = |of: &Self| (of.alignment.converged(), of.alignment.inlier_ratio);
        rank(self) > rank(other)
    }
}

/// Owner of the matches.
#[derive(Debug, Clone, Default)]
pub(super) struct Aligner {
    matches: Vec<Match>,
}

impl Aligner {
    /// The pose of `features` in `map` near `guess`, which is `sigma` metres off or so.
    pub(super) fn align(
        &mut self,
        features: &PlacedFeatures,
        map: &LocalMap,
        guess: &Se3,
        sigma: f64,
        params: &LoamParams,
        solve: LoamSolve,
        par: Par,
    ) -> Aligned {
        let (mut pose, mut iterations) = (*guess, 0);
        // The coarsest level that is needed is the first to reach three sigma.
        let reach = 3.0 * sigma;
        let start =
            (0..LocalMap::COARSEST).find(|&level| map.level(level).reach() >= reach).unwrap_or(LocalMap::COARSEST);
        for level in (1..=start).rev() {
            choose(features, COARSE_SURFACES, 0, &mut self.matches);
            let spacing = map.level(level).spacing();
            for round in 0..COARSE_ROUNDS {
                associate(&mut self.matches, map, level, reach, &pose, par);
                let kernel = (0.5 * spacing / f64::from(1_u32 << round.min(2))).max(params.kernel);
                let found = self.improve(&pose, Selection::All, kernel, params, &Matrix6::identity(), par);
                iterations += found.iterations;
                let step = pose.minus(&found.pose);
                pose = found.pose;
                if step.norm() < 0.02 * spacing {
                    break;
                }
            }
        }
        choose(features, params.max_surfaces, params.max_edges, &mut self.matches);
        // In places that are more clutter than surface the coarse levels may lead away from a good guess.
        if start > 0 && self.inliers(guess, map, params, par) >= self.inliers(&pose, map, params, par) {
            pose = *guess;
        }
        let (mut found, more) = self.rounds(&pose, map, params, solve, &Matrix6::identity(), par);
        iterations += more;
        let mut fit = self.objective(Selection::All, params.kernel, par).fit(
            &found.pose,
            params.inlier_distance,
            params.min_facing_share,
        );
        let held = fit.unobserved;
        if held.trace() > 0.5 {
            // What is known of the pose is kept, and the guess's place along the rest (Zhang, Kaess and Singh 2016).
            let start = found.pose.plus(&(held * guess.minus(&found.pose)));
            let keep = Matrix6::identity() - held;
            let (again, more) = self.rounds(&start, map, params, LoamSolve::Joint, &keep, par);
            iterations += more;
            found = again;
            let refit = self.objective(Selection::All, params.kernel, par).fit(
                &found.pose,
                params.inlier_distance,
                params.min_facing_share,
            );
            fit = MatchFit { unobserved: held, ..refit };
        }
        Aligned { alignment: self.conclude(found, fit, iterations, guess, params, par), agreement: fit.agreement }
    }

    /// Features that lie where the finest level has them.
    fn inliers(&mut self, pose: &Se3, map: &LocalMap, params: &LoamParams, par: Par) -> usize {
        associate(&mut self.matches, map, 0, map.level(0).reach(), pose, par);
        self.objective(Selection::All, params.kernel, par).inliers(pose, params.inlier_distance)
    }

    fn objective(&self, selection: Selection, kernel: f64, par: Par) -> MatchObjective<'_> {
        MatchObjective { matches: &self.matches, selection, kernel, par }
    }

    fn improve(
        &self,
        pose: &Se3,
        selection: Selection,
        kernel: f64,
        params: &LoamParams,
        keep: &Matrix6<f64>,
        par: Par,
    ) -> Descent {
        let mut objective = self.objective(selection, kernel, par);
        Optimizer::TrustRegion.minimize(&mut objective, &params.descent, pose, keep)
    }

    /// Rounds on the finest level, until the pose is at rest.
    fn rounds(
        &mut self,
        start: &Se3,
        map: &LocalMap,
        params: &LoamParams,
        solve: LoamSolve,
        keep: &Matrix6<f64>,
        par: Par,
    ) -> (Descent, usize) {
        let reach = map.level(0).reach();
        let (mut pose, mut iterations) = (*start, 0);
        let mut round = 0;
        loop {
            associate(&mut self.matches, map, 0, reach, &pose, par);
            let kernel = (0.4 * reach / f64::from(1_u32 << round.min(8))).max(params.kernel);
            let mut found = match solve {
                LoamSolve::Joint => self.improve(&pose, Selection::All, kernel, params, keep, par),
                LoamSolve::TwoStep => self.two_steps(&pose, kernel, params, par),
            };
            iterations += found.iterations;
            let step = found.pose.minus(&pose);
            pose = found.pose;
            let (line, turn) = (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm());
            let at_rest =
                line <= 2.0 * params.descent.translation_tolerance && turn <= 2.0 * params.descent.rotation_tolerance;
            let hopeless = matches!(found.termination, Termination::TooFewPoints | Termination::Degenerate);
            if hopeless || (at_rest && kernel <= params.kernel) || round + 1 >= params.max_rounds {
                // That the matches changed to the end is no reason to distrust a pose that hardly moves.
                let settled = line <= 0.02 && turn <= 0.002;
                if !hopeless {
                    found.termination = if settled { Termination::Converged } else { Termination::IterationLimit };
                }
                return (found, iterations);
            }
            round += 1;
        }
    }

    /// Height, roll and pitch by what is level; then x, y and yaw by edges.
    fn two_steps(&self, pose: &Se3, kernel: f64, params: &LoamParams, par: Par) -> Descent {
        let enough = |selection| {
            let count = self.objective(selection, kernel, par).count();
            if count >= FEWEST { selection } else { Selection::All }
        };
        let planar = Freedom::Planar.projector(pose);
        let vertical = Matrix6::identity() - planar;
        let upright = self.improve(pose, enough(Selection::Level), kernel, params, &vertical, par);
        let planar = Freedom::Planar.projector(&upright.pose);
        let found = self.improve(&upright.pose, enough(Selection::Edges), kernel, params, &planar, par);
        Descent { iterations: upright.iterations + found.iterations, ..found }
    }

    fn conclude(
        &self,
        found: Descent,
        fit: MatchFit,
        iterations: usize,
        guess: &Se3,
        params: &LoamParams,
        par: Par,
    ) -> Alignment<Se3> {
        let mut objective = self.objective(Selection::All, params.kernel, par);
        let quadratic = objective.evaluate(&found.pose);
        if quadratic.matches < FEWEST || !found.pose.is_finite() {
            let mut lost = Alignment::unknown(*guess, Termination::TooFewPoints);
            lost.iterations = iterations;
            return lost;
        }
        let mut result = Alignment::unknown(found.pose, found.termination);
        if found.termination == Termination::Converged
            && (fit.agreement < params.min_agreement || fit.inlier_ratio < LEAST)
        {
            result.termination = Termination::PoorFit;
        }
        result.iterations = iterations;
        result.unobserved = fit.unobserved;
        // Distances as the matches have them, but no better than a millimetre.
        let information = quadratic.hessian / fit.variance.max(1e-6);
        result.information = observed_information::<Se3>(&information, &fit.unobserved);
        result.inlier_ratio = fit.inlier_ratio;
        result.score = -quadratic.cost / quadratic.matches as f64;
        result
    }
}
