//! Particle swarms: standard, that of paper 000, and an improved one.

mod inertia;
mod params;
mod sensing;
mod swarm;
mod topology;

pub use inertia::Inertia;
pub use params::{Acceleration, Boundary, SwarmParams};
pub use sensing::{Sensing, Threshold};
pub use swarm::Swarm;
pub use topology::Topology;
