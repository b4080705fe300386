//! Planar world, vehicle and any number of sensors together, one step at a time.

use crate::onboard::{Onboard, Scheduled, admit};
use crate::{
    Body, Error, FloorCamera, FrontCamera, GroundTruth, Imu, Laser, MovingDiscs, PlanarWorld, Populated, Vehicle,
    WheelEncoders, WheelReading,
};
use agv_core::{
    geometry::{Se2, Twist2},
    obstacle::MovingObstacle,
    odometry::OdometryIncrement,
    sensors::{ImuSample, LandmarkObservation, LaserScan, MarkerObservation},
};

/// What a step brings: what the vehicle's computer is told, and the truth beside it.
///
/// Sensors that were not due are left out; those of one kind come in the order in which they were added.
#[derive(Debug, Clone, Copy)]
pub struct Observed2d<'a> {
    /// What the odometry says of the step.
    pub odometry: OdometryIncrement,
    /// Ground truth of the vehicle.
    pub truth: GroundTruth,
    /// Ground truth: whether the body touches anything.
    pub contact: bool,
    sensors: &'a Sensors,
    onboard: &'a Onboard,
}

impl<'a> Observed2d<'a> {
    /// The scans that began at the end of the step.
    pub fn scans(&self) -> impl Iterator<Item = &'a LaserScan> + use<'a> {
        self.sensors.lasers.iter().filter(|s| s.due).map(|s| s.sensor.last())
    }

    /// The scan of a vehicle with one laser, where it was due.
    pub fn scan(&self) -> Option<&'a LaserScan> {
        self.scans().next()
    }

    /// Samples of the inertial units.
    pub fn imu_samples(&self) -> impl Iterator<Item = &'a ImuSample> + use<'a> {
        self.onboard.imu_samples()
    }

    /// Readings of the encoders.
    pub fn wheel_readings(&self) -> impl Iterator<Item = &'a WheelReading> + use<'a> {
        self.onboard.wheel_readings()
    }

    /// What each floor camera sees: the codes of one image, none where there are none.
    pub fn markers(&self) -> impl Iterator<Item = &'a [MarkerObservation<Se2>]> + use<'a> {
        self.sensors.floor_cameras.iter().filter(|s| s.due).map(|s| s.sensor.last())
    }

    /// What each front camera sees: the landmarks of one image, none where there are none.
    pub fn landmarks(&self) -> impl Iterator<Item = &'a [LandmarkObservation]> + use<'a> {
        self.sensors.front_cameras.iter().filter(|s| s.due).map(|s| s.sensor.last())
    }
}

/// The sensors that look at the world.
#[derive(Debug, Clone, Default)]
struct Sensors {
    lasers: Vec<Scheduled<Laser>>,
    floor_cameras: Vec<Scheduled<FloorCamera>>,
    front_cameras: Vec<Scheduled<FrontCamera>>,
}

impl Sensors {
    /// Marks what is due after this step; all of it without one.
    fn schedule(&mut self, step: Option<u64>) {
        fn all<S>(sensors: &mut [Scheduled<S>], step: Option<u64>) {
            for sensor in sensors {
                match step {
                    Some(step) => _ = sensor.tick(step),
                    None => sensor.due = true,
                }
            }
        }
        all(&mut self.lasers, step);
        all(&mut self.floor_cameras, step);
        all(&mut self.front_cameras, step);
    }

    /// Reads what is due.
    fn read(&mut self, world: &impl PlanarWorld, truth: &GroundTruth) -> Result<(), Error> {
        let pose = &truth.map_from_base;
        for laser in self.lasers.iter_mut().filter(|s| s.due) {
            laser.sensor.scan(world, pose, &truth.twist, truth.stamp)?;
        }
        for camera in self.floor_cameras.iter_mut().filter(|s| s.due) {
            camera.sensor.look(pose, truth.stamp)?;
        }
        for camera in self.front_cameras.iter_mut().filter(|s| s.due) {
            camera.sensor.look(world, pose, truth.stamp)?;
        }
        Ok(())
    }
}

/// A vehicle with its sensors in a planar world, in steps of `dt` seconds.
///
/// Each sensor reads after every so many steps (never, for zero), so a step is as long as the fastest one's period.
/// Each draws from a stream of its own: adding a sensor, or changing one's rate, changes no other's readings. Two of one
/// kind need different [`SensorId`](agv_core::sensors::SensorId)s.
///
/// Nothing stops at a contact: it is reported, and the caller decides.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::nalgebra::Vector2;
/// use agv_sim::{Body, Imu, ImuParams, Laser, LaserParams, Shape, Simulator2d, Vehicle, VehicleParams, World2d};
///
/// let world = World2d::new(Shape::room(Vector2::new(0.0, 0.0), Vector2::new(10.0, 6.0)).to_vec())?;
/// let vehicle = Vehicle::new(VehicleParams::default(), Se2::new(2.0, 3.0, 0.0), Seed(1))?;
/// let laser = Laser::new(LaserParams::default().with_beams(181, std::f64::consts::PI), Seed(1))?;
/// let mut simulator = Simulator2d::new(world, vehicle, Body::rectangle(0.5, 0.3)?, 0.01)?
///     .with_laser(laser, 10)?
///     .with_imu(Imu::new(ImuParams::default(), Seed(1))?, 1)?;
///
/// let (mut scans, mut samples) = (0, 0);
/// for _ in 0..100 {
///     let seen = simulator.step(&Twist2::new(0.5, 0.0, 0.1))?;
///     scans += seen.scans().count();
///     samples += seen.imu_samples().count();
///     assert!(!seen.contact);
/// }
/// assert_eq!((scans, samples), (10, 100));
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Simulator2d<W> {
    world: W,
    body: Body,
    onboard: Onboard,
    sensors: Sensors,
    moving: MovingDiscs,
    obstacles: Vec<MovingObstacle>,
}

impl<W: PlanarWorld> Simulator2d<W> {
    /// A simulation in steps of `dt` seconds, without sensors and moving obstacles.
    ///
    /// # Errors
    /// A `dt` that is not finite and positive.
    pub fn new(world: W, vehicle: Vehicle, body: Body, dt: f64) -> Result<Self, Error> {
        let onboard = Onboard::new(vehicle, dt)?;
        let (moving, obstacles) = (MovingDiscs::default(), Vec::new());
        Ok(Self { world, body, onboard, sensors: Sensors::default(), moving, obstacles })
    }

    /// The same with a laser that scans after every `every` steps.
    ///
    /// # Errors
    /// [`Error::SensorTaken`].
    pub fn with_laser(mut self, laser: Laser, every: u64) -> Result<Self, Error> {
        let lasers = &mut self.sensors.lasers;
        admit("laser", laser.params().geometry.sensor, lasers.iter().map(|s| s.sensor.params().geometry.sensor))?;
        lasers.push(Scheduled::new(laser, every));
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

    /// The same with a floor camera that looks after every `every` steps.
    ///
    /// # Errors
    /// [`Error::SensorTaken`].
    pub fn with_floor_camera(mut self, camera: FloorCamera, every: u64) -> Result<Self, Error> {
        let cameras = &mut self.sensors.floor_cameras;
        admit("floor camera", camera.params().sensor, cameras.iter().map(|s| s.sensor.params().sensor))?;
        cameras.push(Scheduled::new(camera, every));
        Ok(self)
    }

    /// The same with a front camera that looks after every `every` steps.
    ///
    /// # Errors
    /// [`Error::SensorTaken`].
    pub fn with_front_camera(mut self, camera: FrontCamera, every: u64) -> Result<Self, Error> {
        let cameras = &mut self.sensors.front_cameras;
        admit("front camera", camera.params().sensor, cameras.iter().map(|s| s.sensor.params().sensor))?;
        cameras.push(Scheduled::new(camera, every));
        Ok(self)
    }

    /// The same with obstacles that move; their time starts with the simulation's.
    #[must_use]
    pub fn with_moving(mut self, moving: MovingDiscs) -> Self {
        moving.states_into(self.onboard.vehicle.now().seconds(), &mut self.obstacles);
        self.moving = moving;
        self
    }

    /// Drives for one step under a command and reads the sensors that are due. No allocation.
    ///
    /// # Errors
    /// A command that is not finite; the simulation is then as it was.
    pub fn step(&mut self, command: &Twist2) -> Result<Observed2d<'_>, Error> {
        let odometry = self.onboard.step(command)?;
        self.moving.states_into(self.onboard.vehicle.now().seconds(), &mut self.obstacles);
        self.observe(odometry, Some(self.onboard.steps))
    }

    /// What all sensors but the inertial ones say from where the vehicle stands, whatever their rates: for a localizer
    /// that must start before the first step. The odometry is no motion.
    ///
    /// # Errors
    /// None in practice: the vehicle's state is finite by construction.
    pub fn look(&mut self) -> Result<Observed2d<'_>, Error> {
        self.onboard.look();
        let now = self.onboard.vehicle.now();
        let still = OdometryIncrement::between(now, &Se2::default(), now, &Se2::default())?;
        self.observe(still, None)
    }

    fn observe(&mut self, odometry: OdometryIncrement, step: Option<u64>) -> Result<Observed2d<'_>, Error> {
        let world = Populated { world: &self.world, obstacles: &self.obstacles };
        let truth = self.onboard.vehicle.truth();
        let contact = world.touches(&self.body, &truth.map_from_base);
        self.sensors.schedule(step);
        self.sensors.read(&world, &truth)?;
        Ok(Observed2d { odometry, truth, contact, sensors: &self.sensors, onboard: &self.onboard })
    }

    /// The static world.
    pub const fn world(&self) -> &W {
        &self.world
    }

    /// The vehicle, with its ground truth.
    pub const fn vehicle(&self) -> &Vehicle {
        &self.onboard.vehicle
    }

    /// The outline that touches things.
    pub const fn body(&self) -> &Body {
        &self.body
    }

    /// The moving obstacles now, in the map frame.
    pub fn obstacles(&self) -> &[MovingObstacle] {
        &self.obstacles
    }

    /// Duration of a step, in seconds.
    pub const fn dt(&self) -> f64 {
        self.onboard.dt
    }

    /// Distance from the body to the nearest obstacle, moving ones included, at most `limit`, in metres.
    pub fn clearance(&self, limit: f64) -> f64 {
        let world = Populated { world: &self.world, obstacles: &self.obstacles };
        world.clearance(&self.body, &self.onboard.vehicle.map_from_base(), limit)
    }
}

#[cfg(test)]
mod tests;
