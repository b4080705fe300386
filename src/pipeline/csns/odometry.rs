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
/// let motion = odometry.update(&wheels, [])?.ok_or("time has passed")?;
/// assert!((motion.start_from_end.translation().x - 0.1).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct InertialOdometry {
    filter: FusionFilter,
    wheels: SourceId,
    imu: SourceId,
    /// Whether a motion was handed out.
    begun: bool,
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
        Ok(Self { filter, wheels, imu, begun: false })
    }

    /// Takes what the wheels and the inertial unit say of a time step, and returns the motion since the last one handed out, in
    /// space, up to the newest reading; none where no time has passed since, as with a reading that comes twice or one of the wheels
    /// that is later than the inertial unit's.
    ///
    /// The first motion is that of the wheels alone. After a clock was set back, the motion across that step is not known, and none.
    ///
    /// # Errors
    /// A reading that is none; what came before it in the same call is taken in.
    pub fn update<'a>(
        &mut self,
        wheels: &OdometryIncrement,
        imu: impl IntoIterator<Item = &'a ImuSample>,
    ) -> Result<Option<MotionIncrement<Se3>>, Error> {
        self.filter.fuse(self.wheels, *wheels)?;
        let first = (!self.begun).then_some(*wheels);
        if first.is_some() {
            // From here on the filter counts: the end of the first motion, whatever the inertial unit knows of later.
            self.filter.take_motion()?;
            self.begun = true;
        }
        for sample in imu {
            self.filter.fuse(self.imu, *sample)?;
        }
        let motion = match first {
            Some(wheels) => Some(wheels),
            None => self.filter.take_motion()?,
        };
        Ok(motion.as_ref().map(Into::into))
    }

    /// The filter, with its diagnostics.
    pub const fn filter(&self) -> &FusionFilter {
        &self.filter
    }
}
