//! Whether a vehicle gets on: it does while it leaves places behind.

use agv_core::geometry::Se2;

/// The place that was left behind last, and the time since.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Progress {
    anchor: Option<Se2>,
    standing: f64,
}

impl Progress {
    /// Takes the pose after `dt` seconds, and says whether the vehicle has come `distance` metres farther.
    pub(super) fn update(&mut self, here: &Se2, dt: f64, distance: f64) -> bool {
        self.standing += dt;
        match &self.anchor {
            Some(anchor) if (here.translation() - anchor.translation()).norm() < distance => false,
            anchor => {
                let moved_on = anchor.is_some();
                *self = Self { anchor: Some(*here), standing: 0.0 };
                moved_on
            }
        }
    }

    /// Takes back `dt` seconds that were spent waiting.
    pub(super) fn pause(&mut self, dt: f64) {
        self.standing = (self.standing - dt).max(0.0);
    }

    /// Seconds since the last progress.
    pub(super) const fn standing(&self) -> f64 {
        self.standing
    }
}
