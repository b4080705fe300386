//! Spatial world, vehicle and spinning lidars together, one step at a time.

use crate::onboard::{Onboard, admit};
use crate::{Error, GroundTruth, Imu, Lidar, Vehicle, WheelEncoders, WheelReading, World3d};
use agv_core::{
    check,
    geometry::{LieGroup, Se3, Twist2},
    odometry::OdometryIncrement,
    sensors::{BodyMotion, ImuSample, PointCloud, PoseTrack},
    time::Stamp,
};
use std::borrow::Borrow;

/// Where the vehicle really was while a cloud was taken.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CloudTruth {
    /// Pose of the base in the map at the cloud's stamp, the time of its first column.
    pub map_from_base: Se3,
    /// Pose of the base in the map at the end of the revolution.
    pub map_from_end: Se3,
}

/// What a step brings: what the vehicle's computer is told, and the truth beside it.
#[derive(Debug, Clone, Copy)]
pub struct Observed3d<'a> {
    /// What the odometry says of the step.
    pub odometry: OdometryIncrement,
    /// Ground truth of the vehicle at the end of the step.
    pub truth: GroundTruth,
    lidars: &'a [Spinning],
    track: &'a [(Stamp, Se3)],
    onboard: &'a Onboard,
}

impl<'a> Observed3d<'a> {
    /// The clouds whose revolution ended in the step, each with its truth, in the order in which the lidars were added.
    pub fn clouds(&self) -> impl Iterator<Item = (&'a PointCloud, CloudTruth)> + use<'a> {
        self.lidars.iter().filter(|s| s.due).map(|s| (s.lidar.last(), s.truth))
    }

    /// Samples of the inertial units that were due.
    pub fn imu_samples(&self) -> impl Iterator<Item = &'a ImuSample> + use<'a> {
        self.onboard.imu_samples()
    }

    /// Readings of the encoders that were due.
    pub fn wheel_readings(&self) -> impl Iterator<Item = &'a WheelReading> + use<'a> {
        self.onboard.wheel_readings()
    }

    /// Ground truth: poses of the base in the map at the ends of the steps, from before the first column of any of the
    /// clouds on. Between two of them the vehicle moved along the geodesic, as in a
    /// [`PoseTrack`](agv_core::sensors::PoseTrack).
    pub const fn track(&self) -> &'a [(Stamp, Se3)] {
        self.track
    }
}

/// A lidar and its revolution.
#[derive(Debug, Clone)]
struct Spinning {
    lidar: Lidar,
    /// When the revolution that is going on began.
    start: Stamp,
    /// Whether one ended in the last step.
    due: bool,
    truth: CloudTruth,
}

/// A vehicle on the floor (z = 0) of a spatial world, with spinning lidars, inertial units and encoders, in steps of
/// `dt` seconds.
///
/// A lidar's revolutions follow one another without a gap from time zero on. Its cloud is there when the revolution has
/// ended, bent by all the motion since it began, and stamped with its beginning. Steps and revolutions need not share
/// their times. As in [`Simulator2d`](crate::Simulator2d), a sensor more changes no other's readings.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se3, So3, Twist2};
/// use agv_core::nalgebra::Vector3;
/// use agv_core::sensors::{Deskew, PointCloud, PoseTrack};
/// use agv_sim::{Factory, FactoryParams, Lidar, LidarParams, Simulator3d, Vehicle, VehicleParams};
///
/// let factory = Factory::generate(FactoryParams::default(), Seed(7))?;
/// let vehicle = Vehicle::new(VehicleParams::default(), factory.aisles()[3], Seed(1))?;
/// let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), So3::default());
/// let params = LidarParams { columns: 360, ..LidarParams::vlp16().with_mount(mount) };
/// let mut simulator = Simulator3d::new(factory.world(), vehicle, 0.02)?.with_lidar(Lidar::new(params, Seed(1))?)?;
///
/// let (mut clouds, mut straight) = (0, PointCloud::default());
/// for _ in 0..20 {
///     let seen = simulator.step(&Twist2::new(0.8, 0.0, 0.2))?;
///     for (cloud, _truth) in seen.clouds() {
///         clouds += 1;
///         Deskew::cloud_into(cloud, &PoseTrack::new(seen.track(), cloud.stamp())?, &mut straight);
///     }
/// }
/// assert_eq!(clouds, 4); // 10 Hz over 0.4 s
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Simulator3d<W> {
    world: W,
    onboard: Onboard,
    lidars: Vec<Spinning>,
    track: Vec<(Stamp, Se3)>,
}

impl<W: Borrow<World3d>> Simulator3d<W> {
    /// A simulation in steps of `dt` seconds, without sensors, in a world of one's own or a borrowed one.
    ///
    /// # Errors
    /// A `dt` that is not finite and positive.
    pub fn new(world: W, vehicle: Vehicle, dt: f64) -> Result<Self, Error> {
        let track = vec![(vehicle.now(), vehicle.map_from_base().into())];
        Ok(Self { world, onboard: Onboard::new(vehicle, dt)?, lidars: Vec::new(), track })
    }

    /// The same with a lidar, which begins its first revolution now.
    ///
    /// # Errors
    /// [`Error::SensorTaken`], or a lidar that revolves faster than a step.
    pub fn with_lidar(mut self, lidar: Lidar) -> Result<Self, Error> {
        let sensor = lidar.params().sensor;
        admit("lidar", sensor, self.lidars.iter().map(|s| s.lidar.params().sensor))?;
        check::in_range("dt", self.onboard.dt, 0.0, lidar.params().period)?;
        let start = self.onboard.vehicle.now();
        self.lidars.push(Spinning { lidar, start, due: false, truth: CloudTruth::default() });
        Ok(self)
    }

    /// The same with an inertial unit that is sampled after every `every` steps.
    ///
    /// # Errors
    /// [`Error::SensorTaken`].
    pub fn with_imu(mut self, imu: Imu, every: u64) -> Result<Self, Error> {
        self.onboard.add_imu(imu, every)?;
        Ok(self)
    }

    /// The same with encoders that are read after every `every` steps.
    ///
    /// # Errors
    /// [`Error::SensorTaken`].
    pub fn with_encoders(mut self, encoders: WheelEncoders, every: u64) -> Result<Self, Error> {
        self.onboard.add_encoders(encoders, every)?;
        Ok(self)
    }

    /// Drives for one step under a command, and takes the clouds whose revolution ended. No allocation once the track
    /// spans a revolution.
    ///
    /// # Errors
    /// A command that is not finite; the simulation is then as it was.
    pub fn step(&mut self, command: &Twist2) -> Result<Observed3d<'_>, Error> {
        let odometry = self.onboard.step(command)?;
        let (now, truth) = (self.onboard.vehicle.now(), self.onboard.vehicle.truth());
        self.forget();
        self.track.push((now, truth.map_from_base.into()));
        for spinning in &mut self.lidars {
            let end = spinning.start + spinning.lidar.params().period;
            spinning.due = end <= now;
            if spinning.due {
                spinning.truth = revolve(&mut spinning.lidar, spinning.start, end, self.world.borrow(), &self.track)?;
                spinning.start = end;
            }
        }
        Ok(Observed3d { odometry, truth, lidars: &self.lidars, track: &self.track, onboard: &self.onboard })
    }

    /// Drops poses that no revolution needs any more: those before the last at or before the earliest beginning.
    fn forget(&mut self) {
        let now = self.onboard.vehicle.now();
        let earliest = self.lidars.iter().map(|s| s.start).min().unwrap_or(now);
        let known = self.track.partition_point(|(stamp, _)| *stamp <= earliest);
        self.track.drain(..known.saturating_sub(1));
    }

    /// The world.
    pub fn world(&self) -> &World3d {
        self.world.borrow()
    }

    /// The vehicle, with its ground truth.
    pub const fn vehicle(&self) -> &Vehicle {
        &self.onboard.vehicle
    }

    /// Duration of a step, in seconds.
    pub const fn dt(&self) -> f64 {
        self.onboard.dt
    }
}

/// One revolution along the track, which spans it.
fn revolve(
    lidar: &mut Lidar,
    start: Stamp,
    end: Stamp,
    world: &World3d,
    track: &[(Stamp, Se3)],
) -> Result<CloudTruth, Error> {
    let motion = PoseTrack::new(track, start)?;
    check::at_least("track", track.len(), 2)?;
    let (first, map_from_first) = track[0];
    let map_from_base = map_from_first.compose(&motion.reference_from_base(first - start).inverse());
    lidar.scan_along(world, &map_from_base, &motion)?;
    Ok(CloudTruth { map_from_base, map_from_end: map_from_base.compose(&motion.reference_from_base(end - start)) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ImuParams, LidarParams, Solid, VehicleParams, WheelEncodersParams};
    use agv_core::{
        compute::Seed,
        geometry::{Se2, So3},
        sensors::{Deskew, SensorId},
    };
    use nalgebra::Vector3;
    use std::fmt::Write;

    fn room() -> World3d {
        World3d::new(vec![Solid::block(Vector3::new(-5.0, -5.0, -5.0), Vector3::repeat(5.0)).into()]).unwrap()
    }

    fn lidar(number: u16, params: LidarParams) -> Lidar {
        let mount = Se3::from_parts(Vector3::new(0.3, 0.0, 1.0), So3::from_roll_pitch_yaw(0.0, 0.1, 0.5));
        let params = LidarParams { sensor: SensorId(number), columns: 240, ..params.with_mount(mount) };
        Lidar::new(params, Seed(1)).unwrap()
    }

    fn vehicle() -> Vehicle {
        Vehicle::new(VehicleParams::default(), Se2::new(-1.0, 0.5, 0.2), Seed(1)).unwrap()
    }

    /// Speeding up and turning in during the revolution, in steps that do not divide it: put back along the truth, every
    /// point of an ideal cloud is on a wall; left as it is, or put back by the last twist alone, it is not.
    #[test]
    fn the_truth_mends_every_cloud() {
        for dt in [0.02, 0.03, 0.1] {
            let mut simulator = Simulator3d::new(room(), vehicle(), dt)
                .unwrap()
                .with_lidar(lidar(0, LidarParams::vlp16().ideal()))
                .unwrap();
            let (mut clouds, mut bent) = (0, 0.0_f64);
            let mut straight = PointCloud::default();
            for step in 0..(1.2 / dt) as i32 {
                let seen = simulator.step(&Twist2::new(1.0, 0.0, if step % 7 < 4 { 1.0 } else { -1.0 })).unwrap();
                for (cloud, truth) in seen.clouds() {
                    assert_eq!(cloud.stamp().nanoseconds(), 100_000_000 * clouds);
                    clouds += 1;
                    let motion = PoseTrack::new(seen.track(), cloud.stamp()).unwrap();
                    Deskew::cloud_into(cloud, &motion, &mut straight);
                    let off = |cloud: &PointCloud| {
                        let map_from_sensor = truth.map_from_base.compose(&cloud.base_from_sensor());
                        let place = |p: Vector3<f32>| (map_from_sensor.act(&p.cast()).amax() - 5.0).abs();
                        cloud.points().map(place).fold(0.0, f64::max)
                    };
                    assert!(off(&straight) < 2e-5, "{}", off(&straight));
                    bent = bent.max(off(cloud));
                    let end = motion.reference_from_base(0.1);
                    assert!(truth.map_from_base.compose(&end).minus(&truth.map_from_end).norm() < 1e-12);
                }
            }
            assert!(clouds >= 10 && bent > 0.05, "{clouds} {bent}");
        }
    }

    /// The same bits from the same seeds, and alone as among others.
    #[test]
    fn a_sensor_more_changes_no_others_readings() {
        let fill = |imu: bool, second: bool| {
            let noisy = LidarParams { dropout: 0.05, ..LidarParams::vlp16() };
            let mut simulator =
                Simulator3d::new(room(), vehicle(), 0.02).unwrap().with_lidar(lidar(0, noisy.clone())).unwrap();
            if second {
                simulator = simulator.with_lidar(lidar(1, LidarParams { period: 0.05, ..noisy })).unwrap();
            }
            if imu {
                let encoders = WheelEncoders::new(WheelEncodersParams::default(), Seed(1)).unwrap();
                let imu = Imu::new(ImuParams::default(), Seed(1)).unwrap();
                simulator = simulator.with_imu(imu, 1).unwrap().with_encoders(encoders, 2).unwrap();
            }
            let (mut clouds, mut inner) = ([String::new(), String::new()], String::new());
            for _ in 0..20 {
                let seen = simulator.step(&Twist2::new(0.7, 0.0, 0.5)).unwrap();
                for (cloud, truth) in seen.clouds() {
                    write!(clouds[usize::from(cloud.sensor().0)], "{cloud:?} {truth:?}").unwrap();
                }
                seen.imu_samples().for_each(|sample| write!(inner, "{sample:?}").unwrap());
                seen.wheel_readings().for_each(|reading| write!(inner, "{reading:?}").unwrap());
            }
            (clouds, inner)
        };
        let (all, inner) = fill(true, true);
        let (alone, _) = fill(false, false);
        assert!(!alone[0].is_empty() && !inner.is_empty() && !all[1].is_empty());
        assert!(all[0] == alone[0] && all[0] != all[1]);
        assert!(inner == fill(true, false).1 && all == fill(true, true).0);
    }

    #[test]
    fn bad_simulations_are_refused() {
        for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Simulator3d::new(room(), vehicle(), dt).is_err());
        }
        let slow = Simulator3d::new(room(), vehicle(), 0.2).unwrap();
        assert!(slow.with_lidar(lidar(0, LidarParams::vlp16())).is_err());
        let mut simulator =
            Simulator3d::new(room(), vehicle(), 0.02).unwrap().with_lidar(lidar(0, LidarParams::vlp16())).unwrap();
        assert!(simulator.step(&Twist2::new(0.0, f64::NAN, 0.0)).is_err());
        assert_eq!(simulator.vehicle(), &vehicle());
        let twice = simulator.with_lidar(lidar(0, LidarParams::vlp16()));
        assert!(matches!(twice, Err(Error::SensorTaken { kind: "lidar", .. })));
    }
}
