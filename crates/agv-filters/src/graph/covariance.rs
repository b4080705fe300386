//! How certain the poses of a graph are.
//!
//! The covariance of all poses is the inverse of the Hessian at the minimum; of it the columns of one pose are solved for, with the
//! factor that the descent made. In the frames of the poses, as everything here (Solà et al., section III).

use super::{PoseGraph, PoseGraphSolver, PoseId};
use agv_core::{geometry::LieGroup, solve::NormalSystem};

/// Variance of an unknown beside what it would be if all others were known: about twice the number of poses of a chain, and beyond
/// this the rounding of an unknown that nothing determines.
const UNDETERMINED: f64 = 1e12;

impl<G: LieGroup> PoseGraphSolver<G> {
    /// Covariance of a pose of the graph that was optimised last, in the frame of that pose, given the poses that stay; none if
    /// the relations leave it undetermined; where they leave another one so, there may be none either. The first call factors the sums, each solves once per degree of freedom: linear in the
    /// entries of the factor.
    ///
    /// Robust kernels count as they did at the minimum.
    pub fn covariance(&mut self, pose: PoseId) -> Option<G::Matrix> {
        let Some(block) = *self.blocks.get(pose.index())? else {
            return Some(G::matrix_from_slice(&[]));
        };
        let [covariance] = self.columns(block, [Some(block)])?;
        Some(symmetric::<G>(&covariance))
    }

    /// Covariance of where one pose lies in the frame of another, in the frame of `to`: what a new relation between the two is to be
    /// compared with. `graph` is the one that was optimised last; none if its relations leave poses undetermined, or if it has
    /// not both of them. Twice the work of [`covariance`](Self::covariance).
    pub fn relative_covariance(&mut self, graph: &PoseGraph<G>, from: PoseId, to: PoseId) -> Option<G::Matrix> {
        let (first, second) = (*self.blocks.get(from.index())?, *self.blocks.get(to.index())?);
        let (from, to) = (graph.poses().get(from.index())?, graph.poses().get(to.index())?);
        let by_from = from.between_jacobians(to).0;
        let mut sum = G::matrix_from_slice(&[]);
        if let Some(block) = second {
            let [own, cross] = self.columns(block, [Some(block), first])?;
            let mixed = by_from * cross;
            sum = sum + own + mixed + G::transpose(&mixed);
        }
        if let Some(block) = first {
            let [own] = self.columns(block, [Some(block)])?;
            sum = sum + by_from * own * G::transpose(&by_from);
        }
        Some(symmetric::<G>(&sum))
    }

    /// Of the columns of the inverse of the Hessian that belong to a block, the rows of some blocks; zero for one that stays. None
    /// if the block is not determined.
    fn columns<const K: usize>(&mut self, block: u32, rows: [Option<u32>; K]) -> Option<[G::Matrix; K]> {
        let system = &mut self.workspace.system;
        if !system.factorize() {
            return None;
        }
        let mut entries = [(); K].map(|()| Vec::with_capacity(G::DOF * G::DOF));
        let mut unit = Vec::new();
        for i in (0..G::DOF).map(|inner| block as usize * G::DOF + inner) {
            unit.clear();
            unit.resize(system.dimension(), 0.0);
            unit[i] = 1.0;
            if !system.substitute(&mut unit) || unit[i] * system.diagonal(i) > UNDETERMINED {
                return None;
            }
            for (entries, row) in entries.iter_mut().zip(rows) {
                if let Some(row) = row {
                    let first = row as usize * G::DOF;
                    entries.extend_from_slice(&unit[first..first + G::DOF]);
                }
            }
        }
        Some(entries.map(|entries| G::matrix_from_slice(&entries)))
    }
}

/// Without the rounding that makes the two halves differ.
fn symmetric<G: LieGroup>(matrix: &G::Matrix) -> G::Matrix {
    (*matrix + G::transpose(matrix)) * 0.5
}
