//! Particle swarms: standard, that of paper 000, and an improved one.
//!
//! A [`Swarm`] is an [`Optimizer`](crate::optimize::Optimizer); what it does follows from its [`SwarmParams`], of which
//! [`standard`](SwarmParams::standard), [`paper`](SwarmParams::paper) and [`improved`](SwarmParams::improved) are three.
//! With [`Sensing`] it notices that its objective has changed and begins anew; [`MovingPeaks`] is the objective on which
//! that is measured.

mod inertia;
mod moving_peaks;
mod params;
mod sensing;
mod swarm;
mod topology;

pub use inertia::Inertia;
pub use moving_peaks::{MovingPeaks, MovingPeaksParams};
pub use params::{Acceleration, Boundary, SwarmParams};
pub use sensing::{Sensing, Threshold};
pub use swarm::Swarm;
pub use topology::Topology;
