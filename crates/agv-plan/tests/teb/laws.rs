//! The laws of the role, for all vehicles.

use super::scenes::{disc, footprint, hall, local, wall};
use agv_core::{
    geometry::{Se2, Twist2},
    nalgebra::Vector2,
    path::{Gear, Path, PathPoint},
    roles::{LocalPlanRequest, VehicleState, laws},
};
use agv_plan::teb::{Teb, TebParams};

fn keeps_laws(name: &str, costmap: &agv_core::grid::Costmap, path: &Path, start: Se2, tolerance: f64) {
    let map = local(costmap);
    for (vehicle, limits) in laws::vehicles() {
        let mut teb = Teb::new(TebParams::for_footprint(footprint())).unwrap();
        let state = VehicleState::new(start, Twist2::ZERO);
        let request = LocalPlanRequest { state, path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
        // What turns on the spot arrives with the last heading, from wherever it comes.
        let turns = limits.turns_on_the_spot();
        let tolerance = if turns { teb.params().yaw_tolerance } else { tolerance };
        let kept = laws::local_planner(&mut teb, request, &footprint(), 0.1, tolerance);
        assert!(kept.is_ok(), "{name}, {vehicle}: {kept:?}");
    }
}

fn line(points: &[(f64, f64)]) -> Path {
    Path::from_positions(&points.iter().map(|&(x, y)| Vector2::new(x, y)).collect::<Vec<_>>()).unwrap()
}

#[test]
fn every_vehicle_keeps_the_laws() {
    let mut costmap = hall(10.0, 6.0);
    keeps_laws("straight", &costmap, &line(&[(1.0, 3.0), (8.0, 3.0)]), Se2::new(1.0, 3.0, 0.0), 0.15);
    keeps_laws("corner", &costmap, &line(&[(1.0, 1.0), (6.0, 1.0), (6.0, 5.0)]), Se2::new(1.0, 1.0, 0.0), 0.3);
    keeps_laws("beside", &costmap, &line(&[(1.0, 3.0), (8.0, 3.0)]), Se2::new(1.0, 3.4, 0.5), 0.3);
    let mut back = Path::new();
    for (x, gear) in [(1.0, Gear::Forward), (5.0, Gear::Forward), (3.0, Gear::Reverse)] {
        back.push(PathPoint { pose: Se2::new(x, 3.0, 0.0), gear }).unwrap();
    }
    keeps_laws("cusp", &costmap, &back, Se2::new(1.0, 3.0, 0.0), 0.3);
    disc(&mut costmap, Vector2::new(4.5, 3.0), 0.2);
    keeps_laws("post", &costmap, &line(&[(1.0, 3.0), (8.0, 3.0)]), Se2::new(1.0, 3.0, 0.0), 0.3);
    wall(&mut costmap, 6.5, (2.6, 3.4));
    keeps_laws("gap", &costmap, &line(&[(1.0, 3.0), (9.0, 3.0)]), Se2::new(1.0, 3.0, 0.0), 0.3);
    wall(&mut costmap, 7.5, (9.0, 9.0));
    keeps_laws("closed", &costmap, &line(&[(1.0, 3.0), (9.0, 3.0)]), Se2::new(1.0, 3.0, 0.0), 0.3);
}
