use super::*;
use crate::{geometry::Se2, path::PathPoint};
use nalgebra::Vector2;
use proptest::prelude::*;

const WINDOW: f64 = 0.5;

fn course(points: &[(f64, f64)]) -> Course {
    let positions: Vec<_> = points.iter().map(|&(x, y)| Vector2::new(x, y)).collect();
    let mut course = Course::new(WINDOW);
    course.set(&Path::from_positions(&positions).unwrap()).unwrap();
    course
}

#[test]
fn a_path_that_crosses_itself_is_followed_in_order() {
    // A loop whose end crosses its beginning: at the crossing the progress must not jump.
    let mut course = course(&[(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, -2.0)]);
    let at_crossing = course.advance(&Vector2::new(2.0, 0.01), 1.0).unwrap();
    assert!((at_crossing.arc_length - 2.0).abs() < 1e-12);
    assert!((at_crossing.cross_track - 0.01).abs() < 1e-12);
}

#[test]
fn long_segments_are_left_at_their_end() {
    let mut course = course(&[(0.0, 0.0), (9.0, 0.0), (9.0, 9.0)]);
    for x in [0.0, 4.0, 8.5] {
        course.advance(&Vector2::new(x, 0.0), 5.0);
    }
    let turned = course.advance(&Vector2::new(9.0, 0.5), 1.5).unwrap();
    assert!((turned.arc_length - 9.5).abs() < 1e-12 && turned.cross_track.abs() < 1e-12);
}

#[test]
fn cusps_cut_the_course() {
    let mut path = Path::new();
    for (x, gear) in [(0.0, Gear::Forward), (1.0, Gear::Forward), (0.5, Gear::Reverse)] {
        path.push(PathPoint { pose: Se2::new(x, 0.0, 0.0), gear }).unwrap();
    }
    let mut course = Course::new(WINDOW);
    course.set(&path).unwrap();
    assert_eq!((course.leg(), course.section_end()), (Leg::Drive(Gear::Forward), 1.0));
    assert!(course.next_section());
    assert_eq!((course.leg(), course.section_end()), (Leg::Drive(Gear::Reverse), 1.5));
    let back = course.advance(&Vector2::new(0.75, 0.1), 1.0).unwrap();
    // Travelling towards -x, a point at +y lies to the right.
    assert!((back.arc_length - 1.25).abs() < 1e-12 && (back.cross_track + 0.1).abs() < 1e-12);
    assert!(!course.next_section());
}

#[test]
fn a_refused_path_leaves_the_course() {
    let mut c = course(&[(0.0, 0.0), (1.0, 0.0)]);
    let before = c.clone();
    assert_eq!(
        c.set(&Path::from_positions(&[Vector2::x(); 4]).unwrap()),
        Err(Error::TooFew { name: "distinct poses of the path", min: 2, len: 1 })
    );
    assert_eq!(c, before);
}

#[test]
fn a_corner_bends_over_the_window() {
    let course = course(&[(0.0, 0.0), (3.0, 0.0), (3.0, -3.0)]);
    let curvature = -std::f64::consts::FRAC_PI_2 / WINDOW;
    let at = |s: f64| course.bends()[(s / course.knot_spacing()).round() as usize];
    for (s, here) in [(2.7, 0.0), (2.8, curvature), (3.0, curvature), (3.2, curvature), (3.3, 0.0)] {
        assert!((at(s).curvature - here).abs() < 1e-12, "{s}");
        assert!((course.curvature_at(s) - here).abs() < 0.9 * curvature.abs(), "{s}");
    }
    assert!((at(3.0).change - curvature.abs() / (0.5 * WINDOW)).abs() < 1e-12);
    assert!(at(1.0) == Bend::default() && at(5.0) == Bend::default());
}

#[test]
fn turns_on_the_spot_cut_the_course_and_the_last_heading_is_one() {
    let mut path = Path::from_positions(&[(0.0, 0.0), (1.0, 0.0)].map(|(x, y)| Vector2::new(x, y))).unwrap();
    path.push_turn(1.0).unwrap();
    path.push_turn(1.5).unwrap();
    path.push(PathPoint { pose: Se2::new(1.0, 1.0, -2.0), gear: Gear::Forward }).unwrap();
    let mut course = Course::new(WINDOW);
    course.set(&path).unwrap();
    let mut legs = vec![course.leg()];
    while course.next_section() {
        legs.push(course.leg());
    }
    assert_eq!(legs, [Leg::Drive(Gear::Forward), Leg::Turn(1.5), Leg::Drive(Gear::Forward), Leg::Turn(-2.0)]);
    assert!(course.bends().iter().all(|bend| *bend == Bend::default()), "no bend where the vehicle stops");
    let there = course.advance(&Vector2::new(1.1, 1.0), 1.0).unwrap();
    assert!((there.arc_length - 2.0).abs() < 1e-12 && (there.cross_track.abs() - 0.1).abs() < 1e-12);

    let mut only = Path::from_positions(&[Vector2::x()]).unwrap();
    assert_eq!(course.set(&only), Err(Error::TooFew { name: "distinct poses of the path", min: 2, len: 1 }));
    only.push_turn(2.0).unwrap();
    course.set(&only).unwrap();
    assert_eq!((course.leg(), course.length(), course.is_last_section()), (Leg::Turn(2.0), 0.0, true));
    assert_eq!(course.point_at(7.0).unwrap().0, Vector2::x());
    assert_eq!((course.curvature_at(3.0), course.yaw_at(3.0)), (0.0, Some(2.0)));
}

#[test]
fn headings_between_points_are_interpolated() {
    let mut path = Path::new();
    for (x, yaw) in [(0.0, 3.0), (2.0, -3.0)] {
        path.push(PathPoint { pose: Se2::new(x, 0.0, yaw), gear: Gear::Forward }).unwrap();
    }
    let mut course = Course::new(WINDOW);
    course.set(&path).unwrap();
    let turn = 2.0 * std::f64::consts::PI - 6.0;
    assert!((course.yaw_at(0.5).unwrap() - (3.0 + 0.25 * turn)).abs() < 1e-12, "the shorter way, through π");
    assert!((course.yaw_at(-1.0).unwrap() - 3.0).abs() < 1e-12);
}

proptest! {
    /// On a circle of many chords the curvature is that of the circle.
    #[test]
    fn curvature_of_a_circle(radius in 0.5..5.0_f64) {
        let positions: Vec<_> = (0..2000).map(|i| {
            let angle = f64::from(i) * 0.0025;
            Vector2::new(radius * angle.cos(), radius * angle.sin())
        }).collect();
        let mut course = Course::new(WINDOW);
        course.set(&Path::from_positions(&positions).unwrap()).unwrap();
        let middle = course.bends()[course.bends().len() / 2];
        prop_assert!((middle.curvature * radius - 1.0).abs() < 0.05 && middle.change * radius < 0.2);
    }

    /// The nearest point that is found with few looks is the nearest of all.
    #[test]
    fn projection_skips_nothing(
        turns in prop::collection::vec((-0.8..0.8_f64, 0.01..0.6_f64), 2..60), reach in 0.1..5.0_f64,
        walk in prop::collection::vec((-0.5..0.5_f64, -0.5..0.5_f64), 10),
    ) {
        let (mut at, mut yaw) = (Vector2::zeros(), 0.0_f64);
        let mut positions = vec![at];
        for (turn, ahead) in turns {
            yaw += turn;
            at += Vector2::new(yaw.cos(), yaw.sin()) * ahead;
            positions.push(at);
        }
        let mut course = Course::new(WINDOW);
        course.set(&Path::from_positions(&positions).unwrap()).unwrap();
        for (i, (x, y)) in walk.into_iter().enumerate() {
            let position = positions[(i * positions.len()) / 10] + Vector2::new(x, y);
            let (first, progress) = (course.segment, course.progress);
            // All segments that begin within reach, one by one.
            let nearest = (first..positions.len() - 1)
                .take_while(|&k| k == first || course.arc_lengths[k] <= progress + reach)
                .map(|k| {
                    let along = positions[k + 1] - positions[k];
                    let share = ((position - positions[k]).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                    (position - (positions[k] + along * share)).norm()
                })
                .fold(f64::INFINITY, f64::min);
            let found = course.advance(&position, reach).unwrap();
            prop_assert!((found.cross_track.abs() - nearest).abs() < 1e-9, "{} {nearest}", found.cross_track);
        }
    }

    /// The error is the distance to the nearest point of the section, also beyond corners and ends.
    #[test]
    fn cross_track_is_the_distance(x in -2.0..8.0_f64, y in -3.0..6.0_f64) {
        let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (7.0, 3.0)];
        let mut course = course(&corners);
        let position = Vector2::new(x, y);
        let projection = course.advance(&position, 100.0).unwrap();
        // Brute force: ten thousand points along the corners.
        let nearest = corners.windows(2).flat_map(|w| (0..=5000).map(move |i| {
            let f = f64::from(i) / 5000.0;
            Vector2::new(w[0].0 + f * (w[1].0 - w[0].0), w[0].1 + f * (w[1].1 - w[0].1))
        })).map(|p| (p - position).norm()).fold(f64::INFINITY, f64::min);
        prop_assert!((projection.cross_track.abs() - nearest).abs() < 1e-3);
    }

    /// Walking along the path, the projection moves with the walker.
    #[test]
    fn progress_follows_the_walker(offset in -0.2..0.2_f64) {
        let mut course = course(&[(0.0, 0.0), (5.0, 0.0), (5.0, 5.0)]);
        for i in 0..80 {
            let s = f64::from(i) * 0.05;
            let projection = course.advance(&Vector2::new(s, offset), 2.0).unwrap();
            prop_assert!((projection.arc_length - s).abs() < 1e-9 && (projection.cross_track - offset).abs() < 1e-9);
        }
    }
}
