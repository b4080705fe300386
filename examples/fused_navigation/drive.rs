//! A drive: the vehicle in its world, with a scanner that sees what the map does not show.

use crate::{Result, cases::Case};
use agv_nav::{
    core::grid::{CollisionParams, Footprint, InflationParams, LocalMapParams, RollingCostmap, RollingParams},
    filters::tracking::{ObstacleTracker, TrackerParams},
    nalgebra::Vector2,
    pipeline::{NavigationRequest, NavigationStatus},
    prelude::*,
};
use agv_sim::{Body, Laser, LaserParams, MovingDiscs, Shape, Simulator2d, Vehicle, VehicleParams, World2d};
use agv_support::{cli::Report, timing::Timings};

/// Time of a cycle, in seconds, and steps of the simulation in it.
const CYCLE: f64 = 0.1;
const STEPS: u64 = 5;
/// When a drive ends at the latest, in seconds.
const TIMEOUT: f64 = 100.0;

/// What became of a drive.
pub(crate) struct Driven {
    pub(crate) map: Grid<CellState>,
    pub(crate) unknown: Vec<Shape>,
    pub(crate) moving: MovingDiscs,
    pub(crate) goal: Se2,
    /// The first path.
    pub(crate) path: Vec<Vector2<f64>>,
    pub(crate) status: NavigationStatus,
    pub(crate) contact: bool,
    pub(crate) time: f64,
    /// Time, pose and motion in each cycle.
    pub(crate) track: Vec<(f64, Se2, Motion)>,
    clearance: f64,
    replans: usize,
    recoveries: usize,
    cycles: Timings,
}

/// Lets the vehicle of a case drive.
pub(crate) fn drive(mut case: Case, seed: Seed) -> Result<Driven> {
    let layout = *case.map.layout();
    let solid = (0..layout.len()).filter(|&i| case.map.values()[i] == CellState::Occupied);
    let square = |i| {
        Shape::rectangle(
            Se2::from_parts(layout.center(layout.cell(i)), So2::default()),
            layout.resolution(),
            layout.resolution(),
        )
    };
    let mut shapes: Vec<Shape> = solid.map(square).collect();
    shapes.extend(case.unknown.iter().cloned());
    let world = World2d::new(shapes)?;

    let mut limits = case.limits.twist;
    // How fast a steered vehicle turns follows from its speed and its wheels.
    limits.yaw_acceleration = limits.yaw_acceleration.max(case.limits.steering.map_or(0.0, |_| 100.0));
    let steering_rate = case.limits.steering.map_or(1.0, |steering| steering.max_rate);
    let vehicle = VehicleParams { limits, steering_rate, ..VehicleParams::new(case.drive).ideal() };
    let laser = LaserParams::default().with_beams(541, 270_f64.to_radians());
    let body = Body::rectangle(case.size.0, case.size.1)?;
    let mut simulator =
        Simulator2d::new(world, Vehicle::new(vehicle, case.start, seed.derive(1))?, body, CYCLE / STEPS as f64)?
            .with_laser(Laser::new(laser, seed.derive(2))?, STEPS)?
            .with_moving(case.moving.clone());

    // Two centimetres more on each side, for cells and noise.
    let (length, width) = (case.size.0 + 0.04, case.size.1 + 0.04);
    let footprint = Footprint::rectangle(-0.5 * length, 0.5 * length, width)?;
    let inflation = InflationParams { cost_scaling_factor: 4.0, ..InflationParams::for_footprint(&footprint) };
    let cells = (2.0 * layout.width().max(layout.height()) as f64 * layout.resolution() / 0.1) as usize + 20;
    let params = RollingParams {
        width: cells,
        height: cells,
        resolution: 0.1,
        mark_range: Some(6.0),
        forget_after: None,
        inflation: Some(inflation),
        ..RollingParams::default()
    };
    let mut rolling = RollingCostmap::new(params)?.with_footprint(footprint).with_static_map(case.map.clone())?;
    let collision = CollisionParams { unknown_is_obstacle: false, outside_is_obstacle: false };
    let mut local = LocalMap::new(rolling.costmap(), LocalMapParams { collision, max_distance: 3.0 })?;
    let mut tracker = ObstacleTracker::new(TrackerParams::default())?;
    case.navigation.go_to(&case.goal)?;

    let steering = case.limits.steering.map(|_| 0.0);
    let mut motion = Motion { steering, ..Motion::REST };
    let mut driven = Driven {
        map: case.map,
        unknown: case.unknown,
        moving: case.moving,
        goal: case.goal,
        path: Vec::new(),
        status: NavigationStatus::Idle,
        contact: false,
        time: 0.0,
        track: Vec::new(),
        clearance: 1.0,
        replans: 0,
        recoveries: 0,
        cycles: Timings::default(),
    };
    let mut scan = simulator.look()?.scan().cloned().ok_or("the laser is silent")?;
    for cycle in 0..(TIMEOUT / CYCLE) as u64 {
        let here = simulator.vehicle().map_from_base();
        let command = driven.cycles.time(|| -> Result<_> {
            let obstacles = tracker.update(&scan, &here)?.to_vec();
            rolling.update_where([&scan], &here, |_, beam| !tracker.is_moving_beam(beam))?;
            local.update(rolling.costmap())?;
            // The vehicle ramps where planners take commands as steps: half a cycle ahead both come to the same.
            let map_from_base = here * motion.twist.integrate(0.5 * CYCLE);
            let state = VehicleState { map_from_base, twist: motion.twist, steering: motion.steering };
            let request =
                NavigationRequest { state, map: &local, obstacles: &obstacles, limits: &case.limits, dt: CYCLE };
            Ok(case.navigation.cycle(request)?)
        })?;
        if command.forget_map {
            rolling.reset()?;
        }
        if driven.path.is_empty() {
            driven.path = case.navigation.path().points().iter().map(|point| point.pose.translation()).collect();
        }
        driven.replans += usize::from(command.planned);
        let recovers = |status| matches!(status, NavigationStatus::Recovering(_));
        driven.recoveries += usize::from(recovers(command.status) && !recovers(driven.status));
        driven.status = command.status;
        driven.time = cycle as f64 * CYCLE;
        motion = command.motion;
        driven.track.push((driven.time, here, motion));
        if matches!(command.status, NavigationStatus::Arrived | NavigationStatus::GaveUp(_)) {
            break;
        }
        for _ in 0..STEPS {
            let seen = simulator.step(&motion.twist)?;
            driven.contact |= seen.contact;
            if let Some(new) = seen.scan() {
                scan.clone_from(new);
            }
            driven.clearance = driven.clearance.min(simulator.clearance(1.0));
        }
    }
    Ok(driven)
}

impl Driven {
    /// Its figures.
    pub(crate) fn report(&self, name: &str) -> Report {
        let pairs = || self.track.windows(2);
        let length: f64 = pairs().map(|pair| (pair[1].1.translation() - pair[0].1.translation()).norm()).sum();
        let turned: f64 = pairs().map(|pair| pair[0].1.between(&pair[1].1).yaw().abs()).sum();
        let planned: f64 = self.path.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        let mut report = Report::new(name);
        report
            .text("case", name)
            .flag("arrived", self.status == NavigationStatus::Arrived)
            .flag("contact", self.contact)
            .text("status", format!("{:?}", self.status))
            .number("time_s", self.time)
            .number("length_m", length)
            .number("planned_length_m", planned)
            .count("key_nodes", self.path.len())
            .number("turned_deg", turned.to_degrees())
            .number("clearance_min_m", self.clearance)
            .count("plans", self.replans)
            .count("recoveries", self.recoveries)
            .number("cycle_ms_p50", self.cycles.milliseconds(50.0))
            .number("cycle_ms_p99", self.cycles.milliseconds(99.0));
        report
    }
}
