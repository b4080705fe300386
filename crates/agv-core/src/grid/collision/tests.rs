use super::*;
use crate::{
    geometry::{LieGroup, Twist2, outline::edges},
    grid::{Cell, GridLayout},
};
use nalgebra::Vector2;
use proptest::prelude::*;

const RESOLUTION: f64 = 0.05;

fn any_map() -> impl Strategy<Value = Grid<CellState>> {
    let cell = prop_oneof![150 => Just(CellState::Free), 1 => Just(CellState::Occupied)];
    (prop::collection::vec(cell, 60 * 50), -3.0..3.0_f64).prop_map(|(states, yaw)| {
        Grid::new(GridLayout::new(60, 50, RESOLUTION, Se2::new(-0.3, 0.2, yaw)).unwrap(), states).unwrap()
    })
}

fn any_footprint() -> impl Strategy<Value = Footprint> {
    let l_shape = [(-0.3, -0.2), (0.4, -0.2), (0.4, 0.0), (0.0, 0.05), (-0.05, 0.3), (-0.3, 0.3)];
    let triangle = [(-0.1, 0.0), (0.5, -0.03), (0.5, 0.03)];
    prop_oneof![
        (0.01..0.6_f64).prop_map(|r| Footprint::circle(r).unwrap()),
        (0.05..0.4_f64, 0.05..0.3_f64).prop_map(|(x, r)| Footprint::two_circles(x, r, -0.1, 0.8 * r).unwrap()),
        Just(Footprint::segment(Vector2::new(-0.2, 0.1), Vector2::new(0.4, -0.05)).unwrap()),
        (0.02..0.6_f64, 0.02..0.5_f64).prop_map(|(l, w)| Footprint::rectangle(-0.3 * l, l, w).unwrap()),
        Just(Footprint::polygon(l_shape.map(|(x, y)| Vector2::new(x, y)).into()).unwrap()),
        Just(Footprint::polygon(triangle.map(|(x, y)| Vector2::new(x, y)).into()).unwrap()),
    ]
}

/// A pose, given in cells of the map.
fn pose_in(map: &Grid<CellState>, x: f64, y: f64, yaw: f64) -> Se2 {
    map.layout().map_from_grid().compose(&Se2::new(x * RESOLUTION, y * RESOLUTION, yaw))
}

/// Whether a dense sample of the footprint's points, shrunk or grown by a factor, falls into an obstacle.
fn sampled(map: &Grid<CellState>, footprint: &Footprint, pose: &Se2, outside: bool) -> bool {
    let r = footprint.circumscribed_radius();
    let steps = (2.0 * r / (0.2 * RESOLUTION)).ceil() as i32;
    (0..=steps).any(|i| {
        (0..=steps).any(|j| {
            let at = |k: i32| -r + 2.0 * r * f64::from(k) / f64::from(steps);
            let p = Vector2::new(at(i), at(j));
            footprint.contains(&p)
                && match map.layout().cell_at(&(*pose * p)).and_then(|c| map.get(c)) {
                    Some(state) => *state == CellState::Occupied,
                    None => outside,
                }
        })
    })
}

/// Whether any point of an obstacle cell, grown by `margin` metres, lies in the footprint, by sampling the cells, and
/// the outline too: the tip of a needle lies between the samples of a cell.
fn near(map: &Grid<CellState>, footprint: &Footprint, pose: &Se2, margin: f64, outside: bool) -> bool {
    let base_from_map = pose.inverse();
    let half = 0.5 * RESOLUTION + margin;
    let layout = map.layout();
    let span = 12;
    let cell_meets = |c: Cell| {
        let center = Vector2::new(f64::from(c.x) + 0.5, f64::from(c.y) + 0.5) * RESOLUTION;
        (0..=span).any(|i| {
            (0..=span).any(|j| {
                let offset = |k: i32| half * (2.0 * f64::from(k) / f64::from(span) - 1.0);
                let p = layout.map_from_grid() * (center + Vector2::new(offset(i), offset(j)));
                footprint.contains(&(base_from_map * p))
            })
        })
    };
    let outline = footprint.vertices().unwrap_or_default();
    let on_outline = edges(outline).flat_map(|(a, b)| (0..=2000).map(move |k| a + (b - a) * (f64::from(k) / 2000.0)));
    let tip_meets = |p: Vector2<f64>| {
        let p = layout.to_grid(&(*pose * p));
        let reach = margin / RESOLUTION;
        (-1..=1).any(|i| {
            (-1..=1).any(|j| {
                let near = Vector2::new(p.x + reach * f64::from(i), p.y + reach * f64::from(j));
                let cell = Cell::new(near.x.floor() as i32, near.y.floor() as i32);
                map.get(cell).map_or(outside, |s| *s == CellState::Occupied)
            })
        })
    };
    if on_outline.into_iter().any(tip_meets) {
        return true;
    }
    let (w, h) = (layout.width() as i32, layout.height() as i32);
    let border = 30;
    (-border..w + border).any(|x| {
        (-border..h + border).any(|y| {
            let c = Cell::new(x, y);
            let blocked = map.get(c).map_or(outside, |s| *s == CellState::Occupied);
            let reach = footprint.circumscribed_radius() + 2.0 * RESOLUTION + margin;
            blocked && (layout.center(c) - pose.translation()).norm() < reach && cell_meets(c)
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// What a dense sample of the footprint finds is found; what is found lies within a hair of the footprint.
    #[test]
    fn poses_agree_with_sampling(
        map in any_map(), footprint in any_footprint(), x in -5.0..65.0_f64, y in -5.0..55.0_f64, yaw in -3.2..3.2_f64, outside: bool,
    ) {
        let params = CollisionParams { unknown_is_obstacle: true, outside_is_obstacle: outside };
        let checker = CollisionChecker::new(&map, footprint.clone(), params).unwrap();
        let pose = pose_in(&map, x, y, yaw);
        if checker.collides(&pose).unwrap() {
            prop_assert!(near(&map, &footprint, &pose, 0.15 * RESOLUTION, outside), "nothing is there");
        } else {
            prop_assert!(!sampled(&map, &footprint, &pose, outside), "missed");
        }
    }

    /// A motion is free only if every pose on it is; it collides only if one grown by the margin does.
    #[test]
    fn motions_agree_with_many_poses(
        map in any_map(), footprint in any_footprint(), x in 5.0..55.0_f64, y in 5.0..45.0_f64, yaw in -3.2..3.2_f64,
        vx in -1.0..1.0_f64, vy in -0.3..0.3_f64, w in -2.0..2.0_f64, dt in 0.0..1.5_f64,
        margin in prop_oneof![Just(obstacle_map::MARGIN), 0.01..0.5_f64],
    ) {
        let checker = CollisionChecker::new(&map, footprint, CollisionParams::default()).unwrap();
        let (start, twist) = (pose_in(&map, x, y, yaw), Twist2::new(vx, vy, w));
        let poses: Vec<Se2> = (0..=400).map(|i| start.compose(&twist.integrate(dt * f64::from(i) / 400.0))).collect();
        let (obstacles, outline) = (checker.obstacles(), checker.footprint());
        let collides = obstacles.collides_along_within(outline, &start, &twist, dt, margin).unwrap();
        if margin == obstacle_map::MARGIN {
            prop_assert_eq!(checker.collides_along(&start, &twist, dt).unwrap(), collides);
        }
        if collides {
            prop_assert!(poses.iter().any(|pose| obstacles.touches(outline, pose, 2.0 * margin + 0.05)), "nothing is there");
        } else {
            prop_assert!(!poses.iter().any(|pose| checker.obstacles().touches(checker.footprint(), pose, 0.0)), "missed");
        }
        let end = start.compose(&twist.integrate(dt));
        prop_assert!(checker.collides_between(&start, &end).unwrap() || !checker.collides(&end).unwrap());
    }
}

#[test]
fn nothing_thin_is_jumped_over() {
    let mut map = Grid::filled(GridLayout::new(400, 40, RESOLUTION, Se2::default()).unwrap(), CellState::Free);
    map.set(Cell::new(200, 20), CellState::Occupied);
    let needle = Footprint::circle(0.001).unwrap();
    let checker = CollisionChecker::new(&map, needle, CollisionParams::default()).unwrap();
    let start = Se2::new(1.0, 20.5 * RESOLUTION, 0.0);
    assert!(checker.collides_along(&start, &Twist2::new(1000.0, 0.0, 0.0), 0.0185).unwrap());
    assert!(!checker.collides_along(&start, &Twist2::new(1.0, 0.0, 0.0), 8.9).unwrap());
}

#[test]
fn threads_share_a_checker_and_a_load_changes_the_outline() {
    let mut map = Grid::filled(GridLayout::new(100, 60, RESOLUTION, Se2::default()).unwrap(), CellState::Free);
    map.set(Cell::new(50, 30), CellState::Occupied);
    let empty = Footprint::rectangle(-0.3, 0.3, 0.3).unwrap();
    let mut checker = CollisionChecker::new(&map, empty.clone(), CollisionParams::default()).unwrap();
    let poses: Vec<Se2> = (0..200).map(|i| Se2::new(0.5 + 0.02 * f64::from(i), 1.25, 0.1 * f64::from(i))).collect();
    let count = |checker: &CollisionChecker| poses.iter().filter(|p| checker.collides(p).unwrap()).count();
    let alone = count(&checker);
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..3).map(|_| scope.spawn(|| count(&checker))).collect();
        for thread in threads {
            assert_eq!(thread.join().unwrap(), alone);
        }
    });
    let many = (0..40).map(|i| f64::from(i) * 0.157).map(|a| 0.5 * Vector2::new(a.cos(), a.sin())).collect();
    for loaded in [Footprint::rectangle(-0.3, 0.5, 0.8).unwrap(), Footprint::polygon(many).unwrap()] {
        checker.set_footprint(loaded.clone());
        let anew = CollisionChecker::new(&map, loaded, CollisionParams::default()).unwrap();
        assert_eq!(count(&checker), count(&anew));
        assert!(count(&checker) > alone);
    }
    checker.set_footprint(empty);
    assert_eq!(count(&checker), alone);
}

#[test]
fn bad_input_is_named() {
    let map = Grid::filled(GridLayout::new(40, 40, RESOLUTION, Se2::default()).unwrap(), CellState::Free);
    let checker = CollisionChecker::new(&map, Footprint::circle(0.1).unwrap(), CollisionParams::default()).unwrap();
    let (here, still) = (Se2::new(1.0, 1.0, 0.0), Twist2::ZERO);
    assert!(checker.collides(&Se2::new(f64::NAN, 0.0, 0.0)).is_err());
    assert!(checker.collides(&Se2::new(1e300, 0.0, 0.0)).is_err());
    assert!(checker.collides_along(&here, &Twist2::new(f64::NAN, 0.0, 0.0), 1.0).is_err());
    assert!(checker.collides_along(&here, &Twist2::new(1e9, 0.0, 0.0), 1.0).is_err());
    assert!(checker.collides_along(&here, &still, -1.0).is_err());
    for margin in [0.0, -0.1, 1.1, f64::NAN] {
        assert!(checker.obstacles().collides_along_within(checker.footprint(), &here, &still, 1.0, margin).is_err());
    }
    assert!(checker.collides_along(&here, &still, f64::NAN).is_err());
    assert!(checker.collides_between(&here, &Se2::new(0.0, f64::INFINITY, 0.0)).is_err());
    assert_eq!(checker.collides_along(&here, &still, 1.0), Ok(false));
}

#[test]
fn a_margin_grows_the_outline() {
    let layout = GridLayout::new(100, 40, 0.05, Se2::default()).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    map.set(Cell::new(60, 20), CellState::Occupied);
    let obstacles = ObstacleMap::new(&map, CollisionParams::default(), None).unwrap();
    // The cell's edge is at 3 m: 0.12 m, or 2.4 cells, before the outlines.
    for outline in [Footprint::circle(0.3).unwrap(), Footprint::rectangle(-0.3, 0.3, 0.4).unwrap()] {
        let pose = Se2::new(2.58, 1.025, 0.0);
        let within = |margin: f64| obstacles.collides_within(&outline, &pose, margin);
        assert_eq!([0.0, 2.3, 2.5].map(within), [Ok(false), Ok(false), Ok(true)]);
        assert!([-1.0, f64::NAN, f64::INFINITY].into_iter().all(|bad| within(bad).is_err()));
    }
}
