//! The whole: one scan after the other.

use super::{
    GraphSlamParams,
    closures::{self, Closure, Seeker},
    key_scan::{KeyScan, gather, noise, usable_points_into},
    params::Driven,
};
use crate::{
    graph::{PoseGraph, PoseGraphSolver, PoseGraphSolverParams, PoseId, Relation},
    matching::{CorrelativeMatcher, SearchWindow, Squares},
};
use agv_core::{
    Error, check,
    compute::Par,
    geometry::{LieGroup, PoseSigma, Se2},
    roles::{Alignment, AlignmentError, Termination},
    sensors::LaserScan,
    solve::{LevenbergMarquardtParams, RobustKernel},
    time::Stamp,
};
use nalgebra::Vector2;
use std::collections::BTreeSet;

/// How a scan found its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum TrackingOutcome {
    /// It fits the target from where it was expected.
    Matched,
    /// It fits after a search of the window.
    Searched,
    /// It does not fit anywhere near: the pose is odometry's, or goes on as before.
    DeadReckoning,
    /// It has too few readings to say anything; as [`DeadReckoning`](Self::DeadReckoning).
    TooFewReadings,
    /// It is the first scan, which the map begins at.
    First,
}

/// What became of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SlamStep {
    /// Pose of the vehicle in the map.
    pub map_from_base: Se2,
    /// How it was found.
    pub outcome: TrackingOutcome,
    /// The match in the frame of the last key scan: score, information, and the directions that it does not see.
    pub alignment: Alignment<Se2>,
    /// The key scan that it became.
    pub key: Option<PoseId>,
    /// Loop closures that were believed with it.
    pub closures: usize,
    /// Whether the poses of the map were corrected, as they are after each closure.
    pub corrected: bool,
}

/// A scan's place, relative to a key scan so that it follows when that is corrected.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Place {
    pub(super) stamp: Stamp,
    pub(super) key: u32,
    pub(super) key_from_base: Se2,
}

/// Graph SLAM in the plane; see the [module](super).
///
/// Deterministic, for any number of threads. A state that was stored continues with the same bits (feature `serde`).
///
/// ```
/// use agv_core::{geometry::Se2, sensors::{LaserScan, ScanGeometry}, time::Stamp};
/// use agv_filters::slam::graph::{GraphSlam, GraphSlamParams};
///
/// // A corner of a room, from where odometry says that we are: it is right, but for 3 cm.
/// let geometry = ScanGeometry { angle_min: -0.5, angle_increment: 0.01, ..Default::default() };
/// let mut slam = GraphSlam::new(GraphSlamParams::default())?;
/// for step in 0..20 {
///     let x = 0.1 * f64::from(step);
///     let beam = |a: f64| ((4.0 - x) / a.cos().max(1e-9)).min(3.0 / a.sin().max(1e-9)) as f32;
///     let scan = LaserScan::new(Stamp::default(), geometry, (0..200).map(|i| beam(geometry.angle(i))).collect())?;
///     let odometry = Se2::new(x + 0.03 * f64::from(step % 2), 0.0, 0.0);
///     let step = slam.process(&scan, Some(&odometry))?;
///     assert!((step.map_from_base.x() - x).abs() < 0.02);
/// }
/// assert!(slam.keys() > 3 && slam.map()?.layout().width() > 64);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "super::checkpoint::RawGraphSlam")
)]
pub struct GraphSlam {
    pub(super) params: GraphSlamParams,
    #[cfg_attr(feature = "serde", serde(serialize_with = "super::checkpoint::store_keys"))]
    pub(super) keys: Vec<KeyScan>,
    pub(super) graph: PoseGraph<Se2>,
    pub(super) way: Vec<Place>,
    /// Key scan in whose frame the target lies.
    pub(super) anchor: u32,
    pub(super) anchor_from_base: Se2,
    /// Way since the start, in metres.
    pub(super) path: f64,
    /// Way at the last closure.
    pub(super) tied: f64,
    pub(super) drive: u32,
    /// Whether the map stays as it is.
    pub(super) frozen: bool,
    pub(super) last_odometry: Option<Se2>,
    /// Motion over the last scan.
    pub(super) last_motion: Se2,
    /// Motion since the last key scan by odometry; none if a part is missing.
    pub(super) since_key: Option<Driven>,
    pub(super) pending: Vec<Closure>,
    /// Key scans that a believed closure relates: the older one, the newer one.
    pub(super) closed: BTreeSet<(u32, u32)>,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(super) derived: Derived,
}

/// What follows from the rest, and memory.
#[derive(Debug)]
pub(super) struct Derived {
    pub(super) front: CorrelativeMatcher,
    pub(super) solver: PoseGraphSolver<Se2>,
    pub(super) par: Par,
    pub(super) squares: Squares,
    pub(super) points: Vec<Vector2<f64>>,
    pub(super) target: Vec<Vector2<f64>>,
    pub(super) seekers: Vec<Seeker>,
}

impl Derived {
    pub(super) fn new(params: &GraphSlamParams) -> Result<Self, Error> {
        let solver = PoseGraphSolverParams::default();
        let descent = LevenbergMarquardtParams { cost_tolerance: 1e-6, max_iterations: 20, ..solver.descent };
        Ok(Self {
            front: CorrelativeMatcher::new(params.matcher)?,
            solver: PoseGraphSolver::new(PoseGraphSolverParams { descent, ..solver })?,
            par: Par::Seq,
            squares: Vec::new(),
            points: Vec::new(),
            target: Vec::new(),
            seekers: Vec::new(),
        })
    }
}

/// No search: the match starts where it is expected.
const HERE: SearchWindow = SearchWindow { distance: 0.0, angle: 0.0 };

/// Standard deviations of a motion of which neither match nor odometry says anything.
const UNKNOWN_MOTION: PoseSigma = PoseSigma { translation: 0.5, rotation: 0.3 };

/// How closures count: their residual's square up to so many standard deviations, and linearly beyond.
pub(super) const CLOSURE_KERNEL: RobustKernel = RobustKernel::Huber { scale: 3.0 };

/// How odometry counts beside a match: wheels that slip far beyond what they are trusted with pull next to nothing, however far that is.
/// The pull is greatest at three standard deviations.
const SLIP_KERNEL: RobustKernel = RobustKernel::GemanMcClure { scale: 5.0 };

/// A match stands in for odometry if it is worth this share of it in every direction: at most twice its deviation.
const STAND_IN: f64 = 0.25;

impl GraphSlam {
    /// SLAM without a map, on the calling thread.
    ///
    /// # Errors
    /// As [`GraphSlamParams::validate`].
    pub fn new(params: GraphSlamParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            params,
            keys: Vec::new(),
            graph: PoseGraph::new(),
            way: Vec::new(),
            anchor: 0,
            anchor_from_base: Se2::default(),
            path: 0.0,
            tied: 0.0,
            drive: 0,
            frozen: false,
            last_odometry: None,
            last_motion: Se2::default(),
            since_key: Some(Driven::default()),
            pending: Vec::new(),
            closed: BTreeSet::new(),
            derived: Derived::new(&params)?,
        })
    }

    /// The same, seeking loop closures on several threads; the results do not depend on it.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.derived.par = par;
        self
    }

    /// Takes a scan, and where the vehicle is in the odometry's frame, if there is odometry.
    ///
    /// About linear in the scan's beams, but for scans that become key scans: those also seek loop closures, and a closure solves the
    /// graph.
    ///
    /// # Errors
    /// An odometry that is not finite; the state is then as it was. [`Error::TooMany`] for a graph that memory has no room for; the scan
    /// is then taken in, but loops are not closed.
    pub fn process(&mut self, scan: &LaserScan, odom_from_base: Option<&Se2>) -> Result<SlamStep, AlignmentError> {
        if let Some(pose) = odom_from_base {
            check::all_finite("odom_from_base", &[pose.x(), pose.y(), pose.yaw()])?;
        }
        let mut points = std::mem::take(&mut self.derived.points);
        usable_points_into(scan, &self.params, &mut self.derived.squares, &mut points);
        let done = self.take(scan, &points, odom_from_base);
        self.derived.points = points;
        done
    }

    fn take(
        &mut self,
        scan: &LaserScan,
        points: &[Vector2<f64>],
        odom_from_base: Option<&Se2>,
    ) -> Result<SlamStep, AlignmentError> {
        let motion = self.last_odometry.zip(odom_from_base).map(|(last, now)| last.between(now));
        let motion = motion.filter(|motion| self.params.odometry.believes(motion));
        let enough = points.len() >= self.params.matcher.min_points;
        if self.keys.is_empty() {
            self.last_odometry = odom_from_base.copied();
            return self.begin(scan, enough);
        }
        let guess = self.anchor_from_base.compose(&motion.unwrap_or(self.last_motion));
        let mut outcome = TrackingOutcome::TooFewReadings;
        let mut alignment = Alignment::unknown(guess, Termination::TooFewPoints);
        if enough {
            (outcome, alignment) = self.track(points, &guess)?;
        }
        // Nothing fails from here on but sums that overflow.
        self.last_odometry = odom_from_base.copied();
        let pose = alignment.target_from_source;
        self.last_motion = self.anchor_from_base.between(&pose);
        self.anchor_from_base = pose;
        self.path += self.last_motion.translation().norm();
        self.since_key = self.since_key.zip(motion).map(|(driven, motion)| driven.and(&motion));
        let mut step = SlamStep {
            map_from_base: self.map_from_base(),
            outcome,
            alignment,
            key: None,
            closures: 0,
            corrected: false,
        };
        let off = self.anchor_from_base;
        let is_far = off.translation().norm() >= self.params.key_distance || off.yaw().abs() >= self.params.key_angle;
        self.way.push(Place { stamp: scan.stamp(), key: self.anchor, key_from_base: off });
        if self.frozen {
            self.follow()?;
        } else if is_far && enough {
            self.add_key(scan, points, &mut step)?;
        }
        Ok(step)
    }

    /// The first scan.
    fn begin(&mut self, scan: &LaserScan, enough: bool) -> Result<SlamStep, AlignmentError> {
        let mut step = SlamStep {
            map_from_base: Se2::default(),
            outcome: TrackingOutcome::TooFewReadings,
            alignment: Alignment::unknown(Se2::default(), Termination::TooFewPoints),
            key: None,
            closures: 0,
            corrected: false,
        };
        let params = GraphSlamParams { matcher: self.params.matcher.widened_for(noise(scan)), ..self.params };
        let key = KeyScan::new(scan.clone(), self.path, self.drive, &params);
        // Wider cells leave fewer points.
        if enough && key.points.len() >= params.matcher.min_points {
            let mut front = CorrelativeMatcher::new(params.matcher)?;
            front.set_points(&key.points)?;
            step.key = Some(self.graph.add_pose(Se2::default())?);
            step.outcome = TrackingOutcome::First;
            self.derived.front = front;
            self.derived.seekers.clear();
            self.params = params;
            self.keys.push(key);
        }
        // Until the first scan that says something, the vehicle is where the map begins.
        self.way.push(Place { stamp: scan.stamp(), key: 0, key_from_base: Se2::default() });
        Ok(step)
    }

    /// Where a scan fits the target.
    fn track(
        &mut self,
        points: &[Vector2<f64>],
        guess: &Se2,
    ) -> Result<(TrackingOutcome, Alignment<Se2>), AlignmentError> {
        let GraphSlamParams { good_fit, matcher, .. } = self.params;
        let front = &mut self.derived.front;
        let near = front.match_points(points, guess, HERE, 0.0)?;
        if near.converged() && near.inlier_ratio >= good_fit {
            return Ok((TrackingOutcome::Matched, near));
        }
        let found = front.match_points(points, guess, matcher.window, 0.0)?;
        let worth = |found: &Alignment<Se2>| if found.converged() { found.score } else { -1.0 };
        // Where a corridor has no ends, the search takes any place along it.
        Ok(if worth(&found) > 1.1 * worth(&near) && found.converged() {
            (TrackingOutcome::Searched, found)
        } else if near.converged() {
            (TrackingOutcome::Matched, near)
        } else {
            (TrackingOutcome::DeadReckoning, Alignment::unknown(*guess, near.termination))
        })
    }

    /// Makes the last scan a pose of the graph.
    fn add_key(
        &mut self,
        scan: &LaserScan,
        points: &[Vector2<f64>],
        step: &mut SlamStep,
    ) -> Result<(), AlignmentError> {
        let (from, motion) = (PoseId(self.anchor), self.anchor_from_base);
        let to = self.graph.add_pose(self.map_from_base())?;
        self.keys.push(KeyScan::with_points(scan.clone(), points, self.path, self.drive));
        let matched = matches!(step.outcome, TrackingOutcome::Matched | TrackingOutcome::Searched)
            .then(|| {
                // Where there is odometry, it alone says what the match does not see.
                let worth =
                    if self.since_key.is_some() { closures::seen_information } else { closures::matched_information };
                worth(&step.alignment, &self.params)
            })
            .flatten();
        if let Some(information) = matched {
            self.graph.add_relation(Relation::new(from, to, motion, information))?;
        }
        if let Some(driven) = self.since_key {
            let information = self.params.odometry.information(&driven);
            let relation = Relation::new(from, to, driven.motion, information);
            // Odometry is let go only where the match stands in for all of it: along a corridor it is all that there is.
            let is_spare = matched.is_some_and(|seen| (seen - information * STAND_IN).cholesky().is_some());
            self.graph.add_relation(if is_spare { relation.with_kernel(SLIP_KERNEL) } else { relation })?;
        } else if matched.is_none() {
            let information = super::params::information(UNKNOWN_MOTION);
            self.graph.add_relation(Relation::new(from, to, motion, information))?;
        }
        self.since_key = Some(Driven::default());
        (self.anchor, self.anchor_from_base) = (to.0, Se2::default());
        if let Some(place) = self.way.last_mut() {
            (place.key, place.key_from_base) = (to.0, Se2::default());
        }
        step.key = Some(to);
        let closed = self.close_and_solve(step);
        // Whatever came of it, the target is that of the new anchor.
        self.aim()?;
        closed
    }

    fn close_and_solve(&mut self, step: &mut SlamStep) -> Result<(), AlignmentError> {
        step.closures = self.close_loops()?;
        if step.closures > 0 {
            self.solve()?;
            step.corrected = true;
            step.map_from_base = self.map_from_base();
        }
        Ok(())
    }

    /// Makes the target anew: the last key scans, in the frame of the anchor; the anchor alone where these are too far apart for one
    /// target.
    pub(super) fn aim(&mut self) -> Result<(), Error> {
        let poses = self.graph.poses();
        let anchor = self.anchor as usize;
        let Some(map_from_anchor) = poses.get(anchor) else { return Ok(()) };
        let chain = self.chain();
        let mut target = std::mem::take(&mut self.derived.target);
        gather(chain.iter().map(|&i| (&self.keys[i], &poses[i])), map_from_anchor, &mut target);
        let mut aimed = self.derived.front.set_points(&target);
        if matches!(aimed, Err(Error::TooMany { .. })) {
            aimed = self.derived.front.set_points(&self.keys[anchor].points);
        }
        self.derived.target = target;
        aimed
    }
}
