//! Laws that models obey, for tests: those of this crate, and a user's own.
//!
//! Each returns by how much the law is broken at worst, as a number that a test bounds.

use super::{Manifold, MeasurementModel, ProcessModel};
use nalgebra::SVector;

/// Step of the central differences: their error falls with its square, their rounding grows as it shrinks.
const STEP: f64 = 1e-5;

/// The greatest entry by which [`ProcessModel::jacobian`] differs from central differences, relative to entries above one; the
/// parts of [`ProcessModel::linearize`] are compared with it as well.
pub fn process_jacobian<X: Manifold<N>, P: ProcessModel<X, N>, const N: usize>(
    model: &P,
    state: &X,
    control: &P::Control,
    dt: f64,
) -> f64 {
    let (end, stated) = (model.transition(state, control, dt), model.jacobian(state, control, dt));
    let at_once = model.linearize(state, control, dt);
    let mut worst = at_once.state.boxminus(&end).amax();
    worst = worst.max((at_once.jacobian - stated).amax());
    worst = worst.max((at_once.noise - model.noise(state, control, dt)).amax());
    for column in 0..N {
        let mut step = SVector::<f64, N>::zeros();
        step[column] = STEP;
        let moved = |sign: f64| model.transition(&state.boxplus(&(step * sign)), control, dt).boxminus(&end);
        let difference = (moved(1.0) - moved(-1.0)) / (2.0 * STEP);
        worst = worst.max((difference - stated.column(column)).amax() / stated.column(column).amax().max(1.0));
    }
    worst
}

/// As [`process_jacobian`], of [`MeasurementModel::jacobian`].
pub fn measurement_jacobian<X: Manifold<N>, H: MeasurementModel<X, N, M>, const N: usize, const M: usize>(
    model: &H,
    state: &X,
) -> f64 {
    let (expected, stated) = (model.predict(state), model.jacobian(state));
    let at_once = model.linearize(state);
    let mut worst = model.residual(&at_once.value, &expected).amax();
    worst = worst.max((at_once.jacobian - stated).amax());
    worst = worst.max((at_once.noise - model.noise(state)).amax());
    for column in 0..N {
        let mut step = SVector::<f64, N>::zeros();
        step[column] = STEP;
        let read = |sign: f64| model.residual(&model.predict(&state.boxplus(&(step * sign))), &expected);
        let difference = (read(1.0) - read(-1.0)) / (2.0 * STEP);
        worst = worst.max((difference - stated.column(column)).amax() / stated.column(column).amax().max(1.0));
    }
    worst
}

/// How far a state with an increment of moderate size is from the laws of [`Manifold`]: `x ⊞ 0 = x`, `(x ⊞ δ) ⊟ x = δ`,
/// `x ⊞ (y ⊟ x) = y`, and the reset's Jacobian against differences.
pub fn manifold<X: Manifold<N>, const N: usize>(state: &X, increment: &SVector<f64, N>) -> f64 {
    let moved = state.boxplus(increment);
    let mut worst = state.boxplus(&SVector::zeros()).boxminus(state).amax();
    worst = worst.max((moved.boxminus(state) - increment).amax());
    worst = worst.max(state.boxplus(&moved.boxminus(state)).boxminus(&moved).amax());
    let stated = X::reset_jacobian(increment).unwrap_or_else(nalgebra::SMatrix::identity);
    for column in 0..N {
        let mut step = SVector::<f64, N>::zeros();
        step[column] = STEP;
        let reset = |sign: f64| state.boxplus(&(increment + step * sign)).boxminus(&moved);
        let difference = (reset(1.0) - reset(-1.0)) / (2.0 * STEP);
        worst = worst.max((difference - stated.column(column)).amax());
    }
    worst
}
