//! The mapper: one cloud after the other.

use super::{
    KeyFrame, KeyFrameMap, KeyFrameParams,
    closures::{CONTRADICTION, Closure, is_find, verify},
    drift::unseen,
    map::{Place, Tracked},
};
use crate::Error;
use agv_core::{
    check,
    geometry::{LieGroup, Se3, Twist3, UncertainPose},
    nalgebra::Vector3,
    roles::{LidarOdometryStep, Registration},
    sensors::{ConstantTwist, Deskew, PointCloud, VoxelGrid},
    solve::LevenbergMarquardtParams,
};
use agv_filters::graph::{PoseGraphSolver, PoseGraphSolverParams, Relation};
use agv_ndt::{
    places::{PlaceMatch, ScanContext},
    preprocess::one_of_every,
};

/// What the mapper made of a cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct KeyFrameStep {
    /// Where the vehicle is.
    pub map_from_base: Se3,
    /// What to correct the odometry by, from now on.
    pub map_from_odom: Se3,
    /// The key frame that the cloud became.
    pub key: Option<usize>,
    /// The older key frame that the cloud was found at, so that it became none itself.
    pub met: Option<usize>,
    /// Loop closures that were believed with it.
    pub closures: usize,
    /// Whether the poses of the map were corrected, as they are after each closure, and may be with a find that waits
    /// for others.
    pub corrected: bool,
}

/// Makes a map of key frames out of lidar odometry, and closes its loops; see the [module](super).
///
/// Key frames follow the odometry's motion: standing still makes none. Clouds with times are straightened by the motion
/// since the last one. A cloud that becomes a key frame, or is found at one, costs a few registrations, and a closure
/// solves the graph; others next to nothing. Memory grows by [`max_points`](KeyFrameParams::max_points) a key frame at
/// most, and by a pose a cloud; where the vehicle comes by a place again there is no further key frame
/// ([`reach`](KeyFrameParams::reach)). Deterministic, for any number of threads of the parts.
///
/// ```
/// use agv_core::{nalgebra::Vector3, roles::LidarOdometry, sensors::PointCloud};
/// use agv_nav::ndt::{loam::{LoamOdometry, LoamParams}, ndt::{NdtParams, NdtRegistration, VoxelParams}};
/// use agv_nav::pipeline::mapping::{KeyFrameMapper, KeyFrameParams};
///
/// let place = |i: i32| i as f32 * 0.1 - 5.0;
/// let sheet = |f: fn(f32, f32) -> [f32; 3]| (0..10_000).map(move |i| f(place(i % 100), place(i / 100)));
/// let walls = sheet(|a, b| [a, -5.0, b + 4.0]).chain(sheet(|a, b| [5.0, a, b + 4.0]));
/// let hall: Vec<_> = sheet(|a, b| [a, b, -1.0]).chain(walls).collect();
/// let seen_from = |x: f32| PointCloud::from_points(hall.iter().map(|p| Vector3::from(*p) - Vector3::new(x, 0.0, 0.0)));
///
/// let mut odometry = LoamOdometry::new(LoamParams::default())?;
/// let mut mapper = KeyFrameMapper::new(NdtRegistration::new(NdtParams::default())?, KeyFrameParams::default())?;
/// for i in 0..8 {
///     let cloud = seen_from(0.2 * i as f32);
///     let step = odometry.process(&cloud, None)?;
///     mapper.process(&step, &cloud)?;
/// }
/// assert_eq!(mapper.map().key_frames().len(), 2);
/// let tiles = mapper.map().tiles(VoxelParams::default(), 32)?;
/// assert_eq!(tiles.loaded().count(), 4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct KeyFrameMapper<R> {
    map: KeyFrameMap,
    registration: R,
    solver: PoseGraphSolver<Se3>,
    scratch: Scratch,
}

/// What came of looking for a key frame among older ones.
#[derive(Debug, Clone, Copy, Default)]
struct Found {
    /// Closures that are believed and do not contradict the rest; none if no pose was corrected.
    closures: Option<usize>,
    /// The one that shows it where an older key frame stands already.
    known: Option<Closure>,
}

/// What is written anew for each key frame.
#[derive(Debug)]
struct Scratch {
    grid: VoxelGrid,
    source_grid: VoxelGrid,
    straight: PointCloud,
    thinned: PointCloud,
    source: PointCloud,
    target: PointCloud,
    moved: PointCloud,
    context: ScanContext,
    matches: Vec<PlaceMatch>,
}

impl<R: Registration> KeyFrameMapper<R> {
    /// A mapper without a cloud, whose loops are verified by a registration.
    ///
    /// # Errors
    /// A parameter out of its range, by name.
    pub fn new(registration: R, params: KeyFrameParams) -> Result<Self, Error> {
        Self::resume(registration, KeyFrameMap::new(params)?)
    }

    /// A mapper that goes on with a map: with the same registration, to the same bits as if it had not stopped.
    ///
    /// # Errors
    /// None that a map that was accepted has.
    pub fn resume(registration: R, map: KeyFrameMap) -> Result<Self, Error> {
        let solver = PoseGraphSolverParams::default();
        let descent = LevenbergMarquardtParams { cost_tolerance: 1e-6, max_iterations: 20, ..solver.descent };
        let scratch = Scratch {
            grid: VoxelGrid::new(map.params.leaf as f32)?,
            source_grid: VoxelGrid::new(map.params.source_leaf as f32)?,
            straight: PointCloud::default(),
            thinned: PointCloud::default(),
            source: PointCloud::default(),
            target: PointCloud::default(),
            moved: PointCloud::default(),
            context: ScanContext::default(),
            matches: Vec::new(),
        };
        let solver = PoseGraphSolver::new(PoseGraphSolverParams { descent, ..solver })?;
        Ok(Self { map, registration, solver, scratch })
    }

    /// What it knows.
    pub const fn map(&self) -> &KeyFrameMap {
        &self.map
    }

    /// What it knew in the end.
    pub fn into_map(self) -> KeyFrameMap {
        self.map
    }

    /// Takes a cloud and what the odometry made of it.
    ///
    /// # Errors
    /// A pose that is not finite, or a stamp before the last one: the map is then as it was. What the registration
    /// refuses, and a graph that memory has no room for: the cloud is then taken in, but closes no loop.
    pub fn process(&mut self, step: &LidarOdometryStep, cloud: &PointCloud) -> Result<KeyFrameStep, Error> {
        let (stamp, odom_from_base) = (cloud.stamp(), step.odom_from_base);
        check::all_finite("odom_from_base", odom_from_base.translation().iter())?;
        check::all_finite("odom_from_base", odom_from_base.rotation().matrix().iter())?;
        let mut twist = None;
        let key_from_base = UncertainPose::exact(odom_from_base);
        let mut tracked = Tracked { stamp, odom_from_base, key_from_base, kept_from_base: None, since: stamp };
        let (mut way, mut doubt) = (self.map.way, self.map.doubt);
        if let Some(last) = &self.map.tracked {
            if stamp < last.stamp {
                let (earlier_ns, later_ns) = (last.stamp.nanoseconds(), stamp.nanoseconds());
                return Err(agv_core::Error::TimeBackwards { earlier_ns, later_ns }.into());
            }
            let motion = last.odom_from_base.between(&odom_from_base);
            check::all_finite("motion", motion.translation().iter())?;
            twist = velocity(&motion, stamp - last.stamp, cloud);
            let gone = self.map.params.drift.of(&motion, step.alignment.as_ref());
            tracked.since = last.since;
            tracked.key_from_base = last.key_from_base.compose(&gone);
            tracked.kept_from_base = last.kept_from_base.map(|kept| kept.compose(&gone));
            let moved = motion.translation().norm();
            way += moved;
            doubt += moved * self.map.params.loops.growth.max(unseen(step.alignment.as_ref()).trace().min(1.0));
        }
        let is_key = self.is_key(&tracked.key_from_base, stamp - tracked.since);
        let key = is_key.then(|| self.prepare(cloud, twist)).transpose()?.flatten();
        // Nothing fails from here on but sums that overflow.
        self.map.tracked = Some(tracked);
        (self.map.way, self.map.doubt) = (way, doubt);
        let followed = self.map.followed;
        self.map.trajectory.push(Place { stamp, key: followed, key_from_base: *tracked.key_from_base.mean() });
        let (mut made, mut met, mut closures) = (None, None, None);
        if let Some(key) = key {
            let number = self.add(key, &tracked)?;
            let found = self.close_loops();
            let known = found.as_ref().ok().and_then(|found| found.known);
            if let Some(closure) = known {
                self.map.forget_last(&closure, &tracked)?;
                met = Some(closure.from as usize);
            } else {
                self.map.keep_last(&self.scratch.context);
                made = Some(number);
            }
            closures = found?.closures;
        }
        Ok(KeyFrameStep {
            map_from_base: self.map.map_from_base(),
            map_from_odom: self.map.map_from_odom(),
            key: made,
            met,
            closures: closures.unwrap_or(0),
            corrected: closures.is_some(),
        })
    }

    /// Whether the vehicle has come far enough for a key frame.
    fn is_key(&self, key_from_base: &UncertainPose<Se3>, seconds: f64) -> bool {
        if self.map.keys.is_empty() {
            return true;
        }
        let KeyFrameParams { distance, turn, time, .. } = self.map.params;
        let motion = key_from_base.mean();
        let share = (motion.translation().norm() / distance).max(motion.rotation().log().norm() / turn);
        let is_late = time.is_some_and(|time| seconds >= time);
        share >= if is_late { 0.1 } else { 1.0 }
    }

    /// The key frame that a cloud would be; none with too few points.
    fn prepare(&mut self, cloud: &PointCloud, twist: Option<Twist3>) -> Result<Option<KeyFrame>, Error> {
        let KeyFrameParams { min_range, max_range, min_points, max_points, .. } = self.map.params;
        let Scratch { grid, source_grid, straight, thinned, source, context, .. } = &mut self.scratch;
        if let Some(twist) = twist {
            Deskew::cloud_into(cloud, &ConstantTwist::spatial(cloud.stamp(), &twist)?, straight);
        } else {
            straight.copy_from(cloud);
        }
        straight.crop_range(min_range as f32, max_range as f32)?;
        straight.transform(&cloud.base_from_sensor());
        grid.filter_into(straight, thinned);
        if thinned.len() < min_points {
            return Ok(None);
        }
        // Evenly, so that no side is blind, and in no step with the order of the cubes.
        let few = one_of_every(thinned.len().div_ceil(max_points), thinned.len());
        let (x, y, z) = (thinned.x(), thinned.y(), thinned.z());
        let cloud = PointCloud::from_points(few.map(|i| Vector3::new(x[i], y[i], z[i]))).with_stamp(cloud.stamp());
        source_grid.filter_into(&cloud, source);
        self.map.places.describe_into(&cloud, context);
        Ok(Some(KeyFrame { cloud, way: 0.0 }))
    }

    /// Makes a key frame a pose of the graph, which is not followed yet.
    fn add(&mut self, key: KeyFrame, tracked: &Tracked) -> Result<usize, Error> {
        let map = &mut self.map;
        let number = map.keys.len();
        let previous = map.graph.poses().get(map.followed as usize).copied();
        let key_from_base = tracked.key_from_base.mean();
        let here = previous.map_or(*key_from_base, |key| key.compose(key_from_base));
        map.graph.add_pose(here)?;
        if let Err(error) = map.relate_last(tracked) {
            map.graph.pop_pose();
            return Err(error);
        }
        if previous.is_none() {
            // Places before this one were told from the origin, which this key frame is not.
            for place in &mut map.trajectory {
                place.key_from_base = here.between(&place.key_from_base);
            }
        }
        let since = key.cloud.stamp();
        map.keys.push(KeyFrame { way: map.way, ..key });
        map.tracked = map.tracked.map(|tracked| Tracked { since, ..tracked });
        Ok(number)
    }

    /// Seeks closures of the last key frame.
    fn close_loops(&mut self) -> Result<Found, Error> {
        let mut found: Vec<Closure> = Vec::new();
        let Self { map, registration, scratch, .. } = self;
        let Scratch { source, target, moved, context, matches, .. } = scratch;
        for candidate in map.around() {
            found.extend(verify(map, registration, source, &candidate, target, moved)?);
        }
        if !found.iter().any(|closure| map.is_expected(closure)) {
            for candidate in map.look_alikes(context, matches) {
                found.extend(verify(map, registration, source, &candidate, target, moved)?);
            }
        }
        let Some(closure) = map.unambiguous(&found) else { return Ok(Found::default()) };
        let before = map.graph.poses().to_vec();
        let explained = map.explains(&mut self.solver, &closure)?;
        let believed = if explained { map.believed(&closure) } else { Vec::new() };
        if believed.is_empty() {
            // To explain it the graph was solved, which may have gone on where the last solution stopped.
            return Ok(Found { closures: (map.graph.poses() != before).then_some(0), known: None });
        }
        let added: Vec<Relation<Se3>> = believed.iter().map(Closure::relation).collect();
        for relation in &added {
            map.graph.add_relation(*relation)?;
        }
        self.solve().inspect_err(|_| {
            // As if they had not been found.
            self.map.graph.retain_relations(|relation| !added.contains(relation));
        })?;
        let is_kept = |closure: &Closure| self.map.graph.relations().contains(&closure.relation());
        let kept = believed.iter().filter(|closure| is_kept(closure)).count();
        // Along what a find leaves open it says nothing.
        if believed.iter().any(|closure| closure.is_whole() && is_kept(closure)) {
            self.map.doubt = 0.0;
        }
        let known = Some(closure).filter(|closure| is_kept(closure) && self.map.is_known(closure));
        Ok(Found { closures: Some(kept), known })
    }

    /// Moves all poses to where the relations fit best, and takes out closures that contradict the rest.
    fn solve(&mut self) -> Result<(), Error> {
        let graph = &mut self.map.graph;
        self.solver.optimize(graph)?;
        let poses = graph.poses().to_vec();
        let count = graph.relations().len();
        graph.retain_relations(|relation| {
            if !is_find(relation) {
                return true;
            }
            let predicted = poses[relation.from.index()].between(&poses[relation.to.index()]);
            let error = relation.from_from_to.between(&predicted).log();
            error.dot(&(relation.information * error)) <= CONTRADICTION
        });
        if graph.relations().len() < count {
            self.solver.optimize(graph)?;
        }
        Ok(())
    }
}

/// The velocity that a cloud of some duration is straightened with, if the motion lasted long enough to tell it.
fn velocity(motion: &Se3, seconds: f64, cloud: &PointCloud) -> Option<Twist3> {
    let times = cloud.time()?.iter().map(|time| time.abs()).filter(|time| *time <= 1.0);
    let sweep = f64::from(times.fold(0.0, f32::max));
    if seconds <= 0.0 || seconds < 0.5 * sweep {
        return None;
    }
    let tangent = motion.log() / seconds;
    let (linear, angular) = (tangent.fixed_rows::<3>(0).into_owned(), tangent.fixed_rows::<3>(3).into_owned());
    Some(Twist3 { linear, angular })
}
