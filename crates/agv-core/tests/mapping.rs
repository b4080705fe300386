//! Laws of the mapping and the live grid: order, merging, growth, clamping, bad input, checkpoints.

use agv_core::{
    Error,
    geometry::Se2,
    grid::{
        Cell, CellState, EvidenceGrid, Grid, GridLayout, InverseModelParams, NoReturn, OccupancyGrid, OccupancyParams,
        OccupancyThresholds, QUANTUM, Traversal,
    },
    nalgebra::Vector2,
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use proptest::prelude::*;

fn layout() -> GridLayout {
    GridLayout::new(40, 30, 0.1, Se2::new(-2.0, -1.5, 0.3)).unwrap()
}

fn scan(ranges: Vec<f32>) -> LaserScan {
    let geometry = ScanGeometry { angle_min: -1.0, angle_increment: 0.11, range_max: 12.0, ..Default::default() };
    LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
}

fn grid() -> EvidenceGrid {
    EvidenceGrid::new(layout(), InverseModelParams::default()).unwrap()
}

fn mapped<'a>(scans: impl IntoIterator<Item = &'a (LaserScan, Se2)>) -> EvidenceGrid {
    let mut map = grid();
    for (scan, pose) in scans {
        map.insert_scan(scan, pose).unwrap();
    }
    map
}

/// A scan somewhere within 15 m of the first layout, with hits, missing returns and nonsense.
fn any_scan() -> impl Strategy<Value = (LaserScan, Se2)> {
    let range = prop_oneof![8 => 0.05_f32..12.0, 1 => Just(f32::INFINITY), 1 => Just(f32::NAN)];
    (prop::collection::vec(range, 1..20), -15.0..15.0_f64, -15.0..15.0_f64, -3.1..3.1_f64)
        .prop_map(|(ranges, x, y, yaw)| (scan(ranges), Se2::new(x, y, yaw)))
}

fn merged(a: &EvidenceGrid, b: &EvidenceGrid) -> EvidenceGrid {
    let mut sum = a.clone();
    sum.merge(b).unwrap();
    sum
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn merging_is_associative_and_commutative_to_the_bit(
        a in prop::collection::vec(any_scan(), 0..3),
        b in prop::collection::vec(any_scan(), 0..3),
        c in prop::collection::vec(any_scan(), 0..3),
    ) {
        let (ma, mb, mc) = (mapped(&a), mapped(&b), mapped(&c));
        let together = mapped(a.iter().chain(&b).chain(&c));
        prop_assert!(merged(&merged(&ma, &mb), &mc) == merged(&ma, &merged(&mb, &mc)));
        prop_assert!(merged(&ma, &mb) == merged(&mb, &ma));
        prop_assert!(merged(&merged(&ma, &mb), &mc) == together, "merging equals mapping all scans in one grid");
    }

    #[test]
    fn the_order_of_scans_does_not_matter(
        (scans, shuffled) in prop::collection::vec(any_scan(), 1..6)
            .prop_flat_map(|scans| (Just(scans.clone()), Just(scans).prop_shuffle())),
    ) {
        prop_assert!(mapped(&scans) == mapped(&shuffled));
    }

    /// Every beam by the public traversal, one after the other.
    #[test]
    fn insertion_is_the_sum_over_the_traversals((scan, pose) in any_scan()) {
        let params = InverseModelParams { protect_hits: false, ..Default::default() };
        let mut map = EvidenceGrid::new(layout(), params).unwrap();
        let done = map.insert_scan(&scan, &pose).unwrap();
        let grown = map.layout();
        let mut expected = vec![0; grown.len()];
        let (free, hit) = (map.model().free(), map.model().hit());
        let mut updates = 0;
        for point in scan.points_in_base() {
            let from = layout().to_grid(&pose.translation());
            let end = layout().to_grid(&(pose * point));
            let mut cells = Traversal::new(&from, &end).unwrap().peekable();
            let corner = grown.to_grid(&layout().map_from_grid().translation());
            let (dx, dy) = (corner.x.round() as i32, corner.y.round() as i32);
            while let Some(cell) = cells.next() {
                let evidence = if cells.peek().is_some() { free } else { hit };
                expected[grown.index(Cell::new(cell.x + dx, cell.y + dy)).unwrap()] += evidence;
                updates += 1;
            }
        }
        let different = map.evidence().iter().zip(&expected).filter(|(a, b)| a != b).count();
        // The same real end point, computed along two ways, may round to neighbouring lattice points.
        prop_assert!(different <= 4, "{} cells differ", different);
        prop_assert!(done.cells_updated().abs_diff(updates) <= 4);
    }
}

#[test]
fn bad_input_is_named_and_changes_nothing() {
    let mut map = mapped(&[(scan(vec![3.0; 15]), Se2::default())]);
    let mut live = OccupancyGrid::new(layout(), OccupancyParams::default()).unwrap();
    let (before, live_before) = (map.clone(), live.clone());
    let good = scan(vec![2.0; 5]);
    for pose in [
        Se2::new(f64::NAN, 0.0, 0.0),
        Se2::new(0.0, f64::INFINITY, 0.0),
        Se2::new(0.0, 0.0, f64::NAN),
        Se2::new(1e12, 0.0, 0.0),
        Se2::new(0.0, -1e300, 0.0),
    ] {
        assert!(map.insert_scan(&good, &pose).is_err(), "{pose:?}");
        assert!(live.insert_scan(&good, &pose).is_err(), "{pose:?}");
    }
    let far = Se2::new(1e6, 1e6, 0.0);
    assert!(matches!(map.insert_scan(&good, &far), Err(Error::TooMany { name: "grid", .. })));
    assert!(map == before && live == live_before);

    let nothing = map.insert_scan(&scan(vec![]), &Se2::default()).unwrap();
    assert_eq!((nothing.beams_used, nothing.cells_updated()), (0, 0));
    let silent = map.insert_scan(&scan(vec![f32::NAN, -1.0, f32::INFINITY]), &far).unwrap();
    assert_eq!((silent.beams_skipped, silent.grown), (3, false));
    assert!(map == before);
    // A live grid does not grow: a scan elsewhere is no error and changes nothing.
    assert_eq!(live.insert_scan(&good, &Se2::new(500.0, 0.0, 0.0)).unwrap().cells_updated(), 0);
    assert!(live == live_before);
}

#[test]
fn grids_of_different_lattices_are_not_merged() {
    let mut map = grid();
    for other in [
        GridLayout::new(40, 30, 0.2, Se2::new(-2.0, -1.5, 0.3)).unwrap(),
        GridLayout::new(40, 30, 0.1, Se2::new(-2.01, -1.5, 0.3)).unwrap(),
        GridLayout::new(40, 30, 0.1, Se2::new(-2.0, -1.5, 0.31)).unwrap(),
    ] {
        let other = EvidenceGrid::new(other, InverseModelParams::default()).unwrap();
        assert!(matches!(map.merge(&other), Err(Error::LayoutMismatch { .. })));
    }
}

/// Adding a map to itself reaches the end of an `i32`: an error, not a wrap, and nothing has changed.
#[test]
fn evidence_does_not_overflow() {
    let pose = Se2::default();
    let once = scan(vec![3.0; 15]);
    let mut map = mapped(&[(once.clone(), pose)]);
    let mut powers = vec![map.clone()];
    while let Ok(()) = map.merge(&powers[powers.len() - 1]) {
        powers.push(map.clone());
    }
    assert!(map == powers[powers.len() - 1], "a refused merge changes nothing");
    // Fill up with smaller maps until not even one scan fits.
    for power in powers.iter().rev() {
        let refused = map.merge(power);
        assert!(refused.is_ok() || matches!(refused, Err(Error::OutOfRange { name: "evidence", .. })));
    }
    let before = map.clone();
    let once_at_most = 15 * map.model().hit().unsigned_abs();
    assert!(map.evidence().iter().any(|v| v.unsigned_abs() > i32::MAX.unsigned_abs() - once_at_most));
    assert!(matches!(map.insert_scan(&once, &pose), Err(Error::OutOfRange { name: "evidence", .. })));
    assert!(map == before);
    let cell = map.layout().cell_at(&Vector2::new(1.0, 0.0)).unwrap();
    assert!(map.log_odds(cell).unwrap().abs() < 14.0, "reading clamps");
}

#[test]
fn a_hit_is_protected_from_its_neighbours() {
    // A wall seen at a flat angle: one row of cells, many beams through it.
    let ranges: Vec<f32> = (0..50).map(|i| (0.59 / (0.02 + 0.003 * f64::from(i)).sin()) as f32).collect();
    let geometry = ScanGeometry { angle_min: 0.02, angle_increment: 0.003, range_max: 60.0, ..Default::default() };
    let scan = LaserScan::new(Stamp::default(), geometry, ranges).unwrap();
    let flat = GridLayout::new(300, 20, 0.1, Se2::default()).unwrap();
    let negative_ends = |protect_hits| {
        let mut map = EvidenceGrid::new(flat, InverseModelParams { protect_hits, ..Default::default() }).unwrap();
        map.insert_scan(&scan, &Se2::default()).unwrap();
        let ends = scan.points_in_base().filter_map(|p| map.layout().cell_at(&p));
        ends.filter(|&cell| map.log_odds(cell).unwrap() < 0.0).count()
    };
    assert_eq!(negative_ends(true), 0);
    assert!(negative_ends(false) > 0, "without protection the wall is washed out");
}

#[test]
fn a_live_grid_forgets_what_has_gone() {
    let params = OccupancyParams { half_life: Some(10.0), ..Default::default() };
    let mut live = OccupancyGrid::new(layout(), params).unwrap();
    let at = |x: f64| layout().cell_at(&Vector2::new(x, 0.0)).unwrap();
    for _ in 0..1000 {
        live.insert_scan(&scan(vec![1.04; 20]), &Se2::default()).unwrap();
    }
    let thresholds = OccupancyThresholds::default();
    assert!((live.probability(at(0.5)).unwrap() - params.p_min).abs() < 1e-3, "clamped below");
    let wall = layout().cell_at(&Vector2::new(1.04 * 0.1_f64.cos(), 1.04 * 0.1_f64.sin())).unwrap();
    assert!((live.probability(wall).unwrap() - params.p_max).abs() < 1e-3, "clamped above");
    // From 3.5 to below 0 at -0.405 each: nine scans, whatever the thousand before.
    for _ in 0..9 {
        live.insert_scan(&scan(vec![1.6; 20]), &Se2::default()).unwrap();
    }
    assert!(live.log_odds(wall).unwrap() < 0.0);

    let before = live.log_odds(at(0.5)).unwrap();
    for _ in 0..1000 {
        live.forget(0.01).unwrap();
    }
    assert!((live.log_odds(at(0.5)).unwrap() - 0.5 * before).abs() < 9.0 * QUANTUM, "half after a half-life");
    live.forget(1e6).unwrap();
    assert_eq!(live.state(at(0.5), &thresholds), Some(CellState::Unknown));
    for dt in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(live.forget(dt).is_err());
    }
}

#[test]
fn bad_live_parameters_are_named() {
    let good = OccupancyParams::default();
    for (name, bad) in [
        ("p_min", OccupancyParams { p_min: 0.5, ..good }),
        ("p_min", OccupancyParams { p_min: 0.0, ..good }),
        ("p_max", OccupancyParams { p_max: 0.5, ..good }),
        ("p_max", OccupancyParams { p_max: f64::NAN, ..good }),
        ("half_life", OccupancyParams { half_life: Some(0.0), ..good }),
        ("p_hit", OccupancyParams { model: InverseModelParams { p_hit: 2.0, ..good.model }, ..good }),
    ] {
        let error = OccupancyGrid::new(layout(), bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{error}");
    }
}

#[test]
fn missing_returns_free_the_space_up_to_the_limit() {
    let params = InverseModelParams { no_return: NoReturn::FreeUpTo(1.5), ..Default::default() };
    let mut map = EvidenceGrid::new(layout(), params).unwrap();
    let done = map.insert_scan(&scan(vec![f32::INFINITY; 20]), &Se2::default()).unwrap();
    assert_eq!((done.beams_used, done.hit_updates), (20, 0));
    assert!(map.evidence().iter().all(|&v| v <= 0));
    let cell = map.layout().cell_at(&Vector2::new(1.0 * 0.1_f64.cos(), 1.0 * 0.1_f64.sin())).unwrap();
    assert!(map.log_odds(cell).unwrap() < 0.0);
}

#[test]
fn a_live_grid_may_start_from_a_map() {
    let map = mapped(&vec![(scan(vec![1.04; 20]), Se2::default()); 50]);
    let live = OccupancyGrid::from_evidence(&map, OccupancyParams::default()).unwrap();
    let thresholds = OccupancyThresholds::default();
    assert!(live.states(&thresholds) == map.states(&thresholds));
    assert!(live.states(&thresholds).values().contains(&CellState::Occupied));
}

#[cfg(feature = "serde")]
#[test]
fn checkpoints_resume_to_the_bit() {
    let scans: Vec<(LaserScan, Se2)> =
        (0_u8..6).map(|i| (scan(vec![2.0 + f32::from(i); 18]), Se2::new(f64::from(i), 0.2, 0.4))).collect();
    let mut map = mapped(&scans[..3]);
    let mut live =
        OccupancyGrid::new(layout(), OccupancyParams { half_life: Some(1.0), ..Default::default() }).unwrap();
    live.insert_scan(&scans[0].0, &scans[0].1).unwrap();
    live.forget(0.3).unwrap();
    let mut restored: EvidenceGrid = serde_json::from_str(&serde_json::to_string(&map).unwrap()).unwrap();
    let mut live_restored: OccupancyGrid = serde_json::from_str(&serde_json::to_string(&live).unwrap()).unwrap();
    assert!(map == restored && live == live_restored);
    for (scan, pose) in &scans[3..] {
        map.insert_scan(scan, pose).unwrap();
        restored.insert_scan(scan, pose).unwrap();
        live.insert_scan(scan, pose).unwrap();
        live_restored.insert_scan(scan, pose).unwrap();
    }
    assert!(map == restored && live == live_restored);
    let broken = serde_json::to_string(&map).unwrap().replacen("\"width\":", "\"width\":1", 1);
    assert!(serde_json::from_str::<EvidenceGrid>(&broken).is_err());
}

#[test]
fn states_are_written_over_another_grid() {
    let thresholds = OccupancyThresholds::default();
    let mut states = Grid::filled(GridLayout::new(3, 3, 1.0, Se2::default()).unwrap(), CellState::Occupied);
    let mut live = OccupancyGrid::new(layout(), OccupancyParams::default()).unwrap();
    live.insert_scan(&scan(vec![1.04; 20]), &Se2::default()).unwrap();
    live.states_into(&thresholds, &mut states);
    assert_eq!(states, live.states(&thresholds));
    assert!(states.values().contains(&CellState::Occupied) && states.values().contains(&CellState::Free));
    let map = mapped(&[(scan(vec![9.0; 20]), Se2::default())]);
    map.states_into(&thresholds, &mut states);
    assert_eq!((states.layout(), states.values().len()), (&map.layout(), map.layout().len()));
    assert_eq!(states, map.states(&thresholds));
}
