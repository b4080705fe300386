//! Discrete PID controllers.
//!
//! Paper 000, Eq. 25 in its right form, `u = Kp e + Ki ∫e + Kd de/dt`, as industrial controllers write it (Åström and
//! Murray, *Feedback Systems*, 2nd ed., section 11.5):
//!
//! ```text
//! u = Kp (β r - y) + I - D + f,      I' = Ki (r - y) + (u_limited - u) / Tt,      D = Kd s / (1 + Tf s) y
//! ```
//!
//! with `r` the set-point, `y` the measurement and `f` a feed-forward. The derivative acts on the measurement, so that a
//! step of the set-point does not kick the actuator; the filter `Tf` is discretised by backward differences, which is
//! stable for every `dt`. The integral holds `Ki ∫e`, not `∫e`, so that a change of `Ki` does not move the output.
//!
//! - [`Pid`]: the positional form.
//! - [`VelocityPid`]: the velocity form, which computes changes of the output and has no integral that could wind up.

mod controller;
mod params;
#[cfg(test)]
mod tests;
mod timing;
mod velocity;

pub use controller::Pid;
pub use params::{AntiWindup, PidParams};
pub use velocity::VelocityPid;
