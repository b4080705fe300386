//! Against exhaustive search, and on simulated scans whose poses are known.

mod consistency;
mod guided;

use super::{
    CorrelativeMatcher, CorrelativeParams, SearchWindow,
    search::{Scratch, search},
    target::Target,
};
use agv_core::{
    Error,
    compute::Seed,
    geometry::{LieGroup, PoseSigma, Se2, So2, Twist2},
    grid::{CellState, Grid, GridLayout},
    roles::{AlignmentError, ScanMatcher, TargetScan, Termination, laws},
    sensors::LaserScan,
    time::Stamp,
};
use agv_sim::{Laser, LaserParams, Shape, World2d};
use nalgebra::Vector2;
use rand::RngExt;
use std::f64::consts::PI;

/// A hall without symmetry.
fn hall() -> World2d {
    let mut shapes = Shape::room(Vector2::new(-6.0, -4.0), Vector2::new(7.0, 5.0)).to_vec();
    shapes.push(Shape::rectangle(Se2::new(3.0, 2.5, 0.3), 1.5, 0.8));
    shapes.push(Shape::rectangle(Se2::new(-3.0, -1.5, 0.0), 0.6, 2.0));
    shapes.push(Shape::Circle { center: Vector2::new(0.5, -2.5), radius: 0.4 });
    World2d::new(shapes).unwrap()
}

fn corridor() -> World2d {
    World2d::new(Shape::room(Vector2::new(-200.0, -1.2), Vector2::new(200.0, 1.2)).to_vec()).unwrap()
}

fn laser(sigma: f64, seed: u64) -> Laser {
    let params = LaserParams { range_sigma: sigma, relative_sigma: 0.0, dropout: 0.0, ..LaserParams::default() };
    Laser::new(params.with_beams(361, 1.5 * PI), Seed(seed)).unwrap()
}

fn scan(world: &World2d, laser: &mut Laser, pose: &Se2) -> LaserScan {
    laser.scan(world, pose, &Twist2::ZERO, Stamp::default()).unwrap().clone()
}

fn matcher() -> CorrelativeMatcher {
    CorrelativeMatcher::new(CorrelativeParams::default()).unwrap()
}

/// Scans without noise from around the origin.
fn clean_target(world: &World2d) -> CorrelativeMatcher {
    let mut laser = laser(0.0, 1);
    let poses = [(0.0, 0.0, 0.0), (0.5, 0.5, 2.0), (-0.5, 0.3, -2.0)].map(|(x, y, yaw)| Se2::new(x, y, yaw));
    let scans = poses.map(|pose| scan(world, &mut laser, &pose));
    let target: Vec<_> =
        poses.iter().zip(&scans).map(|(pose, scan)| TargetScan { target_from_base: *pose, scan }).collect();
    let mut matcher = matcher();
    matcher.set_target(&target).unwrap();
    matcher
}

#[test]
fn the_search_finds_what_trying_all_finds() {
    let world = hall();
    let mut laser = laser(0.03, 2);
    let first: Vec<_> = scan(&world, &mut laser, &Se2::default()).points_in_base().collect();
    let mut target = Target::new(&first, &CorrelativeParams::default()).unwrap();
    let mut scratch = Scratch::default();
    for (pose, guess) in [
        (Se2::new(0.2, -0.1, 0.1), Se2::default()),
        (Se2::new(-0.3, 0.3, -0.2), Se2::new(-0.1, 0.1, 0.0)),
        (Se2::new(0.0, 0.4, 3.0), Se2::new(0.1, 0.2, 0.4)),
    ] {
        let points: Vec<_> = scan(&world, &mut laser, &pose).points_in_base().step_by(9).collect();
        let window = SearchWindow { distance: 0.33, angle: 0.15 };
        let found = search(&mut target, &points, &guess, &window, 0.0, &mut scratch).unwrap();
        let farthest = points.iter().map(nalgebra::Matrix::norm).fold(0.0, f64::max);
        let turns = (window.angle * farthest / 0.05).ceil() as i32;
        let (mut best, mut tried) = (0, 0);
        for turn in -turns..=turns {
            let rotation = So2::from_angle(f64::from(turn) * window.angle / f64::from(turns));
            let turned = Se2::from_parts(guess.translation(), guess.rotation().compose(&rotation));
            let cells: Vec<_> =
                points.iter().map(|point| target.layout.to_grid(&turned.act(point)).map(f64::floor)).collect();
            for (x, y) in (-7..=7).flat_map(|x| (-7..=7).map(move |y| (x, y))) {
                let value =
                    |cell: &Vector2<f64>| u32::from(target.pyramid(0).at(0, cell.x as i32 + x, cell.y as i32 + y));
                best = best.max(cells.iter().map(value).sum::<u32>());
                tried += 1;
            }
        }
        assert_eq!(found.score, best);
        assert!(found.evaluated < tried / 2, "{} of {tried}", found.evaluated);
        // A floor below it changes nothing but the time, one above it leaves nothing.
        let share = f64::from(best) / (255.0 * points.len() as f64);
        let above = search(&mut target, &points, &guess, &window, share - 0.01, &mut scratch).unwrap();
        assert!((above.pose, above.score) == (found.pose, best) && above.evaluated <= found.evaluated);
        assert_eq!(search(&mut target, &points, &guess, &window, share + 0.01, &mut scratch), None);
        let off = guess.inverse().compose(&found.pose);
        assert!(off.yaw().abs() < 0.1501 && (found.pose.translation() - guess.translation()).amax() < 0.3501);
    }
}

/// Off by up to the window, found to the noise; the stated covariance is that of the errors, to a factor.
#[test]
fn poses_are_found_to_the_noise_and_the_information_says_so() {
    let world = hall();
    let mut matcher = clean_target(&world);
    let (mut laser, mut stream) = (laser(0.02, 3), Seed(4).stream(0, 0));
    let (mut squares, runs) = (0.0, 60);
    for _ in 0..runs {
        let mut within = |limit: f64| stream.random_range(-limit..limit);
        let truth = Se2::new(within(0.8), within(0.8), within(3.0));
        let guess = Se2::new(truth.x() + within(0.25), truth.y() + within(0.25), truth.yaw() + within(0.3));
        let found = matcher.match_scan(&scan(&world, &mut laser, &truth), &guess).unwrap();
        assert!(found.converged() && found.inlier_ratio > 0.8, "{found:?}");
        let error = truth.between(&found.target_from_source).log();
        assert!(error.xy().norm() < 0.02 && error.z.abs() < 0.006, "{truth:?} {error:?}");
        squares += (error.transpose() * found.information * error)[0];
        assert_eq!(found.unobserved.trace(), 0.0);
    }
    // Three per run if beams were independent of each other and lines were lines.
    let mean = squares / f64::from(runs);
    assert!((1.0..9.0).contains(&mean), "{mean}");
}

#[test]
fn a_wide_window_closes_loops() {
    let world = hall();
    let mut matcher = clean_target(&world);
    let mut laser = laser(0.02, 5);
    let truth = Se2::new(0.7, -0.4, 2.2);
    let reading = scan(&world, &mut laser, &truth);
    let window = SearchWindow { distance: 3.0, angle: PI };
    let found = matcher.match_within(&reading, &Se2::new(-1.5, 1.5, -1.0), window).unwrap();
    let error = truth.between(&found.target_from_source).log();
    assert!(found.converged() && error.norm() < 0.02, "{found:?}");
    // What was never seen is not found: another hall, and a scan of it.
    let elsewhere = World2d::new(vec![
        Shape::Circle { center: Vector2::new(2.0, 1.0), radius: 0.7 },
        Shape::Circle { center: Vector2::new(-1.0, 2.0), radius: 0.5 },
        Shape::Circle { center: Vector2::new(1.0, -3.0), radius: 1.0 },
    ]);
    let foreign = scan(&elsewhere.unwrap(), &mut laser, &Se2::default());
    let found = matcher.match_within(&foreign, &Se2::default(), SearchWindow { distance: 0.5, angle: 0.3 }).unwrap();
    assert!(!found.converged() || found.score < 0.5, "{found:?}");
}

#[test]
fn a_corridor_fixes_no_place_along_it() {
    let world = corridor();
    let mut matcher = clean_target(&world);
    let mut laser = laser(0.02, 6);
    let (truth, guess) = (Se2::new(0.3, 0.1, 0.05), Se2::new(0.1, 0.0, 0.0));
    let reading = scan(&world, &mut laser, &truth);
    // Without a search, which would take any place along the corridor, the place along it stays.
    let found = matcher.match_within(&reading, &guess, SearchWindow { distance: 0.0, angle: 0.0 }).unwrap();
    assert!(found.converged());
    let along = truth.rotation().inverse().act(&Vector2::x());
    let expected = along * along.transpose();
    assert!((found.unobserved.fixed_view::<2, 2>(0, 0) - expected).norm() < 0.05, "{}", found.unobserved);
    let pose = found.target_from_source;
    assert!((pose.y() - 0.1).abs() < 0.01 && (pose.yaw() - 0.05).abs() < 0.003, "{pose:?}");
    assert!((pose.x() - 0.1).abs() < 0.02, "{pose:?}");
    let covariance = found.covariance(PoseSigma { translation: 5.0, rotation: 1.0 }).unwrap();
    assert!(covariance[(0, 0)] > 20.0 && covariance[(1, 1)] < 0.1);
}

#[test]
fn maps_serve_as_targets() {
    // The hall, drawn to cells of 0.05 m from clean scans.
    let world = hall();
    let layout = GridLayout::new(300, 220, 0.05, Se2::new(-7.0, -5.0, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    let mut clean = laser(0.0, 1);
    for yaw in [0.0, 2.0, 4.0] {
        let pose = Se2::new(0.0, 0.0, yaw);
        for point in scan(&world, &mut clean, &pose).points_in_base() {
            map.set(layout.cell_at(&pose.act(&point)).unwrap(), CellState::Occupied);
        }
    }
    let mut matcher = matcher();
    assert!(matcher.set_map(&Grid::filled(layout, CellState::Free)).is_err());
    matcher.set_map(&map).unwrap();
    let truth = Se2::new(0.1, 0.2, 0.3);
    let reading = scan(&world, &mut laser(0.02, 7), &truth);
    let found = matcher.match_scan(&reading, &Se2::default()).unwrap();
    let error = truth.between(&found.target_from_source).log();
    assert!(found.converged() && error.norm() < 0.03, "{found:?}");
}

#[test]
fn the_laws_of_the_role_hold() {
    let world = hall();
    let mut laser = laser(0.01, 8);
    let first = scan(&world, &mut laser, &Se2::default());
    let second = scan(&world, &mut laser, &Se2::new(0.1, 0.0, 0.1));
    let target = [TargetScan { target_from_base: Se2::default(), scan: &first }];
    assert_eq!(matcher().match_scan(&first, &Se2::default()), Err(AlignmentError::NoTarget));
    laws::scan_matcher(&mut matcher(), &target, &second, &Se2::default()).unwrap();
}

#[test]
fn bad_input_is_named() {
    let good = CorrelativeParams::default();
    let window = good.window;
    for (name, bad) in [
        ("resolution", CorrelativeParams { resolution: 0.0, ..good }),
        ("sigma", CorrelativeParams { sigma: f64::NAN, ..good }),
        ("sigma / resolution", CorrelativeParams { sigma: 0.01, ..good }),
        ("range_sigma", CorrelativeParams { range_sigma: -0.1, ..good }),
        ("distance of", CorrelativeParams { window: SearchWindow { distance: 1e6, ..window }, ..good }),
        ("angle of", CorrelativeParams { window: SearchWindow { angle: f64::NAN, ..window }, ..good }),
        ("min_points", CorrelativeParams { min_points: 0, ..good }),
        ("min_inlier_ratio", CorrelativeParams { min_inlier_ratio: 1.1, ..good }),
        ("normal_radius", CorrelativeParams { normal_radius: f64::INFINITY, ..good }),
        ("rotation", CorrelativeParams { observable: PoseSigma { translation: 1.0, rotation: 0.0 }, ..good }),
    ] {
        let error = CorrelativeMatcher::new(bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    // Scans that are too far apart for one grid, and guesses that are nowhere.
    let world = hall();
    let reading = scan(&world, &mut laser(0.01, 9), &Se2::default());
    let at = |x: f64| TargetScan { target_from_base: Se2::new(x, 0.0, 0.0), scan: &reading };
    let mut matcher = matcher();
    let apart = matcher.set_target(&[at(0.0), at(1e9)]);
    assert!(matches!(apart, Err(AlignmentError::Invalid(Error::TooMany { .. }))));
    matcher.set_target(&[at(0.0)]).unwrap();
    for x in [1e9, 1e300, f64::MAX] {
        let found = matcher.match_scan(&reading, &Se2::new(x, -x, 0.0)).unwrap();
        assert_eq!((found.termination, found.target_from_source.x()), (Termination::TooFewPoints, x));
    }
}

#[test]
fn points_that_are_on_no_line_count_in_the_score() {
    let posts: Vec<_> = (0..42).map(|i| Vector2::new(f64::from(i % 7), f64::from(i / 7))).collect();
    let mut matcher = CorrelativeMatcher::new(CorrelativeParams::default()).unwrap();
    matcher.set_points(&posts).unwrap();
    let here = SearchWindow { distance: 0.0, angle: 0.0 };
    let found = matcher.match_points(&posts, &Se2::default(), here, 0.0).unwrap();
    assert!(found.converged() && found.score > 0.95, "{found:?}");
    let aside: Vec<_> = posts.iter().map(|post| post + Vector2::new(0.1, 0.0)).collect();
    let found = matcher.match_points(&aside, &Se2::default(), here, 0.0).unwrap();
    // One standard deviation off.
    assert!((found.score - (-0.5_f64).exp()).abs() < 0.01, "{found:?}");
}
