//! The timed elastic band: plans from the beginning and plans that go on, by poses and by obstacle points, along a lane whose points
//! are nearer than the clearance that is kept; around a post that stands on it, by all ways that there are, on one thread and on two;
//! and for an outline of corners and a vehicle that steers.

use agv_core::{
    compute::{Par, Seed},
    geometry::{Se2, Twist2},
    grid::{CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams, cost},
    kinematics::{MotionLimits, SteeringLimits},
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

/// What is benched, by name.
struct Case {
    name: &'static str,
    /// Poses of the band, and the length that they make, in metres.
    band: (u32, f64),
    points: usize,
    post: bool,
    footprint: Footprint,
    limits: MotionLimits,
    par: Par,
}

fn cases() -> Vec<Case> {
    let circle = || Footprint::circle(0.3).unwrap();
    let case = |name, band, points, post| {
        let (footprint, limits) = (circle(), MotionLimits::default());
        Case { name, band, points, post, footprint, limits, par: Par::Seq }
    };
    let (short, long) = ((40, 8.0), (98, 21.4));
    let steering = SteeringLimits { wheelbase: 0.6, max_rate: 1.0, ..SteeringLimits::default() };
    let rectangle = Footprint::rectangle(-0.3, 0.3, 0.5).unwrap();
    vec![
        case("40 poses, 50 points", short, 50, false),
        case("40 poses, 50 points, post", short, 50, true),
        case("98 poses, 50 points", long, 50, false),
        case("98 poses, 1000 points", long, 1000, false),
        Case { footprint: rectangle, ..case("98 poses, 50 points, polygon", long, 50, false) },
        Case {
            limits: MotionLimits { steering: Some(steering), ..MotionLimits::default() },
            ..case("98 poses, 50 points, steering", long, 50, false)
        },
        case("98 poses, 50 points, post", long, 50, true),
        Case { par: Par::threads(2), ..case("98 poses, 50 points, post, 2 threads", long, 50, true) },
    ]
}

fn bench(c: &mut Criterion) {
    let path = Path::from_positions(&[Vector2::new(1.0, 4.0), Vector2::new(23.0, 4.0)]).unwrap();
    let mut group = c.benchmark_group("teb");
    for Case { name, band: (poses, length), points, post, footprint, limits, par } in cases() {
        let map = hall(points, post);
        let spacing = length / f64::from(poses - 1);
        let params = TebParams { horizon: length - 0.01, spacing, ..TebParams::for_footprint(footprint) };
        let mut teb = Teb::new(params).unwrap().with_parallelism(par);
        let state = VehicleState::new(Se2::new(1.0, 4.1, 0.1), Twist2::new(0.5, 0.0, 0.0));
        let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
        let plan = teb.plan(request).unwrap();
        assert!(plan.is_free && plan.command.status == LocalPlanStatus::Following, "{name}");
        let band = plan.band.unwrap();
        let aside = (0..band.len()).filter_map(|i| band.pose(i)).map(|pose| (pose.y() - 4.0).abs());
        let bent = aside.fold(0.0, f64::max);
        assert!(!post || plan.ways > 1 && bent > 0.3, "{} ways, {bent} m aside", plan.ways);
        println!("{name}: {} poses, {} ways, {:?}", band.len(), plan.ways, plan.report);
        group.bench_function(format!("cold, {name}"), |b| {
            b.iter(|| {
                teb.reset();
                black_box(teb.plan(black_box(request)).unwrap().command)
            });
        });
        // The vehicle moves on, so that there is something left to do in each cycle; now and then from the beginning.
        let (mut state, mut cycles) = (request.state, 0);
        group.bench_function(format!("warm, {name}"), |b| {
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
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
