//! Monte Carlo localisation: the particle filter that plays [`Localizer`](agv_core::roles::Localizer).

#[cfg(feature = "serde")]
mod checkpoint;
mod filter;
mod gaussian;
mod role;

#[cfg(feature = "serde")]
pub use checkpoint::MclCheckpoint;
pub use filter::{Mcl, MclDiagnostics, MclParams};
