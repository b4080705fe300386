//! Levenberg–Marquardt: nonlinear least squares, also on manifolds, in a few unknowns or in many that hang together in a
//! structure ([`NormalSystem`]).
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

use super::{NormalEquations, NormalSystem};
use crate::{Error, check};
use nalgebra::SVector;

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

/// A least-squares problem of any structure and size: the sums are those of `S`.
pub trait StructuredLeastSquares<S: NormalSystem> {
    /// What is sought: a band of poses, a graph. `clone_from` should keep its memory, as that of a `Vec` does.
    type State: Clone;

    /// Adds every residual at `state` with its Jacobian to the sums, which come in empty.
    fn linearize(&mut self, state: &Self::State, system: &mut S);

    /// The cost at `state`, with the very weights and kernels of [`linearize`](Self::linearize).
    fn cost(&mut self, state: &Self::State) -> f64;

    /// Makes `trial` the state `state ⊕ step`; it comes in with some state of the same problem, whose memory serves.
    fn retract_into(&self, state: &Self::State, step: &[f64], trial: &mut Self::State);
}

/// A small dense problem in the clothes of a structured one.
struct Dense<'a, P>(&'a mut P);

impl<const N: usize, P: LeastSquares<N>> StructuredLeastSquares<NormalEquations<N>> for Dense<'_, P> {
    type State = P::State;

    #[inline]
    fn linearize(&mut self, state: &P::State, normal: &mut NormalEquations<N>) {
        self.0.linearize(state, normal);
    }

    #[inline]
    fn cost(&mut self, state: &P::State) -> f64 {
        self.0.cost(state)
    }

    #[inline]
    fn retract_into(&self, state: &P::State, step: &[f64], trial: &mut P::State) {
        *trial = self.0.retract(state, &SVector::from_column_slice(step));
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

impl LeastSquaresTermination {
    /// Whether it is the end at a minimum.
    pub const fn converged(self) -> bool {
        matches!(self, Self::Gradient | Self::Cost | Self::Step)
    }
}

impl<S, const N: usize> Minimum<S, N> {
    /// Whether it ended at a minimum.
    pub const fn converged(&self) -> bool {
        self.termination.converged()
    }
}

/// How a structured problem came to its end; the state and the sums are where they were given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeastSquaresReport {
    /// The least cost that was met.
    pub cost: f64,
    /// Steps tried.
    pub iterations: usize,
    /// Why it ended.
    pub termination: LeastSquaresTermination,
}

/// The memory of structured problems, which serves one after the other.
#[derive(Debug, Clone)]
pub struct LeastSquaresWorkspace<S, T> {
    /// The sums: to be given the problem's size before it is solved, and at the end those at the minimum.
    pub system: S,
    trial: T,
    scale: Vec<f64>,
    step: Vec<f64>,
}

impl<S, T> LeastSquaresWorkspace<S, T> {
    /// A workspace around sums; `state` is any state of the problem, whose memory it will use.
    pub const fn new(system: S, state: T) -> Self {
        Self { system, trial: state, scale: Vec::new(), step: Vec::new() }
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
        let (mut state, mut trial, mut normal) = (start.clone(), start, NormalEquations::zeros());
        let (mut scale, mut step) = ([0.0; N], [0.0; N]);
        let memory = Memory { trial: &mut trial, scale: &mut scale, step: &mut step };
        let (iterations, termination) = self.descend(&mut Dense(problem), &mut state, &mut normal, memory)?;
        Ok(Minimum { state, normal, iterations, termination })
    }

    /// Walks from `state` down to a minimum of a problem of any structure. Allocates nothing once the workspace has met a
    /// problem of this size.
    ///
    /// # Errors
    /// As [`minimize`](Self::minimize), and [`Error::OutOfRange`] for a residual that the structure has no place for;
    /// `state` is then the last one whose sums were good.
    pub fn minimize_structured<S: NormalSystem, P: StructuredLeastSquares<S>>(
        &self,
        problem: &mut P,
        state: &mut P::State,
        workspace: &mut LeastSquaresWorkspace<S, P::State>,
    ) -> Result<LeastSquaresReport, Error> {
        let LeastSquaresWorkspace { system, trial, scale, step } = workspace;
        for vector in [&mut *scale, &mut *step] {
            vector.clear();
            vector.resize(system.dimension(), 0.0);
        }
        trial.clone_from(state);
        let memory = Memory { trial, scale, step };
        let (iterations, termination) = self.descend(problem, state, system, memory)?;
        Ok(LeastSquaresReport { cost: system.cost(), iterations, termination })
    }

    fn descend<S: NormalSystem, P: StructuredLeastSquares<S>>(
        &self,
        problem: &mut P,
        state: &mut P::State,
        system: &mut S,
        memory: Memory<'_, P::State>,
    ) -> Result<(usize, LeastSquaresTermination), Error> {
        let (params, Memory { trial, scale, step }) = (&self.params, memory);
        linearize(problem, state, system)?;
        let (mut damping, mut growth, mut iterations) = (params.initial_damping, 2.0, 0);
        // What the first step from the present state promised: heavier damping promises less, and means nothing.
        let (mut best_promise, mut longest_step) = (0.0_f64, 0.0_f64);

        let termination = loop {
            for (i, scale) in scale.iter_mut().enumerate() {
                *scale = scale.max(system.diagonal(i));
            }
            if gradient_cosine(system) <= params.gradient_tolerance {
                break LeastSquaresTermination::Gradient;
            }
            if iterations >= params.max_iterations {
                break LeastSquaresTermination::MaxIterations;
            }
            iterations += 1;
            let mut accepted = false;
            if system.solve_damped(damping, scale, step) {
                let (mut promised, mut length) = (0.0, 0.0_f64);
                for ((step, scale), gradient) in step.iter().zip(&*scale).zip(system.gradient()) {
                    promised += 0.5 * step * (damping * scale * step - gradient);
                    length = length.max(step.abs());
                }
                (best_promise, longest_step) = (best_promise.max(promised), longest_step.max(length));
                let cost = system.cost();
                if best_promise <= params.cost_tolerance * cost {
                    break LeastSquaresTermination::Cost;
                }
                problem.retract_into(state, step, trial);
                let gain = (cost - problem.cost(trial)) / promised;
                if gain > 0.0 && gain.is_finite() {
                    std::mem::swap(state, trial);
                    linearize(problem, state, system).inspect_err(|_| std::mem::swap(state, trial))?;
                    damping = (damping * (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0)).max(f64::MIN_POSITIVE);
                    (growth, best_promise, longest_step, accepted) = (2.0, 0.0, 0.0, true);
                }
                if length <= params.step_tolerance {
                    break LeastSquaresTermination::Step;
                }
            }
            if !accepted {
                damping *= growth;
                growth *= 2.0;
                if damping > MAX_DAMPING {
                    // At a perfect fit the cost itself is rounding, and so is the step.
                    let at_rest = best_promise <= ROUNDING * system.cost() || longest_step <= 1e-13;
                    break if at_rest { LeastSquaresTermination::Cost } else { LeastSquaresTermination::Stalled };
                }
            }
        };
        Ok((iterations, termination))
    }
}

/// What a descent writes in beside the state and the sums.
struct Memory<'a, T> {
    trial: &'a mut T,
    scale: &'a mut [f64],
    step: &'a mut [f64],
}

#[inline]
fn linearize<S: NormalSystem, P: StructuredLeastSquares<S>>(
    problem: &mut P,
    state: &P::State,
    system: &mut S,
) -> Result<(), Error> {
    system.clear();
    problem.linearize(state, system);
    system.check()
}

/// Greatest `|Jᵢᵀ r| / (|Jᵢ| |r|)` over the unknowns: how far the residuals are from orthogonal to the columns of the
/// Jacobian, whatever the units. Zero at a perfect fit.
#[inline]
fn gradient_cosine(system: &impl NormalSystem) -> f64 {
    let residual = (2.0 * system.cost()).sqrt();
    let cosine = |(i, gradient): (usize, &f64)| {
        let size = system.diagonal(i).sqrt() * residual;
        if size > 0.0 { gradient.abs() / size } else { 0.0 }
    };
    system.gradient().iter().enumerate().map(cosine).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests;
