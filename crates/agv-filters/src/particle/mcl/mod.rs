//! Monte Carlo localisation: the particle filter that plays [`Localizer`](agv_core::roles::Localizer).

mod belief;
#[cfg(feature = "serde")]
mod checkpoint;
mod correct;
mod filter;
mod params;
mod role;
mod swarm;
mod temper;

#[cfg(feature = "serde")]
pub use checkpoint::MclCheckpoint;
pub(super) use correct::{Adapt, Seen};
pub use filter::Mcl;
pub use params::{MclDiagnostics, MclParams};
pub use temper::TemperingParams;
