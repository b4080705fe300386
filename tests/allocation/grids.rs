//! What is derived from a map, and what is asked of it.

use crate::{counter, scenes};
use agv_nav::core::{
    compute::Par,
    geometry::{Se2, Twist2},
    grid::{
        Cell, CellState, CollisionChecker, CollisionParams, Costmap, DistanceParams, DistanceTransform, Footprint,
        GaussianGrid, GaussianParams, Grid, Inflation, InflationParams, RayCastParams, RayCaster,
    },
    nalgebra::Vector2,
};

/// The room, and the same with another pillar.
fn maps() -> [Grid<CellState>; 2] {
    let mut changed = scenes::room();
    changed.set(Cell::new(30, 30), CellState::Occupied);
    [scenes::room(), changed]
}

#[test]
fn distance_transform() {
    let [one, other] = maps();
    let mut transform = DistanceTransform::new(DistanceParams::default()).unwrap();
    let (mut field, mut squared) = (transform.compute(&one).unwrap(), Grid::filled(*one.layout(), 0));
    transform.squared_into(&one, &mut squared).unwrap();
    let count = counter::count(|| {
        transform.compute_into(&other, &mut field).unwrap();
        transform.squared_into(&other, &mut squared).unwrap();
    });
    assert_eq!(count, 0);
    assert_eq!(field.get(Cell::new(30, 31)), Some(&0.05));
}

#[test]
fn distance_transform_inside_a_pool() {
    let [one, other] = maps();
    let new = |par| DistanceTransform::new(DistanceParams::default()).unwrap().with_parallelism(par);
    let state = std::sync::Mutex::new((new(Par::threads(2)), new(Par::Seq).compute(&one).unwrap()));
    let run = |map: &Grid<CellState>| {
        let (transform, field) = &mut *state.lock().unwrap();
        transform.compute_into(map, field).unwrap();
    };
    assert_eq!(counter::count_in_pool(2, || run(&one), || run(&other)), 0);
}

#[test]
fn inflation() {
    let [one, other] = maps();
    let mut inflation = Inflation::new(InflationParams::default()).unwrap();
    let mut costmap = inflation.inflate(&one).unwrap();
    assert_eq!(counter::count(|| inflation.inflate_into(&other, &mut costmap).unwrap()), 0);
    assert!(!costmap.is_traversable(Cell::new(30, 30)) && Costmap::from_map(&one).is_traversable(Cell::new(30, 30)));
}

#[test]
fn ray_caster() {
    let caster = RayCaster::new(&scenes::room(), RayCastParams::default()).unwrap();
    let angles = (0..360_i32).map(|degrees| f64::from(degrees).to_radians());
    let directions: Vec<_> = angles.map(|angle| Vector2::new(angle.cos(), angle.sin())).collect();
    let mut ranges = vec![0.0; directions.len()];
    let count = counter::count(|| {
        caster.cast_into(&scenes::start(), &directions, 10.0, &mut ranges, Par::Seq);
        assert!(caster.cast(&Vector2::new(1.0, 1.0), 0.3, 20.0).is_some());
        assert!(caster.cast_exact(&Vector2::new(1.0, 1.0), 0.3, 20.0).is_some());
    });
    assert_eq!(count, 0);
    assert!(ranges.iter().all(|range| range.is_finite()));
}

#[test]
fn collision_checker() {
    let footprints = [Footprint::circle(0.3).unwrap(), Footprint::rectangle(-0.2, 0.6, 0.5).unwrap()];
    let [one, other] = maps();
    for footprint in footprints {
        let mut checker = CollisionChecker::new(&one, footprint, CollisionParams::default()).unwrap();
        let mut run = |heading: f64| {
            // Clear, near the pillar of the map, and through its wall.
            let hits = [(1.0, 3.5), (2.7, 2.0), (7.9, 2.0)].map(|(x, y)| {
                let pose = Se2::new(x, y, heading);
                let along = checker.collides_along(&pose, &Twist2::new(0.4, 0.0, 0.3), 0.5).unwrap();
                let between = checker.collides_between(&pose, &Se2::new(x, y + 0.2, heading)).unwrap();
                checker.collides(&pose).unwrap() || along || between
            });
            assert!(!hits[0] && hits[2], "{hits:?} {heading}");
            checker.set_map(&other).unwrap();
        };
        run(0.0);
        assert_eq!(counter::count(|| (1..20).for_each(|k| run(0.3 * f64::from(k)))), 0);
    }
}

#[test]
fn gaussian_grid() {
    let mut grid = GaussianGrid::new(*scenes::room().layout(), GaussianParams::default()).unwrap();
    let other = grid.clone();
    let count = counter::count(|| {
        for k in 0..1000 {
            let t = 0.005 * f64::from(k);
            assert!(grid.insert(&Vector2::new(1.0 + t, 1.0 + 0.5 * t)));
        }
        grid.merge(&other).unwrap();
        let seen = (0..grid.layout().len()).filter(|&i| grid.gaussian(grid.layout().cell(i)).is_some()).count();
        assert!(seen > 50, "{seen}");
    });
    assert_eq!(count, 0);
}
