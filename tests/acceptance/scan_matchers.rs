//! All scan matchers on the same scans: how near they come, and from how far off.
//!
//! A hall of 13 m by 9 m with boxes in it, seen by 361 beams over three quarters of a circle with 0.02 m of noise; the
//! target are three scans. `cargo test --test acceptance -- --nocapture scan_matchers` prints the table of
//! `docs/experiments.md`.

use agv_nav::{
    core::{
        compute::Seed,
        geometry::{LieGroup, Se2, Twist2},
        nalgebra::Vector2,
        roles::{ScanMatcher, TargetScan},
        sensors::LaserScan,
        time::Stamp,
    },
    filters::matching::{
        ClimbingMatcher, ClimbingMatcherParams, CorrelativeMatcher, CorrelativeParams, FieldMatcher,
        FieldMatcherParams, PointToLineMatcher, PointToLineParams,
    },
    ndt::ndt::{NdtScanMatcher, NdtScanMatcherParams},
};
use agv_sim::{Laser, LaserParams, Shape, World2d};
use std::f64::consts::PI;

fn hall() -> World2d {
    let mut shapes = Shape::room(Vector2::new(-6.0, -4.0), Vector2::new(7.0, 5.0)).to_vec();
    shapes.push(Shape::rectangle(Se2::new(3.0, 2.5, 0.3), 1.5, 0.8));
    shapes.push(Shape::rectangle(Se2::new(-3.0, -1.5, 0.0), 0.6, 2.0));
    shapes.push(Shape::Circle { center: Vector2::new(0.5, -2.5), radius: 0.4 });
    World2d::new(shapes).unwrap()
}

/// Poses along a walk through the hall, and what is seen from them.
fn readings(laser: &mut Laser, world: &World2d, count: u32) -> Vec<(Se2, LaserScan)> {
    let pose = |i: u32| {
        let t = f64::from(i) * 0.61;
        Se2::new(0.9 * t.cos(), 0.7 * (1.7 * t).sin(), 2.3 * t)
    };
    let mut see = |pose: Se2| (pose, laser.scan(world, &pose, &Twist2::ZERO, Stamp::default()).unwrap().clone());
    (0..count).map(|i| see(pose(i))).collect()
}

/// What a matcher made of the guesses that are off by `distance` metres or `angle` radians.
struct Found {
    /// Share of those that came within 0.05 m and 0.02 rad.
    share: f64,
    /// Root mean square of the errors of these, in metres and radians.
    position: f64,
    heading: f64,
    /// Share of the others that the matcher held for good.
    deceived: f64,
}

fn ask(matcher: &mut dyn ScanMatcher, readings: &[(Se2, LaserScan)], distance: f64, angle: f64) -> Found {
    let (mut good, mut deceived, mut asked) = (0.0, 0.0, 0.0);
    let (mut position, mut heading) = (0.0, 0.0);
    for (i, (truth, scan)) in readings.iter().enumerate() {
        for direction in 0..8 {
            let towards = PI / 4.0 * f64::from(direction) + 0.1 * i as f64;
            let turn = if direction % 2 == 0 { angle } else { -angle };
            let offset = Vector2::new(towards.cos(), towards.sin()) * distance;
            let guess = Se2::from_parts(truth.translation() + offset, (*truth * Se2::new(0.0, 0.0, turn)).rotation());
            let found = matcher.match_scan(scan, &guess).unwrap();
            let error = truth.between(&found.target_from_source).log();
            let is_near = error.xy().norm() < 0.05 && error.z.abs() < 0.02;
            asked += 1.0;
            if is_near && found.converged() {
                good += 1.0;
                (position, heading) = (position + error.xy().norm_squared(), heading + error.z * error.z);
            } else if found.converged() {
                deceived += 1.0;
            }
        }
    }
    let root = |squares: f64| (squares / f64::max(good, 1.0)).sqrt();
    Found { share: good / asked, position: root(position), heading: root(heading), deceived: deceived / asked }
}

/// A matcher, and what is asked of it.
struct Candidate {
    name: &'static str,
    matcher: Box<dyn ScanMatcher>,
    /// How far off a guess may be for nineteen in twenty to come home, in metres and in radians.
    distance: f64,
    angle: f64,
    /// How near they come, in metres.
    accuracy: f64,
}

impl Candidate {
    fn new(name: &'static str, matcher: impl ScanMatcher + 'static, distance: f64, angle: f64, accuracy: f64) -> Self {
        Self { name, matcher: Box::new(matcher), distance, angle, accuracy }
    }
}

#[test]
fn scan_matchers_find_the_pose_from_where_they_say() {
    let world = hall();
    let params = LaserParams { range_sigma: 0.02, relative_sigma: 0.0, dropout: 0.0, ..LaserParams::default() };
    let mut laser = Laser::new(params.with_beams(361, 1.5 * PI), Seed(21)).unwrap();
    let poses = [(0.0, 0.0, 0.0), (0.5, 0.5, 2.0), (-0.5, 0.3, -2.0)].map(|(x, y, yaw)| Se2::new(x, y, yaw));
    let scans = poses.map(|pose| laser.scan(&world, &pose, &Twist2::ZERO, Stamp::default()).unwrap().clone());
    let target: Vec<_> =
        poses.iter().zip(&scans).map(|(pose, scan)| TargetScan { target_from_base: *pose, scan }).collect();
    let readings = readings(&mut laser, &world, 5);

    let candidates = [
        Candidate::new(
            "CorrelativeMatcher",
            CorrelativeMatcher::new(CorrelativeParams::default()).unwrap(),
            0.5,
            0.3,
            0.01,
        ),
        Candidate::new(
            "ClimbingMatcher",
            ClimbingMatcher::new(ClimbingMatcherParams::default()).unwrap(),
            0.3,
            0.2,
            0.01,
        ),
        Candidate::new("FieldMatcher", FieldMatcher::new(FieldMatcherParams::default()).unwrap(), 0.5, 0.3, 0.02),
        Candidate::new(
            "PointToLineMatcher",
            PointToLineMatcher::new(PointToLineParams::default()).unwrap(),
            0.5,
            0.3,
            0.01,
        ),
        Candidate::new("NdtScanMatcher", NdtScanMatcher::new(NdtScanMatcherParams::default()).unwrap(), 0.5, 0.2, 0.02),
    ];
    let (distances, angles) = ([0.2, 0.3, 0.5, 0.8, 1.2], [0.1, 0.2, 0.3, 0.5, 0.8]);
    println!("| matcher | error | found from off by {distances:?} m | off by {angles:?} rad | deceived, worst |");
    for Candidate { name, mut matcher, distance, angle, accuracy } in candidates {
        matcher.set_target(&target).unwrap();
        let near = ask(&mut *matcher, &readings, 0.02, 0.01);
        let off = distances.map(|distance| ask(&mut *matcher, &readings, distance, 0.0));
        let turned = angles.map(|angle| ask(&mut *matcher, &readings, 0.0, angle));
        let percent =
            |found: &[Found]| found.iter().map(|found| format!("{:.0} %", 100.0 * found.share)).collect::<Vec<_>>();
        let deceived = off.iter().chain(&turned).map(|found| found.deceived).fold(0.0, f64::max);
        println!(
            "| `{name}` | {:.1} mm, {:.2} mrad | {} | {} | {:.0} % |",
            1e3 * near.position,
            1e3 * near.heading,
            percent(&off).join(", "),
            percent(&turned).join(", "),
            100.0 * deceived
        );
        assert!(near.share > 0.95 && near.position < accuracy && near.heading < accuracy, "{name}: {}", near.position);
        let within = distances.iter().zip(&off).filter(|(off, _)| **off <= distance);
        assert!(within.clone().all(|(_, found)| found.share > 0.95), "{name}");
        let within = angles.iter().zip(&turned).filter(|(off, _)| **off <= angle);
        assert!(within.clone().all(|(_, found)| found.share > 0.95), "{name}");
    }
}
