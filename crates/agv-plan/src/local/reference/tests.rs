use super::*;
use agv_core::{
    geometry::Twist2,
    grid::{CellState, Costmap, Grid, GridLayout, LocalMap, LocalMapParams},
    kinematics::{MotionLimits, SteeringLimits},
    roles::VehicleState,
};
use std::f64::consts::FRAC_PI_2;

struct Scene {
    map: LocalMap,
    limits: MotionLimits,
    reference: Reference,
}

impl Scene {
    fn new() -> Self {
        let layout = GridLayout::new(10, 10, 0.1, Se2::default()).unwrap();
        let costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        Self {
            map: LocalMap::new(&costmap, LocalMapParams::default()).unwrap(),
            limits: MotionLimits::default(),
            reference: Reference::new(ReferenceParams::default()).unwrap(),
        }
    }

    fn task(&mut self, path: &Path, x: f64, y: f64, yaw: f64, speed: f64) -> Task {
        let state = VehicleState::new(Se2::new(x, y, yaw), Twist2::new(speed, 0.0, 0.0));
        let (map, limits) = (&self.map, &self.limits);
        self.reference.update(&LocalPlanRequest { state, path, map, obstacles: &[], limits, dt: 0.1 }).unwrap()
    }
}

fn path(points: &[(f64, f64)]) -> Path {
    let points: Vec<_> = points.iter().map(|&(x, y)| Vector2::new(x, y)).collect();
    Path::from_positions(&points).unwrap()
}

fn drive(task: Task) -> Drive {
    let Task::Drive(drive) = task else { panic!("{task:?}") };
    drive
}

#[test]
fn a_cusp_is_driven_to_before_the_way_back() {
    let mut scene = Scene::new();
    let mut way = path(&[(0.0, 0.0), (2.0, 0.0)]);
    way.push(PathPoint { pose: Se2::new(1.0, 0.0, 0.0), gear: Gear::Reverse }).unwrap();
    let first = drive(scene.task(&way, 1.0, 0.0, 0.0, 0.5));
    assert_eq!((first.gear, first.to_stop(), first.is_last, first.remaining), (Gear::Forward, 1.0, false, 2.0));
    // There, but not at rest yet.
    assert_eq!(scene.task(&way, 1.95, 0.0, 0.0, 0.5), Task::Turn(0.0));
    let second = drive(scene.task(&way, 1.95, 0.0, 0.0, 0.0));
    assert_eq!((second.gear, second.is_last), (Gear::Reverse, true));
    assert_eq!(scene.task(&way, 1.05, 0.0, 0.0, 0.0), Task::Arrive);
}

#[test]
fn a_turn_on_the_way_is_asked_of_those_who_can() {
    let mut way = path(&[(0.0, 0.0), (2.0, 0.0)]);
    way.push_turn(FRAC_PI_2).unwrap();
    way.push(PathPoint { pose: Se2::new(2.0, 2.0, FRAC_PI_2), gear: Gear::Forward }).unwrap();
    let mut scene = Scene::new();
    drive(scene.task(&way, 1.0, 0.0, 0.0, 0.5));
    assert!(
        matches!(scene.task(&way, 2.0, 0.0, 0.2, 0.0), Task::Turn(angle) if (angle + 0.2 - FRAC_PI_2).abs() < 1e-12)
    );
    assert!(drive(scene.task(&way, 2.0, 0.0, FRAC_PI_2, 0.0)).is_last);

    let mut truck = Scene::new();
    truck.limits.steering = Some(SteeringLimits::default());
    drive(truck.task(&way, 1.0, 0.0, 0.0, 0.5));
    assert!(drive(truck.task(&way, 2.0, 0.0, 0.2, 0.0)).is_last);
    assert_eq!(truck.task(&way, 2.0, 2.0, 0.3, 0.0), Task::Arrive, "with the heading that it has");
}

#[test]
fn another_path_is_taken_where_the_vehicle_is() {
    let mut scene = Scene::new();
    drive(scene.task(&path(&[(0.0, 0.0), (4.0, 0.0)]), 3.0, 0.0, 0.0, 0.5));
    let other = path(&[(-9.0, 1.0), (9.0, 1.0)]);
    let place = drive(scene.task(&other, 3.0, 0.5, 0.0, 0.5));
    assert!(scene.reference.is_new() && place.projection.arc_length == 12.0 && place.projection.cross_track == -0.5);
    drive(scene.task(&other, 3.1, 0.5, 0.0, 0.5));
    assert!(!scene.reference.is_new());
    assert_eq!(scene.task(&other, 3.1, 3.0, 0.0, 0.5), Task::OffPath);
}

#[test]
fn a_path_that_passes_its_own_end_is_driven_in_order() {
    let mut scene = Scene::new();
    let lap = path(&[(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0), (0.0, 0.05)]);
    assert!(drive(scene.task(&lap, 0.0, 0.0, 0.0, 0.0)).remaining > 15.0);
}

#[test]
fn a_path_of_one_pose_is_the_way_there() {
    let mut scene = Scene::new();
    let mut way = Path::new();
    way.push(PathPoint { pose: Se2::new(0.0, 3.0, 0.0), gear: Gear::Forward }).unwrap();
    let place = drive(scene.task(&way, 0.0, 1.0, 0.0, 0.0));
    assert_eq!((place.remaining, place.stop_pose.yaw()), (2.0, 0.0));
    assert!(matches!(scene.task(&way, 0.0, 3.0, FRAC_PI_2, 0.0), Task::Turn(angle) if angle == -FRAC_PI_2));
    assert_eq!(scene.task(&way, 0.0, 3.0, 0.0, 0.0), Task::Arrive);
    // A vehicle that is there when it is told, and is pushed away.
    let mut there = Scene::new();
    assert_eq!(there.task(&way, 0.0, 3.0, 0.0, 0.0), Task::Arrive);
    drive(there.task(&way, 0.0, 2.0, 0.0, 0.0));
}

#[test]
fn who_arrived_stays_until_pushed() {
    let mut scene = Scene::new();
    let way = path(&[(0.0, 0.0), (2.0, 0.0)]);
    assert_eq!(scene.task(&way, 1.95, 0.0, 0.0, 0.0), Task::Arrive);
    assert_eq!(scene.task(&way, 1.85, 0.0, 0.0, 0.0), Task::Arrive);
    drive(scene.task(&way, 1.7, 0.0, 0.0, 0.0));
}

#[test]
fn bad_input_is_refused() {
    let good = ReferenceParams::default();
    for bad in [0.0, -1.0, f64::NAN] {
        for params in [
            ReferenceParams { goal_tolerance: bad, ..good },
            ReferenceParams { heading_tolerance: bad, ..good },
            ReferenceParams { max_cross_track: bad, ..good },
            ReferenceParams { reach: bad, ..good },
            ReferenceParams { bend_window: bad, ..good },
        ] {
            assert!(Reference::new(params).is_err(), "{params:?}");
        }
    }
    let mut scene = Scene::new();
    let state = VehicleState::default();
    let nothing = Path::new();
    let (map, limits) = (&scene.map, &scene.limits);
    let request = LocalPlanRequest { state, path: &nothing, map, obstacles: &[], limits, dt: 0.1 };
    assert_eq!(scene.reference.update(&request), Err(LocalPlanError::EmptyPath));
    assert!(
        scene
            .reference
            .update(&LocalPlanRequest { path: &path(&[(0.0, 0.0), (1.0, 0.0)]), dt: 0.0, ..request })
            .is_err()
    );
}
