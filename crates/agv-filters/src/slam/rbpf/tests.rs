//! On simulated drives whose truth is known.

use super::{Rbpf, RbpfParams, RbpfUpdate, ScanFitParams, TileMap};
use crate::particle::{
    DifferentialOdometryModel, EffectiveSampleSizeBelow, MotionThreshold, OdometryNoise, WeightSummary,
};
use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Twist2},
    grid::{CellState, OccupancyThresholds},
    odometry::OdometryIncrement,
    roles::SkipReason,
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_sim::{Laser, LaserParams, Shape, World2d};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};
use std::{
    collections::{HashMap, HashSet},
    f64::consts::{PI, TAU},
    sync::Arc,
};

#[cfg(feature = "serde")]
mod stored;

type Filter = Rbpf<DifferentialOdometryModel>;

/// A ring of corridors around a block, with niches that tell its sides apart.
fn ring() -> World2d {
    let mut shapes = Shape::room(Vector2::new(-8.0, -6.0), Vector2::new(8.0, 6.0)).to_vec();
    shapes.push(Shape::rectangle(Se2::new(0.0, 0.0, 0.0), 10.0, 6.0));
    shapes.push(Shape::rectangle(Se2::new(7.5, 2.0, 0.4), 0.8, 0.6));
    shapes.push(Shape::rectangle(Se2::new(-1.0, 5.7, 0.0), 1.0, 0.6));
    shapes.push(Shape::rectangle(Se2::new(-7.7, -1.0, 0.2), 0.5, 1.5));
    shapes.push(Shape::Circle { center: Vector2::new(1.5, -5.6), radius: 0.3 });
    World2d::new(shapes).unwrap()
}

/// A scan, the truth, and the motion since the scan before as the wheels have it.
struct Step {
    truth: Se2,
    wheels: Se2,
    scan: LaserScan,
}

/// Along the middle of the corridors, `steps` scans over `laps` rounds, with wheels that slip and drift.
fn drive(laser: LaserParams, steps: usize, laps: f64) -> Vec<Step> {
    let (world, mut laser, mut noise) = (ring(), Laser::new(laser, Seed(11)).unwrap(), Seed(12).stream(0, 0));
    // Straights with a quarter of a circle after each, counted along the way.
    let (radius, arc) = (1.2, 0.6 * PI);
    let sides = [(Se2::new(6.5, -3.3, 0.5 * PI), 6.6), (Se2::new(5.3, 4.5, PI), 10.6)];
    let sides = [sides[0], sides[1], (Se2::new(-6.5, 3.3, -0.5 * PI), 6.6), (Se2::new(-5.3, -4.5, 0.0), 10.6)];
    let around: f64 = sides.iter().map(|(_, length)| length + arc).sum();
    let pose = |i: usize| {
        let mut way = (around * laps * i as f64 / steps as f64 + 1.0) % around;
        for (start, length) in sides {
            if way < length {
                return start * Se2::new(way, 0.0, 0.0);
            } else if way < length + arc {
                let turn = (way - length) / radius;
                return start * Se2::new(length, 0.0, 0.0) * Se2::exp(&Vector3::new(radius * turn, 0.0, turn));
            }
            way -= length + arc;
        }
        sides[0].0
    };
    let mut last = pose(0);
    (0..steps)
        .map(|i| {
            let truth = pose(i);
            let motion = last.between(&truth);
            last = truth;
            let z = Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(&mut noise) });
            let wheels = motion.plus(&Vector3::new(
                motion.x() * (0.05 + 0.05 * z.x),
                0.01 * z.y,
                0.03 * motion.x() + 0.05 * motion.yaw() * z.z,
            ));
            let stamp = Stamp::from_seconds(0.2 * i as f64);
            let scan = laser.scan(&world, &truth, &Twist2::ZERO, stamp).unwrap().clone();
            Step { truth, wheels, scan }
        })
        .collect()
}

fn laser(beams: usize, field: f64) -> LaserParams {
    LaserParams { range_sigma: 0.015, relative_sigma: 0.0, dropout: 0.02, ..LaserParams::default() }
        .with_beams(beams, field)
}

fn filter(particles: usize) -> Filter {
    let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.02)).unwrap();
    let matching = ScanFitParams { max_beams: 90, ..ScanFitParams::default() };
    Rbpf::new(motion, RbpfParams { particles, matching, ..RbpfParams::default() }, Seed(5)).unwrap()
}

fn odometry(motion: Se2) -> OdometryIncrement {
    let stamp = Stamp::default();
    OdometryIncrement { start: stamp, end: stamp, start_from_end: motion, covariance: Matrix3::zeros() }
}

fn run(filter: &mut Filter, steps: &[Step]) -> Vec<RbpfUpdate> {
    steps
        .iter()
        .map(|step| {
            filter.predict(&odometry(step.wheels)).unwrap();
            filter.update(&step.scan).unwrap()
        })
        .collect()
}

/// Greatest distance of the trajectory from the truth, seen from the first pose.
fn worst(filter: &Filter, steps: &[Step]) -> f64 {
    let trajectory = filter.trajectory();
    assert_eq!(trajectory.len(), steps.len());
    let off = |((_, found), step): (&(Stamp, Se2), &Step)| {
        (found.translation() - steps[0].truth.between(&step.truth).translation()).norm()
    };
    trajectory.iter().zip(steps).map(off).fold(0.0, f64::max)
}

/// A square of 0.06 m.
fn square(point: &Vector2<f64>) -> (i32, i32) {
    let cell = (point / 0.06).map(f64::floor);
    (cell.x as i32, cell.y as i32)
}

/// Squares that hold a wall, by a laser without noise, and those around them.
fn walls(steps: &[Step]) -> HashSet<(i32, i32)> {
    let (world, mut clean) = (ring(), Laser::new(laser(1441, TAU).ideal(), Seed(1)).unwrap());
    let mut squares = HashSet::new();
    for step in steps.iter().step_by(4) {
        let scan = clean.scan(&world, &step.truth, &Twist2::ZERO, Stamp::default()).unwrap();
        for point in scan.points_in_base().map(|point| step.truth.act(&point)) {
            let (x, y) = square(&point);
            squares.extend((-1..=1).flat_map(|i| (-1..=1).map(move |j| (x + i, y + j))));
        }
    }
    squares
}

fn wheels_alone(steps: &[Step]) -> f64 {
    let end = steps.iter().skip(1).fold(Se2::default(), |pose, step| pose * step.wheels);
    (end.translation() - steps[0].truth.between(&steps[steps.len() - 1].truth).translation()).norm()
}

#[test]
fn a_loop_closes_and_the_map_is_that_of_the_world() {
    let steps = drive(laser(181, 1.5 * PI), 260, 1.3);
    let mut slam = filter(12);
    let updates = run(&mut slam, &steps);
    assert!(wheels_alone(&steps) > 1.0, "{}", wheels_alone(&steps));
    let worst = worst(&slam, &steps);
    assert!(worst < 0.12, "{worst}");
    let taken: Vec<_> = updates.iter().filter(|update| update.skipped.is_none()).collect();
    assert!(taken.len() > 60 && updates.len() - taken.len() > 60, "{}", taken.len());
    assert!(taken.iter().all(|update| update.matched == 12 && update.explained > 0.5));
    // Scans that are not taken in leave the weights as they are.
    let (uniform, mut weights) = (WeightSummary::uniform(12), WeightSummary::uniform(12));
    for update in &updates {
        if update.skipped.is_some() {
            assert_eq!(update.weights, weights);
        } else {
            weights = if update.resampled { uniform } else { update.weights };
        }
    }
    assert_ne!(weights, uniform, "the last scans prove nothing");
    // Surfaces of the map lie on walls, and the block's inside is unknown.
    let (map, walls) = (slam.best_map().states(&OccupancyThresholds::default()).unwrap(), walls(&steps));
    let fused = slam.fused_map(&OccupancyThresholds::default()).unwrap();
    for map in [&map, &fused] {
        let layout = *map.layout();
        let (mut surfaces, mut near) = (0_u32, 0_u32);
        for index in 0..layout.len() {
            let cell = layout.cell(index);
            let point = steps[0].truth.act(&layout.center(cell));
            match map.get(cell).unwrap() {
                CellState::Occupied => {
                    surfaces += 1;
                    near += u32::from(walls.contains(&square(&point)));
                }
                state => assert!(*state == CellState::Unknown || point.x.abs() > 4.7 || point.y.abs() > 2.7, "{point}"),
            }
        }
        assert!(surfaces > 600 && f64::from(near) > 0.97 * f64::from(surfaces), "{near} of {surfaces}");
    }
}

#[test]
fn the_bits_do_not_depend_on_threads() {
    let steps = drive(laser(91, 1.5 * PI), 60, 0.3);
    let results = [Par::Seq, Par::threads(2), Par::threads(4)].map(|par| {
        let mut slam = filter(7).with_parallelism(par);
        let updates = run(&mut slam, &steps);
        let maps: Vec<_> = slam.maps().iter().map(|map| map.states(&OccupancyThresholds::default()).unwrap()).collect();
        (updates, slam.trajectory(), slam.weights().to_vec(), maps)
    });
    assert!(results[0] == results[1] && results[0] == results[2]);
}

/// No wheels, a laser that hangs upside down and looks ahead only, and a clock that jumps back.
#[test]
fn scans_alone_do() {
    let mounted = laser(181, PI);
    let geometry = mounted.geometry;
    let hanging = ScanGeometry {
        base_from_sensor: Se2::new(0.2, 0.05, 0.1),
        angle_min: -geometry.angle_min,
        angle_increment: -geometry.angle_increment,
        ..geometry
    };
    let mut steps = drive(LaserParams { geometry: hanging, ..mounted }, 150, 0.5);
    for (i, step) in steps.iter_mut().enumerate() {
        let (back, ranges) = (Stamp::from_seconds(1e6 - i as f64), step.scan.ranges().to_vec());
        step.scan.refill(back, ranges.into_iter()).unwrap();
    }
    let mut slam = filter(8);
    for step in &steps {
        slam.update(&step.scan).unwrap();
    }
    let worst = worst(&slam, &steps);
    // 21 m, of which half a circle in turns.
    assert!(worst < 0.4, "{worst}");
    assert_eq!(slam.trajectory()[3].0, Stamp::from_seconds(1e6 - 3.0));
}

/// A laser that sees a quarter of what is around, from the vehicle's corner.
#[test]
fn a_narrow_view_does() {
    let narrow = laser(121, 1.7);
    let geometry = ScanGeometry { base_from_sensor: Se2::new(0.4, 0.2, 0.4), ..narrow.geometry };
    let steps = drive(LaserParams { geometry, ..narrow }, 120, 0.5);
    let mut slam = filter(8);
    run(&mut slam, &steps);
    let worst = worst(&slam, &steps);
    assert!(worst < 0.25 && wheels_alone(&steps) > 0.5, "{worst} {}", wheels_alone(&steps));
}

/// Wheels that say something for a part of the way only.
#[test]
fn odometry_may_begin_late_and_end_early() {
    let steps = drive(laser(181, 1.5 * PI), 150, 0.5);
    let mut slam = filter(8);
    let mut has_begun = false;
    for (i, step) in steps.iter().enumerate() {
        if (40..90).contains(&i) && (has_begun || slam.belief.walked.x() > 0.05) {
            if !has_begun {
                let before = slam.map_from_base();
                slam.predict(&odometry(Se2::default())).unwrap();
                let jump = before.between(&slam.map_from_base()).translation().norm();
                assert!(jump < 1e-9, "{jump}");
            }
            has_begun = true;
            slam.predict(&odometry(step.wheels)).unwrap();
        }
        slam.update(&step.scan).unwrap();
    }
    let end = slam.map_from_base().translation() - steps[0].truth.between(&steps[149].truth).translation();
    assert!(has_begun && end.norm() < 0.4, "{end}");
}

/// What all particles have seen alike is there once: copies of a particle share its map, and go on sharing what a scan does not change.
#[test]
fn memory_is_that_of_the_differences() {
    let (steps, particles) = (drive(laser(181, 1.5 * PI), 60, 0.3), 24);
    let (mut one, mut slam) = (filter(1), filter(particles));
    for slam in [&mut one, &mut slam] {
        slam.update(&steps[0].scan).unwrap();
    }
    assert!(slam.memory() < one.memory() + particles * 64, "one scan: {}", slam.memory());
    // The target of one scan, of which all particles together have one: some metres each way, eight bytes a cell.
    let working = one.working_memory();
    assert!(working > 50_000 && slam.working_memory() < working + particles * 10_000, "{working}");

    let address = |map: &TileMap| {
        let mut first = None;
        map.for_each_part(|address, _| {
            first.get_or_insert(address);
            false
        });
        first
    };
    let bits = |pose: &Se2| [pose.x(), pose.y(), pose.yaw()].map(f64::to_bits);
    // A new set as often as there may be one, until just after one that left particles out: where the weights are nearly alike, an
    // evenly spaced draw takes each once.
    slam.params.resample = EffectiveSampleSizeBelow { ratio: 1.0 };
    let (mut taken, mut resampled) = (1, 0);
    loop {
        let update = run(&mut slam, &steps[taken..=taken])[0];
        (taken, resampled) = (taken + 1, resampled + usize::from(update.resampled));
        if !update.resampled {
            continue;
        }
        let survivors = slam.belief.particles.states().iter().map(bits).collect::<HashSet<_>>().len();
        let sheets = slam.maps().iter().map(address).collect::<HashSet<_>>().len();
        assert_eq!(sheets, survivors, "one map for each ancestor");
        if resampled > 5 && survivors < particles {
            break;
        }
    }

    // Some scans more, and no new set: tiles that they do not change are those that were.
    slam.params.resample = EffectiveSampleSizeBelow { ratio: 0.0 };
    let before = slam.clone();
    run(&mut slam, &steps[taken..taken + 4]);
    let (mut same, mut kept) = (0, 0);
    for (before, after) in before.maps().iter().zip(slam.maps()) {
        let tiles: HashMap<_, _> = after.tiles().collect();
        for (place, tile) in before.tiles().filter(|(place, tile)| tiles[place] == *tile) {
            same += 1;
            kept += usize::from(Arc::ptr_eq(tile, tiles[&place]));
        }
    }
    assert!(same > 100 && kept as f64 > 0.98 * f64::from(same), "{kept} of {same}");
    let tiles = |slam: &Filter| -> usize {
        let all = slam.maps().iter().flat_map(TileMap::tiles).map(|(_, tile)| Arc::as_ptr(tile));
        all.collect::<HashSet<_>>().len()
    };
    let whole: usize = slam.maps().iter().map(|map| map.tiles().count()).sum();
    assert!(tiles(&slam) < whole, "{} {whole}", tiles(&slam));
}

#[test]
fn what_says_nothing_changes_nothing() {
    let steps = drive(laser(91, 1.5 * PI), 30, 0.15);
    let mut slam = filter(4);
    let geometry = *steps[0].scan.geometry();
    let empty = |ranges: Vec<f32>| LaserScan::new(Stamp::default(), geometry, ranges).unwrap();
    let too_few =
        |update: RbpfUpdate| matches!(update.skipped, Some(SkipReason::TooFewReadings { usable: 0, needed: 20 }));
    assert!(too_few(slam.update(&empty(vec![])).unwrap()) && slam.trajectory().is_empty());
    assert!(slam.best_map().layout().is_err() && slam.fused_map(&OccupancyThresholds::default()).is_err());
    run(&mut slam, &steps);
    let state = |slam: &Filter| (slam.map_from_base(), slam.weights().to_vec(), slam.trajectory().len());
    let before = state(&slam);
    assert!(too_few(slam.update(&empty(vec![f32::NAN, f32::INFINITY, -1.0])).unwrap()));
    assert_eq!(slam.update(&steps[29].scan).unwrap().skipped, Some(SkipReason::LittleMotion));
    assert_eq!((state(&slam).0, state(&slam).1), (before.0, before.1));
    assert_eq!(state(&slam).2, before.2 + 2, "they have a place in the trajectory");
}

#[test]
fn bad_input_is_named_and_changes_nothing() {
    let good = RbpfParams::default();
    let fit = good.matching;
    let with = |matching: ScanFitParams| RbpfParams { matching, ..good };
    for (name, bad) in [
        ("particles", RbpfParams { particles: 0, ..good }),
        ("particles", RbpfParams { particles: RbpfParams::MAX_PARTICLES + 1, ..good }),
        ("resolution", RbpfParams { resolution: 0.0, ..good }),
        ("resolution", RbpfParams { resolution: f64::NAN, ..good }),
        ("update", RbpfParams { update: MotionThreshold { distance: -1.0, angle: 0.1 }, ..good }),
        ("resampling", RbpfParams { resample: crate::particle::EffectiveSampleSizeBelow { ratio: 2.0 }, ..good }),
        ("max_range", RbpfParams { max_range: f64::INFINITY, ..good }),
        ("sigma", with(ScanFitParams { sigma: 0.0, ..fit })),
        ("outlier", with(ScanFitParams { outlier: f64::NAN, ..fit })),
        ("independent_beams", with(ScanFitParams { independent_beams: -1.0, ..fit })),
        ("weight_exponent", with(ScanFitParams { weight_exponent: 1.5, ..fit })),
        ("max_beams", with(ScanFitParams { max_beams: 0, ..fit })),
        ("min_beams", with(ScanFitParams { min_beams: 0, ..fit })),
        ("min_explained", with(ScanFitParams { min_explained: 1.1, ..fit })),
        ("samples", with(ScanFitParams { samples: 1, ..fit })),
    ] {
        let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.02)).unwrap();
        let error = Rbpf::new(motion, bad, Seed(1)).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }

    let steps = drive(laser(91, 1.5 * PI), 20, 0.1);
    let mut slam = filter(4);
    run(&mut slam, &steps);
    let state = |slam: &Filter| (slam.map_from_base(), slam.trajectory(), slam.weights().to_vec());
    let before = state(&slam);
    for motion in [Se2::new(f64::NAN, 0.0, 0.0), Se2::new(0.0, f64::INFINITY, 0.0), Se2::new(1e7, 0.0, 0.0)] {
        assert!(slam.predict(&odometry(motion)).is_err());
    }
    let vague = OdometryIncrement { covariance: Matrix3::from_element(f64::NAN), ..odometry(Se2::default()) };
    let indefinite = OdometryIncrement { covariance: Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0)), ..vague };
    assert!(slam.predict(&indefinite).is_err());
    assert!(slam.predict(&vague).is_err() && slam.reset(Se2::new(f64::NAN, 0.0, 0.0)).is_err());
    // A laser on a boom of a thousand kilometres.
    let boom = ScanGeometry { base_from_sensor: Se2::new(1e6, 0.0, 0.0), ..*steps[0].scan.geometry() };
    let far = LaserScan::new(Stamp::default(), boom, steps[0].scan.ranges().to_vec()).unwrap();
    assert!(state(&slam) == before);
    slam.predict(&odometry(Se2::new(0.5, 0.0, 0.0))).unwrap();
    let before = state(&slam);
    assert!(slam.update(&far).is_err() && state(&slam) == before);
    assert!(filter(2).update(&far).is_err());
    // Where maps would be absurdly wide both ways.
    for _ in 0..40 {
        slam.predict(&odometry(Se2::new(6e5, 6e5, 0.0))).unwrap();
    }
    let before = state(&slam);
    assert!(slam.update(&steps[0].scan).is_err() && state(&slam) == before);
    slam.reset(Se2::new(1.0, 2.0, 3.0)).unwrap();
    assert!(slam.trajectory().is_empty());
    run(&mut slam, &steps);
    assert!((slam.trajectory()[0].1.x() - 1.0).abs() < 1e-12);
}
