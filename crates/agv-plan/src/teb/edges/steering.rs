//! Vehicles that steer: how tightly they turn, and how fast that changes.

use super::{
    BandEdge, Residuals, Term, Window,
    segment::{Segment, change, pair},
};

/// The vehicle turns no more than its tightest circle lets it: `√w (|Δθ| - κ |s|)` where that is positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurningRadius {
    /// Greatest curvature, in 1/m.
    pub max_curvature: f64,
    /// Weight, in 1/rad².
    pub weight: f64,
}

impl BandEdge<7> for TurningRadius {
    #[inline]
    fn residuals(&self, window: &Window<7>, out: &mut impl Residuals) {
        let segment = Segment::new(window);
        let (turn, along) = (segment.turn, segment.along);
        let (turn_sign, along_sign) = (turn.value.signum(), self.max_curvature * along.value.signum());
        let gradient: [f64; 7] = std::array::from_fn(|k| turn_sign * turn.gradient[k] - along_sign * along.gradient[k]);
        let value = turn.value.abs() - self.max_curvature * along.value.abs();
        Term { value, gradient }.at_most(0.0, self.weight.sqrt(), out);
    }
}

/// The curvature changes no faster than the wheels are turned; a segment's is `Δθ / s`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SteeringRate {
    /// Greatest change of the curvature, in 1/(m s); where the wheels are straight it is their rate over the wheelbase.
    pub curvature_rate: f64,
    /// Weight.
    pub weight: f64,
}

/// Length below which a segment has no curvature to speak of, in metres.
const SHORTEST: f64 = 0.01;

impl BandEdge<11> for SteeringRate {
    #[inline]
    fn residuals(&self, window: &Window<11>, out: &mut impl Residuals) {
        let (first, second) = pair(window);
        if first.along.value.abs() < SHORTEST || second.along.value.abs() < SHORTEST {
            return;
        }
        let rate = change(&curvature(&first), &curvature(&second), window.unknowns[3], window.unknowns[7]);
        rate.within(self.curvature_rate, self.weight.sqrt(), out);
    }
}

#[inline]
fn curvature(segment: &Segment) -> Term<7> {
    let per = 1.0 / segment.along.value;
    let value = segment.turn.value * per;
    let gradient = std::array::from_fn(|k| per * (segment.turn.gradient[k] - value * segment.along.gradient[k]));
    Term { value, gradient }
}
