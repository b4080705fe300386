//! The roles that a [`LandmarkFilter`] plays.

use super::{CalibratedPose, Cursor, DEGREES, LARGEST, LandmarkFilter, Track};
use crate::landmark::MotionPiece;
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    odometry::OdometryIncrement,
    roles::{Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, PoseEstimate, UpdateOutcome},
    sensors::LandmarkObservation,
};
use nalgebra::{SMatrix, SVector};

impl Localizer for LandmarkFilter {
    type Pose = Se2;

    /// Takes a pose with its covariance, and forgets what was learnt.
    ///
    /// # Errors
    /// [`Error::Empty`] for [`PoseBelief::Anywhere`], which no Gaussian is; a variance above (1000 km)².
    fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        let PoseBelief::Around(pose) = belief else { return Err(Error::Empty { name: "pose of the belief" }.into()) };
        check::in_range("covariance", pose.covariance().amax(), 0.0, LARGEST * LARGEST)?;
        let mut covariance = SMatrix::<f64, DEGREES, DEGREES>::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(pose.covariance());
        let priors = self.params.priors.all(&self.params.noise);
        for (index, prior) in priors.iter().enumerate() {
            covariance[(index + 3, index + 3)] = prior.sigma * prior.sigma;
        }
        let parameters = SVector::from(priors.map(|prior| prior.mean));
        let state = CalibratedPose { map_from_base: *pose.mean(), parameters };
        let start = Cursor { ekf: crate::kalman::Ekf::new(state, covariance)?, time: None };
        self.track = Some(Track { anchor: start, tip: start, stamp: None, contradictions: 0 });
        self.history.clear();
        self.monitor.initialized(pose);
        Ok(())
    }

    /// A motion without a duration, and one that begins before the last one's end, is taken as it is.
    fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
        let track = self.track.ok_or(LocalizationError::NotInitialized)?;
        let motion = odometry.start_from_end;
        check::all_finite("odometry", &[motion.x(), motion.y(), motion.yaw()])?;
        check::in_range("odometry run", motion.translation().norm(), 0.0, LARGEST)?;
        check::covariance("odometry covariance", &odometry.covariance)?;
        check::in_range("odometry covariance", odometry.covariance.amax(), 0.0, LARGEST * LARGEST)?;
        let piece = MotionPiece { read: motion.log(), covariance: odometry.covariance };
        self.track = Some(self.moved(track, odometry.start, odometry.end, piece)?);
        Ok(())
    }

    fn estimate(&self) -> Option<PoseEstimate<Se2>> {
        let track = self.track.as_ref()?;
        let pose = self.pose(track).ok()?;
        Some(PoseEstimate { pose, stamp: track.stamp })
    }

    fn status(&self) -> LocalizationStatus {
        self.monitor.status()
    }
}

/// A sighting is taken in where the vehicle was at its stamp, by the latency learnt so far.
impl Correct<LandmarkObservation> for LandmarkFilter {
    /// A sighting of a landmark that is not on the map is [`Unexplained`](agv_core::roles::SkipReason::Unexplained), as is one that
    /// does not know its landmark and fits none or several.
    ///
    /// # Errors
    /// [`LocalizationError::NotInitialized`]; a sighting without noise of a belief without doubt.
    fn update(&mut self, observation: &LandmarkObservation) -> Result<UpdateOutcome, LocalizationError> {
        let mut track = self.track.ok_or(LocalizationError::NotInitialized)?;
        let outcome = self.take_in(observation, &mut track)?;
        let pose = self.pose(&track)?;
        self.track = Some(track);
        self.monitor.updated(&pose, &outcome);
        Ok(outcome)
    }
}
