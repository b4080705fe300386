//! The dynamic window approach: of the velocities that the vehicle can reach soon, the one whose trajectory is best.
//!
//! After Fox, Burgard and Thrun, *The dynamic window approach to collision avoidance* (1997), with the navigation function of Brock and
//! Khatib's global variant (1999) among its critics. What is looked at is
//!
//! ```text
//! V_m ∩ V_d ∩ V_a        V_m: within the limits   V_d: within reach in the window's time   V_a: from which one can brake
//! ```
//!
//! The first two are a grid of samples, with the window's edges and zero always among them; the third is what the
//! [`Guard`](crate::local::Guard) decides on the best in turn.

mod params;
mod planner;
mod sampler;

pub use params::{AdaptiveWindow, DwaParams};
pub use planner::Dwa;
