//! Where in the map a cloud was taken: many starts, judged at a glance, and the best of them followed to their optimum.

use super::super::registration::NdtRegistration;
use super::params::SearchParams;
use super::places::spread_out;
use agv_core::{
    geometry::{LieGroup, Se3, So3},
    roles::{Alignment, AlignmentError, Registration},
    sensors::PointSource,
};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Results that are nearer to each other than this are one: in metres, and in radians.
const SAME: (f64, f64) = (0.3, 0.1);

/// What a search is made of; the buffers are kept.
#[derive(Debug, Clone, Default)]
pub(super) struct Search {
    guesses: Vec<Se3>,
    scores: Vec<f64>,
    order: Vec<usize>,
    finalists: Vec<Se3>,
    found: Vec<Alignment<Se3>>,
}

impl Search {
    /// Looks for poses that explain the source and are `allowed`, from all headings at the places within `radius` metres of `around`,
    /// and from `around` itself, which is always followed to its optimum.
    pub(super) fn run(
        &mut self,
        ndt: &mut NdtRegistration,
        source: &dyn PointSource,
        places: &[Se3],
        (around, radius): (&Se3, f64),
        params: &SearchParams,
        allowed: impl Fn(&Alignment<Se3>) -> bool,
    ) -> Result<(), AlignmentError> {
        let step = TAU / params.headings as f64;
        self.guesses.clear();
        self.guesses.push(*around);
        let near = |place: &&Se3| (place.translation() - around.translation()).norm() <= radius;
        let near = places.iter().filter(near).copied().collect();
        let (places, apart) = spread_out(near, params.spacing, (params.max_starts / params.headings).max(1));
        for place in &places {
            for heading in 0..params.headings {
                let turn = So3::exp(&Vector3::new(0.0, 0.0, heading as f64 * step));
                self.guesses.push(place.compose(&Se3::from_parts(Vector3::zeros(), turn)));
            }
        }
        ndt.glance(source, &self.guesses, &mut self.scores);
        self.pick(params, 1.5 * apart, 1.5 * step);
        self.found.clear();
        for guess in &self.finalists {
            let result = ndt.align(source, guess)?;
            if result.converged() && allowed(&result) {
                self.found.push(result);
            }
        }
        Ok(())
    }

    /// Starts of the last search.
    #[cfg(test)]
    pub(super) fn starts(&self) -> usize {
        self.guesses.len()
    }

    /// The first start, and the best others, no two of which are near each other.
    fn pick(&mut self, params: &SearchParams, apart: f64, turned: f64) {
        self.order.clear();
        self.order.extend(0..self.guesses.len());
        let (scores, guesses) = (&self.scores, &self.guesses);
        // Ties go to the first: the order of the guesses is that of the caller.
        self.order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]));
        self.finalists.clear();
        self.finalists.extend(guesses.first());
        for &index in &self.order {
            if self.finalists.len() > params.finalists {
                break;
            }
            let guess = &guesses[index];
            if !self.finalists.iter().any(|taken| is_near(taken, guess, apart, turned)) {
                self.finalists.push(*guess);
            }
        }
    }

    /// The result with the greatest share of inliers, if no other place comes up to it; `None` if there is none, or another fits
    /// nearly as well. Places that differ only along what the best one leaves unobserved may count as one.
    pub(super) fn verdict(&self, lead: f64, as_observed: bool) -> Option<Alignment<Se3>> {
        let best = self.found.iter().max_by(|a, b| a.inlier_ratio.total_cmp(&b.inlier_ratio))?;
        let is_rival = |other: &Alignment<Se3>| {
            other.inlier_ratio + lead > best.inlier_ratio
                && !is_near(&other.target_from_source, &best.target_from_source, SAME.0, SAME.1)
                && !(as_observed && is_same_as_observed(best, other))
        };
        (!self.found.iter().any(is_rival)).then_some(*best)
    }
}

fn is_same_as_observed(best: &Alignment<Se3>, other: &Alignment<Se3>) -> bool {
    let apart = other.target_from_source.minus(&best.target_from_source);
    let seen = apart - best.unobserved * apart;
    seen.fixed_rows::<3>(0).norm() < SAME.0 && seen.fixed_rows::<3>(3).norm() < SAME.1
}

fn is_near(a: &Se3, b: &Se3, apart: f64, turned: f64) -> bool {
    let between = a.between(b);
    between.translation().norm() < apart && between.rotation().log().norm() < turned
}
