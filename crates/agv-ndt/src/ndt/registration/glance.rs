//! What many poses are worth at a glance, for a search that has to choose where to begin.

use super::super::objective::ScoreObjective;
use super::super::search::Surroundings;
use super::{COARSE_POINTS, NdtRegistration};
use crate::registration::Objective;
use agv_core::{compute::Par, geometry::Se3, sensors::PointSource};

/// Poses that a thread looks at in one go, with buffers of its own.
const POSES: usize = 128;

impl NdtRegistration {
    /// What the coarsest level says of a source at each of many poses, without a search: its score per point. Allocates.
    pub(in crate::ndt) fn glance(&mut self, source: &dyn PointSource, poses: &[Se3], scores: &mut Vec<f64>) {
        scores.clear();
        scores.resize(poses.len(), 0.0);
        self.source.refill(source);
        let coarsest = self.levels.len() - 1;
        let most = self.source.len() / COARSE_POINTS;
        self.thinned.thin(&self.source, if coarsest == 0 { 1 } else { (2 << coarsest).min(most) });
        let (level, thinned, mixture) = (&self.levels[coarsest], &self.thinned, self.mixtures[coarsest]);
        let (search, arch) = (self.params.search, self.arch);
        self.par.for_each_chunk((poses, scores.as_mut_slice()), POSES, |_, (poses, scores)| {
            let (mut source, mut surroundings) = (thinned.clone(), Surroundings::default());
            let mut objective = ScoreObjective {
                level,
                source: &mut source,
                surroundings: &mut surroundings,
                mixture,
                search,
                curvature: 0.0,
                par: Par::Seq,
                arch,
            };
            for (pose, score) in poses.iter().zip(scores) {
                objective.prepare(pose);
                *score = -objective.evaluate(pose).cost / thinned.len().max(1) as f64;
            }
        });
    }
}
