//! What lies between two poses, with derivatives.

use super::{Direction, Term, Window};

/// The way from a pose to the next, in the frame of the heading half-way: along, to the side, and by how much it turns.
///
/// On an arc the chord has just that heading, so that a vehicle that rolls has nothing to the side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    pub(super) along: Term<7>,
    pub(super) across: Term<7>,
    pub(super) turn: Term<7>,
    interval: f64,
}

impl Segment {
    #[inline]
    pub(super) fn new(window: &Window<7>) -> Self {
        Self::at(&window.unknowns, window.middles[0])
    }

    #[inline]
    fn at(w: &[f64; 7], Direction { sin, cos }: Direction) -> Self {
        let (dx, dy, turn) = (w[4] - w[0], w[5] - w[1], w[6] - w[2]);
        let (along, across) = (dx * cos + dy * sin, dy * cos - dx * sin);
        Self {
            along: Term { value: along, gradient: [-cos, -sin, 0.5 * across, 0.0, cos, sin, 0.5 * across] },
            across: Term { value: across, gradient: [sin, -cos, -0.5 * along, 0.0, -sin, cos, -0.5 * along] },
            turn: Term { value: turn, gradient: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0] },
            interval: w[3],
        }
    }

    /// A way per time.
    #[inline]
    pub(super) fn rate(&self, way: &Term<7>) -> Term<7> {
        let per = 1.0 / self.interval;
        let value = way.value * per;
        let mut gradient = way.gradient.map(|g| g * per);
        gradient[3] = -value * per;
        Term { value, gradient }
    }
}

/// The two segments of a window of three poses.
#[inline]
pub(super) fn pair(window: &Window<11>) -> (Segment, Segment) {
    let at = |first: usize| std::array::from_fn(|i| window.unknowns[first + i]);
    (Segment::at(&at(0), window.middles[0]), Segment::at(&at(4), window.middles[1]))
}

/// How fast a value changes from a segment to the next, from the middle of the one to the middle of the other:
/// `2 (b - a) / (Δt₁ + Δt₂)`.
#[inline]
pub(super) fn change(a: &Term<7>, b: &Term<7>, first_interval: f64, second_interval: f64) -> Term<11> {
    let per = 2.0 / (first_interval + second_interval);
    let value = per * (b.value - a.value);
    let mut gradient = [0.0; 11];
    for k in 0..7 {
        gradient[k] -= per * a.gradient[k];
        gradient[k + 4] += per * b.gradient[k];
    }
    gradient[3] -= 0.5 * per * value;
    gradient[7] -= 0.5 * per * value;
    Term { value, gradient }
}
