//! Finds what moves in the scans of one or more lasers, and follows it.

use super::{
    Assignment, ConstantVelocity, Outline, ScanClusters, TrackerParams,
    track::Track,
    views::{View, Views},
};
use agv_core::{
    Error, check,
    geometry::{Se2, Twist2},
    grid::{CellState, DistanceParams, DistanceTransform, Grid},
    metrics::chi_square_quantile,
    obstacle::MovingObstacle,
    sensors::{BodyMotion, ConstantTwist, Deskew, LaserScan, ScanGeometry},
    time::Stamp,
};
use nalgebra::Matrix4;

#[cfg(feature = "serde")]
mod checkpoint;
mod cycle;

/// A thing that is followed, moving or not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedObstacle {
    /// Place, velocity and outline.
    pub obstacle: MovingObstacle,
    /// Covariance of `(x, y, vx, vy)`, in metres and seconds.
    pub covariance: Matrix4<f64>,
    /// Standard deviation of its radius, in metres.
    pub radius_sigma: f64,
    /// Whether it moves.
    pub moving: bool,
    /// Scans that showed it.
    pub hits: u32,
    /// Seconds since the last of them.
    pub unseen_for: f64,
}

/// Tracks obstacles through the scans of one or more lasers, and tells what moves.
///
/// Each scan falls into clusters, each cluster small enough has an [`Outline`], and outlines belong to tracks by the assignment
/// of least squared Mahalanobis distance in place and size. A track is a Kalman filter of nearly constant velocity
/// ([`ConstantVelocity`]).
///
/// A track moves when its velocity is significant ([`speed_confidence`](TrackerParams::speed_confidence),
/// [`min_speed`](TrackerParams::min_speed)) and in several scans either three points of its surface lie where a scan from a quarter
/// to one and a half of a [`memory`](TrackerParams::memory) ago saw through, or of the places where its surface was then some are seen through now.
/// Surfaces that stand still do neither, whatever part of them is in sight. It stops moving when that ceases.
///
/// Call [`update`](Self::update) with each scan of each laser, in the order of their stamps; what several lasers see of one thing
/// comes to one track. Same input, same bits; after warm-up nothing is allocated.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::tracking::{ObstacleTracker, TrackerParams};
///
/// // Somebody of 0.3 m radius crosses 4 m ahead at 1 m/s, before a wall 8 m away.
/// let geometry = ScanGeometry::default();
/// let mut tracker = ObstacleTracker::new(TrackerParams::default())?;
/// for step in 0..40 {
///     let time = 0.05 * f64::from(step);
///     let person = Vector2::new(4.0, time - 1.0);
///     let range = |beam: usize| {
///         let (sin, cos) = geometry.angle(beam).sin_cos();
///         let (along, across) = (person.x * cos + person.y * sin, person.y * cos - person.x * sin);
///         if along > 0.0 && across.abs() < 0.3 { along - (0.09 - across * across).sqrt() } else { 8.0 }
///     };
///     let ranges = (0..1081).map(|beam| range(beam) as f32).collect();
///     tracker.update(&LaserScan::new(Stamp::from_seconds(time), geometry, ranges)?, &Se2::default())?;
/// }
/// let [person] = tracker.obstacles() else { panic!("one thing moves") };
/// assert!((person.velocity - Vector2::new(0.0, 1.0)).norm() < 0.1);
/// assert!((person.position - Vector2::new(4.0, 0.95)).norm() < 0.05 && (person.radius - 0.3).abs() < 0.03);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ObstacleTracker {
    params: TrackerParams,
    model: ConstantVelocity,
    /// Greatest squared distance of an outline from its track, and least normalised square of a velocity.
    gate: f64,
    speed_limit: f64,
    /// Distance to the static map's obstacles.
    explained: Option<Grid<f32>>,
    tracks: Vec<Track>,
    next_id: u64,
    now: Option<Stamp>,
    views: Views,
    /// The scan of the present update, as if taken at once.
    scan: LaserScan,
    present: View,
    deskew: Deskew,
    /// Scans of lasers that sweep, as if taken at once: one for each.
    flat: Vec<LaserScan>,
    clusters: ScanClusters,
    /// Outlines of the clusters that are small enough, and which clusters these are.
    outlines: Vec<(usize, Outline)>,
    assignment: Assignment,
    pairs: Vec<(usize, usize, f64)>,
    taken: Vec<bool>,
    obstacles: Vec<MovingObstacle>,
    moving_beams: Vec<bool>,
}

/// Most seconds by which a scan may be older than the last.
const LATE: f64 = 0.1;

/// Distance from what moves within which a hit belongs to it, in metres.
const STRAY: f64 = 0.1;

/// Seconds after which a track that should be in sight, and is not, is given up.
const GIVE_UP: f64 = 0.25;

impl ObstacleTracker {
    /// A tracker that has seen nothing yet.
    ///
    /// # Errors
    /// The first parameter out of its range.
    pub fn new(params: TrackerParams) -> Result<Self, Error> {
        params.validate()?;
        let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), Vec::new())?;
        Ok(Self {
            params,
            model: ConstantVelocity::new(params.wander)?,
            gate: chi_square_quantile(3.0, params.gate_probability)?,
            speed_limit: chi_square_quantile(2.0, params.speed_confidence)?,
            explained: None,
            tracks: Vec::new(),
            next_id: 1,
            now: None,
            views: Views::default(),
            present: View::new(Stamp::default(), &Se2::default(), &scan),
            scan,
            deskew: Deskew::default(),
            flat: Vec::new(),
            clusters: ScanClusters::new(params.clusters)?,
            outlines: Vec::new(),
            assignment: Assignment::default(),
            pairs: Vec::new(),
            taken: Vec::new(),
            obstacles: Vec::new(),
            moving_beams: Vec::new(),
        })
    }

    /// The same tracker for vehicles that know a map: hits near its obstacles belong to them.
    ///
    /// # Errors
    /// A map that is too long for a [`DistanceTransform`].
    pub fn with_static_map(mut self, map: &Grid<CellState>) -> Result<Self, Error> {
        let params =
            DistanceParams { max_distance: Some(2.0 * self.params.map_tolerance), ..DistanceParams::default() };
        self.explained = Some(DistanceTransform::new(params)?.compute(map)?);
        Ok(self)
    }

    /// The parameters that were given.
    pub const fn params(&self) -> &TrackerParams {
        &self.params
    }

    /// Takes a scan that was taken at once, with the base at `map_from_base`, and returns what moves, by its state at the scan's
    /// stamp.
    ///
    /// A scan without hits lets the tracks coast. O(beams × what moves + tracks × clusters), and an [`Assignment`] of those near each
    /// other.
    ///
    /// # Errors
    /// A pose that is not finite or farther than 1e6 m, or [`Error::TimeBackwards`] for a scan more than 0.1 s older than the
    /// last (less is taken as of the last one's time); the tracker is then as it was.
    pub fn update(&mut self, scan: &LaserScan, map_from_base: &Se2) -> Result<&[MovingObstacle], Error> {
        let still = ConstantTwist::planar(scan.stamp(), &Twist2::ZERO)?;
        self.update_along(scan, map_from_base, &still)
    }

    /// As [`update`](Self::update), for a vehicle that moves while it scans: `map_from_base` is where it is at the motion's
    /// reference time, for which the obstacles are then told.
    ///
    /// # Errors
    /// As [`update`](Self::update).
    pub fn update_along(
        &mut self,
        scan: &LaserScan,
        map_from_base: &Se2,
        motion: &impl BodyMotion<Se2>,
    ) -> Result<&[MovingObstacle], Error> {
        check::all_finite("map_from_base", &[map_from_base.x(), map_from_base.y(), map_from_base.yaw()])?;
        check::in_range("map_from_base (m)", map_from_base.translation().amax(), 0.0, 1e6)?;
        let reference = motion.reference();
        let dt = self.now.map_or(0.0, |now| reference - now);
        if let Some(now) = self.now
            && dt < -LATE
        {
            let (earlier_ns, later_ns) = (now.nanoseconds(), reference.nanoseconds());
            return Err(Error::TimeBackwards { earlier_ns, later_ns });
        }
        self.take_at_once(scan, motion)?;
        let dt = dt.max(0.0);
        let now = self.now.map_or(reference, |now| now.max(reference));
        self.now = Some(now);
        self.present.retake(now, map_from_base, &self.scan);
        let (model, coast_time) = (self.model, self.params.coast_time);
        self.tracks.retain_mut(|track| now - track.seen <= coast_time && track.predict(model, dt));
        self.see(map_from_base);
        self.associate(map_from_base, now, dt);
        self.judge(now);
        self.views.remember(now, map_from_base, &self.scan, self.params.memory);
        self.obstacles.clear();
        self.obstacles.extend(self.tracks.iter().filter(|track| track.moving).map(Track::obstacle));
        self.mark_strays();
        Ok(&self.obstacles)
    }

    /// What moves, by its state at the last scan's time, in the order in which it was found.
    pub fn obstacles(&self) -> &[MovingObstacle] {
        &self.obstacles
    }

    /// All that is followed, moving or not.
    pub fn tracks(&self) -> impl Iterator<Item = TrackedObstacle> + '_ {
        let now = self.now.unwrap_or_default();
        self.tracks.iter().map(move |track| TrackedObstacle {
            obstacle: track.obstacle(),
            covariance: *track.filter.covariance(),
            radius_sigma: track.radius.1.sqrt(),
            moving: track.moving,
            hits: track.hits,
            unseen_for: now - track.seen,
        })
    }

    /// The last scan as if taken at once, for a [`RollingCostmap`](agv_core::grid::RollingCostmap).
    pub const fn scan(&self) -> &LaserScan {
        &self.scan
    }

    /// Whether a beam of [`scan`](Self::scan) ended on something that moves, or within 0.1 m of it: it should not be marked in a
    /// map of what stands.
    pub fn is_moving_beam(&self, beam: usize) -> bool {
        self.moving_beams.get(beam).copied().unwrap_or(false)
    }

    /// Forgets all tracks and scans, as after a jump of the vehicle's estimate; identities go on.
    pub fn reset(&mut self) {
        self.tracks.clear();
        self.views.clear();
        self.obstacles.clear();
        self.moving_beams.clear();
        self.now = None;
    }

    fn take_at_once(&mut self, scan: &LaserScan, motion: &impl BodyMotion<Se2>) -> Result<(), Error> {
        if scan.geometry().time_increment <= 0.0 {
            self.scan.copy_masked(scan, |_| true);
            return Ok(());
        }
        let geometry = ScanGeometry { time_increment: 0.0, ..*scan.geometry() };
        let known = self.flat.iter().position(|flat| *flat.geometry() == geometry && flat.len() == scan.len());
        let index = known.unwrap_or(self.flat.len());
        if known.is_none() {
            self.flat.retain(|flat| flat.sensor() != scan.sensor());
            self.flat.push(LaserScan::new(scan.stamp(), geometry, vec![f32::NAN; scan.len()])?);
        }
        let last = self.flat.len().saturating_sub(1);
        if let Some(flat) = self.flat.get_mut(index.min(last)) {
            self.deskew.scan_into(scan, motion, flat)?;
            self.scan.copy_masked(flat, |_| true);
        }
        Ok(())
    }

    /// Beams that graze a thing's edge are often in none of its clusters.
    fn mark_strays(&mut self) {
        for (point, &beam) in self.clusters.points().iter().zip(self.clusters.beams()) {
            if let Some(moving) = self.moving_beams.get_mut(beam) {
                *moving |= self.obstacles.iter().any(|obstacle| obstacle.distance_after(0.0, point) < STRAY);
            }
        }
    }

    /// Something that was seen once or twice and then no more was nothing.
    fn judge(&mut self, now: Stamp) {
        let (confirm_hits, give_up) = (self.params.confirm_hits, GIVE_UP);
        self.tracks.retain(|track| track.hits >= confirm_hits || now - track.seen <= give_up);
    }
}
