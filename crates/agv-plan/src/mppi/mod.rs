//! Model predictive path integral control: many sequences of commands are tried, and their mean, weighed by what they cost, is begun.
//!
//! After Williams et al., *Information theoretic MPC for model-based reinforcement learning* (2017) and *Information-theoretic model
//! predictive control: theory and applications to autonomous driving* (2018):
//!
//! ```text
//! V_i = U + ε_i         ε_i: noise       w_i = exp(-(S(V_i) - min S) / λ)       U ← Σ w_i V_i / Σ w_i
//! ```
//!
//! `U` is what was planned in the last cycle, moved on in time. Noise is Gaussian at knots in time and linear in between, which is smooth by
//! itself. What is rolled out, scored and averaged is what the vehicle would do: each sequence is led through the limits of speed and
//! acceleration first. A part of the samples are plain arcs, which look where `U` does not.
//!
//! A mean of ways around both sides of an obstacle leads into it. So it is rolled out as well, and where it is worse than the best sample
//! by more than `temperature`, that is taken instead; and whatever is taken begins with a command that the [`Guard`](crate::local::Guard) lets pass.

mod block;
mod params;
mod planner;
mod proposal;

pub use params::MppiParams;
pub use planner::Mppi;
