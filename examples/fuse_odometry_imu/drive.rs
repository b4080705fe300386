//! The hall, the vehicle, and the drive from (3, 3) by (9, -3) to (12, 0).

use super::{Result, estimates::LASERS};
use agv_nav::{
    core::{geometry::wrap_angle, sensors::ImuSample},
    nalgebra::{Vector2, Vector3},
    prelude::*,
};
use agv_sim::{
    Body, GridWorld, GroundTruth, Imu, ImuParams, Laser, LaserParams, OdometryErrors, Simulator2d, Vehicle,
    VehicleParams,
};

/// Step of the simulation, and of odometry and IMU, in seconds.
const STEP: f64 = 0.05;
/// Radius of the vehicle, in metres.
pub(crate) const RADIUS: f64 = 0.25;
/// Half a box's edge, in metres.
const BOX: f64 = 0.2;
/// Boxes beside the path, so near that a laser of 1 m sees one now and then.
const BOXES: [(f64, f64); 8] = [
    (3.57, 1.44),
    (5.69, 1.45),
    (5.9, -0.89),
    (8.16, -1.03),
    (8.09, -3.22),
    (10.4, -2.7),
    (10.27, -0.59),
    (12.25, -0.9),
];

/// A hall of 15 m by 12 m with boxes.
pub(crate) struct Hall {
    pub(crate) map: Grid<CellState>,
    world: GridWorld,
}

impl Hall {
    /// The hall as a map with cells of this edge, in metres.
    pub(crate) fn new(resolution: f64) -> Result<Self> {
        let [columns, rows] = [15.0, 12.0].map(|side: f64| (side / resolution).round() as usize);
        let layout = GridLayout::new(columns, rows, resolution, Se2::new(0.0, -6.0, 0.0))?;
        let mut map = Grid::filled(layout, CellState::Free);
        for index in 0..layout.len() {
            let cell = layout.cell(index);
            let center = layout.center(cell);
            let in_box = |(x, y): &(f64, f64)| (center - Vector2::new(*x, *y)).amax() < BOX;
            let at_edge = cell.x == 0 || cell.y == 0 || cell.x == columns as i32 - 1 || cell.y == rows as i32 - 1;
            if at_edge || BOXES.iter().any(in_box) {
                map.set(cell, CellState::Occupied);
            }
        }
        let world = GridWorld::new(&map);
        Ok(Self { map, world })
    }
}

/// What a step brought.
pub(crate) struct Step {
    pub(crate) truth: GroundTruth,
    pub(crate) odometry: OdometryIncrement,
    pub(crate) imu: ImuSample,
    /// Of each laser, where it was due.
    pub(crate) scans: Vec<LaserScan>,
}

/// A drive as the vehicle's computer saw it, with the truth.
pub(crate) struct Drive {
    pub(crate) start: Se2,
    pub(crate) steps: Vec<Step>,
}

impl Drive {
    /// Drives along the path by the true pose: it is the estimates that are compared, not their effect on the driving.
    pub(crate) fn new(hall: &Hall, seed: Seed) -> Result<Self> {
        let start = Se2::new(3.0, 3.0, -std::f64::consts::FRAC_PI_4);
        let errors = OdometryErrors { yaw_scale: 0.03, yaw_per_metre: 0.02, ..OdometryErrors::default() };
        let params = VehicleParams { odometry: errors, ..VehicleParams::default() };
        let vehicle = Vehicle::new(params, start, seed)?;
        let imu = ImuParams {
            base_from_sensor: Se3::from_parts(Vector3::new(0.0, 0.0, 0.05), So3::default()),
            attitude_sigma: Some(0.01),
            ..ImuParams::default()
        };
        let mut simulator = Simulator2d::new(hall.world.clone(), vehicle, Body::circle(RADIUS)?, STEP)?
            .with_imu(Imu::new(imu, seed)?, 1)?;
        for (i, (_, range)) in LASERS.iter().enumerate() {
            // 360 beams, ten times a second.
            let mut laser = LaserParams::default().with_beams(360, 359_f64.to_radians());
            laser.geometry.base_from_sensor = Se2::new(0.05, 0.0, 0.0);
            (laser.geometry.range_min, laser.geometry.range_max) = (0.1, *range);
            laser.geometry.sensor = SensorId(i as u16);
            simulator = simulator.with_laser(Laser::new(laser, seed)?, 2)?;
        }

        let mut steps = Vec::new();
        for goal in [Vector2::new(9.0, -3.0), Vector2::new(12.0, 0.0)] {
            for _ in 0..2000 {
                let pose = simulator.vehicle().map_from_base();
                let way = goal - pose.translation();
                if way.norm() < 0.1 {
                    break;
                }
                let turn = wrap_angle(way.y.atan2(way.x) - pose.yaw());
                let speed = 0.5 * turn.cos().max(0.0).powi(4) * (way.norm() / 0.4).min(1.0);
                let seen = simulator.step(&Twist2::new(speed, 0.0, (2.0 * turn).clamp(-0.8, 0.8)))?;
                if seen.contact {
                    return Err("the vehicle has touched a box".into());
                }
                let imu = *seen.imu_samples().next().ok_or("the IMU is silent")?;
                let scans = seen.scans().cloned().collect();
                steps.push(Step { truth: seen.truth, odometry: seen.odometry, imu, scans });
            }
        }
        Ok(Self { start, steps })
    }

    pub(crate) fn truths(&self) -> Vec<Se2> {
        self.steps.iter().map(|step| step.truth.map_from_base).collect()
    }
}
