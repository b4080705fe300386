//! What is derived from a map, what is asked of it, and paths through it.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes,
};
use agv_nav::core::{
    geometry::Se2,
    grid::{
        Cell, CellState, Costmap, DistanceParams, DistanceTransform, EvidenceGrid, GridLayout, Inflation,
        InflationParams, InverseModelParams, LikelihoodField, LikelihoodFieldParams, RayCastParams, RayCaster,
    },
    nalgebra::Vector2,
    path::Path,
    roles::{GlobalPlanner, PlanOutcome},
};
use agv_nav::plan::grid::{AStar, AStarParams};

/// Sides that are no multiples of a chunk.
fn map() -> agv_nav::core::grid::Grid<CellState> {
    scenes::cluttered(701, 333)
}

#[test]
fn distance_transform() {
    let map = map();
    let digest = assert_same_bits("DistanceTransform", |par| {
        let mut transform = DistanceTransform::new(DistanceParams::default()).unwrap().with_parallelism(par);
        Digest::new().singles(transform.compute(&map).unwrap().values())
    });
    // Integers and correctly rounded square roots: the same on every platform.
    assert_eq!(digest, 0xbe24_ae83_3c89_80c0);
}

#[test]
fn inflation() {
    let map = map();
    assert_same_bits("Inflation", |par| {
        let mut inflation = Inflation::new(InflationParams::default()).unwrap().with_parallelism(par);
        Digest::new().integers(inflation.inflate(&map).unwrap().costs().iter().copied())
    });
}

#[test]
fn likelihood_field() {
    let map = map();
    assert_same_bits("LikelihoodField", |par| {
        let params = LikelihoodFieldParams::default();
        Digest::new().singles(LikelihoodField::build(&map, params, par).unwrap().values())
    });
}

#[test]
fn ray_caster() {
    let caster = RayCaster::new(&map(), RayCastParams::default()).unwrap();
    let angles = (0..2500_i32).map(|i| f64::from(i) * 0.002_51);
    let directions: Vec<_> = angles.map(|angle| Vector2::new(angle.cos(), angle.sin())).collect();
    assert_same_bits("RayCaster", |par| {
        let mut ranges = vec![0.0; directions.len()];
        caster.cast_into(&Se2::new(10.0, 9.0, 0.4), &directions, 30.0, &mut ranges, par);
        Digest::new().singles(&ranges)
    });
}

#[test]
fn insertion() {
    let layout = GridLayout::new(10, 10, 0.05, Se2::new(1.0, 1.0, 0.2)).unwrap();
    let mut map = EvidenceGrid::new(layout, InverseModelParams::default()).unwrap();
    let mut pose = scenes::start();
    for (motion, scan) in scenes::circle(6) {
        pose = pose * motion.start_from_end;
        map.insert_scan(&scan, &pose).unwrap();
    }
    let corner = map.layout().map_from_grid();
    Digest::new().integers(map.evidence().iter().copied()).poses([&corner]).report("EvidenceGrid");
}

#[test]
fn paths() {
    let mut map = map();
    for corner in [Cell::new(3, 3), Cell::new(697, 329)] {
        map.set(corner, CellState::Free);
    }
    let costmap = Costmap::from_map(&map);
    let mut planner = AStar::new(AStarParams::default()).unwrap();
    let mut path = Path::new();
    let [start, goal] = [Se2::new(-2.825, 2.175, 0.0), Se2::new(31.875, 18.475, 0.0)];
    let outcome = planner.plan_into(&costmap, &start, &goal, &mut path).unwrap();
    let PlanOutcome::Found { cost, expansions } = outcome else { panic!("{outcome:?}") };
    let digest = Digest::new().bits([cost.to_bits(), expansions]).poses(path.points().iter().map(|p| &p.pose));
    // No function that platforms round differently: the same path everywhere.
    assert_eq!(digest.report("AStar"), 0xcdd9_0cb6_9c6e_89e1);
}
