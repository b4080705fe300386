//! What the filter is told of the robots.

use agv_nav::filters::landmark::{CalibrationPriors, EstimateClock, LandmarkFilterParams, Prior, RangeKind};

/// A camera measures depth, and the odometry is what the drives were commanded; with what another robot of the make has `taught`,
/// or without. All else are the library's defaults.
pub(crate) fn of_the_make(taught: bool) -> LandmarkFilterParams {
    LandmarkFilterParams {
        priors: if taught { create_drive() } else { CalibrationPriors::default() },
        range_kind: RangeKind::Depth,
        clock: EstimateClock::Landmarks,
        ..LandmarkFilterParams::default()
    }
}

/// The drive of an iRobot Create, as robot 1 of MRCLAM 6 taught it from the library's defaults, rounded; the deviations are a guess
/// of how much drives of one make differ. Cameras are each their own.
fn create_drive() -> CalibrationPriors {
    CalibrationPriors {
        speed_scale: Prior::new(0.04, 0.03),
        turn_loss: Prior::new(0.09, 0.03),
        yaw_scale: Prior::new(-0.055, 0.05),
        yaw_bias: Prior::new(-0.004, 0.003),
        latency: Prior::new(0.24, 0.05),
        ..CalibrationPriors::default()
    }
}
