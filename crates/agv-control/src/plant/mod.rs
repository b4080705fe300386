//! Plants: what a controller drives, as models with one input and one output.
//!
//! - [`TransferFunction`] and [`LinearPlant`]: any proper `G(s)` with dead time and a limited actuator, exact at the
//!   samples.
//! - [`CrossTrackPlant`] and [`DrivePlant`]: the AGV's own, beside its path and as a drive with a load.
//! - [`StandIn`]: the plants on which tuning is compared.

pub(crate) mod actuator;
mod cross_track;
mod drive;
mod expm;
mod linear;
mod stand_ins;
pub(crate) mod state_space;
#[cfg(test)]
mod tests;
mod transfer_function;

pub use actuator::ActuatorLimits;
pub use cross_track::{CrossTrackParams, CrossTrackPlant};
pub use drive::{DriveParams, DrivePlant};
pub use linear::LinearPlant;
pub use stand_ins::StandIn;
pub use transfer_function::{MAX_ORDER, TransferFunction};

use crate::Error;

/// A system with one input and one output, simulated in steps. Plants are values: a clone goes on from the same state.
///
/// ```
/// use agv_control::plant::{LinearPlant, Plant, TransferFunction};
///
/// // A first-order lag of one second reaches 63 % in one second, whatever the step.
/// let mut plant = LinearPlant::new(TransferFunction::new(&[1.0], &[1.0, 1.0])?)?;
/// for _ in 0..4 {
///     plant.step(1.0, 0.25)?;
/// }
/// assert!((plant.output() - (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
/// # Ok::<(), agv_control::Error>(())
/// ```
pub trait Plant {
    /// The output now, in the measurement's unit.
    fn output(&self) -> f64;

    /// Holds `input` for `dt` seconds; the output at their end. An unstable plant may grow until the numbers end: who
    /// simulates one looks at the output.
    ///
    /// # Errors
    /// An input that is not finite, or a `dt` that is not positive or that the plant cannot be discretised for; the
    /// plant is then as it was.
    fn step(&mut self, input: f64, dt: f64) -> Result<f64, Error>;

    /// Back to rest.
    fn reset(&mut self);
}
