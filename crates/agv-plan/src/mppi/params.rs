//! Parameters of an [`Mppi`](super::Mppi).

use crate::{
    Error,
    local::{FieldParams, GuardParams, ReferenceParams, sampling},
};
use agv_core::{check, grid::Footprint};

/// Parameters of an [`Mppi`](super::Mppi).
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MppiParams {
    /// The vehicle's outline.
    pub footprint: Footprint,
    /// Sequences that are tried in a cycle.
    pub samples: usize,
    /// Speeds of the plain arcs among them.
    pub arc_speeds: usize,
    /// Turns of the plain arcs with each speed.
    pub arc_turns: usize,
    /// Duration of the sequences, in seconds; a step takes [`MAX_STEP`](Self::MAX_STEP) at the most.
    pub horizon: f64,
    /// Steps of a sequence.
    pub steps: usize,
    /// Steps from one knot of the noise to the next.
    pub knot: usize,
    /// Standard deviation of the noise of speeds, as a share of the greatest.
    pub speed_noise: f64,
    /// Standard deviation of the noise of turns, as a share of the greatest yaw rate, or curvature of a vehicle that steers.
    pub turn_noise: f64,
    /// `λ`: difference in cost, in metres of way with the critics of [`Mppi::new`](super::Mppi::new), that makes a sample count for
    /// a share of `1/e`.
    pub temperature: f64,
    /// How far ahead on the path the way leads that is followed, in metres.
    pub look_ahead: f64,
    /// Share of the deceleration that a stop at the goal is planned with.
    pub stopping_share: f64,
    /// Time of driving without any progress after which the planner gives up, in seconds.
    pub patience: f64,
    /// The path's tolerances.
    pub reference: ReferenceParams,
    /// The field that sequences are judged by.
    pub field: FieldParams,
    /// How closely obstacles may be passed.
    pub guard: GuardParams,
}

impl MppiParams {
    /// The defaults for a vehicle: 1000 samples, 153 of them arcs, 2 s ahead in 40 steps with a knot every 8, noise of a quarter of the
    /// speeds and two fifths of the turns, towards 4 m ahead on the path.
    pub fn for_footprint(footprint: &Footprint) -> Self {
        Self {
            footprint: footprint.clone(),
            samples: 1000,
            arc_speeds: 9,
            arc_turns: 17,
            horizon: 2.0,
            steps: 40,
            knot: 8,
            speed_noise: 0.25,
            turn_noise: 0.4,
            temperature: 0.03,
            look_ahead: 4.0,
            stopping_share: 0.8,
            patience: 15.0,
            reference: ReferenceParams::default(),
            field: FieldParams::default(),
            guard: GuardParams::default(),
        }
    }

    /// Longest step of a sequence, in seconds.
    pub const MAX_STEP: f64 = sampling::MAX_STEP;

    /// Most samples times steps.
    pub const MAX_STATES: usize = 1 << 22;

    /// Checks all fields.
    ///
    /// # Errors
    /// The first that is out of its range, by name.
    pub fn validate(&self) -> Result<(), Error> {
        check::at_least("samples", self.samples, 2)?;
        check::at_least("knot", self.knot, 1)?;
        sampling::check_horizon(self.horizon, self.steps)?;
        check::in_range("speed_noise", self.speed_noise, 0.0, 10.0)?;
        check::in_range("turn_noise", self.turn_noise, 0.0, 10.0)?;
        check::positive("temperature", self.temperature)?;
        sampling::check_lead(self.look_ahead, self.stopping_share, self.patience)?;
        let states = self.samples.saturating_mul(self.steps);
        check::in_range("samples * steps", states as f64, 1.0, Self::MAX_STATES as f64)?;
        let arcs = self.arc_speeds.saturating_mul(self.arc_turns);
        check::in_range("arc_speeds * arc_turns", arcs as f64, 0.0, self.samples as f64)?;
        Ok(())
    }
}
