//! The pose of a vehicle on its floor from the pixels of points that are known in space: corners of tags on walls, racks,
//! ceilings or the floor.
//!
//! A single tag seen from afar fits two poses of the camera almost equally, tilted to one side or the other (the flips of
//! `AprilTag`'s issue 71; Schweighofer and Pinz 2006). A vehicle does not tilt: with three unknowns instead of six every corner
//! counts towards heading and place, and the problem is linear in `c = cos θ`, `s = sin θ` and `u = -Rᵀ t`. With `P` a point in
//! the map, the camera at `t_c` with the axes `R_c` on the vehicle, and `(x, y)` the ray of its pixel,
//!
//! ```text
//! P_b = (c X + s Y + u_x, -s X + c Y + u_y, Z)        a · (P_b - t_c) = 0,   a = x m3 - m1 and y m3 - m2
//! ```
//!
//! where `m1`, `m2`, `m3` are the rows of `R_cᵀ`. `u` is eliminated, and what is left is a quadratic form on the circle
//! `c² + s² = 1`, whose two minima at most are all the poses there can be. Both are refined by Levenberg–Marquardt on the pixels;
//! the worse one is handed out, too, with how well it fits.

use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, Se3, UncertainPose},
    sensors::PinholeCamera,
    solve::{LeastSquares, LevenbergMarquardt, LevenbergMarquardtParams, NormalEquations},
};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Matrix4, SVector, Vector2, Vector3, Vector4};
use std::f64::consts::TAU;

/// A point that is known, and where it is in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PixelOf {
    /// The point in the map, in metres, z above the floor.
    pub point: Vector3<f64>,
    /// Where it is seen, in pixels.
    pub pixel: Vector2<f64>,
}

/// A pose that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resection {
    /// Pose of the vehicle in the map, with the covariance that the pixel noise leaves.
    pub map_from_base: UncertainPose<Se2>,
    /// Squared residuals by the pixels' variance: chi-square of `2 points - 3` degrees of freedom.
    pub chi_square: f64,
    /// Another pose that the pixels allow, and its squared residuals: as likely by a factor of `exp(½ difference)` less.
    pub alternative: Option<(Se2, f64)>,
}

/// Angles at which the quadratic form on the circle is looked at for minima; it has two periods at most.
const SAMPLES: usize = 64;

/// The pose on the floor from which a camera at `base_from_camera` sees two or more points at their pixels, each within
/// `pixel_sigma` pixels along each axis. No guess is needed. O(points), no allocation.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2, Se3, So3};
/// use agv_core::nalgebra::{Vector2, Vector3};
/// use agv_core::sensors::{PinholeCamera, PinholeParams};
/// use agv_filters::marker::{PixelOf, resect};
/// use std::f64::consts::FRAC_PI_2;
///
/// let camera = PinholeCamera::new(PinholeParams::default())?;
/// let ahead = So3::from_roll_pitch_yaw(-FRAC_PI_2, 0.0, -FRAC_PI_2);
/// let mount = Se3::from_parts(Vector3::new(0.3, 0.0, 0.5), ahead);
/// // The corners of a tag of 20 cm on a wall, and a vehicle that looks at it from the side.
/// let corners = [(-0.1, 0.4), (0.1, 0.4), (0.1, 0.6), (-0.1, 0.6)].map(|(y, z)| Vector3::new(5.0, y, z));
/// let truth = Se2::new(3.5, -0.8, 0.4);
/// let camera_from_map = (Se3::from(truth) * mount).inverse();
/// let seen = corners.map(|point| PixelOf { point, pixel: camera.project(&camera_from_map.act(&point)).expect("in sight") });
/// let found = resect(&camera, &mount, &seen, 0.5)?;
/// assert!(found.map_from_base.mean().minus(&truth).norm() < 1e-6);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::TooFew`] below two points; a number that is not finite, a deviation that is not positive, a pixel that no ray is
/// seen at ([`Error::NotFinite`]); [`Error::Singular`] if the points leave the pose open or no pose shows all of them.
pub fn resect(
    camera: &PinholeCamera,
    base_from_camera: &Se3,
    points: &[PixelOf],
    pixel_sigma: f64,
) -> Result<Resection, Error> {
    check::at_least("points", points.len(), 2)?;
    check::positive("pixel_sigma", pixel_sigma)?;
    if !base_from_camera.is_finite() {
        return Err(Error::NotFinite { name: "base_from_camera", value: f64::NAN });
    }
    for entry in points {
        check::all_finite("point", entry.point.iter())?;
        check::all_finite("pixel", entry.pixel.iter())?;
    }
    let mut problem =
        Reprojection { camera, camera_from_base: base_from_camera.inverse(), points, weight: pixel_sigma.powi(-2) };
    let solver = LevenbergMarquardt::new(LevenbergMarquardtParams { step_tolerance: 1e-11, ..Default::default() })?;
    let mut found: [Option<(UncertainPose<Se2>, f64)>; 2] = [None; 2];
    for start in starts(camera, base_from_camera, points)?.into_iter().flatten() {
        if !problem.cost(&start).is_finite() {
            continue; // a point would be behind the camera
        }
        let minimum = solver.minimize(&mut problem, start)?;
        let Some(covariance) = Se2::inverse_of(&minimum.normal.hessian) else { continue };
        let fit = (UncertainPose::new(minimum.state, covariance)?, 2.0 * minimum.normal.cost);
        match &mut found {
            [None, _] => found[0] = Some(fit),
            // Both starts may lead to one minimum.
            [Some((first, _)), second] if fit.0.mean().minus(first.mean()).norm() > 1e-6 => *second = Some(fit),
            _ => {}
        }
    }
    found.sort_by(|a, b| a.map_or(f64::INFINITY, |a| a.1).total_cmp(&b.map_or(f64::INFINITY, |b| b.1)));
    let [best, other] = found;
    let (map_from_base, chi_square) = best.ok_or(Error::Singular { name: "resection", row: 0, pivot: 0.0 })?;
    Ok(Resection { map_from_base, chi_square, alternative: other.map(|(pose, chi_square)| (*pose.mean(), chi_square)) })
}

/// The minima of the linear problem on the circle, at most two.
fn starts(camera: &PinholeCamera, base_from_camera: &Se3, points: &[PixelOf]) -> Result<[Option<Se2>; 2], Error> {
    let (rows, eye) = (base_from_camera.rotation().matrix().transpose(), base_from_camera.translation());
    // Around the points' middle, for the sake of the digits.
    let middle = points.iter().map(|entry| entry.point.xy()).sum::<Vector2<f64>>() / points.len() as f64;
    let (mut matrix, mut vector) = (Matrix4::zeros(), Vector4::zeros());
    for entry in points {
        let ray = camera.ray(&entry.pixel).ok_or(Error::NotFinite { name: "ray of the pixel", value: f64::NAN })?;
        let point = entry.point.xy() - middle;
        for (axis, coordinate) in [ray.x, ray.y].into_iter().enumerate() {
            let a = (rows.row(2) * coordinate - rows.row(axis)).transpose();
            let row = Vector4::new(a.x * point.x + a.y * point.y, a.x * point.y - a.y * point.x, a.x, a.y);
            matrix += row * row.transpose();
            vector += row * (a.dot(&eye) - a.z * entry.point.z);
        }
    }
    let block = |i, j| -> Matrix2<f64> { matrix.fixed_view::<2, 2>(i, j).into_owned() };
    let (across, sides) = (block(0, 2), vector.fixed_rows::<2>(2).into_owned());
    let singular = Error::Singular { name: "resection", row: 2, pivot: block(2, 2).determinant() };
    let inverse = block(2, 2).try_inverse().ok_or(singular)?;
    let form = block(0, 0) - across * inverse * across.transpose();
    let slope = vector.fixed_rows::<2>(0) - across * inverse * sides;
    let direction = |sample: usize| {
        let angle = TAU * sample as f64 / SAMPLES as f64;
        Vector2::new(angle.cos(), angle.sin())
    };
    let value = |sample: usize| {
        let v = direction(sample % SAMPLES);
        v.dot(&(form * v)) - 2.0 * slope.dot(&v)
    };
    let mut found = [None; 2];
    let is_least = |&sample: &usize| value(sample) < value(sample + 1) && value(sample) <= value(sample + SAMPLES - 1);
    for (slot, sample) in found.iter_mut().zip((0..SAMPLES).filter(is_least)) {
        let v = direction(sample);
        let u = inverse * (sides - across.transpose() * v);
        // t = -R u.
        let place = middle - Vector2::new(v.x * u.x - v.y * u.y, v.y * u.x + v.x * u.y);
        *slot = Some(Se2::new(place.x, place.y, v.y.atan2(v.x)));
    }
    Ok(found)
}

/// The distances of the points' images from their pixels.
struct Reprojection<'a> {
    camera: &'a PinholeCamera,
    camera_from_base: Se3,
    points: &'a [PixelOf],
    weight: f64,
}

impl Reprojection<'_> {
    /// None for a point that is not seen.
    fn residual(&self, pose: &Se2, entry: &PixelOf) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let planar = pose.inverse().act(&entry.point.xy());
        let in_base = Vector3::new(planar.x, planar.y, entry.point.z);
        let (pixel, by_point) = self.camera.project_with_jacobian(&self.camera_from_base.act(&in_base))?;
        // X ⊕ τ moves the point in the base frame by -τ_xy - τ_θ × P_b.
        let by_increment = Matrix3::new(-1.0, 0.0, in_base.y, 0.0, -1.0, -in_base.x, 0.0, 0.0, 0.0);
        Some((pixel - entry.pixel, by_point * self.camera_from_base.rotation().matrix() * by_increment))
    }
}

impl LeastSquares<3> for Reprojection<'_> {
    type State = Se2;

    fn linearize(&mut self, pose: &Se2, normal: &mut NormalEquations<3>) {
        for entry in self.points {
            if let Some((residual, jacobian)) = self.residual(pose, entry) {
                normal.add(&residual, &jacobian, self.weight);
            }
        }
    }

    fn cost(&mut self, pose: &Se2) -> f64 {
        let squared = |entry| self.residual(pose, entry).map_or(f64::INFINITY, |(r, _)| r.norm_squared());
        0.5 * self.weight * self.points.iter().map(squared).sum::<f64>()
    }

    fn retract(&self, pose: &Se2, step: &SVector<f64, 3>) -> Se2 {
        pose.plus(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        compute::{Seed, Stream},
        geometry::So3,
        sensors::{LensDistortion, PinholeParams},
    };
    use proptest::prelude::*;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::FRAC_PI_2;

    fn camera() -> PinholeCamera {
        let distortion = LensDistortion { radial: [-0.2, 0.05, 0.0], tangential: [1e-4, 2e-4] };
        PinholeCamera::new(PinholeParams { distortion, ..Default::default() }).unwrap()
    }

    /// A camera that looks ahead and 10° up.
    fn mount() -> Se3 {
        let ahead = So3::from_roll_pitch_yaw(0.0, -0.17, 0.0) * So3::from_roll_pitch_yaw(-FRAC_PI_2, 0.0, -FRAC_PI_2);
        Se3::from_parts(Vector3::new(0.3, 0.05, 0.6), ahead)
    }

    /// The corners of a square tag on the wall at x = 5 m.
    fn tag(y: f64, z: f64, edge: f64) -> Vec<Vector3<f64>> {
        let half = 0.5 * edge;
        [(-half, -half), (half, -half), (half, half), (-half, half)]
            .map(|(a, b)| Vector3::new(5.0, y + a, z + b))
            .to_vec()
    }

    fn seen(truth: &Se2, points: &[Vector3<f64>], noise: Option<&mut Stream>) -> Vec<PixelOf> {
        let camera_from_map = (Se3::from(*truth) * mount()).inverse();
        let mut pixels: Vec<_> = points
            .iter()
            .map(|&point| PixelOf { point, pixel: camera().project(&camera_from_map.act(&point)).unwrap() })
            .collect();
        if let Some(stream) = noise {
            for entry in &mut pixels {
                entry.pixel += Vector2::from_fn(|_, _| {
                    let z: f64 = StandardNormal.sample(stream);
                    0.5 * z
                });
            }
        }
        pixels
    }

    proptest! {
        #[test]
        fn exact_pixels_give_the_pose(back in 1.0..3.0_f64, aside in -0.6..0.6_f64, yaw in -0.2..0.2_f64, z in 0.3..1.2_f64) {
            // Towards the tag, give or take.
            let truth = Se2::new(5.0 - back, aside, (-aside / back).atan() + yaw);
            let found = resect(&camera(), &mount(), &seen(&truth, &tag(0.0, z, 0.2), None), 0.5).unwrap();
            let alternative = found.alternative.map_or(f64::INFINITY, |(pose, _)| pose.minus(&truth).norm());
            let error = found.map_from_base.mean().minus(&truth).norm();
            prop_assert!(error < 1e-6 && found.chi_square < 1e-8, "{error} {alternative} {}", found.chi_square);
        }
    }

    /// NEES and squared residuals with two tags, over 2000 images, within 4.5 deviations.
    #[test]
    fn the_covariance_is_that_of_the_pixel_noise() {
        let (truth, n, mut stream) = (Se2::new(3.0, 0.2, 0.1), 2000_u32, Seed(3).stream(0, 0));
        let points = [tag(-0.4, 0.7, 0.25), tag(0.9, 1.1, 0.25)].concat();
        let (mut nees, mut residuals) = (0.0, 0.0);
        for _ in 0..n {
            let found = resect(&camera(), &mount(), &seen(&truth, &points, Some(&mut stream)), 0.5).unwrap();
            let error = found.map_from_base.mean().minus(&truth);
            nees += error.dot(&(Se2::inverse_of(found.map_from_base.covariance()).unwrap() * error));
            residuals += found.chi_square;
        }
        for (sum, freedom) in [(nees, 3.0), (residuals, 13.0)] {
            let mean = freedom * f64::from(n);
            assert!((sum - mean).abs() < 4.5 * (2.0 * mean).sqrt(), "{sum} {mean}");
        }
    }

    /// A small tag, far and head-on: the truth is one of the two poses that are handed out, and where the better one is the
    /// wrong one the two are said to be nearly as likely.
    #[test]
    fn a_flip_is_said_to_be_possible() {
        let (mut flips, mut stream) = (0, Seed(4).stream(0, 0));
        for i in 0..1000 {
            let truth = Se2::new(2.0, 0.002 * f64::from(i % 200) - 0.2, 0.0);
            let found =
                resect(&camera(), &mount(), &seen(&truth, &tag(0.0, 0.9, 0.12), Some(&mut stream)), 0.5).unwrap();
            let off = |pose: &Se2| pose.minus(&truth).z.abs();
            let best = off(found.map_from_base.mean());
            if let Some((pose, chi_square)) = found.alternative.filter(|(pose, _)| off(pose) < best) {
                flips += 1;
                assert!(off(&pose) < 0.4, "{pose:?}");
                assert!(chi_square - found.chi_square < 13.8, "as unlikely as one in a thousand");
            } else {
                assert!(best < 0.4, "{best}");
            }
        }
        assert!(flips > 0 && flips < 500, "{flips}");
    }

    #[test]
    fn bad_points_are_refused() {
        let good = seen(&Se2::new(3.0, 0.0, 0.0), &tag(0.0, 0.9, 0.2), None);
        let with = |points: &[PixelOf], sigma| resect(&camera(), &mount(), points, sigma);
        assert!(matches!(with(&good[..1], 0.5), Err(Error::TooFew { .. })));
        assert!(matches!(with(&[good[0]; 4], 0.5), Err(Error::Singular { .. })));
        for sigma in [0.0, f64::NAN, -1.0] {
            assert!(with(&good, sigma).is_err());
        }
        for bad in [
            PixelOf { pixel: Vector2::repeat(f64::NAN), ..good[0] },
            PixelOf { pixel: Vector2::repeat(1e9), ..good[0] },
            PixelOf { point: Vector3::repeat(f64::INFINITY), ..good[0] },
        ] {
            assert!(with(&[bad, good[1], good[2]], 0.5).is_err(), "{bad:?}");
        }
        let lost = Se3::from_parts(Vector3::repeat(f64::NAN), So3::default());
        assert!(resect(&camera(), &lost, &good, 0.5).is_err());
    }
}
