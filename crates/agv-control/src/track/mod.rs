//! Path trackers: what keeps a vehicle on its path.
//!
//! All share one [`Follower`]: it projects the vehicle onto the path, keeps the progress, plans the speed (curvature,
//! limits, a stop at the end and at cusps), executes turns on the spot, and keeps the command within the limits. What differs is
//! the [`Steering`] law:
//!
//! - [`PurePursuit`]: an arc to a point ahead (Coulter 1992; regulated as Macenski et al. 2023).
//! - [`Stanley`]: the front axle back to its track (Hoffmann et al. 2007).
//! - [`PidTracker`]: cross-track and heading errors in cascade (paper 000, section 3).
//!
//! The follower also knows how the vehicle answers: the lag of its drives, and the slip of its wheels, which it learns. Laws
//! steer by [`SteeringInput::predicted`], the errors when the drives will have done what they were told.

mod course;
mod follower;
mod pid;
mod pure_pursuit;
mod response;
mod small_angle;
mod speed;
mod stanley;
mod steering;

pub use course::{Course, Leg, Projection};
pub use follower::{Facing, Follower, FollowerParams};
pub use pid::{PidSteering, PidTracker, PidTrackerParams};
pub use pure_pursuit::{PurePursuit, PurePursuitParams, PurePursuitSteering};
pub use speed::SpeedProfile;
pub use stanley::{Stanley, StanleyParams, StanleySteering};
pub use steering::{Prediction, Steering, SteeringInput};
