use super::*;
use proptest::prelude::*;

const RESOLUTION: f64 = 0.05;

fn map_of(width: usize, height: usize, yaw: f64, states: Vec<CellState>) -> Grid<CellState> {
    Grid::new(GridLayout::new(width, height, RESOLUTION, Se2::new(-0.4, 0.3, yaw)).unwrap(), states).unwrap()
}

fn any_map() -> impl Strategy<Value = Grid<CellState>> {
    (1_usize..50, 1_usize..50, 0.0..1.0_f64, -3.2..3.2_f64).prop_flat_map(|(width, height, fill, yaw)| {
        let cell = (0.0..1.0_f64).prop_map(move |u| match u {
            u if u < fill.powi(5) => CellState::Occupied,
            u if u > 0.99 => CellState::Unknown,
            _ => CellState::Free,
        });
        prop::collection::vec(cell, width * height).prop_map(move |states| map_of(width, height, yaw, states))
    })
}

/// Rays from within and around the map; some along the axes and diagonals, some from lines and corners between cells.
fn any_ray() -> impl Strategy<Value = (Vector2<f64>, f64, f64)> {
    let start = prop_oneof![-20.0..70.0_f64, (-20_i32..70).prop_map(f64::from)];
    let angle =
        prop_oneof![4 => -3.2..3.2_f64, 1 => (-8_i32..9).prop_map(|i| f64::from(i) * std::f64::consts::FRAC_PI_4)];
    (start.clone(), start, angle, 0.0..6.0_f64).prop_map(|(x, y, angle, range)| (Vector2::new(x, y), angle, range))
}

/// The ray in the map frame of one that is given in cells of the grid.
fn to_map(map: &Grid<CellState>, start: &Vector2<f64>, angle: f64) -> (Vector2<f64>, f64) {
    (map.layout().to_map(start), angle + map.layout().map_from_grid().yaw())
}

/// Range at which a ray meets a square cell that is grown by `margin` cells (slab test), in cells.
fn slab(start: &Vector2<f64>, angle: f64, cell: Cell, margin: f64) -> Option<f64> {
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for (s, d, c) in [(start.x, angle.cos(), cell.x), (start.y, angle.sin(), cell.y)] {
        let (low, high) = (f64::from(c) - margin, f64::from(c) + 1.0 + margin);
        if d.abs() < 1e-15 {
            if s < low || s > high {
                return None;
            }
        } else {
            let (a, b) = ((low - s) / d, (high - s) / d);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
    }
    (enter <= leave).then_some(enter)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    /// No obstacle that the ray meets by more than a hair lies before the hit, and the hit is met but for a hair.
    #[test]
    fn exact_casting_agrees_with_geometry(map in any_map(), (start, angle, range) in any_ray()) {
        let caster = RayCaster::new(&map, RayCastParams::default()).unwrap();
        let (origin, heading) = to_map(&map, &start, angle);
        let hit = caster.cast_exact(&origin, heading, range);
        let layout = map.layout();
        let first = |margin: f64| {
            (0..layout.len())
                .filter(|&i| map.values()[i] == CellState::Occupied)
                .filter_map(|i| slab(&start, angle, layout.cell(i), margin))
                .fold(f64::INFINITY, f64::min) * RESOLUTION
        };
        let (early, late) = (first(1e-6) - 1e-6, first(-1e-6) + 1e-6);
        match hit {
            Some(hit) => {
                prop_assert!(hit.range >= early && hit.range <= late, "{hit:?} not in {early}..{late}");
                prop_assert_eq!(map.get(hit.cell), Some(&CellState::Occupied));
                let entry = slab(&start, angle, hit.cell, 1e-6).unwrap() * RESOLUTION;
                prop_assert!((entry - hit.range).abs() < 1e-4, "{hit:?} entered at {entry}");
            }
            None => prop_assert!(late > range, "missed an obstacle at {late}"),
        }
    }

    #[test]
    fn skipping_changes_nothing(map in any_map(), rays in prop::collection::vec(any_ray(), 60), unknown_is_obstacle: bool) {
        let caster = RayCaster::new(&map, RayCastParams { unknown_is_obstacle }).unwrap();
        for (start, angle, range) in rays {
            let (origin, heading) = to_map(&map, &start, angle);
            prop_assert_eq!(caster.cast(&origin, heading, range), caster.cast_exact(&origin, heading, range));
        }
    }

    #[test]
    fn scans_are_many_casts(map in any_map(), (start, angle, range) in any_ray(), threads in 1_usize..5) {
        let caster = RayCaster::new(&map, RayCastParams::default()).unwrap();
        let (origin, heading) = to_map(&map, &start, angle);
        let angles: Vec<f64> = (0..700).map(|i| f64::from(i) * 0.009).collect();
        let directions: Vec<_> = angles.iter().map(|a| Vector2::new(a.cos(), a.sin())).collect();
        let pose = Se2::new(origin.x, origin.y, heading);
        let (mut ranges, mut seq) = (vec![0.0; 700], vec![0.0; 700]);
        caster.cast_into(&pose, &directions, range, &mut ranges, Par::threads(threads));
        caster.cast_into(&pose, &directions, range, &mut seq, Par::Seq);
        prop_assert_eq!(&ranges, &seq);
        prop_assert!(ranges.iter().all(|&r| r >= 0.0 && (f64::from(r) <= range * (1.0 + 1e-6) || r == f32::INFINITY)));
    }
}

fn open_map() -> Grid<CellState> {
    let mut map = map_of(30, 20, 0.0, vec![CellState::Free; 600]);
    map.set(Cell::new(20, 10), CellState::Occupied);
    map.set(Cell::new(15, 10), CellState::Unknown);
    map
}

#[test]
fn the_semantics_are_as_documented() {
    let map = open_map();
    let caster = RayCaster::new(&map, RayCastParams::default()).unwrap();
    let at = |x: f64, y: f64| map.layout().to_map(&Vector2::new(x, y));
    let range = |x, y, angle, max| caster.cast(&at(x, y), angle, max).map(|h| (h.range * 1e9).round() / 1e9);
    assert_eq!(range(10.0, 10.5, 0.0, 5.0), Some(0.5), "unknown cells are looked through");
    assert_eq!(range(10.0, 10.5, 0.0, 0.4999), None, "beyond the range");
    assert_eq!(range(20.5, 10.5, 1.0, 5.0), Some(0.0), "the ray starts in an obstacle");
    assert_eq!(range(-10.0, 10.5, 0.0, 5.0), Some(1.5), "the ray comes from outside");
    assert_eq!(range(-10.0, 10.5, std::f64::consts::PI, 5.0), None, "the ray goes away from the map");
    assert_eq!(range(10.0, 12.5, 0.0, f64::INFINITY), None, "the ray leaves the map");
    let strict = RayCaster::new(&map, RayCastParams { unknown_is_obstacle: true }).unwrap();
    assert_eq!(strict.cast(&at(10.0, 10.5), 0.0, 5.0).map(|h| h.cell), Some(Cell::new(15, 10)));
}

#[test]
fn bad_rays_hit_nothing() {
    let caster = RayCaster::new(&open_map(), RayCastParams::default()).unwrap();
    let nan = f64::NAN;
    for (x, y, angle, range) in [
        (nan, 0.0, 0.0, 1.0),
        (0.0, f64::INFINITY, 0.0, 1.0),
        (0.0, 0.5, nan, 1.0),
        (0.0, 0.5, f64::INFINITY, 1.0),
        (0.0, 0.5, 0.0, nan),
        (0.0, 0.5, 0.0, -1.0),
        (1e300, -1e300, 2.0, 1e300),
        (-1e6, 0.5, 0.0, 1e300),
    ] {
        let cast = caster.cast(&Vector2::new(x, y), angle, range);
        assert_eq!(cast, caster.cast_exact(&Vector2::new(x, y), angle, range));
        assert!(cast.is_none_or(|hit| hit.range.is_finite()), "{cast:?}");
    }
    let mut ranges = [0.0_f32; 2];
    caster.cast_into(&Se2::default(), &[Vector2::new(nan, 0.0), Vector2::zeros()], 1.0, &mut ranges, Par::Seq);
    assert_eq!(ranges, [f32::INFINITY; 2]);
}
