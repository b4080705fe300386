//! Path trackers: what keeps a vehicle on its path.
//!
//! All share one [`Follower`]: it projects the vehicle onto the path, keeps the progress, plans the speed (curvature,
//! limits, a stop at the end and at cusps), executes turns on the spot, and keeps the command within the limits. What differs is
//! the [`Steering`] law:
//!
//! - [`PurePursuit`]: an arc to a point ahead (Coulter 1992; regulated as Macenski et al. 2023).
//! - [`Stanley`]: the front axle back to its track (Hoffmann et al. 2007).
//! - [`Lqr`]: optimal feedback of a filtered state, and the turn rate of the bend ahead.
//! - [`Mpc`]: a horizon of inputs within the limits, planned anew each cycle.
//! - [`PidTracker`]: cross-track and heading errors in cascade (paper 000, section 3).
//!
//! The follower also knows how the vehicle answers: the lag of its drives, and the slip of its wheels, which it learns. Laws
//! steer by [`SteeringInput::predicted`], the errors when the drives will have done what they were told. The optimal two have the lag
//! in their model and a filter of their own for pose and slip: give them poses as they are measured, not led ahead.

mod errors;
mod follower;
mod lateral;
mod lqr;
mod mpc;
mod observer;
mod pid;
mod pure_pursuit;
mod response;
mod riccati;
mod stanley;
mod steering;

pub use follower::{Facing, Follower, FollowerParams};
pub use lateral::TrackingWeights;
pub use lqr::{Lqr, LqrParams, LqrSteering};
pub use mpc::{Mpc, MpcParams, MpcReport, MpcSource, MpcSteering};
pub use observer::ObserverParams;
pub use pid::{PidSteering, PidTracker, PidTrackerParams};
pub use pure_pursuit::{PurePursuit, PurePursuitParams, PurePursuitSteering};
pub use riccati::{Regulator, riccati};
pub use stanley::{Stanley, StanleyParams, StanleySteering};
pub use steering::{Prediction, Steering, SteeringInput};
