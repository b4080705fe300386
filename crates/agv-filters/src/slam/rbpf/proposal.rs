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
    view::{AROUND, View, ViewMemory},
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

/// A scan and the motion before it, as all particles see them.
pub(super) struct Moment<'a> {
    pub(super) motion: &'a Motion,
    pub(super) beams: &'a Beams,
    pub(super) params: &'a ScanFitParams,
}

/// Proposes a particle's next pose; `sample` draws from the motion model.
pub(super) fn propose(
    map: &TileMap,
    before: &Se2,
    moment: &Moment<'_>,
    sample: impl Fn(&Se2, &mut Stream) -> Se2,
    stream: &mut Stream,
    memory: &mut ViewMemory,
) -> Proposed {
    let Moment { motion, beams, params } = *moment;
    let predicted = *before * motion.start_from_end;
    let margin = AROUND + 1 + (SLACK / map.resolution()) as i32;
    let Some((low, high)) = beams.cells_from(&predicted, map.resolution(), margin) else {
        return Proposed { pose: predicted, log_weight: 0.0, explained: 0.0, matched: false };
    };
    let view = View::new(map, &TileRect::of_cells(low, high), memory);
    let prediction = Prediction { pose: predicted, information: motion.information };
    let fit = Fit { view, resolution: map.resolution(), points: &beams.points, prediction, params };
    let best = fit.best();
    let placed = (best.explained >= params.min_explained)
        .then(|| placed(&fit, &best.pose, &best.hessian, motion, stream))
        .flatten()
        .map(|placed| Proposed { explained: best.explained, ..placed });
    let proposed = placed.unwrap_or_else(|| {
        let pose = sample(before, stream);
        let sums = fit.sums(&pose);
        let log_weight = -params.weight_exponent * sums.scan_cost;
        Proposed { pose, log_weight, explained: sums.explained, matched: false }
    });
    fit.view.put_back(memory);
    proposed
}

/// How far a match may lead from the prediction before the map ends for it, in metres.
const SLACK: f64 = 1.0;

/// Draws from the Gaussian of `τ` around the best pose; none if the fit has no curvature or no sample counts.
fn placed(fit: &Fit<'_>, best: &Se2, hessian: &Matrix3<f64>, motion: &Motion, stream: &mut Stream) -> Option<Proposed> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slam::{
        RbpfParams,
        rbpf::insert::{Scratch, insert},
    };
    use agv_core::{
        compute::Seed,
        sensors::{LaserScan, ScanGeometry},
        time::Stamp,
    };

    /// Beams in a corner, 3 m ahead and 2 m to the left.
    fn corner() -> Beams {
        let geometry = ScanGeometry { angle_min: -0.9, angle_increment: 0.02, ..ScanGeometry::default() };
        let range = |a: f64| (3.0 / a.cos().max(1e-9)).min(2.0 / a.sin().max(1e-9)) as f32;
        let ranges = (0..140).map(|i| range(geometry.angle(i))).collect();
        let (mut beams, model) = (Beams::default(), RbpfParams::default().inverse_model().unwrap());
        beams.read(&LaserScan::new(Stamp::default(), geometry, ranges).unwrap(), &model, 90);
        beams
    }

    fn map_of(beams: &Beams) -> TileMap {
        let mut map = TileMap::new(0.05);
        insert(&mut map, &Se2::default(), beams, &mut Scratch::default());
        map
    }

    fn motion() -> Motion {
        Motion::new(Se2::new(0.02, -0.01, 0.004), &Matrix3::from_diagonal(&Vector3::new(4e-4, 4e-4, 1e-4))).unwrap()
    }

    /// The weight is the integral of the posterior, and the draws have its mean: both against a sum over a fine lattice.
    #[test]
    fn the_weight_is_the_integral_and_the_draws_have_the_mean() {
        let beams = corner();
        let map = map_of(&beams);
        let params = ScanFitParams { weight_exponent: 1.0, samples: 64, ..ScanFitParams::default() };
        let motion = motion();
        let reach = beams.cells_from(&Se2::default(), 0.05, 30).unwrap();
        let prediction = Prediction { pose: motion.start_from_end, information: motion.information };
        let view = View::new(&map, &TileRect::of_cells(reach.0, reach.1), &mut Vec::new());
        let fit = Fit { view, resolution: 0.05, points: &beams.points, prediction, params: &params };
        let best = fit.best();
        assert!(best.explained > 0.95 && best.pose.translation().norm() < 0.01, "{:?}", best.pose);

        let sigma = best.hessian.cholesky().unwrap().inverse().diagonal().map(f64::sqrt);
        let (half, steps) = (4.5, 8_i32);
        let (mut sum, mut mean) = (0.0, Vector3::zeros());
        let at = |i: i32| half * f64::from(i) / f64::from(steps);
        for (i, j, k) in
            (-steps..=steps).flat_map(|i| (-steps..=steps).flat_map(move |j| (-steps..=steps).map(move |k| (i, j, k))))
        {
            let off = Vector3::new(at(i), at(j), at(k)).component_mul(&sigma);
            let density = (-fit.cost(&best.pose.plus(&off))).exp();
            sum += density;
            mean += off * density;
        }
        mean /= sum;
        let volume = sigma.product() * (half / f64::from(steps)).powi(3);
        let expected = (sum * volume).ln() + motion.log_scale - 1.5 * std::f64::consts::TAU.ln();

        let draw = |seed: u64| {
            let mut stream = Seed(seed).stream(0, 0);
            let moment = Moment { motion: &motion, beams: &beams, params: &params };
            let sample = |_: &Se2, _: &mut Stream| panic!("the scan fits");
            propose(&map, &Se2::default(), &moment, sample, &mut stream, &mut Vec::new())
        };
        let draws: Vec<_> = (0..200).map(draw).collect();
        let count = draws.len() as f64;
        let log_weight = draws.iter().map(|d| d.log_weight).sum::<f64>() / count;
        assert!((log_weight - expected).abs() < 0.15, "{log_weight} {expected}");
        let offs: Vec<_> = draws.iter().map(|d| d.pose.minus(&best.pose)).collect();
        let drawn = offs.iter().sum::<Vector3<f64>>() / count;
        // Five standard errors.
        assert!(((drawn - mean).component_div(&sigma)).amax() < 5.0 / count.sqrt(), "{drawn} {mean} {sigma}");
        let variance = offs.iter().map(|o| o.component_mul(o)).sum::<Vector3<f64>>() / count;
        let ratio = variance.component_div(&sigma.component_mul(&sigma));
        assert!(ratio.min() > 0.5 && ratio.max() < 2.0, "{ratio}");
    }

    #[test]
    fn where_nothing_fits_the_motion_model_draws() {
        let beams = corner();
        let (params, mut stream) = (ScanFitParams::default(), Seed(1).stream(0, 0));
        let elsewhere = Se2::new(0.3, 0.2, 0.1);
        let (empty, motion) = (TileMap::new(0.05), motion());
        let mut propose = |before: &Se2, beams: &Beams| {
            let moment = Moment { motion: &motion, beams, params: &params };
            propose(&empty, before, &moment, |_, _| elsewhere, &mut stream, &mut Vec::new())
        };
        let proposed = propose(&Se2::default(), &beams);
        assert!(!proposed.matched && proposed.explained == 0.0 && proposed.pose == elsewhere);
        let cost = params.weight_exponent * params.independent_beams * params.outlier;
        assert!((proposed.log_weight + cost).abs() < 1e-9);
        // A scan of few beams is worth no more than these.
        let mut few = beams.clone();
        few.points.truncate(30);
        let proposed = propose(&Se2::default(), &few);
        assert!((proposed.log_weight + params.weight_exponent * 30.0 * params.outlier).abs() < 1e-9);
        // Far beyond what cells count.
        let far = Se2::new(1e12, 0.0, 0.0);
        let proposed = propose(&far, &beams);
        assert!(!proposed.matched && proposed.pose.x() > 1e11);
    }
}
