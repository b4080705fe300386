use super::*;
use crate::{
    grid::{Cell, InflationParams, cost},
    sensors::{Beam, ScanGeometry},
};
use nalgebra::Vector2;
use proptest::prelude::*;

const RESOLUTION: f64 = 0.1;

fn params() -> RollingParams {
    RollingParams {
        width: 60,
        height: 50,
        resolution: RESOLUTION,
        misses_to_clear: 1,
        inflation: None,
        ..Default::default()
    }
}

fn rolling(params: RollingParams) -> RollingCostmap {
    RollingCostmap::new(params).unwrap()
}

/// Beams all around, of 4 m.
fn scan(seconds: f64, ranges: &[f32]) -> LaserScan {
    let increment = std::f64::consts::TAU / ranges.len().max(1) as f64;
    let geometry = ScanGeometry {
        angle_min: -3.1,
        angle_increment: increment,
        range_min: 0.05,
        range_max: 4.0,
        base_from_sensor: Se2::new(0.2, 0.1, 0.3),
        ..Default::default()
    };
    LaserScan::new(Stamp::from_seconds(seconds), geometry, ranges.to_vec()).unwrap()
}

/// A scan of one beam ahead from the base's origin.
fn beam(seconds: f64, range: f32) -> LaserScan {
    let geometry = ScanGeometry { angle_min: 0.0, range_max: 4.0, ..Default::default() };
    LaserScan::new(Stamp::from_seconds(seconds), geometry, vec![range]).unwrap()
}

fn state(rolling: &RollingCostmap, x: f64, y: f64) -> CellState {
    let cell = rolling.layout().cell_at(&Vector2::new(x, y)).unwrap();
    *rolling.states().get(cell).unwrap()
}

fn any_ranges() -> impl Strategy<Value = Vec<f32>> {
    let range = prop_oneof![8 => 0.1..4.5_f32, 1 => Just(f32::INFINITY), 1 => Just(f32::NAN)];
    prop::collection::vec(range, 1..90)
}

fn any_pose() -> impl Strategy<Value = Se2> {
    (-9.0..9.0_f64, -9.0..9.0_f64, -3.2..3.2_f64).prop_map(|(x, y, yaw)| Se2::new(x, y, yaw))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// Where a beam ends is marked; where any passes, and none ends, is free; all else is unknown. By the exact traversal of
    /// every beam, clipped to nothing but the window.
    #[test]
    fn what_is_seen_is_marked_and_what_is_seen_through_is_free(ranges in any_ranges(), pose in any_pose()) {
        let (mut rolling, scan) = (rolling(params()), scan(0.0, &ranges));
        rolling.update([&scan], &pose).unwrap();
        let layout = *rolling.layout();
        let sensor = pose * scan.geometry().base_from_sensor;
        let mut expected = vec![CellState::Unknown; layout.len()];
        for pass in [CellState::Free, CellState::Occupied] {
            for (angle, beam) in scan.beams() {
                let (range, hit) = match beam {
                    Beam::Hit(range) => (range, true),
                    Beam::NoReturn => (4.0, false),
                    Beam::Invalid => continue,
                };
                let end = sensor * (Vector2::new(angle.cos(), angle.sin()) * range);
                let cells: Vec<Cell> =
                    Traversal::new(&layout.to_grid(&sensor.translation()), &layout.to_grid(&end)).unwrap().collect();
                let (last, before) = cells.split_last().unwrap();
                for &cell in if pass == CellState::Free { before } else if hit { std::slice::from_ref(last) } else { &[] } {
                    if let Some(index) = layout.index(cell) {
                        expected[index] = pass;
                    }
                }
            }
        }
        let wrong = expected.iter().zip(rolling.states().values()).filter(|(a, b)| a != b).count();
        // An end within rounding of a grid line, or a beam cut short at the window's edge.
        prop_assert!(wrong <= 2, "{} cells differ", wrong);
    }

    /// Driving about loses nothing that stays inside, and shows nothing that came in.
    #[test]
    fn moving_keeps_what_stays_inside(ranges in any_ranges(), poses in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64), 1..8)) {
        let mut moved = rolling(RollingParams { forget_after: None, ..params() });
        moved.update([&scan(0.0, &ranges)], &Se2::new(0.05, 0.05, 0.0)).unwrap();
        let before = moved.clone();
        let (mut x, mut y, mut inside) = (0.05, 0.05, vec![true; before.layout().len()]);
        for (dx, dy) in poses {
            (x, y) = (x + dx, y + dy);
            moved.update([], &Se2::new(x, y, 1.0)).unwrap();
            for (index, inside) in inside.iter_mut().enumerate() {
                let center = before.layout().center(before.layout().cell(index));
                *inside &= moved.layout().cell_at(&center).is_some();
            }
            let middle = moved.layout().cell_at(&Vector2::new(x, y));
            prop_assert_eq!(middle, Some(Cell::new(30, 25)));
        }
        for (index, &now) in moved.states().values().iter().enumerate() {
            let center = moved.layout().center(moved.layout().cell(index));
            let then = before.layout().cell_at(&center).and_then(|cell| before.layout().index(cell)).filter(|&i| inside[i]);
            prop_assert_eq!(now, then.map_or(CellState::Unknown, |i| before.states().values()[i]));
        }
        prop_assert_eq!(moved.costmap(), &Costmap::from_map(moved.states()));
    }

    /// The scans of one update are taken together: their order does not matter.
    #[test]
    fn lasers_may_come_in_any_order(a in any_ranges(), b in any_ranges(), pose in any_pose()) {
        let (a, b) = (scan(0.0, &a), scan(0.0, &b));
        let (mut one, mut other) = (rolling(params()), rolling(params()));
        one.update([&a, &b], &pose).unwrap();
        other.update([&b, &a], &pose).unwrap();
        prop_assert_eq!(one.costmap(), other.costmap());
    }

    #[test]
    fn inflation_is_that_of_the_states(ranges in any_ranges(), pose in any_pose()) {
        let inflation = InflationParams::default();
        let mut inflated = rolling(RollingParams { inflation: Some(inflation), ..params() });
        inflated.update([&scan(0.0, &ranges)], &pose).unwrap();
        let expected = Inflation::new(inflation).unwrap().inflate(inflated.states()).unwrap();
        prop_assert_eq!(inflated.costmap(), &expected);
    }
}

#[test]
fn a_mark_outlives_as_many_misses_as_it_has() {
    let mut rolling = rolling(RollingParams { misses_to_clear: 3, ..params() });
    let (near, far) = (beam(0.0, 1.05), beam(0.0, 3.05));
    let mut see = |scan: &LaserScan| {
        rolling.update([scan], &Se2::default()).unwrap();
        state(&rolling, 1.05, 0.0)
    };
    assert_eq!(see(&near), CellState::Occupied);
    assert_eq!([see(&far), see(&far)], [CellState::Occupied; 2]);
    // Hit again, it has all its misses again.
    see(&near);
    assert_eq!([see(&far), see(&far), see(&far)], [CellState::Occupied, CellState::Occupied, CellState::Free]);
}

#[test]
fn marks_are_forgotten_in_time_and_free_space_is_not() {
    let mut rolling = rolling(RollingParams { forget_after: Some(8.0), ..params() });
    rolling.update([&beam(100.0, 1.05)], &Se2::default()).unwrap();
    let away = Se2::new(0.0, 0.0, 2.0);
    rolling.update([&beam(107.9, 1.05)], &away).unwrap();
    assert_eq!(state(&rolling, 1.05, 0.0), CellState::Occupied);
    rolling.update([&beam(50.0, 1.05)], &away).unwrap(); // late: no time passes
    rolling.update([&beam(108.6, 1.05)], &away).unwrap();
    assert_eq!([state(&rolling, 1.05, 0.0), state(&rolling, 0.55, 0.0)], [CellState::Unknown, CellState::Free]);
}

#[test]
fn ranges_and_no_returns_are_taken_as_told() {
    let mut capped = rolling(RollingParams { mark_range: Some(2.0), clear_range: Some(1.0), ..params() });
    capped.update([&beam(0.0, 2.55)], &Se2::default()).unwrap();
    assert_eq!(
        [0.85, 1.25, 2.55].map(|x| state(&capped, x, 0.0)),
        [CellState::Free, CellState::Unknown, CellState::Unknown]
    );
    capped.update([&beam(0.0, 1.95)], &Se2::default()).unwrap();
    assert_eq!([1.25, 1.95].map(|x| state(&capped, x, 0.0)), [CellState::Free, CellState::Occupied]);

    for (no_return_clears, expected) in [(true, CellState::Free), (false, CellState::Unknown)] {
        let mut rolling = rolling(RollingParams { no_return_clears, ..params() });
        let done = rolling.update([&beam(0.0, f32::INFINITY)], &Se2::default()).unwrap();
        assert_eq!((done.beams_used, done.beams_skipped), if no_return_clears { (1, 0) } else { (0, 1) });
        // To the window's edge, which the scanner looks beyond.
        assert_eq!([0.0, 2.0, 2.95].map(|x| state(&rolling, x, 0.0)), [expected; 3]);
    }
}

#[test]
fn the_vehicle_does_not_see_itself() {
    let footprint = Footprint::rectangle(-0.3, 0.5, 0.6).unwrap();
    let mut rolling = rolling(RollingParams { keep_unknown: true, ..params() }).with_footprint(footprint);
    let done = rolling.update([&beam(0.0, 0.45)], &Se2::default()).unwrap();
    assert_eq!((done.beams_used, done.beams_skipped), (0, 1));
    assert_eq!(
        [0.45, -0.25, 0.65].map(|x| state(&rolling, x, 0.0)),
        [CellState::Free, CellState::Free, CellState::Unknown]
    );
    // A mark that it drives onto is gone; one that it has in sight is not.
    rolling.update([&beam(0.0, 0.75)], &Se2::default()).unwrap();
    rolling.update([&beam(0.1, 0.55)], &Se2::new(0.4, 0.0, 0.0)).unwrap();
    assert_eq!([0.75, 0.95].map(|x| state(&rolling, x, 0.0)), [CellState::Free, CellState::Occupied]);
}

#[test]
fn what_moves_clears_but_does_not_mark() {
    let mut rolling = rolling(params());
    rolling.update([&beam(0.0, 1.55)], &Se2::default()).unwrap();
    rolling.update_where([&beam(0.05, 1.55)], &Se2::default(), |scan, beam| (scan, beam) != (0, 0)).unwrap();
    assert_eq!([1.25, 1.55].map(|x| state(&rolling, x, 0.0)), [CellState::Free; 2]);
}

#[test]
fn a_static_map_shows_where_nothing_was_seen() {
    use CellState::{Free, Occupied, Unknown};
    let layout = GridLayout::new(80, 40, 0.05, Se2::new(1.0, -1.0, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for y in 0..40 {
        map.set(Cell::new(31, y), CellState::Occupied); // x from 2.55 to 2.6
    }
    let mut rolling = rolling(params()).with_static_map(map).unwrap();
    let at = |rolling: &RollingCostmap, x: f64| state(rolling, x, 0.55);
    assert_eq!([0.5, 1.5, 2.55].map(|x| at(&rolling, x)), [Unknown, Free, Occupied]);
    // It comes in with the window as well, and is not seen through; what it does not show is marked.
    rolling.update([&beam(0.0, 3.05)], &Se2::new(1.75, 0.55, 0.0)).unwrap();
    assert_eq!([0.5, 1.5, 2.55, 2.65, 4.55].map(|x| at(&rolling, x)), [Unknown, Free, Occupied, Free, Free]);
    rolling.update([&beam(0.0, 0.5)], &Se2::new(1.75, 0.55, 0.0)).unwrap();
    assert_eq!(at(&rolling, 2.25), Occupied);
    rolling.update([], &Se2::new(-40.0, 0.55, 0.0)).unwrap();
    rolling.update([], &Se2::new(1.75, 0.55, 0.0)).unwrap();
    assert_eq!([2.25, 2.55].map(|x| at(&rolling, x)), [Free, Occupied]);
}

#[test]
fn unknown_cells_may_be_taken_as_free() {
    let mut rolling = rolling(RollingParams { keep_unknown: false, ..params() });
    rolling.update([&beam(0.0, 1.05)], &Se2::default()).unwrap();
    let mut costs = rolling.costmap().costs().to_vec();
    costs.sort_unstable();
    assert_eq!((costs.pop(), costs.pop()), (Some(cost::LETHAL), Some(cost::FREE)));
}

#[test]
fn an_update_without_news_leaves_the_revision() {
    let mut rolling = rolling(params());
    let scan = scan(0.0, &[1.0, 2.0, 3.0]);
    assert!(rolling.update([&scan], &Se2::default()).unwrap().changed);
    let seen = rolling.costmap().revision().clone();
    let again = rolling.update([&scan], &Se2::default()).unwrap();
    assert_eq!((again.moved, again.changed, rolling.costmap().revision() == &seen), (false, false, true));
    rolling.reset().unwrap();
    assert!(rolling.costmap().costs().iter().all(|&c| c == cost::UNKNOWN) && rolling.costmap().revision() != &seen);
}

#[test]
fn bad_parameters_are_named() {
    let good = params();
    for (name, bad) in [
        ("grid", RollingParams { width: 0, ..good }),
        ("grid", RollingParams { width: usize::MAX, ..good }),
        ("resolution", RollingParams { resolution: f64::NAN, ..good }),
        ("mark_range", RollingParams { mark_range: Some(0.0), ..good }),
        ("clear_range", RollingParams { clear_range: Some(f64::NAN), ..good }),
        ("forget_after", RollingParams { forget_after: Some(-1.0), ..good }),
        ("misses_to_clear", RollingParams { misses_to_clear: 0, ..good }),
        ("misses_to_clear", RollingParams { misses_to_clear: 201, ..good }),
        (
            "inflation_radius",
            RollingParams { inflation: Some(InflationParams { inflation_radius: 1e6, ..Default::default() }), ..good },
        ),
    ] {
        let error = RollingCostmap::new(bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
}

#[test]
fn bad_updates_change_nothing() {
    let mut rolling = rolling(params());
    let good = scan(0.0, &[1.0, 2.0]);
    rolling.update([&good], &Se2::default()).unwrap();
    let before = rolling.costmap().clone();
    for bad in [f64::NAN, f64::INFINITY, 1e12, -1e300] {
        assert!(rolling.update([&good], &Se2::new(bad, 0.0, 0.0)).is_err(), "{bad}");
        assert!(rolling.update([&good], &Se2::new(0.0, bad, 0.0)).is_err(), "{bad}");
    }
    assert!(rolling.update([&good], &Se2::new(0.0, 0.0, f64::NAN)).is_err());
    // A scan without readings, one without a valid reading, and one from a mount that cannot be.
    let nan = scan(0.0, &[f32::NAN, -1.0, f32::NEG_INFINITY]);
    let geometry = ScanGeometry { base_from_sensor: Se2::new(1e300, 0.0, 0.0), ..Default::default() };
    let absurd = LaserScan::new(Stamp::default(), geometry, vec![1.0]).unwrap();
    let done = rolling.update([&scan(0.0, &[]), &nan, &absurd], &Se2::default()).unwrap();
    assert_eq!(done, RollingUpdate { beams_skipped: 4, ..Default::default() });
    assert_eq!(rolling.costmap(), &before);
    // Ranges beyond all measure end at the window's edge.
    let geometry = ScanGeometry { range_max: 1e300, ..Default::default() };
    let long = LaserScan::new(Stamp::default(), geometry, vec![f32::MAX, f32::INFINITY]).unwrap();
    assert_eq!(rolling.update([&long], &Se2::default()).unwrap().beams_used, 2);
}

#[cfg(feature = "serde")]
#[test]
fn a_stored_costmap_goes_on_as_if_it_had_not_been() {
    let map = Grid::filled(GridLayout::new(30, 30, 0.2, Se2::new(-1.0, 0.0, 0.3)).unwrap(), CellState::Free);
    let footprint = Footprint::circle(0.3).unwrap();
    let mut rolling = rolling(params()).with_footprint(footprint).with_static_map(map).unwrap();
    rolling.update([&scan(0.0, &[1.0, 2.0, 3.0])], &Se2::new(1.0, 2.0, 0.5)).unwrap();
    let text = serde_json::to_string(&rolling).unwrap();
    let mut loaded: RollingCostmap = serde_json::from_str(&text).unwrap();
    assert_eq!(loaded.costmap(), rolling.costmap());
    for seconds in [20.0, 31.0] {
        let next = scan(seconds, &[2.5, 1.0]);
        for costmap in [&mut rolling, &mut loaded] {
            costmap.update([&next], &Se2::new(1.2, 2.0, 0.7)).unwrap();
        }
        assert_eq!(loaded.costmap(), rolling.costmap());
    }
    assert!(
        serde_json::from_str::<RollingCostmap>(&text.replace("\"misses_to_clear\":1", "\"misses_to_clear\":0"))
            .is_err()
    );
}
