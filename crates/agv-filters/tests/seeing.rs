//! What the vehicle sees, end to end: the rolling costmap keeps what stands and forgets what has gone, in simulated worlds.

use agv_core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    grid::{CellState, Footprint, RollingCostmap, RollingParams},
    nalgebra::Vector2,
    sensors::ScanGeometry,
    time::Stamp,
};
use agv_filters::tracking::{ObstacleTracker, TrackerParams};
use agv_sim::{KeyFrame, Laser, LaserParams, MovingDisc, Populated, Shape, World2d};

fn laser(seed: u64) -> Laser {
    let geometry =
        ScanGeometry { range_max: 10.0, base_from_sensor: Se2::new(0.2, 0.0, 0.0), ..ScanGeometry::default() };
    let params = LaserParams { geometry, ..LaserParams::default() }.with_beams(720, 270_f64.to_radians());
    Laser::new(params, Seed(seed)).unwrap()
}

/// Poles of 0.075 m radius on a lattice; the vehicle drives among them. A pole flickers when no cell that it touches is marked
/// although it was hit within the last quarter of a second. Returns how often that is so, of how many looks, and how many marked
/// cells became free in all.
fn flickers(misses_to_clear: u8) -> (usize, usize, usize) {
    let poles: Vec<Vector2<f64>> =
        (0..40).map(|i| Vector2::new(1.3 * f64::from(i % 8) + 0.21, 1.7 * f64::from(i / 8) - 3.4)).collect();
    let world = World2d::new(poles.iter().map(|&center| Shape::Circle { center, radius: 0.075 }).collect()).unwrap();
    let footprint = Footprint::rectangle(-0.254, 0.254, 0.43).unwrap();
    let params = RollingParams { misses_to_clear, inflation: None, ..RollingParams::default() };
    let mut rolling = RollingCostmap::new(params).unwrap().with_footprint(footprint);
    let (mut laser, mut pose, twist) = (laser(1), Se2::new(-1.0, 0.2, 0.0), Twist2::new(1.0, 0.0, 0.12));
    let mut last_hit = vec![usize::MAX; poles.len()];
    let (mut gone, mut looks, mut lost_cells, mut before) = (0, 0, 0, rolling.clone());
    for step in 0..160 {
        let scan = laser.scan(&world, &pose, &twist, Stamp::from_seconds(0.05 * step as f64)).unwrap();
        rolling.update([scan], &pose).unwrap();
        lost_cells += (0..before.layout().len())
            .filter(|&i| before.states().values()[i] == CellState::Occupied)
            .filter_map(|i| rolling.layout().cell_at(&before.layout().center(before.layout().cell(i))))
            .filter(|cell| rolling.states().get(*cell) == Some(&CellState::Free))
            .count();
        before = rolling.clone();
        let hits: Vec<Vector2<f64>> = scan.points_in_base().map(|p| pose * p).collect();
        for (pole, last) in poles.iter().zip(&mut last_hit) {
            if hits.iter().any(|p| (p - pole).norm() < 0.12) {
                *last = step;
            }
            let inside =
                rolling.layout().cell_at(pole).is_some_and(|c| (4..196).contains(&c.x) && (4..196).contains(&c.y));
            // Where the vehicle stands, and that it drives over poles here, nothing is marked.
            let apart = (pole - pose.translation()).norm() > 0.6;
            if inside && apart && *last != usize::MAX && step - *last <= 5 {
                looks += 1;
                let marked = (-4..=4).any(|i| {
                    (-4..=4).any(|j| {
                        let at = pole + Vector2::new(f64::from(i), f64::from(j)) * 0.025;
                        let cell = rolling.layout().cell_at(&at);
                        cell.and_then(|cell| rolling.states().get(cell)) == Some(&CellState::Occupied)
                    })
                });
                gone += usize::from(!marked);
            }
        }
        pose = pose * twist.integrate(0.05);
    }
    (gone, looks, lost_cells)
}

#[test]
fn thin_poles_do_not_flicker() {
    let [one, two, four] = [1, 2, 4].map(flickers);
    println!("gone, looks, cells lost: {one:?}, {two:?}, {four:?}");
    assert!(one.1 > 3000 && [one.0, two.0, four.0] == [0; 3]);
    assert!(two.2 < one.2);
}

/// Two who pass before a wall: behind them the map is free again, and where they are tracked it is not marked at all.
#[test]
fn what_moves_leaves_no_trail() {
    let world = World2d::new(Shape::room(Vector2::new(-6.0, -6.0), Vector2::new(6.0, 6.0)).to_vec()).unwrap();
    let frame = |time, x| KeyFrame { time, position: Vector2::new(x, 1.5) };
    let disc = MovingDisc::new(0.4, 12.0, vec![frame(0.0, -4.0), frame(6.0, 4.0), frame(12.0, -4.0)]).unwrap();
    let mut laser = laser(3);
    let mut rolling =
        RollingCostmap::new(RollingParams { width: 300, height: 300, ..RollingParams::default() }).unwrap();
    let mut stands = rolling.clone();
    let mut tracker = ObstacleTracker::new(TrackerParams::default()).unwrap();
    let pose = Se2::new(0.0, -2.0, 1.57);
    for step in 0..200 {
        let time = 0.05 * f64::from(step);
        let mover = disc.at(time).unwrap();
        let stamp = Stamp::from_seconds(time);
        let scan = laser.scan(&Populated { world: &world, obstacles: &[mover] }, &pose, &Twist2::ZERO, stamp).unwrap();
        tracker.update(scan, &pose).unwrap();
        rolling.update([scan], &pose).unwrap();
        stands.update_where([tracker.scan()], &pose, |_, beam| !tracker.is_moving_beam(beam)).unwrap();
        let sight = (mover.position - pose.translation()).normalize();
        let marked = |map: &RollingCostmap, least: f64, most: f64| {
            let marked = |i: &usize| {
                let center = map.layout().center(map.layout().cell(*i));
                let away = center - mover.position;
                // In the mover's shadow nothing can be seen to have gone; walls stay.
                let (behind, across) = (away.dot(&sight), away.x * sight.y - away.y * sight.x);
                let hidden = behind > 0.0 && across.abs() < 0.65 && away.norm() > 0.6;
                let near = (least..=most).contains(&away.norm()) && !hidden && center.amax() < 5.8;
                near && map.states().values()[*i] == CellState::Occupied
            };
            (0..map.layout().len()).filter(marked).count()
        };
        // Two updates at 1.3 m/s are 0.13 m, and a cell is 0.07 m across.
        assert_eq!(marked(&rolling, 0.7, 99.0), 0, "{time}");
        assert!(marked(&rolling, 0.0, 0.6) > 5);
        if time > 2.0 && (time - 6.0).abs() > 1.5 {
            assert_eq!(marked(&stands, 0.0, 99.0), 0, "{time}");
        }
    }
}
