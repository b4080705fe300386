//! One run: world, vehicle, scanner and odometry around a navigation.

use crate::{Args, Result, contact::Way, planners, sight::Sight, worlds::Trial};
use agv_nav::{
    core::{geometry::Twist2, metrics::Statistics, obstacle::MovingObstacle},
    pipeline::{NavigationRequest, NavigationStatus},
    prelude::{LieGroup, Motion, MotionLimits, Se2, Seed, VehicleState},
};
use agv_sim::{Drive, Laser, LaserParams, OdometryErrors, PlanarWorld, Simulator2d, Vehicle, VehicleParams};
use agv_support::{progress::Progress, timing::Timings};
use rand_distr::{Distribution as _, Normal};
use std::sync::Mutex;

/// Time of a planning cycle and of a scan, in seconds.
pub(crate) const CYCLE: f64 = 0.05;
/// Steps of the simulation in a cycle: the vehicle's ramps are smooth.
const STEPS: u64 = 5;
/// Distance from the goal at which it succeeds, in metres.
const REACHED: f64 = 1.0;
/// Relative error of the odometry.
const ODOMETRY: f64 = 0.01;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum End {
    Success,
    Collision,
    Timeout,
    GaveUp,
    /// It stands where it believes that it has arrived, and is not there.
    Missed,
}

impl End {
    /// Whether a navigation that says this ends a run, with the vehicle at rest or not.
    const fn told_by(status: NavigationStatus, rests: bool) -> Option<Self> {
        match status {
            NavigationStatus::GaveUp(_) => Some(Self::GaveUp),
            NavigationStatus::Arrived if rests => Some(Self::Missed),
            _ => None,
        }
    }
}

/// What became of a run.
pub(crate) struct Run {
    pub(crate) end: End,
    /// Why the vehicle stood at the end, or the last status.
    pub(crate) status: NavigationStatus,
    /// Duration, in seconds.
    pub(crate) time: f64,
    /// Length of the way, in metres.
    pub(crate) length: f64,
    pub(crate) score: f64,
    /// Least clearance, in metres, at most one.
    pub(crate) clearance: f64,
    /// Share of the time in which something is nearer than the safe distance.
    pub(crate) danger: f64,
    /// Mean magnitude of the acceleration along the way, in metres per second squared.
    pub(crate) smoothness: f64,
    /// Times of costmap, global and local planning together.
    pub(crate) cycles: Timings,
    /// Of the costmap alone.
    pub(crate) sight: Timings,
    /// True poses, once a cycle.
    pub(crate) track: Vec<Se2>,
    /// Paths: the first, and each that was taken later.
    pub(crate) paths: Vec<Vec<agv_nav::nalgebra::Vector2<f64>>>,
    /// Moving obstacles at the end.
    pub(crate) obstacles: Vec<MovingObstacle>,
    pub(crate) recoveries: usize,
    /// Cycles in which the vehicle got out of somebody's way.
    pub(crate) evasions: usize,
}

impl Run {
    /// One that has not begun.
    fn from(start: Se2) -> Self {
        Self {
            end: End::Timeout,
            status: NavigationStatus::Idle,
            time: 0.0,
            length: 0.0,
            score: 0.0,
            clearance: 1.0,
            danger: 0.0,
            smoothness: 0.0,
            cycles: Timings::default(),
            sight: Timings::default(),
            track: vec![start],
            paths: Vec::new(),
            obstacles: Vec::new(),
            recoveries: 0,
            evasions: 0,
        }
    }
}

/// All runs, in the order of the trials; several at once where threads are given.
pub(crate) fn all(trials: &[Trial], args: &Args) -> Result<Vec<Run>> {
    let progress = Progress::new(trials.len(), "driving");
    let next = Mutex::new(0..trials.len());
    let done: Mutex<Vec<Option<Result<Run>>>> = Mutex::new(trials.iter().map(|_| None).collect());
    let work = || {
        let take = || next.lock().ok().and_then(|mut next| next.next());
        while let Some(index) = take() {
            let seed = args.common.seed().derive(trials[index].number);
            let run = one(&trials[index], args, seed);
            if let Ok(mut done) = done.lock() {
                done[index] = Some(run);
            }
            progress.step();
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..args.common.threads {
            scope.spawn(work);
        }
        work();
    });
    let done = done.into_inner().map_err(|_| "a run panicked")?;
    done.into_iter().map(|run| run.unwrap_or_else(|| Err("a run is missing".into()))).collect()
}

fn vehicle(v_max: f64, start: Se2, seed: Seed) -> Result<Vehicle> {
    let mut stream = seed.derive(1).stream(0, 0);
    let scale = Normal::new(0.0, ODOMETRY)?;
    // Each step's own error averages out over the steps of a cycle: larger by the root of their number.
    let alpha = ODOMETRY * ODOMETRY * STEPS as f64;
    let odometry = OdometryErrors {
        alphas: [alpha, 0.0, alpha, 0.0],
        distance_scale: scale.sample(&mut stream),
        yaw_scale: scale.sample(&mut stream),
        ..OdometryErrors::NONE
    };
    let ideal = VehicleParams::new(Drive::default()).ideal();
    let params = VehicleParams { limits: planners::limits(v_max), odometry, ..ideal };
    Ok(Vehicle::new(params, start, seed.derive(2))?)
}

/// Puts what truly moves to where a vehicle at `truth` that believes to be elsewhere would see it.
fn as_seen(obstacles: &mut [MovingObstacle], truth: &Se2, believed: &Se2) {
    for obstacle in obstacles {
        obstacle.position = believed.act(&truth.inverse().act(&obstacle.position));
        obstacle.velocity = believed.rotation().act(&truth.rotation().inverse().act(&obstacle.velocity));
    }
}

fn one(trial: &Trial, args: &Args, seed: Seed) -> Result<Run> {
    let (planner, v_max, frozen) = (args.planner, args.v_max, args.compare.frozen);
    let world: &dyn PlanarWorld = &*trial.world;
    let (body, footprint) = (planners::body()?, planners::footprint()?);
    let limits: MotionLimits = planners::limits(v_max).into();
    let mut laser = LaserParams { dropout: 0.0, ..LaserParams::default() }.with_beams(720, 270_f64.to_radians());
    laser.geometry.range_max = 10.0;
    let mut simulator =
        Simulator2d::new(world, vehicle(v_max, trial.start, seed)?, body.clone(), CYCLE / STEPS as f64)?
            .with_laser(Laser::new(laser, seed.derive(3))?, STEPS)?
            .with_moving(trial.moving.clone());
    let known = trial.map.as_ref().filter(|_| args.worlds.known_map);
    let mut sight = Sight::new(&footprint, trial.window, frozen, known)?;
    let mut navigation = planners::navigation(planner, args.compare.adaptive_window)?;
    navigation.go_to(&trial.goal)?;

    let mut run = Run::from(trial.start);
    let mut endangered = 0.0;
    let (mut believed, mut motion, mut states) = (trial.start, Motion::REST, Vec::new());
    let (mut changes, mut told, mut was_recovering) = (Vec::new(), Vec::new(), false);
    let mut scan = simulator.look()?.scan().cloned().ok_or("the laser is silent")?;
    let cycles = (args.timeout / CYCLE) as u64;
    'driving: for cycle in 0..cycles {
        if args.compare.oracle {
            trial.moving.states_into(cycle as f64 * CYCLE, &mut told);
            as_seen(&mut told, &simulator.vehicle().map_from_base(), &believed);
        }
        let command = run.cycles.time(|| {
            run.sight.time(|| sight.look(&scan, &believed, args.compare.oracle.then_some(&*told)))?;
            navigation
                .cycle(NavigationRequest {
                    // The vehicle ramps where planners take commands as steps: half a cycle ahead both come to the same.
                    state: VehicleState::new(believed * motion.twist.integrate(0.5 * CYCLE), motion.twist),
                    map: sight.map(),
                    obstacles: sight.obstacles(),
                    limits: &limits,
                    dt: CYCLE,
                })
                .map_err(Box::<dyn std::error::Error + Send + Sync>::from)
        })?;
        if command.forget_map {
            sight.forget()?;
        }
        let is_recovering = matches!(command.status, NavigationStatus::Recovering(_));
        run.recoveries += usize::from(is_recovering && !was_recovering);
        was_recovering = is_recovering;
        run.evasions += usize::from(command.status == NavigationStatus::Evading);
        run.status = command.status;
        if command.planned {
            let path: Vec<_> = navigation.path().points().iter().map(|point| point.pose.translation()).collect();
            if run.paths.last() != Some(&path) {
                run.paths.push(path);
            }
        }
        // It has not moved in the last cycle either.
        let rests = motion.twist == Twist2::ZERO && command.motion.twist == Twist2::ZERO;
        if let Some(end) = End::told_by(command.status, rests) {
            run.end = end;
            break;
        }
        changes.push((command.motion.twist.vx - motion.twist.vx).abs() / CYCLE);
        motion = command.motion;
        for step in 0..STEPS {
            let start = simulator.vehicle().map_from_base();
            let time = (cycle * STEPS + step) as f64 * simulator.dt();
            let seen = simulator.step(&motion.twist)?;
            believed = believed.compose(&seen.odometry.start_from_end);
            if let Some(new) = seen.scan() {
                scan.clone_from(new);
            }
            let (twist, end) = (seen.truth.twist, seen.truth.map_from_base);
            let way = Way { world, moving: &trial.moving, body: &body, start, twist, time };
            let (touches, clearance) = way.touches(simulator.dt(), &mut states);
            run.clearance = run.clearance.min(clearance);
            endangered += if clearance < args.safe_distance { simulator.dt() } else { 0.0 };
            run.time = time + simulator.dt();
            run.length += (end.translation() - start.translation()).norm();
            if touches {
                run.end = End::Collision;
                run.clearance = 0.0;
                run.track.push(end);
                break 'driving;
            }
            if (end.translation() - trial.goal.translation()).norm() <= REACHED {
                run.end = End::Success;
                run.track.push(end);
                break 'driving;
            }
        }
        run.track.push(simulator.vehicle().map_from_base());
        // Who has a map finds its place in it.
        if known.is_some() {
            believed = simulator.vehicle().map_from_base();
        }
    }
    run.danger = endangered / run.time.max(CYCLE);
    run.smoothness = Statistics::new(changes).map_or(0.0, |s| s.mean());
    run.obstacles = simulator.obstacles().to_vec();
    if run.end == End::Success {
        run.score = trial.optimal_time / run.time.clamp(2.0 * trial.optimal_time, 8.0 * trial.optimal_time);
    }
    Ok(run)
}
