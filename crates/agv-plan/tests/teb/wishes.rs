//! Outlines, points to pass and sides to turn to.

use super::scenes::{disc, footprint, hall, local, wall};
use agv_core::{
    geometry::{Se2, Twist2},
    grid::Footprint,
    kinematics::{MotionLimits, TwistLimits},
    nalgebra::Vector2,
    path::Path,
    roles::{LocalPlanRequest, LocalPlanner, VehicleState, laws},
};
use agv_plan::teb::{Teb, TebParams};

/// Every outline gets through the same gap and around the same post, or stops before them.
#[test]
fn every_outline_keeps_the_laws() {
    let corners = [(-0.3, -0.2), (0.3, -0.2), (0.4, 0.0), (0.1, 0.05), (-0.3, 0.2)].map(|(x, y)| Vector2::new(x, y));
    let outlines = [
        Footprint::point(),
        Footprint::circle(0.25).unwrap(),
        Footprint::two_circles(0.25, 0.2, -0.15, 0.25).unwrap(),
        Footprint::segment(Vector2::new(-0.2, 0.0), Vector2::new(0.3, 0.0)).unwrap(),
        Footprint::polygon(corners.to_vec()).unwrap(),
    ];
    let mut costmap = hall(10.0, 6.0);
    disc(&mut costmap, Vector2::new(3.5, 3.0), 0.2);
    wall(&mut costmap, 6.5, (2.5, 3.5));
    let map = local(&costmap);
    let path = Path::from_positions(&[Vector2::new(1.0, 3.0), Vector2::new(9.0, 3.0)]).unwrap();
    for outline in outlines {
        for (vehicle, limits) in laws::vehicles() {
            let mut teb = Teb::new(TebParams::for_footprint(outline.clone())).unwrap();
            let state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
            let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
            let kept = laws::local_planner(&mut teb, request, &outline, 0.1, 0.3);
            assert!(kept.is_ok(), "{outline:?}, {vehicle}: {kept:?}");
        }
    }
}

fn request<'a>(path: &'a Path, map: &'a agv_core::grid::LocalMap, limits: &'a MotionLimits) -> LocalPlanRequest<'a> {
    let state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
    LocalPlanRequest { state, path, map, obstacles: &[], limits, dt: 0.1 }
}

#[test]
fn points_to_pass_bend_the_way() {
    let map = local(&hall(9.0, 6.0));
    let path = Path::from_positions(&[Vector2::new(1.0, 3.0), Vector2::new(5.0, 3.0)]).unwrap();
    let limits = MotionLimits::default();
    let point = Vector2::new(3.0, 3.6);
    let nearest = |via: &[Vector2<f64>]| {
        let mut params = TebParams::for_footprint(footprint());
        params.weights.via = 20.0;
        let mut teb = Teb::new(params).unwrap();
        teb.set_via_points(via).unwrap();
        let plan = teb.plan(request(&path, &map, &limits)).unwrap();
        assert!(plan.is_free);
        let poses = plan.trajectory.points().iter();
        poses.map(|p| (p.map_from_base.translation() - point).norm()).fold(f64::INFINITY, f64::min)
    };
    let (without, with) = (nearest(&[]), nearest(&[point]));
    assert!(without > 0.55 && with < 0.35, "{without} {with}");
}

/// Towards a goal behind the vehicle both sides are as long, up to a little.
#[test]
fn the_side_to_turn_to_may_be_wished() {
    let map = local(&hall(9.0, 6.0));
    let limits = TwistLimits::default().into();
    for askew in [-0.05, 0.05] {
        let path = Path::from_positions(&[Vector2::new(5.0, 3.0), Vector2::new(1.0, 3.0 + 4.0 * askew)]).unwrap();
        for side in [1.0, 0.0, -1.0] {
            let mut teb = Teb::new(TebParams::for_footprint(footprint())).unwrap();
            teb.prefer_rotation(side).unwrap();
            let state = VehicleState::new(Se2::new(5.0, 3.0, 0.0), Twist2::ZERO);
            let motion = teb.command(LocalPlanRequest { state, ..request(&path, &map, &limits) }).unwrap().motion;
            let shorter = if askew < 0.0 { -1.0 } else { 1.0 };
            let expected = if side == 0.0 { shorter } else { side };
            assert!(motion.twist.yaw_rate * expected > 0.0, "{askew} {side}: {motion:?}");
        }
    }
}
