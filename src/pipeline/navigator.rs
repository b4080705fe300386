//! From a goal to twists in a known map: localise, plan once, track.
//!
//! ```text
//! odometry -> Localizer.predict --+
//! scan ----> Localizer.update ----+--> estimate --> PathTracker.command --> twist
//! goal ----> GlobalPlanner.plan_into (from the estimate) --> path --^
//! ```

use crate::Error;
use agv_core::{
    geometry::{Se2, Twist2},
    grid::Costmap,
    kinematics::TwistLimits,
    odometry::OdometryIncrement,
    path::Path,
    roles::{
        Correct, GlobalPlanner, LocalizationError, PathTracker, PlanOutcome, PoseBelief, PoseEstimate, TrackCommand,
        TrackError, UpdateOutcome, VehicleState,
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
/// use agv_nav::{control::track::{PurePursuit, PurePursuitParams}, pipeline::Navigator, prelude::*};
/// # use agv_nav::core::roles::LocalizationError;
/// # struct DeadReckoning(PoseEstimate<Se2>);
/// # impl Localizer for DeadReckoning {
/// #     type Pose = Se2;
/// #     fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
/// #         if let PoseBelief::Around { map_from_base, covariance } = *belief { self.0 = PoseEstimate::new(map_from_base, covariance); }
/// #         Ok(())
/// #     }
/// #     fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
/// #         self.0.map_from_base = self.0.map_from_base * odometry.start_from_end;
/// #         Ok(())
/// #     }
/// #     fn estimate(&self) -> PoseEstimate<Se2> { self.0 }
/// # }
/// # impl Correct<LaserScan> for DeadReckoning {
/// #     fn update(&mut self, _: &LaserScan) -> Result<UpdateOutcome, LocalizationError> { Ok(UpdateOutcome::Applied(Default::default())) }
/// # }
/// # struct StraightLine;
/// # impl GlobalPlanner for StraightLine {
/// #     fn plan_into(&mut self, _: &Costmap, start: &Se2, goal: &Se2, path: &mut Path) -> Result<PlanOutcome, agv_nav::core::roles::PlanError> {
/// #         path.set_positions([start.translation(), goal.translation()])?;
/// #         Ok(PlanOutcome::Found { cost: path.length(), expansions: 1 })
/// #     }
/// # }
/// # let localizer = DeadReckoning(PoseEstimate::new(Se2::identity(), agv_nav::nalgebra::Matrix3::zeros()));
/// # let planner = StraightLine;
/// let map = Grid::filled(GridLayout::new(100, 100, 0.1, Se2::identity())?, CellState::Free);
/// let tracker = PurePursuit::new(PurePursuitParams::default())?;
/// let (costmap, limits) = (Costmap::from_map(&map), TwistLimits::default());
/// let mut navigator = Navigator::new(Box::new(localizer), Box::new(planner), Box::new(tracker), costmap, limits)?;
///
/// navigator.start(&PoseBelief::around(Se2::new(1.0, 1.0, 0.0), agv_nav::nalgebra::Matrix3::identity() * 1e-4))?;
/// navigator.go_to(&Se2::new(5.0, 1.0, 0.0))?;
/// let (mut twist, mut now, dt) = (Twist2::ZERO, Stamp::default(), 0.05);
/// let arrived = (0..1000).any(|_| {
///     // The caller's vehicle and sensors; here an ideal one.
///     let motion = OdometryIncrement::between(now, &Se2::identity(), now + dt, &twist.integrate(dt)).unwrap();
///     now = now + dt;
///     let step = navigator.cycle(&motion, None, twist, dt).unwrap();
///     let command = step.command.unwrap(); // there is a goal
///     twist = command.twist;
///     command.status == TrackStatus::Arrived
/// });
/// assert!(arrived);
/// # Ok::<(), agv_nav::Error>(())
/// ```
pub struct Navigator {
    localizer: Box<dyn Correct<LaserScan, Pose = Se2> + Send>,
    planner: Box<dyn GlobalPlanner + Send>,
    tracker: Box<dyn PathTracker + Send>,
    costmap: Costmap,
    limits: TwistLimits,
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
        limits: TwistLimits,
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
    /// If there is no path, the old one is kept and the outcome says why there is none.
    ///
    /// # Errors
    /// [`LocalizationError::NotInitialized`] before [`start`](Self::start), and what the planner or the tracker refuses.
    pub fn go_to(&mut self, goal: &Se2) -> Result<PlanOutcome, Error> {
        let estimate = self.localizer.estimate();
        // Before its first belief a localizer says that its variances are infinite.
        if estimate.covariance.iter().any(|v| !v.is_finite()) {
            return Err(LocalizationError::NotInitialized.into());
        }
        let start = estimate.map_from_base;
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
    /// `twist` is the velocity now, in the base frame.
    ///
    /// # Errors
    /// What the localizer or the tracker refuses.
    pub fn cycle(
        &mut self,
        odometry: &OdometryIncrement,
        scan: Option<&LaserScan>,
        twist: Twist2,
        dt: f64,
    ) -> Result<NavigationStep, Error> {
        self.localizer.predict(odometry)?;
        let correction = scan.map(|scan| self.localizer.update(scan)).transpose()?;
        let estimate = self.localizer.estimate();
        let state = VehicleState { map_from_base: estimate.map_from_base, twist };
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

    /// Where the vehicle is.
    pub fn estimate(&self) -> PoseEstimate<Se2> {
        self.localizer.estimate()
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
