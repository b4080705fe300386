//! Curves made of circular arcs of one radius and straight lines, driven forwards or backwards.

use agv_core::{
    Error, check,
    geometry::{Se2, Twist2},
    path::Gear,
};
use std::f64::consts::TAU;

/// Which way a piece of a curve bends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Turn {
    /// Steered to the left.
    Left,
    /// Not steered.
    #[default]
    Straight,
    /// Steered to the right.
    Right,
}

impl Turn {
    /// 1 to the left, -1 to the right.
    #[inline]
    pub const fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Straight => 0.0,
            Self::Right => -1.0,
        }
    }

    /// The same piece seen in a mirror.
    #[inline]
    pub const fn mirrored(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Straight => Self::Straight,
            Self::Right => Self::Left,
        }
    }
}

/// An arc or a line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CurvePiece {
    /// Which way it bends.
    pub turn: Turn,
    /// How far it goes, in metres; negative backwards.
    pub length: f64,
}

/// What a curve costs beside its length.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CurveWeights {
    /// What a metre backwards costs in metres forwards; at least 1.
    pub reverse: f64,
    /// What a change between forwards and backwards costs, in metres.
    pub gear_change: f64,
}

impl Default for CurveWeights {
    /// The length, and nothing else.
    fn default() -> Self {
        Self { reverse: 1.0, gear_change: 0.0 }
    }
}

impl CurveWeights {
    /// Checks both weights.
    ///
    /// # Errors
    /// A `reverse` that is not finite or below 1, a `gear_change` that is not finite or negative.
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("reverse", self.reverse, 1.0, f64::MAX)?;
        check::non_negative("gear_change", self.gear_change)?;
        Ok(())
    }

    /// Cost of signed lengths driven one after another; the weights in the unit of the lengths.
    #[inline]
    pub(super) fn of_lengths(&self, lengths: &[f64]) -> f64 {
        let (mut cost, mut before) = (0.0, 0.0);
        for &length in lengths.iter().filter(|length| length.abs() > NOTHING) {
            cost += if length < 0.0 { -length * self.reverse } else { length };
            cost += if length * before < 0.0 { self.gear_change } else { 0.0 };
            before = length;
        }
        cost
    }
}

/// Length of a piece, in radii, that is rounding and not driven: it says nothing of gear or turn.
pub(super) const NOTHING: f64 = 1e-9;

/// A pose on a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurveSample {
    /// The pose, seen from the curve's start.
    pub start_from_base: Se2,
    /// How the piece that leads here is driven.
    pub gear: Gear,
}

/// A curve of up to five pieces: what [`Dubins`](super::Dubins) and [`ReedsShepp`](super::ReedsShepp) find. A value without
/// memory of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curve {
    radius: f64,
    pieces: [CurvePiece; 5],
    len: usize,
}

impl Curve {
    /// A curve that goes nowhere.
    pub(super) const fn nowhere(radius: f64) -> Self {
        Self { radius, pieces: [CurvePiece { turn: Turn::Straight, length: 0.0 }; 5], len: 0 }
    }

    /// Appends a piece; `length` counts radii. A curve has room for five.
    pub(super) fn push(&mut self, turn: Turn, length: f64) {
        if let Some(slot) = self.pieces.get_mut(self.len) {
            *slot = CurvePiece { turn, length: length * self.radius };
            self.len += 1;
        }
    }

    /// Radius of its arcs, in metres.
    pub const fn radius(&self) -> f64 {
        self.radius
    }

    /// Its pieces, from start to end. One that is shorter than a billionth of the radius is rounding.
    pub fn pieces(&self) -> &[CurvePiece] {
        self.pieces.get(..self.len).unwrap_or_default()
    }

    /// Pieces that are driven: no rounding.
    pub(super) fn driven(&self) -> impl Iterator<Item = CurvePiece> + '_ {
        self.pieces().iter().copied().filter(|piece| piece.length.abs() > NOTHING * self.radius)
    }

    /// Length, in metres.
    pub fn length(&self) -> f64 {
        self.pieces().iter().map(|piece| piece.length.abs()).sum()
    }

    /// Length that is driven backwards, in metres.
    pub fn reverse_length(&self) -> f64 {
        self.driven().map(|piece| (-piece.length).max(0.0)).sum()
    }

    /// Changes between forwards and backwards.
    pub fn gear_changes(&self) -> usize {
        self.driven().zip(self.driven().skip(1)).filter(|(a, b)| a.length * b.length < 0.0).count()
    }

    /// Cost under weights, in metres.
    pub fn cost(&self, weights: &CurveWeights) -> f64 {
        self.length()
            + (weights.reverse - 1.0) * self.reverse_length()
            + weights.gear_change * self.gear_changes() as f64
    }

    /// The motion along a piece at a speed of 1 m/s: constant, for as many seconds as the piece has metres.
    #[inline]
    pub fn twist(&self, piece: &CurvePiece) -> Twist2 {
        let direction = piece.length.signum();
        Twist2::new(direction, 0.0, direction * piece.turn.sign() / self.radius)
    }

    /// Its end, seen from its start.
    pub fn start_from_end(&self) -> Se2 {
        self.pieces().iter().fold(Se2::default(), |pose, piece| pose * self.along(piece, piece.length.abs()))
    }

    /// The pose after `distance` metres, seen from its start; the ends for distances beyond them.
    pub fn start_from_pose_at(&self, distance: f64) -> Se2 {
        let (mut pose, mut rest) = (Se2::default(), distance.max(0.0));
        for piece in self.pieces() {
            let length = piece.length.abs().min(rest);
            pose = pose * self.along(piece, length);
            rest -= length;
        }
        pose
    }

    #[inline]
    fn along(&self, piece: &CurvePiece, distance: f64) -> Se2 {
        self.twist(piece).integrate(distance)
    }

    /// Poses along the curve, at most `step` metres apart within each piece; the end of every piece is one, the start is not.
    /// Nothing of pieces that are rounding.
    ///
    /// ```
    /// use agv_core::geometry::Se2;
    /// use agv_plan::hybrid::ReedsShepp;
    ///
    /// let curve = ReedsShepp::new(2.0)?.shortest(&Se2::default(), &Se2::new(0.0, 4.0, std::f64::consts::PI))?;
    /// assert_eq!(curve.samples(0.5)?.count(), 13); // half a circle of 2 m radius: 6.28 m
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// A step that is not finite and positive, or so small that a piece has more than 2^24 samples.
    pub fn samples(&self, step: f64) -> Result<impl Iterator<Item = CurveSample> + '_, Error> {
        check::positive("step", step)?;
        let count = move |length: f64| (length.abs() / step - 1e-9).ceil().max(1.0);
        for piece in self.pieces() {
            check::in_range("samples of a piece", count(piece.length), 1.0, f64::from(1 << 24))?;
        }
        let starts = self.pieces().iter().scan(Se2::default(), |pose, piece| {
            let start = *pose;
            *pose = start * self.along(piece, piece.length.abs());
            Some((start, piece))
        });
        let driven = starts.filter(|(_, piece)| piece.length.abs() > NOTHING * self.radius);
        Ok(driven.flat_map(move |(start, piece)| {
            let (twist, steps) = (self.twist(piece), count(piece.length));
            let gear = if piece.length < 0.0 { Gear::Reverse } else { Gear::Forward };
            (1..=steps as u32).map(move |i| {
                let distance = piece.length.abs() * f64::from(i) / steps;
                CurveSample { start_from_base: start * twist.integrate(distance), gear }
            })
        }))
    }
}

/// The angle in [0, 2π), but a hair below zero where a hair below a full turn would be meant: a curve that needs no turn must
/// not make a full one for a rounding error.
#[inline]
pub(super) fn full_turn(angle: f64) -> f64 {
    let turn = angle.rem_euclid(TAU);
    if turn > TAU - NOTHING { turn - TAU } else { turn }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// A quarter to the left, a line back, a quarter to the right.
    fn curve() -> Curve {
        let mut curve = Curve::nowhere(2.0);
        curve.push(Turn::Left, FRAC_PI_2);
        curve.push(Turn::Straight, -1.5);
        curve.push(Turn::Right, 1e-12);
        curve.push(Turn::Right, -FRAC_PI_2);
        curve
    }

    #[test]
    fn figures_are_those_of_the_drawing() {
        let curve = curve();
        assert!((curve.length() - (TAU + 3.0)).abs() < 1e-9);
        assert!((curve.reverse_length() - (PI + 3.0)).abs() < 1e-9);
        assert_eq!(curve.gear_changes(), 1, "rounding is no change of gear");
        let weights = CurveWeights { reverse: 2.0, gear_change: 0.5 };
        assert!((curve.cost(&weights) - (PI + 2.0 * (PI + 3.0) + 0.5)).abs() < 1e-9);
        // At (2, 2) it faces up; back to (2, -1); back to the right: the centre is (4, -1), the heading turns left to π.
        let end = curve.start_from_end();
        assert!((end.x() - 4.0).abs() < 1e-9 && (end.y() + 3.0).abs() < 1e-9 && (end.yaw().abs() - PI).abs() < 1e-9);
    }

    #[test]
    fn samples_are_on_the_curve_and_end_at_its_end() {
        let curve = curve();
        let mut last = Se2::default();
        let mut driven = 0.0;
        for sample in curve.samples(0.1).unwrap() {
            let chord = (sample.start_from_base.translation() - last.translation()).norm();
            assert!(chord <= 0.1 + 1e-12);
            driven += chord;
            last = sample.start_from_base;
            let there = curve.start_from_pose_at(driven);
            assert!((there.translation() - last.translation()).norm() < 2e-3);
        }
        assert!((last.translation() - curve.start_from_end().translation()).norm() < 1e-12);
        assert!(Curve::nowhere(1.0).samples(0.1).unwrap().next().is_none());
    }

    #[test]
    fn bad_steps_and_weights_are_refused() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9] {
            assert!(curve().samples(bad).is_err(), "{bad}");
        }
        for (reverse, gear_change) in [(0.9, 0.0), (f64::NAN, 0.0), (f64::INFINITY, 0.0), (1.0, -0.1), (1.0, f64::NAN)]
        {
            assert!(CurveWeights { reverse, gear_change }.validate().is_err(), "{reverse} {gear_change}");
        }
    }
}
