//! Levenberg–Marquardt: nonlinear least squares in a few unknowns, also on manifolds.
//!
//! Minimises `F(x) = ½ Σ wᵢ |rᵢ(x)|²`. Each step solves `(H + λ S) δ = -g` with `H = Σ wᵢ JᵢᵀJᵢ`, `g = Σ wᵢ Jᵢᵀ rᵢ` and
//! `S` the greatest diagonal of `H` met so far (Moré 1978), so that unknowns may differ in unit. The damping `λ` follows
//! the gain ratio (Nielsen 1999; Madsen, Nielsen and Tingleff, *Methods for non-linear least squares problems*, 2004,
//! Algorithm 3.16):
//!
//! ```text
//! ϱ = (F(x) - F(x ⊕ δ)) / ½ δᵀ (λ S δ - g)       ϱ > 0:  λ ← λ max(1/3, 1 - (2ϱ - 1)³),  ν ← 2
//!                                                 else:   λ ← λ ν,  ν ← 2 ν
//! ```

use crate::{Error, check};
use nalgebra::{SMatrix, SVector};

/// A least-squares problem in `N` unknowns around a state of any type.
///
/// Sums come through `&mut self`, so that a problem can keep what it needs for them (correspondences, residuals) in
/// memory of its own; what they say must depend on the state alone.
pub trait LeastSquares<const N: usize> {
    /// What is sought: a vector, a pose, a camera.
    type State: Clone;

    /// Adds every residual at `state` with its Jacobian to the normal equations, which come in empty.
    fn linearize(&mut self, state: &Self::State, normal: &mut NormalEquations<N>);

    /// `½ Σ wᵢ |rᵢ|²` at `state`, with the very weights of [`linearize`](Self::linearize).
    fn cost(&mut self, state: &Self::State) -> f64;

    /// `state ⊕ step`, the state that the Jacobians are with respect to.
    fn retract(&self, state: &Self::State, step: &SVector<f64, N>) -> Self::State;
}

/// Sums that residuals are accumulated in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalEquations<const N: usize> {
    /// `Σ w JᵀJ`.
    pub hessian: SMatrix<f64, N, N>,
    /// `Σ w Jᵀr`.
    pub gradient: SVector<f64, N>,
    /// `½ Σ w rᵀr`.
    pub cost: f64,
}

impl<const N: usize> NormalEquations<N> {
    /// Empty sums.
    pub fn zeros() -> Self {
        Self { hessian: SMatrix::zeros(), gradient: SVector::zeros(), cost: 0.0 }
    }

    /// Adds a residual with `M` entries, its Jacobian and its weight.
    #[inline]
    pub fn add<const M: usize>(&mut self, residual: &SVector<f64, M>, jacobian: &SMatrix<f64, M, N>, weight: f64) {
        let weighted = jacobian.transpose() * weight;
        self.hessian += weighted * jacobian;
        self.gradient += weighted * residual;
        self.cost += 0.5 * weight * residual.norm_squared();
    }
}

/// When to stop, and how boldly to start.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LevenbergMarquardtParams {
    /// Most steps that are tried.
    pub max_iterations: usize,
    /// First damping, relative to the diagonal of the Hessian: small if the start is near the minimum.
    pub initial_damping: f64,
    /// At rest when the cosine of the angle between the residuals and every column of the Jacobian is below this.
    pub gradient_tolerance: f64,
    /// At rest when a step promises to lower the cost by less than this part of it.
    pub cost_tolerance: f64,
    /// At rest when every entry of a step is below this, in the unknowns' units; zero turns the test off.
    pub step_tolerance: f64,
}

impl Default for LevenbergMarquardtParams {
    /// Damping as Madsen et al. advise for a start that is not far off; tolerances near the rounding of `f64`, since
    /// the last steps converge fast.
    fn default() -> Self {
        Self {
            max_iterations: 100,
            initial_damping: 1e-3,
            gradient_tolerance: 1e-12,
            cost_tolerance: 1e-15,
            step_tolerance: 0.0,
        }
    }
}

/// Why an iteration came to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum LeastSquaresTermination {
    /// The gradient vanishes: a minimum.
    Gradient,
    /// No step promises to lower the cost any more: a minimum.
    Cost,
    /// The steps have become as small as was asked for.
    Step,
    /// No step, however short, lowers the cost: rounding, or Jacobians that are not those of the residuals.
    Stalled,
    /// As many steps as were allowed.
    MaxIterations,
}

/// Where an iteration came to its end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Minimum<S, const N: usize> {
    /// The state of least cost that was met.
    pub state: S,
    /// Normal equations there: the Hessian's inverse, times the residuals' variance, is the covariance of the state.
    pub normal: NormalEquations<N>,
    /// Steps tried.
    pub iterations: usize,
    /// Why it ended.
    pub termination: LeastSquaresTermination,
}

impl<S, const N: usize> Minimum<S, N> {
    /// Whether it ended at a minimum.
    pub const fn converged(&self) -> bool {
        matches!(
            self.termination,
            LeastSquaresTermination::Gradient | LeastSquaresTermination::Cost | LeastSquaresTermination::Step
        )
    }
}

/// The solver: parameters only, it keeps no state and allocates nothing.
///
/// ```
/// use agv_core::nalgebra::{SVector, Vector1, Vector2};
/// use agv_core::solve::{LeastSquares, LevenbergMarquardt, LevenbergMarquardtParams, NormalEquations};
///
/// /// A position from distances to known beacons.
/// struct Trilateration([(Vector2<f64>, f64); 3]);
///
/// impl LeastSquares<2> for Trilateration {
///     type State = Vector2<f64>;
///     fn linearize(&mut self, position: &Vector2<f64>, normal: &mut NormalEquations<2>) {
///         for (beacon, range) in &self.0 {
///             let away = position - beacon;
///             normal.add(&Vector1::new(away.norm() - range), &away.normalize().transpose(), 1.0);
///         }
///     }
///     fn cost(&mut self, position: &Vector2<f64>) -> f64 {
///         self.0.iter().map(|(beacon, range)| 0.5 * ((position - beacon).norm() - range).powi(2)).sum()
///     }
///     fn retract(&self, position: &Vector2<f64>, step: &SVector<f64, 2>) -> Vector2<f64> {
///         position + step
///     }
/// }
///
/// let truth = Vector2::new(2.0, 1.0);
/// let beacons = [Vector2::new(0.0, 0.0), Vector2::new(5.0, 0.0), Vector2::new(0.0, 4.0)];
/// let mut problem = Trilateration(beacons.map(|b| (b, (truth - b).norm())));
/// let solver = LevenbergMarquardt::new(LevenbergMarquardtParams::default())?;
/// let found = solver.minimize(&mut problem, Vector2::new(4.0, 4.0))?;
/// assert!(found.converged() && (found.state - truth).norm() < 1e-9);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevenbergMarquardt {
    params: LevenbergMarquardtParams,
}

/// Damping beyond which steps are lost in rounding.
const MAX_DAMPING: f64 = 1e20;

/// Rounding of a sum of squares, relative: a promise below it may be broken by chance.
const ROUNDING: f64 = 1e-11;

impl LevenbergMarquardt {
    /// A solver.
    ///
    /// # Errors
    /// [`Error::NotPositive`] or [`Error::Negative`] with the name of the parameter.
    pub fn new(params: LevenbergMarquardtParams) -> Result<Self, Error> {
        check::positive("initial_damping", params.initial_damping)?;
        check::non_negative("gradient_tolerance", params.gradient_tolerance)?;
        check::non_negative("cost_tolerance", params.cost_tolerance)?;
        check::non_negative("step_tolerance", params.step_tolerance)?;
        Ok(Self { params })
    }

    /// Walks from `start` down to a minimum. Trial states whose cost is not finite are turned down like a rise.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if the residuals or the Jacobians at a state of finite cost are not.
    pub fn minimize<const N: usize, P: LeastSquares<N>>(
        &self,
        problem: &mut P,
        start: P::State,
    ) -> Result<Minimum<P::State, N>, Error> {
        let params = &self.params;
        let (mut state, mut normal) = (start, NormalEquations::zeros());
        linearize(problem, &state, &mut normal)?;
        let mut scale = SVector::<f64, N>::zeros();
        let (mut damping, mut growth, mut iterations) = (params.initial_damping, 2.0, 0);
        // What the first step from the present state promised: heavier damping promises less, and means nothing.
        let (mut best_promise, mut longest_step) = (0.0_f64, 0.0_f64);

        let termination = loop {
            scale = scale.zip_map(&normal.hessian.diagonal(), f64::max);
            if gradient_cosine(&normal) <= params.gradient_tolerance {
                break LeastSquaresTermination::Gradient;
            }
            if iterations >= params.max_iterations {
                break LeastSquaresTermination::MaxIterations;
            }
            iterations += 1;
            let mut damped = normal.hessian;
            for i in 0..N {
                // An unknown that no residual depends on yet stays where it is.
                damped[(i, i)] += if scale[i] > 0.0 { damping * scale[i] } else { 1.0 };
            }
            let mut accepted = false;
            if let Some(factor) = damped.cholesky() {
                let step = factor.solve(&-normal.gradient);
                let promised = 0.5 * step.dot(&(scale.component_mul(&step) * damping - normal.gradient));
                (best_promise, longest_step) = (best_promise.max(promised), longest_step.max(step.amax()));
                if best_promise <= params.cost_tolerance * normal.cost {
                    break LeastSquaresTermination::Cost;
                }
                let trial = problem.retract(&state, &step);
                let gained = normal.cost - problem.cost(&trial);
                let gain = gained / promised;
                if gain > 0.0 && gain.is_finite() {
                    state = trial;
                    linearize(problem, &state, &mut normal)?;
                    damping = (damping * (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0)).max(f64::MIN_POSITIVE);
                    (growth, best_promise, longest_step, accepted) = (2.0, 0.0, 0.0, true);
                }
                if step.amax() <= params.step_tolerance {
                    break LeastSquaresTermination::Step;
                }
            }
            if !accepted {
                damping *= growth;
                growth *= 2.0;
                if damping > MAX_DAMPING {
                    // At a perfect fit the cost itself is rounding, and so is the step.
                    let at_rest = best_promise <= ROUNDING * normal.cost || longest_step <= 1e-13;
                    break if at_rest { LeastSquaresTermination::Cost } else { LeastSquaresTermination::Stalled };
                }
            }
        };
        Ok(Minimum { state, normal, iterations, termination })
    }
}

fn linearize<const N: usize, P: LeastSquares<N>>(
    problem: &mut P,
    state: &P::State,
    normal: &mut NormalEquations<N>,
) -> Result<(), Error> {
    *normal = NormalEquations::zeros();
    problem.linearize(state, normal);
    check::finite("cost", normal.cost)?;
    check::all_finite("gradient", normal.gradient.iter())?;
    check::all_finite("hessian", normal.hessian.iter())
}

/// Greatest `|Jᵢᵀ r| / (|Jᵢ| |r|)` over the unknowns: how far the residuals are from orthogonal to the columns of the
/// Jacobian, whatever the units. Zero at a perfect fit.
fn gradient_cosine<const N: usize>(normal: &NormalEquations<N>) -> f64 {
    let residual = (2.0 * normal.cost).sqrt();
    (0..N)
        .map(|i| {
            let size = normal.hessian[(i, i)].sqrt() * residual;
            if size > 0.0 { normal.gradient[i].abs() / size } else { 0.0 }
        })
        .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests;
