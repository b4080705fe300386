//! A pose graph as a least-squares problem.
//!
//! With right increments, `r = log(measured⁻¹ ∘ xᵢ⁻¹ ∘ xⱼ)` has the Jacobians (Solà et al., Eqs. 82, 79 and 62)
//!
//! ```text
//! Jⱼ = Jr⁻¹(r)        Jᵢ = -Jr⁻¹(r) Ad(xⱼ⁻¹ ∘ xᵢ)
//! ```

use super::{
    Prior, Relation, SparseNormalEquations,
    relation::{residual, squared},
};
use agv_core::{
    geometry::LieGroup,
    solve::{NormalSystem, StructuredLeastSquares},
};

/// The measurements, and which unknowns a pose has.
pub(super) struct GraphProblem<'a, G: LieGroup> {
    pub(super) relations: &'a [Relation<G>],
    pub(super) priors: &'a [Prior<G>],
    /// Block of unknowns of each pose; none for a pose that is held.
    pub(super) blocks: &'a [Option<u32>],
}

impl<G: LieGroup> GraphProblem<'_, G> {
    /// Adds the products of a residual with the Jacobians of the poses that it depends on.
    fn add(
        system: &mut SparseNormalEquations,
        residual: &G::Tangent,
        information: &G::Matrix,
        parts: &[(Option<u32>, G::Matrix)],
    ) {
        for (i, (block, jacobian)) in parts.iter().enumerate() {
            let Some(block) = *block else { continue };
            let weighted = G::transpose(jacobian) * *information;
            system.add_gradient(block, G::tangent_slice(&(weighted * *residual)));
            for (other, second) in &parts[..=i] {
                let Some(other) = *other else { continue };
                system.add_block(block, other, G::matrix_slice(&(weighted * *second)));
            }
        }
    }
}

impl<G: LieGroup> StructuredLeastSquares<SparseNormalEquations> for GraphProblem<'_, G> {
    type State = Vec<G>;

    fn linearize(&mut self, poses: &Vec<G>, system: &mut SparseNormalEquations) {
        for relation in self.relations {
            let (from, to) = (&poses[relation.from.index()], &poses[relation.to.index()]);
            let from_from_to = from.between(to);
            let error = residual(&relation.from_from_to, &from_from_to);
            let square = squared::<G>(&error, &relation.information);
            let by_to = G::right_jacobian_inverse(&error);
            let by_from = -(by_to * from_from_to.inverse().adjoint());
            let parts = [(self.blocks[relation.from.index()], by_from), (self.blocks[relation.to.index()], by_to)];
            Self::add(system, &error, &(relation.information * relation.kernel.weight(square)), &parts);
            system.add_cost(0.5 * relation.kernel.loss(square));
        }
        for prior in self.priors {
            let error = residual(&prior.map_from_pose, &poses[prior.pose.index()]);
            let square = squared::<G>(&error, &prior.information);
            let parts = [(self.blocks[prior.pose.index()], G::right_jacobian_inverse(&error))];
            Self::add(system, &error, &(prior.information * prior.kernel.weight(square)), &parts);
            system.add_cost(0.5 * prior.kernel.loss(square));
        }
    }

    fn cost(&mut self, poses: &Vec<G>) -> f64 {
        let relations = self.relations.iter().map(|relation| {
            let predicted = poses[relation.from.index()].between(&poses[relation.to.index()]);
            let error = residual(&relation.from_from_to, &predicted);
            0.5 * relation.kernel.loss(squared::<G>(&error, &relation.information))
        });
        let priors = self.priors.iter().map(|prior| {
            let error = residual(&prior.map_from_pose, &poses[prior.pose.index()]);
            0.5 * prior.kernel.loss(squared::<G>(&error, &prior.information))
        });
        relations.sum::<f64>() + priors.sum::<f64>()
    }

    fn retract_into(&self, poses: &Vec<G>, step: &[f64], trial: &mut Vec<G>) {
        for ((pose, moved), block) in poses.iter().zip(trial.iter_mut()).zip(self.blocks) {
            *moved = match block {
                Some(block) => {
                    let first = *block as usize * G::DOF;
                    pose.plus(&G::tangent_from_slice(&step[first..first + G::DOF]))
                }
                None => *pose,
            };
        }
    }
}
