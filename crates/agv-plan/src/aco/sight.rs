//! What an ant sees: the heuristic η of a step, before any pheromone lies on it.
//!
//! Weights are kept in single precision. η^β spans many decades, so that its logarithm is tabulated once per query, with the
//! middle of its range at zero, and raised by `exp(β ln η)` once per iteration; what the middle is drops out of every choice.

use crate::{Error, grid::GridSpace};
use agv_core::{check, grid::GridLayout};

/// How the distance to the goal in Eq. 5 is to be read; the radical is lost in print.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum GoalDistance {
    /// `3 sqrt(dx² + dy²)`: the default, whose paths are the shorter ones.
    #[default]
    ThreeTimes,
    /// `(dx² + dy²)^(1/3)`: distance counts less beside the direction, and paths have fewer turns and are longer.
    CubeRoot,
    /// `sqrt(dx² + dy²)`: the widespread one.
    Plain,
}

impl GoalDistance {
    fn of(self, dx: f64, dy: f64) -> f64 {
        let squared = dx * dx + dy * dy;
        match self {
            Self::ThreeTimes => 3.0 * squared.sqrt(),
            Self::CubeRoot => squared.cbrt(),
            Self::Plain => squared.sqrt(),
        }
    }
}

/// The heuristic η of a step from cell i to cell j.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Sight {
    /// `1 / d_ij`, the length of the step (with Eq. 1): an ant that does not know where the goal is.
    StepLength,
    /// `1 / (a d_jE + b C_ij)` (Eqs. 5 and 6), lengths in cells: the distance d of cell j from the goal, and C for the change
    /// of direction at cell i. With ψ the angle there, in degrees, between the ways to the cell before and to cell j,
    /// `C = 360/ψ`, and 0.1 straight on. (Distances and ratios of angles are added up: that is the paper's.) The first step
    /// counts as straight on. A sum below a tenth counts as a tenth.
    Goal {
        /// a, of the distance.
        distance: f64,
        /// b, of the direction.
        direction: f64,
        /// How d is to be read.
        reading: GoalDistance,
    },
}

/// Changes of direction that are told apart: none, 45°, 90° and 135°; an ant does not turn on its heel.
pub(super) const TURNS: usize = 4;

/// Least value of `a d + b C`.
const LEAST: f64 = 0.1;

impl Sight {
    /// Eq. 5 with the paper's weights 0.7 and 0.3.
    pub const fn goal(reading: GoalDistance) -> Self {
        Self::Goal { distance: 0.7, direction: 0.3, reading }
    }

    /// `1 / d_jE`, the widespread heuristic of colonies on grids: Eq. 5 of the distance alone.
    pub const fn to_goal() -> Self {
        Self::Goal { distance: 1.0, direction: 0.0, reading: GoalDistance::Plain }
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        if let Self::Goal { distance, direction, .. } = *self {
            check::in_range("distance weight", distance, 0.0, 1e3)?;
            check::in_range("direction weight", direction, 0.0, 1e3)?;
            check::positive("sum of distance and direction weight", distance + direction)?;
        }
        Ok(())
    }

    /// Eq. 6, for the changes of direction in the order of [`TURNS`].
    fn turn_costs() -> [f64; TURNS] {
        [0.1, 360.0 / 135.0, 360.0 / 90.0, 360.0 / 45.0]
    }
}

/// η^β of one query, for every cell that is stepped to and every change of direction.
#[derive(Debug, Clone, Default)]
pub(super) struct SightTable {
    /// ln η about the middle of its range, `[cell][turn]`, with a row and a cell more at both ends, so that every cell has eight
    /// around it; empty where η does not depend on them.
    logarithms: Vec<[f32; TURNS]>,
    powers: Vec<[f32; TURNS]>,
    beta: f64,
}

impl SightTable {
    /// Greatest exponent of a weight, either way: what is beyond it would leave single precision.
    const LIMIT: f32 = 55.0;

    pub(super) fn prepare(&mut self, sight: &Sight, space: &GridSpace, goal: u32) {
        self.logarithms.clear();
        self.beta = f64::NAN;
        let Sight::Goal { distance, direction, reading } = *sight else { return self.powers.clear() };
        let target = space.cell(goal);
        let costs = Sight::turn_costs().map(|c| direction * c);
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        let guard = space.layout().map_or(0, GridLayout::width) + 1;
        self.logarithms.resize(guard, [0.0; TURNS]);
        for node in 0..space.len() as u32 {
            if space.mask(node) == 0 {
                // Nobody comes here.
                self.logarithms.push([0.0; TURNS]);
                continue;
            }
            let cell = space.cell(node);
            let away = distance * reading.of(f64::from(target.x - cell.x), f64::from(target.y - cell.y));
            let row = costs.map(|c| -(away + c).max(LEAST).ln());
            (least, greatest) =
                (row.iter().copied().fold(least, f64::min), row.iter().copied().fold(greatest, f64::max));
            self.logarithms.push(row.map(|v| v as f32));
        }
        self.logarithms.resize(self.logarithms.len() + guard, [0.0; TURNS]);
        let middle = f64::midpoint(least, greatest) as f32;
        self.logarithms.as_flattened_mut().iter_mut().for_each(|v| *v -= middle);
    }

    /// Raises η to β.
    pub(super) fn raise(&mut self, beta: f64) {
        if self.beta == beta {
            return;
        }
        self.beta = beta;
        let exponent = beta as f32;
        self.powers.clear();
        let limited = |v: f32| (exponent * v).clamp(-Self::LIMIT, Self::LIMIT);
        self.powers.extend(self.logarithms.iter().map(|row| row.map(|v| exp(limited(v)))));
    }

    /// η^β, laid out as the logarithms are.
    pub(super) fn powers(&self) -> &[[f32; TURNS]] {
        &self.powers
    }
}

/// e to the power of `x`, for |x| up to 87, to three units in the last place: e^x = 2^n e^r with n whole and |r| ≤ ln 2 / 2, and the series of
/// e^r to the sixth power. Additions and products alone, so that eight at a time fit into wide registers, and bits do not
/// depend on the platform's library.
#[inline]
fn exp(x: f32) -> f32 {
    /// Added to a small number it leaves the nearest whole one in the last bits.
    const WHOLE: f32 = 12_582_912.0;
    /// ln 2 in two parts, of which multiples of the first are exact.
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let shifted = x * std::f32::consts::LOG2_E + WHOLE;
    let n = shifted - WHOLE;
    let r = (x - n * LN_2[0]) - n * LN_2[1];
    let series = 1.0 + r * (1.0 + r * (1.0 / 2.0 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r / 720.0)))));
    series * f32::from_bits((shifted.to_bits() << 23).wrapping_add(1.0_f32.to_bits()))
}

/// η^β of the eight steps where it is a matter of their length alone; one otherwise.
pub(super) fn step_factors(sight: &Sight, beta: f64) -> [f32; 8] {
    let diagonal = match sight {
        Sight::StepLength => (-0.5 * beta * std::f64::consts::LN_2).exp() as f32,
        Sight::Goal { .. } => 1.0,
    };
    [1.0, 1.0, 1.0, 1.0, diagonal, diagonal, diagonal, diagonal]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_e_are_near_the_exact_ones() {
        for k in -8700..=8700 {
            let x = k as f32 * 0.01;
            let exact = f64::from(x).exp();
            assert!((f64::from(exp(x)) / exact - 1.0).abs() < 3.0 * f64::from(f32::EPSILON), "{x}");
        }
        assert_eq!(exp(0.0), 1.0);
    }
}
