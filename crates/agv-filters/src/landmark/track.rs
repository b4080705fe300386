//! A belief that moves along the history of the odometry.

use super::{CalibratedOdometry, CalibratedPose, DEGREES, Parameter, history::History};
use crate::kalman::{Ekf, GaussianBelief};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2, UncertainPose},
    time::Stamp,
};
use nalgebra::{SMatrix, Vector3};

/// A belief at a time of the odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Cursor {
    pub(super) ekf: Ekf<CalibratedPose, DEGREES>,
    /// None before the first motion.
    pub(super) time: Option<Stamp>,
}

impl Cursor {
    /// Moves on to `target`, as far as the history goes; never back.
    pub(super) fn advance(
        &mut self,
        model: &CalibratedOdometry,
        history: &History,
        target: Stamp,
    ) -> Result<(), Error> {
        let (Some(from), Some(last)) = (self.time, history.end()) else { return Ok(()) };
        let to = target.min(last);
        if to <= from {
            return Ok(());
        }
        for (piece, dt) in history.between(from, to) {
            self.ekf.predict(model, &piece, dt)?;
        }
        self.time = Some(to);
        Ok(())
    }

    /// Seconds by which the motion is later than the odometry's stamps.
    pub(super) fn latency(&self) -> f64 {
        self.ekf.state().get(Parameter::Latency)
    }

    /// Velocities of the vehicle, in its frame, about a time of the odometry.
    pub(super) fn twist(&self, history: &History, time: Stamp) -> Vector3<f64> {
        CalibratedOdometry::motion(self.ekf.state(), &history.velocity(time), 1.0)
    }

    /// The pose at the time of the cursor.
    pub(super) fn pose(&self) -> Result<UncertainPose<Se2>, Error> {
        let covariance = self.ekf.covariance().fixed_view::<3, 3>(0, 0).into_owned();
        UncertainPose::new(self.ekf.state().map_from_base, covariance)
    }

    /// The pose when the landmark sensor's clock shows `stamp`.
    pub(super) fn pose_on_sensor_clock(&self, history: &History, stamp: Stamp) -> Result<UncertainPose<Se2>, Error> {
        let Some(time) = self.time else { return self.pose() };
        let twist = self.twist(history, time);
        let since = Se2::exp(&(twist * (stamp - time - self.latency())));
        let mut by_state = SMatrix::<f64, 3, DEGREES>::zeros();
        by_state.fixed_view_mut::<3, 3>(0, 0).copy_from(&since.inverse().adjoint());
        by_state.set_column(Parameter::Latency.row(), &-twist);
        let covariance = by_state * self.ekf.covariance() * by_state.transpose();
        UncertainPose::new(self.ekf.state().map_from_base * since, (covariance + covariance.transpose()) * 0.5)
    }

    /// The same belief with a pose that is `factor` times as uncertain in variance.
    pub(super) fn doubted(&self, factor: f64) -> Result<Self, Error> {
        let mut covariance = *self.ekf.covariance();
        let mut pose = covariance.fixed_view_mut::<3, 3>(0, 0);
        pose *= factor;
        Ok(Self { ekf: GaussianBelief::new(*self.ekf.state(), covariance)?.into(), ..*self })
    }

    /// The same belief with a latency of at most `most` seconds either way.
    pub(super) fn bounded(&self, most: f64) -> Result<Self, Error> {
        let mut state = *self.ekf.state();
        state.parameters[Parameter::Latency.index()] = self.latency().clamp(-most, most);
        Ok(Self { ekf: GaussianBelief::new(state, *self.ekf.covariance())?.into(), ..*self })
    }
}

/// What is known.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Track {
    /// Where the last sighting was taken in: late ones go on from here.
    pub(super) anchor: Cursor,
    /// Now.
    pub(super) tip: Cursor,
    /// End of the last motion, or the stamp of the first sighting if there was no motion yet.
    pub(super) stamp: Option<Stamp>,
    /// Sightings refused one after the other.
    pub(super) contradictions: usize,
}
