//! Which closures to believe, and what they change.

use super::{
    GraphSlam,
    closures::{self, Closure, Keys},
    confirm::{Claim, confirmed},
    slam::{CLOSURE_KERNEL, Derived},
};
use crate::graph::{PoseId, Relation};
use agv_core::{Error, geometry::LieGroup, roles::AlignmentError};

/// Squared residual beyond which a closure contradicts the rest.
const CONTRADICTION: f64 = 100.0;

/// Way over which closures wait for others that agree, in metres.
const PATIENCE: f64 = 8.0;

impl GraphSlam {
    /// Seeks closures of the last key scan; how many are believed.
    pub(super) fn close_loops(&mut self) -> Result<usize, AlignmentError> {
        let params = self.params.closure;
        let window = params.window_after(self.path - self.tied);
        let keys = Keys { scans: &self.keys, poses: self.graph.poses() };
        let Derived { seekers, par, .. } = &mut self.derived;
        let found = closures::find(keys, window, &self.params, seekers, *par)?;
        let (poses, keys, path) = (self.graph.poses(), &self.keys, self.path);
        let claim = |closure: &Closure| {
            let way = keys.get(closure.to as usize)?.path;
            Some(Claim { way, pose: closures::claimed(closure, poses)? })
        };
        self.pending.retain(|closure| claim(closure).is_some_and(|claim| path - claim.way <= PATIENCE));
        let Some(here) = poses.last() else { return Ok(0) };
        let mut believed = Vec::new();
        for closure in found {
            let Some(new) = claim(&closure) else { continue };
            if closures::agree(&new.pose, here, params.agreement) {
                believed.push(closure);
                continue;
            }
            let claims: Vec<Claim> = self.pending.iter().filter_map(claim).collect();
            if let Some(others) = confirmed(new, &claims, params.agreement, params.confirmations) {
                let mut index = 0..;
                believed.extend(self.pending.extract_if(.., |_| index.next().is_some_and(|i| others.contains(&i))));
                believed.push(closure);
            } else {
                self.pending.push(closure);
            }
        }
        for Closure { from, to, from_from_to, information } in &believed {
            let relation = Relation::new(PoseId(*from), PoseId(*to), *from_from_to, *information);
            self.graph.add_relation(relation.with_kernel(CLOSURE_KERNEL))?;
            self.closed.insert((*from, *to));
            self.tied = path;
        }
        Ok(believed.len())
    }

    /// Moves all poses to where the relations fit best, and takes out closures that contradict the rest; whether it went well.
    ///
    /// Closures do this by themselves. Time is that of the pose graph: some milliseconds for a thousand key scans.
    ///
    /// # Errors
    /// [`Error::TooMany`] for a graph that memory has no room for.
    pub fn correct(&mut self) -> Result<bool, Error> {
        let converged = self.solve()?;
        self.aim()?;
        Ok(converged)
    }

    /// As [`correct`](Self::correct), with the front end's target as it was.
    pub(super) fn solve(&mut self) -> Result<bool, Error> {
        let mut report = self.derived.solver.optimize(&mut self.graph)?;
        let poses = self.graph.poses().to_vec();
        let (before, closed) = (self.graph.relations().len(), &self.closed);
        self.graph.retain_relations(|relation| {
            let predicted = poses[relation.from.index()].between(&poses[relation.to.index()]);
            let error = relation.from_from_to.between(&predicted).log();
            // The first key scan of a drive may be tied to its anchor by a match too, which has no kernel.
            let is_closure = relation.kernel == CLOSURE_KERNEL && closed.contains(&(relation.from.0, relation.to.0));
            !is_closure || (error.transpose() * relation.information * error)[0] <= CONTRADICTION
        });
        if self.graph.relations().len() < before {
            report = self.derived.solver.optimize(&mut self.graph)?;
        }
        Ok(report.termination.converged())
    }
}
