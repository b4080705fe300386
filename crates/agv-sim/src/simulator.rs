//! World, vehicle and laser together, one step at a time.

use crate::{Body, Error, Laser, MovingDiscs, PlanarWorld, Populated, Vehicle};
use agv_core::{
    check, geometry::Twist2, obstacle::MovingObstacle, odometry::OdometryIncrement, roles::VehicleState,
    sensors::LaserScan,
};

/// What a step brings: what the vehicle's computer knows, and the truth beside it.
#[derive(Debug, Clone, Copy)]
pub struct Observation<'a> {
    /// What the odometry says of the step.
    pub odometry: OdometryIncrement,
    /// The scan that began at the end of the step, where one was due.
    pub scan: Option<&'a LaserScan>,
    /// Ground truth: pose in the map and twist.
    pub truth: VehicleState,
    /// Ground truth: whether the body touches anything.
    pub contact: bool,
}

/// A vehicle with a laser in a planar world, in steps of `dt` seconds.
///
/// Nothing stops at a contact: it is reported, and the caller decides.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::nalgebra::Vector2;
/// use agv_sim::{Body, Laser, LaserParams, Shape, Simulator2d, Vehicle, VehicleParams, World2d};
///
/// let world = World2d::new(Shape::room(Vector2::new(0.0, 0.0), Vector2::new(10.0, 6.0)).to_vec())?;
/// let vehicle = Vehicle::new(VehicleParams::default(), Se2::new(2.0, 3.0, 0.0), Seed(1))?;
/// let laser = Laser::new(LaserParams::default().with_beams(181, std::f64::consts::PI), Seed(2))?;
/// let mut simulator = Simulator2d::new(world, vehicle, Body::rectangle(0.5, 0.3)?, laser, 0.05)?.with_scan_every(2);
///
/// let mut scans = 0;
/// for _ in 0..100 {
///     let seen = simulator.step(&Twist2::new(0.5, 0.0, 0.1))?;
///     scans += usize::from(seen.scan.is_some());
///     assert!(!seen.contact);
/// }
/// assert_eq!(scans, 50);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Simulator2d<W> {
    world: W,
    vehicle: Vehicle,
    body: Body,
    laser: Laser,
    dt: f64,
    scan_every: u64,
    steps: u64,
    moving: MovingDiscs,
    obstacles: Vec<MovingObstacle>,
}

impl<W: PlanarWorld> Simulator2d<W> {
    /// A simulation that scans after every step of `dt` seconds, without moving obstacles.
    ///
    /// # Errors
    /// A `dt` that is not finite and positive.
    pub fn new(world: W, vehicle: Vehicle, body: Body, laser: Laser, dt: f64) -> Result<Self, Error> {
        check::positive("dt", dt)?;
        let (moving, obstacles) = (MovingDiscs::default(), Vec::new());
        Ok(Self { world, vehicle, body, laser, dt, scan_every: 1, steps: 0, moving, obstacles })
    }

    /// The same with a scan after every `steps` steps only; zero means never.
    #[must_use]
    pub const fn with_scan_every(mut self, steps: u64) -> Self {
        self.scan_every = steps;
        self
    }

    /// The same with obstacles that move; their time starts with the simulation's.
    #[must_use]
    pub fn with_moving(mut self, moving: MovingDiscs) -> Self {
        moving.states_into(self.vehicle.now().seconds(), &mut self.obstacles);
        self.moving = moving;
        self
    }

    /// Drives for one step under a command. No allocation.
    ///
    /// # Errors
    /// A command that is not finite; the simulation is then as it was.
    pub fn step(&mut self, command: &Twist2) -> Result<Observation<'_>, Error> {
        let odometry = self.vehicle.step(command, self.dt)?;
        self.steps += 1;
        self.moving.states_into(self.vehicle.now().seconds(), &mut self.obstacles);
        let world = Populated { world: &self.world, obstacles: &self.obstacles };
        let truth = VehicleState::new(self.vehicle.map_from_base(), self.vehicle.twist());
        let contact = world.touches(&self.body, &truth.map_from_base);
        let due = self.scan_every > 0 && self.steps.is_multiple_of(self.scan_every);
        let scan = if due {
            Some(self.laser.scan(&world, &truth.map_from_base, &truth.twist, self.vehicle.now())?)
        } else {
            None
        };
        Ok(Observation { odometry, scan, truth, contact })
    }

    /// A scan from where the vehicle stands, for a localizer that must start before the first step.
    ///
    /// # Errors
    /// None in practice: the vehicle's state is finite by construction.
    pub fn look(&mut self) -> Result<&LaserScan, Error> {
        let world = Populated { world: &self.world, obstacles: &self.obstacles };
        self.laser.scan(&world, &self.vehicle.map_from_base(), &self.vehicle.twist(), self.vehicle.now())
    }

    /// The static world.
    pub const fn world(&self) -> &W {
        &self.world
    }

    /// The vehicle, with its ground truth.
    pub const fn vehicle(&self) -> &Vehicle {
        &self.vehicle
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
        self.dt
    }

    /// Distance from the body to the nearest obstacle, moving ones included, at most `limit`, in metres.
    pub fn clearance(&self, limit: f64) -> f64 {
        let world = Populated { world: &self.world, obstacles: &self.obstacles };
        world.clearance(&self.body, &self.vehicle.map_from_base(), limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{KeyFrame, LaserParams, MovingDisc, Shape, VehicleParams, World2d};
    use agv_core::{
        compute::{Par, Seed},
        geometry::Se2,
    };
    use nalgebra::Vector2;

    fn simulator(par: Par) -> Simulator2d<World2d> {
        let world = World2d::new(Shape::room(Vector2::zeros(), Vector2::new(10.0, 6.0)).to_vec()).unwrap();
        let vehicle = Vehicle::new(VehicleParams::default(), Se2::new(2.0, 3.0, 0.0), Seed(1)).unwrap();
        let laser = Laser::new(LaserParams::default(), Seed(2)).unwrap().with_parallelism(par);
        Simulator2d::new(world, vehicle, Body::rectangle(0.5, 0.3).unwrap(), laser, 0.05).unwrap()
    }

    #[test]
    fn a_run_can_be_replayed_on_any_number_of_threads() {
        let run = |par| {
            let mut simulator = simulator(par);
            let mut bits = Vec::new();
            for step in 0..30 {
                let seen = simulator.step(&Twist2::new(0.5, 0.0, f64::from(step) * 0.01)).unwrap();
                bits.extend(seen.scan.unwrap().ranges().iter().map(|r| r.to_bits()));
                bits.push(seen.odometry.start_from_end.x().to_bits() as u32);
            }
            bits
        };
        assert_eq!(run(Par::Seq), run(Par::threads(3)));
    }

    #[test]
    fn contact_is_reported_when_the_bumper_reaches_the_wall() {
        let mut simulator = simulator(Par::Seq);
        let (mut contact, mut clear) = (false, true);
        while !contact {
            clear &= simulator.clearance(10.0) > 0.0;
            contact = simulator.step(&Twist2::new(1.0, 0.0, 0.0)).unwrap().contact;
        }
        // 8 m to the wall less 0.25 m of body, overshot by less than a step.
        let travelled = simulator.vehicle().map_from_base().x() - 2.0;
        assert!(clear && (7.75..7.8 + 1e-9).contains(&travelled), "{travelled}");
        assert_eq!(simulator.clearance(10.0), 0.0);
    }

    #[test]
    fn a_moving_obstacle_runs_into_a_vehicle_at_rest() {
        let frame = |time, x| KeyFrame { time, position: Vector2::new(x, 3.0) };
        let disc = MovingDisc::new(0.5, 10.0, vec![frame(0.0, 8.0), frame(5.5, 2.5), frame(10.0, 8.0)]).unwrap();
        let mut simulator = simulator(Par::Seq).with_moving(MovingDiscs::new(vec![disc]));
        let ahead = simulator.look().unwrap().ranges()[540];
        assert!((ahead - 5.5).abs() < 0.1, "{ahead}");
        // At 1 m/s its edge reaches the bumper, at x = 2.25 m, after 5.25 s.
        let first = (1..=120).find(|_| simulator.step(&Twist2::ZERO).unwrap().contact).unwrap();
        assert!((105..=106).contains(&first), "{first}");
    }

    #[test]
    fn bad_steps_are_refused() {
        let mut simulator = simulator(Par::Seq);
        let before = simulator.vehicle().clone();
        assert!(simulator.step(&Twist2::new(f64::NAN, 0.0, 0.0)).is_err());
        assert_eq!(simulator.vehicle(), &before);
        let (world, laser) = (World2d::new(vec![]).unwrap(), Laser::new(LaserParams::default(), Seed(0)).unwrap());
        assert!(Simulator2d::new(world, before, Body::circle(0.1).unwrap(), laser, 0.0).is_err());
    }
}
