//! Critics: what is good or bad about a trajectory, each by one view, put together with weights.
//!
//! | critic | of | what it dislikes |
//! |---|---|---|
//! | [`Progress`] | Brock and Khatib 1999, with the field of [`NavigationField`] | not to come nearer to the goal around obstacles; the default |
//! | [`Heading`], [`Clearance`], [`Velocity`] | Fox, Burgard and Thrun 1997 | to face away from the goal, to be near obstacles, to be slow |
//! | [`PathDistance`], [`PathAlign`], [`GoalDistance`], [`GoalAlign`] | Nav2's DWB | to leave the path, to face away from it, to stay far from its goal |
//! | [`PreferForward`], [`Oscillation`], [`Twirling`] | Nav2's DWB | to back up, to change the side, to turn for nothing |
//! | [`BoundedObstacle`], [`KeyNodeDistance`], [`KeyNodeHeading`] | paper 002, Eqs 24 and 25 | as the classic ones, but only near obstacles, and towards the next key node |
//!
//! Each scores a whole batch. Its costs may be brought to the range from 0 to 1 over the batch before they are weighed, as papers 000 and 002
//! do; costs in metres of way are better left as they are. A trajectory that touches something in its first step, or that one critic
//! rules out, costs infinity, and that is what the next ones are shown.

mod classic;
mod improved;
mod path;
mod preference;
mod progress;

use super::{Drive, NavigationField, Trajectories};
use agv_core::{geometry::Twist2, path::Course, roles::LocalPlanRequest};
pub use classic::{Clearance, Heading, Velocity};
pub use improved::{BoundedObstacle, KeyNodeDistance, KeyNodeHeading};
use nalgebra::Vector2;
pub use path::{GoalAlign, GoalDistance, PathAlign, PathDistance};
pub use preference::{Oscillation, PreferForward, Twirling};
pub use progress::Progress;
use std::fmt::Debug;

/// What critics know besides the trajectories.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// What the planner was asked.
    pub request: &'a LocalPlanRequest<'a>,
    /// Where on the path the vehicle is.
    pub drive: &'a Drive,
    /// The path by arc length.
    pub course: &'a Course,
    /// How far it is to the target, from anywhere near.
    pub field: &'a NavigationField,
    /// The next key node, or the goal, in the map.
    pub key_node: Vector2<f64>,
    /// Where the way is to lead within the planner's sight, in the map.
    pub target: Vector2<f64>,
    /// What was aimed at in the last cycle.
    pub last: Twist2,
}

/// The critics that measured best: [`Progress`] on the navigation field, a little faithfulness to the side that was chosen, and a
/// dislike of backing up.
pub fn standard() -> Vec<Critic> {
    vec![
        Critic::new(1.0, Progress::new(0.6, 0.1, 0.5, 0.3)),
        Critic::new(0.05, Oscillation),
        Critic::new(0.5, PreferForward),
    ]
}

/// A view by which trajectories are judged: the lower the cost, the better.
pub trait TrajectoryCost: Debug + Send + Sync {
    /// Its name, for those who log.
    fn name(&self) -> &'static str;

    /// Adds to the cost of each trajectory, in the order of the batch. Those that are infinite are ruled out already, and may be left as
    /// they are; infinity rules out.
    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]);
}

/// A critic, and what its word counts.
#[derive(Debug)]
pub struct Critic {
    cost: Box<dyn TrajectoryCost>,
    weight: f32,
    normalized: bool,
}

impl Critic {
    /// Costs times `weight`, as they are.
    pub fn new(weight: f64, cost: impl TrajectoryCost + 'static) -> Self {
        Self { cost: Box::new(cost), weight: weight as f32, normalized: false }
    }

    /// Costs brought to the range from 0 to 1 over the batch, times `weight`.
    pub fn normalized(weight: f64, cost: impl TrajectoryCost + 'static) -> Self {
        Self { normalized: true, ..Self::new(weight, cost) }
    }

    /// What its word counts.
    pub fn weight(&self) -> f64 {
        f64::from(self.weight)
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.cost.name()
    }
}

/// Sums up what all critics say; `scratch` is working memory.
pub(crate) fn score(
    critics: &mut [Critic],
    batch: &Trajectories,
    scene: &Scene<'_>,
    totals: &mut Vec<f32>,
    scratch: &mut Vec<f32>,
) {
    assess(critics, batch, scene, scratch, totals);
    let rows = scratch.chunks_exact(batch.len().max(1));
    for (critic, costs) in critics.iter().zip(rows) {
        let mut spread = Spread::NONE;
        spread.take(costs);
        critic.add_to(costs, spread, totals);
    }
}

/// What each critic says of each trajectory, a row for each critic; `out` is infinite for those that are ruled out.
pub(crate) fn assess(
    critics: &mut [Critic],
    batch: &Trajectories,
    scene: &Scene<'_>,
    rows: &mut Vec<f32>,
    out: &mut Vec<f32>,
) {
    out.clear();
    // What touches something at once has no way to be judged by.
    out.extend(batch.free().iter().map(|&free| if free == 0 { f32::INFINITY } else { 0.0 }));
    rows.clear();
    for critic in critics {
        let begin = rows.len();
        rows.extend_from_slice(out);
        let Some(costs) = rows.get_mut(begin..) else { continue };
        critic.cost.add_costs(batch, scene, costs);
        for (out, cost) in out.iter_mut().zip(costs) {
            *out = if cost.is_finite() { *out } else { f32::INFINITY };
        }
    }
}

/// Least and greatest finite cost that a critic gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spread {
    least: f32,
    greatest: f32,
}

impl Spread {
    pub(crate) const NONE: Self = Self { least: f32::INFINITY, greatest: f32::NEG_INFINITY };

    /// Takes in some costs.
    pub(crate) fn take(&mut self, costs: &[f32]) {
        for &cost in costs.iter().filter(|cost| cost.is_finite()) {
            (self.least, self.greatest) = (self.least.min(cost), self.greatest.max(cost));
        }
    }
}

impl Critic {
    /// Adds its costs, which have this spread, to the totals.
    pub(crate) fn add_to(&self, costs: &[f32], spread: Spread, totals: &mut [f32]) {
        let (mut offset, mut scale) = (0.0, self.weight);
        if self.normalized {
            let Spread { least, greatest } = spread;
            // All alike: nothing to say.
            scale = if greatest > least { self.weight / (greatest - least) } else { 0.0 };
            offset = if least.is_finite() { least } else { 0.0 };
        }
        for (total, &cost) in totals.iter_mut().zip(costs) {
            *total += if cost.is_finite() { scale * (cost - offset) } else { f32::INFINITY };
        }
    }
}

/// Index of the last step that a trajectory has free, none if not even the first.
fn last_free(batch: &Trajectories, i: usize) -> Option<usize> {
    (*batch.free().get(i)? as usize).checked_sub(1)
}
