//! Accelerations.

use super::{
    BandEdge, Residuals, Term, Window,
    segment::{Segment, change, pair},
};
use agv_core::{
    geometry::Twist2,
    kinematics::{MotionLimits, TwistLimits},
};

/// Speeds change within the limits:
///
/// ```text
/// aᵢ = 2 (vᵢ₊₁ - vᵢ) / (Δtᵢ + Δtᵢ₊₁)
/// ```
///
/// The change of the turn rate counts for vehicles that do not steer only; of the others [`SteeringRate`](super::SteeringRate).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Acceleration {
    limits: MotionLimits,
    share: f64,
    root: f64,
}

impl Acceleration {
    /// Of the limits, `share` may be used.
    pub fn new(limits: &MotionLimits, share: f64, weight: f64) -> Self {
        Self { limits: *limits, share, root: weight.sqrt() }
    }
}

impl BandEdge<11> for Acceleration {
    #[inline]
    fn residuals(&self, window: &Window<11>, out: &mut impl Residuals) {
        let (first, second) = pair(window);
        let (dt1, dt2) = (window.unknowns[3], window.unknowns[7]);
        let mut linear = |a: &Term<7>, b: &Term<7>| {
            change(a, b, dt1, dt2).within(
                self.share * linear_limit(&self.limits.twist, a.value, b.value),
                self.root,
                out,
            );
        };
        linear(&first.rate(&first.along), &second.rate(&second.along));
        if self.limits.is_holonomic() {
            linear(&first.rate(&first.across), &second.rate(&second.across));
        }
        if self.limits.steering.is_none() {
            let turn = change(&first.rate(&first.turn), &second.rate(&second.turn), dt1, dt2);
            turn.within(self.share * self.limits.twist.yaw_acceleration, self.root, out);
        }
    }
}

/// Whether the speed grows decides which limit counts.
#[inline]
fn linear_limit(limits: &TwistLimits, before: f64, after: f64) -> f64 {
    if after.abs() > before.abs() { limits.acceleration } else { limits.deceleration }
}

/// The band's first velocity can be reached from the vehicle's, or its last one from the goal's. The mean velocity of an interval is
/// that in its middle:
///
/// ```text
/// a₀ = 2 (v₀ - v) / Δt₀
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndSpeed {
    /// Velocity at the end, in the vehicle's frame.
    pub twist: Twist2,
    /// What the accelerations may be.
    pub limits: TwistLimits,
    /// Whether the velocity to the side counts: that of a vehicle that rolls is zero in any case.
    pub sideways: bool,
    /// Whether it is the goal's end.
    pub at_end: bool,
    /// Weight.
    pub weight: f64,
}

impl BandEdge<7> for EndSpeed {
    #[inline]
    fn residuals(&self, window: &Window<7>, out: &mut impl Residuals) {
        let segment = Segment::new(window);
        let (per, root) = (2.0 / window.unknowns[3], self.weight.sqrt());
        let mut edge = |rate: &Term<7>, given: f64, limit: f64| {
            let value = per * (rate.value - given);
            let mut gradient = rate.gradient.map(|g| per * g);
            gradient[3] -= 0.5 * per * value;
            Term { value, gradient }.within(limit, root, out);
        };
        let linear = |inner: f64, given: f64| {
            let (before, after) = if self.at_end { (inner, given) } else { (given, inner) };
            linear_limit(&self.limits, before, after)
        };
        let v = segment.rate(&segment.along);
        edge(&v, self.twist.vx, linear(v.value, self.twist.vx));
        if self.sideways {
            let u = segment.rate(&segment.across);
            edge(&u, self.twist.vy, linear(u.value, self.twist.vy));
        }
        edge(&segment.rate(&segment.turn), self.twist.yaw_rate, self.limits.yaw_acceleration);
    }
}
