//! The graph: poses, and what ties them together.

use super::{Prior, Relation};
use agv_core::{Error, geometry::LieGroup};

/// Which pose of a graph it is, counted from zero in the order in which they were added.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PoseId(pub u32);

impl PoseId {
    /// Its index in [`PoseGraph::poses`].
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Poses in a map, relations between them and priors of them.
///
/// A part of the graph that has no prior, and none of whose poses is [held](Self::hold), can be moved as a whole without any
/// relation noticing; its first pose then stays where it is. A prior without information holds a part in name only: it drifts.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2};
/// use agv_core::nalgebra::Matrix3;
/// use agv_filters::graph::{PoseGraph, PoseGraphSolver, PoseGraphSolverParams, Relation};
///
/// // Once around a square of 2 m, by odometry that turns too little; the end is recognised as the start.
/// let mut graph = PoseGraph::new();
/// let step = Se2::new(2.0, 0.0, 1.5);
/// let information = Matrix3::identity() * 100.0;
/// let start = graph.add_pose(Se2::default())?;
/// let mut last = start;
/// for _ in 0..4 {
///     let next = graph.add_pose(graph.poses()[last.index()].compose(&step))?;
///     graph.add_relation(Relation::new(last, next, step, information))?;
///     last = next;
/// }
/// graph.add_relation(Relation::new(last, start, Se2::default(), information * 100.0))?;
///
/// let mut solver = PoseGraphSolver::new(PoseGraphSolverParams::default())?;
/// let report = solver.optimize(&mut graph)?;
/// assert!(report.termination.converged());
/// assert!(graph.poses()[last.index()].translation().norm() < 0.01);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawPoseGraph<G>"),
    serde(bound(
        serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
        deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
    ))
)]
pub struct PoseGraph<G: LieGroup> {
    poses: Vec<G>,
    held: Vec<bool>,
    relations: Vec<Relation<G>>,
    priors: Vec<Prior<G>>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(bound(deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"))]
struct RawPoseGraph<G: LieGroup> {
    poses: Vec<G>,
    held: Vec<bool>,
    relations: Vec<Relation<G>>,
    priors: Vec<Prior<G>>,
}

#[cfg(feature = "serde")]
impl<G: LieGroup> TryFrom<RawPoseGraph<G>> for PoseGraph<G> {
    type Error = Error;

    fn try_from(raw: RawPoseGraph<G>) -> Result<Self, Error> {
        let (len, expected) = (raw.held.len(), raw.poses.len());
        if len != expected {
            return Err(Error::LengthMismatch { name: "held", len, expected });
        }
        let mut graph = Self::new();
        for (pose, held) in raw.poses.into_iter().zip(raw.held) {
            let id = graph.add_pose(pose)?;
            if held {
                graph.hold(id)?;
            }
        }
        raw.relations.into_iter().try_for_each(|relation| graph.add_relation(relation))?;
        raw.priors.into_iter().try_for_each(|prior| graph.add_prior(prior))?;
        Ok(graph)
    }
}

impl<G: LieGroup> Default for PoseGraph<G> {
    fn default() -> Self {
        Self::new()
    }
}

impl<G: LieGroup> PoseGraph<G> {
    /// A graph without poses.
    pub const fn new() -> Self {
        Self { poses: Vec::new(), held: Vec::new(), relations: Vec::new(), priors: Vec::new() }
    }

    /// Adds a pose by a first guess of it, in the map.
    ///
    /// # Errors
    /// [`Error::NotFinite`], or [`Error::TooMany`] beyond 2^32 - 1 of them.
    pub fn add_pose(&mut self, guess: G) -> Result<PoseId, Error> {
        if !guess.is_finite() {
            return Err(Error::NotFinite { name: "pose", value: f64::NAN });
        }
        let len = self.poses.len();
        let max = u32::MAX as usize;
        let id =
            u32::try_from(len).ok().filter(|id| *id < u32::MAX).ok_or(Error::TooMany { name: "poses", len, max })?;
        self.poses.push(guess);
        self.held.push(false);
        Ok(PoseId(id))
    }

    /// Takes the pose that was added last away, with its relations and priors; none of a graph without poses.
    pub fn pop_pose(&mut self) -> Option<G> {
        let pose = self.poses.pop()?;
        self.held.pop();
        let len = self.poses.len();
        self.relations.retain(|relation| relation.from.index() < len && relation.to.index() < len);
        self.priors.retain(|prior| prior.pose.index() < len);
        Some(pose)
    }

    /// Keeps a pose where it is.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a pose that is not there.
    pub fn hold(&mut self, pose: PoseId) -> Result<(), Error> {
        self.check(pose)?;
        self.held[pose.index()] = true;
        Ok(())
    }

    /// Lets a pose that was held move again.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a pose that is not there.
    pub fn release(&mut self, pose: PoseId) -> Result<(), Error> {
        self.check(pose)?;
        self.held[pose.index()] = false;
        Ok(())
    }

    /// Moves a pose to another guess.
    ///
    /// # Errors
    /// [`Error::NotFinite`], or [`Error::OutOfRange`] for a pose that is not there; nothing changes then.
    pub fn set_pose(&mut self, pose: PoseId, guess: G) -> Result<(), Error> {
        self.check(pose)?;
        if !guess.is_finite() {
            return Err(Error::NotFinite { name: "pose", value: f64::NAN });
        }
        self.poses[pose.index()] = guess;
        Ok(())
    }

    /// Adds a relation between two poses that are there.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a pose that is not there, or is related to itself; and a pose, an information or a kernel that
    /// cannot be one. The graph is then as it was.
    pub fn add_relation(&mut self, relation: Relation<G>) -> Result<(), Error> {
        relation.validate()?;
        self.check(relation.from)?;
        self.check(relation.to)?;
        if relation.from == relation.to {
            let (value, max) = (f64::from(relation.to.0), self.poses.len() as f64 - 1.0);
            return Err(Error::OutOfRange { name: "another pose than the relation's first", value, min: 0.0, max });
        }
        self.relations.push(relation);
        Ok(())
    }

    /// Adds a prior of a pose that is there.
    ///
    /// # Errors
    /// As [`add_relation`](Self::add_relation).
    pub fn add_prior(&mut self, prior: Prior<G>) -> Result<(), Error> {
        prior.validate()?;
        self.check(prior.pose)?;
        self.priors.push(prior);
        Ok(())
    }

    fn check(&self, pose: PoseId) -> Result<(), Error> {
        if pose.index() < self.poses.len() {
            return Ok(());
        }
        let max = self.poses.len() as f64 - 1.0;
        Err(Error::OutOfRange { name: "pose of the graph", value: f64::from(pose.0), min: 0.0, max })
    }

    /// The poses in the map, by [`PoseId`].
    pub fn poses(&self) -> &[G] {
        &self.poses
    }

    /// The poses, to be moved by a solver that keeps their number and leaves them finite.
    pub(crate) const fn poses_mut(&mut self) -> &mut Vec<G> {
        &mut self.poses
    }

    /// All relations, in the order in which they were added.
    pub fn relations(&self) -> &[Relation<G>] {
        &self.relations
    }

    /// All priors, in the order in which they were added.
    pub fn priors(&self) -> &[Prior<G>] {
        &self.priors
    }

    /// Keeps the relations that `keep` says yes to: how loop closures that turned out to be false leave the graph.
    pub fn retain_relations(&mut self, keep: impl FnMut(&Relation<G>) -> bool) {
        self.relations.retain(keep);
    }

    /// Numbers the poses that may move: those that are not held, and of each part without a prior or a held pose not the first.
    pub(crate) fn blocks_into(&self, blocks: &mut Vec<Option<u32>>) -> usize {
        self.linked_blocks_into(std::iter::empty(), blocks)
    }

    /// The same where something beside relations links poses too.
    pub(crate) fn linked_blocks_into(
        &self,
        links: impl Iterator<Item = (PoseId, PoseId)>,
        blocks: &mut Vec<Option<u32>>,
    ) -> usize {
        // Each pose's part, by its first pose.
        let mut first: Vec<u32> = (0..self.poses.len() as u32).collect();
        let relations = self.relations.iter().map(|relation| (relation.from, relation.to));
        for (from, to) in relations.chain(links) {
            let (a, b) = (root(&mut first, from.0), root(&mut first, to.0));
            first[a.max(b) as usize] = a.min(b);
        }
        let mut anchored = vec![false; self.poses.len()];
        for pose in self.priors.iter().map(|prior| prior.pose.0) {
            anchored[root(&mut first, pose) as usize] = true;
        }
        for pose in (0..self.poses.len() as u32).filter(|pose| self.held[*pose as usize]) {
            anchored[root(&mut first, pose) as usize] = true;
        }
        let mut free = 0;
        blocks.clear();
        blocks.extend((0..self.poses.len()).map(|pose| {
            let fixed = self.held[pose] || (root(&mut first, pose as u32) as usize == pose && !anchored[pose]);
            (!fixed).then(|| {
                free += 1;
                free - 1
            })
        }));
        free as usize
    }
}

/// The first pose of the part that a pose belongs to; ways there are halved.
fn root(first: &mut [u32], mut pose: u32) -> u32 {
    while first[pose as usize] != pose {
        first[pose as usize] = first[first[pose as usize] as usize];
        pose = first[pose as usize];
    }
    pose
}
