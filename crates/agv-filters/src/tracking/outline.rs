//! Where a thing is and how large, from the side of it that a scanner sees.
//!
//! The mean of the points is no place: it lies on the near side, and moves around the thing as the vehicle passes. A disc is
//! fitted instead, with what is known of its radius before:
//!
//! ```text
//! min Σ ((‖p_i - c‖ - ρ) / σ)² + ((ρ - ρ_0) / σ_0)²
//! ```
//!
//! by Gauss and Newton; the inverse of the normal equations' matrix is the covariance of centre and radius. The radius before is
//! that of the track, or half of the width that the scanner sees. What is no disc is described by its hull: what the disc misses by
//! more than 5 cm, and flat fronts that are seen whole, which it misses by more than the scatter of the points and a straight line by less than half of
//! that.

use agv_core::obstacle::Hull;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use std::f64::consts::FRAC_PI_4;

/// A thing's place and size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outline {
    /// Centre of the disc, or middle of what is seen, in metres.
    pub center: Vector2<f64>,
    /// Covariance of the centre, in square metres.
    pub covariance: Matrix2<f64>,
    /// Radius of the disc, or half of the width that is seen, in metres.
    pub radius: f64,
    /// Variance of the radius, in square metres.
    pub radius_variance: f64,
    /// The points' hull around the centre, along the axes of the map; none for a disc.
    pub hull: Option<Hull>,
}

/// Most points that a fit takes.
const MOST_POINTS: usize = 32;

/// Greatest root mean square distance of points from a disc that they are believed to show, in metres.
const ROUND: f64 = 0.05;

impl Outline {
    /// The outline of the points of a surface, as seen from `sensor`, all in one frame and in metres.
    ///
    /// `hidden` says that there may be more of it before the first or after the last point, `sigma` how far points scatter
    /// around a surface, and `radius` what is known of it, as mean and variance. None if there are no points, or numbers that
    /// are not finite. O(points), of which the fit takes 32 at most.
    pub fn of(
        points: &[Vector2<f64>],
        sensor: &Vector2<f64>,
        hidden: [bool; 2],
        sigma: f64,
        radius: Option<(f64, f64)>,
    ) -> Option<Self> {
        if points.is_empty() {
            return None;
        }
        let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
        let sight = (mean - sensor).try_normalize(1e-9)?;
        let across = Vector2::new(-sight.y, sight.x);
        let reach = |direction: &Vector2<f64>| {
            points
                .iter()
                .map(|p| (p - mean).dot(direction))
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), d| (low.min(d), high.max(d)))
        };
        let (left, right) = reach(&across);
        let half = 0.5 * (right - left);
        // A beam's width more than the outermost points show, on either side half of it.
        let spacing = if points.len() > 1 { half / (points.len() - 1) as f64 } else { sigma };
        let seen = half + spacing;
        let some_hidden = hidden[0] || hidden[1];
        let guess = if some_hidden {
            (seen.max(0.1), (0.5 * seen + 0.2).powi(2))
        } else {
            (seen, (0.15 * seen + spacing + sigma).powi(2))
        };
        let (known, variance) = radius.unwrap_or(guess);
        let disc = Self::disc(points, &(mean, sight), sigma, (known.max(1e-3), variance.max(1e-6)));
        // Of what is seen in part the ends move with who hides it: a disc is steadier.
        let is_flat = |rms: f64| rms > sigma && straightness(points, &mean) < 0.5 * rms;
        let is_round = |rms: f64| rms <= ROUND && (some_hidden || !is_flat(rms));
        disc.filter(|(_, rms)| is_round(*rms)).map(|(disc, _)| disc).or_else(|| {
            let (near, far) = reach(&sight);
            let center = mean + across * (0.5 * (left + right)) + sight * (0.5 * (near + far));
            let slack = 0.03 + 0.15 * half + if some_hidden { half } else { 0.0 };
            Some(Self {
                center,
                covariance: Matrix2::identity() * (slack * slack),
                radius: seen,
                radius_variance: (0.03 + 0.3 * half).powi(2),
                hull: Some(hull_around(points, &center)?),
            })
        })
    }

    /// The disc that fits best, and the root mean square distance of the points from it.
    fn disc(
        points: &[Vector2<f64>],
        (mean, sight): &(Vector2<f64>, Vector2<f64>),
        sigma: f64,
        (known, variance): (f64, f64),
    ) -> Option<(Self, f64)> {
        let stride = points.len().div_ceil(MOST_POINTS);
        let some = || points.iter().step_by(stride);
        let count = some().count() as f64;
        let weight = 1.0 / (sigma * sigma);
        let (mut center, mut radius) = (mean + sight * (0.7 * known), known);
        let mut information = Matrix3::zeros();
        let mut squares = 0.0;
        for round in 0..8 {
            information = Matrix3::zeros();
            let mut slope = Vector3::zeros();
            squares = 0.0;
            for point in some() {
                let away = point - center;
                let distance = away.norm().max(1e-9);
                let residual = distance - radius;
                let jacobian = Vector3::new(-away.x / distance, -away.y / distance, -1.0);
                information += jacobian * jacobian.transpose() * weight;
                slope += jacobian * (residual * weight);
                squares += residual * residual;
            }
            information[(2, 2)] += 1.0 / variance;
            slope[2] += (radius - known) / variance;
            let step = information.cholesky()?.solve(&slope);
            if round == 7 || step.norm() < 1e-5 {
                break;
            }
            // Not over the centre in one step.
            let step = step * (0.5 * radius / step.norm().max(1e-12)).min(1.0);
            center -= step.xy();
            radius = (radius - step[2]).max(0.25 * known);
        }
        let covariance = information.cholesky()?.inverse();
        let behind = (center - mean).dot(sight) > 0.0;
        let finite = center.iter().chain(covariance.iter()).all(|v| v.is_finite()) && radius.is_finite();
        let disc = Self {
            center,
            covariance: covariance.fixed_view::<2, 2>(0, 0).into_owned() + Matrix2::identity() * (0.25 * sigma * sigma),
            radius,
            radius_variance: covariance[(2, 2)],
            hull: None,
        };
        (behind && finite).then_some((disc, (squares / count).sqrt()))
    }
}

/// Root mean square distance of the points from the straight line that fits them best: that of least variance across it.
fn straightness(points: &[Vector2<f64>], mean: &Vector2<f64>) -> f64 {
    let spread = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum::<Matrix2<f64>>();
    let (half, difference) = (0.5 * spread.trace(), 0.5 * (spread[(0, 0)] - spread[(1, 1)]));
    ((half - difference.hypot(spread[(0, 1)])).max(0.0) / points.len() as f64).sqrt()
}

/// An octagon around the points, relative to their centre: every point lies in it.
fn hull_around(points: &[Vector2<f64>], center: &Vector2<f64>) -> Option<Hull> {
    let mut normals = [Vector2::zeros(); 8];
    let mut reach = [0.0_f64; 8];
    for (index, (normal, reach)) in normals.iter_mut().zip(&mut reach).enumerate() {
        let (sin, cos) = (index as f64 * FRAC_PI_4).sin_cos();
        *normal = Vector2::new(cos, sin);
        // A centimetre wide where the points lie on a line, so that the outline has an inside.
        let far = points.iter().map(|p| (p - center).dot(normal)).fold(f64::NEG_INFINITY, f64::max);
        *reach = far + 0.005;
    }
    let mut corners = [Vector2::zeros(); 8];
    let mut count = 0;
    for index in 0..8 {
        let next = (index + 1) % 8;
        let (a, b) = (normals[index], normals[next]);
        // The corner of two edges that stand at 45° to each other.
        let cross = a.x * b.y - a.y * b.x;
        let corner =
            Vector2::new(reach[index] * b.y - reach[next] * a.y, reach[next] * a.x - reach[index] * b.x) / cross;
        let apart = |other: &Vector2<f64>| (corner - other).norm() > 1e-6;
        if (count == 0 || apart(&corners[count - 1])) && (index < 7 || apart(&corners[0])) {
            corners[count] = corner;
            count += 1;
        }
    }
    Hull::new(&corners[..count]).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Points of the near side of a disc, as a scanner of a quarter of a degree at the origin sees it, with noise.
    fn seen(center: Vector2<f64>, radius: f64, noise: &[f64]) -> Vec<Vector2<f64>> {
        let middle = center.y.atan2(center.x);
        let beams = (0..noise.len()).map(|i| middle + (i as f64 - 0.5 * noise.len() as f64) * 0.25_f64.to_radians());
        beams
            .zip(noise)
            .filter_map(|(angle, noise)| {
                let direction = Vector2::new(angle.cos(), angle.sin());
                let along = center.dot(&direction);
                let inside = radius * radius - (center.norm_squared() - along * along);
                (inside > 0.0).then(|| direction * (along - inside.sqrt() + noise))
            })
            .collect()
    }

    proptest! {
        /// The fit errs by no more than a few of the deviations that it states, whichever side is seen.
        #[test]
        fn a_disc_is_found_from_its_near_side(
            x in 2.0..6.0_f64, y in -5.0..5.0_f64, radius in 0.2..0.6_f64,
            noise in prop::collection::vec(-0.015..0.015_f64, 200),
        ) {
            let center = Vector2::new(x, y);
            let points = seen(center, radius, &noise);
            let outline = Outline::of(&points, &Vector2::zeros(), [false; 2], 0.02, None).unwrap();
            prop_assert!(outline.hull.is_none());
            let error = outline.center - center;
            let nees = error.dot(&(outline.covariance.try_inverse().unwrap() * error));
            prop_assert!(nees < 16.0 && error.norm() < 0.08, "{} {}", nees, error.norm());
            prop_assert!((outline.radius - radius).abs() < 0.08);
        }

        /// Fronts of carts and ends of racks, however they stand: a hull, as wide as they are.
        #[test]
        fn a_flat_front_is_no_disc(
            x in 2.0..5.0_f64, width in 0.6..1.6_f64, turn in -0.7..0.7_f64,
            noise in prop::collection::vec(-0.015..0.015_f64, 400),
        ) {
            let (middle, along) = (Vector2::new(x, 0.3), Vector2::new(turn.sin(), turn.cos()));
            let ahead = Vector2::new(along.y, -along.x);
            let points: Vec<_> = (0..400)
                .zip(&noise)
                .filter_map(|(i, noise)| {
                    let (sin, cos) = ((f64::from(i) - 200.0) * 0.25_f64.to_radians()).sin_cos();
                    let direction = Vector2::new(cos, sin);
                    let range = middle.dot(&ahead) / direction.dot(&ahead);
                    let point = direction * range;
                    ((point - middle).dot(&along).abs() < 0.5 * width).then(|| direction * (range + noise))
                })
                .collect();
            let outline = Outline::of(&points, &Vector2::zeros(), [false; 2], 0.02, None).unwrap();
            let hull = outline.hull.unwrap();
            prop_assert!(points.iter().all(|p| hull.distance(&(p - outline.center)) <= 0.0));
        }

        #[test]
        fn a_hull_holds_its_points(points in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64), 1..30)) {
            let points: Vec<_> = points.into_iter().map(|(x, y)| Vector2::new(x + 5.0, y)).collect();
            let hull = hull_around(&points, &Vector2::new(5.0, 0.0)).unwrap();
            for point in &points {
                prop_assert!(hull.distance(&(point - Vector2::new(5.0, 0.0))) <= 0.0);
            }
        }
    }

    #[test]
    fn what_is_no_surface_has_no_outline() {
        assert_eq!(Outline::of(&[], &Vector2::zeros(), [false; 2], 0.02, None), None);
        assert_eq!(Outline::of(&[Vector2::zeros()], &Vector2::zeros(), [false; 2], 0.02, None), None);
        assert_eq!(Outline::of(&[Vector2::new(f64::NAN, 0.0)], &Vector2::zeros(), [false; 2], 0.02, None), None);
    }
}
