//! Path trackers: what keeps a vehicle on its path.
//!
//! All share one [`Follower`]: it projects the vehicle onto the path, keeps the progress, plans the speed (curvature,
//! limits, a stop at the end and at cusps), executes turns on the spot, and keeps the command within the limits. What differs is
//! the [`Steering`] law:
//!
//! - [`PurePursuit`]: an arc to a point ahead (Coulter 1992; regulated as Macenski et al. 2023).
//! - [`PidTracker`]: cross-track and heading errors in cascade (paper 000, section 3).

mod course;
mod follower;
mod pid;
mod pure_pursuit;
mod speed;
mod steering;

pub use course::{Course, Leg, Projection};
pub use follower::{Follower, FollowerParams};
pub use pid::{PidSteering, PidTracker, PidTrackerParams};
pub use pure_pursuit::{PurePursuit, PurePursuitParams, PurePursuitSteering};
pub use speed::SpeedProfile;
pub use steering::{Steering, SteeringInput};
