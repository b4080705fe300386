//! Odometry by any registration: each cloud is aligned with the local map of those before it.

use super::tracker::{Matcher, Tracked, Tracker};
use super::{PointMap, Window};
use crate::Error;
use agv_core::{
    check,
    geometry::{LieGroup, Se3, So3, Twist3},
    roles::{AlignmentError, LidarOdometry, LidarOdometryStep, Registration, Termination},
    sensors::{ConstantTwist, Deskew, LidarReturn, PointCloud, VoxelGrid},
    time::Stamp,
};
use nalgebra::{Vector3, Vector6};

/// What an odometry by registration may be told.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FollowParams {
    /// Edge of the cubes of which each cloud gives one point, in metres.
    pub source_leaf: f64,
    /// Edge of the cubes of which the map keeps one point, in metres.
    pub map_leaf: f64,
    /// Distance from the vehicle up to which the map is kept, in metres.
    pub radius: f64,
    /// Points nearer than this are the vehicle's own, in metres.
    pub min_range: f64,
}

impl Default for FollowParams {
    /// Leaves for methods that pair points; 100 m is paper 003's local map.
    fn default() -> Self {
        Self { source_leaf: 0.3, map_leaf: 0.25, radius: 100.0, min_range: 0.5 }
    }
}

impl FollowParams {
    /// For methods whose target is a distribution per voxel of a metre: it wants a point per decimetre, and the source four to its edge.
    #[must_use]
    pub fn for_distributions() -> Self {
        Self { source_leaf: 0.25, map_leaf: 0.1, ..Self::default() }
    }
}

/// Follows a lidar by a [`Registration`] against a sliding map of points.
///
/// The map is handed to the registration anew after each cloud, so that its target's cost counts; [`LoamOdometry`] has a map that grows
/// in place. Clouds with times are deskewed by the motion that is expected, and again if another is found. The map keeps the mean of each cube's latest 64 points or so.
/// Directions that the cloud does not fix keep the prediction: a registration is taken at its word that what ends as
/// [`Degenerate`](Termination::Degenerate) is a good fit along the others. Those of this crate end as
/// [`PoorFit`](Termination::PoorFit) or [`TooFewPoints`](Termination::TooFewPoints) if it is not.
///
/// [`LoamOdometry`]: crate::loam::LoamOdometry
///
/// ```
/// use agv_core::{nalgebra::Vector3, roles::LidarOdometry, sensors::PointCloud};
/// use agv_ndt::gicp::{PointParams, PointRegistration};
/// use agv_ndt::odometry::{Follow, FollowParams};
///
/// let sheet = |f: fn(f32, f32) -> [f32; 3]| (0..10_000).map(move |i| f((i % 100) as f32 * 0.1 - 5.0, (i / 100) as f32 * 0.1 - 5.0));
/// let hall: Vec<_> = sheet(|a, b| [a, b, -1.0]).chain(sheet(|a, b| [a, -5.0, b + 4.0])).chain(sheet(|a, b| [5.0, a, b + 4.0])).collect();
/// let seen_from = |x: f32| PointCloud::from_points(hall.iter().map(|p| Vector3::from(*p) - Vector3::new(x, 0.0, 0.0)));
///
/// let mut odometry = Follow::new(PointRegistration::new(PointParams::default())?, FollowParams::default())?;
/// odometry.process(&seen_from(0.0), None)?;
/// let step = odometry.process(&seen_from(0.2), None)?;
/// assert!((step.odom_from_base.translation() - Vector3::new(0.2, 0.0, 0.0)).norm() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Follow<R> {
    params: FollowParams,
    tracker: Tracker,
    matcher: MapMatcher<R>,
}

/// The map, and what is matched with it.
#[derive(Debug, Clone)]
struct MapMatcher<R> {
    params: FollowParams,
    registration: R,
    grid: VoxelGrid,
    /// The cloud without skew, then in the base frame, and thinned out.
    straight: PointCloud,
    source: PointCloud,
    map: PointMap,
    target: PointCloud,
    /// Whether the registration has taken the map.
    has_target: bool,
    window: Window,
}

impl<R: Registration> Follow<R> {
    /// An odometry that has not seen anything.
    ///
    /// # Errors
    /// A parameter out of its range, by name.
    pub fn new(registration: R, params: FollowParams) -> Result<Self, Error> {
        check::positive("radius", params.radius)?;
        check::in_range("min_range", params.min_range, 0.0, params.radius)?;
        check::in_range("source_leaf", params.source_leaf, 0.01, 10.0)?;
        check::in_range("map_leaf", params.map_leaf, 0.01, 100.0)?;
        let matcher = MapMatcher {
            params,
            registration,
            grid: VoxelGrid::new(params.source_leaf as f32)?,
            straight: PointCloud::default(),
            source: PointCloud::default(),
            map: PointMap::new(params.map_leaf)?,
            target: PointCloud::default(),
            has_target: false,
            window: Window::new(params.radius),
        };
        // Registrations have a reach of their own, so that no deviation is reckoned with.
        Ok(Self { params, tracker: Tracker::new(0.0), matcher })
    }

    /// The parameters.
    pub const fn params(&self) -> &FollowParams {
        &self.params
    }

    /// The map, in the frame of the first cloud.
    pub const fn map(&self) -> &PointMap {
        &self.matcher.map
    }

    /// Forgets the drive; the next cloud is the first one.
    pub fn reset(&mut self) {
        self.tracker = Tracker::new(0.0);
        self.matcher.forget();
    }
}

impl<R: Registration> Matcher for MapMatcher<R> {
    fn place(&mut self, cloud: &PointCloud, velocity: Option<&Vector6<f64>>) -> Result<(), AlignmentError> {
        if let Some(twist) = velocity {
            let (linear, angular) = (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned());
            let twist = Twist3 { linear, angular };
            Deskew::cloud_into(cloud, &ConstantTwist::spatial(cloud.stamp(), &twist)?, &mut self.straight);
        } else {
            self.straight.copy_from(cloud);
        }
        self.straight.crop_range(self.params.min_range as f32, self.params.radius as f32)?;
        self.straight.transform(&cloud.base_from_sensor());
        self.grid.filter_into(&self.straight, &mut self.source);
        Ok(())
    }

    fn placed(&self) -> (usize, f64) {
        let (count, sum) = (self.source.len(), self.source.points().map(|point| f64::from(point.norm())).sum::<f64>());
        (count, sum / count.max(1) as f64)
    }

    fn has_map(&self) -> bool {
        self.has_target
    }

    fn track(&mut self, guess: &Se3, _sigma: f64) -> Result<Tracked, AlignmentError> {
        if !self.has_target {
            return Ok(Tracked::nothing(guess));
        }
        let odom_from_target = Se3::from_parts(self.window.center(), So3::default());
        let mut alignment = self.registration.align(&self.source, &odom_from_target.between(guess))?;
        alignment.target_from_source = odom_from_target.compose(&alignment.target_from_source);
        // A fit that leaves directions free is a good one along the others: those keep the prediction.
        let is_usable = alignment.converged() || alignment.termination == Termination::Degenerate;
        Ok(Tracked { alignment, is_usable, is_clear: alignment.converged() })
    }

    /// Also hands the map to the registration; one that it refuses is not a target.
    fn remember(&mut self, pose: &Se3) {
        for point in self.straight.points() {
            self.map.insert(&pose.act(&point.cast()));
        }
        let here = pose.translation();
        if let Some(radius) = self.window.slides(&here) {
            self.map.retain_around(&here, radius);
        }
        // Around the centre, so that `f32` serves far from the origin.
        let center = self.window.center();
        let place = |point: Vector3<f64>| LidarReturn { position: (point - center).cast(), ..Default::default() };
        self.target.refill(Stamp::default(), self.map.points().map(place));
        self.has_target = self.registration.set_target(&self.target).is_ok();
    }

    fn forget(&mut self) {
        self.map.clear();
        self.window.recenter();
        self.has_target = false;
    }
}

impl<R: Registration> LidarOdometry for Follow<R> {
    fn process(&mut self, cloud: &PointCloud, prior: Option<&Se3>) -> Result<LidarOdometryStep, AlignmentError> {
        self.tracker.step(&mut self.matcher, cloud, prior)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gicp::{PointMetric, PointParams, PointRegistration};
    use crate::ndt::{DistributionRegistration, NdtParams, NdtRegistration};
    use crate::scenes::{CORRIDOR, ROOM, cloud, sheets};
    use agv_core::{geometry::Se2, roles::laws, sensors::PointSource};

    fn seen(pose: &Se3, draw: u32) -> PointCloud {
        cloud(&sheets(&ROOM, 60.0, draw), pose)
    }

    fn check(registration: &(impl Registration + Clone), bound: f64) {
        let params = FollowParams { source_leaf: 0.25, ..FollowParams::default() };
        let follow = || Follow::new(registration.clone(), params).unwrap();
        let step = |i: u32| Se3::from(Se2::new(0.15, 0.05, 0.06)).log() * f64::from(i);
        laws::lidar_odometry(&mut follow(), &seen(&Se3::identity(), 0), &seen(&Se3::exp(&step(1)), 1)).unwrap();
        let mut odometry = follow();
        for i in 0..8 {
            let pose = Se3::exp(&step(i));
            let found = odometry.process(&seen(&pose, i), None).unwrap();
            assert!(pose.between(&found.odom_from_base).log().norm() < bound, "{i}: {found:?}");
        }
    }

    #[test]
    fn every_registration_follows_and_keeps_the_laws() {
        check(&PointRegistration::new(PointParams::default()).unwrap(), 0.02);
        let plane = PointParams { metric: PointMetric::PointToPlane, ..PointParams::default() };
        check(&PointRegistration::new(plane).unwrap(), 0.02);
        check(&NdtRegistration::new(NdtParams::default()).unwrap(), 0.02);
    }

    /// A vehicle that stands in a room, while its lidar is covered but for a few points.
    #[test]
    fn clouds_that_are_nearly_blind_move_neither_the_pose_nor_the_map() {
        fn stand(registration: impl Registration) {
            let mut odometry =
                Follow::new(registration, FollowParams { source_leaf: 0.25, ..Default::default() }).unwrap();
            for draw in 0..4 {
                odometry.process(&seen(&Se3::identity(), draw), None).unwrap();
            }
            let room = seen(&Se3::identity(), 5);
            for (count, place) in [1, 5, 20, 40].into_iter().flat_map(|count| [(count, 1), (count, 3)]) {
                let few = (0..count).map(|i| room.point(place + i * (room.len() - 9) / count));
                odometry.process(&seen(&Se3::identity(), 6), None).unwrap();
                let points = odometry.map().len();
                let step = odometry.process(&PointCloud::from_points(few), None).unwrap();
                assert_eq!(step.alignment.unwrap().termination, Termination::TooFewPoints, "{count}");
                assert!(step.odom_from_base.log().norm() < 0.02, "{count}: {step:?}");
                assert_eq!(odometry.map().len(), points, "{count}");
            }
            let step = odometry.process(&room, None).unwrap();
            assert!(step.alignment.unwrap().converged() && step.odom_from_base.log().norm() < 0.01, "{step:?}");
        }
        stand(NdtRegistration::new(NdtParams::default()).unwrap());
        stand(DistributionRegistration::new(NdtParams::default()).unwrap());
        for metric in [PointMetric::PointToPlane, PointMetric::Generalized, PointMetric::Voxelized] {
            stand(PointRegistration::new(PointParams { metric, ..PointParams::default() }).unwrap());
        }
    }

    /// ... also where the last drive went farther than the map's window does at once.
    #[test]
    fn after_a_reset_a_drive_has_the_bits_of_a_first_one() {
        let params = FollowParams { source_leaf: 0.25, radius: 15.0, ..FollowParams::default() };
        let mut odometry = Follow::new(NdtRegistration::new(NdtParams::default()).unwrap(), params).unwrap();
        let mut drive = || {
            odometry.reset();
            // There and almost back again, so that the window follows twice.
            let places = [0.0, 0.9, 1.8, 0.9, 0.25];
            let poses = places.iter().zip(0..).map(|(&x, i)| {
                let moved = x - if i == 0 { 0.0 } else { places[i as usize - 1] };
                let (pose, prior) = (Se3::from(Se2::new(x, 0.0, 0.0)), Se3::from(Se2::new(moved, 0.0, 0.0)));
                odometry.process(&seen(&pose, i), Some(&prior)).unwrap().odom_from_base
            });
            poses.collect::<Vec<_>>()
        };
        let first = drive();
        assert!((first[4].translation().x - 0.25).abs() < 0.02, "{}", first[4].translation());
        assert_eq!(drive(), first);
    }

    #[test]
    fn along_a_corridor_the_prior_is_kept() {
        fn walk(registration: impl Registration) {
            let shift = |x: f64, y: f64, yaw: f64| Se3::from(Se2::new(x, y, yaw));
            let (pose, prior) = (shift(0.5, 0.05, 0.0), shift(0.43, 0.0, 0.02));
            let mut odometry = Follow::new(registration, FollowParams::default()).unwrap();
            odometry.process(&cloud(&sheets(&CORRIDOR, 20.0, 0), &Se3::identity()), None).unwrap();
            let step = odometry.process(&cloud(&sheets(&CORRIDOR, 20.0, 1), &pose), Some(&prior)).unwrap();
            let found = step.odom_from_base.translation();
            assert!((step.alignment.unwrap().unobserved.trace() - 1.0).abs() < 1e-6, "{step:?}");
            assert!((found.x - 0.43).abs() < 0.01, "{found}");
            assert!((found.y - 0.05).abs() < 0.03 && found.z.abs() < 0.03, "{found}");
        }
        walk(NdtRegistration::new(NdtParams::default()).unwrap());
        walk(PointRegistration::new(PointParams::default()).unwrap());
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = FollowParams::default();
        for bad in [
            FollowParams { source_leaf: 0.0, ..good },
            FollowParams { map_leaf: f64::NAN, ..good },
            FollowParams { radius: -1.0, ..good },
            FollowParams { min_range: 101.0, ..good },
        ] {
            let registration = PointRegistration::new(PointParams::default()).unwrap();
            assert!(Follow::new(registration, bad).is_err(), "{bad:?}");
        }
    }
}
