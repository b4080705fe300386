//! Which closures to believe, and what they change.

use super::{
    GraphSlam,
    closures::{self, Closure, Keys},
    slam::{CLOSURE_KERNEL, Derived},
};
use crate::graph::{PoseId, Relation};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2},
    roles::AlignmentError,
};

/// Squared residual beyond which a closure contradicts the rest.
const CONTRADICTION: f64 = 100.0;

/// Least way between key scans whose closures confirm each other, in metres: neighbours see the same and are deceived alike.
const APART: f64 = 1.0;

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
        self.pending.retain(|closure| path - keys[closure.to as usize].path <= PATIENCE);
        let Some(here) = poses.last() else { return Ok(0) };
        let mut believed = Vec::new();
        for closure in found {
            let Some(claim) = closures::claimed(&closure, poses) else { continue };
            if closures::agree(&claim, here, params.agreement) {
                believed.push(closure);
                continue;
            }
            let agrees = |other: &Closure| {
                closures::claimed(other, poses).is_some_and(|other| closures::agree(&claim, &other, params.agreement))
            };
            let way = |closure: &Closure| keys[closure.to as usize].path;
            // One claim for each place, and all of them alike.
            let mut alike = vec![(way(&closure), claim)];
            for other in self.pending.iter().filter(|other| agrees(other)) {
                let Some(claim) = closures::claimed(other, poses) else { continue };
                let is_another = |(at, before): &(f64, Se2)| {
                    (at - way(other)).abs() >= APART && closures::agree(before, &claim, params.agreement)
                };
                if alike.iter().all(is_another) {
                    alike.push((way(other), claim));
                }
            }
            if alike.len() >= params.confirmations {
                believed.extend(self.pending.extract_if(.., |other| agrees(other)));
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
