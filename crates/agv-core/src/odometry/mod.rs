//! What wheels and gyros say of the motion between two moments.
//!
//! Encoder counts become increments in [`WheelOdometry`], gyro rates become a turn in [`YawIntegrator`], and
//! [`gyrodometry`] joins the two. Increments compose with [`OdometryIncrement::then`] and carry their covariance along.
//! [`UmbMark`] finds the systematic errors of a differential drive, [`RotTransRot`] is the form in which motion models
//! state the random ones.

mod calibration;
mod compose;
mod encoder;
mod gyro_bias;
mod imu;
mod increment;
mod rolling;
mod rot_trans_rot;
mod wheels;

pub use calibration::{SquareRuns, UmbMark};
pub use compose::OdometryAccumulator;
pub use encoder::{EncoderParams, TickCounter};
pub use gyro_bias::GyroBiasEstimator;
pub use imu::{YawIncrement, YawIntegrator, gyrodometry};
pub use increment::{MotionIncrement, OdometryIncrement};
pub use rolling::RollingModel;
pub use rot_trans_rot::RotTransRot;
pub use wheels::{WheelNoise, WheelOdometry};
