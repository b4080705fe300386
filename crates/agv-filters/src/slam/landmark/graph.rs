//! A graph of poses and landmarks.

use super::{LandmarkReading, LandmarkSighting, problem::sees, reading::SCALES};
use crate::graph::{PoseGraph, PoseId};
use agv_core::{Error, check, geometry::Se2, solve::RobustKernel};
use nalgebra::Vector2;

/// A landmark of a [`LandmarkGraph`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GraphLandmark(pub(super) u32);

impl GraphLandmark {
    /// Place in [`LandmarkGraph::landmarks`].
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// A sighting that ties a landmark to a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Tie {
    /// The pose of the vehicle.
    pub pose: PoseId,
    /// The landmark.
    pub landmark: GraphLandmark,
    /// What was measured; its identity does not count.
    pub sighting: LandmarkSighting,
    /// How its residual counts, in standard deviations: a robust kernel for sightings that may be of another landmark.
    pub kernel: RobustKernel,
}

/// Poses that odometry ties together, and landmarks that sightings tie to them: a [`PoseGraph`] with points beside its poses.
///
/// ```
/// use agv_core::{geometry::Se2, nalgebra::{Matrix3, Vector2}, solve::RobustKernel};
/// use agv_filters::graph::{PoseGraphSolverParams, Relation};
/// use agv_filters::slam::landmark::{LandmarkGraph, LandmarkGraphSolver, LandmarkReading, LandmarkSighting, Tie};
///
/// // A step of two metres that odometry takes for one and a half, beside a post that is seen from both ends.
/// let mut graph = LandmarkGraph::new();
/// let (a, b) = (graph.add_pose(Se2::default())?, graph.add_pose(Se2::new(1.5, 0.0, 0.0))?);
/// let information = Matrix3::from_diagonal(&[4.0, 1e4, 1e4].into());
/// graph.add_relation(Relation::new(a, b, Se2::new(1.5, 0.0, 0.0), information))?;
/// let post = graph.add_landmark(Vector2::new(1.0, 1.0))?;
/// for (pose, range, bearing) in [(a, 1.414, 0.785), (b, 1.414, 2.356)] {
///     let sighting = LandmarkSighting::new(None, LandmarkReading::range_bearing(range, bearing, [0.01, 0.005])?);
///     graph.add_tie(Tie { pose, landmark: post, sighting, kernel: RobustKernel::Square })?;
/// }
/// let mut solver = LandmarkGraphSolver::new(PoseGraphSolverParams::default())?;
/// assert!(solver.optimize(&mut graph)?.termination.converged());
/// assert!((graph.poses()[b.index()].x() - 2.0).abs() < 0.01);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawLandmarkGraph"))]
pub struct LandmarkGraph {
    pub(super) poses: PoseGraph<Se2>,
    pub(super) landmarks: Vec<Vector2<f64>>,
    pub(super) ties: Vec<Tie>,
    /// Share by which ranges are too long.
    pub(super) range_scale: f64,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawLandmarkGraph {
    poses: PoseGraph<Se2>,
    landmarks: Vec<Vector2<f64>>,
    ties: Vec<Tie>,
    range_scale: f64,
}

#[cfg(feature = "serde")]
impl TryFrom<RawLandmarkGraph> for LandmarkGraph {
    type Error = Error;

    fn try_from(raw: RawLandmarkGraph) -> Result<Self, Error> {
        let mut graph = Self { poses: raw.poses, ..Self::new() };
        graph.set_range_scale(raw.range_scale)?;
        for place in raw.landmarks {
            graph.add_landmark(place)?;
        }
        raw.ties.into_iter().try_for_each(|tie| graph.add_tie(tie))?;
        Ok(graph)
    }
}

impl Default for LandmarkGraph {
    fn default() -> Self {
        Self::new()
    }
}

impl LandmarkGraph {
    /// A graph without poses and landmarks.
    pub const fn new() -> Self {
        Self { poses: PoseGraph::new(), landmarks: Vec::new(), ties: Vec::new(), range_scale: 0.0 }
    }

    /// Adds a pose by a first guess of it, in the map.
    ///
    /// # Errors
    /// As [`PoseGraph::add_pose`].
    pub fn add_pose(&mut self, guess: Se2) -> Result<PoseId, Error> {
        self.poses.add_pose(guess)
    }

    /// Adds a relation between two poses: odometry.
    ///
    /// # Errors
    /// As [`PoseGraph::add_relation`].
    pub fn add_relation(&mut self, relation: crate::graph::Relation<Se2>) -> Result<(), Error> {
        self.poses.add_relation(relation)
    }

    /// Adds a landmark by a first guess of its place, in the map.
    ///
    /// # Errors
    /// [`Error::NotFinite`], or [`Error::TooMany`] beyond 2^32 - 1 of them.
    pub fn add_landmark(&mut self, guess: Vector2<f64>) -> Result<GraphLandmark, Error> {
        check::all_finite("place of a landmark", guess.iter())?;
        let (len, max) = (self.landmarks.len(), u32::MAX as usize);
        let id = u32::try_from(len).map_err(|_| Error::TooMany { name: "landmarks", len, max })?;
        self.landmarks.push(guess);
        Ok(GraphLandmark(id))
    }

    /// Ties a landmark to a pose.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a pose or a landmark that is not there; a sighting or a kernel that cannot be one. The graph is then
    /// as it was.
    pub fn add_tie(&mut self, tie: Tie) -> Result<(), Error> {
        tie.sighting.validate()?;
        tie.kernel.checked()?;
        let there =
            |name, value: usize, len: usize| check::in_range(name, value as f64, 0.0, len as f64 - 1.0).map(|_| ());
        there("pose of the graph", tie.pose.index(), self.poses.poses().len())?;
        there("landmark of the graph", tie.landmark.index(), self.landmarks.len())?;
        self.ties.push(tie);
        Ok(())
    }

    /// Says by which share ranges are too long; it is not estimated here.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] unless between -0.9 and 10.
    pub fn set_range_scale(&mut self, range_scale: f64) -> Result<(), Error> {
        self.range_scale = check::in_range("range_scale", range_scale, *SCALES.start(), *SCALES.end())?;
        Ok(())
    }

    /// The poses in the map, by [`PoseId`].
    pub fn poses(&self) -> &[Se2] {
        self.poses.poses()
    }

    /// The places of the landmarks in the map, by [`GraphLandmark`].
    pub fn landmarks(&self) -> &[Vector2<f64>] {
        &self.landmarks
    }

    /// The sightings, in the order in which they were added.
    pub fn ties(&self) -> &[Tie] {
        &self.ties
    }

    /// Says that one landmark is another: its sightings become that one's. It stays in the list, without sightings.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a landmark that is not there.
    pub fn merge(&mut self, one: GraphLandmark, into: GraphLandmark) -> Result<(), Error> {
        for landmark in [one, into] {
            check::in_range("landmark of the graph", f64::from(landmark.0), 0.0, self.landmarks.len() as f64 - 1.0)?;
        }
        self.ties.iter_mut().filter(|tie| tie.landmark == one).for_each(|tie| tie.landmark = into);
        self.landmarks[one.index()] = self.landmarks[into.index()];
        Ok(())
    }

    /// Numbers the unknowns of the landmarks that are seen, behind those of the poses.
    pub(super) fn landmark_blocks_into(&self, free_poses: usize, blocks: &mut Vec<Option<u32>>) -> usize {
        let mut seen = vec![false; self.landmarks.len()];
        self.ties.iter().for_each(|tie| seen[tie.landmark.index()] = true);
        let mut next = free_poses as u32;
        blocks.clear();
        blocks.extend(seen.into_iter().map(|seen| {
            seen.then(|| {
                next += 1;
                next - 1
            })
        }));
        next as usize - free_poses
    }

    /// Half the sum of what each sighting costs at the places as they are.
    pub fn tie_cost(&self) -> f64 {
        self.ties
            .iter()
            .filter_map(|tie| {
                let (pose, place) = (&self.poses.poses()[tie.pose.index()], &self.landmarks[tie.landmark.index()]);
                sees(tie, pose, place, self.range_scale).map(|seen| 0.5 * tie.kernel.loss(seen.square()))
            })
            .sum()
    }

    /// Whether a reading of this kind can tell a place by itself.
    pub(super) const fn places(reading: &LandmarkReading) -> bool {
        !matches!(reading, LandmarkReading::Range(_))
    }
}
