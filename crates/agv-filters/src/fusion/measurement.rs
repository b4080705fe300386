//! What the filter takes, and the form in which it keeps it: checked, its noise complete, gravity taken off.

use super::{Components, MotionNoise, Reference, SourceParams, source::Source};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    odometry::OdometryIncrement,
    sensors::{GRAVITY, ImuSample, PoseObservation, PositionObservation, VelocityObservation},
    time::Stamp,
};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Anything that a [`FusionFilter`](super::FusionFilter) takes; every kind converts into it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
#[expect(clippy::large_enum_variant, reason = "a box would allocate for every sample of an inertial unit")]
pub enum Measurement {
    /// The motion between two moments: wheel odometry, scan or lidar odometry.
    Motion(OdometryIncrement),
    /// A pose, in the map or in a frame of the sensor's own.
    Pose(PoseObservation<Se2>),
    /// A place in the map.
    Position(PositionObservation),
    /// A velocity in the frame of the sensor.
    Velocity(VelocityObservation<Se2>),
    /// Turn rate, specific force and attitude of an inertial unit.
    Imu(ImuSample),
}

macro_rules! converts {
    ($($variant:ident($kind:ty)),*) => {$(
        impl From<$kind> for Measurement {
            fn from(measurement: $kind) -> Self {
                Self::$variant(measurement)
            }
        }

        impl From<&$kind> for Measurement {
            fn from(measurement: &$kind) -> Self {
                Self::$variant(*measurement)
            }
        }
    )*};
}
converts!(
    Motion(OdometryIncrement),
    Pose(PoseObservation<Se2>),
    Position(PositionObservation),
    Velocity(VelocityObservation<Se2>),
    Imu(ImuSample)
);

/// Greatest number that a measurement may hold, in its unit: beyond, they have no meaning.
const LARGEST: f64 = 1e7;

/// A measurement as it is kept.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) enum Reading {
    /// A motion as a tangent, with the covariance of its right increment.
    Motion { start: Stamp, tangent: Vector3<f64>, spread: Matrix3<f64> },
    /// A pose of a sensor, with the covariance of its right increment; a place has no heading.
    Place { own_from_sensor: Se2, spread: Matrix3<f64>, base_from_sensor: Se2, has_yaw: bool },
    /// A velocity in the frame of the sensor.
    Velocity { velocity: Vector3<f64>, spread: Matrix3<f64>, base_from_sensor: Se2 },
    /// What an inertial unit says of the base, with variances.
    Inertial {
        yaw: Option<[f64; 2]>,
        rate: Option<[f64; 2]>,
        acceleration: Option<(Vector2<f64>, Matrix2<f64>)>,
        lever: Vector2<f64>,
    },
}

impl Measurement {
    /// When it was taken, as it says.
    pub fn stamp(&self) -> Stamp {
        match self {
            Self::Motion(motion) => motion.end,
            Self::Pose(pose) => pose.stamp(),
            Self::Position(position) => position.stamp(),
            Self::Velocity(velocity) => velocity.stamp(),
            Self::Imu(sample) => sample.stamp(),
        }
    }

    /// Checks it and brings it into the form that is kept.
    pub(super) fn reading(&self, source: &Source) -> Result<Reading, Error> {
        let params = &source.params;
        let reading = match self {
            Self::Motion(motion) => {
                if source.slot.is_none() {
                    return Err(Error::Empty { name: "reference of a source of motions" });
                }
                motion_reading(motion, params)?
            }
            Self::Pose(pose) => {
                let seen = pose.map_from_sensor();
                check_mount(&pose.base_from_sensor())?;
                check_size("pose", &[seen.mean().x(), seen.mean().y()])?;
                Reading::Place {
                    own_from_sensor: *seen.mean(),
                    spread: seen.covariance() + pose_floor(params),
                    base_from_sensor: pose.base_from_sensor(),
                    has_yaw: true,
                }
            }
            Self::Position(position) => {
                if params.reference != Reference::Map {
                    return Err(Error::Empty { name: "heading of places that do not refer to the map" });
                }
                let seen = position.position();
                check_mount(&position.base_from_sensor())?;
                check_size("position", seen.mean().as_slice())?;
                let mut spread = pose_floor(params);
                let mut corner = spread.fixed_view_mut::<2, 2>(0, 0);
                corner += seen.covariance();
                Reading::Place {
                    own_from_sensor: Se2::from_parts(*seen.mean(), agv_core::geometry::So2::default()),
                    spread,
                    base_from_sensor: position.base_from_sensor(),
                    has_yaw: false,
                }
            }
            Self::Velocity(velocity) => {
                let (along, about) = (params.floor.velocity, params.floor.yaw_rate);
                check_mount(&velocity.base_from_sensor())?;
                check_size("velocity", velocity.velocity().as_slice())?;
                Reading::Velocity {
                    velocity: *velocity.velocity(),
                    spread: velocity.covariance() + squares([along, along, about]),
                    base_from_sensor: velocity.base_from_sensor(),
                }
            }
            Self::Imu(sample) => inertial_reading(sample, params)?,
        };
        reading.check(params)?;
        Ok(reading)
    }
}

fn check_mount(base_from_sensor: &Se2) -> Result<(), Error> {
    check_size("base_from_sensor", base_from_sensor.translation().as_slice())
}

fn check_size(name: &'static str, values: &[f64]) -> Result<(), Error> {
    values.iter().try_for_each(|&value| check::in_range(name, value, -LARGEST, LARGEST).map(|_| ()))
}

fn squares(sigmas: [f64; 3]) -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::from(sigmas).map(|sigma| sigma * sigma))
}

fn pose_floor(params: &SourceParams) -> Matrix3<f64> {
    squares([params.floor.position, params.floor.position, params.floor.yaw])
}

/// What a motion gains of noise by its length.
pub(super) fn growth(noise: &MotionNoise, tangent: &Vector3<f64>) -> Matrix3<f64> {
    let (driven, turned) = (tangent.x.hypot(tangent.y), tangent.z.abs());
    let position = noise.position_per_metre * driven + noise.position_per_radian * turned;
    let yaw = noise.yaw_per_metre * driven + noise.yaw_per_radian * turned;
    Matrix3::from_diagonal(&Vector3::new(position, position, yaw))
}

fn motion_reading(motion: &OdometryIncrement, params: &SourceParams) -> Result<Reading, Error> {
    let pose = &motion.start_from_end;
    check_size("odometry", &[pose.x(), pose.y(), pose.yaw()])?;
    check::covariance("odometry covariance", &motion.covariance)?;
    check::positive("duration of the odometry", motion.dt())?;
    let tangent = pose.log();
    let spread = motion.covariance + growth(&params.motion, &tangent) + pose_floor(params);
    Ok(Reading::Motion { start: motion.start, tangent, spread })
}

/// Heading, turn rate and horizontal acceleration of the base; gravity is taken off by the attitude, or where there is none
/// as on a level floor.
fn inertial_reading(sample: &ImuSample, params: &SourceParams) -> Result<Reading, Error> {
    let mount = sample.base_from_sensor();
    check_mount(&mount.to_planar())?;
    let attitude = sample.orientation().map(|seen| {
        let world_from_base = seen.mean().compose(&mount.rotation().inverse()).matrix();
        // The error about the axis that points up.
        let up = seen.mean().matrix().fixed_rows::<1>(2).into_owned();
        let variance = (up * seen.covariance() * up.transpose()).x + params.floor.yaw * params.floor.yaw;
        (world_from_base, [world_from_base[(1, 0)].atan2(world_from_base[(0, 0)]), variance])
    });
    let rate = sample.yaw_rate().map(|(rate, variance)| [rate, variance + params.floor.yaw_rate.powi(2)]);
    let acceleration = sample.specific_force().map(|force| {
        let turned = force.transformed(&mount.rotation().matrix());
        let weight = attitude.map_or(Vector2::zeros(), |(world_from_base, _)| {
            Vector2::new(world_from_base[(2, 0)], world_from_base[(2, 1)]) * GRAVITY
        });
        let floor = Matrix2::from_diagonal_element(params.floor.acceleration.powi(2));
        (turned.mean().xy() - weight, turned.covariance().fixed_view::<2, 2>(0, 0) + floor)
    });
    if let Some([rate, _]) = rate {
        check_size("yaw_rate", &[rate])?;
    }
    if let Some((value, _)) = &acceleration {
        check_size("acceleration", value.as_slice())?;
    }
    let lever = mount.translation().xy();
    Ok(Reading::Inertial { yaw: attitude.map(|(_, yaw)| yaw), rate, acceleration, lever })
}

impl Reading {
    /// The numbers that count, in the order of the innovation.
    pub(super) fn selected(&self, components: Components) -> [bool; 4] {
        let [x, y, yaw] = components.among([Components::X, Components::Y, Components::YAW]);
        match self {
            Self::Motion { .. } => [x, y, yaw, false],
            Self::Place { has_yaw, .. } => [x, y, yaw && *has_yaw, false],
            Self::Velocity { .. } => {
                let [vx, vy, rate] = components.among([Components::VX, Components::VY, Components::YAW_RATE]);
                [vx, vy, rate, false]
            }
            Self::Inertial { yaw: seen, rate, acceleration, .. } => {
                let [rates, ax, ay] = components.among([Components::YAW_RATE, Components::AX, Components::AY]);
                let accelerates = acceleration.is_some();
                [yaw && seen.is_some(), rates && rate.is_some(), ax && accelerates, ay && accelerates]
            }
        }
    }

    /// Refuses a reading of which nothing counts, and noise that is none.
    fn check(&self, params: &SourceParams) -> Result<(), Error> {
        let selected = self.selected(params.components);
        if !selected.contains(&true) {
            return Err(Error::Empty { name: "components of the measurement" });
        }
        let variances = match self {
            Self::Motion { spread, .. } | Self::Place { spread, .. } | Self::Velocity { spread, .. } => {
                [spread.m11, spread.m22, spread.m33, 1.0]
            }
            Self::Inertial { yaw, rate, acceleration, .. } => {
                let (ax, ay) = acceleration.map_or((1.0, 1.0), |(_, spread)| (spread.m11, spread.m22));
                [yaw.map_or(1.0, |[_, v]| v), rate.map_or(1.0, |[_, v]| v), ax, ay]
            }
        };
        for (variance, _) in variances.iter().zip(selected).filter(|(_, selected)| *selected) {
            check::in_range("variance of the measurement", *variance, 1e-18, LARGEST * LARGEST)?;
        }
        Ok(())
    }
}
