//! SLAM with landmarks on a graph: the filter says which landmark is seen, the graph where everything is.

use super::{
    GraphLandmark, LandmarkGraph, LandmarkGraphSolver, LandmarkSighting, LandmarkSlam, LandmarkSlamParams,
    LandmarkUpdate, SightingOutcome, Tie,
};
use crate::graph::{PoseGraphSolverParams, PoseId, Relation};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    metrics::chi_square_quantile,
    odometry::OdometryIncrement,
    solve::{LeastSquaresReport, LevenbergMarquardtParams, RobustKernel},
};
use nalgebra::{Matrix2, Matrix3};
use std::collections::{BTreeMap, BTreeSet};

/// Parameters of a [`LandmarkGraphSlam`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LandmarkGraphSlamParams {
    /// The filter in front.
    pub front: LandmarkSlamParams,
    /// How the residuals of sightings count.
    pub kernel: RobustKernel,
    /// Poses with sightings between two corrections of the graph; zero: at the end only.
    pub interval: usize,
    /// Probability with which two landmarks that are one pass for it.
    pub merge_probability: f64,
    /// Least deviation of a motion, in metres and in radians: odometry that claims to be exact would make the graph singular.
    pub least_sigmas: [f64; 2],
}

impl Default for LandmarkGraphSlamParams {
    /// Cauchy's kernel at 2.385 deviations, corrections every hundred poses.
    fn default() -> Self {
        Self {
            front: LandmarkSlamParams::default(),
            kernel: RobustKernel::Cauchy { scale: 2.385 },
            interval: 100,
            merge_probability: 0.99,
            least_sigmas: [1e-3, 1e-4],
        }
    }
}

/// Graph SLAM with landmarks.
///
/// Deterministic. A state that was stored continues with the same bits (feature `serde`); covariances and what became of the last
/// sightings are not in it, the next correction and the next update tell them again.
///
/// A [`LandmarkSlam`] in front decides which landmark each sighting is of. Every update becomes a pose of a [`LandmarkGraph`], tied by odometry to the one before and by
/// its sightings to landmarks. The graph is corrected every so many poses, from where it was, and at the end; then landmarks are compared
/// again: two that were never seen together, and whose distance is explained by its covariance, are made one, and the graph is
/// corrected with them. So a loop that the filter did not see closes after all.
///
/// ```
/// # use agv_core::{geometry::{LieGroup, Se2}, nalgebra::{Matrix3, Vector2}, odometry::OdometryIncrement, time::Stamp};
/// use agv_filters::slam::landmark::{LandmarkGraphSlam, LandmarkGraphSlamParams, LandmarkReading, LandmarkSighting};
///
/// let mut slam = LandmarkGraphSlam::new(LandmarkGraphSlamParams::default())?;
/// let (posts, mut truth, now) = ([Vector2::new(4.0, 2.0), Vector2::new(3.0, -2.0)], Se2::default(), Stamp::default());
/// for _ in 0..20 {
///     let seen: Vec<_> = posts
///         .iter()
///         .map(|post| truth.inverse().act(post))
///         .map(|q| LandmarkReading::range_bearing(q.norm(), q.y.atan2(q.x), [0.05, 0.01]))
///         .map(|reading| Ok(LandmarkSighting::new(None, reading?)))
///         .collect::<Result<_, agv_core::Error>>()?;
///     slam.update(&seen)?;
///     let step = Se2::new(0.1, 0.0, 0.02);
///     slam.predict(&OdometryIncrement { start: now, end: now, start_from_end: step, covariance: Matrix3::zeros() })?;
///     truth = truth * step;
/// }
/// slam.finish()?;
/// assert_eq!(slam.landmarks().count(), 2);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "super::graph_checkpoint::RawLandmarkGraphSlam")
)]
pub struct LandmarkGraphSlam {
    pub(super) params: LandmarkGraphSlamParams,
    pub(super) front: LandmarkSlam,
    pub(super) graph: LandmarkGraph,
    /// The graph's landmark of each key.
    pub(super) of_key: BTreeMap<u32, GraphLandmark>,
    /// Motion since the last pose.
    pub(super) motion: Option<OdometryIncrement>,
    /// Poses since the graph was corrected.
    pub(super) since: usize,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(super) solver: LandmarkGraphSolver,
}

impl LandmarkGraphSlam {
    /// A graph without poses.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: LandmarkGraphSlamParams) -> Result<Self, Error> {
        params.kernel.checked()?;
        check::open_probability("merge_probability", params.merge_probability)?;
        check::positive("least deviation", params.least_sigmas[0])?;
        check::positive("least deviation", params.least_sigmas[1])?;
        let solver = PoseGraphSolverParams::default();
        let descent = LevenbergMarquardtParams { max_iterations: 50, ..solver.descent };
        Ok(Self {
            params,
            front: LandmarkSlam::new(params.front)?,
            graph: LandmarkGraph::new(),
            solver: LandmarkGraphSolver::new(PoseGraphSolverParams { descent, ..solver })?,
            of_key: BTreeMap::new(),
            motion: None,
            since: 0,
        })
    }

    /// The filter in front.
    pub const fn front(&self) -> &LandmarkSlam {
        &self.front
    }

    /// The graph.
    pub const fn graph(&self) -> &LandmarkGraph {
        &self.graph
    }

    /// Where the vehicle is: by the graph's last pose, and odometry since.
    pub fn map_from_base(&self) -> Se2 {
        let last = self.graph.poses().last().copied().unwrap_or_default();
        self.motion.map_or(last, |motion| last.compose(&motion.start_from_end))
    }

    fn last(&self) -> Option<PoseId> {
        self.graph.poses().len().checked_sub(1).map(|last| PoseId(last as u32))
    }

    /// The last pose of the graph, and the vehicle in its frame: what a trajectory keeps, to be corrected with the graph.
    pub fn place(&self) -> (Option<PoseId>, Se2) {
        (self.last(), self.motion.map(|motion| motion.start_from_end).unwrap_or_default())
    }

    /// Landmarks of the graph with the number of their sightings: those that were seen often enough to be believed.
    pub fn landmarks(&self) -> impl Iterator<Item = (GraphLandmark, usize)> + '_ {
        let mut counts = vec![0; self.graph.landmarks().len()];
        self.graph.ties().iter().for_each(|tie| counts[tie.landmark.index()] += 1);
        let least = self.params.front.confirmations as usize;
        counts.into_iter().enumerate().filter(move |(_, n)| *n >= least).map(|(i, n)| (GraphLandmark(i as u32), n))
    }

    /// Covariance of a landmark's place in the graph as it was corrected last, in the axes of the map; none if it was not in it.
    pub fn landmark_covariance(&mut self, landmark: GraphLandmark) -> Option<Matrix2<f64>> {
        self.solver.landmark_covariance(landmark)
    }

    /// Landmark that each sighting of the last update was taken for, in their order.
    pub fn taken(&self) -> impl Iterator<Item = Option<GraphLandmark>> + '_ {
        self.front.outcomes().iter().map(|outcome| match outcome {
            SightingOutcome::Matched(key) | SightingOutcome::Added(key) => self.of_key.get(&key.number()).copied(),
            _ => None,
        })
    }

    /// Moves the vehicle by what odometry says.
    ///
    /// # Errors
    /// As [`LandmarkSlam::predict`].
    pub fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), Error> {
        let next = OdometryIncrement { covariance: self.front.covariance_of(odometry)?, ..*odometry };
        let motion = self.motion.map_or(next, |motion| motion.compose(&next));
        self.information_of(&motion)?;
        self.front.predict(odometry)?;
        self.motion = Some(motion);
        Ok(())
    }

    /// Information of a motion in the graph.
    pub(super) fn information_of(&self, motion: &OdometryIncrement) -> Result<Matrix3<f64>, Error> {
        let [way, turn] = self.params.least_sigmas.map(|sigma| sigma * sigma);
        let covariance = motion.covariance + Matrix3::from_diagonal(&[way, way, turn].into());
        let information = Se2::inverse_of(&covariance).filter(|_| motion.start_from_end.is_finite());
        let information = information.ok_or(Error::NotFinite { name: "information of a motion", value: f64::NAN })?;
        check::covariance("information of a motion", &information)?;
        Ok(information)
    }

    /// Takes in what was seen at one time. Without a motion since the last update it is taken in at the same pose.
    ///
    /// # Errors
    /// As [`LandmarkSlam::update`], and those of the solver; the graph is then as it was before it was to be corrected.
    pub fn update(&mut self, sightings: &[LandmarkSighting]) -> Result<LandmarkUpdate, Error> {
        let update = self.front.update(sightings)?;
        let poses = self.graph.poses().len();
        let pose = self.next_pose()?;
        for (sighting, outcome) in sightings.iter().zip(self.front.outcomes()) {
            let (SightingOutcome::Matched(key) | SightingOutcome::Added(key)) = outcome else { continue };
            let pose_guess = self.graph.poses()[pose.index()];
            let landmark = if let Some(&landmark) = self.of_key.get(&key.number()) {
                landmark
            } else {
                let Some(place) = first_guess(&self.front, key.number(), sighting, &pose_guess) else { continue };
                let landmark = self.graph.add_landmark(place)?;
                self.of_key.insert(key.number(), landmark);
                landmark
            };
            let (sighting, kernel) = (*sighting, self.params.kernel);
            self.graph.add_tie(Tie { pose, landmark, sighting, kernel })?;
        }
        if self.graph.poses().len() == poses {
            return Ok(update);
        }
        self.since += 1;
        if self.params.interval > 0 && self.since >= self.params.interval {
            self.optimize()?;
        }
        Ok(update)
    }

    /// Another pose, tied by the motion since the last one; without a motion the last one itself.
    fn next_pose(&mut self) -> Result<PoseId, Error> {
        let tied = match (self.last(), self.motion) {
            (Some(last), None) => return Ok(last),
            (Some(last), Some(motion)) => Some((last, motion.start_from_end, self.information_of(&motion)?)),
            (None, _) => None,
        };
        let pose = self.graph.add_pose(self.map_from_base())?;
        if let Some((last, start_from_end, information)) = tied {
            self.graph.add_relation(Relation::new(last, pose, start_from_end, information))?;
        }
        self.motion = None;
        Ok(pose)
    }

    /// Corrects the graph.
    ///
    /// # Errors
    /// Those of [`LandmarkGraphSolver::optimize`].
    pub fn optimize(&mut self) -> Result<LeastSquaresReport, Error> {
        self.graph.set_range_scale(self.front.range_scale().0)?;
        let report = self.solver.optimize(&mut self.graph)?;
        self.since = 0;
        Ok(report)
    }

    /// Corrects the graph, and makes landmarks one that are one, until none are left; how many those were. Two are if neither could be
    /// a third, and if the corrected graph bears it: twice the rise of its cost is within the chi-square of the pairs.
    ///
    /// # Errors
    /// Those of [`optimize`](Self::optimize).
    pub fn finish(&mut self) -> Result<usize, Error> {
        let (mut merged, mut refused, mut most) = (0, BTreeSet::new(), usize::MAX);
        let mut cost = self.optimize()?.cost;
        loop {
            let mut pairs = self.twins(&refused)?;
            pairs.truncate(most);
            if pairs.is_empty() {
                return Ok(merged);
            }
            let limit = chi_square_quantile(2.0 * pairs.len() as f64, self.params.merge_probability)?;
            let before = (self.graph.clone(), self.of_key.clone());
            let with = match self.merged(&pairs) {
                Ok(report) => report.cost,
                Err(error) => {
                    (self.graph, self.of_key) = before;
                    return Err(error);
                }
            };
            if 2.0 * (with - cost) <= limit {
                (merged, cost) = (merged + pairs.len(), with);
                continue;
            }
            (self.graph, self.of_key) = before;
            cost = self.optimize()?.cost;
            // All at once, or one by one.
            if pairs.len() == 1 {
                refused.extend(pairs);
            }
            most = 1;
        }
    }

    /// Makes each pair one landmark, and corrects the graph.
    fn merged(&mut self, pairs: &[Twins]) -> Result<LeastSquaresReport, Error> {
        for &(one, into) in pairs {
            self.graph.merge(one, into)?;
            self.of_key.values_mut().filter(|landmark| **landmark == one).for_each(|landmark| *landmark = into);
        }
        self.optimize()
    }

    /// Pairs of landmarks that may be one, neither of which may be another, but for those that were refused; the nearest first.
    fn twins(&mut self, refused: &BTreeSet<Twins>) -> Result<Vec<Twins>, Error> {
        let novelty = self.params.front.novelty_probability.max(self.params.merge_probability);
        let possible = chi_square_quantile(2.0, novelty)?;
        let limit = chi_square_quantile(2.0, self.params.merge_probability)?;
        let mut together = BTreeSet::new();
        // Ties are in the order of their poses.
        for seen in self.graph.ties().chunk_by(|a, b| a.pose == b.pose) {
            for a in seen {
                together.extend(seen.iter().map(|b| (a.landmark.min(b.landmark), a.landmark.max(b.landmark))));
            }
        }
        let landmarks: Vec<_> = self.landmarks().map(|(landmark, _)| landmark).collect();
        let mut found = Vec::new();
        for (i, &one) in landmarks.iter().enumerate() {
            let Some(own) = self.solver.landmark_covariance(one) else { continue };
            for &other in &landmarks[..i] {
                let way = self.graph.landmarks()[other.index()] - self.graph.landmarks()[one.index()];
                // Beyond what even landmarks without correlation could be apart.
                if together.contains(&(other, one)) || way.norm_squared() > 16.0 * possible * (own.trace() + 1e-2) {
                    continue;
                }
                let Some(covariance) = self.solver.relative_covariance(one, other) else { continue };
                let Some(inverse) = covariance.try_inverse() else { continue };
                let square = way.dot(&(inverse * way));
                if square <= possible {
                    found.push((square, one, other));
                }
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut partners = vec![0; self.graph.landmarks().len()];
        for side in found.iter().flat_map(|(_, one, other)| [one, other]) {
            partners[side.index()] += 1;
        }
        let only = |(square, one, other): &(f64, GraphLandmark, GraphLandmark)| {
            *square <= limit && partners[one.index()] == 1 && partners[other.index()] == 1
        };
        let pairs = found.into_iter().filter(only).map(|(_, one, other)| (one, other));
        Ok(pairs.filter(|pair| !refused.contains(pair)).collect())
    }
}

/// Two landmarks that may be one.
type Twins = (GraphLandmark, GraphLandmark);

/// Where a landmark lies that the filter added, as seen from the graph's pose; by the filter if a sighting does not tell.
fn first_guess(
    front: &LandmarkSlam,
    key: u32,
    sighting: &LandmarkSighting,
    map_from_base: &Se2,
) -> Option<nalgebra::Vector2<f64>> {
    if LandmarkGraph::places(&sighting.reading) {
        let (seen, _) = sighting.place(front.range_scale().0)?;
        return Some(map_from_base.compose(&sighting.base_from_sensor).act(&seen));
    }
    let place = *front.landmarks().find(|landmark| landmark.key.number() == key)?.place.mean();
    // The filter's map beside the graph's, by where the vehicle is in both.
    Some(map_from_base.act(&front.map_from_base().inverse().act(&place)))
}
