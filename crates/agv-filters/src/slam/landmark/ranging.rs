//! Landmarks of which only ranges are measured: where they are is known late.
//!
//! A single range leaves a circle, ranges from a straight line leave a place and its mirror image. Until one place stands out, each range
//! is kept together with the place where the sensor was, as a point of the map: a copy of the vehicle's position with all its
//! correlations, which later corrections move as they move landmarks. The place is found by least squares from all starts on a circle; then the
//! landmark is added with next to no information, and all ranges are taken in at once, with their anchors. Nothing is counted twice,
//! and nothing is lost but ranges that are closer together than the spacing (delayed initialisation; Bailey, *Constrained initialisation for bearing-only SLAM*, 2003).

use super::{
    RangeStart,
    state::{Constraint, SCALE, SlamState, row_of},
};
use agv_core::solve::RobustKernel;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use std::f64::consts::TAU;

/// A range that waits.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct KeptRange {
    /// Key of the point where the sensor was.
    pub(super) anchor: u32,
    pub(super) range: f64,
    pub(super) variance: f64,
}

/// A landmark that is not in the map yet.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Waiting {
    pub(super) id: u32,
    /// Way between two ranges that are kept.
    pub(super) spacing: f64,
    pub(super) ranges: Vec<KeptRange>,
}

/// Directions in which a place is sought at first.
const STARTS: usize = 48;

/// Steps of Gauss and Newton from each start that is a minimum among its neighbours.
const STEPS: usize = 20;

/// Residual, in standard deviations, beyond which a range is left out.
const OUTLIER: f64 = 4.0;

/// A place, the scale of ranges with it, and what is left.
#[derive(Debug, Clone, Copy)]
struct Fit {
    unknowns: Vector3<f64>,
    cost: f64,
    information: Matrix3<f64>,
}

/// A range from a known place, `(anchor, range, variance)`.
type Ranged = (Vector2<f64>, f64, f64);

impl Waiting {
    pub(super) const fn new(id: u32, spacing: f64) -> Self {
        Self { id, spacing, ranges: Vec::new() }
    }

    /// Where the landmark must be; none as long as it may be elsewhere.
    pub(super) fn locate(&self, state: &SlamState, params: &RangeStart) -> Option<Vector2<f64>> {
        let ranged = self.ranged(state)?;
        let prior = (state.scale, state.covariance.get(SCALE, SCALE));
        let (center, radius, _) = *ranged.get(ranged.len() / 2)?;
        let radius = radius / (1.0 + state.scale);
        let on_circle = |i: usize| {
            let (sin, cos) = (TAU * i as f64 / STARTS as f64).sin_cos();
            center + Vector2::new(cos, sin) * radius
        };
        let costs: Vec<f64> = (0..STARTS)
            .map(|i| fit_at(&ranged, prior, &Vector3::new(on_circle(i).x, on_circle(i).y, prior.0)).cost)
            .collect();
        let minimum = |i: &usize| {
            let (before, after) = (costs[(i + STARTS - 1) % STARTS], costs[(i + 1) % STARTS]);
            costs[*i] <= before && costs[*i] <= after
        };
        let mut fits: Vec<Fit> = (0..STARTS)
            .filter(minimum)
            .filter_map(|i| descend(&ranged, prior, Vector3::new(on_circle(i).x, on_circle(i).y, prior.0)))
            .collect();
        fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let best = fits.first()?;
        let distance = ranged.iter().map(|(_, range, _)| range).sum::<f64>() / ranged.len() as f64;
        let tolerance = params.certainty * distance;
        let place = best.unknowns.xy();
        if fits.iter().any(|fit| (fit.unknowns.xy() - place).norm() > tolerance && fit.cost < best.cost + params.lead) {
            return None;
        }
        let spread = best.information.try_inverse()?.fixed_view::<2, 2>(0, 0).into_owned();
        let largest = spread.symmetric_eigenvalues().max();
        (largest.is_finite() && largest < tolerance * tolerance).then_some(place)
    }

    /// All ranges, each as uncertain as it is together with where it was measured from, beside the first.
    fn ranged(&self, state: &SlamState) -> Option<Vec<Ranged>> {
        let first = row_of(state.index_of(self.ranges.first()?.anchor)?);
        self.ranges
            .iter()
            .map(|kept| {
                let index = state.index_of(kept.anchor)?;
                let row = row_of(index);
                let p = &state.covariance;
                let relative =
                    |i: usize| p.get(row + i, row + i) - 2.0 * p.get(row + i, first + i) + p.get(first + i, first + i);
                let moved = 0.5 * (relative(0) + relative(1)).max(0.0);
                Some((state.points[index].place, kept.range, kept.variance + moved))
            })
            .collect()
    }

    /// The ranges as constraints on the landmark at `index`, but for those that its place does not explain.
    pub(super) fn constraints(&self, state: &SlamState, index: usize) -> Vec<Constraint> {
        let place = state.points[index].place;
        let stretch = 1.0 + state.scale;
        let scale_variance = state.covariance.get(SCALE, SCALE);
        let constraint = |(kept, (_, _, variance)): (&KeptRange, &Ranged)| {
            let anchor = state.index_of(kept.anchor)?;
            let way = place - state.points[anchor].place;
            let distance = way.norm();
            let residual = kept.range - stretch * distance;
            // With what the anchors may be off beside each other.
            let spread = variance + scale_variance * distance * distance;
            if !(distance > 0.0 && residual * residual <= OUTLIER * OUTLIER * spread) {
                return None;
            }
            let along = way * (stretch / distance);
            Some(Constraint {
                point: row_of(index),
                base: row_of(anchor),
                rows: 1,
                a: Matrix2::new(along.x, along.y, 0.0, 0.0),
                by_scale: Vector2::new(distance, 0.0),
                residual: Vector2::new(residual, 0.0),
                noise: Matrix2::new(kept.variance, 0.0, 0.0, 1.0),
            })
        };
        let ranged = self.ranged(state).unwrap_or_default();
        self.ranges.iter().zip(&ranged).filter_map(constraint).collect()
    }
}

/// Cost and sums at some unknowns: place and scale. 95 % of the efficiency on Gaussian ranges.
fn fit_at(ranged: &[Ranged], (scale, variance): (f64, f64), unknowns: &Vector3<f64>) -> FitSums {
    let kernel = RobustKernel::Cauchy { scale: 2.385 };
    let mut sums = FitSums { cost: 0.0, gradient: Vector3::zeros(), information: Matrix3::zeros() };
    // A scale that is known has a prior so narrow that it stays.
    let weight = 1.0 / variance.max(1e-12);
    let off = unknowns.z - scale;
    sums.cost += off * off * weight;
    sums.gradient.z += off * weight;
    sums.information[(2, 2)] += weight;
    for (anchor, range, variance) in ranged {
        let way = unknowns.xy() - anchor;
        let distance = way.norm().max(1e-9);
        let residual = (1.0 + unknowns.z) * distance - range;
        let along = way * ((1.0 + unknowns.z) / distance);
        let jacobian = Vector3::new(along.x, along.y, distance);
        let square = residual * residual / variance;
        let weight = kernel.weight(square) / variance;
        sums.cost += kernel.loss(square);
        sums.gradient += jacobian * (residual * weight);
        sums.information += jacobian * jacobian.transpose() * weight;
    }
    sums
}

struct FitSums {
    cost: f64,
    gradient: Vector3<f64>,
    information: Matrix3<f64>,
}

/// Damped steps of Gauss and Newton.
fn descend(ranged: &[Ranged], prior: (f64, f64), mut unknowns: Vector3<f64>) -> Option<Fit> {
    let mut sums = fit_at(ranged, prior, &unknowns);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let mut damped = sums.information;
        for i in 0..3 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let trial = unknowns - damped.try_inverse()? * sums.gradient;
        let next = fit_at(ranged, prior, &trial);
        if next.cost < sums.cost {
            (unknowns, sums) = (trial, next);
            damping *= 0.1;
        } else {
            damping *= 10.0;
        }
    }
    unknowns.iter().all(|v| v.is_finite()).then_some(Fit { unknowns, cost: sums.cost, information: sums.information })
}
