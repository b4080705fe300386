//! The navigator by itself: what it does when a goal, a map or a call is not as it should be, and that it arrives.
//!
//! The vehicle is ideal and its localizer adds up the odometry, so that nothing but the composition is on trial.

use agv_nav::{
    Error,
    control::track::{PurePursuit, PurePursuitParams},
    core::{
        geometry::UncertainPose,
        grid::{Cell, CellState, Costmap, Grid, GridLayout, cost},
        kinematics::{Motion, MotionLimits, TwistLimits},
        roles::{
            LocalizationError, LocalizationStatus, NoPathReason, PlanError, PlanOutcome, PoseEstimate, StatusMonitor,
            StatusParams, TrackError,
        },
        sensors::LaserScan,
        time::Stamp,
    },
    nalgebra::Matrix3,
    pipeline::Navigator,
    plan::grid::{AStar, AStarParams},
    prelude::*,
};

const DT: f64 = 0.05;

/// Dead reckoning from a known start.
struct DeadReckoning {
    known: Option<PoseEstimate<Se2>>,
    monitor: StatusMonitor,
}

impl Localizer for DeadReckoning {
    type Pose = Se2;

    fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        if let PoseBelief::Around(pose) = belief {
            self.known = Some(PoseEstimate::new(*pose));
            self.monitor.initialized(pose);
        }
        Ok(())
    }

    fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
        let known = self.known.as_mut().ok_or(LocalizationError::NotInitialized)?;
        let motion = UncertainPose::new(odometry.start_from_end, odometry.covariance)?;
        *known = PoseEstimate { pose: known.pose.compose(&motion), stamp: Some(odometry.end) };
        Ok(())
    }

    fn estimate(&self) -> Option<PoseEstimate<Se2>> {
        self.known
    }

    fn status(&self) -> LocalizationStatus {
        self.monitor.status()
    }
}

impl Correct<LaserScan> for DeadReckoning {
    fn update(&mut self, _: &LaserScan) -> Result<UpdateOutcome, LocalizationError> {
        Ok(UpdateOutcome::Applied(agv_nav::core::roles::UpdateReport::default()))
    }
}

/// A hall of 8 m by 6 m, free but for the cells that are lethal.
fn hall(lethal: impl Fn(Cell) -> bool) -> Costmap {
    let layout = GridLayout::new(80, 60, 0.1, Se2::default()).unwrap();
    let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
    for index in 0..layout.len() {
        let cell = layout.cell(index);
        if lethal(cell) {
            costmap.set(cell, cost::LETHAL);
        }
    }
    costmap
}

fn navigator(costmap: Costmap) -> Navigator {
    let monitor = StatusMonitor::new(StatusParams::default()).unwrap();
    let astar = AStar::new(AStarParams::default()).unwrap();
    let tracker = PurePursuit::new(PurePursuitParams::default()).unwrap();
    let localizer = DeadReckoning { known: None, monitor };
    Navigator::new(Box::new(localizer), Box::new(astar), Box::new(tracker), costmap, MotionLimits::default()).unwrap()
}

fn started(costmap: Costmap, start: Se2) -> Navigator {
    let mut navigator = navigator(costmap);
    navigator.start(&PoseBelief::around(start, Matrix3::identity() * 1e-6).unwrap()).unwrap();
    navigator
}

/// The odometry of `dt` seconds at a twist.
fn driven(from: Stamp, twist: &Twist2) -> OdometryIncrement {
    OdometryIncrement::between(from, &Se2::default(), from + DT, &twist.integrate(DT)).unwrap()
}

/// Drives until the navigator says something else than that it tracks, or for so many cycles; the poses on the way.
fn drive(navigator: &mut Navigator, cycles: usize) -> (TrackStatus, Vec<Se2>) {
    let limits = MotionLimits::default();
    let (mut motion, mut now, mut poses) = (Motion::REST, Stamp::default(), Vec::new());
    for _ in 0..cycles {
        let odometry = driven(now, &motion.twist);
        let step = navigator.cycle(&odometry, None, motion, DT).unwrap();
        now = odometry.end;
        poses.push(*step.estimate.map_from_base());
        let command = step.command.unwrap();
        assert!(limits.allows_step(&motion, &command.motion, DT));
        motion = command.motion;
        if command.status != TrackStatus::Tracking {
            return (command.status, poses);
        }
    }
    (TrackStatus::Tracking, poses)
}

fn lies_in_free_cells(costmap: &Costmap, poses: &[Se2]) -> bool {
    poses
        .iter()
        .all(|pose| costmap.layout().cell_at(&pose.translation()).is_some_and(|cell| costmap.is_traversable(cell)))
}

#[test]
fn a_vehicle_that_is_nowhere_goes_nowhere() {
    let mut navigator = navigator(hall(|_| false));
    let goal = Se2::new(6.0, 4.0, 0.0);
    assert_eq!(navigator.go_to(&goal), Err(Error::Localization(LocalizationError::NotInitialized)));
    let odometry = driven(Stamp::default(), &Twist2::ZERO);
    let blind = navigator.cycle(&odometry, None, Motion::REST, DT);
    assert_eq!(blind, Err(Error::Localization(LocalizationError::NotInitialized)));
    assert!(navigator.path().is_empty() && navigator.estimate().is_none());
}

#[test]
fn without_a_goal_there_is_nothing_to_drive() {
    let start = Se2::new(2.0, 2.0, 0.0);
    let mut navigator = started(hall(|_| false), start);
    let step = navigator.cycle(&driven(Stamp::default(), &Twist2::ZERO), None, Motion::REST, DT).unwrap();
    assert_eq!((step.command, step.correction), (None, None));
    assert_eq!(*step.estimate.map_from_base(), start);
}

#[test]
fn it_arrives_at_the_goal_and_at_rest() {
    let (start, goal) = (Se2::new(1.0, 1.0, 2.0), Se2::new(6.55, 4.25, 0.0));
    let mut navigator = started(hall(|_| false), start);
    assert!(matches!(navigator.go_to(&goal), Ok(PlanOutcome::Found { .. })));
    let (status, poses) = drive(&mut navigator, 1000);
    let end = poses.last().unwrap();
    assert_eq!(status, TrackStatus::Arrived);
    assert!((end.translation() - goal.translation()).norm() < 0.1, "{end:?}");
}

#[test]
fn the_heading_of_the_goal_is_reached() {
    for yaw in [-2.5, 0.0, 1.5] {
        let (start, goal) = (Se2::new(1.0, 1.0, 0.0), Se2::new(5.05, 1.05, yaw));
        let mut navigator = started(hall(|_| false), start);
        navigator.go_to(&goal).unwrap();
        let (status, poses) = drive(&mut navigator, 1000);
        let error = goal.inverse().compose(poses.last().unwrap());
        assert_eq!(status, TrackStatus::Arrived);
        assert!(error.yaw().abs() < 0.03 && error.translation().norm() < 0.1, "{error:?}");
    }
}

#[test]
fn a_goal_that_cannot_be_reached_is_an_outcome_and_the_old_path_stays() {
    let start = Se2::new(1.0, 3.0, 0.0);
    // A wall from side to side, and a block in the near half.
    let costmap = hall(|cell| cell.x == 50 || (cell.x - 30).abs() < 3 && (cell.y - 45).abs() < 3);
    let mut navigator = started(costmap.clone(), start);
    let near = Se2::new(4.0, 3.0, 0.0);
    assert!(matches!(navigator.go_to(&near), Ok(PlanOutcome::Found { .. })));
    let path = navigator.path().clone();
    for (goal, expected) in
        [(Se2::new(7.0, 3.0, 0.0), NoPathReason::Disconnected), (Se2::new(3.05, 4.55, 0.0), NoPathReason::GoalBlocked)]
    {
        let outcome = navigator.go_to(&goal).unwrap();
        assert!(matches!(outcome, PlanOutcome::NoPath { reason, .. } if reason == expected), "{outcome:?}");
        assert_eq!(navigator.path(), &path);
    }
    let (status, poses) = drive(&mut navigator, 1000);
    assert_eq!(status, TrackStatus::Arrived, "to the goal before");
    assert!((poses.last().unwrap().translation() - near.translation()).norm() < 0.1);
    assert!(lies_in_free_cells(&costmap, &poses));
}

#[test]
fn a_goal_off_the_map_or_not_a_number_is_refused_and_the_old_path_stays() {
    let mut navigator = started(hall(|_| false), Se2::new(1.0, 3.0, 0.0));
    navigator.go_to(&Se2::new(4.0, 3.0, 0.0)).unwrap();
    let path = navigator.path().clone();
    let outside = navigator.go_to(&Se2::new(40.0, 3.0, 0.0));
    assert!(matches!(outside, Err(Error::Plan(PlanError::GoalOutside { .. }))), "{outside:?}");
    assert!(navigator.go_to(&Se2::new(f64::NAN, 3.0, 0.0)).is_err());
    assert!(navigator.go_to(&Se2::new(2.0, 3.0, f64::NAN)).is_err());
    assert_eq!(navigator.path(), &path);
}

#[test]
fn a_start_off_the_map_or_in_a_wall_is_told() {
    let goal = Se2::new(4.0, 3.0, 0.0);
    let mut lost = started(hall(|_| false), Se2::new(-3.0, 3.0, 0.0));
    assert!(matches!(lost.go_to(&goal), Err(Error::Plan(PlanError::StartOutside { .. }))));
    let mut walled = started(hall(|cell| cell.x < 20), Se2::new(1.0, 3.0, 0.0));
    let outcome = walled.go_to(&goal);
    assert!(matches!(outcome, Ok(PlanOutcome::NoPath { reason: NoPathReason::StartBlocked, .. })), "{outcome:?}");
}

#[test]
fn a_goal_where_the_vehicle_stands_is_no_path_but_may_be_a_turn() {
    let here = Se2::new(2.05, 2.05, 0.3);
    let mut navigator = started(hall(|_| false), here);
    assert_eq!(navigator.go_to(&here), Err(Error::Track(TrackError::NoPath)));
    assert!(navigator.path().is_empty());
    // On the same spot there is still the heading.
    navigator.go_to(&Se2::new(2.05, 2.05, 2.0)).unwrap();
    let (status, poses) = drive(&mut navigator, 400);
    let end = poses.last().unwrap();
    assert!(status == TrackStatus::Arrived && (end.yaw() - 2.0).abs() < 0.03, "{end:?}");
    assert!((end.translation() - here.translation()).norm() < 1e-6);
}

#[test]
fn a_map_that_changes_on_the_way_counts_from_the_next_goal_on() {
    let goal = Se2::new(7.0, 3.0, 0.0);
    let mut navigator = started(hall(|_| false), Se2::new(1.0, 3.0, 0.0));
    navigator.go_to(&goal).unwrap();
    let straight = navigator.path().clone();
    let (status, _) = drive(&mut navigator, 40);
    assert_eq!(status, TrackStatus::Tracking);

    // A wall with a gap at the top.
    let walled = hall(|cell| cell.x == 50 && cell.y < 50);
    navigator.set_costmap(walled.clone());
    assert_eq!((navigator.path(), navigator.costmap()), (&straight, &walled), "the path stays");
    let (status, _) = drive(&mut navigator, 5);
    assert_eq!(status, TrackStatus::Tracking);

    assert!(matches!(navigator.go_to(&goal), Ok(PlanOutcome::Found { .. })));
    let through_the_gap = navigator.path().points().iter().any(|p| p.pose.y() > 4.9);
    assert!(through_the_gap && navigator.path() != &straight);
    let (status, poses) = drive(&mut navigator, 2000);
    assert_eq!(status, TrackStatus::Arrived);
    assert!((poses.last().unwrap().translation() - goal.translation()).norm() < 0.1);
}

#[test]
fn a_refused_cycle_changes_nothing() {
    let mut navigator = started(hall(|_| false), Se2::new(1.0, 3.0, 0.0));
    navigator.go_to(&Se2::new(4.0, 3.0, 0.0)).unwrap();
    let before = navigator.estimate();
    let odometry = driven(Stamp::default(), &Twist2::new(1.0, 0.0, 0.0));
    for bad in [f64::NAN, f64::INFINITY] {
        let flying = Motion::from(Twist2::new(bad, 0.0, 0.0));
        let bent = Motion { steering: Some(bad), ..Motion::REST };
        assert!(navigator.cycle(&odometry, None, flying, DT).is_err());
        assert!(navigator.cycle(&odometry, None, bent, DT).is_err());
        assert!(navigator.cycle(&odometry, None, Motion::REST, bad).is_err());
    }
    for dt in [0.0, -DT] {
        assert!(navigator.cycle(&odometry, None, Motion::REST, dt).is_err());
    }
    assert_eq!(navigator.estimate(), before);
}

#[test]
fn limits_that_are_none_are_refused() {
    let parts = || {
        let monitor = StatusMonitor::new(StatusParams::default()).unwrap();
        let localizer = Box::new(DeadReckoning { known: None, monitor });
        let tracker = PurePursuit::new(PurePursuitParams::default()).unwrap();
        (localizer, Box::new(AStar::new(AStarParams::default()).unwrap()), Box::new(tracker))
    };
    let good = MotionLimits::default();
    for limits in [
        MotionLimits { lateral_acceleration: Some(f64::NAN), ..good },
        MotionLimits { twist: TwistLimits { deceleration: 0.0, ..good.twist }, ..good },
    ] {
        let (localizer, astar, tracker) = parts();
        assert!(matches!(Navigator::new(localizer, astar, tracker, hall(|_| false), limits), Err(Error::Core(_))));
    }
}
