//! What wheels and gyros say of the motion between two moments.

mod increment;

pub use increment::OdometryIncrement;
