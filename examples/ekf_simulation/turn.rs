//! Paper 000, Figs. 41 to 43: one turn and back to the start, as odometry, an extended filter and particles see it.
//!
//! The paper's vehicle ends where it began; its odometry believes it 0.385 m away, the fused odometry and IMU 0.263 m, Monte
//! Carlo localisation 0.203 m. It states neither the turn's radius nor any noise. Here it is a circle of 1 m radius in a room
//! with pillars, and a turn on the spot; odometry that reads distances and turns wrong by some per cent, different in each run;
//! an IMU whose heading is off by a drift of 0.1 °/s and 0.01 rad of white noise; a laser of 10 m.

use crate::{Result, mean_and_error};
use agv_nav::{
    core::{
        grid::{LikelihoodField, LikelihoodFieldParams},
        odometry::OdometryIncrement,
    },
    filters::{
        kalman::{Ekf, Gate, PlanarPose, PlanarState, Unicycle, UnicycleParams, YawReading},
        particle::{
            DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
            OdometryNoise,
        },
    },
    nalgebra::{Matrix3, Vector3},
    prelude::*,
};
use agv_sim::{GridWorld, Laser, LaserParams, OdometryErrors, Vehicle, VehicleParams};
use agv_support::{
    cli::Report,
    plot::{Color, Scene, TimeSeries},
};
use rand_distr::{Distribution, StandardNormal};
use std::{f64::consts::TAU, path::Path};

const DT: f64 = 0.05;
/// Standard deviations over the runs: of the odometry's scale of distances and of turns, and of the gyro's drift in rad/s.
const DISTANCE_SCALE: f64 = 0.03;
const YAW_SCALE: f64 = 0.05;
const DRIFT: f64 = 1.7e-3;
const YAW_SIGMA: f64 = 0.01;

/// A room of 6 m by 5 m with two pillars.
fn room() -> Result<Grid<CellState>> {
    let layout = GridLayout::new(124, 104, 0.05, Se2::new(-3.1, -2.6, 0.0))?;
    let mut map = Grid::filled(layout, CellState::Free);
    for x in 0..124 {
        for y in 0..104 {
            let wall = x < 2 || y < 2 || x >= 122 || y >= 102;
            let pillar =
                (100..106).contains(&x) && (80..90).contains(&y) || (20..32).contains(&x) && (14..20).contains(&y);
            if wall || pillar {
                map.set(Cell::new(x, y), CellState::Occupied);
            }
        }
    }
    Ok(map)
}

/// Believed poses at the end of a step: odometry, extended filter, particles; and the true one.
type Poses = [Se2; 4];

/// Who believes, in that order.
const BELIEVERS: [&str; 3] = ["odometry", "ekf", "mcl"];

fn run(map: &Grid<CellState>, twist: &Twist2, seed: Seed) -> Result<Vec<Poses>> {
    let mut stream = seed.derive(7).stream(0, 0);
    let mut normal = || -> f64 { StandardNormal.sample(&mut stream) };
    let odometry = OdometryErrors {
        distance_scale: DISTANCE_SCALE * normal(),
        yaw_scale: YAW_SCALE * normal(),
        ..OdometryErrors::default()
    };
    let drift = DRIFT * normal();
    let start = Se2::new(0.0, -1.0, 0.0);
    let mut vehicle = Vehicle::new(VehicleParams { odometry, ..VehicleParams::default() }, start, seed.derive(1))?;
    let world = GridWorld::new(map);
    let mut laser = Laser::new(LaserParams::default().with_beams(360, TAU), seed.derive(2))?;

    let field = LikelihoodField::new(map, LikelihoodFieldParams::default())?;
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
    let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.05))?;
    let mut mcl = Mcl::new(
        motion,
        sensor,
        FreeSpace::new(map, 0.2)?,
        MclParams { particles: 500, ..Default::default() },
        seed.derive(3),
    )?;
    let spread = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-4));
    mcl.initialize(&PoseBelief::around(start, spread)?)?;

    let drive = Unicycle::new(UnicycleParams {
        variance_per_metre: DISTANCE_SCALE * DISTANCE_SCALE,
        variance_per_radian: YAW_SCALE * YAW_SCALE,
        ..UnicycleParams::default()
    })?;
    let compass = YawReading::new(YAW_SIGMA)?;
    let pose = PlanarPose::from(Vector3::new(start.x(), start.y(), start.yaw()));
    let mut ekf = Ekf::new(pose, spread)?;

    let (mut odom, mut track, mut turned, mut time) = (start, Vec::new(), 0.0, 0.0);
    // A turn as the vehicle makes it, then to rest.
    while turned < TAU || vehicle.truth().twist.speed() + vehicle.truth().twist.yaw_rate.abs() > 1e-3 {
        let before = vehicle.truth().map_from_base;
        let stopping = turned + 0.5 * vehicle.truth().twist.yaw_rate.powi(2) >= TAU;
        let increment: OdometryIncrement = vehicle.step(if stopping { &Twist2::ZERO } else { twist }, DT)?;
        time += DT;
        let truth = vehicle.truth();
        turned += before.between(&truth.map_from_base).yaw();
        odom = odom * increment.start_from_end;

        let read = increment.start_from_end.log() / DT;
        ekf.predict(&drive, &Twist2::from(read), DT)?;
        let heading = truth.map_from_base.yaw() + drift * time + YAW_SIGMA * normal();
        ekf.update(&compass, &heading, &Gate::OPEN)?;

        mcl.predict(&increment)?;
        mcl.update(laser.scan(&world, &truth.map_from_base, &truth.twist, truth.stamp)?)?;
        let by_particles = mcl.estimate().map_or(start, |estimate| *estimate.map_from_base());
        track.push([odom, ekf.state().pose(), by_particles, truth.map_from_base]);
        if time > 60.0 {
            break;
        }
    }
    Ok(track)
}

/// A circle and a turn on the spot.
pub(crate) fn experiment(seeds: &[Seed], out: &Path) -> Result<Vec<Report>> {
    let map = room()?;
    let mut reports = Vec::new();
    for (name, twist) in [("circle", Twist2::new(0.4, 0.0, 0.4)), ("on_the_spot", Twist2::new(0.0, 0.0, 0.4))] {
        let tracks = seeds.iter().map(|&seed| run(&map, &twist, seed)).collect::<Result<Vec<_>>>()?;
        let ends: Vec<Poses> = tracks.iter().filter_map(|track| track.last().copied()).collect();
        let mut report = Report::new("One turn of Figs. 41 to 43");
        report.text("turn", name);
        for (index, believer) in BELIEVERS.iter().enumerate() {
            let distance = |poses: &Poses| (poses[index].translation() - poses[3].translation()).norm();
            let turn = |poses: &Poses| poses[3].between(&poses[index]).yaw().abs();
            let distances: Vec<f64> = ends.iter().map(distance).collect();
            report.number(&format!("{believer}_end_error_m"), mean_and_error(&distances).0);
            report.number(&format!("{believer}_end_error_max_m"), distances.iter().copied().fold(0.0, f64::max));
            report.number(
                &format!("{believer}_heading_rad"),
                mean_and_error(&ends.iter().map(turn).collect::<Vec<_>>()).0,
            );
        }
        let ordered = ends.iter().filter(|poses| {
            let [a, b, c] = [0, 1, 2].map(|i| (poses[i].translation() - poses[3].translation()).norm());
            c <= b && b <= a
        });
        report.number("runs_in_the_papers_order", ordered.count() as f64 / ends.len() as f64);
        reports.push(report);
        if let Some(track) = tracks.first() {
            draw(&map, name, track, out)?;
        }
    }
    Ok(reports)
}

/// Names and colours of the believers in the pictures.
const CURVES: [(&str, Color); BELIEVERS.len()] =
    [("odometry", Color::Red), ("odometry and IMU", Color::Orange), ("particles", Color::Blue)];

/// The turn from above, where there is something to see of it, and how far each is off.
fn draw(map: &Grid<CellState>, name: &str, track: &[Poses], out: &Path) -> Result<()> {
    let title = name.replace('_', " ");
    if name == "circle" {
        let truth = track.iter().map(|poses| &poses[3]);
        let mut scene = Scene::new(format!("One turn: {title}")).map(map).trajectory("truth", Color::Black, truth);
        for (index, (believer, color)) in CURVES.into_iter().enumerate() {
            let poses = track.iter().map(|poses| &poses[index]);
            scene = scene.trajectory(believer, color, poses);
        }
        scene.write(out.join(format!("turn_{name}.svg")))?;
    }
    let mut errors = TimeSeries::new(format!("One turn, {title}: error of the position"), "time, s", "error, m");
    for (index, (believer, color)) in CURVES.into_iter().enumerate() {
        let error = |poses: &Poses| (poses[index].translation() - poses[3].translation()).norm();
        let points = (1..).zip(track).map(|(step, poses)| (f64::from(step) * DT, error(poses)));
        errors = errors.curve(believer, color, points);
    }
    errors.write(out.join(format!("turn_{name}_errors.svg")))?;
    Ok(())
}
