//! Small worlds that the acceptance tests share.
#![allow(dead_code, reason = "each test binary uses its part")]

pub(crate) mod clouds;
pub(crate) mod equipped;
pub(crate) mod kalman;
pub(crate) mod landmarks;
pub(crate) mod mapping;
pub(crate) mod models;

use agv_nav::core::nalgebra::Matrix3;
use agv_nav::core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Twist2},
    grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_nav::filters::particle::{
    Amcl, AmclParams, DifferentialOdometryModel, FreeSpace, KldParams, LikelihoodFieldModel,
    LikelihoodFieldModelParams, Mcl, MclParams, OdometryNoise,
};

/// The first particle filter, as a user would build it.
pub(crate) type ScanFilter = Mcl<DifferentialOdometryModel, LikelihoodFieldModel>;

/// A room of 8 x 5 m with a pillar, 5 cm cells.
pub(crate) fn room() -> Grid<CellState> {
    let layout = GridLayout::new(162, 102, 0.05, Se2::new(-0.05, -0.05, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for x in 0..162 {
        for y in 0..102 {
            let is_wall = x == 0 || y == 0 || x == 161 || y == 101;
            let is_pillar = (60..70).contains(&x) && (40..46).contains(&y);
            if is_wall || is_pillar {
                map.set(Cell::new(x, y), CellState::Occupied);
            }
        }
    }
    map
}

/// A filter in the room.
pub(crate) fn scan_filter(particles: usize, par: Par) -> ScanFilter {
    let map = room();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let params = MclParams { particles, ..Default::default() };
    let free_space = FreeSpace::new(&map, 0.2).unwrap();
    Mcl::new(motion, sensor, free_space, params, Seed(7)).unwrap().with_parallelism(par)
}

/// The same with a belief around the start of [`circle`].
pub(crate) fn initialized(particles: usize, par: Par) -> ScanFilter {
    let mut filter = scan_filter(particles, par);
    filter.initialize(&PoseBelief::around(start(), Matrix3::identity() * 0.04).unwrap()).unwrap();
    filter
}

/// The adaptive filter in the room, for a vehicle that may be anywhere.
pub(crate) fn adaptive_filter(par: Par) -> Amcl<DifferentialOdometryModel, LikelihoodFieldModel> {
    let map = room();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let kld = KldParams { max_particles: 4000, ..Default::default() };
    let params = AmclParams { kld, ..Default::default() };
    let free_space = FreeSpace::new(&map, 0.2).unwrap();
    let mut filter = Amcl::new(motion, sensor, free_space, params, Seed(7)).unwrap().with_parallelism(par);
    filter.initialize(&PoseBelief::Anywhere).unwrap();
    filter
}

/// Localises along [`circle`], and says how many particles were drawn elsewhere.
pub(crate) fn localize_adaptively(
    filter: &mut Amcl<DifferentialOdometryModel, LikelihoodFieldModel>,
    steps: &[(OdometryIncrement, LaserScan)],
) -> usize {
    let mut fresh = 0;
    for (motion, scan) in steps {
        filter.predict(motion).unwrap();
        assert!(matches!(filter.update(scan), Ok(UpdateOutcome::Applied(_))));
        std::hint::black_box(filter.hypotheses());
        fresh += filter.diagnostics().fresh;
    }
    fresh
}

/// Particles, weights and estimate of an adaptive filter.
pub(crate) fn adaptive_bits(filter: &Amcl<DifferentialOdometryModel, LikelihoodFieldModel>) -> Vec<u64> {
    let estimate = filter.estimate().unwrap();
    let pose = |p: &Se2| [p.x(), p.y(), p.rotation().cos(), p.rotation().sin()];
    let particles = filter.particles().states().iter().flat_map(pose);
    let hypotheses = filter.hypotheses().iter().flat_map(|h| pose(h.pose.mean()).into_iter().chain([h.weight]));
    let mean = pose(estimate.map_from_base()).into_iter().chain(estimate.covariance().iter().copied());
    particles
        .chain(filter.particles().log_weights().iter().copied())
        .chain(hypotheses)
        .chain(mean)
        .map(f64::to_bits)
        .collect()
}

/// Localises along [`circle`], and says whether the particles were resampled.
pub(crate) fn localize(filter: &mut ScanFilter, steps: &[(OdometryIncrement, LaserScan)]) -> bool {
    let mut resampled = false;
    for (motion, scan) in steps {
        filter.predict(motion).unwrap();
        assert!(matches!(filter.update(scan), Ok(UpdateOutcome::Applied(_))));
        std::hint::black_box(filter.estimate());
        resampled |= filter.diagnostics().resampled;
    }
    resampled
}

/// Particles, weights and estimate of a filter.
pub(crate) fn filter_bits(filter: &ScanFilter) -> Vec<u64> {
    let estimate = filter.estimate().unwrap();
    let pose = |p: &Se2| [p.x(), p.y(), p.rotation().cos(), p.rotation().sin()];
    let particles = filter.particles().states().iter().flat_map(pose);
    let weights = filter.particles().weights().iter().chain(filter.particles().log_weights()).copied();
    let mean = pose(estimate.map_from_base()).into_iter().chain(estimate.covariance().iter().copied());
    particles.chain(weights).chain(mean).map(f64::to_bits).collect()
}

/// A map with one cell in forty occupied and one in thirty unknown, by a generator of integers of its own.
pub(crate) fn cluttered(width: usize, height: usize) -> Grid<CellState> {
    let mut state = 1_u64;
    let cells = (0..width * height).map(|_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        match state >> 33 {
            n if n % 40 == 0 => CellState::Occupied,
            n if n % 30 == 1 => CellState::Unknown,
            _ => CellState::Free,
        }
    });
    let cells = cells.collect();
    Grid::new(GridLayout::new(width, height, 0.05, Se2::new(-3.0, 2.0, 0.0)).unwrap(), cells).unwrap()
}

/// A circle in the room: odometry and scan of each step.
pub(crate) fn circle(steps: usize) -> Vec<(OdometryIncrement, LaserScan)> {
    let (map, geometry) = (room(), ahead());
    let motion = circle_step();
    let mut pose = start();
    let drive = (0..steps).map(|_| {
        pose = pose * motion.start_from_end;
        (motion, seen(&map, &pose, geometry))
    });
    drive.collect()
}

/// What the odometry says of each step of [`circle`].
pub(crate) fn circle_step() -> OdometryIncrement {
    let step = Twist2::new(0.25, 0.0, 0.2).integrate(1.0);
    OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &step).unwrap()
}

/// A laser of 180 beams that looks ahead.
pub(crate) fn ahead() -> ScanGeometry {
    ScanGeometry { angle_min: -2.0, angle_increment: 4.0 / 179.0, ..Default::default() }
}

/// What a laser sees from a vehicle at `pose`, by marching along the beams.
pub(crate) fn seen(map: &Grid<CellState>, pose: &Se2, geometry: ScanGeometry) -> LaserScan {
    let eye = *pose * geometry.base_from_sensor;
    let range = |beam: usize| {
        let (sin, cos) = (eye.yaw() + geometry.angle(beam)).sin_cos();
        let hit = (0..1000).map(|k| f64::from(k) * 0.01).find(|r| {
            let cell = map.layout().cell_at(&[eye.x() + r * cos, eye.y() + r * sin].into());
            cell.is_none_or(|cell| map.get(cell) == Some(&CellState::Occupied))
        });
        hit.unwrap_or(f64::INFINITY) as f32
    };
    LaserScan::new(Stamp::default(), geometry, (0..180).map(range).collect()).unwrap()
}

/// Where the circle starts.
pub(crate) fn start() -> Se2 {
    Se2::new(4.0, 0.9, 0.0)
}
