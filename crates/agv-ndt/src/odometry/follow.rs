//! Odometry by any registration: each cloud is aligned with the local map of those before it.

use super::{MotionPrior, PointMap};
use crate::Error;
use agv_core::{
    check,
    geometry::{LieGroup, Se3, So3, Twist3},
    roles::{Alignment, AlignmentError, LidarOdometry, LidarOdometryStep, Registration, Termination},
    sensors::{ConstantTwist, Deskew, LidarReturn, PointCloud, VoxelGrid},
    time::Stamp,
};
use nalgebra::Vector3;

/// How far the vehicle goes before the map forgets, as a share of its radius.
const SLIDE: f64 = 0.1;

/// Clouds in a row that fit nowhere, after which the map is begun anew where the prediction is.
const GIVE_UP: usize = 5;

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

/// Follows a lidar by a [`Registration`] against a sliding map of points.
///
/// The map is handed to the registration anew for each cloud, so that its target's cost counts; [`LoamOdometry`] has a map that grows
/// in place. Clouds with times are deskewed by the motion that is expected. The map keeps the mean of all clouds' points per cube.
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
    registration: R,
    grid: VoxelGrid,
    /// The cloud without skew, then in the base frame, and thinned out.
    straight: PointCloud,
    source: PointCloud,
    map: PointMap,
    target: PointCloud,
    center: Vector3<f64>,
    prior: Option<MotionPrior>,
    lost: usize,
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
        Ok(Self {
            registration,
            grid: VoxelGrid::new(params.source_leaf as f32)?,
            straight: PointCloud::default(),
            source: PointCloud::default(),
            map: PointMap::new(params.map_leaf)?,
            target: PointCloud::default(),
            center: Vector3::zeros(),
            prior: None,
            lost: 0,
            params,
        })
    }

    /// The parameters.
    pub const fn params(&self) -> &FollowParams {
        &self.params
    }

    /// The map, in the frame of the first cloud.
    pub const fn map(&self) -> &PointMap {
        &self.map
    }

    /// Puts the cloud where the base is at its stamp, given the motion in `seconds`; thinned out.
    fn place(&mut self, cloud: &PointCloud, motion: &Se3, seconds: f64) -> Result<(), AlignmentError> {
        if cloud.time().is_some() && seconds > 0.0 {
            let twist = motion.log() / seconds;
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

    /// Takes the cloud into the map, and hands that to the registration; a map that it refuses is not a target.
    fn remember(&mut self, pose: &Se3) {
        for point in self.straight.points() {
            self.map.insert(&pose.act(&point.cast()));
        }
        if (pose.translation() - self.center).norm() > SLIDE * self.params.radius {
            self.center = pose.translation();
            self.map.retain_around(&self.center, self.params.radius);
        }
        // Around the centre, so that `f32` serves far from the origin.
        let place = |point: Vector3<f64>| LidarReturn { position: (point - self.center).cast(), ..Default::default() };
        self.target.refill(Stamp::default(), self.map.points().map(place));
    }

    fn track(&mut self, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        let odom_from_target = Se3::from_parts(self.center, So3::default());
        if self.registration.set_target(&self.target).is_err() {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        let mut found = self.registration.align(&self.source, &odom_from_target.between(guess))?;
        found.target_from_source = odom_from_target.compose(&found.target_from_source);
        Ok(found)
    }
}

impl<R: Registration> LidarOdometry for Follow<R> {
    fn process(&mut self, cloud: &PointCloud, prior: Option<&Se3>) -> Result<LidarOdometryStep, AlignmentError> {
        if let Some(prior) = prior {
            check::all_finite("prior", prior.translation().iter())?;
            check::all_finite("prior", prior.rotation().matrix().iter())?;
        }
        let stamp = cloud.stamp();
        let Some(mut state) = self.prior else {
            self.place(cloud, &Se3::identity(), 0.0)?;
            self.remember(&Se3::identity());
            self.prior = Some(MotionPrior::new(stamp, 0.0));
            return Ok(LidarOdometryStep { odom_from_base: Se3::identity(), alignment: None });
        };
        let (origin, seconds) = (state.pose(), state.seconds_to(stamp));
        let predicted = prior.copied().unwrap_or_else(|| state.motion_until(stamp));
        check::all_finite("predicted position", origin.compose(&predicted).translation().iter())?;
        self.place(cloud, &predicted, seconds)?;
        let mut found = self.track(&origin.compose(&predicted))?;
        if !found.converged() {
            // The prediction may be what is wrong: once more from where the vehicle was.
            let other = self.track(&origin)?;
            if (other.converged(), other.inlier_ratio) > (found.converged(), found.inlier_ratio) {
                found = other;
            }
        }
        let usable = found.converged() || found.termination == Termination::Degenerate;
        let pose = if usable { found.target_from_source } else { origin.compose(&predicted) };
        self.lost = if usable { 0 } else { self.lost + 1 };
        if self.lost >= GIVE_UP {
            self.map.clear();
        }
        if usable || self.map.is_empty() {
            self.remember(&pose);
        }
        state.advance(stamp, &pose);
        self.prior = Some(state);
        Ok(LidarOdometryStep { odom_from_base: pose, alignment: Some(found) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gicp::{PointMetric, PointParams, PointRegistration};
    use crate::ndt::{NdtParams, NdtRegistration};
    use crate::scenes::{ROOM, cloud, sheets};
    use agv_core::{geometry::Se2, roles::laws};

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
