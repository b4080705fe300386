//! Wheels and an inertial unit as one odometry.

use crate::Error;
use agv_core::{geometry::Se3, nalgebra::Matrix3};
use agv_core::{
    geometry::{LieGroup, Se2},
    odometry::{MotionIncrement, OdometryIncrement},
    roles::PoseBelief,
    sensors::ImuSample,
};
use agv_filters::fusion::{FusionFilter, FusionParams, SourceId, SourceParams};

/// A Kalman filter over wheel odometry and an inertial unit that hands out motions with their covariance: what a localizer predicts
/// with. Nothing that the localizer says comes back to it, so that nothing counts twice.
///
/// ```
/// use agv_nav::{core::odometry::OdometryIncrement, filters::fusion::*, pipeline::csns::InertialOdometry, prelude::*};
///
/// let mut odometry = InertialOdometry::new(FusionParams::default(), SourceParams::wheels(), SourceParams::imu())?;
/// let start = Stamp::default();
/// let wheels = OdometryIncrement::between(start, &Se2::default(), start + 0.1, &Se2::new(0.1, 0.0, 0.0))?;
/// let motion = odometry.update(&wheels, [])?;
/// assert!((motion.start_from_end.translation().x - 0.1).abs() < 1e-6);
/// # Ok::<(), agv_nav::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct InertialOdometry {
    filter: FusionFilter,
    wheels: SourceId,
    imu: SourceId,
}

impl InertialOdometry {
    /// An odometry at rest.
    ///
    /// # Errors
    /// A parameter that is out of its range.
    pub fn new(params: FusionParams, wheels: SourceParams, imu: SourceParams) -> Result<Self, Error> {
        let mut filter = FusionFilter::new(params)?;
        let (wheels, imu) = (filter.add_source(wheels)?, filter.add_source(imu)?);
        filter.initialize(&PoseBelief::around(Se2::identity(), Matrix3::identity() * 1e-6)?)?;
        Ok(Self { filter, wheels, imu })
    }

    /// Takes what the wheels and the inertial unit say of a time step, and returns the motion in it, in space.
    ///
    /// The first motion is that of the wheels alone.
    ///
    /// # Errors
    /// A reading that is none; what came before it in the same call is taken in.
    pub fn update<'a>(
        &mut self,
        wheels: &OdometryIncrement,
        imu: impl IntoIterator<Item = &'a ImuSample>,
    ) -> Result<MotionIncrement<Se3>, Error> {
        self.filter.fuse(self.wheels, *wheels)?;
        for sample in imu {
            self.filter.fuse(self.imu, *sample)?;
        }
        Ok((&self.filter.take_motion()?.unwrap_or(*wheels)).into())
    }

    /// The filter, with its diagnostics.
    pub const fn filter(&self) -> &FusionFilter {
        &self.filter
    }
}
