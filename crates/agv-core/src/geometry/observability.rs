//! Directions along which measurements do not fix a pose: a long corridor, an open field, a single wall.
//!
//! The information `Λ` of a match is (nearly) singular along them, and has no inverse to serve as a covariance. With
//! `S = diag(σ)` of standard deviations that the caller calls "as good as unknown", the eigenvalues of `S Λ S` compare
//! metres with radians: one below 1 belongs to a direction whose standard deviation exceeds its `σ` (the eigen-analysis of
//! Zhang, Kaess and Singh, *On degeneracy of optimization-based state estimation problems*, 2016, with a threshold that has
//! a unit).

use super::LieGroup;
use crate::{Error, check};

/// Standard deviations of a pose beyond which a direction counts as not observed.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PoseSigma {
    /// Of the position, in metres.
    pub translation: f64,
    /// Of the attitude, in radians.
    pub rotation: f64,
}

impl Default for PoseSigma {
    /// What odometry and a guess know better without any match, within seconds: 1 m and 0.5 rad.
    fn default() -> Self {
        Self { translation: 1.0, rotation: 0.5 }
    }
}

impl PoseSigma {
    /// Accepts standard deviations that are finite and positive.
    ///
    /// # Errors
    /// [`Error::NotPositive`].
    pub fn checked(self) -> Result<Self, Error> {
        check::positive("translation", self.translation)?;
        check::positive("rotation", self.rotation)?;
        Ok(self)
    }

    /// `σ` of each entry of a tangent.
    fn of_entry<G: LieGroup>(self, entry: usize) -> f64 {
        if entry < G::TRANSLATION_DOF { self.translation } else { self.rotation }
    }

    /// Eigenvalues of `S Λ S`, and the directions `S v` that belong to them.
    fn spectrum<G: LieGroup>(self, information: &G::Matrix) -> Result<(G::Tangent, G::Matrix), Error> {
        self.checked()?;
        check::all_finite("information", G::matrix_slice(information))?;
        let scale = diagonal::<G>(|entry| self.of_entry::<G>(entry));
        let scaled = scale * *information * scale;
        let (values, vectors) =
            G::symmetric_eigen(&scaled).ok_or(Error::NotFinite { name: "information", value: f64::INFINITY })?;
        // Against the greatest eigenvalue: what was projected out of a large information leaves its rounding behind.
        let (least, greatest) = G::tangent_slice(&values)
            .iter()
            .fold((0.0_f64, 0.0_f64), |(least, greatest), v| (least.min(*v), greatest.max(*v)));
        let skew = scaled - G::transpose(&scaled);
        let asymmetry = G::matrix_slice(&skew).iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        if least < -ROUNDING * greatest || asymmetry > ROUNDING * greatest {
            return Err(Error::NotCovariance { name: "information", pivot: least.min(-asymmetry) });
        }
        Ok((values, scale * vectors))
    }
}

/// Rounding that an information may carry, relative to its greatest eigenvalue.
const ROUNDING: f64 = 1e-9;

/// A diagonal tangent-space matrix.
fn diagonal<G: LieGroup>(entry: impl Fn(usize) -> f64) -> G::Matrix {
    let mut entries = [0.0; 36];
    for i in 0..G::DOF {
        entries[i * (G::DOF + 1)] = entry(i);
    }
    G::matrix_from_slice(&entries[..G::DOF * G::DOF])
}

/// Column of a tangent-space matrix.
fn column<G: LieGroup>(matrix: &G::Matrix, index: usize) -> G::Tangent {
    G::tangent_from_slice(&G::matrix_slice(matrix)[index * G::DOF..(index + 1) * G::DOF])
}

fn dot<G: LieGroup>(a: &G::Tangent, b: &G::Tangent) -> f64 {
    G::tangent_slice(a).iter().zip(G::tangent_slice(b)).map(|(a, b)| a * b).sum()
}

/// The projector `P = Σ u uᵀ` onto the directions in which `information` leaves a standard deviation above `sigma`; zero
/// if there are none. The `u` are orthonormal tangents (metres and radians as they come); their number is the trace.
///
/// ```
/// use agv_core::geometry::{PoseSigma, Se2, unobserved_directions};
/// use agv_core::nalgebra::{Matrix3, Vector3};
///
/// // A corridor along x: sideways to 1 cm, heading to 0.01 rad, lengthwise to 10 m.
/// let corridor = Matrix3::from_diagonal(&Vector3::new(1e-2, 1e4, 1e4));
/// let projector = unobserved_directions::<Se2>(&corridor, PoseSigma::default())?;
/// assert!((projector - Matrix3::from_diagonal(&Vector3::x())).norm() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::NotPositive`] for a `sigma`; [`Error::NotFinite`] or [`Error::NotCovariance`] for an information that is not
/// symmetric and positive semi-definite.
pub fn unobserved_directions<G: LieGroup>(information: &G::Matrix, sigma: PoseSigma) -> Result<G::Matrix, Error> {
    let (values, directions) = sigma.spectrum::<G>(information)?;
    let mut basis = [G::tangent_from_slice(&[]); 6];
    let (mut count, mut projector) = (0, diagonal::<G>(|_| 0.0));
    for (index, &value) in G::tangent_slice(&values).iter().enumerate() {
        if value < 1.0 {
            // Orthogonal in the metric of S; once more in that of the tangents, twice against rounding.
            let mut u = column::<G>(&directions, index);
            for _ in 0..2 {
                for v in &basis[..count] {
                    u = u - *v * dot::<G>(&u, v);
                }
                u = u * (1.0 / dot::<G>(&u, &u).sqrt());
            }
            basis[count] = u;
            count += 1;
            projector = projector + G::outer(&u, &u);
        }
    }
    Ok(projector)
}

/// `(I - P) Λ (I - P)`: the information without what it says along the directions of the projector `unobserved`. What a
/// pose graph or an information filter should take from a match: it adds nothing where nothing was seen.
pub fn observed_information<G: LieGroup>(information: &G::Matrix, unobserved: &G::Matrix) -> G::Matrix {
    let keep = G::identity_matrix() - *unobserved;
    let reduced = keep * *information * keep;
    (reduced + G::transpose(&reduced)) * 0.5
}

/// The inverse of an information that may be singular, with the standard deviation of each direction bounded by `sigma`.
///
/// Where the information is good this is its inverse. Where it is not, the variance is the caller's `sigma` and *not*
/// knowledge: a filter that takes such a covariance again and again gains `1 / σ²` each time along a direction that no
/// measurement saw. Choose `sigma` well above what the filter knows already, or hand over the information itself
/// ([`observed_information`]).
///
/// ```
/// use agv_core::geometry::{PoseSigma, Se2, bounded_covariance};
/// use agv_core::nalgebra::{Matrix3, Vector3};
///
/// let corridor = Matrix3::from_diagonal(&Vector3::new(0.0, 1e4, 1e4));
/// let covariance = bounded_covariance::<Se2>(&corridor, PoseSigma { translation: 20.0, rotation: 1.0 })?;
/// assert!((covariance[(0, 0)] - 400.0).abs() < 1e-9 && (covariance[(1, 1)] - 1e-4).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// As [`unobserved_directions`].
pub fn bounded_covariance<G: LieGroup>(information: &G::Matrix, sigma: PoseSigma) -> Result<G::Matrix, Error> {
    let (values, directions) = sigma.spectrum::<G>(information)?;
    let values = G::tangent_slice(&values).iter().enumerate();
    Ok(values.fold(diagonal::<G>(|_| 0.0), |sum, (index, value)| {
        let u = column::<G>(&directions, index);
        sum + G::outer(&u, &u) * (1.0 / value.max(1.0))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Se2, Se3};
    use nalgebra::{Matrix2x3, Matrix3, Matrix6, Vector2, Vector3, Vector6};

    /// Information of points on walls, each of which sees the pose along its normal only, to 1 cm.
    fn walls(points: &[(f64, f64, f64)]) -> Matrix3<f64> {
        points.iter().fold(Matrix3::zeros(), |sum, &(x, y, normal): &(f64, f64, f64)| {
            let normal = Vector2::new(normal.cos(), normal.sin());
            let act: Matrix2x3<f64> = Se2::default().act_jacobians(&Vector2::new(x, y)).0;
            let row = normal.transpose() * act;
            sum + row.transpose() * row * 1e4
        })
    }

    #[test]
    fn a_corridor_at_any_angle_hides_its_axis_alone() {
        for angle in [0.0, 0.4, 1.3, -2.0_f64] {
            let (sin, cos) = angle.sin_cos();
            // Both walls, 2 m to either side, seen for 5 m.
            let at = |along: f64, aside: f64| {
                (cos * along - sin * aside, sin * along + cos * aside, angle + std::f64::consts::FRAC_PI_2)
            };
            let points: Vec<_> = (0..20).map(|i| at(0.5 * f64::from(i / 2) - 2.0, f64::from(i % 2 * 4 - 2))).collect();
            let information = walls(&points);
            let projector = unobserved_directions::<Se2>(&information, PoseSigma::default()).unwrap();
            let axis = Vector3::new(cos, sin, 0.0);
            assert!((projector - axis * axis.transpose()).norm() < 1e-5, "{angle}: {projector}");
            let observed = observed_information::<Se2>(&information, &projector);
            assert!((observed * axis).norm() < 1e-6 && (observed - information).norm() < 1e-3 * information.norm());
            let sigma = PoseSigma { translation: 30.0, rotation: 3.0 };
            let covariance = bounded_covariance::<Se2>(&observed, sigma).unwrap();
            assert!((axis.dot(&(covariance * axis)) - 900.0).abs() < 1.0);
            let across = Vector3::new(-sin, cos, 0.0);
            let expected = 1e-4 / 20.0;
            assert!((across.dot(&(covariance * across)) - expected).abs() < 0.1 * expected, "{covariance}");
        }
    }

    #[test]
    fn a_turn_about_a_post_mixes_metres_and_radians() {
        // A round post at (3, 0): its position is seen, but the vehicle may circle it.
        let information = walls(&[(3.0, 0.0, 0.0), (3.0, 0.0, 1.0), (3.0, 0.0, 2.0)]);
        let projector = unobserved_directions::<Se2>(&information, PoseSigma::default()).unwrap();
        let circling = Vector3::new(0.0, -3.0, 1.0).normalize();
        assert!((projector - circling * circling.transpose()).norm() < 1e-9, "{projector}");
    }

    /// A sharp match of many points, one direction of which was projected out: what is left of it is rounding, of either sign.
    #[test]
    fn rounding_of_a_large_information_is_none() {
        let direction = Vector6::new(0.99, 0.01, -0.02, 0.003, -0.001, 0.004).normalize();
        let root = Matrix6::from_fn(|i, j| f64::from(u8::from(i == j)) * 1e5 + 3e4 * ((i * 7 + j) as f64).sin());
        let projector = direction * direction.transpose();
        let observed = observed_information::<Se3>(&(root * root.transpose()), &projector);
        let covariance = bounded_covariance::<Se3>(&observed, PoseSigma { translation: 10.0, rotation: 10.0 }).unwrap();
        assert!((direction.dot(&(covariance * direction)) - 100.0).abs() < 1.0, "{covariance}");
    }

    #[test]
    fn good_information_is_inverted_and_none_is_bounded() {
        let root = Matrix6::from_fn(|i, j| f64::from(u8::from(i == j)) * 30.0 + ((i * 7 + j) as f64).sin());
        let information = root * root.transpose();
        let sigma = PoseSigma::default();
        assert_eq!(unobserved_directions::<Se3>(&information, sigma).unwrap(), Matrix6::zeros());
        let inverse = Se3::inverse_of(&information).unwrap();
        assert!((bounded_covariance::<Se3>(&information, sigma).unwrap() - inverse).norm() < 1e-12);
        let nothing = Matrix6::zeros();
        assert!((unobserved_directions::<Se3>(&nothing, sigma).unwrap() - Matrix6::identity()).norm() < 1e-12);
        let expected = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 0.25, 0.25, 0.25));
        assert!((bounded_covariance::<Se3>(&nothing, sigma).unwrap() - expected).norm() < 1e-12);
    }

    #[test]
    fn bad_input_is_named() {
        let (good, unit) = (PoseSigma::default(), Matrix3::identity());
        for bad in [PoseSigma { translation: 0.0, ..good }, PoseSigma { rotation: f64::NAN, ..good }] {
            assert!(matches!(unobserved_directions::<Se2>(&unit, bad), Err(Error::NotPositive { .. })));
            assert!(matches!(bounded_covariance::<Se2>(&unit, bad), Err(Error::NotPositive { .. })));
        }
        assert!(matches!(bounded_covariance::<Se2>(&(unit * f64::NAN), good), Err(Error::NotFinite { .. })));
        assert!(matches!(unobserved_directions::<Se2>(&-unit, good), Err(Error::NotCovariance { .. })));
        let huge = bounded_covariance::<Se2>(&(unit * 1e308), PoseSigma { translation: 1e6, rotation: 1e6 });
        assert!(matches!(huge, Err(Error::NotFinite { .. })));
    }
}
