//! Parameters of a [`Dwa`](super::Dwa).

use crate::{
    Error,
    local::{FieldParams, GuardParams, ReferenceParams, sampling},
};
use agv_core::{check, grid::Footprint};

/// How the time of the window follows speed and room: paper 000's dynamic adjustment of the window.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AdaptiveWindow {
    /// Least share of the window's time, close to obstacles or at rest.
    pub least: f64,
    /// Distance to obstacles, beyond the circle around the vehicle, from which on the window is whole, in metres.
    pub room: f64,
}

impl Default for AdaptiveWindow {
    /// A third, and a metre.
    fn default() -> Self {
        Self { least: 0.33, room: 1.0 }
    }
}

/// Parameters of a [`Dwa`](super::Dwa).
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DwaParams {
    /// The vehicle's outline.
    pub footprint: Footprint,
    /// Speeds that are tried.
    pub speeds: usize,
    /// Turn rates (steering angles) that are tried with each speed.
    pub turns: usize,
    /// Sideways speeds that are tried with each, of a vehicle that moves sideways.
    pub lateral_speeds: usize,
    /// Time in which velocities must be reached to be tried, in seconds; zero for one cycle, which is Fox's window. Trajectories speed up
    /// and slow down on the way.
    pub window: f64,
    /// Whether the window follows speed and room; none for one of a fixed time.
    pub adaptive: Option<AdaptiveWindow>,
    /// Duration of the trajectories, in seconds; a step takes [`MAX_STEP`](Self::MAX_STEP) at the most.
    pub horizon: f64,
    /// Steps of a trajectory.
    pub steps: usize,
    /// How far ahead on the path the way leads that is followed, in metres.
    pub look_ahead: f64,
    /// Share of the deceleration that a stop at the goal is planned with.
    pub stopping_share: f64,
    /// Time of driving without any progress after which the planner gives up, in seconds.
    pub patience: f64,
    /// The path's tolerances.
    pub reference: ReferenceParams,
    /// The field that trajectories are judged by.
    pub field: FieldParams,
    /// How closely obstacles may be passed.
    pub guard: GuardParams,
}

impl DwaParams {
    /// The defaults for a vehicle: 16 speeds times 25 turns within 0.6 s, 1.5 s ahead in 30 steps, towards 4 m ahead on the path.
    pub fn for_footprint(footprint: &Footprint) -> Self {
        Self {
            footprint: footprint.clone(),
            speeds: 16,
            turns: 25,
            lateral_speeds: 5,
            window: 0.6,
            adaptive: None,
            horizon: 1.5,
            steps: 30,
            look_ahead: 4.0,
            stopping_share: 0.8,
            patience: 15.0,
            reference: ReferenceParams::default(),
            field: FieldParams::default(),
            guard: GuardParams::default(),
        }
    }

    /// Longest step of a trajectory, in seconds.
    pub const MAX_STEP: f64 = sampling::MAX_STEP;

    /// Most trajectories of a cycle times steps.
    pub const MAX_STATES: usize = 1 << 20;

    /// Checks all fields.
    ///
    /// # Errors
    /// The first that is out of its range, by name.
    pub fn validate(&self) -> Result<(), Error> {
        check::at_least("speeds", self.speeds, 2)?;
        check::at_least("turns", self.turns, 2)?;
        check::at_least("lateral_speeds", self.lateral_speeds, 1)?;
        check::non_negative("window", self.window)?;
        sampling::check_horizon(self.horizon, self.steps)?;
        sampling::check_lead(self.look_ahead, self.stopping_share, self.patience)?;
        if let Some(adaptive) = &self.adaptive {
            check::in_range("least", adaptive.least, 0.0, 1.0)?;
            check::positive("room", adaptive.room)?;
        }
        let tried = |count: usize| count.saturating_add(2);
        let samples = tried(self.speeds).saturating_mul(tried(self.turns)).saturating_mul(tried(self.lateral_speeds));
        check::in_range("trajectories", samples.saturating_mul(self.steps) as f64, 1.0, Self::MAX_STATES as f64)?;
        Ok(())
    }
}
