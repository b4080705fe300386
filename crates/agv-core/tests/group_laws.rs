//! One battery of laws, run over every group: group axioms, exponential and logarithm, adjoint, and every analytic
//! Jacobian against numeric differentiation.

use agv_core::geometry::{LieGroup, Se2, Se3, So2, So3};
use agv_core::nalgebra::{Isometry2, Isometry3, UnitComplex, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;
use std::f64::consts::PI;

/// Relative error that every law may show.
const TOLERANCE: f64 = 1e-8;

/// What the battery needs to know of a group beyond [`LieGroup`].
trait Case: LieGroup {
    /// Entries of a tangent that rotate; they come last.
    const ROTATION: usize;
    fn point(entries: &[f64; 3]) -> Self::Point;
    fn point_entries(point: &Self::Point) -> Vec<f64>;
    /// Both Jacobians of `act`, column by column.
    fn act_columns(&self, point: &Self::Point) -> (Vec<f64>, Vec<f64>);
}

macro_rules! case {
    ($group:ty, $rotation:literal, $dimension:literal, $point:ty) => {
        impl Case for $group {
            const ROTATION: usize = $rotation;
            fn point(entries: &[f64; 3]) -> Self::Point {
                <$point>::from_column_slice(&entries[..$dimension])
            }
            fn point_entries(point: &Self::Point) -> Vec<f64> {
                point.as_slice().to_vec()
            }
            fn act_columns(&self, point: &Self::Point) -> (Vec<f64>, Vec<f64>) {
                let (motion, moved) = self.act_jacobians(point);
                (motion.as_slice().to_vec(), moved.as_slice().to_vec())
            }
        }
    };
}
case!(So2, 1, 2, Vector2<f64>);
case!(Se2, 1, 2, Vector2<f64>);
case!(So3, 3, 3, Vector3<f64>);
case!(Se3, 3, 3, Vector3<f64>);

/// Tangents with turns of all sizes up to `max_turn`: none, tiny, ordinary and close to the limit.
fn tangent<G: Case>(max_turn: f64) -> impl Strategy<Value = G::Tangent> {
    let turn = prop_oneof![
        1 => Just(0.0),
        3 => (-12.0..0.0_f64).prop_map(|e| 10_f64.powf(e)),
        3 => 0.0..1.0_f64,
        2 => (-9.0..-1.0_f64).prop_map(|e| 1.0 - 10_f64.powf(e)),
    ];
    (prop::array::uniform6(-1.0..1.0_f64), turn).prop_map(move |(mut entries, turn)| {
        let split = G::DOF - G::ROTATION;
        let size = norm(&entries[split..G::DOF]).max(1e-3);
        entries[split..G::DOF].iter_mut().for_each(|v| *v *= turn * max_turn / size);
        entries[..split].iter_mut().for_each(|v| *v *= 5.0);
        G::tangent_from_slice(&entries[..G::DOF])
    })
}

fn element<G: Case>() -> impl Strategy<Value = G> {
    tangent::<G>(PI).prop_map(|t| G::exp(&t))
}

fn norm(entries: &[f64]) -> f64 {
    entries.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Distance between two vectors, relative to the size of the first where that is above one.
fn error(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let difference: Vec<f64> = a.iter().zip(b).map(|(x, y)| x - y).collect();
    norm(&difference) / norm(a).max(1.0)
}

fn apart<G: Case>(a: &G, b: &G) -> f64 {
    norm(G::tangent_slice(&a.minus(b))) / norm(G::tangent_slice(&a.log())).max(1.0)
}

fn matrices<G: Case>(a: &G::Matrix, b: &G::Matrix) -> f64 {
    error(G::matrix_slice(a), G::matrix_slice(b))
}

/// The part of a tangent that rotates.
fn turn<G: Case>(t: &G::Tangent) -> Vec<f64> {
    G::tangent_slice(t)[G::DOF - G::ROTATION..].to_vec()
}

/// Derivative of `f` at zero along every axis, column by column: the central difference of order six, whose step of
/// 5e-3 leaves an error of about 1e-12.
fn numeric(axes: usize, f: impl Fn(&[f64]) -> Vec<f64>) -> Vec<f64> {
    const STEP: f64 = 5e-3;
    let mut columns = Vec::new();
    for axis in 0..axes {
        let at = |steps: f64| {
            let mut offset = vec![0.0; axes];
            offset[axis] = steps * STEP;
            f(&offset)
        };
        let slope = |k: f64| at(k).iter().zip(at(-k)).map(|(a, b)| a - b).collect::<Vec<_>>();
        let (one, two, three) = (slope(1.0), slope(2.0), slope(3.0));
        columns.extend((0..one.len()).map(|i| (45.0 * one[i] - 9.0 * two[i] + three[i]) / (60.0 * STEP)));
    }
    columns
}

/// Jacobian of a map between group elements: right increments in, right increments out.
fn numeric_increment<G: Case>(x: &G, f: impl Fn(&G) -> G) -> Vec<f64> {
    let base = f(x);
    numeric(G::DOF, |o| G::tangent_slice(&f(&x.plus(&G::tangent_from_slice(o))).minus(&base)).to_vec())
}

macro_rules! battery {
    ($name:ident, $group:ty) => {
        mod $name {
            use super::*;
            type G = $group;

            proptest! {
                #[test]
                fn axioms(a in element::<G>(), b in element::<G>(), c in element::<G>()) {
                    prop_assert!(apart(&a.compose(&b).compose(&c), &a.compose(&b.compose(&c))) < TOLERANCE);
                    prop_assert!(apart(&a.compose(&G::identity()), &a) < 1e-14);
                    prop_assert!(apart(&G::identity().compose(&a), &a) < 1e-14);
                    prop_assert!(apart(&G::identity(), &a.compose(&a.inverse())) < TOLERANCE);
                    prop_assert!(apart(&G::identity(), &a.inverse().compose(&a)) < TOLERANCE);
                    prop_assert!(apart(&a.between(&b), &a.inverse().compose(&b)) < TOLERANCE);
                }

                #[test]
                fn acting_is_a_homomorphism(
                    a in element::<G>(), b in element::<G>(), p in prop::array::uniform3(-9.0..9.0),
                ) {
                    let p = G::point(&p);
                    let (both, twice) = (a.compose(&b).act(&p), a.act(&b.act(&p)));
                    prop_assert!(error(&G::point_entries(&both), &G::point_entries(&twice)) < TOLERANCE);
                }

                #[test]
                fn the_logarithm_undoes_the_exponential(t in tangent::<G>(PI)) {
                    let back = G::exp(&t).log();
                    let size = norm(&turn::<G>(&t));
                    // At half a turn the logarithm may take the other of the two ways round.
                    if size < PI - 1e-7 {
                        prop_assert!(error(G::tangent_slice(&t), G::tangent_slice(&back)) < TOLERANCE, "{t:?} {back:?}");
                        // A tiny turn keeps its digits, too.
                        let off: Vec<f64> = turn::<G>(&t).iter().zip(turn::<G>(&back)).map(|(a, b)| a - b).collect();
                        prop_assert!(norm(&off) <= TOLERANCE * size, "{t:?} {back:?}");
                    }
                    prop_assert!(apart(&G::exp(&t), &G::exp(&back)) < TOLERANCE);
                }

                #[test]
                fn the_adjoint_moves_tangents(a in element::<G>(), b in element::<G>(), t in tangent::<G>(1.0)) {
                    prop_assert!(apart(&a.plus(&t), &G::exp(&(a.adjoint() * t)).compose(&a)) < TOLERANCE);
                    prop_assert!(matrices::<G>(&a.compose(&b).adjoint(), &(a.adjoint() * b.adjoint())) < TOLERANCE);
                }

                #[test]
                fn exponential_jacobians(t in tangent::<G>(PI)) {
                    let (x, at) = (G::exp(&t), |o: &[f64]| G::exp(&(t + G::tangent_from_slice(o))));
                    let right = numeric(G::DOF, |o| G::tangent_slice(&at(o).minus(&x)).to_vec());
                    prop_assert!(error(&right, G::matrix_slice(&G::right_jacobian(&t))) < TOLERANCE);
                    let left = numeric(G::DOF, |o| G::tangent_slice(&at(o).compose(&x.inverse()).log()).to_vec());
                    prop_assert!(error(&left, G::matrix_slice(&G::left_jacobian(&t))) < TOLERANCE);
                    let unit = G::identity_matrix();
                    prop_assert!(matrices::<G>(&unit, &(G::left_jacobian(&t) * G::left_jacobian_inverse(&t))) < TOLERANCE);
                    prop_assert!(matrices::<G>(&unit, &(G::right_jacobian(&t) * G::right_jacobian_inverse(&t))) < TOLERANCE);
                    // Ad(exp τ) = Jl(τ) Jr(τ)⁻¹ (Solà Eq. 75).
                    let product = G::left_jacobian(&t) * G::right_jacobian_inverse(&t);
                    prop_assert!(matrices::<G>(&x.adjoint(), &product) < TOLERANCE);
                }

                #[test]
                fn group_jacobians(a in element::<G>(), b in element::<G>(), t in tangent::<G>(3.0)) {
                    let (by_a, by_b) = a.compose_jacobians(&b);
                    prop_assert!(error(&numeric_increment(&a, |x| x.compose(&b)), G::matrix_slice(&by_a)) < TOLERANCE);
                    prop_assert!(error(&numeric_increment(&b, |x| a.compose(x)), G::matrix_slice(&by_b)) < TOLERANCE);
                    let (by_a, by_b) = a.between_jacobians(&b);
                    prop_assert!(error(&numeric_increment(&a, |x| x.between(&b)), G::matrix_slice(&by_a)) < TOLERANCE);
                    prop_assert!(error(&numeric_increment(&b, |x| a.between(x)), G::matrix_slice(&by_b)) < TOLERANCE);
                    let inverse = numeric_increment(&a, LieGroup::inverse);
                    prop_assert!(error(&inverse, G::matrix_slice(&a.inverse_jacobian())) < TOLERANCE);
                    // Turns up to 3 rad: the stencil must not step over the cut of the logarithm.
                    let x = G::exp(&t);
                    let log = numeric(G::DOF, |o| G::tangent_slice(&x.plus(&G::tangent_from_slice(o)).log()).to_vec());
                    prop_assert!(error(&log, G::matrix_slice(&x.log_jacobian())) < TOLERANCE);
                }

                #[test]
                fn action_jacobians(a in element::<G>(), p in prop::array::uniform3(-9.0..9.0_f64)) {
                    let point = G::point(&p);
                    let (motion, moved) = a.act_columns(&point);
                    let by_motion =
                        numeric(G::DOF, |o| G::point_entries(&a.plus(&G::tangent_from_slice(o)).act(&point)));
                    prop_assert!(error(&by_motion, &motion) < TOLERANCE);
                    let by_point = numeric(G::point_entries(&point).len(), |o| {
                        let mut q = p;
                        q.iter_mut().zip(o).for_each(|(q, o)| *q += o);
                        G::point_entries(&a.act(&G::point(&q)))
                    });
                    prop_assert!(error(&by_point, &moved) < TOLERANCE);
                }

                #[test]
                fn interpolation_runs_along_the_geodesic(
                    a in element::<G>(), t in tangent::<G>(3.0), s in 0.0..1.0_f64,
                ) {
                    let b = a.plus(&t);
                    prop_assert!(apart(&a, &a.interpolate(&b, 0.0)) < 1e-14);
                    prop_assert!(apart(&b, &a.interpolate(&b, 1.0)) < TOLERANCE);
                    prop_assert!(apart(&a.plus(&(t * s)), &a.interpolate(&b, s)) < TOLERANCE);
                    prop_assert!(apart(&a.interpolate(&b, s), &b.interpolate(&a, 1.0 - s)) < TOLERANCE);
                }

                #[test]
                fn long_chains_stay_rigid(step in element::<G>(), p in prop::array::uniform3(-1.0..1.0_f64)) {
                    let chain = (0..5000).fold(G::identity(), |x, _| x.compose(&step));
                    let (origin, point) = (G::point(&[0.0; 3]), G::point(&p));
                    let (o, q) = (G::point_entries(&chain.act(&origin)), G::point_entries(&chain.act(&point)));
                    let length: Vec<f64> = o.iter().zip(&q).map(|(a, b)| a - b).collect();
                    // Only the rounding of the far translation may show.
                    let allowed = 1e-14 + 1e-15 * norm(&o);
                    prop_assert!((norm(&length) - norm(&G::point_entries(&point))).abs() < allowed);
                }

                /// Any root of a covariance: its square is inverted, its entries make it anew, and its negative is refused.
                #[test]
                fn covariances_are_inverted(t in tangent::<G>(2.0)) {
                    let root = G::left_jacobian(&t);
                    let covariance = root * G::transpose(&root) + G::identity_matrix() * 0.1;
                    prop_assert_eq!(G::matrix_from_slice(G::matrix_slice(&covariance)), covariance);
                    let inverse = G::inverse_of(&covariance).unwrap();
                    prop_assert!(matrices::<G>(&G::identity_matrix(), &(covariance * inverse)) < TOLERANCE);
                    prop_assert_eq!(G::inverse_of(&-covariance), None);
                    prop_assert_eq!(G::inverse_of(&(covariance * f64::NAN)), None);
                }

                #[cfg(feature = "serde")]
                #[test]
                fn storage_keeps_every_bit(a in element::<G>(), b in element::<G>()) {
                    let value = a.compose(&b);
                    let text = serde_json::to_string(&value).unwrap();
                    prop_assert_eq!(serde_json::from_str::<G>(&text).unwrap(), value);
                }
            }

            #[test]
            fn what_is_not_finite_is_seen() {
                assert!(!G::exp(&G::tangent_from_slice(&[f64::NAN; 6][..G::DOF])).is_finite());
                assert!(G::identity().is_finite());
            }

            #[cfg(feature = "serde")]
            #[test]
            fn damaged_rotations_are_refused() {
                // The identity holds one number that is not zero: a cosine, or a quaternion's scalar.
                let text = serde_json::to_string(&G::identity()).unwrap().replace("1.0", "1.1");
                assert!(serde_json::from_str::<G>(&text).is_err(), "{text}");
            }
        }
    };
}
battery!(so2, So2);
battery!(se2, Se2);
battery!(so3, So3);
battery!(se3, Se3);

proptest! {
    #[test]
    fn nalgebra_agrees_in_the_plane(
        a in element::<Se2>(), b in element::<Se2>(), p in prop::array::uniform2(-9.0..9.0_f64),
    ) {
        let (m, n) = (Isometry2::from(a), Isometry2::from(b));
        prop_assert!(apart(&Se2::from(m), &a) < 1e-14);
        prop_assert!(apart(&Se2::from(m * n), &(a * b)) < 1e-14);
        let p = Vector2::from(p);
        prop_assert!((m.transform_point(&p.into()).coords - a * p).norm() < 1e-13);
        let rotation = UnitComplex::from(a.rotation());
        prop_assert!(apart(&So2::from(rotation), &a.rotation()) < 1e-15);
    }

    #[test]
    fn nalgebra_agrees_in_space(
        a in element::<Se3>(), b in element::<Se3>(), p in prop::array::uniform3(-9.0..9.0_f64),
    ) {
        let (m, n) = (Isometry3::from(a), Isometry3::from(b));
        prop_assert!(apart(&Se3::from(m), &a) < 1e-13);
        prop_assert!(apart(&Se3::from(m * n), &(a * b)) < 1e-13);
        let p = Vector3::from(p);
        prop_assert!((m.transform_point(&p.into()).coords - a * p).norm() < 1e-13);
        let rotation = UnitQuaternion::from(a.rotation());
        prop_assert!((rotation.to_rotation_matrix().into_inner() - a.rotation().matrix()).norm() < 1e-14);
    }

    /// Also at the poles, where pitch is ±90°.
    #[test]
    fn roll_pitch_yaw_gives_the_rotation_back(
        roll in -3.1..3.1_f64,
        yaw in -3.1..3.1_f64,
        pitch in prop_oneof![-1.5..1.5_f64, (-16.0..-1.0_f64).prop_map(|e| PI / 2.0 - 10_f64.powf(e)), Just(-PI / 2.0)],
    ) {
        let rotation = So3::from_roll_pitch_yaw(roll, pitch, yaw);
        let (r, p, y) = rotation.roll_pitch_yaw();
        prop_assert!(rotation.minus(&So3::from_roll_pitch_yaw(r, p, y)).norm() < 1e-13, "{r} {p} {y}");
        prop_assert!((p - pitch).abs() < 1e-14);
        if pitch.abs() < 1.5 {
            prop_assert!((r - roll).abs() < 1e-13 && (y - yaw).abs() < 1e-13);
        }
    }
}

/// Far from the origin, as in national grids, a relative pose keeps the digits that the positions have.
#[test]
fn between_does_not_cancel_far_from_the_origin() {
    let offset = Vector2::new(4_500_000.25, 5_700_000.5);
    let (a, b) = (Se2::new(offset.x, offset.y, 0.7), Se2::new(offset.x + 1.0, offset.y + 0.5, 0.7));
    let expected = So2::from_angle(-0.7).act(&Vector2::new(1.0, 0.5));
    assert!((a.between(&b).translation() - expected).norm() < 1e-15);
    assert!((Se3::from(a).between(&b.into()).translation().xy() - expected).norm() < 1e-15);
}
