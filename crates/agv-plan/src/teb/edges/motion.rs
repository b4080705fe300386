//! Time, length, speeds and rolling without slipping.

use super::{BandEdge, Direction, Residuals, Term, Window, segment::Segment};
use agv_core::kinematics::MotionLimits;

/// The time between two poses should be short: `√w Δt`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Duration {
    /// Weight, in 1/s².
    pub weight: f64,
}

impl BandEdge<7> for Duration {
    #[inline]
    fn residuals(&self, window: &Window<7>, out: &mut impl Residuals) {
        let root = self.weight.sqrt();
        out.add_difference(root * window.unknowns[3], root, 3, None);
    }
}

/// The way between two poses should be short: `√w (Δx, Δy)`, whose square tends to even spacing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// Weight, in 1/m².
    pub weight: f64,
}

impl BandEdge<7> for Length {
    #[inline]
    fn residuals(&self, window: &Window<7>, out: &mut impl Residuals) {
        let root = self.weight.sqrt();
        out.add_difference(root * (window.unknowns[4] - window.unknowns[0]), root, 4, Some(0));
        out.add_difference(root * (window.unknowns[5] - window.unknowns[1]), root, 5, Some(1));
    }
}

/// Speeds, turn rate and acceleration to the side keep their limits, and the vehicle does not drive against its gear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Speed {
    limits: MotionLimits,
    gear: f64,
    root: f64,
    gear_root: f64,
}

impl Speed {
    /// `gear` is 1 for forwards, -1 for backwards and 0 for either.
    pub fn new(limits: &MotionLimits, gear: f64, weight: f64, gear_weight: f64) -> Self {
        Self { limits: *limits, gear, root: weight.sqrt(), gear_root: gear_weight.sqrt() }
    }
}

impl BandEdge<7> for Speed {
    #[inline]
    fn residuals(&self, window: &Window<7>, out: &mut impl Residuals) {
        let segment = Segment::new(window);
        let twist = &self.limits.twist;
        let (v, w) = (segment.rate(&segment.along), segment.rate(&segment.turn));
        v.at_most(twist.forward_speed, self.root, out);
        v.negated().at_most(twist.reverse_speed, self.root, out);
        w.within(twist.yaw_rate, self.root, out);
        if self.limits.is_holonomic() {
            segment.rate(&segment.across).within(twist.lateral_speed, self.root, out);
        } else if self.gear != 0.0 {
            let against = Term { value: -self.gear * v.value, gradient: v.gradient.map(|g| -self.gear * g) };
            against.at_most(0.0, self.gear_root, out);
        }
        if let Some(limit) = self.limits.lateral_acceleration {
            let gradient: [f64; 7] = std::array::from_fn(|k| v.gradient[k] * w.value + v.value * w.gradient[k]);
            Term { value: v.value * w.value, gradient }.within(limit, self.root, out);
        }
    }
}

/// Wheels roll: two poses lie on one arc,
///
/// ```text
/// (cos θ₁ + cos θ₂) Δy - (sin θ₁ + sin θ₂) Δx = 0
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NonHolonomic {
    /// Weight, in 1/m².
    pub weight: f64,
}

impl BandEdge<7> for NonHolonomic {
    #[inline]
    fn residuals(&self, window: &Window<7>, out: &mut impl Residuals) {
        let root = self.weight.sqrt();
        let w = &window.unknowns;
        let (dx, dy) = (root * (w[4] - w[0]), root * (w[5] - w[1]));
        let [Direction { sin: s1, cos: c1 }, Direction { sin: s2, cos: c2 }] = window.headings;
        let (s, c) = (s1 + s2, c1 + c2);
        let by = |s: f64, c: f64| -s * dy - c * dx;
        out.add(c * dy - s * dx, &[root * s, -root * c, by(s1, c1), 0.0, -root * s, root * c, by(s2, c2)]);
    }
}
