//! From a goal to twists in a known map: localise, plan once, track.
//!
//! ```text
//! odometry -> Localizer.predict --+
//! scan ----> Localizer.update ----+--> estimate --> PathTracker.command --> twist
//! goal ----> GlobalPlanner.plan_into (from the estimate) --> path --^
//! ```

use crate::Error;
use agv_core::{
    check,
    geometry::Se2,
    grid::Costmap,
    kinematics::{Motion, MotionLimits},
    odometry::OdometryIncrement,
    path::Path,
    roles::{
        Correct, GlobalPlanner, LocalizationError, LocalizationStatus, PathTracker, PlanOutcome, PoseBelief,
        PoseEstimate, TrackCommand, TrackError, UpdateOutcome, VehicleState,
    },
    sensors::LaserScan,
};

/// What one cycle brought.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NavigationStep {
    /// Where the vehicle is.
    pub estimate: PoseEstimate<Se2>,
    /// What became of the scan; none if there was none in this cycle.
    pub correction: Option<UpdateOutcome>,
    /// What to drive next, and how far along the path the vehicle is; none before the first goal.
    pub command: Option<TrackCommand>,
}

/// Drives to goals in a known map.
///
/// ```
/// use agv_nav::{control::track::*, core::grid::*, filters::particle::*, nalgebra::Matrix3};
/// use agv_nav::{pipeline::Navigator, plan::grid::*, prelude::*};
/// use agv_sim::{Body, GridWorld, Laser, LaserParams, Simulator2d, Vehicle, VehicleParams};
///
/// // A room of 8 m by 6 m.
/// let layout = GridLayout::new(160, 120, 0.05, Se2::default())?;
/// let is_wall = |c: Cell| c.x % 159 == 0 || c.y % 119 == 0;
/// let state = |i| if is_wall(layout.cell(i)) { CellState::Occupied } else { CellState::Free };
/// let map = Grid::new(layout, (0..layout.len()).map(state).collect())?;
///
/// let field = LikelihoodField::new(&map, LikelihoodFieldParams::default())?;
/// let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
/// let motion = DifferentialOdometryModel::new(OdometryNoise::default())?;
/// let mcl = Mcl::new(motion, sensor, FreeSpace::new(&map, 0.2)?, MclParams::default(), Seed(7))?;
/// let costmap = Inflation::new(InflationParams::default())?.inflate(&map)?;
/// let (astar, tracker) = (AStar::new(AStarParams::default())?, PurePursuit::new(PurePursuitParams::default())?);
/// let limits = MotionLimits::default();
/// let mut navigator = Navigator::new(Box::new(mcl), Box::new(astar), Box::new(tracker), costmap, limits)?;
///
/// let (start, goal, dt) = (Se2::new(2.0, 2.0, 0.0), Se2::new(6.0, 4.0, 0.0), 0.05);
/// assert!(navigator.go_to(&goal).is_err(), "nobody knows yet where the vehicle is");
/// navigator.start(&PoseBelief::around(start, Matrix3::identity() * 0.01)?)?;
/// navigator.go_to(&goal)?;
///
/// let vehicle = Vehicle::new(VehicleParams::default(), start, Seed(1))?;
/// let laser = Laser::new(LaserParams::default(), Seed(2))?;
/// let mut robot = Simulator2d::new(GridWorld::new(&map), vehicle, Body::circle(0.2)?, dt)?.with_laser(laser, 1)?;
/// let mut motion = Motion::REST;
/// let arrived = (0..1000).any(|_| {
///     let seen = robot.step(&motion.twist).unwrap();
///     let step = navigator.cycle(&seen.odometry, seen.scan(), motion, dt).unwrap();
///     let command = step.command.unwrap();
///     motion = command.motion;
///     command.status == TrackStatus::Arrived
/// });
/// let error = robot.vehicle().map_from_base().translation() - goal.translation();
/// assert!(arrived && error.norm() < 0.2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Navigator {
    localizer: Box<dyn Correct<LaserScan, Pose = Se2> + Send>,
    planner: Box<dyn GlobalPlanner + Send>,
    tracker: Box<dyn PathTracker + Send>,
    costmap: Costmap,
    limits: MotionLimits,
    path: Path,
}

impl Navigator {
    /// A navigator from its parts; `costmap` is what the planner sees, inflated for the vehicle.
    ///
    /// # Errors
    /// Limits that cannot be some.
    pub fn new(
        localizer: Box<dyn Correct<LaserScan, Pose = Se2> + Send>,
        planner: Box<dyn GlobalPlanner + Send>,
        tracker: Box<dyn PathTracker + Send>,
        costmap: Costmap,
        limits: MotionLimits,
    ) -> Result<Self, Error> {
        limits.validate()?;
        Ok(Self { localizer, planner, tracker, costmap, limits, path: Path::new() })
    }

    /// Tells where the vehicle starts.
    ///
    /// # Errors
    /// What the localizer refuses.
    pub fn start(&mut self, belief: &PoseBelief<Se2>) -> Result<(), Error> {
        Ok(self.localizer.initialize(belief)?)
    }

    /// Plans from the present estimate to `goal` and follows the path from the next cycle on.
    ///
    /// The vehicle arrives with the heading that the planner's path ends with, for a grid planner that of the goal. If there is no
    /// path, the old one is kept and the outcome says why there is none.
    ///
    /// # Errors
    /// [`LocalizationError::NotInitialized`] before [`start`](Self::start), [`TrackError::NoPath`] for a goal where the vehicle
    /// is already, and what else the planner or the tracker refuses; the old path is kept.
    pub fn go_to(&mut self, goal: &Se2) -> Result<PlanOutcome, Error> {
        let start = *self.known()?.map_from_base();
        let mut path = Path::new();
        let outcome = self.planner.plan_into(&self.costmap, &start, goal, &mut path)?;
        if let PlanOutcome::Found { .. } = outcome {
            self.tracker.set_path(&path)?;
            self.path = path;
        }
        Ok(outcome)
    }

    /// Takes what the sensors say of the last `dt` seconds and returns what to drive for the next.
    ///
    /// `motion` is the velocity now, in the base frame, and the steering angle of a vehicle that steers.
    ///
    /// # Errors
    /// What the localizer or the tracker refuses. A motion or a `dt` that cannot be one changes nothing.
    pub fn cycle(
        &mut self,
        odometry: &OdometryIncrement,
        scan: Option<&LaserScan>,
        motion: Motion,
        dt: f64,
    ) -> Result<NavigationStep, Error> {
        // Before the localizer moves.
        VehicleState { steering: motion.steering, ..VehicleState::new(Se2::default(), motion.twist) }.validate()?;
        check::positive("dt", dt)?;
        self.localizer.predict(odometry)?;
        let correction = scan.map(|scan| self.localizer.update(scan)).transpose()?;
        let estimate = self.known()?;
        let Motion { twist, steering } = motion;
        let state = VehicleState { map_from_base: *estimate.map_from_base(), twist, steering };
        // Without a path there is nothing to track, and the localizer has moved already.
        let command = match self.tracker.command(&state, &self.limits, dt) {
            Err(TrackError::NoPath) => None,
            command => Some(command?),
        };
        Ok(NavigationStep { estimate, correction, command })
    }

    /// The path that is being followed; empty before the first goal.
    pub const fn path(&self) -> &Path {
        &self.path
    }

    /// Where the vehicle is; none before [`start`](Self::start).
    pub fn estimate(&self) -> Option<PoseEstimate<Se2>> {
        self.localizer.estimate()
    }

    fn known(&self) -> Result<PoseEstimate<Se2>, LocalizationError> {
        self.localizer.estimate().ok_or(LocalizationError::NotInitialized)
    }

    /// How far that can be trusted.
    pub fn status(&self) -> LocalizationStatus {
        self.localizer.status()
    }

    /// Replaces what the planner sees, from the next [`go_to`](Self::go_to) on; the path that is followed stays.
    pub fn set_costmap(&mut self, costmap: Costmap) {
        self.costmap = costmap;
    }

    /// What the planner sees.
    pub const fn costmap(&self) -> &Costmap {
        &self.costmap
    }
}
