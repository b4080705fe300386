//! Dubins curves: the shortest way from pose to pose of a vehicle that turns no tighter than a circle and never reverses.
//!
//! Such a way is one of six words of arcs and a line, `LSL RSR LSR RSL RLR LRL` (Dubins 1957). With the poses `d` radii
//! apart, `α` and `β` their headings against the line from one to the other, each word's three lengths are closed formulas
//! (Shkel and Lumelsky, *Classification of the Dubins set*, 2001, section 2).

use super::curve::{Curve, NOTHING, Turn, full_turn};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
};
use std::f64::consts::{PI, TAU};

/// Shortest curves of a vehicle that only drives forwards.
///
/// Allocates nothing. The length is not continuous: to end a hair behind the start takes a full circle. Poses within a billionth of the radius, and of a radian, of each other count as one.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_plan::hybrid::Dubins;
///
/// let car = Dubins::new(2.0)?;
/// let curve = car.shortest(&Se2::default(), &Se2::new(6.0, 2.0, std::f64::consts::FRAC_PI_2))?;
/// assert!((curve.length() - (4.0 + std::f64::consts::PI)).abs() < 1e-9); // a line, and a quarter of a circle
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "f64", into = "f64"))]
pub struct Dubins {
    radius: f64,
}

impl TryFrom<f64> for Dubins {
    type Error = Error;

    fn try_from(radius: f64) -> Result<Self, Error> {
        Self::new(radius)
    }
}

impl From<Dubins> for f64 {
    fn from(dubins: Dubins) -> Self {
        dubins.radius
    }
}

impl Dubins {
    /// Curves of this least turning radius, in metres.
    ///
    /// # Errors
    /// A radius that is not finite and positive.
    pub fn new(radius: f64) -> Result<Self, Error> {
        Ok(Self { radius: check::positive("radius", radius)? })
    }

    /// Least turning radius, in metres.
    pub const fn radius(&self) -> f64 {
        self.radius
    }

    /// The shortest curve between two poses.
    ///
    /// # Errors
    /// A pose that is not finite, or one more than 1e12 radii away.
    pub fn shortest(&self, from: &Se2, to: &Se2) -> Result<Curve, Error> {
        let word = Word::best(Relative::between(from, to, self.radius)?);
        let mut curve = Curve::nowhere(self.radius);
        for (turn, length) in word.turns.into_iter().zip(word.lengths) {
            curve.push(turn, length);
        }
        Ok(curve)
    }

    /// Length of the shortest curve, in metres.
    ///
    /// # Errors
    /// As [`shortest`](Self::shortest).
    pub fn length(&self, from: &Se2, to: &Se2) -> Result<f64, Error> {
        Ok(Word::best(Relative::between(from, to, self.radius)?).length() * self.radius)
    }
}

/// A goal seen from a start, in radii.
#[derive(Debug, Clone, Copy)]
pub(super) struct Relative {
    pub(super) x: f64,
    pub(super) y: f64,
    /// Heading, its cosine and its sine.
    pub(super) yaw: f64,
    pub(super) cos: f64,
    pub(super) sin: f64,
}

impl Relative {
    pub(super) fn between(from: &Se2, to: &Se2, radius: f64) -> Result<Self, Error> {
        for (name, pose) in [("from", from), ("to", to)] {
            check::all_finite(name, &[pose.x(), pose.y(), pose.rotation().cos(), pose.rotation().sin()])?;
        }
        let relative = Self::of(&from.between(to), radius);
        check::in_range("distance (radii)", relative.x.abs().max(relative.y.abs()), 0.0, 1e12)?;
        Ok(relative)
    }

    #[inline]
    pub(super) fn of(start_from_goal: &Se2, radius: f64) -> Self {
        let (x, y) = (start_from_goal.x() / radius, start_from_goal.y() / radius);
        let rotation = start_from_goal.rotation();
        Self { x, y, yaw: rotation.angle(), cos: rotation.cos(), sin: rotation.sin() }
    }

    #[inline]
    fn is_here(&self) -> bool {
        self.x.abs().max(self.y.abs()).max(self.yaw.abs()) < NOTHING
    }
}

/// Three turns and their lengths in radii.
#[derive(Debug, Clone, Copy)]
pub(super) struct Word {
    pub(super) turns: [Turn; 3],
    pub(super) lengths: [f64; 3],
}

impl Word {
    #[inline]
    pub(super) fn length(&self) -> f64 {
        let [t, p, q] = self.lengths;
        t.abs() + p + q.abs()
    }

    /// The shortest of the six.
    #[inline]
    pub(super) fn best(goal: Relative) -> Self {
        const WORDS: [[Turn; 3]; 6] = [
            [Turn::Left, Turn::Straight, Turn::Left],
            [Turn::Right, Turn::Straight, Turn::Right],
            [Turn::Left, Turn::Straight, Turn::Right],
            [Turn::Right, Turn::Straight, Turn::Left],
            [Turn::Right, Turn::Left, Turn::Right],
            [Turn::Left, Turn::Right, Turn::Left],
        ];
        let nothing = Self { turns: WORDS[0], lengths: [0.0; 3] };
        if goal.is_here() {
            return nothing;
        }
        let mut best = (f64::INFINITY, nothing);
        for turns in WORDS {
            if let Some(lengths) = solve(turns, &goal, best.0) {
                let word = Self { turns, lengths };
                if word.length() < best.0 {
                    best = (word.length(), word);
                }
            }
        }
        best.1
    }
}

/// Lengths of one word, if it reaches the goal and can be shorter than `limit`.
///
/// Solved for words that begin to the left; those that begin to the right are seen in a mirror. The circle of the first arc
/// has its centre at (0, 1), that of the last one at `w` from there:
///
/// ```text
/// LSL   w = (x - sin φ, y - 1 + cos φ)      p = |w|              t = arg w
/// LSR   w = (x + sin φ, y - 1 - cos φ)      p = √(w² - 4)        t = arg w + atan2(2, p)
/// LRL   w as LSL                            p = 2π - 2 asin(|w| / 4) or its complement, t = arg w + p / 2
/// ```
#[inline]
fn solve(turns: [Turn; 3], goal: &Relative, limit: f64) -> Option<[f64; 3]> {
    let mirror = turns[0].sign();
    let (y, sin, yaw) = (mirror * goal.y, mirror * goal.sin, mirror * goal.yaw);
    // +1 where the last arc bends as the first.
    let same = mirror * turns[2].sign();
    let (wx, wy) = (goal.x - same * sin, y - 1.0 + same * goal.cos);
    let squared = wx * wx + wy * wy;
    let (p, t) = match (turns[1], same > 0.0) {
        (Turn::Straight, true) => (squared.sqrt(), if squared < limit * limit { wy.atan2(wx) } else { return None }),
        (Turn::Straight, false) => {
            let p = (squared - 4.0).max(0.0).sqrt();
            if squared < 4.0 - NOTHING || p >= limit {
                return None;
            }
            (p, wy.atan2(wx) + 2.0_f64.atan2(p))
        }
        _ => {
            if squared > 16.0 {
                return None;
            }
            // The middle arc goes the long way round: it is more than half a circle, or the word is not shortest.
            let p = TAU - 2.0 * (0.25 * squared.sqrt()).asin();
            if p >= limit {
                return None;
            }
            (p, wy.atan2(wx) + 0.5 * p)
        }
    };
    let t = full_turn(t);
    let q = match (turns[1], same > 0.0) {
        (Turn::Straight, true) => yaw - t,
        (Turn::Straight, false) => t - yaw,
        _ => yaw - t + p,
    };
    debug_assert!(p <= TAU + PI || turns[1] == Turn::Straight);
    Some([t, p, full_turn(q)])
}
