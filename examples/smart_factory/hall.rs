//! The hall, the vehicle, and where it is driven.

use crate::{Args, Result};
use agv_nav::{
    core::{
        grid::Footprint,
        kinematics::{Ackermann, AckermannParams, SteeringLimits},
        path::{Path, shapes},
    },
    nalgebra::{Vector2, Vector3},
    prelude::{MotionLimits, Se2, Se3, Seed, So3, TwistLimits},
};
use agv_sim::{Drive, Factory, FactoryParams, Lidar, LidarParams, OdometryErrors, VehicleParams};

/// Inside of the hall, in metres.
const SIZE: (f64, f64) = (40.0, 21.0);

/// Lanes across the aisles' western and eastern ends.
const LANES: (f64, f64) = (2.9, 36.8);

/// Ends of the vehicle's outline along it from the rear axle, and its width, in metres.
pub(crate) const OUTLINE: (f64, f64, f64) = (-0.4, 1.6, 0.8);

pub(crate) struct Hall {
    pub(crate) factory: Factory,
    /// Through all aisles.
    pub(crate) tour: Path,
    /// Through two of them and back.
    pub(crate) lap: Path,
}

impl Hall {
    pub(crate) fn new(args: &Args) -> Result<Self> {
        let params = FactoryParams { length: SIZE.0, width: SIZE.1, ..FactoryParams::default() };
        let factory = Factory::generate(params, args.common.seed())?;
        let aisles: Vec<f64> = factory.aisles().iter().map(Se2::y).collect();
        let route = |stations: &[(bool, usize)]| {
            let at = |&(east, aisle): &(bool, usize)| Vector2::new(if east { LANES.1 } else { LANES.0 }, aisles[aisle]);
            let mut points: Vec<_> = stations.iter().map(at).collect();
            // Off before the first corner, and to a stop where it began.
            points.insert(0, points[0] + Vector2::new(3.0, 0.0));
            points.remove(1);
            points.push(Vector2::new(LANES.0, aisles[0] + 3.0));
            shapes::rounded(&points, 2.0, 0.05)
        };
        let (west, east) = (false, true);
        let tour = route(&[(west, 0), (east, 0), (east, 1), (west, 1), (west, 2), (east, 2), (east, 3), (west, 3)])?;
        let lap = route(&[(west, 0), (east, 0), (east, 2), (west, 2)])?;
        Ok(Self { factory, tour, lap })
    }
}

/// What the vehicle may do at this greatest speed.
pub(crate) fn limits(speed: f64) -> MotionLimits {
    let twist = TwistLimits {
        forward_speed: speed,
        reverse_speed: 0.5,
        yaw_rate: 1.5,
        acceleration: 1.5,
        deceleration: 1.5,
        yaw_acceleration: 4.0,
        ..TwistLimits::default()
    };
    let steering = SteeringLimits { max_rate: 1.0, ..SteeringLimits::default() };
    MotionLimits { steering: Some(steering), lateral_acceleration: Some(2.0), ..twist.into() }
}

/// A tugger: Ackermann steering, a floor without slip, odometry of encoders that are well kept.
pub(crate) fn vehicle(speed: f64) -> Result<VehicleParams> {
    let drive = Drive::Ackermann(Ackermann::new(AckermannParams::default())?);
    let odometry = OdometryErrors { alphas: [1e-3, 1e-5, 1e-3, 1e-5], distance_scale: 0.005, ..OdometryErrors::NONE };
    Ok(VehicleParams { limits: limits(speed).twist, steering_rate: 1.0, odometry, ..VehicleParams::new(drive) })
}

/// A 16-line lidar above the middle of the vehicle.
pub(crate) fn lidar(args: &Args, seed: Seed) -> Result<Lidar> {
    let mount = Se3::from_parts(Vector3::new(0.6, 0.0, 1.3), So3::default());
    let params = LidarParams {
        columns: usize::from(args.columns),
        range_sigma: args.range_sigma,
        ..LidarParams::vlp16().with_mount(mount)
    };
    Ok(Lidar::new(params, seed)?.with_parallelism(args.common.par()))
}

pub(crate) fn footprint() -> Result<Footprint> {
    Ok(Footprint::rectangle(OUTLINE.0, OUTLINE.1, OUTLINE.2)?)
}
