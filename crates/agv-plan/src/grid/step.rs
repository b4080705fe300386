//! The eight steps of a grid and what they cost in integers.
//!
//! A straight step costs [`STRAIGHT`] = 985 and a diagonal one [`DIAGONAL`] = 1393, a convergent of the continued
//! fraction of √2: 1393/985 = √2 - 3.6e-7. Integer keys allow a bucket queue, and the paths are still the true octile
//! optima. Let the integer-optimal path P have `b` diagonals more than a true optimum Q and `a` straight steps more.
//! P being no worse in integers and worse in truth means
//!
//! ```text
//! 985 a + 1393 b <= 0 < a + √2 b      so      1393/985 <= -a/b < √2,  b > 0
//! ```
//!
//! and no fraction with a denominator below 985 lies in that interval (a convergent is the best approximation from its
//! side). So P is *exactly* optimal unless two paths differ by 985 diagonals or more, and even then its excess is below
//! 3.6e-7 cells per diagonal. Lengths are reported from the exact counts of straight and diagonal steps, not from the
//! integers.

use agv_core::grid::Cell;

/// Cost of a step to an edge neighbour, in the integers of the search.
pub const STRAIGHT: u32 = 985;
/// Cost of a step to a corner neighbour, in the integers of the search.
pub const DIAGONAL: u32 = 1393;

/// A step to one of the eight neighbours, counter-clockwise from +x: the four straight ones first, then the diagonals.
///
/// The order is that of the bits in a neighbour mask.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Step(u8);

impl Default for Step {
    /// No step.
    fn default() -> Self {
        Self::NONE
    }
}

impl Step {
    /// +x.
    pub const EAST: Self = Self(0);
    /// +y.
    pub const NORTH: Self = Self(1);
    /// -x.
    pub const WEST: Self = Self(2);
    /// -y.
    pub const SOUTH: Self = Self(3);
    /// +x, +y.
    pub const NORTH_EAST: Self = Self(4);
    /// -x, +y.
    pub const NORTH_WEST: Self = Self(5);
    /// -x, -y.
    pub const SOUTH_WEST: Self = Self(6);
    /// +x, -y.
    pub const SOUTH_EAST: Self = Self(7);
    /// No step: where a search began.
    pub const NONE: Self = Self(8);

    /// The eight steps in the order of the mask's bits.
    pub const ALL: [Self; 8] = [
        Self::EAST,
        Self::NORTH,
        Self::WEST,
        Self::SOUTH,
        Self::NORTH_EAST,
        Self::NORTH_WEST,
        Self::SOUTH_WEST,
        Self::SOUTH_EAST,
    ];

    /// The step of a mask's bit; bits from 8 on are [`NONE`](Self::NONE).
    #[inline]
    pub const fn from_bit(bit: u32) -> Self {
        if bit < 8 { Self(bit as u8) } else { Self::NONE }
    }

    /// Its number: the bit in a mask, or 8 for none.
    #[inline]
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Its bit in a mask; zero for none.
    #[inline]
    pub const fn bit(self) -> u8 {
        if self.0 < 8 { 1 << self.0 } else { 0 }
    }

    /// Columns it moves.
    #[inline]
    pub const fn dx(self) -> i32 {
        [1, 0, -1, 0, 1, -1, -1, 1, 0][self.index()]
    }

    /// Rows it moves.
    #[inline]
    pub const fn dy(self) -> i32 {
        [0, 1, 0, -1, 1, 1, -1, -1, 0][self.index()]
    }

    /// Whether it moves along both axes.
    #[inline]
    pub const fn is_diagonal(self) -> bool {
        self.0 >= 4 && self.0 < 8
    }

    /// The step by `(dx, dy)`, each -1, 0 or 1 by their signs.
    pub const fn towards(dx: i32, dy: i32) -> Self {
        match (dx.signum(), dy.signum()) {
            (1, 0) => Self::EAST,
            (0, 1) => Self::NORTH,
            (-1, 0) => Self::WEST,
            (0, -1) => Self::SOUTH,
            (1, 1) => Self::NORTH_EAST,
            (-1, 1) => Self::NORTH_WEST,
            (-1, -1) => Self::SOUTH_WEST,
            (1, -1) => Self::SOUTH_EAST,
            _ => Self::NONE,
        }
    }

    /// The step back.
    pub const fn reversed(self) -> Self {
        Self::towards(-self.dx(), -self.dy())
    }

    /// Where the step leads.
    #[inline]
    pub const fn from(self, cell: Cell) -> Cell {
        Cell::new(cell.x + self.dx(), cell.y + self.dy())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_and_offsets_agree() {
        for (bit, step) in Step::ALL.into_iter().enumerate() {
            assert_eq!(Step::from_bit(bit as u32), step);
            assert_eq!(Step::towards(step.dx(), step.dy()), step);
            assert_eq!(step.reversed().from(step.from(Cell::new(5, 5))), Cell::new(5, 5));
            assert_eq!(step.is_diagonal(), step.dx() * step.dy() != 0);
        }
    }

    /// The claim that the module's argument rests on: no fraction p/q with q < 985 lies in [1393/985, √2).
    #[test]
    fn no_smaller_fraction_lies_between_the_convergent_and_the_root() {
        for q in 1_i64..985 {
            // Largest p with p/q < √2, that is p² < 2 q².
            let p = (1..2 * q).take_while(|p| p * p < 2 * q * q).last().unwrap_or(0);
            assert!(p * 985 < 1393 * q, "{p}/{q}");
        }
    }
}
