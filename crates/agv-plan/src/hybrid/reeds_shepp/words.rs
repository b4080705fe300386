//! The words of Reeds and Shepp: which sequences of arcs and lines lead to a goal, and how long their pieces are.
//!
//! Forty-eight words in eight families (Reeds and Shepp, *Optimal paths for a car that goes both forwards and backwards*,
//! 1990, section 8). Each family is solved for one word that begins forwards and to the left; the others follow by driving
//! the other way (`x -> -x, φ -> -φ`), by a mirror (`y -> -y, φ -> -φ`), and by swapping start and goal. All depend on
//! where the centre of the last circle is from the first one's, `ρ e^{iθ}`, for a last circle on the same side and on the
//! other,
//!
//! ```text
//! same   z - i + i e^{iφ}         cross   z - i - i e^{iφ}         z = x + i y
//! ```
//!
//! and the two of a mirrored goal. Driving the other way turns `θ` into `π - θ`, swapping the ends turns `θ` of `same` into
//! `φ - θ` and that of `cross` into `φ + θ'` with `θ'` of the mirrored one: four pairs `(ρ, θ)` serve all words.

use super::super::{
    curve::{Curve, NOTHING, Turn},
    dubins::Relative,
};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// One word that leads to the goal: its pieces in radii, signed, and its turns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Word {
    turns: [Turn; 5],
    lengths: [f64; 5],
    len: usize,
    mirrored: bool,
    swapped: bool,
}

impl Word {
    /// Signed lengths, from start to goal or from goal to start.
    #[inline]
    pub(super) fn lengths(&self) -> &[f64] {
        self.lengths.get(..self.len).unwrap_or_default()
    }

    pub(super) fn curve(&self, radius: f64) -> Curve {
        let mut curve = Curve::nowhere(radius);
        for i in 0..self.len {
            let at = if self.swapped { self.len - 1 - i } else { i };
            let turn = self.turns[at];
            curve.push(if self.mirrored { turn.mirrored() } else { turn }, self.lengths[at]);
        }
        curve
    }
}

/// Centre of the last circle from the first one's.
#[derive(Debug, Clone, Copy)]
struct Centre {
    squared: f64,
    rho: f64,
    theta: f64,
}

impl Centre {
    #[inline]
    fn new(x: f64, y: f64) -> Self {
        let squared = x * x + y * y;
        Self { squared, rho: squared.sqrt(), theta: y.atan2(x) }
    }

    #[inline]
    fn with_theta(self, theta: f64) -> Self {
        Self { theta, ..self }
    }
}

/// What of a family depends on the distance of the centres only, shared by its words.
#[derive(Debug, Clone, Copy)]
struct Shapes {
    /// `LSR` and `LRSLR`: length of the line between circles of opposite sides, and the angle at which it leaves.
    cross_line: Option<(f64, f64)>,
    /// `LRSL`: the same for a line after an arc of a quarter.
    same_line: Option<(f64, f64)>,
    /// `LRL`: length of the middle arc.
    middle: Option<f64>,
    /// `LRLR` with the two middle arcs of opposite directions: their length, and an angle.
    opposite: Option<(f64, f64)>,
    /// `LRLR` with the two middle arcs of one direction: their length, and an angle.
    equal: Option<(f64, f64)>,
}

impl Shapes {
    #[inline]
    fn new(same: &Centre, cross: &Centre) -> Self {
        let line = |squared: f64| (squared - 4.0).max(0.0).sqrt();
        let cross_line = (cross.squared >= 4.0 - NOTHING).then(|| {
            let a = line(cross.squared);
            (a, 2.0_f64.atan2(a))
        });
        let same_line = (same.squared >= 8.0 - NOTHING).then(|| {
            let r = line(same.squared);
            (r, r.atan2(-2.0))
        });
        let middle = (same.squared <= 16.0 + NOTHING).then(|| -2.0 * (0.25 * same.rho).min(1.0).asin());
        let opposite = (cross.rho <= 2.0 + NOTHING).then(|| {
            let cos = (0.5 + 0.25 * cross.rho).min(1.0);
            let (sin, cos_double) = (((1.0 - cos) * (1.0 + cos)).sqrt(), 2.0 * cos * cos - 1.0);
            (cos.acos(), (cos - cos_double - 1.0).atan2(sin - 2.0 * sin * cos))
        });
        let equal = (cross.squared >= 4.0 - NOTHING && cross.squared <= 20.0 + NOTHING).then(|| {
            let cos = ((20.0 - cross.squared) / 16.0).clamp(0.0, 1.0);
            let sin = -((1.0 - cos) * (1.0 + cos)).sqrt();
            (-cos.acos(), (cos - 2.0).atan2(sin))
        });
        Self { cross_line, same_line, middle, opposite, equal }
    }
}

/// A goal as one of the four symmetric words sees it.
#[derive(Debug, Clone, Copy)]
struct View {
    yaw: f64,
    same: Centre,
    cross: Centre,
    /// `cross` of the mirrored goal, for the words whose ends are swapped.
    other_cross: Centre,
    mirrored: bool,
    /// 1 forwards, -1 the other way.
    direction: f64,
}

const L: Turn = Turn::Left;
const R: Turn = Turn::Right;
const S: Turn = Turn::Straight;

/// Calls `take` for words that lead to the goal; it returns the length that words still have to beat, and those that cannot
/// are left out. Among them is the shortest curve of all.
#[inline]
pub(super) fn for_each(goal: &Relative, mut limit: f64, mut take: impl FnMut(&Word) -> f64) {
    let side = |mirror: f64| {
        let (y, sin) = (mirror * goal.y, mirror * goal.sin);
        (Centre::new(goal.x - sin, y - 1.0 + goal.cos), Centre::new(goal.x + sin, y - 1.0 - goal.cos))
    };
    let (left, right) = (side(1.0), side(-1.0));
    let shapes = [Shapes::new(&left.0, &left.1), Shapes::new(&right.0, &right.1)];
    let views = [(false, 1.0), (false, -1.0), (true, 1.0), (true, -1.0)].map(|(mirrored, direction)| {
        let (own, other) = if mirrored { (right, left) } else { (left, right) };
        let turned = |centre: Centre| if direction > 0.0 { centre } else { centre.with_theta(PI - centre.theta) };
        View {
            yaw: if mirrored { -direction * goal.yaw } else { direction * goal.yaw },
            same: turned(own.0),
            cross: turned(own.1),
            other_cross: turned(other.1),
            mirrored,
            direction,
        }
    });
    let shape = |view: &View| if view.mirrored { &shapes[1] } else { &shapes[0] };
    let other_shape = |view: &View| if view.mirrored { &shapes[0] } else { &shapes[1] };
    let mut offer = |view: &View, turns: [Turn; 5], len: usize, lengths: [f64; 5], swapped: bool| {
        let lengths = lengths.map(|length| view.direction * length);
        take(&Word { turns, lengths, len, mirrored: view.mirrored, swapped })
    };
    for view in &views {
        if let Some([t, u, v]) = line_same(view, limit) {
            limit = offer(view, [L, S, L, S, S], 3, [t, u, v, 0.0, 0.0], false);
        }
        if let Some([t, u, v]) = line_cross(view, shape(view), limit) {
            limit = offer(view, [L, S, R, S, S], 3, [t, u, v, 0.0, 0.0], false);
        }
    }
    for view in &views {
        for swapped in [false, true] {
            if let Some([t, u, v]) = three_arcs(view, shape(view), limit, swapped) {
                limit = offer(view, [L, R, L, S, S], 3, [t, u, v, 0.0, 0.0], swapped);
            }
        }
        if let Some([t, u, v]) = opposite_arcs(view, shape(view), limit) {
            limit = offer(view, [L, R, L, R, S], 4, [t, u, -u, v, 0.0], false);
        }
        if let Some([t, u, v]) = equal_arcs(view, shape(view), limit) {
            limit = offer(view, [L, R, L, R, S], 4, [t, u, u, v, 0.0], false);
        }
    }
    for view in &views {
        for swapped in [false, true] {
            if let Some([t, u, v]) = quarter_same(view, shape(view), limit, swapped) {
                limit = offer(view, [L, R, S, L, S], 4, [t, -FRAC_PI_2, u, v, 0.0], swapped);
            }
            let cross = if swapped { other_shape(view) } else { shape(view) };
            if cross.cross_line.is_some()
                && let Some([t, u, v]) = quarter_cross(view, limit, swapped)
            {
                limit = offer(view, [L, R, S, R, S], 4, [t, -FRAC_PI_2, u, v, 0.0], swapped);
            }
        }
        if let Some([t, u, v]) = two_quarters(view, shape(view), limit) {
            limit = offer(view, [L, R, S, L, R], 5, [t, -FRAC_PI_2, u, -FRAC_PI_2, v], false);
        }
    }
}

/// The angle in (-π, π], or a hair above π rather than a hair above -π.
#[inline]
fn wrapped(angle: f64) -> f64 {
    // The sums here leave the circle by two turns at the most.
    let mut angle = angle;
    while angle <= NOTHING - PI {
        angle += TAU;
    }
    while angle > PI + NOTHING {
        angle -= TAU;
    }
    angle
}

/// An angle driven forwards, up to half a circle; none if it would have to be driven backwards.
#[inline]
fn ahead(angle: f64) -> Option<f64> {
    Some(wrapped(angle)).filter(|&angle| angle >= -NOTHING)
}

/// An angle driven backwards.
#[inline]
fn back(angle: f64) -> Option<f64> {
    ahead(-angle).map(|angle| -angle)
}

/// `L⁺S⁺L⁺` (8.1)
#[inline]
fn line_same(view: &View, limit: f64) -> Option<[f64; 3]> {
    let u = (view.same.rho < limit).then_some(view.same.rho)?;
    let t = ahead(view.same.theta)?;
    Some([t, u, ahead(view.yaw - t)?])
}

/// `L⁺S⁺R⁺` (8.2)
#[inline]
fn line_cross(view: &View, shapes: &Shapes, limit: f64) -> Option<[f64; 3]> {
    let (u, angle) = shapes.cross_line.filter(|&(u, _)| u < limit)?;
    let t = ahead(view.cross.theta + angle)?;
    Some([t, u, ahead(t - view.yaw)?])
}

/// `L⁺R⁻L⁺` and `L⁺R⁻L⁻` (8.3, 8.4)
#[inline]
fn three_arcs(view: &View, shapes: &Shapes, limit: f64, swapped: bool) -> Option<[f64; 3]> {
    let u = shapes.middle.filter(|u| -u < limit)?;
    let theta = if swapped { view.yaw - view.same.theta } else { view.same.theta };
    let t = ahead(theta + 0.5 * u + PI)?;
    Some([t, u, wrapped(view.yaw - t + u)])
}

/// `L⁺R⁺L⁻R⁻` with middle arcs of equal length (8.7)
#[inline]
fn opposite_arcs(view: &View, shapes: &Shapes, limit: f64) -> Option<[f64; 3]> {
    let (u, angle) = shapes.opposite.filter(|(u, _)| 2.0 * u < limit)?;
    let t = ahead(view.cross.theta - angle)?;
    Some([t, u, back(t - 2.0 * u - view.yaw)?])
}

/// `L⁺R⁻L⁻R⁺` with middle arcs of equal length (8.8)
#[inline]
fn equal_arcs(view: &View, shapes: &Shapes, limit: f64) -> Option<[f64; 3]> {
    let (u, angle) = shapes.equal.filter(|(u, _)| -2.0 * u < limit)?;
    let t = ahead(view.cross.theta - angle)?;
    Some([t, u, ahead(t - view.yaw)?])
}

/// `L⁺R⁻S⁻L⁻` with a quarter in the middle (8.9)
#[inline]
fn quarter_same(view: &View, shapes: &Shapes, limit: f64, swapped: bool) -> Option<[f64; 3]> {
    let (r, angle) = shapes.same_line.filter(|(r, _)| FRAC_PI_2 + r - 2.0 < limit)?;
    let theta = if swapped { view.yaw - view.same.theta } else { view.same.theta };
    let t = ahead(theta + angle)?;
    Some([t, 2.0 - r, back(view.yaw - FRAC_PI_2 - t)?])
}

/// `L⁺R⁻S⁻R⁻` with a quarter in the middle (8.10)
#[inline]
fn quarter_cross(view: &View, limit: f64, swapped: bool) -> Option<[f64; 3]> {
    let (rho, theta) = if swapped {
        (view.other_cross.rho, view.yaw + view.other_cross.theta)
    } else {
        (view.cross.rho, view.cross.theta)
    };
    if FRAC_PI_2 + rho - 2.0 >= limit {
        return None;
    }
    let t = ahead(theta + FRAC_PI_2)?;
    Some([t, 2.0 - rho, back(t + FRAC_PI_2 - view.yaw)?])
}

/// `L⁺R⁻S⁻L⁻R⁺` with two quarters (8.11)
#[inline]
fn two_quarters(view: &View, shapes: &Shapes, limit: f64) -> Option<[f64; 3]> {
    let (a, angle) = shapes.cross_line.filter(|&(a, _)| a >= 4.0 - NOTHING && PI + a - 4.0 < limit)?;
    let t = ahead(view.cross.theta + FRAC_PI_2 + angle)?;
    Some([t, 4.0 - a, ahead(t - view.yaw)?])
}
