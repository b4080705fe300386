//! Parameters of a navigation.

use crate::Error;
use agv_core::check;

/// Parameters of a [`Navigation`](super::Navigation).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NavigationParams {
    /// Time between two global plans, in seconds.
    pub plan_period: f64,
    /// Least time between two global plans where the path is blocked, in seconds.
    pub retry_period: f64,
    /// Share by which another path must be cheaper to be taken, from 0 to 1: two that are alike are not to take turns.
    pub hysteresis: f64,
    /// How much dearer than a free cell the dearest one is when paths are compared, without unit; as the global planner has it.
    pub cost_weight: f64,
    /// How far ahead on the path obstacles count as blocking it, in metres.
    pub look_ahead: f64,
    /// Length of path that the local planner is given, up to the next key node, in metres; infinite for all of it. Short of it
    /// each key node is a goal of its own, as in paper 000.
    pub reach: f64,
    /// Distance from the border of the map at which goals beyond it are made for, in metres.
    pub border: f64,
    /// Distance from the goal within which the vehicle has arrived, in metres.
    pub goal_tolerance: f64,
    /// Way that counts as progress, in metres.
    pub progress_distance: f64,
    /// Time without progress after which a recovery begins, in seconds.
    pub progress_time: f64,
    /// The same where the local planner says that the path is blocked, or there is none, in seconds.
    pub blocked_time: f64,
    /// How long to wait for an obstacle that moves, in seconds.
    pub patience: f64,
    /// For how long a course must be left that keeps clear of what moves, in seconds; zero to stand where something comes.
    pub foresight: f64,
    /// Recovery behaviours before giving up, and as many escapes from contacts beside. Both are counted anew once the vehicle gets
    /// on by itself farther than a metre, and than twice `progress_distance`, from where it got stuck.
    pub recoveries: u32,
    /// Whether the last resort is to forget the surroundings and see them anew ([`Recovery::LookAgain`](super::Recovery::LookAgain)):
    /// for scanners that see all around, and maps that keep for ever what was there once.
    pub look_again: bool,
}

impl Default for NavigationParams {
    /// Four plans a second, five where something stands in the way; another path must save a tenth, or be the only one; 0.3 m
    /// in 4 s are progress, where Nav2's checker asks for 0.5 m in 10 s; a round of eight recovery behaviours and half of another, none of them
    /// forgetting what lies behind.
    fn default() -> Self {
        Self {
            plan_period: 0.25,
            retry_period: 0.2,
            hysteresis: 0.1,
            cost_weight: 2.0,
            look_ahead: 4.0,
            reach: f64::INFINITY,
            border: 0.5,
            goal_tolerance: 0.25,
            progress_distance: 0.3,
            progress_time: 4.0,
            blocked_time: 1.0,
            patience: 5.0,
            foresight: 2.5,
            recoveries: 12,
            look_again: false,
        }
    }
}

impl NavigationParams {
    pub(super) fn validate(&self) -> Result<(), Error> {
        for (name, value) in [
            ("plan_period", self.plan_period),
            ("retry_period", self.retry_period),
            ("look_ahead", self.look_ahead),
            ("goal_tolerance", self.goal_tolerance),
            ("progress_distance", self.progress_distance),
            ("progress_time", self.progress_time),
            ("blocked_time", self.blocked_time),
        ] {
            check::positive(name, value)?;
        }
        check::in_range("hysteresis", self.hysteresis, 0.0, 1.0)?;
        check::in_range("cost_weight", self.cost_weight, 0.0, 50.0)?;
        check::non_negative("border", self.border)?;
        check::non_negative("patience", self.patience)?;
        check::in_range("foresight", self.foresight, 0.0, 30.0)?;
        if self.reach != f64::INFINITY {
            check::positive("reach", self.reach)?;
        }
        Ok(())
    }
}
