//! The first drive: map a building from a recorded log, find the way in it, and drive.
//!
//! ```text
//! cargo run --release --example navigate
//! ```
//!
//! 1. **Map**: the laser scans of a recorded drive are entered at their reference poses into a log-odds grid.
//! 2. **Localise**: on another recorded drive, a particle filter follows the vehicle by raw odometry and scans alone.
//! 3. **Plan**: A* leads from where that drive ended to the far end of the building.
//! 4. **Drive**: a simulated AGV follows the path by pure pursuit, its pose coming from the particle filter on simulated
//!    scans of the map that was just built.
//!
//! You will see a table of sizes, errors and times, and pictures in `target/agv/navigate/`; it takes a few seconds. The
//! data are two drives through the Intel Research Lab (`data/intel/README.md`); with `--log` and `--reference` it runs on
//! yours, mapped from the same drive or from `--map-log`, or in a given `--map`.

use agv_nav::{
    control::track::{FollowerParams, PurePursuit, PurePursuitParams},
    core::{
        geometry::wrap_angle,
        grid::{
            EvidenceGrid, Footprint, Inflation, InflationParams, InverseModelParams, LikelihoodField,
            LikelihoodFieldParams, OccupancyThresholds,
        },
        metrics::Statistics,
        path::Course,
    },
    filters::particle::{
        DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
        OdometryNoise,
    },
    nalgebra::{Matrix3, Vector3},
    pipeline::Navigator,
    plan::{
        grid::{AStar, AStarParams, GridParams},
        smooth::{KeyNodes, LineOfSightParams, Straightened},
    },
    prelude::*,
};
use agv_sim::{Body, GridWorld, Laser, LaserParams, Simulator2d, Vehicle, VehicleParams};
use agv_support::{
    Error,
    cli::{CommonArgs, Report},
    log::{ScanLog, StampedPose, csv},
    map,
    plot::{Color, Scene, TimeSeries},
    progress::Progress,
    timing::Timings,
};
use clap::Parser;
use std::{path::PathBuf, process::ExitCode};

/// Map a building from a recorded log, localise in it, plan across it, and drive.
#[derive(Parser)]
struct Args {
    /// Recorded drive to localise: scans and raw odometry
    #[arg(long, default_value = "data/intel/drive_scans.csv.gz")]
    log: PathBuf,
    /// Reference poses of the drive, one per scan
    #[arg(long, default_value = "data/intel/drive_reference.csv.gz")]
    reference: PathBuf,
    /// Recorded drive to map [default: the shipped one, or `--log` if that is given]
    #[arg(long, requires = "map_reference")]
    map_log: Option<PathBuf>,
    /// Reference poses of the drive to map, one per scan
    #[arg(long, requires = "map_log")]
    map_reference: Option<PathBuf>,
    /// Map to use instead of one made from a log (map_server's YAML)
    #[arg(long)]
    map: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArgs,
}

/// Edge of a map cell, in metres.
const RESOLUTION: f64 = 0.05;

/// Radius of the simulated vehicle, in metres.
const VEHICLE_RADIUS: f64 = 0.25;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("navigate")?;
        let mut report = Report::new("The first drive");
        let recorded = Recording::read(&args.log, &args.reference)?;
        let map = build_map(&args, &recorded, &mut report)?;
        let localized = localize(&args, &map, &recorded, &mut report)?;
        let drive = drive(&args, &map, localized.end(), &recorded, &mut report)?;
        draw(&out, &map, &recorded, &localized, &drive)?;
        map::write(out.join("map.yaml"), &map)?;
        report.print(args.common.json)?;
        Result::Ok(())
    })
}

/// A log with a reference pose for each of its scans.
struct Recording {
    log: ScanLog,
    reference: Vec<StampedPose>,
}

impl Recording {
    fn read(log: &PathBuf, reference: &PathBuf) -> Result<Self> {
        let recording = Self { log: ScanLog::read(log)?, reference: csv::read_reference(reference)? };
        let (scans, poses) = (recording.log.entries.len(), recording.reference.len());
        if scans == 0 || scans != poses {
            return Err(format!("{}: {poses} reference poses for {scans} scans", reference.display()).into());
        }
        Ok(recording)
    }
}

/// Stage 1: enters every scan at its reference pose into a log-odds grid.
fn build_map(args: &Args, recorded: &Recording, report: &mut Report) -> Result<Grid<CellState>> {
    if let Some(path) = &args.map {
        let map = map::read(path)?;
        report.count("map_cells", map.layout().len()).count("map_cells_updated", 0).number("map_ms", 0.0);
        return Ok(map);
    }
    let shipped = Args::parse_from(["navigate"]);
    let separate = match (&args.map_log, &args.map_reference) {
        (Some(log), Some(reference)) => Some(Recording::read(log, reference)?),
        _ if args.log == shipped.log => {
            let [log, reference] = ["scans", "reference"].map(|part| format!("data/intel/map_{part}.csv.gz").into());
            Some(Recording::read(&log, &reference)?)
        }
        _ => None,
    };
    let Recording { log, reference } = separate.as_ref().unwrap_or(recorded);

    let seed = GridLayout::new(64, 64, RESOLUTION, Se2::default())?;
    let mut grid = EvidenceGrid::new(seed, InverseModelParams::default())?;
    let (mut timings, mut updated) = (Timings::default(), 0);
    let progress = Progress::new(reference.len(), "mapping");
    for (entry, reference) in progress.over(log.entries.iter().zip(reference)) {
        updated += timings.time(|| grid.insert_scan(&entry.scan, &reference.pose))?.cells_updated();
    }
    let map = grid.states(&OccupancyThresholds::default());
    report
        .count("map_scans", timings.count())
        .count("map_cells", map.layout().len())
        .count("map_cells_updated", updated as usize)
        .number("map_ms", timings.total_milliseconds())
        .number("map_scan_ms_p50", timings.milliseconds(50.0));
    Ok(map)
}

/// The localizer of both drives: a particle filter on the likelihood field of the map.
fn localizer(
    map: &Grid<CellState>,
    inside: &Se2,
    args: &Args,
    seed: Seed,
) -> Result<Box<dyn Correct<LaserScan, Pose = Se2> + Send>> {
    let field = LikelihoodField::new(map, LikelihoodFieldParams::default())?;
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
    let motion = DifferentialOdometryModel::new(OdometryNoise::default())?;
    let free_space = FreeSpace::new(map, VEHICLE_RADIUS)?.reached_from(&inside.translation())?;
    let mcl = Mcl::new(motion, sensor, free_space, MclParams::default(), seed)?;
    Ok(Box::new(mcl.with_parallelism(args.common.par())))
}

/// What is known of the start: half a metre and 15 degrees.
fn start_belief(start: &Se2) -> Result<PoseBelief<Se2>> {
    let deviations = Vector3::new(0.5, 0.5, 15_f64.to_radians());
    Ok(PoseBelief::around(*start, Matrix3::from_diagonal(&deviations.component_mul(&deviations)))?)
}

/// Estimates beside the truth, at some moments of a drive.
#[derive(Default)]
struct Track {
    /// Seconds since the start.
    times: Vec<f64>,
    estimates: Vec<Se2>,
    truths: Vec<Se2>,
}

impl Track {
    fn push(&mut self, time: f64, estimate: Se2, truth: Se2) {
        self.times.push(time);
        self.estimates.push(estimate);
        self.truths.push(truth);
    }

    fn position_errors(&self) -> Vec<f64> {
        self.pairs().map(|(e, t)| (e.translation() - t.translation()).norm()).collect()
    }

    fn heading_errors(&self) -> Vec<f64> {
        self.pairs().map(|(e, t)| wrap_angle(e.yaw() - t.yaw()).abs().to_degrees()).collect()
    }

    fn pairs(&self) -> impl Iterator<Item = (&Se2, &Se2)> {
        self.estimates.iter().zip(&self.truths)
    }

    fn end(&self) -> Se2 {
        self.estimates.last().copied().unwrap_or_default()
    }
}

/// Stage 2: follows the recorded drive by raw odometry and scans; the errors are taken at every update.
fn localize(args: &Args, map: &Grid<CellState>, recorded: &Recording, report: &mut Report) -> Result<Track> {
    let start = recorded.reference[0].pose;
    let mut localizer = localizer(map, &start, args, args.common.seed())?;
    localizer.initialize(&start_belief(&start)?)?;

    let (mut track, mut timings) = (Track::default(), Timings::default());
    let progress = Progress::new(recorded.reference.len(), "localising");
    let mut last = &recorded.log.entries[0];
    for (entry, reference) in progress.over(recorded.log.entries.iter().zip(&recorded.reference)) {
        let (from, to) = (last.scan.stamp(), entry.scan.stamp());
        localizer.predict(&OdometryIncrement::between(from, &last.odom_from_base, to, &entry.odom_from_base)?)?;
        last = entry;
        let mut attempt = Timings::default();
        if matches!(attempt.time(|| localizer.update(&entry.scan))?, UpdateOutcome::Applied(_)) {
            timings.append(attempt);
            let time = to - recorded.log.entries[0].scan.stamp();
            let estimate = localizer.estimate().ok_or("the localizer has no belief")?;
            track.push(time, *estimate.map_from_base(), reference.pose);
        }
    }
    let (position, heading) = (Statistics::new(track.position_errors())?, Statistics::new(track.heading_errors())?);
    report
        .count("localization_updates", timings.count())
        .number("localization_mean_m", position.mean())
        .number("localization_max_m", position.max())
        .number("heading_mean_deg", heading.mean())
        .number("heading_max_deg", heading.max())
        .number("localize_ms_p50", timings.milliseconds(50.0))
        .number("localize_ms_p99", timings.milliseconds(99.0));
    Ok(track)
}

/// What the simulated drive left behind.
struct Drive {
    path: Path,
    track: Track,
    /// Distance of the vehicle from the path, to the left, in metres.
    cross_track: Vec<f64>,
}

/// Stages 3 and 4: plans from `start` across the building and lets a simulated vehicle drive there.
fn drive(args: &Args, map: &Grid<CellState>, start: Se2, recorded: &Recording, report: &mut Report) -> Result<Drive> {
    let seed = args.common.seed().derive(1);
    let footprint = Footprint::circle(VEHICLE_RADIUS)?;
    let costmap = Inflation::new(InflationParams::for_footprint(&footprint))?.inflate(map)?;
    // Keep away from walls where there is room: dear cells are avoided, and straight lines do not enter them.
    let grid = GridParams { cost_weight: 2.0, ..GridParams::default() };
    let astar = AStar::new(AStarParams { grid, start_tolerance: 0.5, ..AStarParams::default() })?;
    let key_nodes = KeyNodes::new(LineOfSightParams { max_cost: 100, ..LineOfSightParams::default() })?;
    let limits = TwistLimits { forward_speed: 0.8, ..TwistLimits::default() };
    let mut navigator = Navigator::new(
        localizer(map, &start, args, seed.derive(0))?,
        Box::new(Straightened::new(astar, key_nodes)),
        Box::new(PurePursuit::new(PurePursuitParams::default())?),
        costmap,
        limits.into(),
    )?;
    navigator.start(&PoseBelief::around(start, Matrix3::identity() * 1e-4)?)?;
    let mut plan = Timings::default();
    let expansions = go_far(&mut navigator, &mut plan, start, recorded)?;

    let (dt, laser) = (0.05, LaserParams::default().with_beams(181, std::f64::consts::PI));
    let vehicle = VehicleParams { limits, ..VehicleParams::default() };
    let mut simulator = Simulator2d::new(
        GridWorld::new(map),
        Vehicle::new(vehicle, start, seed.derive(1))?,
        Body::circle(VEHICLE_RADIUS)?,
        dt,
    )?
    .with_laser(Laser::new(laser, seed.derive(2))?, 2)?;

    let mut course = Course::new(FollowerParams::default().bend_window);
    course.set(navigator.path())?;
    let mut drive = Drive { path: navigator.path().clone(), track: Track::default(), cross_track: Vec::new() };
    let (mut command, mut cycles, mut arrived, mut contacts) = (Motion::REST, Timings::default(), false, 0);
    let cycles_at_most = (20.0 * drive.path.length() / limits.forward_speed / dt) as usize;
    for cycle in 1..=cycles_at_most {
        let seen = simulator.step(&command.twist)?;
        let step = cycles.time(|| navigator.cycle(&seen.odometry, seen.scan(), command, dt))?;
        let track = step.command.ok_or("the navigator has no path")?;
        command = track.motion;
        contacts += usize::from(seen.contact);
        let truth = seen.truth.map_from_base;
        drive.track.push(cycle as f64 * dt, *step.estimate.map_from_base(), truth);
        drive.cross_track.extend(course.advance(&truth.translation(), 2.0).map(|p| p.cross_track));
        arrived = track.status == TrackStatus::Arrived;
        if arrived {
            break;
        }
    }
    let errors = Statistics::new(drive.cross_track.clone())?;
    let position = Statistics::new(drive.track.position_errors())?;
    let goal = drive.path.points().last().map_or(start, |p| p.pose);
    let end = simulator.vehicle().map_from_base();
    report
        .number("plan_ms", plan.milliseconds(50.0))
        .count("plan_expansions", expansions as usize)
        .number("path_length_m", drive.path.length())
        .count("path_key_nodes", drive.path.len())
        .flag("arrived", arrived)
        .count("contacts", contacts)
        .number("drive_time_s", drive.track.times.last().copied().unwrap_or(0.0))
        .number("tracking_rmse_m", errors.rmse())
        .number("tracking_max_m", errors.max().max(-errors.min()))
        .number("drive_localization_mean_m", position.mean())
        .number("goal_error_m", (end.translation() - goal.translation()).norm())
        .number("cycle_ms_p50", cycles.milliseconds(50.0))
        .number("cycle_ms_p99", cycles.milliseconds(99.0));
    Ok(drive)
}

/// Plans to the farthest pose of the recorded drive that can be reached, and returns the expansions of that query.
fn go_far(navigator: &mut Navigator, timings: &mut Timings, start: Se2, recorded: &Recording) -> Result<u64> {
    let distance = |pose: &Se2| (pose.translation() - start.translation()).norm();
    let mut goals: Vec<Se2> = recorded.reference.iter().map(|r| r.pose).collect();
    goals.sort_by(|a, b| distance(b).total_cmp(&distance(a)));
    for goal in goals.iter().step_by(10) {
        let mut attempt = Timings::default();
        if let PlanOutcome::Found { expansions, .. } = attempt.time(|| navigator.go_to(goal))? {
            timings.append(attempt);
            return Ok(expansions);
        }
    }
    Err("no pose of the recorded drive can be reached in the map".into())
}

/// Draws both drives in the map, and their errors over time.
fn draw(
    out: &std::path::Path,
    map: &Grid<CellState>,
    recorded: &Recording,
    localized: &Track,
    drive: &Drive,
) -> std::result::Result<(), Error> {
    let entries = &recorded.log.entries;
    let map_from_odom = recorded.reference[0].pose * entries[0].odom_from_base.inverse();
    let odometry: Vec<Se2> = entries.iter().map(|e| map_from_odom * e.odom_from_base).collect();
    Scene::new("Localisation on the recorded drive")
        .map(map)
        .trajectory("raw odometry", Color::Grey, &odometry)
        .trajectory("reference", Color::Green, &localized.truths)
        .trajectory("particle filter", Color::Blue, &localized.estimates)
        .write(out.join("localization.png"))?;
    TimeSeries::new("Localisation error on the recorded drive", "time, s", "error, m or deg")
        .curve("position, m", Color::Blue, errors_over_time(localized, &localized.position_errors()))
        .curve("heading, deg", Color::Orange, errors_over_time(localized, &localized.heading_errors()))
        .write(out.join("localization_error.svg"))?;
    let path: Vec<Se2> = drive.path.points().iter().map(|p| p.pose).collect();
    let (first, last) = (path[0].translation(), path[path.len() - 1].translation());
    Scene::new("Planned and driven across the map")
        .map(map)
        .trajectory("planned path", Color::Orange, &path)
        .trajectory("driven", Color::Blue, &drive.track.truths)
        .mark("start", Color::Green, first)
        .mark("goal", Color::Red, last)
        .write(out.join("drive.png"))?;
    TimeSeries::new("Errors of the simulated drive", "time, s", "error, m")
        .curve("cross-track", Color::Orange, errors_over_time(&drive.track, &drive.cross_track))
        .curve("localisation", Color::Blue, errors_over_time(&drive.track, &drive.track.position_errors()))
        .write(out.join("drive_error.svg"))
}

fn errors_over_time(track: &Track, errors: &[f64]) -> Vec<(f64, f64)> {
    track.times.iter().copied().zip(errors.iter().copied()).collect()
}
