//! A guess of all poses from their relations alone: chordal relaxation.
//!
//! A descent finds the nearest minimum, and odometry that has turned by too much ends in another one, or takes hundreds of steps
//! out of it. If the orthogonality of rotation matrices is given up, the rotations that fit best solve a linear problem, and so do the
//! translations once the rotations are known (Martinec and Pajdla, *Robust rotation and translation estimation in multiview
//! reconstruction*, 2007; Carlone et al., *Initialization techniques for 3D SLAM*, 2015):
//!
//! ```text
//! min Σ w |Rⱼ - Rᵢ Rᵢⱼ|²        then        min Σ w |tⱼ - tᵢ - Rᵢ tᵢⱼ|²
//! ```
//!
//! The rows of a matrix do not depend on each other, nor do the coordinates: one factor serves all.

use super::{Layout, PoseGraph, PoseGraphSolver, SparseNormalEquations};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2, Se3, So2, So3},
};
use nalgebra::{Matrix3, Vector3};

/// Rigid motions as matrices, those of the plane within space.
pub trait RigidMotion: LieGroup {
    /// Dimensions of the space that moves.
    const SPACE: usize;

    /// Rotation matrix and translation, in metres.
    fn parts(&self) -> (Matrix3<f64>, Vector3<f64>);

    /// The motion of the rotation that is nearest to a matrix, and of a translation in metres; none if no one rotation is nearest.
    fn nearest(matrix: &Matrix3<f64>, translation: &Vector3<f64>) -> Option<Self>;
}

impl RigidMotion for Se2 {
    const SPACE: usize = 2;

    fn parts(&self) -> (Matrix3<f64>, Vector3<f64>) {
        let (cos, sin) = (self.rotation().cos(), self.rotation().sin());
        (Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0), Vector3::new(self.x(), self.y(), 0.0))
    }

    fn nearest(matrix: &Matrix3<f64>, translation: &Vector3<f64>) -> Option<Self> {
        let (cos, sin) = (matrix[(0, 0)] + matrix[(1, 1)], matrix[(1, 0)] - matrix[(0, 1)]);
        let pose = Self::from_parts(translation.xy(), So2::from_direction(cos, sin));
        ((cos != 0.0 || sin != 0.0) && pose.is_finite()).then_some(pose)
    }
}

impl RigidMotion for Se3 {
    const SPACE: usize = 3;

    fn parts(&self) -> (Matrix3<f64>, Vector3<f64>) {
        (self.rotation().matrix(), self.translation())
    }

    fn nearest(matrix: &Matrix3<f64>, translation: &Vector3<f64>) -> Option<Self> {
        let (rotation, clearness) = So3::nearest(matrix)?;
        let pose = Self::from_parts(*translation, rotation);
        (clearness > f64::EPSILON && pose.is_finite()).then_some(pose)
    }
}

/// Least weight of a relation, beside the greatest: it must not leave a pose without any, nor the equations ill-conditioned.
const LEAST_WEIGHT: f64 = 1e-6;

impl<G: RigidMotion> PoseGraphSolver<G> {
    /// Moves all poses but those that stay to a guess from relations and priors alone, and says whether there is one; if not, the
    /// poses stay. To be called before [`optimize`](Self::optimize) where the poses are no good guess; robust kernels do not
    /// count in it, so that false relations spoil it.
    ///
    /// # Errors
    /// [`Error::TooMany`] for a graph that memory has no room for.
    pub fn initialize(&mut self, graph: &mut PoseGraph<G>) -> Result<bool, Error> {
        let mut blocks = Vec::new();
        let free = graph.blocks_into(&mut blocks);
        let problem = Chordal { graph, free, ties: ties(graph), blocks };
        let mut system = SparseNormalEquations::default();
        let Some(rotations) = problem.rotations(&mut system)? else { return Ok(false) };
        let Some(translations) = problem.translations(&rotations, &mut system)? else { return Ok(false) };
        let guess: Option<Vec<G>> = (problem.blocks.iter().zip(graph.poses()).zip(&rotations))
            .map(|((block, pose), rotation)| match block {
                None => Some(*pose),
                Some(block) => G::nearest(rotation, &translations[*block as usize]),
            })
            .collect();
        let found = guess.is_some();
        if let Some(guess) = guess {
            *graph.poses_mut() = guess;
        }
        Ok(found)
    }
}

/// All that ties a pose to another, or to the map.
fn ties<G: RigidMotion>(graph: &PoseGraph<G>) -> Vec<Tie> {
    let tie = |from: Option<usize>, to: usize, measured: &G, information: &G::Matrix| {
        let entries = G::matrix_slice(information);
        let diagonal = |range: std::ops::Range<usize>| range.map(|i| entries[i * (G::DOF + 1)]).sum::<f64>();
        let (rotation, translation) = measured.parts();
        let weights = [diagonal(G::TRANSLATION_DOF..G::DOF), diagonal(0..G::TRANSLATION_DOF)];
        Tie { from, to, rotation, translation, weights }
    };
    let relations =
        graph.relations().iter().map(|r| tie(Some(r.from.index()), r.to.index(), &r.from_from_to, &r.information));
    let priors = graph.priors().iter().map(|p| tie(None, p.pose.index(), &p.map_from_pose, &p.information));
    let mut ties: Vec<Tie> = relations.chain(priors).collect();
    for kind in 0..2 {
        let between = ties.iter().filter(|tie| tie.from.is_some());
        let greatest = between.map(|tie| tie.weights[kind]).fold(0.0, f64::max);
        let least = if greatest > 0.0 { LEAST_WEIGHT * greatest } else { 1.0 };
        // A prior may say nothing, but who says anything is heard: else rounding decides where the whole graph lies.
        for tie in ties.iter_mut().filter(|tie| tie.from.is_some() || tie.weights[kind] > 0.0) {
            tie.weights[kind] = tie.weights[kind].max(least);
        }
    }
    ties
}

/// What the linear problems are made of.
struct Chordal<'a, G: RigidMotion> {
    graph: &'a PoseGraph<G>,
    /// Poses that may move, and the block of each.
    free: usize,
    blocks: Vec<Option<u32>>,
    ties: Vec<Tie>,
}

impl<G: RigidMotion> Chordal<'_, G> {
    /// The nearest rotation of every pose, as matrices; none if the relations do not determine them.
    fn rotations(&self, system: &mut SparseNormalEquations) -> Result<Option<Vec<Matrix3<f64>>>, Error> {
        let (size, free, graph) = (G::SPACE, self.free, self.graph);
        let known: Vec<Matrix3<f64>> = graph.poses().iter().map(|pose| pose.parts().0).collect();
        system.reset(Layout::uniform(size, free), self.pairs())?;
        let mut rhs = vec![vec![0.0; free * size]; size];
        // A prior may know nothing of a rotation, or of a place.
        for tie in self.ties.iter().filter(|tie| tie.weights[0] > 0.0) {
            let weight = tie.weights[0];
            let [from, to] = self.ends(tie);
            let entries = |matrix: Matrix3<f64>| -> Vec<f64> {
                (0..size).flat_map(|c| (0..size).map(move |r| matrix[(r, c)])).collect()
            };
            for block in [from, to].into_iter().flatten() {
                system.add_block(block, block, &entries(Matrix3::identity() * weight));
            }
            // A row of Rⱼ, as a column x, is the transpose of Rᵢⱼ times that of Rᵢ.
            match (from, to) {
                (Some(from), Some(to)) => system.add_block(to, from, &entries(tie.rotation.transpose() * -weight)),
                (None, Some(to)) => {
                    let base = tie.from.map_or_else(Matrix3::identity, |pose| known[pose]);
                    add_rows(&mut rhs, to, size, &(base * tie.rotation * weight));
                }
                (Some(from), None) => {
                    add_rows(&mut rhs, from, size, &(known[tie.to] * tie.rotation.transpose() * weight));
                }
                (None, None) => {}
            }
        }
        if !system.factorize() || !rhs.iter_mut().all(|row| system.substitute(row)) {
            return Ok(None);
        }
        let matrices = self.blocks.iter().zip(known).map(|(block, known)| match block {
            None => Some(known),
            Some(block) => {
                let mut matrix = Matrix3::identity();
                for (r, row) in rhs.iter().enumerate() {
                    for c in 0..size {
                        matrix[(r, c)] = row[*block as usize * size + c];
                    }
                }
                G::nearest(&matrix, &Vector3::zeros()).map(|pose| pose.parts().0)
            }
        });
        Ok(matrices.collect())
    }

    /// The translation of every pose that may move, given all rotations.
    fn translations(
        &self,
        rotations: &[Matrix3<f64>],
        system: &mut SparseNormalEquations,
    ) -> Result<Option<Vec<Vector3<f64>>>, Error> {
        let (free, graph) = (self.free, self.graph);
        system.reset(Layout::uniform(1, free), self.pairs())?;
        let mut rhs = vec![vec![0.0; free]; 3];
        let mut add = |block: u32, pull: Vector3<f64>| {
            rhs.iter_mut().zip(pull.iter()).for_each(|(rhs, pull)| rhs[block as usize] += pull);
        };
        for tie in self.ties.iter().filter(|tie| tie.weights[1] > 0.0) {
            let weight = tie.weights[1];
            let [from, to] = self.ends(tie);
            let turned = tie.from.map_or(tie.translation, |pose| rotations[pose] * tie.translation);
            for block in [from, to].into_iter().flatten() {
                system.add_block(block, block, &[weight]);
            }
            let at = |pose: usize| graph.poses()[pose].parts().1;
            match (from, to) {
                (Some(from), Some(to)) => {
                    system.add_block(to, from, &[-weight]);
                    add(to, turned * weight);
                    add(from, turned * -weight);
                }
                (None, Some(to)) => add(to, (tie.from.map_or_else(Vector3::zeros, at) + turned) * weight),
                (Some(from), None) => add(from, (at(tie.to) - turned) * weight),
                (None, None) => {}
            }
        }
        if !system.factorize() || !rhs.iter_mut().all(|row| system.substitute(row)) {
            return Ok(None);
        }
        Ok(Some((0..free).map(|i| Vector3::new(rhs[0][i], rhs[1][i], rhs[2][i])).collect()))
    }

    fn ends(&self, tie: &Tie) -> [Option<u32>; 2] {
        [tie.from.and_then(|pose| self.blocks[pose]), self.blocks[tie.to]]
    }

    fn pairs(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.ties.iter().filter_map(|tie| {
            let [from, to] = self.ends(tie);
            from.zip(to)
        })
    }
}

/// What is known of a pose, seen from another, or from the map.
struct Tie {
    from: Option<usize>,
    to: usize,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    /// Of the rotation and of the translation.
    weights: [f64; 2],
}

/// Adds each row of a matrix to the right-hand side of that row.
fn add_rows(rhs: &mut [Vec<f64>], block: u32, size: usize, matrix: &Matrix3<f64>) {
    for (r, row) in rhs.iter_mut().enumerate() {
        for c in 0..size {
            row[block as usize * size + c] += matrix[(r, c)];
        }
    }
}
