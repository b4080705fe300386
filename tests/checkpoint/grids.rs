//! Maps, and what is made of them.

use crate::{
    scenes,
    table::{assert_kept, assert_refused, restored},
};
use agv_nav::core::{
    geometry::Se2,
    grid::{
        Costmap, EvidenceGrid, Footprint, GaussianGrid, GaussianParams, Grid, GridLayout, InverseModelParams,
        OccupancyGrid, OccupancyParams, OccupancyThresholds, distance_field,
    },
    nalgebra::Vector2,
};
use serde_json::{Value, json};

fn layout() -> GridLayout {
    GridLayout::new(120, 80, 0.05, Se2::new(1.3, -0.7, 0.3)).unwrap()
}

fn evidence(steps: usize) -> EvidenceGrid {
    let mut map = EvidenceGrid::new(layout(), InverseModelParams::default()).unwrap();
    insert(&mut map, 0..steps);
    map
}

fn live() -> OccupancyGrid {
    let params = OccupancyParams { half_life: Some(3.0), ..Default::default() };
    let mut map = OccupancyGrid::new(layout(), params).unwrap();
    for (_, scan) in scenes::circle(2) {
        map.insert_scan(&scan, &scenes::start()).unwrap();
        map.forget(0.123).unwrap();
    }
    map
}

fn insert(map: &mut EvidenceGrid, steps: std::ops::Range<usize>) {
    for (step, (_, scan)) in scenes::circle(steps.end).iter().enumerate().skip(steps.start) {
        map.insert_scan(scan, &Se2::new(3.0 + step as f64, 1.0, 0.4)).unwrap();
    }
}

fn gaussians() -> GaussianGrid {
    GaussianGrid::from_map(&scenes::room(), 0.5, GaussianParams::default()).unwrap()
}

#[test]
fn maps_come_back() {
    assert_kept("GridLayout", &layout());
    assert_kept("Grid of states", &scenes::room());
    assert_kept("Grid of distances", &distance_field(&scenes::room()).unwrap());
    assert_kept("Costmap", &Costmap::from_map(&scenes::room()));
    assert_kept("EvidenceGrid", &evidence(3));
    assert_kept("OccupancyGrid", &live());
    assert_kept("GaussianGrid", &gaussians());
    assert_kept("OccupancyThresholds", &OccupancyThresholds::new(0.7, 0.21).unwrap());
    assert_eq!(restored(&OccupancyThresholds::default()), OccupancyThresholds::default());
    let triangle = [(0.0, 0.0), (1.1, 0.0), (0.3, 0.7)].map(|(x, y)| Vector2::new(x, y)).to_vec();
    let segment = Footprint::segment(Vector2::new(-0.2, 0.1), Vector2::new(0.4, 0.3)).unwrap();
    let long = Footprint::two_circles(0.6, 0.4, -0.2, 0.5).unwrap();
    let round = Footprint::circle(0.3).unwrap();
    for footprint in [Footprint::point(), round, long, segment, Footprint::polygon(triangle).unwrap()] {
        assert_kept("Footprint", &footprint);
        assert_eq!(restored(&footprint), footprint);
    }
}

#[test]
fn maps_that_came_back_go_on_with_the_same_bits() {
    let (mut map, mut live) = (evidence(2), live());
    let (mut map_restored, mut live_restored) = (restored(&map), restored(&live));
    insert(&mut map, 2..5);
    insert(&mut map_restored, 2..5);
    for live in [&mut live, &mut live_restored] {
        live.forget(0.05).unwrap();
        live.insert_scan(&scenes::circle(1)[0].1, &Se2::new(3.3, 1.2, 0.3)).unwrap();
    }
    assert!(map == map_restored && live == live_restored);
    let (mut gaussians, mut gaussians_restored) = (gaussians(), restored(&gaussians()));
    for grid in [&mut gaussians, &mut gaussians_restored] {
        assert!(grid.insert(&Vector2::new(1.03, 1.07)));
    }
    assert!(gaussians == gaussians_restored);
}

/// Layouts that are none, for a layout that is stored at `at`.
fn bad_layouts(at: &str) -> [(String, Value); 4] {
    [("width", json!(121)), ("width", json!(0)), ("resolution", json!(0.0)), ("resolution", json!(null))]
        .map(|(field, value)| (format!("{at}/{field}"), value))
}

#[test]
fn spoilt_maps_are_refused() {
    assert_refused("Grid", &Grid::filled(layout(), 1.5_f32), &bad_layouts("/layout"));
    assert_refused("EvidenceGrid", &evidence(1), &bad_layouts(""));
    assert_refused("OccupancyGrid", &live(), &bad_layouts("/values/layout"));
    assert_refused(
        "Grid",
        &Grid::filled(layout(), 1.5_f32),
        &[
            ("/values", json!([1.0])),
            ("/values/3", json!(null)),
            ("/layout/map_from_grid/rotation/cos", json!(0.2)),
            ("/layout/map_from_grid/translation/0", json!(null)),
        ],
    );
    assert_refused(
        "Costmap",
        &Costmap::from_map(&scenes::room()),
        &[("/values", json!([1])), ("/values/0", json!(256))],
    );
    assert_refused(
        "EvidenceGrid",
        &evidence(1),
        &[
            ("/evidence", json!([1])),
            ("/evidence/0", json!(i32::MIN)),
            ("/evidence/0", json!(0.5)),
            ("/corner/0", json!(i64::MAX)),
            ("/model/p_hit", json!(1.0)),
            ("/model/p_miss", json!(null)),
        ],
    );
    assert_refused(
        "OccupancyGrid",
        &live(),
        &[
            ("/values/values/0", json!(i16::MAX)),
            ("/pending", json!(-0.1)),
            ("/pending", json!(null)),
            ("/params/p_min", json!(0.0)),
            ("/params/half_life", json!(0.0)),
        ],
    );
    assert_refused(
        "GaussianGrid",
        &gaussians(),
        &[("/sums/values", json!([])), ("/params/min_points", json!(1)), ("/params/min_sigma", json!(0.0))],
    );
    let thresholds = OccupancyThresholds::default();
    assert_refused("OccupancyThresholds", &thresholds, &[("/occupied", json!(0.1)), ("/free", json!(null))]);
    let circle = Footprint::circle(0.3).unwrap();
    assert_refused(
        "Footprint",
        &circle,
        &[("/circle", json!(-0.3)), ("/circle", json!(null)), ("", json!({"polygon": []}))],
    );
}
