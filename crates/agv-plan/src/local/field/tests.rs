use super::*;
use agv_core::{
    geometry::Se2,
    grid::{CellState, Costmap, Grid, LocalMapParams},
};
use proptest::prelude::*;

fn hall(yaw: f64, wall: impl Fn(i32, i32) -> bool) -> LocalMap {
    let layout = GridLayout::new(160, 120, 0.05, Se2::new(-1.0, -3.0, yaw)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for index in 0..layout.len() {
        let cell = layout.cell(index);
        if wall(cell.x, cell.y) {
            map.set(cell, CellState::Occupied);
        }
    }
    LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// On free ground the values are distances, and the descent points at the target, in any direction.
    #[test]
    fn free_ground_is_as_the_crow_flies(x in -0.5..6.5_f64, y in -2.5..2.5_f64, tx in 0.0..6.0_f64, ty in -2.0..2.0_f64) {
        let map = hall(0.0, |_, _| false);
        let mut field = NavigationField::new(FieldParams::default()).unwrap();
        field.set_map(&map, 0.2);
        let (from, to) = (Vector2::new(x, y), Vector2::new(tx, ty));
        prop_assume!((to - from).norm() > 0.6);
        prop_assert!(field.compute(&to, &from, 1.0));
        let distance = (to - from).norm();
        prop_assert!((f64::from(field.value_at(&from)) - distance).abs() < 0.03 * distance + 0.06);
        let down = field.descent(&from).unwrap();
        prop_assert!(down.dot(&((to - from) / distance)) > 0.97, "{down}");
        let local = field.origin_of(&from).unwrap();
        let (value, axes) = field.local_value(&local, 0.0, 0.0);
        prop_assert!((value - field.value_at(&from)).abs() < 1e-3);
        prop_assert!(f64::from(axes[0]) * down.x + f64::from(axes[1]) * down.y > 0.97);
    }
}

#[test]
fn the_way_leads_out_of_a_pocket() {
    // A pocket, open to the left, between the vehicle and its target.
    let map = hall(0.4, |x, y| (x == 90 && (30..=90).contains(&y)) || ((60..=90).contains(&x) && (y == 30 || y == 90)));
    let layout = *map.layout();
    let mut field = NavigationField::new(FieldParams::default()).unwrap();
    field.set_map(&map, 0.2);
    let at = |x: i32, y: i32| layout.center(Cell::new(x, y));
    let (inside, target) = (at(80, 60), at(120, 60));
    assert!(field.compute(&target, &inside, 1.0));
    field.trace(&inside);
    let way = field.way().to_vec();
    assert!((way[way.len() - 1] - target).norm() < 0.2, "{way:?}");
    for point in &way {
        assert!(map.distance_at(point).unwrap().0 > 0.15, "{point}");
    }
    // Remembered, it stays the way although the other one is a little shorter now.
    let side = layout.to_grid(&way[way.len() / 2]).y > 60.0;
    let nudged = at(80, if side { 57 } else { 63 });
    field.set_map(&map, 0.2);
    assert!(field.compute(&target, &nudged, 1.0));
    field.trace(&nudged);
    let middle = field.way()[field.way().len() / 2];
    assert_eq!(layout.to_grid(&middle).y > 60.0, side);
}

#[test]
fn what_is_walled_in_has_no_way() {
    let map = hall(0.0, |x, _| x == 80);
    let mut field = NavigationField::new(FieldParams::default()).unwrap();
    assert!(!field.compute(&Vector2::zeros(), &Vector2::zeros(), 1.0), "no map yet");
    field.set_map(&map, 0.2);
    assert!(!field.compute(&Vector2::new(6.0, 0.0), &Vector2::zeros(), 1.0));
    assert!(!field.compute(&Vector2::new(60.0, 0.0), &Vector2::zeros(), 1.0), "off the map");
    assert!(field.value_at(&Vector2::zeros()).is_infinite() && field.descent(&Vector2::zeros()).is_none());
}

#[test]
fn bad_parameters_are_refused() {
    let good = FieldParams::default();
    for bad in [-1.0, f64::NAN] {
        for params in [
            FieldParams { resolution: bad, ..good },
            FieldParams { nearness: bad, ..good },
            FieldParams { room: bad, ..good },
            FieldParams { loyalty: bad, ..good },
        ] {
            assert!(NavigationField::new(params).is_err(), "{params:?}");
        }
    }
}
