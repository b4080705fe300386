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
    solve::{NormalSystem, RobustKernel, StructuredLeastSquares},
};

/// The measurements, and which unknowns a pose has.
pub(crate) struct GraphProblem<'a, G: LieGroup> {
    pub(crate) relations: &'a [Relation<G>],
    pub(crate) priors: &'a [Prior<G>],
    /// Block of unknowns of each pose; none for a pose that is held.
    pub(crate) blocks: &'a [Option<u32>],
    /// How many times wider all kernels are than they were given.
    pub(crate) widening: f64,
}

impl<G: LieGroup> GraphProblem<'_, G> {
    /// `rᵀ Ω r` of all relations and then of all priors, and the kernel of each as it was given.
    pub(crate) fn squares(&self, poses: &[G]) -> impl Iterator<Item = (RobustKernel, f64)> {
        let relations = self.relations.iter().map(|relation| {
            let predicted = poses[relation.from.index()].between(&poses[relation.to.index()]);
            let error = residual(&relation.from_from_to, &predicted);
            (relation.kernel, squared::<G>(&error, &relation.information))
        });
        let priors = self.priors.iter().map(|prior| {
            let error = residual(&prior.map_from_pose, &poses[prior.pose.index()]);
            (prior.kernel, squared::<G>(&error, &prior.information))
        });
        relations.chain(priors)
    }

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
            let by_from = by_to * from.between_jacobians(to).0;
            let parts = [(self.blocks[relation.from.index()], by_from), (self.blocks[relation.to.index()], by_to)];
            let kernel = relation.kernel.widened(self.widening);
            Self::add(system, &error, &(relation.information * kernel.weight(square)), &parts);
            system.add_cost(0.5 * kernel.loss(square));
        }
        for prior in self.priors {
            let error = residual(&prior.map_from_pose, &poses[prior.pose.index()]);
            let square = squared::<G>(&error, &prior.information);
            let parts = [(self.blocks[prior.pose.index()], G::right_jacobian_inverse(&error))];
            let kernel = prior.kernel.widened(self.widening);
            Self::add(system, &error, &(prior.information * kernel.weight(square)), &parts);
            system.add_cost(0.5 * kernel.loss(square));
        }
    }

    fn cost(&mut self, poses: &Vec<G>) -> f64 {
        self.squares(poses).map(|(kernel, square)| 0.5 * kernel.widened(self.widening).loss(square)).sum()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::{Layout, PoseId};
    use agv_core::geometry::{Se2, Se3};

    /// Some positive definite matrix, with all entries different.
    fn information<G: LieGroup>(k: usize) -> G::Matrix {
        let wave: Vec<f64> = (0..G::DOF * G::DOF).map(|i| (1.7 * i as f64 + k as f64).sin()).collect();
        let root = G::matrix_from_slice(&wave);
        root * G::transpose(&root) + G::identity_matrix() * 0.5
    }

    fn motion<G: LieGroup>(k: usize) -> G {
        let wave: Vec<f64> = (0..G::DOF).map(|i| (2.3 * i as f64 + 1.1 * k as f64).sin()).collect();
        G::exp(&G::tangent_from_slice(&wave))
    }

    /// A relation each way between free poses, one to a held pose, and a prior.
    fn measurements<G: LieGroup>(kernel: RobustKernel) -> (Vec<Relation<G>>, Vec<Prior<G>>) {
        let relation =
            |from, to, k| Relation::new(PoseId(from), PoseId(to), motion(k), information::<G>(k)).with_kernel(kernel);
        let prior = Prior { kernel, ..Prior::new(PoseId(2), motion(9), information::<G>(9)) };
        (vec![relation(2, 1, 3), relation(0, 1, 4), relation(1, 2, 5), relation(2, 0, 6)], vec![prior])
    }

    const BLOCKS: [Option<u32>; 3] = [None, Some(0), Some(1)];

    fn linearized<G: LieGroup>(problem: &mut GraphProblem<'_, G>, poses: &Vec<G>) -> SparseNormalEquations {
        let mut system = SparseNormalEquations::default();
        system.reset(Layout::uniform(G::DOF, 2), [(1, 0)]).unwrap();
        problem.linearize(poses, &mut system);
        assert!(system.check().is_ok() && (system.cost() - problem.cost(poses)).abs() <= 1e-12 * system.cost() + 1e-25);
        system
    }

    fn moved<G: LieGroup>(problem: &GraphProblem<'_, G>, poses: &Vec<G>, step: &[f64]) -> Vec<G> {
        let mut trial = poses.clone();
        problem.retract_into(poses, step, &mut trial);
        trial
    }

    fn gradients_are_the_slopes_of_the_cost<G: LieGroup>() {
        use RobustKernel::{Cauchy, DynamicCovarianceScaling, GemanMcClure, Huber, Square};
        let scale = 0.7;
        let bounded = [GemanMcClure { scale: 2.0 }, DynamicCovarianceScaling { scale }];
        for kernel in [Square, Huber { scale }, Cauchy { scale }].into_iter().chain(bounded) {
            let (relations, priors) = measurements::<G>(kernel);
            let mut problem = GraphProblem { relations: &relations, priors: &priors, blocks: &BLOCKS, widening: 1.3 };
            let poses: Vec<G> = (0..3).map(motion).collect();
            let system = linearized(&mut problem, &poses);
            for i in 0..2 * G::DOF {
                let mut cost = |h: f64| {
                    let mut step = vec![0.0; 2 * G::DOF];
                    step[i] = h;
                    let trial = moved(&problem, &poses, &step);
                    problem.cost(&trial)
                };
                let slope = (cost(1e-6) - cost(-1e-6)) / 2e-6;
                assert!((slope - system.gradient()[i]).abs() < 1e-6 * (1.0 + slope.abs()), "{kernel:?} {i}: {slope}");
            }
        }
    }

    /// At a perfect fit the cost of a step `x` with `H x = b` is `½ xᵀ b`, whichever way the relations were measured.
    fn hessians_are_the_bend_of_the_cost<G: LieGroup>() {
        let poses: Vec<G> = (0..3).map(motion).collect();
        let (mut relations, mut priors) = measurements::<G>(RobustKernel::Square);
        for relation in &mut relations {
            relation.from_from_to = poses[relation.from.index()].between(&poses[relation.to.index()]);
        }
        priors[0].map_from_pose = poses[2];
        let mut problem = GraphProblem { relations: &relations, priors: &priors, blocks: &BLOCKS, widening: 1.0 };
        let mut system = linearized(&mut problem, &poses);
        for k in 0..6 {
            let b: Vec<f64> = (0..2 * G::DOF).map(|i| 1e-4 * (0.9 * i as f64 + 1.3 * f64::from(k)).cos()).collect();
            let mut x = b.clone();
            assert!(system.factorize() && system.substitute(&mut x));
            let expected: f64 = 0.5 * x.iter().zip(&b).map(|(x, b)| x * b).sum::<f64>();
            let trial = moved(&problem, &poses, &x);
            assert!((problem.cost(&trial) - expected).abs() < 1e-3 * expected, "{k}: {expected}");
        }
    }

    #[test]
    fn sums_are_those_of_the_cost_in_the_plane_and_in_space() {
        gradients_are_the_slopes_of_the_cost::<Se2>();
        gradients_are_the_slopes_of_the_cost::<Se3>();
        hessians_are_the_bend_of_the_cost::<Se2>();
        hessians_are_the_bend_of_the_cost::<Se3>();
    }
}
