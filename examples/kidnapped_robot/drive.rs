//! The drive that all filters follow: what odometry, laser and camera report, and where the vehicle really is.

use super::{
    Result,
    site::{PER_METRE, RADIUS, Site},
};
use agv_nav::{core::sensors::MarkerObservation, prelude::*};
use agv_sim::{Body, FloorCamera, FloorCameraParams, Laser, LaserParams, OdometryErrors, Vehicle, VehicleParams};
use rand::RngExt;

/// Seconds per step: the laser's and the camera's rate.
pub(crate) const DT: f64 = 0.1;
/// Speed on the route, in m/s.
const SPEED: f64 = 0.8;
/// Metres from stop to stop, a whole number of codes.
const STATION_PITCH: usize = 7;
/// Seconds at each stop.
const STOP: f64 = 2.0;

/// One step of a drive.
pub(crate) struct Step {
    pub(crate) time: f64,
    pub(crate) odometry: OdometryIncrement,
    pub(crate) scan: LaserScan,
    /// A code under the vehicle.
    pub(crate) code: Option<MarkerObservation<Se2>>,
    pub(crate) truth: Se2,
    /// The vehicle stands at a station.
    pub(crate) is_standing: bool,
}

/// A drive with its kidnap.
pub(crate) struct Drive {
    pub(crate) start: Se2,
    pub(crate) steps: Vec<Step>,
    /// First step after the vehicle was put elsewhere.
    pub(crate) kidnap: Option<usize>,
}

/// What moves and what it sees.
struct Simulated<'a> {
    site: &'a Site,
    vehicle: Vehicle,
    laser: Laser,
    camera: FloorCamera,
    step: usize,
}

impl<'a> Simulated<'a> {
    fn new(site: &'a Site, start: Se2, seed: Seed) -> Result<Self> {
        // 320° and 10 m with 2 cm of noise, as paper 001's.
        let mut laser = LaserParams::default().with_beams(321, 320_f64.to_radians());
        (laser.geometry.range_max, laser.range_sigma) = (10.0, 0.02);
        let camera = FloorCameraParams { damaged: 0.2, ..FloorCameraParams::default() };
        Ok(Self {
            site,
            vehicle: vehicle(start, seed)?,
            laser: Laser::new(laser, seed)?,
            camera: FloorCamera::new(camera, site.codes.clone(), seed)?,
            step: 0,
        })
    }

    fn drive(&mut self, command: &Twist2, is_standing: bool) -> Result<Step> {
        let odometry = self.vehicle.step(command, DT)?;
        let truth = self.vehicle.truth();
        let (pose, stamp) = (truth.map_from_base, truth.stamp);
        let scan = self.laser.scan(self.site.world.as_ref(), &pose, &truth.twist, stamp)?.clone();
        let code = self.camera.look(&pose, stamp)?.first().copied();
        self.step += 1;
        Ok(Step { time: self.step as f64 * DT, odometry, scan, code, truth: pose, is_standing })
    }

    fn pose(&self) -> Se2 {
        self.vehicle.map_from_base()
    }
}

/// Odometry with a standard deviation of a tenth of each step's run and turn.
fn vehicle(pose: Se2, seed: Seed) -> Result<Vehicle> {
    let odometry = OdometryErrors { alphas: [0.01; 4], ..OdometryErrors::NONE };
    Ok(Vehicle::new(VehicleParams { odometry, ..VehicleParams::default() }, pose, seed)?)
}

/// Laps on the route with stops, and one kidnap: between 6 and 12 s from the start the vehicle is put to another place of the
/// route, beside it by some decimetres and askew by up to 60°. The drive goes on for 32 s.
pub(crate) fn kidnapped(site: &Site, seed: Seed) -> Result<Drive> {
    let (route, mut stream) = (&site.route, seed.derive(77).stream(0, 0));
    let first = stream.random_range(0..route.len());
    let mut simulated = Simulated::new(site, route[first], seed)?;
    let kidnap = (stream.random_range(6.0..12.0) / DT) as usize;
    let mut driver = Driver::on(route, first);
    let mut steps = Vec::new();
    for index in 0..kidnap + (32.0 / DT) as usize {
        if index == kidnap {
            let (at, pose) = elsewhere(site, &simulated.pose(), &mut stream);
            simulated.vehicle = vehicle(pose, seed.derive(5))?;
            driver = Driver::on(route, at);
        }
        let (command, is_standing) = driver.command(&simulated.pose());
        steps.push(simulated.drive(&command, is_standing)?);
    }
    Ok(Drive { start: route[first], steps, kidnap: Some(kidnap) })
}

/// A place on or near the route, at least two metres away, and the route's index there.
fn elsewhere(site: &Site, from: &Se2, stream: &mut impl rand::Rng) -> (usize, Se2) {
    loop {
        let at = stream.random_range(0..site.route.len());
        let offset = Se2::new(0.0, stream.random_range(-0.3..0.3), stream.random_range(-1.05..1.05));
        let pose = site.route[at] * offset;
        let body = Body::circle(RADIUS);
        let is_free = body.is_ok_and(|body| !site.world.touches(&body, &pose));
        if is_free && (pose.translation() - from.translation()).norm() > 2.0 {
            return (at, pose);
        }
    }
}

/// Follows the route, and stops at its stations.
struct Driver<'a> {
    route: &'a [Se2],
    /// Index of the route that the vehicle has come to; it runs on over the laps.
    at: usize,
    standing: f64,
    station: usize,
}

impl<'a> Driver<'a> {
    fn on(route: &'a [Se2], at: usize) -> Self {
        let pitch = STATION_PITCH * PER_METRE;
        Self { route, at, standing: 0.0, station: (at / pitch + 1) * pitch }
    }

    fn pose(&self, index: usize) -> &Se2 {
        &self.route[index % self.route.len()]
    }

    fn command(&mut self, pose: &Se2) -> (Twist2, bool) {
        let distance = |index: usize| (self.pose(index).translation() - pose.translation()).norm_squared();
        let ahead = (self.at..self.at + 2 * PER_METRE).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        self.at = ahead.unwrap_or(self.at);
        let left = (self.station as f64 - self.at as f64) / PER_METRE as f64;
        if left < 0.03 {
            self.standing += DT;
            if self.standing < STOP {
                return (Twist2::ZERO, self.standing > 0.5 * STOP);
            }
            (self.standing, self.station) = (0.0, self.station + STATION_PITCH * PER_METRE);
        }
        let target = pose.between(self.pose(self.at + PER_METRE / 2));
        let bearing = target.y().atan2(target.x());
        if bearing.abs() > 0.8 {
            return (Twist2::new(0.0, 0.0, bearing.signum() * 0.8), false);
        }
        let speed = SPEED.min((0.6 * left.max(0.01)).sqrt()).max(0.05);
        (Twist2::new(speed, 0.0, 2.0 * speed * bearing.sin() / target.translation().norm().max(0.3)), false)
    }
}

/// Wanders for `length` metres from somewhere in free space: straight on where there is room, else to where there is more. It keeps to
/// what the map shows as free: a gate leads off it, where nothing is known.
pub(crate) fn wandering(site: &Site, length: f64, seed: Seed) -> Result<Drive> {
    let mut stream = seed.derive(77).stream(0, 0);
    let mut start = site.free_space.sample(&mut stream);
    let body = Body::circle(RADIUS)?;
    let is_free = |pose: &Se2| {
        let cell = site.map.layout().cell_at(&pose.translation());
        cell.and_then(|cell| site.map.get(cell)) == Some(&CellState::Free)
    };
    let clearance = |pose: &Se2| if is_free(pose) { site.world.clearance(&body, pose, 1.0) } else { 0.0 };
    while clearance(&start) < 0.1 {
        start = site.free_space.sample(&mut stream);
    }
    let mut simulated = Simulated::new(site, start, seed)?;
    let (mut steps, mut driven, mut liked) = (Vec::new(), 0.0, 0.0);
    while driven < length && steps.len() < 1500 {
        if steps.len() % 30 == 0 {
            liked = stream.random_range(-0.3..0.3);
        }
        let pose = simulated.pose();
        // Of some arcs, the one on which there is most room two seconds ahead, with a liking that changes.
        let room = |yaw_rate: f64| {
            let on_arc = |t: f64| clearance(&(pose * Twist2::new(0.6, 0.0, yaw_rate).integrate(t)));
            [0.5, 1.0, 1.5, 2.0].into_iter().map(on_arc).fold(1.0, f64::min)
        };
        let value = |yaw_rate: f64| room(yaw_rate).min(0.6) - 0.2 * (yaw_rate - liked).abs();
        let best = [-0.8, -0.4, -0.2, 0.0, 0.2, 0.4, 0.8].into_iter().max_by(|a, b| value(*a).total_cmp(&value(*b)));
        let yaw_rate = best.unwrap_or_default();
        let speed = if room(yaw_rate) > 0.02 { 0.6 } else { 0.0 };
        let turn = if speed == 0.0 { 0.8 } else { yaw_rate };
        let step = simulated.drive(&Twist2::new(speed, 0.0, turn), false)?;
        driven += (step.truth.translation() - pose.translation()).norm();
        steps.push(step);
    }
    Ok(Drive { start, steps, kidnap: None })
}
