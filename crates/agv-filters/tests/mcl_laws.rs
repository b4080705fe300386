//! Monte Carlo localisation keeps the laws of its roles, in a room with a real sensor model.

use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2},
    grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, SkipReason, UpdateOutcome, laws},
    sensors::{LaserScan, ScanGeometry, SensorId},
    time::Stamp,
};
use agv_filters::particle::{
    DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
    OdometryNoise,
};
use nalgebra::{Matrix3, Vector3};

/// A room of 8 x 5 m.
fn room() -> Grid<CellState> {
    let mut map = Grid::filled(GridLayout::new(162, 102, 0.05, Se2::new(-0.05, -0.05, 0.0)).unwrap(), CellState::Free);
    for index in 0..map.layout().len() {
        let cell = map.layout().cell(index);
        if [0, 161].contains(&cell.x) || [0, 101].contains(&cell.y) {
            map.set(Cell::new(cell.x, cell.y), CellState::Occupied);
        }
    }
    map
}

fn filter(par: Par) -> Mcl<DifferentialOdometryModel, LikelihoodFieldModel> {
    let map = room();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let free_space = FreeSpace::new(&map, 0.2).unwrap();
    Mcl::new(motion, sensor, free_space, MclParams::default(), Seed(11)).unwrap().with_parallelism(par)
}

fn scan(ranges: Vec<f32>) -> LaserScan {
    scan_of(SensorId::default(), ranges)
}

fn scan_of(sensor: SensorId, ranges: Vec<f32>) -> LaserScan {
    let geometry = ScanGeometry { angle_min: -1.5, angle_increment: 3.0 / 90.0, sensor, ..Default::default() };
    LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
}

#[test]
fn the_filter_keeps_the_laws_of_its_roles() {
    let covariance = Matrix3::from_diagonal(&Vector3::new(0.01, 0.02, 0.005));
    for par in [Par::Seq, Par::threads(2)] {
        for (start, ahead) in [
            (Se2::new(3.0, 2.0, 0.4), Se2::new(1.0, 0.0, 0.0)),
            (Se2::new(5.0, 3.0, -3.1), Se2::new(0.5, 0.0, 0.6)),
            // Too small a motion for the particles to follow at once.
            (Se2::new(1.5, 4.0, 1.5), Se2::new(0.05, 0.0, 0.02)),
        ] {
            let motion =
                OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::from_seconds(1.0), &ahead)
                    .unwrap();
            let mut mcl = filter(par);
            assert_eq!(laws::localizer(&mut mcl, &start, &covariance, &motion), Ok(()), "{start:?}");
            for nothing in [vec![], vec![f32::NAN; 91], vec![f32::INFINITY; 91], vec![0.0; 91]] {
                assert_eq!(laws::correct(&mut mcl, &scan(nothing)), Ok(()), "{start:?}");
            }
            // Skipped scans leave it fit for the next one.
            let lasers = [0, 1].map(|sensor| scan_of(SensorId(sensor), vec![1.5; 91]));
            assert_eq!(laws::two_sensors(&mut mcl, &lasers[0], &lasers[1]), Ok(()), "{start:?}");
            for laser in &lasers {
                let again = mcl.update(laser);
                assert_eq!(again, Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion)), "{start:?}");
            }
        }
    }
}
