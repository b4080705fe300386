//! Stages 3 and 4: plans on the grid, and a drive to two goals past goods that the map does not know.

use crate::{
    Args, Result, drive,
    hall::{self, Hall},
    mapping::Mapped,
};
use agv_nav::{
    core::{
        grid::{CollisionParams, Inflation, InflationParams, LocalMapParams, RollingCostmap, RollingParams, cost},
        kinematics::Motion,
        path::Path,
        sensors::{LaserScan, ScanGeometry},
    },
    nalgebra::Vector3,
    ndt::{
        convert::{CloudToScan, CloudToScanParams},
        ndt::{NdtLocalizer, NdtLocalizerParams},
    },
    pipeline::{
        Navigation, NavigationParams, NavigationStatus,
        csns::{Csns, CsnsSight},
    },
    plan::{
        grid::{AStar, AStarParams, Dijkstra, GridParams, GridPlannerParams},
        teb::{Teb, TebParams},
    },
    prelude::{Costmap, GlobalPlanner, LieGroup as _, LocalizationStatus, PlanOutcome, PoseBelief, Se2, Stamp},
};
use agv_sim::{Body, Fixture, PlanarWorld as _, Solid, World3d};
use agv_support::{cli::Report, timing::Timings};
use std::f64::consts::PI;

/// Greatest speed, in metres per second, and time of a planning cycle, in seconds.
const SPEED: f64 = 2.0;
const CYCLE: f64 = 0.1;

/// Longest drive to a goal, in seconds.
const LONGEST: f64 = 120.0;

/// Queries of each planner in each case.
const QUERIES: usize = 4;

/// How dear it is to pass obstacles closely.
const COST_WEIGHT: f64 = 4.0;

pub(crate) struct Driven {
    pub(crate) start: Se2,
    pub(crate) planned: Path,
    pub(crate) truths: Vec<Se2>,
    pub(crate) estimates: Vec<Se2>,
    pub(crate) goals: Vec<Se2>,
    pub(crate) goods: Vec<Vector3<f64>>,
}

fn inflation() -> Result<InflationParams> {
    let params = InflationParams::for_footprint(&hall::footprint()?);
    Ok(InflationParams { inflation_radius: 1.4, cost_scaling_factor: 2.5, ..params })
}

fn grid() -> GridParams {
    GridParams { cost_weight: COST_WEIGHT, ..GridParams::default() }
}

fn astar() -> Result<AStar> {
    Ok(AStar::new(AStarParams { grid: grid(), start_tolerance: 1.0, goal_tolerance: 0.5, ..AStarParams::default() })?)
}

/// In the first aisle, heading along it.
fn start(hall: &Hall) -> Se2 {
    hall.factory.aisles()[0] * Se2::new(14.0, 0.0, 0.0)
}

/// Goals in the last aisle, and in the second: each lies ahead, for the planner on the grid knows nothing of turning round.
fn goals(hall: &Hall) -> Vec<Se2> {
    let aisles = hall.factory.aisles();
    vec![aisles[3] * Se2::new(24.0, 0.0, PI), aisles[1] * Se2::new(4.0, 0.0, 0.0)]
}

pub(crate) fn run(args: &Args, hall: &Hall, mapped: &Mapped, report: &mut Report) -> Result<Driven> {
    let planned = plan(hall, mapped, report)?;
    let (goods, world) = with_goods(hall)?;
    let mut driven =
        Driven { start: start(hall), planned, truths: vec![], estimates: vec![], goals: goals(hall), goods };
    follow(args, hall, mapped, &world, &mut driven, report)?;
    Ok(driven)
}

/// Stage 3: how long A* and Dijkstra take, on the map and with its aisles half blocked.
fn plan(hall: &Hall, mapped: &Mapped, report: &mut Report) -> Result<Path> {
    let free = Inflation::new(inflation()?)?.inflate(&mapped.grid)?;
    let mut blocked = free.clone();
    block(&mut blocked, hall);
    let (start, goal) = (start(hall), goals(hall)[0]);
    let params = GridPlannerParams { grid: grid(), start_tolerance: 1.0, goal_tolerance: 0.5, ..Default::default() };
    let (mut planned, mut found) = (Path::new(), 0);
    let planners: [(&str, Box<dyn GlobalPlanner>); 2] =
        [("astar", Box::new(astar()?)), ("dijkstra", Box::new(Dijkstra::new(params)?))];
    for (name, mut planner) in planners {
        for (case, costmap) in [("", &free), ("_obstacles", &blocked)] {
            let (mut timings, mut path) = (Timings::default(), Path::new());
            // The costmap is taken in by the first query, as when a vehicle starts.
            for _ in 0..QUERIES {
                let outcome = timings.time(|| planner.plan_into(costmap, &start, &goal, &mut path))?;
                found += usize::from(matches!(outcome, PlanOutcome::Found { .. }));
            }
            report.number(&format!("plan_{name}{case}_ms"), timings.milliseconds(50.0));
            if (name, case) == ("astar", "") {
                report.number("plan_length_m", path.length());
                planned = path;
            }
        }
    }
    report.flag("plans_found", found == 4 * QUERIES);
    Ok(planned)
}

/// Goods across half of every other aisle.
fn block(costmap: &mut Costmap, hall: &Hall) {
    let layout = *costmap.layout();
    for aisle in hall.factory.aisles().iter().step_by(2) {
        for (along, side) in [(6.0, -1.0), (12.0, 1.0), (20.0, -1.0)] {
            let at = *aisle * Se2::new(along, 0.9 * side, 0.0);
            for (dx, dy) in (-8..=8).flat_map(|dx| (-8..=8).map(move |dy| (dx, dy))) {
                let near = at.translation() + agv_nav::nalgebra::Vector2::new(f64::from(dx), f64::from(dy)) * 0.05;
                layout.cell_at(&near).map(|cell| costmap.set(cell, cost::LETHAL));
            }
        }
    }
}

/// The hall with two pallets that were put down after it was mapped.
fn with_goods(hall: &Hall) -> Result<(Vec<Vector3<f64>>, World3d)> {
    let mut fixtures = hall.factory.world().fixtures().to_vec();
    let aisles = hall.factory.aisles();
    let at = |aisle: usize, along: f64, side: f64| {
        let place = aisles[aisle] * Se2::new(along, side, 0.0);
        Vector3::new(place.x(), place.y(), 0.45)
    };
    let goods = vec![at(3, 12.0, 1.0), at(0, 21.0, -1.0)];
    for &center in &goods {
        let solid = Solid::Box { center, size: Vector3::new(0.8, 0.8, 0.9), yaw: 0.2 };
        fixtures.push(Fixture { solid, reflectivity: 0.5 });
    }
    Ok((goods, World3d::new(fixtures)?))
}

/// All of the vehicle's computer.
fn system(args: &Args, mapped: &Mapped) -> Result<Csns> {
    let footprint = hall::footprint()?;
    let localizer = NdtLocalizer::new(&mapped.site.map, NdtLocalizerParams::default())?;
    let localizer = localizer.with_places(mapped.site.places.iter().copied())?.with_parallelism(args.common.par());
    let rolling = RollingParams {
        width: 620,
        height: 380,
        resolution: 0.1,
        mark_range: Some(12.0),
        forget_after: None,
        inflation: Some(inflation()?),
        ..RollingParams::default()
    };
    let costmap =
        RollingCostmap::new(rolling)?.with_footprint(footprint.clone()).with_static_map(mapped.grid.clone())?;
    let mut obstacles = CloudToScanParams { empty_is_free: false, ..CloudToScanParams::default() };
    obstacles.image.columns = usize::from(args.columns);
    let beams = usize::from(args.columns) / 2;
    let geometry = ScanGeometry {
        angle_min: -PI,
        angle_increment: 2.0 * PI / beams as f64,
        range_min: 0.3,
        range_max: 20.0,
        ..ScanGeometry::default()
    };
    let scan = LaserScan::new(Stamp::default(), geometry, vec![f32::NAN; beams])?;
    let sight = CsnsSight { to_scan: CloudToScan::new(obstacles)?, scan, costmap };
    let local = LocalMapParams {
        collision: CollisionParams { unknown_is_obstacle: false, outside_is_obstacle: true },
        max_distance: 4.0,
    };
    let params = NavigationParams { cost_weight: COST_WEIGHT, plan_period: 1.0, ..NavigationParams::default() };
    let teb = Teb::new(TebParams::for_footprint(footprint.clone()))?;
    let navigation = Navigation::new(Box::new(astar()?), Box::new(teb), footprint, params)?;
    Ok(Csns::new(drive::odometry()?, localizer, sight, local, navigation, hall::limits(SPEED))?)
}

/// Stage 4.
fn follow(
    args: &Args,
    hall: &Hall,
    mapped: &Mapped,
    world: &World3d,
    driven: &mut Driven,
    report: &mut Report,
) -> Result<()> {
    let start = start(hall);
    let mut system = system(args, mapped)?;
    let mut simulator = drive::simulator(args, world, start, SPEED, args.common.seed().derive(2000))?;
    system.start(&PoseBelief::Anywhere)?;
    let floor = world.section(0.3)?;
    let (length, width) = (hall::OUTLINE.1 - hall::OUTLINE.0, hall::OUTLINE.2);
    let (body, middle) =
        (Body::rectangle(length, width)?, Se2::new(0.5 * (hall::OUTLINE.0 + hall::OUTLINE.1), 0.0, 0.0));
    let (mut clearance, mut way, mut found, mut arrived) = (f64::INFINITY, 0.0, f64::NAN, 0);
    let (mut sensing, mut planning) = (Timings::default(), Timings::default());
    let (mut motion, every) = (Motion::REST, (CYCLE / drive::STEP).round() as usize);
    let goals = driven.goals.clone();
    let mut goals = goals.iter();
    let (mut steps, mut last) = (0, start);
    let mut ends = Vec::new();
    for step in 0.. {
        let seen = simulator.step(&motion.twist)?;
        let (truth, cloud) = (seen.truth.map_from_base, seen.clouds().next().map(|(cloud, _)| cloud));
        let sensed = sensing.time(|| system.sense(&seen.odometry, seen.imu_samples(), cloud));
        sensed?;
        way += (truth.translation() - last.translation()).norm();
        last = truth;
        clearance = clearance.min(floor.clearance(&body, &(truth * middle), 5.0));
        let known = matches!(system.status(), LocalizationStatus::Tracking);
        if cloud.is_some() && known {
            let estimate = system.estimate().ok_or("it is tracking")?;
            driven.truths.push(truth);
            driven.estimates.push(estimate.map_from_base().to_planar());
            if found.is_nan() {
                found = seen.truth.stamp.seconds();
                if let Some(goal) = goals.next() {
                    system.go_to(goal)?;
                }
            }
        }
        steps += 1;
        if step % every != 0 {
            continue;
        }
        let command = planning.time(|| system.command(motion, CYCLE))?;
        motion = command.motion;
        let over = f64::from(steps) * drive::STEP > LONGEST;
        let ended = match command.status {
            Some(NavigationStatus::Arrived) => {
                arrived += 1;
                true
            }
            Some(NavigationStatus::GaveUp(_)) => true,
            _ => over,
        };
        if ended {
            ends.push(format!("{:?}", command.status));
            steps = 0;
            match goals.next() {
                Some(goal) if !over => system.go_to(goal)?,
                _ => break,
            }
        }
    }
    report
        .number("found_after_s", found)
        .count("goals", driven.goals.len())
        .count("arrived", arrived)
        .text("ends", ends.join(", "))
        .number("drive_length_m", way)
        .number("drive_clearance_m", clearance)
        .number("drive_error_mean_m", mean_error(driven))
        .number("sense_ms_p99", sensing.milliseconds(99.0))
        .number("command_ms_p50", planning.milliseconds(50.0))
        .number("command_ms_p99", planning.milliseconds(99.0));
    Ok(())
}

fn mean_error(driven: &Driven) -> f64 {
    let apart = driven.estimates.iter().zip(&driven.truths).map(|(a, b)| a.minus(b).xy().norm());
    apart.sum::<f64>() / driven.truths.len().max(1) as f64
}
