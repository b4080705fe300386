//! All of the filter that changes as it runs.

use super::MclDiagnostics;
use crate::particle::{ParticleSet, excursion::Excursion, per_sensor::PerSensor};
use agv_core::{
    geometry::{LieGroup, Se2, UncertainPose},
    odometry::OdometryIncrement,
    roles::StatusMonitor,
    time::Stamp,
};

/// Particles, and what is known besides.
#[derive(Debug, Clone)]
pub(super) struct Belief {
    pub(super) particles: ParticleSet,
    /// Counts the random draws of the whole set, so that none uses a stream twice.
    pub(super) step: u64,
    /// Its count when the particles were last drawn around a belief that was given: tells one such belief from the next.
    pub(super) begun: u64,
    /// What the particles say; none before the first initialisation.
    pub(super) known: Option<Known>,
    /// Odometry that the particles have not followed yet.
    pub(super) pending: Option<OdometryIncrement>,
    /// All odometry since the initialisation.
    pub(super) odom_from_base: Se2,
    /// The way since the last observation of each sensor that was applied.
    pub(super) applied: PerSensor<Excursion>,
    pub(super) drawn: LastDrawn,
    pub(super) monitor: StatusMonitor,
    pub(super) diagnostics: MclDiagnostics,
}

/// The estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Known {
    /// Mean and covariance of the particles at the last update, before resampling.
    pub(super) moments: UncertainPose<Se2>,
    /// The same carried on by the odometry since.
    pub(super) pose: UncertainPose<Se2>,
    /// The time that it refers to.
    pub(super) stamp: Option<Stamp>,
}

/// When the set was last drawn anew.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct LastDrawn {
    /// Updates since then.
    pub(super) updates: u64,
    /// The way since then.
    pub(super) way: Excursion,
}

impl LastDrawn {
    /// Just now, with the vehicle here.
    pub(super) const fn now(odom_from_base: Se2) -> Self {
        Self { updates: 0, way: Excursion::from(odom_from_base) }
    }
}

impl Belief {
    /// None yet.
    pub(super) fn none(particles: ParticleSet, monitor: StatusMonitor) -> Self {
        let diagnostics = MclDiagnostics::fresh(particles.len());
        Self {
            particles,
            step: 0,
            begun: 0,
            known: None,
            pending: None,
            odom_from_base: Se2::identity(),
            applied: PerSensor::new(),
            drawn: LastDrawn::default(),
            monitor,
            diagnostics,
        }
    }

    /// The odometry says that the vehicle has moved on.
    pub(super) fn moved(&mut self, motion: &Se2) {
        self.odom_from_base = self.odom_from_base * *motion;
        for way in self.applied.values_mut().chain([&mut self.drawn.way]) {
            way.reached(&self.odom_from_base);
        }
    }

    /// The particles were drawn around a new belief, with these moments.
    pub(super) fn begin(&mut self, moments: UncertainPose<Se2>) {
        self.known = Some(Known { moments, pose: moments, stamp: None });
        self.begun = self.step;
        self.pending = None;
        self.odom_from_base = Se2::identity();
        self.applied.clear();
        self.drawn = LastDrawn::default();
        self.monitor.initialized(&moments);
        self.diagnostics = MclDiagnostics::fresh(self.particles.len());
    }
}
