//! The cost of a pose to second order: what every factor adds to, and every optimiser steps by.
//!
//! A factor says how its cost changes when its point moves: value `f`, gradient `g` and Hessian `H` with respect to the point `x`
//! in the target frame. The rest is the same for all of them. With the pose `(R, t)`, the point `p` of the source, `y = R p` and
//! `x = y + t`, a right increment `(ρ, θ)` moves the point by (Solà et al., Eq. 182, in target axes `ρ' = R ρ`, `θ' = R θ`)
//!
//! ```text
//! δx = ρ' + θ' × y + ½ θ' × (ρ' + θ' × y) + ...
//! ```
//!
//! so that sums over the points of `g`, `y × g`, `H` and its products with `y` make the gradient and the Hessian, and the frame is
//! turned once at the end.

use agv_core::geometry::{Se3, skew};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// A cost near a pose: `cost + gradientᵀ δ + ½ δᵀ hessian δ` for the right increment `δ`, translation first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quadratic {
    /// The cost at the pose.
    pub cost: f64,
    /// Its gradient.
    pub gradient: Vector6<f64>,
    /// Its Hessian, or what the factors take for it.
    pub hessian: Matrix6<f64>,
    /// Points that met the target.
    pub matches: usize,
}

/// Number of sums.
pub(crate) const SUMS: usize = 28;

/// What the points say of the pose, summed up: as many as there are, in any parts, to one [`Quadratic`].
///
/// ```
/// use agv_core::{geometry::{LieGroup, Se3}, nalgebra::{Matrix3, Vector3}};
/// use agv_ndt::registration::{MotionSums, PointDerivatives};
///
/// // One point, one metre from where it should be: cost ½ d².
/// let (pose, point, goal) = (Se3::identity(), Vector3::new(2.0, 0.0, 0.0), Vector3::new(2.0, 1.0, 0.0));
/// let offset = pose.act(&point) - goal;
/// let mut sums = MotionSums::default();
/// let factor = PointDerivatives { cost: 0.5 * offset.norm_squared(), gradient: offset, hessian: Matrix3::identity(), curvature: 0.0 };
/// sums.add(&pose.rotation().act(&point), &factor);
/// let quadratic = sums.quadratic(&pose);
/// // To the right along y, and to the right about z.
/// assert_eq!((quadratic.gradient[1], quadratic.gradient[5]), (-1.0, -2.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionSums {
    /// In target axes: cost; `Σ g`; `Σ y × g`; `Σ H` as xx, xy, xz, yy, yz, zz; `Σ H J + ½ κ [g]×` row by row with `J = -[y]×`;
    /// `Σ JᵀHJ` and the curvature of rotation as xx, xy, xz, yy, yz, zz.
    pub(crate) sums: [f64; SUMS],
    pub(crate) matches: usize,
}

impl Default for MotionSums {
    fn default() -> Self {
        Self { sums: [0.0; SUMS], matches: 0 }
    }
}

/// How a factor's cost changes with its point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointDerivatives {
    /// The cost.
    pub cost: f64,
    /// Gradient with respect to the point in the target frame.
    pub gradient: Vector3<f64>,
    /// Hessian with respect to the point in the target frame, symmetric.
    pub hessian: Matrix3<f64>,
    /// Share of the curvature that the rotation adds to the Hessian: 1 for the whole of it (Newton), 0 for none (Gauss–Newton).
    pub curvature: f64,
}

impl MotionSums {
    /// Adds what a factor says of a point, whose place from the pose's origin is `y = R p`, in the target's axes.
    pub fn add(&mut self, y: &Vector3<f64>, point: &PointDerivatives) {
        let (g, h) = (&point.gradient, &point.hessian);
        let torque = y.cross(g);
        let jacobian = -skew(y);
        let cross = h * jacobian;
        let turn = jacobian.transpose() * cross;
        let cross = cross + skew(g) * (0.5 * point.curvature);
        let bend = (y * g.transpose() + g * y.transpose()) * 0.5 - Matrix3::identity() * y.dot(g);
        let turn = turn + bend * point.curvature;
        let terms = [
            point.cost, g.x, g.y, g.z, torque.x, torque.y, torque.z, h.m11, h.m12, h.m13, h.m22, h.m23, h.m33,
            cross.m11, cross.m12, cross.m13, cross.m21, cross.m22, cross.m23, cross.m31, cross.m32, cross.m33,
            turn.m11, turn.m12, turn.m13, turn.m22, turn.m23, turn.m33,
        ];
        for (sum, term) in self.sums.iter_mut().zip(terms) {
            *sum += term;
        }
        self.matches += 1;
    }

    /// Both together.
    #[must_use]
    pub fn merged(mut self, other: Self) -> Self {
        for (sum, term) in self.sums.iter_mut().zip(other.sums) {
            *sum += term;
        }
        self.matches += other.matches;
        self
    }

    /// The same, for sums that lack the part `½ κ [Σ g]×` of `Σ H J`, which all points of the curvature `κ` share.
    #[must_use]
    pub(crate) fn with_bend(mut self, curvature: f64) -> Self {
        let half = 0.5 * curvature;
        let [_, x, y, z, ..] = self.sums;
        for (at, value) in [(14, -z), (15, y), (16, z), (18, -x), (19, -y), (20, x)] {
            self.sums[at] += half * value;
        }
        self
    }

    /// The cost to second order at the pose that the points were added at.
    pub fn quadratic(&self, pose: &Se3) -> Quadratic {
        let s = &self.sums;
        let symmetric = |i: usize| {
            Matrix3::new(s[i], s[i + 1], s[i + 2], s[i + 1], s[i + 3], s[i + 4], s[i + 2], s[i + 4], s[i + 5])
        };
        let (force, torque) = (Vector3::new(s[1], s[2], s[3]), Vector3::new(s[4], s[5], s[6]));
        let cross = Matrix3::from_row_slice(&s[13..22]);
        let to_source = pose.rotation().matrix().transpose();
        let turned = |block: Matrix3<f64>| to_source * block * to_source.transpose();
        let (force, torque) = (to_source * force, to_source * torque);
        let (line, cross, turn) = (turned(symmetric(7)), turned(cross), turned(symmetric(22)));
        let mut hessian = Matrix6::zeros();
        hessian.fixed_view_mut::<3, 3>(0, 0).copy_from(&line);
        hessian.fixed_view_mut::<3, 3>(0, 3).copy_from(&cross);
        hessian.fixed_view_mut::<3, 3>(3, 0).copy_from(&cross.transpose());
        hessian.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        let hessian = (hessian + hessian.transpose()) * 0.5;
        let gradient = Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z);
        Quadratic { cost: s[0], gradient, hessian, matches: self.matches }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::{LieGroup, So3};
    use num_dual::{DualNum, HyperDual64 as D};
    use proptest::prelude::*;

    /// A well around a mean that is no sphere, with its derivatives.
    fn well(x: &Vector3<f64>) -> PointDerivatives {
        let (mean, a) = (Vector3::new(2.0, -1.0, 0.5), Matrix3::new(3.0, 0.4, -0.2, 0.4, 1.0, 0.3, -0.2, 0.3, 0.5));
        let q = a * (x - mean);
        let e = (-0.3 * (x - mean).dot(&q)).exp();
        let hessian = (a - q * q.transpose() * 0.6) * (0.6 * e);
        PointDerivatives { cost: -e, gradient: q * (0.6 * e), hessian, curvature: 1.0 }
    }

    fn cost(pose: &Se3, points: &[Vector3<f64>]) -> Quadratic {
        let mut sums = MotionSums::default();
        for p in points {
            sums.add(&pose.rotation().act(p), &well(&pose.act(p)));
        }
        sums.quadratic(pose)
    }

    /// The cost at `pose ⊕ increment`, in hyper-dual numbers: value, two slopes and their mixed derivative in one evaluation.
    ///
    /// The exponential is the polynomial of the closed form in the angle's square, exact to the second order.
    fn dual_cost(pose: &Se3, points: &[Vector3<f64>], increment: [D; 6]) -> D {
        let cross =
            |a: [D; 3], b: [D; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let [a, b, c, d, e, f] = increment;
        let (rho, theta) = ([a, b, c], [d, e, f]);
        let square = d * d + e * e + f * f;
        let series = |first: f64, second: f64| D::from(first) - square * second;
        let turned = |v: [D; 3], one: D, two: D| {
            let (w, ww) = (cross(theta, v), cross(theta, cross(theta, v)));
            [0, 1, 2].map(|i| v[i] + w[i] * one + ww[i] * two)
        };
        let shift = turned(rho, series(0.5, 1.0 / 24.0), series(1.0 / 6.0, 1.0 / 120.0));
        let (r, t) = (pose.rotation().matrix(), pose.translation());
        let mean = [2.0, -1.0, 0.5];
        let information = [[3.0, 0.4, -0.2], [0.4, 1.0, 0.3], [-0.2, 0.3, 0.5]];
        points.iter().fold(D::from(0.0), |sum, p| {
            let p = turned([D::from(p.x), D::from(p.y), D::from(p.z)], series(1.0, 1.0 / 6.0), series(0.5, 1.0 / 24.0));
            let d = [0, 1, 2].map(|i| (0..3).fold(D::from(t[i] - mean[i]), |x, j| x + (p[j] + shift[j]) * r[(i, j)]));
            let distance = (0..9).fold(D::from(0.0), |m, k| m + d[k / 3] * d[k % 3] * information[k / 3][k % 3]);
            sum - (distance * -0.3).exp()
        })
    }

    proptest! {
        /// Gradient and Hessian of the cost over right increments are those of dual numbers, to rounding.
        #[test]
        fn derivatives_are_those_of_dual_numbers(
            turn in prop::array::uniform3(-2.0..2.0_f64), shift in prop::array::uniform3(-1.0..1.0_f64),
            points in prop::collection::vec(prop::array::uniform3(-2.0..2.0_f64), 1..5),
        ) {
            let pose = Se3::from_parts(Vector3::from(shift), So3::exp(&Vector3::from(turn)));
            let points: Vec<_> = points.into_iter().map(Vector3::from).collect();
            let found = cost(&pose, &points);
            for i in 0..6 {
                for j in 0..6 {
                    let mut increment = [D::from(0.0); 6];
                    increment[i] += D::new(0.0, 1.0, 0.0, 0.0);
                    increment[j] += D::new(0.0, 0.0, 1.0, 0.0);
                    let dual = dual_cost(&pose, &points, increment);
                    prop_assert!((found.cost - dual.re).abs() < 1e-12);
                    prop_assert!((found.gradient[i] - dual.eps1).abs() < 1e-12);
                    prop_assert!((found.hessian[(i, j)] - dual.eps1eps2).abs() < 1e-11, "{i} {j} {} {}", found.hessian[(i, j)], dual.eps1eps2);
                }
            }
        }

        /// ... and of differences of the cost alone, over the exponential of the group.
        #[test]
        fn derivatives_are_those_of_the_cost(
            turn in prop::array::uniform3(-2.0..2.0_f64), shift in prop::array::uniform3(-1.0..1.0_f64),
            points in prop::collection::vec(prop::array::uniform3(-2.0..2.0_f64), 1..5),
        ) {
            let pose = Se3::from_parts(Vector3::from(shift), So3::exp(&Vector3::from(turn)));
            let points: Vec<_> = points.into_iter().map(Vector3::from).collect();
            let at = |step: Vector6<f64>| cost(&pose.plus(&step), &points).cost;
            let (found, h) = (cost(&pose, &points), 1e-4);
            for i in 0..6 {
                let a = Vector6::ith(i, h);
                let slope = (at(a) - at(-a)) / (2.0 * h);
                prop_assert!((found.gradient[i] - slope).abs() < 1e-5, "{} {}", found.gradient[i], slope);
                for j in 0..=i {
                    let b = Vector6::ith(j, h);
                    let bend = (at(a + b) - at(a - b) - at(b - a) + at(-a - b)) / (4.0 * h * h);
                    prop_assert!((found.hessian[(i, j)] - bend).abs() < 1e-4, "{i} {j}: {} {}", found.hessian[(i, j)], bend);
                    prop_assert_eq!(found.hessian[(i, j)], found.hessian[(j, i)]);
                }
            }
        }
    }
}
