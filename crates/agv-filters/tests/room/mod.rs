//! A room of 8 m by 5 m whose scans are computed in closed form, and drives through it.

use agv_core::{
    compute::{Seed, Stream},
    geometry::{LieGroup, Se2, Twist2},
    grid::{Cell, CellState, Grid, GridLayout},
    odometry::OdometryIncrement,
    roles::{Localizer, PoseBelief},
    sensors::{LaserScan, ScanGeometry, SensorId},
    time::Stamp,
};
use agv_filters::particle::{FreeSpace, Mcl, MclParams, MotionModel};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// Inner size of the room, in metres.
pub(crate) const ROOM: (f64, f64) = (8.0, 5.0);
pub(crate) const RANGE_SIGMA: f64 = 0.02;

/// Free inside, a wall of one cell whose inner face is the room's.
pub(crate) fn room() -> Grid<CellState> {
    let mut map = Grid::filled(GridLayout::new(162, 102, 0.05, Se2::new(-0.05, -0.05, 0.0)).unwrap(), CellState::Free);
    for index in 0..map.layout().len() {
        let cell = map.layout().cell(index);
        if [0, 161].contains(&cell.x) || [0, 101].contains(&cell.y) {
            map.set(Cell::new(cell.x, cell.y), CellState::Occupied);
        }
    }
    map
}

/// A laser of so many beams over 4 rad.
pub(crate) struct Laser {
    pub(crate) beams: usize,
    pub(crate) base_from_sensor: Se2,
    pub(crate) sensor: SensorId,
}

impl Laser {
    pub(crate) fn ahead(beams: usize) -> Self {
        Self { beams, base_from_sensor: Se2::identity(), sensor: SensorId::default() }
    }

    /// What it sees from a vehicle at `pose`, with round things of which the map does not know: centre and radius.
    pub(crate) fn scan(&self, pose: &Se2, things: &[(Vector2<f64>, f64)], stream: &mut Stream) -> LaserScan {
        let geometry = ScanGeometry {
            sensor: self.sensor,
            base_from_sensor: self.base_from_sensor,
            angle_min: -2.0,
            angle_increment: 4.0 / (self.beams - 1) as f64,
            range_max: 20.0,
            ..Default::default()
        };
        let eye = *pose * self.base_from_sensor;
        let range = |i: usize| {
            let (sin, cos) = (eye.yaw() + geometry.angle(i)).sin_cos();
            let along_x = if cos > 0.0 { (ROOM.0 - eye.x()) / cos } else { -eye.x() / cos };
            let along_y = if sin > 0.0 { (ROOM.1 - eye.y()) / sin } else { -eye.y() / sin };
            let thing = |(center, radius): &(Vector2<f64>, f64)| {
                let to = center - eye.translation();
                let (along, across) = (to.x * cos + to.y * sin, to.y * cos - to.x * sin);
                let seen = along > 0.0 && across.abs() < *radius;
                if seen { along - (radius * radius - across * across).sqrt() } else { f64::INFINITY }
            };
            things.iter().map(thing).fold(along_x.min(along_y), f64::min)
        };
        let noisy = (0..self.beams).map(|i| {
            let z: f64 = StandardNormal.sample(stream);
            (range(i) + RANGE_SIGMA * z) as f32
        });
        LaserScan::new(Stamp::default(), geometry, noisy.collect()).unwrap()
    }
}

/// A filter in the room.
pub(crate) fn filter<M, S>(motion: M, sensor: S, particles: usize, seed: u64) -> Mcl<M, S> {
    let params = MclParams { particles, ..Default::default() };
    Mcl::new(motion, sensor, FreeSpace::new(&room(), 0.2).unwrap(), params, Seed(seed)).unwrap()
}

/// Root mean squares of what the estimate was off by, and the median of its normalised squared error.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Errors {
    pub(crate) position: f64,
    pub(crate) heading: f64,
    pub(crate) median_nees: f64,
}

/// Drives on circles: the odometry reports `twist` for a second each, the vehicle does what `slip` draws, and `observe` shows
/// the filter what there is to see. The first ten updates, which start from 0.2 m and 0.1 rad, do not count.
pub(crate) fn drive<M, S>(
    mcl: &mut Mcl<M, S>,
    slip: &M,
    (start, twist): (Se2, Twist2),
    covariance: Matrix3<f64>,
    seed: u64,
    mut observe: impl FnMut(&mut Mcl<M, S>, &Se2, &mut Stream),
) -> Errors
where
    M: MotionModel<Motion = OdometryIncrement>,
{
    let (mut truth, mut world) = (start, Seed(seed).derive(99).stream(0, 0));
    let spread = Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.01));
    mcl.initialize(&PoseBelief::around(truth, spread).unwrap()).unwrap();
    let (mut squares, mut headings, mut nees) = (0.0, 0.0, Vec::new());
    for step in 0..60 {
        let now = Stamp::default();
        let reported = OdometryIncrement::between(now, &Se2::identity(), now, &twist.integrate(1.0)).unwrap();
        let reported = OdometryIncrement { covariance, ..reported };
        truth = slip.condition(&reported)(&truth, &mut world);
        mcl.predict(&reported).unwrap();
        observe(mcl, &truth, &mut world);
        if step >= 10 {
            let estimate = mcl.estimate().unwrap();
            let error = truth.minus(estimate.map_from_base());
            squares += error.xy().norm_squared();
            headings += error.z * error.z;
            nees.push(estimate.covariance().try_inverse().map_or(f64::INFINITY, |w| error.dot(&(w * error))));
        }
    }
    nees.sort_by(f64::total_cmp);
    let root_mean = |sum: f64| (sum / nees.len() as f64).sqrt();
    Errors { position: root_mean(squares), heading: root_mean(headings), median_nees: nees[nees.len() / 2] }
}
