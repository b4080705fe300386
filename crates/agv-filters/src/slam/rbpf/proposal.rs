//! Where a particle goes: the improved proposal.
//!
//! Grisetti, Stachniss and Burgard, *Improved techniques for grid mapping with Rao-Blackwellized particle filters*, IEEE T-RO 23
//! (2007), section III-A: a scan says far better than the odometry where the vehicle is, so that particles are drawn by both,
//!
//! ```text
//! τ(x) = p(z | m, x) p(x | x', u)        x ~ N(μ, Σ)        w = w' ∫ τ(x) dx
//! ```
//!
//! with mean, covariance and integral of `τ` summed up over samples around the pose where the scan fits best. The samples are drawn
//! from the Gaussian `q` of the fit's Hessian and count `τ / q` (the paper draws them evenly, and needs more of them for peaks that are
//! narrow in one direction). Where the scan does not fit, the particle goes where the motion model draws it.

use super::{
    beams::Beams,
    fit::{Fit, Prediction},
    map::{TileMap, TileRect},
    params::ScanFitParams,
    view::{AROUND, View},
};
use crate::particle::semidefinite_root;
use agv_core::{
    compute::Stream,
    geometry::{LieGroup, Se2},
};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// What a particle is to become.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Proposed {
    pub(super) pose: Se2,
    /// Logarithm of the factor on the weight.
    pub(super) log_weight: f64,
    /// Share of the beams that meet the particle's map.
    pub(super) explained: f64,
    /// Whether the scan placed the particle, and not the motion model alone.
    pub(super) matched: bool,
}

/// The motion since the last scan, as all particles see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    pub(super) start_from_end: Se2,
    pub(super) information: Matrix3<f64>,
    /// `-½ log det` of the covariance.
    pub(super) log_scale: f64,
}

/// Least standard deviations of a motion, in metres and radians: a vehicle that stands still is known no better than that.
const LEAST: [f64; 3] = [2e-3, 2e-3, 1e-3];

impl Motion {
    /// A motion with the covariance that the motion model states; none for one that is no covariance.
    pub(super) fn new(start_from_end: Se2, covariance: &Matrix3<f64>) -> Option<Self> {
        let floor = Matrix3::from_diagonal(&Vector3::from(LEAST.map(|sigma| sigma * sigma)));
        let factor = (covariance + floor).cholesky()?;
        let log_scale = -factor.l_dirty().diagonal().map(f64::ln).sum();
        Some(Self { start_from_end, information: factor.inverse(), log_scale })
    }
}

/// Proposes a particle's next pose; `sample` draws from the motion model.
pub(super) fn propose(
    map: &TileMap,
    before: &Se2,
    motion: &Motion,
    beams: &Beams,
    params: &ScanFitParams,
    sample: impl Fn(&Se2, &mut Stream) -> Se2,
    stream: &mut Stream,
) -> Proposed {
    let predicted = *before * motion.start_from_end;
    let margin = AROUND + 1 + (SLACK / map.resolution()) as i32;
    let Some((low, high)) = beams.cells_from(&predicted, map.resolution(), margin) else {
        return Proposed { pose: predicted, log_weight: 0.0, explained: 0.0, matched: false };
    };
    let view = View::new(map, &TileRect::of_cells(low, high));
    let prediction = Prediction { pose: predicted, information: motion.information };
    let fit = Fit { view, resolution: map.resolution(), points: &beams.points, prediction, params };
    let best = fit.best();
    if best.explained >= params.min_explained
        && let Some(placed) = placed(&fit, &best.pose, &best.hessian, motion, stream)
    {
        return Proposed { explained: best.explained, ..placed };
    }
    let pose = sample(before, stream);
    let sums = fit.sums(&pose);
    let log_weight = -params.weight_exponent * sums.scan_cost;
    Proposed { pose, log_weight, explained: sums.explained, matched: false }
}

/// How far a match may lead from the prediction before the map ends for it, in metres.
const SLACK: f64 = 1.0;

/// Draws from the Gaussian of `τ` around the best pose; none if the fit has no curvature or no sample counts.
fn placed(
    fit: &Fit<'_>,
    best: &Se2,
    hessian: &Matrix3<f64>,
    motion: &Motion,
    stream: &mut Stream,
) -> Option<Proposed> {
    let covariance = hessian.cholesky()?.inverse();
    let root = semidefinite_root(&covariance);
    // log (τ / q) at best ⊕ L z, without the constants of the two Gaussians, which cancel.
    let constant = motion.log_scale + root.diagonal().map(f64::ln).sum();
    let (mut samples, mut peak) = ([(Vector3::zeros(), 0.0); MAX_SAMPLES], f64::NEG_INFINITY);
    let count = fit.params.samples.min(MAX_SAMPLES);
    let samples = &mut samples[..count];
    for pair in samples.chunks_mut(2) {
        // In pairs of opposites, whose mean is none.
        let z = Vector3::from_fn(|_, _| StandardNormal.sample(stream));
        for (sample, z) in pair.iter_mut().zip([z, -z]) {
            let off: Vector3<f64> = root * z;
            let log = constant - fit.cost(&best.plus(&off)) + 0.5 * z.norm_squared();
            *sample = (off, log);
            peak = peak.max(log);
        }
    }
    if !peak.is_finite() {
        return None;
    }
    let (mut sum, mut mean, mut squares) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for (off, log) in &*samples {
        let weight = (log - peak).exp();
        sum += weight;
        mean += off * weight;
        squares += off * off.transpose() * weight;
    }
    mean /= sum;
    let spread = semidefinite_root(&(squares / sum - mean * mean.transpose()));
    let z = Vector3::from_fn(|_, _| StandardNormal.sample(stream));
    let pose = best.plus(&(mean + spread * z));
    let log_integral = peak + (sum / count as f64).ln();
    let proposed =
        Proposed { pose, log_weight: fit.params.weight_exponent * log_integral, explained: 1.0, matched: true };
    (pose.is_finite() && log_integral.is_finite()).then_some(proposed)
}

/// Most samples of a proposal.
pub(super) const MAX_SAMPLES: usize = 64;
