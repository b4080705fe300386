//! Paths of known shapes: what experiments drive, and what a route of waypoints becomes with its corners rounded.
//!
//! All are sampled at most `spacing` metres apart and start at the origin, except [`rounded`], which starts where its
//! waypoints do. At 2 cm, the straight lines between the points of a bend of 0.6 m radius are 0.1 mm inside of it.

use super::{Gear, Path, PathPoint};
use crate::{
    Error, check,
    geometry::{Se2, Twist2, angle_difference},
};
use nalgebra::Vector2;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Most points of a path that is made here: a kilometre in millimetres.
const MAX_POINTS: f64 = 1e6;

/// A straight line of `length` metres along x.
///
/// # Errors
/// A length or a spacing that is not finite and positive, or so small a spacing that the path has over a million points.
pub fn line(length: f64, spacing: f64) -> Result<Path, Error> {
    check::positive("length", length)?;
    let steps = steps(length, spacing)?;
    sampled(steps, |t| Vector2::new(length * t, 0.0))
}

/// A change of lane: `length` metres along x and `offset` metres to the left, without curvature at its ends.
///
/// `y = offset (10 u³ - 15 u⁴ + 6 u⁵)` with `u = x / length`, the polynomial of least jerk (Flash and Hogan 1985).
///
/// # Errors
/// As [`line()`], or an offset that is not finite.
pub fn s_curve(length: f64, offset: f64, spacing: f64) -> Result<Path, Error> {
    check::positive("length", length)?;
    check::finite("offset", offset)?;
    // The slope is at most 1.875 offset / length.
    let steps = steps(length.hypot(1.875 * offset), spacing)?;
    sampled(steps, |u| Vector2::new(length * u, offset * u * u * u * (10.0 + u * (6.0 * u - 15.0))))
}

/// A figure of eight: one round of the lemniscate of Gerono, from its crossing and back there.
///
/// `(a sin t, a sin t cos t)` is `2 a` wide and 6.097 `a` long; its bends are as tight as `0.209 a`.
///
/// ```
/// let eight = agv_core::path::shapes::lemniscate(3.0, 0.02)?;
/// assert!((eight.length() - 18.29).abs() < 0.01);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// A half-width or a spacing that is not finite and positive, or so small a spacing that the path has over a million points.
pub fn lemniscate(half_width: f64, spacing: f64) -> Result<Path, Error> {
    let a = check::positive("half_width", half_width)?;
    // Fastest at the crossing, √2 a per radian.
    let steps = steps(TAU * std::f64::consts::SQRT_2 * a, spacing)?;
    sampled(steps, |t| {
        let (sin, cos) = (TAU * t).sin_cos();
        Vector2::new(a * sin, a * sin * cos)
    })
}

/// The way through waypoints along straight lines, each corner rounded off by an arc of `radius` metres: what an aisle with
/// its crossings is to a vehicle that does not stop.
///
/// Where two corners leave too little room for their arcs, both are tightened to what fits, by one factor. A reversal of
/// direction cannot be rounded and stays as it is.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::shapes;
///
/// let corner = [Vector2::new(0.0, 0.0), Vector2::new(2.0, 0.0), Vector2::new(2.0, 2.0)];
/// let path = shapes::rounded(&corner, 0.6, 0.02)?;
/// assert!((path.length() - (2.0 * 1.4 + 0.6 * std::f64::consts::FRAC_PI_2)).abs() < 1e-3);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// Fewer than two distinct waypoints, one that is not finite, a radius or a spacing that is not finite and positive, or so
/// small a spacing that the path has over a million points.
pub fn rounded(waypoints: &[Vector2<f64>], radius: f64, spacing: f64) -> Result<Path, Error> {
    check::positive("radius", radius)?;
    check::all_finite("waypoint", waypoints.iter().flat_map(|point| point.iter()))?;
    let mut corners: Vec<Vector2<f64>> = Vec::with_capacity(waypoints.len());
    for point in waypoints {
        if corners.last() != Some(point) {
            corners.push(*point);
        }
    }
    check::at_least("waypoints", corners.len(), 2)?;
    let lengths: Vec<f64> = corners.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
    steps(lengths.iter().sum(), spacing)?;
    let headings: Vec<f64> = corners.windows(2).map(|pair| heading(pair[1] - pair[0])).collect();
    // How much of both lines each corner's arc takes: r tan(turn / 2); nothing at the ends.
    let mut takes = vec![0.0; corners.len()];
    for (take, pair) in takes[1..].iter_mut().zip(headings.windows(2)) {
        let turn = angle_difference(pair[1], pair[0]).abs();
        *take = if turn < PI - 1e-6 { radius * (0.5 * turn).tan() } else { 0.0 };
    }
    let wanted = takes.clone();
    for (line, length) in lengths.iter().enumerate() {
        let share = length / (wanted[line] + wanted[line + 1]).max(f64::MIN_POSITIVE);
        for corner in [line, line + 1] {
            takes[corner] = takes[corner].min(wanted[corner] * share);
        }
    }
    let mut positions = Vec::new();
    for (line, length) in lengths.iter().enumerate() {
        let (from, yaw) = (corners[line], headings[line]);
        let along = Vector2::new(yaw.cos(), yaw.sin());
        let (begin, end) = (takes[line], length - takes[line + 1]);
        let straight = end - begin;
        // Where two arcs meet there is no line between them, only rounding.
        let pieces = if straight > 1e-9 * length { steps(straight.max(spacing), spacing)? } else { 0 };
        positions.extend((0..=pieces).map(|i| from + along * (begin + straight * i as f64 / pieces.max(1) as f64)));
        if let Some(&next) = headings.get(line + 1) {
            let turn = angle_difference(next, yaw);
            let radius = takes[line + 1] / (0.5 * turn.abs()).tan().max(f64::MIN_POSITIVE);
            let arc = radius * turn.abs();
            if arc.is_finite() && takes[line + 1] > 0.0 {
                let start = Se2::new(from.x + along.x * end, from.y + along.y * end, yaw);
                let pieces = steps(arc.max(spacing), spacing)?;
                let twist = Twist2::new(arc, 0.0, turn);
                positions
                    .extend((1..pieces).map(|i| (start * twist.integrate(i as f64 / pieces as f64)).translation()));
            }
        }
    }
    positions.dedup();
    Path::from_positions(&positions)
}

/// Into a bay, tail first: `lead` metres ahead, a quarter circle to the left, a cusp, a quarter circle back that turns the
/// vehicle about, and `lead` metres back, along x again. Vehicles with a turning radius of at most `radius` metres can drive it.
///
/// # Errors
/// A length that is not finite and positive, or so small a spacing that the path has over a million points.
pub fn reverse_into_bay(lead: f64, radius: f64, spacing: f64) -> Result<Path, Error> {
    check::positive("lead", lead)?;
    check::positive("radius", radius)?;
    let arc = radius * FRAC_PI_2;
    steps(2.0 * (lead + arc), spacing)?;
    let mut path = Path::new();
    let mut pose = Se2::default();
    path.push(PathPoint { pose, gear: Gear::Forward })?;
    for (gear, length, turn) in [
        (Gear::Forward, lead, 0.0),
        (Gear::Forward, arc, FRAC_PI_2),
        (Gear::Reverse, -arc, FRAC_PI_2),
        (Gear::Reverse, -lead, 0.0),
    ] {
        let pieces = steps(length.abs(), spacing)?;
        let twist = Twist2::new(length, 0.0, turn);
        for i in 1..=pieces {
            path.push(PathPoint { pose: pose * twist.integrate(i as f64 / pieces as f64), gear })?;
        }
        pose = pose * twist.integrate(1.0);
    }
    Ok(path)
}

/// How many pieces of at most `spacing` metres a length has.
fn steps(length: f64, spacing: f64) -> Result<usize, Error> {
    check::positive("spacing", spacing)?;
    let steps = (length / spacing).ceil();
    check::in_range("points of the path", steps, 1.0, MAX_POINTS).map(|steps| steps as usize)
}

/// The curve over `t` in [0, 1], at even steps.
fn sampled(steps: usize, curve: impl Fn(f64) -> Vector2<f64>) -> Result<Path, Error> {
    let mut path = Path::new();
    path.set_positions((0..=steps).map(|i| curve(i as f64 / steps as f64)))?;
    Ok(path)
}

fn heading(along: Vector2<f64>) -> f64 {
    along.y.atan2(along.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::LieGroup;
    use crate::metrics::{PathQuality, PathQualityParams};
    use proptest::prelude::*;

    fn spacing_of(path: &Path) -> f64 {
        let gaps = path.points().windows(2).map(|w| (w[1].pose.translation() - w[0].pose.translation()).norm());
        gaps.fold(0.0, f64::max)
    }

    /// Greatest turn per metre from segment to segment.
    fn tightest(path: &Path) -> f64 {
        let points: Vec<_> = path.points().iter().map(|p| p.pose.translation()).collect();
        let bends = points.windows(3).map(|w| {
            let (a, b) = (w[1] - w[0], w[2] - w[1]);
            angle_difference(heading(b), heading(a)).abs() / (0.5 * (a.norm() + b.norm()))
        });
        bends.fold(0.0, f64::max)
    }

    #[test]
    fn shapes_are_as_long_and_as_tight_as_they_say() {
        for (path, length, radius, end) in [
            (line(4.0, 0.05).unwrap(), 4.0, f64::INFINITY, (4.0, 0.0)),
            (s_curve(6.0, 2.0, 0.02).unwrap(), 6.4465, 3.4045, (6.0, 2.0)),
            (lemniscate(3.0, 0.02).unwrap(), 18.292, 0.6263, (0.0, 0.0)),
            (reverse_into_bay(1.5, 0.8, 0.02).unwrap(), 3.0 + 0.8 * PI, 0.8, (4.6, 0.0)),
        ] {
            assert!((path.length() - length).abs() < 2e-3 * length, "{} {length}", path.length());
            let last = path.points().last().unwrap().pose;
            assert!((last.translation() - Vector2::new(end.0, end.1)).norm() < 1e-9, "{last:?}");
            assert!(spacing_of(&path) <= 0.05 + 1e-12);
            // A cusp is no bend.
            let bends =
                if path.points().iter().any(|p| p.gear == Gear::Reverse) { 1.0 / radius } else { tightest(&path) };
            assert!((bends - 1.0 / radius).abs() < 0.01, "{bends} {radius}");
        }
    }

    /// Between arcs that meet there is no line: what rounding leaves of it would point anywhere.
    #[test]
    fn arcs_that_meet_have_no_crumbs_between_them() {
        for k in 0..200 {
            let (shift, turn) = (0.37 * f64::from(k), 0.1 * f64::from(k));
            let place = Se2::new(shift, -shift, turn);
            let corners = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.2), (0.0, 1.2)]
                .map(|(x, y)| (place * Se2::new(x, y, 0.0)).translation());
            let path = rounded(&corners, 0.6, 0.05).unwrap();
            let least = path.points().windows(2).map(|w| (w[1].pose.translation() - w[0].pose.translation()).norm());
            assert!(least.fold(f64::INFINITY, f64::min) > 1e-3, "{k}");
            assert!(tightest(&path) < 1.0 / 0.6 + 0.05, "{k}: {}", tightest(&path));
        }
    }

    #[test]
    fn the_way_into_the_bay_has_one_cusp_and_arrives_turned_about() {
        let path = reverse_into_bay(1.5, 0.8, 0.02).unwrap();
        let quality = PathQuality::of(&path, PathQualityParams::default(), |_| 1.0).unwrap();
        assert_eq!(quality.cusps, 1);
        assert!(path.points().last().unwrap().pose.yaw().abs() > PI - 1e-9);
        // Each pose is tangent to the way, in its gear.
        for pair in path.points().windows(2) {
            let chord = pair[0].pose.between(&pair[1].pose).translation();
            let ahead = if pair[1].gear == Gear::Forward { chord.x } else { -chord.x };
            assert!(ahead > 0.0 && chord.y.abs() < 0.02 * ahead, "{chord}");
        }
    }

    proptest! {
        /// Rounded ways stay between their waypoints' lines, keep the ends, and bend no tighter than asked where there is room.
        #[test]
        fn corners_are_rounded_on_the_inside(turns in prop::collection::vec((-3.0..3.0_f64, 0.3..4.0_f64), 1..8)) {
            let (mut at, mut yaw) = (Vector2::new(1.0, -2.0), 0.0_f64);
            let mut waypoints = vec![at];
            for (turn, ahead) in turns {
                yaw += turn;
                at += Vector2::new(yaw.cos(), yaw.sin()) * ahead;
                waypoints.push(at);
            }
            let path = rounded(&waypoints, 0.6, 0.02).unwrap();
            let straight = Path::from_positions(&waypoints).unwrap();
            prop_assert!(path.length() <= straight.length() + 1e-9 && spacing_of(&path) <= 0.02 + 1e-9);
            let (first, last) = (path.points()[0].pose, path.points().last().unwrap().pose);
            prop_assert!((first.translation() - waypoints[0]).norm() < 1e-12);
            prop_assert!((last.translation() - at).norm() < 1e-9);
        }
    }

    #[test]
    fn an_aisle_has_corners_of_its_radius() {
        let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (8.0, 3.0)].map(|(x, y)| Vector2::new(x, y));
        let path = rounded(&corners, 0.6, 0.02).unwrap();
        assert!((tightest(&path) - 1.0 / 0.6).abs() < 0.1, "{}", tightest(&path));
        assert!((path.length() - (11.0 - 4.0 * 0.6 + 0.6 * PI)).abs() < 1e-3);
        // Too little room for the arcs: they are tightened, and the way still arrives.
        let narrow = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.5), (2.0, 0.5)].map(|(x, y)| Vector2::new(x, y));
        let path = rounded(&narrow, 0.6, 0.01).unwrap();
        assert!((tightest(&path) - 1.0 / 0.25).abs() < 0.2, "{}", tightest(&path));
    }

    #[test]
    fn bad_shapes_are_refused() {
        let two = [Vector2::zeros(), Vector2::new(1.0, 0.0)];
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            for refused in [
                line(bad, 0.1).is_err(),
                line(1.0, bad).is_err(),
                s_curve(bad, 1.0, 0.1).is_err(),
                lemniscate(bad, 0.1).is_err(),
                lemniscate(1.0, bad).is_err(),
                rounded(&two, bad, 0.1).is_err(),
                rounded(&two, 0.5, bad).is_err(),
                reverse_into_bay(bad, 1.0, 0.1).is_err(),
                reverse_into_bay(1.0, bad, 0.1).is_err(),
                reverse_into_bay(1.0, 1.0, bad).is_err(),
            ] {
                assert!(refused, "{bad}");
            }
        }
        assert!(s_curve(1.0, f64::NAN, 0.1).is_err() && line(1e3, 1e-9).is_err());
        assert!(rounded(&two[..1], 0.5, 0.1).is_err() && rounded(&[], 0.5, 0.1).is_err());
        assert!(rounded(&[two[0], two[0]], 0.5, 0.1).is_err());
        assert!(rounded(&[two[0], Vector2::new(f64::NAN, 0.0)], 0.5, 0.1).is_err());
        // There and back is no corner that an arc could round.
        assert!((rounded(&[two[0], two[1], two[0]], 0.5, 0.1).unwrap().length() - 2.0).abs() < 1e-9);
    }
}
