//! Moré and Thuente's line search: *Line search algorithms with guaranteed sufficient decrease*, ACM TOMS 20(3), 1994.
//!
//! Sought is a step `α` along a direction of descent that satisfies the strong Wolfe conditions
//!
//! ```text
//! φ(α) <= φ(0) + μ α φ'(0)        |φ'(α)| <= η |φ'(0)|
//! ```
//!
//! The interval of uncertainty shrinks by safeguarded cubic and quadratic interpolation (section 4); while no step has decreased
//! enough, the auxiliary function `ψ(α) = φ(α) - φ(0) - μ α φ'(0)` takes the place of `φ` (section 3).

use agv_core::{Error, check};

/// A function along a line: step, value and slope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePoint {
    /// The step `α`.
    pub step: f64,
    /// `φ(α)`.
    pub value: f64,
    /// `φ'(α)`.
    pub slope: f64,
}

/// What a step must bring.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LineSearchParams {
    /// `μ`: share of the slope's promise that the value must fall by.
    pub sufficient_decrease: f64,
    /// `η`: share of the slope that may be left.
    pub curvature: f64,
    /// Relative width of the interval at which it ends.
    pub interval_tolerance: f64,
    /// Least step.
    pub min_step: f64,
    /// Greatest step.
    pub max_step: f64,
    /// Most evaluations.
    pub max_evaluations: usize,
}

impl Default for LineSearchParams {
    /// The values that suit Newton's directions (Nocedal and Wright 2006, section 3.1).
    fn default() -> Self {
        Self {
            sufficient_decrease: 1e-4,
            curvature: 0.9,
            interval_tolerance: 1e-3,
            min_step: 1e-6,
            max_step: 4.0,
            max_evaluations: 10,
        }
    }
}

/// Why a line search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum LineSearchEnd {
    /// Both conditions hold.
    Satisfied,
    /// The step is the greatest, and the function still falls.
    AtMaximum,
    /// The step is the least, and the function has not fallen enough.
    AtMinimum,
    /// The interval is as narrow as was asked for, or as rounding allows.
    Narrow,
    /// As many evaluations as were allowed.
    EvaluationLimit,
    /// The direction does not lead downhill, or the function is not a number.
    NotDownhill,
}

/// The line search: parameters only.
///
/// ```
/// use agv_ndt::registration::{LinePoint, LineSearchEnd, LineSearchParams, MoreThuente};
///
/// let search = MoreThuente::new(LineSearchParams { curvature: 0.1, ..LineSearchParams::default() })?;
/// let parabola = |step: f64| LinePoint { step, value: (step - 2.0).powi(2), slope: 2.0 * (step - 2.0) };
/// let (found, end, _) = search.search(&parabola(0.0), 1.0, parabola);
/// assert_eq!(end, LineSearchEnd::Satisfied);
/// assert!((found.step - 2.0).abs() < 0.2);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoreThuente {
    params: LineSearchParams,
}

impl MoreThuente {
    /// A line search.
    ///
    /// # Errors
    /// A condition outside (0, 1), a tolerance that is negative, steps that are not `0 <= min < max`, or no evaluations.
    pub fn new(params: LineSearchParams) -> Result<Self, Error> {
        check::open_probability("sufficient_decrease", params.sufficient_decrease)?;
        check::open_probability("curvature", params.curvature)?;
        check::non_negative("interval_tolerance", params.interval_tolerance)?;
        check::non_negative("min_step", params.min_step)?;
        check::finite("max_step", params.max_step)?;
        check::in_range("min_step", params.min_step, 0.0, params.max_step.next_down())?;
        check::at_least("max_evaluations", params.max_evaluations, 1)?;
        Ok(Self { params })
    }

    /// Searches from `start` (step zero), first at `first_step`; `function` evaluates a step. Returns the last point that was
    /// evaluated, or the best one before if that was no number, why it ended there, and the number of evaluations.
    pub fn search(
        &self,
        start: &LinePoint,
        first_step: f64,
        mut function: impl FnMut(f64) -> LinePoint,
    ) -> (LinePoint, LineSearchEnd, usize) {
        let params = &self.params;
        if !(start.slope < 0.0 && start.value.is_finite() && first_step.is_finite()) {
            return (*start, LineSearchEnd::NotDownhill, 0);
        }
        let promise = params.sufficient_decrease * start.slope;
        let mut interval = Interval { best: *start, other: *start, bracketed: false };
        let (mut width, mut width_before) =
            (params.max_step - params.min_step, 2.0 * (params.max_step - params.min_step));
        let mut step = first_step.clamp(params.min_step, params.max_step);
        let (mut least, mut greatest, mut auxiliary) = (0.0, 5.0 * step, true);
        for evaluations in 1.. {
            let point = function(step);
            if !(point.value.is_finite() && point.slope.is_finite()) {
                return (interval.best, LineSearchEnd::NotDownhill, evaluations);
            }
            let fallen = point.value <= start.value + step * promise;
            auxiliary &= !(fallen && point.slope >= 0.0);
            let end = if fallen && point.slope.abs() <= -params.curvature * start.slope {
                Some(LineSearchEnd::Satisfied)
            } else if interval.bracketed
                && (step <= least || step >= greatest || greatest - least <= params.interval_tolerance * greatest)
            {
                Some(LineSearchEnd::Narrow)
            } else if step >= params.max_step && fallen && point.slope <= promise {
                Some(LineSearchEnd::AtMaximum)
            } else if step <= params.min_step && (!fallen || point.slope >= promise) {
                Some(LineSearchEnd::AtMinimum)
            } else if evaluations >= params.max_evaluations {
                Some(LineSearchEnd::EvaluationLimit)
            } else {
                None
            };
            if let Some(end) = end {
                return (point, end, evaluations);
            }
            step = if auxiliary && point.value <= interval.best.value && !fallen {
                let tilt =
                    |p: &LinePoint, by: f64| LinePoint { value: p.value + by * p.step, slope: p.slope + by, ..*p };
                let mut tilted = Interval {
                    best: tilt(&interval.best, -promise),
                    other: tilt(&interval.other, -promise),
                    ..interval
                };
                let step = tilted.next(&tilt(&point, -promise), least, greatest);
                interval = Interval {
                    best: tilt(&tilted.best, promise),
                    other: tilt(&tilted.other, promise),
                    bracketed: tilted.bracketed,
                };
                step
            } else {
                interval.next(&point, least, greatest)
            };
            let (best, other) = (interval.best.step, interval.other.step);
            if interval.bracketed {
                // The interval must shrink by a third in two steps, or it is halved.
                if (other - best).abs() >= 0.66 * width_before {
                    step = best + 0.5 * (other - best);
                }
                (width_before, width) = (width, (other - best).abs());
                (least, greatest) = (best.min(other), best.max(other));
            } else {
                (least, greatest) = (step + 1.1 * (step - best), step + 4.0 * (step - best));
            }
            step = step.clamp(params.min_step, params.max_step);
            let narrow = step <= least || step >= greatest || greatest - least <= params.interval_tolerance * greatest;
            if interval.bracketed && narrow {
                step = best;
            }
        }
        (interval.best, LineSearchEnd::EvaluationLimit, params.max_evaluations)
    }
}

/// The interval of uncertainty: its best end, and the other.
#[derive(Debug, Clone, Copy)]
struct Interval {
    best: LinePoint,
    other: LinePoint,
    bracketed: bool,
}

impl Interval {
    /// Takes a point in, and gives the next step to try (section 4, cases 1 to 4).
    fn next(&mut self, point: &LinePoint, least: f64, greatest: f64) -> f64 {
        let (x, p) = (self.best, *point);
        let opposite = p.slope * x.slope.signum() < 0.0;
        let closer = |a: f64, b: f64, to: f64| if (a - to).abs() < (b - to).abs() { a } else { b };
        let farther = |a: f64, b: f64, from: f64| if (a - from).abs() > (b - from).abs() { a } else { b };
        let next = if p.value > x.value {
            // 1: a higher value brackets a minimum.
            self.bracketed = true;
            let cubic = cubic_minimum(&x, &p);
            let width = p.step - x.step;
            let quadratic = x.step + 0.5 * x.slope / ((x.value - p.value) / width + x.slope) * width;
            let middle = cubic + 0.5 * (quadratic - cubic);
            if (cubic - x.step).abs() < (quadratic - x.step).abs() { cubic } else { middle }
        } else if opposite {
            // 2: so does a slope of the other sign.
            self.bracketed = true;
            farther(cubic_minimum(&p, &x), secant(&p, &x), p.step)
        } else if p.slope.abs() < x.slope.abs() {
            // 3: the slope flattens; the cubic may have no minimum, or one behind.
            let cubic = cubic_minimum_ahead(&p, &x).unwrap_or(if p.step > x.step { greatest } else { least });
            let secant = secant(&p, &x);
            if self.bracketed {
                let next = closer(cubic, secant, p.step);
                let bound = p.step + 0.66 * (self.other.step - p.step);
                if p.step > x.step { next.min(bound) } else { next.max(bound) }
            } else {
                farther(cubic, secant, p.step).max(least).min(greatest)
            }
        } else if self.bracketed {
            // 4: the function falls faster and faster.
            cubic_minimum(&p, &self.other)
        } else if p.step > x.step {
            greatest
        } else {
            least
        };
        if p.value > x.value {
            self.other = p;
        } else {
            if opposite {
                self.other = x;
            }
            self.best = p;
        }
        next
    }
}

/// `θ` and `γ` of the cubic through two points (section 4), `γ` positive; a discriminant below zero reads as zero.
fn cubic(a: &LinePoint, b: &LinePoint) -> (f64, f64) {
    let theta = 3.0 * (a.value - b.value) / (b.step - a.step) + a.slope + b.slope;
    let scale = theta.abs().max(a.slope.abs()).max(b.slope.abs());
    let discriminant = (theta / scale).powi(2) - (a.slope / scale) * (b.slope / scale);
    (theta, scale * discriminant.max(0.0).sqrt())
}

/// Minimum of the cubic through two points.
fn cubic_minimum(a: &LinePoint, b: &LinePoint) -> f64 {
    let (theta, gamma) = cubic(a, b);
    let gamma = if b.step < a.step { -gamma } else { gamma };
    let ratio = (gamma - a.slope + theta) / (gamma - a.slope + gamma + b.slope);
    a.step + ratio * (b.step - a.step)
}

/// Minimum of the cubic through two points if it lies beyond `a`, seen from `b`.
fn cubic_minimum_ahead(a: &LinePoint, b: &LinePoint) -> Option<f64> {
    let (theta, gamma) = cubic(a, b);
    let gamma = if a.step > b.step { -gamma } else { gamma };
    let ratio = (gamma - a.slope + theta) / (gamma + (b.slope - a.slope) + gamma);
    (ratio < 0.0 && gamma != 0.0).then_some(a.step + ratio * (b.step - a.step))
}

/// Where the slope vanishes, by the secant.
fn secant(a: &LinePoint, b: &LinePoint) -> f64 {
    a.step + a.slope / (a.slope - b.slope) * (b.step - a.step)
}

#[cfg(test)]
#[path = "more_thuente/tests.rs"]
mod tests;
