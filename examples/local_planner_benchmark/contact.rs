//! Whether a vehicle touches anything on its way, by the exact distance of its outline.
//!
//! No point of a body moves faster than `|v| + |ω| r`, so a body whose clearance exceeds that speed times half an interval, and what
//! the obstacles can move in it, is free in all of it (conservative advancement); where it does not, the interval is halved.

use agv_nav::core::{geometry::Twist2, obstacle::MovingObstacle};
use agv_nav::prelude::Se2;
use agv_sim::{Body, MovingDiscs, PlanarWorld, Populated};

/// Motions shorter than this are not halved again, in metres.
const FINEST: f64 = 1e-4;

/// A motion at a constant twist.
pub(crate) struct Way<'a> {
    pub(crate) world: &'a dyn PlanarWorld,
    pub(crate) moving: &'a MovingDiscs,
    pub(crate) body: &'a Body,
    pub(crate) start: Se2,
    pub(crate) twist: Twist2,
    /// Time at the start, in seconds.
    pub(crate) time: f64,
}

impl Way<'_> {
    /// Whether there is a contact within `dt` seconds, and the least clearance that was looked up, at most a metre.
    pub(crate) fn touches(&self, dt: f64, states: &mut Vec<MovingObstacle>) -> (bool, f64) {
        let mut least = 1.0;
        let touches = self.touches_between(0.0, dt, states, &mut least);
        (touches, least)
    }

    fn touches_between(&self, from: f64, to: f64, states: &mut Vec<MovingObstacle>, least: &mut f64) -> bool {
        let middle = 0.5 * (from + to);
        self.moving.states_into(self.time + middle, states);
        let world = Populated { world: self.world, obstacles: states };
        let clearance = world.clearance(self.body, &(self.start * self.twist.integrate(middle)), 1.0);
        *least = least.min(clearance);
        if clearance <= 0.0 {
            return true;
        }
        let fastest = states.iter().map(|disc| disc.velocity.norm()).fold(0.0, f64::max);
        let speed = self.twist.speed() + self.twist.yaw_rate.abs() * self.body.reach() + fastest;
        let reach = speed * 0.5 * (to - from);
        if clearance > reach || reach < FINEST {
            return false;
        }
        self.touches_between(from, middle, states, least) || self.touches_between(middle, to, states, least)
    }
}
