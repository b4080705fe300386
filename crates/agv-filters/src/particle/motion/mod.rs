//! Where a vehicle may have gone, given what its odometry says.

mod ackermann;
mod differential;
mod omnidirectional;
mod prior;
mod sampler;
mod velocity;

use agv_core::{compute::Stream, geometry::Se2};
use nalgebra::Matrix3;

pub use ackermann::{AckermannOdometryModel, AckermannOdometryParams};
pub use differential::{DifferentialOdometryModel, OdometryNoise};
pub use omnidirectional::{OmnidirectionalNoise, OmnidirectionalOdometryModel};
pub use prior::{PriorMotionModel, PriorNoise};
pub use velocity::{VelocityModel, VelocityNoise};

/// A model is its parameters, checked: so it is stored, and so it comes back.
macro_rules! stored_as {
    ($params:ident => $model:ident.$field:ident) => {
        impl TryFrom<$params> for $model {
            type Error = agv_core::Error;

            fn try_from(params: $params) -> Result<Self, agv_core::Error> {
                Self::new(params)
            }
        }

        impl From<$model> for $params {
            fn from(model: $model) -> Self {
                model.$field
            }
        }
    };
}
use stored_as;

/// Refuses the first of some fields that is negative or not finite, by its name.
macro_rules! check_factors {
    ($params:ident: $($field:ident),+) => {
        $(agv_core::check::non_negative(stringify!($field), $params.$field)?;)+
    };
}
use check_factors;

/// Samples where a vehicle may have gone, given what its odometry says.
///
/// Conditioned once per motion; what it returns is called once per particle and draws from the particle's stream only.
/// [`Mcl`](super::Mcl) takes models whose `Motion` is [`OdometryIncrement`](agv_core::odometry::OdometryIncrement).
///
/// ```
/// use agv_core::compute::{Seed, Stream};
/// use agv_core::geometry::{LieGroup, Se2};
/// use agv_core::nalgebra::{Matrix3, Vector3};
/// use agv_core::odometry::OdometryIncrement;
/// use agv_filters::particle::MotionModel;
/// use rand_distr::{Distribution, StandardNormal};
///
/// /// The odometry is right but for the heading.
/// struct HeadingNoise { sigma: f64 }
///
/// impl MotionModel for HeadingNoise {
///     type Motion = OdometryIncrement;
///
///     fn condition<'a>(&'a self, motion: &'a OdometryIncrement) -> impl Fn(&Se2, &mut Stream) -> Se2 + Sync + 'a {
///         move |pose, stream| {
///             let z: f64 = StandardNormal.sample(stream);
///             (*pose * motion.start_from_end).plus(&Vector3::new(0.0, 0.0, self.sigma * z))
///         }
///     }
///     fn covariance(&self, _: &OdometryIncrement) -> Matrix3<f64> {
///         Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, self.sigma * self.sigma))
///     }
/// }
///
/// let motion = OdometryIncrement {
///     start: Default::default(), end: Default::default(),
///     start_from_end: Se2::new(0.3, 0.0, 0.0), covariance: Matrix3::zeros(),
/// };
/// let model = HeadingNoise { sigma: 0.1 };
/// let moved = model.condition(&motion)(&Se2::identity(), &mut Seed(1).stream(0, 0));
/// assert_eq!(moved.x(), 0.3);
/// ```
pub trait MotionModel: Sync {
    /// What the odometry reports between two updates.
    type Motion;

    /// Hoists everything that does not depend on the particle; the result is called once per particle.
    fn condition<'a>(&'a self, motion: &'a Self::Motion) -> impl Fn(&Se2, &mut Stream) -> Se2 + Sync + 'a;

    /// Moves many particles, each as the sampler of [`condition`](Self::condition) would, in order and with the same bits; both
    /// slices have the same length.
    ///
    /// For models that have a faster way for many; called once per chunk of particles.
    fn propagate(&self, motion: &Self::Motion, poses: &[Se2], moved: &mut [Se2], stream: &mut Stream) {
        let sample = self.condition(motion);
        for (moved, pose) in moved.iter_mut().zip(poses) {
            *moved = sample(pose, stream);
        }
    }

    /// Covariance of the motion to first order, over `(x, y, yaw)` in the base frame of its end (m², m rad, rad²):
    /// what an estimate loses in certainty until the particles themselves have moved. Symmetric and positive
    /// semi-definite.
    fn covariance(&self, motion: &Self::Motion) -> Matrix3<f64>;
}
