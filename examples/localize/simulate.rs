//! A drive in a map that has no log: to random places, one after the other, with the truth as reference.

use super::{Result, load::Drive};
use agv_nav::{
    control::track::{PurePursuit, PurePursuitParams},
    core::grid::{Footprint, Inflation, InflationParams},
    filters::particle::FreeSpace,
    plan::{
        grid::{AStar, AStarParams, GridParams},
        smooth::{KeyNodes, LineOfSightParams, Straightened},
    },
    prelude::*,
};
use agv_sim::{Body, GridWorld, Laser, LaserParams, Simulator2d, Vehicle, VehicleParams};
use agv_support::{
    log::{LogEntry, ScanLog, StampedPose},
    progress::Progress,
};

/// Radius of the vehicle, and the room that it keeps to walls at its goals, in metres.
const RADIUS: f64 = 0.25;
const ROOM: f64 = 0.4;

/// Step of the simulation, in seconds; every other one has a scan.
const STEP: f64 = 0.05;

/// Drives so many metres in the largest free area of the map.
pub(crate) fn drive(map: Grid<CellState>, metres: f64, seed: Seed) -> Result<Drive> {
    let space = FreeSpace::new(&map, ROOM)?.largest();
    let mut stream = seed.stream(0, 0);
    let start = space.sample(&mut stream);

    let footprint = Footprint::circle(RADIUS)?;
    let costmap = Inflation::new(InflationParams::for_footprint(&footprint))?.inflate(&map)?;
    let grid = GridParams { cost_weight: 2.0, ..GridParams::default() };
    let astar = AStar::new(AStarParams { grid, start_tolerance: 0.5, ..AStarParams::default() })?;
    let key_nodes = KeyNodes::new(LineOfSightParams { max_cost: 100, ..LineOfSightParams::default() })?;
    let (mut planner, mut path) = (Straightened::new(astar, key_nodes), Path::new());
    let mut tracker = PurePursuit::new(PurePursuitParams::default())?;

    let limits = TwistLimits { forward_speed: 0.8, ..TwistLimits::default() };
    let vehicle = Vehicle::new(VehicleParams { limits, ..VehicleParams::default() }, start, seed.derive(1))?;
    let laser = Laser::new(LaserParams::default().with_beams(181, std::f64::consts::PI), seed.derive(2))?;
    let body = Body::circle(RADIUS)?;
    let mut simulator = Simulator2d::new(GridWorld::new(&map), vehicle, body, STEP)?.with_laser(laser, 2)?;

    let (mut log, mut reference) = (ScanLog::default(), Vec::new());
    let (mut odom_from_base, mut motion, mut travelled, mut truth) = (Se2::identity(), Motion::REST, 0.0, start);
    let (progress, mut shown) = (Progress::new(metres as usize, "simulating"), 0);
    // A goal that cannot be reached, or not in time, is followed by another.
    for _ in 0..10 + metres as usize {
        let found = planner.plan_into(&costmap, &truth, &space.sample(&mut stream), &mut path);
        if !matches!(found, Ok(PlanOutcome::Found { .. })) || tracker.set_path(&path).is_err() {
            continue;
        }
        for _ in 0..(5.0 * path.length() / limits.forward_speed / STEP) as usize {
            let command = tracker.command(&VehicleState::new(truth, motion.twist), &limits.into(), STEP)?;
            motion = command.motion;
            let seen = simulator.step(&motion.twist)?;
            odom_from_base = odom_from_base * seen.odometry.start_from_end;
            let pose = seen.truth.map_from_base;
            travelled += (pose.translation() - truth.translation()).norm();
            truth = pose;
            if let Some(scan) = seen.scan() {
                log.entries.push(LogEntry { odom_from_base, scan: scan.clone(), corrected: None, line: 0 });
                reference.push(StampedPose { stamp: scan.stamp(), pose });
            }
            if command.status == TrackStatus::Arrived || travelled > metres {
                break;
            }
        }
        while shown < travelled.min(metres) as usize {
            progress.step();
            shown += 1;
        }
        if travelled > metres {
            break;
        }
    }
    Ok(Drive { map, log, reference, relations: Vec::new() })
}
