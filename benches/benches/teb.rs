//! The timed elastic band: plans from the beginning and plans that go on, by poses and by obstacle points, along a lane whose points
//! are nearer than the clearance that is kept; and around a post that stands on it.

use agv_core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    grid::{CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams, cost},
    kinematics::MotionLimits,
    path::Path,
    roles::{LocalPlanRequest, LocalPlanStatus, VehicleState},
};
use agv_plan::teb::{Teb, TebParams};
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector2;
use rand_distr::{Distribution, Uniform};
use std::hint::black_box;

/// Where a post stands on the lane, if it does, in metres along the hall.
const POST: f64 = 6.0;
/// Room around the post, in metres along the hall.
const ROOM: f64 = 2.0;
/// Half the width of the lane, in metres.
const LANE: f64 = 0.4;

/// A hall of 24 x 8 m with points on both sides of a lane along its middle, and half of them at its edges.
fn hall(points: usize, post: bool) -> LocalMap {
    let layout = GridLayout::new(480, 160, 0.05, Se2::default()).unwrap();
    let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
    let mut stream = Seed(5).stream(0, 0);
    let (along, aside) = (Uniform::new(2.0_f64, 22.0).unwrap(), Uniform::new(LANE, 3.5).unwrap());
    for i in 0..points {
        let side = if i % 2 == 0 { 1.0 } else { -1.0 };
        let near = if i % 4 < 2 { LANE } else { aside.sample(&mut stream) };
        let point = Vector2::new(along.sample(&mut stream), 4.0 + side * near);
        if post && (point.x - POST).abs() < ROOM {
            continue;
        }
        costmap.set(layout.cell_at(&point).unwrap(), cost::LETHAL);
    }
    if post {
        costmap.set(layout.cell_at(&Vector2::new(POST, 4.0)).unwrap(), cost::LETHAL);
    }
    LocalMap::new(&costmap, LocalMapParams::default()).unwrap()
}

fn bench(c: &mut Criterion) {
    let path = Path::from_positions(&[Vector2::new(1.0, 4.0), Vector2::new(23.0, 4.0)]).unwrap();
    let limits = MotionLimits::default();
    let mut group = c.benchmark_group("teb");
    for (poses, length) in [(40, 8.0), (98, 21.4)] {
        for (points, post) in [(50, false), (50, true), (1000, false)] {
            if poses == 40 && points == 1000 {
                continue;
            }
            let map = hall(points, post);
            let footprint = Footprint::circle(0.3).unwrap();
            let spacing = length / f64::from(poses - 1);
            let params = TebParams { horizon: length - 0.01, spacing, ..TebParams::for_footprint(footprint) };
            let mut teb = Teb::new(params).unwrap();
            let state = VehicleState::new(Se2::new(1.0, 4.1, 0.1), Twist2::new(0.5, 0.0, 0.0));
            let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
            let plan = teb.plan(request).unwrap();
            assert!(plan.is_free && plan.command.status == LocalPlanStatus::Following);
            let band = plan.band.unwrap();
            let aside = (0..band.len()).filter_map(|i| band.pose(i)).map(|pose| (pose.y() - 4.0).abs());
            let bent = aside.fold(0.0, f64::max);
            assert!(!post || plan.ways > 1 && bent > 0.3, "{} ways, {bent} m aside", plan.ways);
            let case = format!("{poses} poses, {points} points{}", if post { ", post" } else { "" });
            println!("{} poses, {:?}", band.len(), plan.report);
            group.bench_function(format!("cold, {case}"), |b| {
                b.iter(|| {
                    teb.reset();
                    black_box(teb.plan(black_box(request)).unwrap().command)
                });
            });
            // The vehicle moves on, so that there is something left to do in each cycle; now and then from the beginning.
            let (mut state, mut cycles) = (request.state, 0);
            group.bench_function(format!("warm, {case}"), |b| {
                b.iter(|| {
                    if cycles == 20 {
                        (state, cycles) = (request.state, 0);
                    }
                    let command = teb.plan(LocalPlanRequest { state, ..request }).unwrap().command;
                    state = state.after(&command.motion, request.dt);
                    cycles += 1;
                    black_box(command)
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
