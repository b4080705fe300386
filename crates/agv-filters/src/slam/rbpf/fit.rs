//! How well a scan fits a map at a pose, and the pose where it fits best.
//!
//! Each end of a beam is held against the nearest surface of the map: the mean of a cell's hits, and the line through its neighbours
//! where there is one. With the residual `e` in metres, `s = e² / 2σ²` and right increments, the cost and the step are
//!
//! ```text
//! C(x) = b/n Σ c s / (c + s)  +  ½ dᵀ Ω d             d = log(prediction⁻¹ x)
//! H = b/n Σ (c / (c + s))² JᵀJ / σ²  +  Ω             J = nᵀ R [ I | (-p_y, p_x)ᵀ ]
//! ```
//!
//! minus the logarithm of the posterior up to a constant: `b ≤ n` of the `n` beams count as independent, `Ω` is the information of the
//! motion model. The kernel is that of Geman and `McClure`; a beam that meets nothing costs `c`.

use super::{
    params::ScanFitParams,
    view::{Surface, View},
};
use agv_core::geometry::{LieGroup, Se2};
use nalgebra::{Matrix3, Vector2, Vector3};

/// A step below this is the end, in metres and radians.
const AT_REST: f64 = 1e-4;

/// Where the motion model expects a particle, and how surely.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prediction {
    pub(super) pose: Se2,
    pub(super) information: Matrix3<f64>,
}

/// A scan, a map and a prediction.
pub(super) struct Fit<'a> {
    pub(super) view: View<'a>,
    pub(super) resolution: f64,
    /// Ends of beams in the base frame, in metres.
    pub(super) points: &'a [Vector2<f64>],
    pub(super) prediction: Prediction,
    pub(super) params: &'a ScanFitParams,
}

/// What the fit is at a pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums {
    pub(super) pose: Se2,
    /// Minus the logarithm of the posterior.
    pub(super) cost: f64,
    /// The part of it that is the scan's.
    pub(super) scan_cost: f64,
    pub(super) hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    /// Share of the beams that meet a surface.
    pub(super) explained: f64,
}

impl Fit<'_> {
    fn scale(&self) -> f64 {
        (self.params.independent_beams / self.points.len().max(1) as f64).min(1.0)
    }

    /// The surface that a beam meets, and the residual over twice the variance.
    #[inline]
    fn met(&self, pose: &Se2, point: &Vector2<f64>) -> Option<(Surface, f64)> {
        let surface = self.view.nearest(&(pose.act(point) * (1.0 / self.resolution)))?;
        let residual = if surface.normal.x == 0.0 && surface.normal.y == 0.0 {
            surface.off.norm_squared()
        } else {
            surface.normal.dot(&surface.off).powi(2)
        };
        let sigma = self.params.sigma / self.resolution;
        Some((surface, residual / (2.0 * sigma * sigma)))
    }

    /// Cost of the scan and of the motion at a pose.
    pub(super) fn cost(&self, pose: &Se2) -> f64 {
        let limit = self.params.outlier;
        let mut sum = 0.0;
        for point in self.points {
            sum += self.met(pose, point).map_or(limit, |(_, s)| limit * s / (limit + s));
        }
        self.scale() * sum + self.motion_cost(pose)
    }

    fn motion_cost(&self, pose: &Se2) -> f64 {
        let off = self.prediction.pose.between(pose).log();
        0.5 * off.dot(&(self.prediction.information * off))
    }

    /// Cost, gradient and Hessian at a pose.
    pub(super) fn sums(&self, pose: &Se2) -> Sums {
        let (limit, scale) = (self.params.outlier, self.scale());
        let weight = scale / (self.params.sigma * self.params.sigma);
        let (mut hessian, mut gradient, mut sum, mut met) = (Matrix3::zeros(), Vector3::zeros(), 0.0, 0_usize);
        let back = pose.rotation().inverse();
        for point in self.points {
            let Some((surface, s)) = self.met(pose, point) else {
                sum += limit;
                continue;
            };
            let share = limit / (limit + s);
            sum += share * s;
            met += usize::from(s < limit);
            let weight = weight * share * share;
            let off = surface.off * self.resolution;
            let mut add = |normal: Vector2<f64>| {
                let local = back.act(&normal);
                let jacobian = Vector3::new(local.x, local.y, local.y * point.x - local.x * point.y);
                hessian += jacobian * jacobian.transpose() * weight;
                gradient += jacobian * (normal.dot(&off) * weight);
            };
            if surface.normal.x == 0.0 && surface.normal.y == 0.0 {
                add(Vector2::x());
                add(Vector2::y());
            } else {
                add(surface.normal);
            }
        }
        let off = self.prediction.pose.between(pose).log();
        let scan_cost = scale * sum;
        Sums {
            pose: *pose,
            cost: scan_cost + self.motion_cost(pose),
            scan_cost,
            hessian: hessian + self.prediction.information,
            gradient: gradient + self.prediction.information * off,
            explained: met as f64 / self.points.len().max(1) as f64,
        }
    }

    /// The best pose on the way from the prediction downhill.
    pub(super) fn best(&self) -> Sums {
        let mut here = self.sums(&self.prediction.pose);
        let mut best = here;
        for _ in 0..self.params.max_iterations {
            let Some(factor) = here.hessian.cholesky() else { break };
            let step = factor.solve(&-here.gradient);
            here = self.sums(&here.pose.plus(&step));
            if here.cost < best.cost {
                best = here;
            }
            if step.amax() < AT_REST {
                break;
            }
        }
        best
    }
}
