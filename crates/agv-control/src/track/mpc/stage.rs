//! One stage of the horizon: what the vehicle is expected to do, and how it answers to more or less of it.
//!
//! The error state is `(σ, y, θ, V, T, W)`: how far the vehicle is ahead of the reference along the path, to the left of it, and
//! turned from it, and what its drives do: speed, turn (the turn rate, or the steering angle) and sideways speed. About the
//! reference, which moves at `v` on a path of curvature `κ` that changes by `κ'` per metre,
//!
//! ```text
//! σ' = V - v + v κ y        y' = v θ + W        θ' = ω(V, T) - κ V - v (κ' σ + κ² y)        a' = (u - a) / τ
//! ```
//!
//! with `ω = g T`, or `ω = g V tan(T) / wheelbase` linearised. A vehicle that is slower turns with the path more slowly: so the
//! programme knows that slowing down is a way to keep to a bend. What follows the held inputs is sampled exactly.

use super::super::lateral::Sampled;

/// Errors and drives.
pub(super) type State = [f64; 6];

/// Entries of [`State`] that the cost looks at.
pub(super) const SIDE: usize = 1;
pub(super) const HEADING: usize = 2;

/// First drive in [`State`].
pub(super) const DRIVES: usize = 3;

/// What the vehicle is expected to do in a stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Stage {
    /// Mean speed, in metres per second.
    pub(super) speed: f64,
    /// Mean curvature of the path and its change per metre, in 1/m and 1/m².
    pub(super) curvature: f64,
    pub(super) slope: f64,
    /// Speed and turn that are commanded if nothing is amiss.
    pub(super) inputs: [f64; 2],
    /// Turn rate of the vehicle per unit of turn and of speed, and the rest of it, in 1/s or so.
    pub(super) turn: f64,
    pub(super) per_speed: f64,
    pub(super) rest: f64,
}

impl Stage {
    /// The linear part of a stage without inputs.
    #[inline]
    pub(super) fn advance(&self, x: &State, step: &Sampled) -> State {
        let [along, side, heading, speed, turn, sideways] = *x;
        let (v, dt, kept) = (self.speed, step.dt, step.kept);
        let rate = self.turn * turn + (self.per_speed - self.curvature) * speed;
        [
            along + step.once[0] * speed + dt * v * self.curvature * side,
            side + v * (dt * heading + step.twice[0] * rate) + step.once[0] * sideways,
            heading + step.once[0] * rate - dt * v * (self.slope * along + self.curvature * self.curvature * side),
            kept * speed,
            kept * turn,
            kept * sideways,
        ]
    }

    /// What comes of nothing: the reference moves on.
    #[inline]
    pub(super) fn drift(&self, step: &Sampled) -> State {
        let dt = step.dt;
        [-self.speed * dt, 0.5 * self.speed * self.rest * dt * dt, self.rest * dt, 0.0, 0.0, 0.0]
    }

    /// What comes of one unit of an input.
    #[inline]
    pub(super) fn response(&self, input: usize, step: &Sampled) -> State {
        let (once, twice, new) = (step.once[1], step.twice[1], 1.0 - step.kept);
        let turning = |rate: f64| (self.speed * twice * rate, once * rate);
        match input {
            0 => {
                let (side, heading) = turning(self.per_speed - self.curvature);
                [once, side, heading, new, 0.0, 0.0]
            }
            1 => {
                let (side, heading) = turning(self.turn);
                [0.0, side, heading, 0.0, new, 0.0]
            }
            _ => [0.0, once, 0.0, 0.0, 0.0, new],
        }
    }

    /// Excess of the turn rate over that of the path, as a linear part of the state; [`rest`](Self::rest) is to be added.
    pub(super) fn excess(&self, x: &State) -> f64 {
        self.turn * x[DRIVES + 1] + (self.per_speed - self.curvature) * x[DRIVES]
    }
}
