//! Driving in a mapped site.

use super::InertialOdometry;
use crate::{
    Error,
    pipeline::{Navigation, NavigationRequest, NavigationStatus},
};
use agv_core::{
    geometry::{Se2, Se3},
    grid::{LocalMap, LocalMapParams, RollingCostmap},
    kinematics::{Motion, MotionLimits},
    odometry::OdometryIncrement,
    roles::{
        Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, PoseEstimate, SkipReason, UpdateOutcome,
        VehicleState,
    },
    sensors::{ImuSample, LaserScan, PointCloud},
};
use agv_ndt::{convert::CloudToScan, ndt::NdtLocalizer};

/// How a vehicle sees what its map does not know.
#[derive(Debug, Clone)]
pub struct CsnsSight {
    /// Presses clouds flat.
    pub to_scan: CloudToScan,
    /// A scan of the geometry that they are pressed into.
    pub scan: LaserScan,
    /// The costs around the vehicle, over the site's grid.
    pub costmap: RollingCostmap,
}

/// What to drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CsnsCommand {
    /// For the next `dt` seconds; it respects the limits.
    pub motion: Motion,
    /// How the navigation fares; none while the vehicle does not know where it is, and brakes.
    pub status: Option<NavigationStatus>,
}

/// Localises and navigates in a mapped site: [`sense`](Self::sense) at the rate of the wheels, [`command`](Self::command) at that of
/// the planner.
pub struct Csns {
    odometry: InertialOdometry,
    localizer: NdtLocalizer,
    sight: CsnsSight,
    local: LocalMap,
    navigation: Navigation,
    limits: MotionLimits,
    /// Whether the vehicle knew where it is when it last sensed: what was seen before is seen from elsewhere.
    knows: bool,
}

impl Csns {
    /// A system of its parts.
    ///
    /// # Errors
    /// Limits that cannot be some, or a costmap that is too long for a distance transform.
    pub fn new(
        odometry: InertialOdometry,
        localizer: NdtLocalizer,
        sight: CsnsSight,
        local: LocalMapParams,
        navigation: Navigation,
        limits: MotionLimits,
    ) -> Result<Self, Error> {
        limits.validate()?;
        let local = LocalMap::new(sight.costmap.costmap(), local)?;
        Ok(Self { odometry, localizer, sight, local, navigation, limits, knows: false })
    }

    /// Tells where the vehicle starts.
    ///
    /// # Errors
    /// What the localizer refuses.
    pub fn start(&mut self, belief: &PoseBelief<Se3>) -> Result<(), Error> {
        self.localizer.initialize(belief)?;
        self.knows = false;
        Ok(())
    }

    /// Sets out for a goal, from the next command on.
    ///
    /// # Errors
    /// A goal that is not finite.
    pub fn go_to(&mut self, goal: &Se2) -> Result<(), Error> {
        self.navigation.go_to(goal)
    }

    /// Takes what the sensors say of a time step, and says what became of the cloud, if there was one.
    ///
    /// While the vehicle knows where it is, every cloud is looked through for obstacles that can be related to the time of the
    /// estimate, whether it fits the map or not: people around a lidar are why it does not. What was seen before a vehicle was lost
    /// is forgotten when it knows again.
    ///
    /// # Errors
    /// What the filter, the localizer or the conversion refuse; readings before the refused one are taken in.
    pub fn sense<'a>(
        &mut self,
        wheels: &OdometryIncrement,
        imu: impl IntoIterator<Item = &'a ImuSample>,
        cloud: Option<&PointCloud>,
    ) -> Result<Option<UpdateOutcome>, Error> {
        if let Some(motion) = self.odometry.update(wheels, imu)? {
            self.localizer.predict(&motion)?;
        }
        let outcome = cloud.map(|cloud| self.localizer.update(cloud)).transpose()?;
        let knew = self.knows;
        self.knows = self.status() == LocalizationStatus::Tracking;
        if self.knows && !knew {
            self.sight.costmap.reset()?;
            self.local.update(self.sight.costmap.costmap())?;
        }
        if self.knows && outcome.as_ref().is_some_and(is_straightened) {
            self.look_around()?;
        }
        Ok(outcome)
    }

    /// Marks what the last cloud shows.
    fn look_around(&mut self) -> Result<(), Error> {
        let estimate = self.localizer.estimate().ok_or(LocalizationError::NotInitialized)?;
        let CsnsSight { to_scan, scan, costmap } = &mut self.sight;
        to_scan.convert_into(self.localizer.straightened(), scan)?;
        costmap.update([&*scan], &estimate.map_from_base().to_planar())?;
        self.local.update(costmap.costmap())?;
        Ok(())
    }

    /// The motion for the next `dt` seconds, given the one now. Unless its localizer is tracking, the vehicle brakes.
    ///
    /// # Errors
    /// What the navigation refuses.
    pub fn command(&mut self, now: Motion, dt: f64) -> Result<CsnsCommand, Error> {
        let is_tracking = self.status() == LocalizationStatus::Tracking;
        let Some(estimate) = self.localizer.estimate().filter(|_| is_tracking) else {
            return Ok(CsnsCommand { motion: self.limits.brake(&now, dt)?, status: None });
        };
        let Motion { twist, steering } = now;
        let state = VehicleState { map_from_base: estimate.map_from_base().to_planar(), twist, steering };
        let request = NavigationRequest { state, map: &self.local, obstacles: &[], limits: &self.limits, dt };
        let command = self.navigation.cycle(request)?;
        if command.forget_map {
            self.sight.costmap.reset()?;
            self.local.update(self.sight.costmap.costmap())?;
        }
        Ok(CsnsCommand { motion: command.motion, status: Some(command.status) })
    }

    /// Where the vehicle is; none before [`start`](Self::start).
    pub fn estimate(&self) -> Option<PoseEstimate<Se3>> {
        self.localizer.estimate()
    }

    /// How far that can be trusted.
    pub fn status(&self) -> LocalizationStatus {
        self.localizer.status()
    }

    /// The navigation, with the path that is followed.
    pub const fn navigation(&self) -> &Navigation {
        &self.navigation
    }

    /// The costs around the vehicle.
    pub const fn costmap(&self) -> &RollingCostmap {
        &self.sight.costmap
    }
}

/// Whether the localizer has straightened the cloud that it said this of, and holds no older one.
const fn is_straightened(outcome: &UpdateOutcome) -> bool {
    !matches!(outcome, UpdateOutcome::Skipped(SkipReason::Duplicate | SkipReason::OutsideHistory { .. }))
}
