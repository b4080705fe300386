//! A drive through a generated factory: the end of an aisle, round the rack, and back along the next, as far as time allows.

use crate::{Args, Result, load::Drive};
use agv_nav::core::{
    check,
    geometry::{Se2, Se3, So3, Twist2, wrap_angle},
    nalgebra::{Vector2, Vector3},
    sensors::PointCloud,
};
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams, Simulator3d, Vehicle, VehicleParams};

/// Which lidar is simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Lines {
    /// 16 lines, 3 cm
    L16,
    /// 32 lines, 2 cm
    L32,
    /// 64 lines, 2 cm
    L64,
}

/// How much of either aisle is driven, in metres.
const STRETCH: f64 = 20.0;

/// Speed, in m/s.
const SPEED: f64 = 2.0;

/// Step of the simulation, in seconds.
const DT: f64 = 0.02;

/// Most steps, of which a lap has at most twice as many: beyond it the vehicle is stuck.
const STEPS: usize = 3000;

pub(crate) fn drive(args: &Args) -> Result<Drive> {
    let seed = args.common.seed();
    let factory = Factory::generate(FactoryParams::default(), seed)?;
    let along = factory.aisle_length();
    let at = |aisle: usize, x: f64| -> Vector2<f64> { factory.aisles()[aisle].translation() + Vector2::new(x, 0.0) };
    let start = at(1, along - STRETCH);
    let turn = [at(1, along), at(1, along + 1.5), at(2, along + 1.5), at(2, along)];
    let back = [at(2, 0.0), at(2, -1.5), at(1, -1.5), at(1, 0.0)];
    let (way, steps) = if let Some(laps) = args.laps {
        // All round, to where it began and some metres on.
        let lap = turn.iter().chain(&back).copied().collect::<Vec<_>>();
        (
            lap.repeat(usize::from(laps)).into_iter().chain([start + Vector2::new(0.5 * STRETCH, 0.0)]).collect(),
            usize::from(laps) * 2 * STEPS,
        )
    } else {
        let seconds = check::positive("seconds", args.seconds)?;
        ([&turn[..], &[at(2, along - STRETCH)]].concat(), STEPS.min((seconds / DT) as usize))
    };
    let lidar = match args.lines {
        Lines::L16 => LidarParams::vlp16(),
        Lines::L32 => LidarParams::hdl32(),
        Lines::L64 => LidarParams::uniform64(),
    };
    let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), So3::default());
    let lidar = Lidar::new(lidar.with_mount(mount), seed)?.with_parallelism(args.common.par());
    let vehicle = Vehicle::new(VehicleParams::default(), Se2::new(start.x, start.y, 0.0), seed)?;
    let mut simulator = Simulator3d::new(factory.world(), vehicle, DT)?.with_lidar(lidar)?;
    let mut drive = Drive { scans: Vec::new(), truth: Vec::new() };
    let mut next = 0;
    for _ in 0..steps {
        let here = simulator.vehicle().truth().map_from_base;
        let ahead = way[next] - here.translation();
        if ahead.norm() < 0.7 {
            next += 1;
            if next == way.len() {
                break;
            }
        }
        let turn = wrap_angle(ahead.y.atan2(ahead.x) - here.yaw());
        let speed = if turn.abs() > 0.5 { 0.4 } else { SPEED };
        let seen = simulator.step(&Twist2::new(speed, 0.0, (1.5 * turn).clamp(-1.0, 1.0)))?;
        for (cloud, truth) in seen.clouds() {
            drive.scans.push(PointCloud::clone(cloud));
            drive.truth.push(Some(truth.map_from_base));
        }
    }
    Ok(drive)
}
