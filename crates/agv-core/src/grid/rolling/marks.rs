//! What a rolling costmap remembers of each cell, and how an update changes it.
//!
//! An update first notes which cells a beam passed and which it hit, whatever the order of beams and scanners; a hit outweighs
//! any number of beams that pass. Then every cell takes its note:
//!
//! ```text
//! hit:     marked, with all its misses left
//! passed:  one miss less; without any left, or unknown before, free
//! neither: as it was
//! ```

use crate::grid::scan_insertion::CellUpdate;

/// A cell: what is known in the low byte (0 nothing, 1 free, 1 + `n` marked with `n` misses left), in the high byte how many
/// steps of time ago a mark was hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub(super) struct Mark(u16);

impl Mark {
    pub(super) const UNKNOWN: Self = Self(0);
    pub(super) const FREE: Self = Self(1);

    /// Steps of time after which a mark is forgotten.
    pub(super) const AGES: u16 = 16;

    const AGE: u16 = 1 << 8;

    pub(super) const fn hit(misses: u8) -> Self {
        Self(1 + misses as u16)
    }

    /// Whether it is one that updates with this many misses make.
    #[cfg(feature = "serde")]
    pub(super) const fn is_valid(self, misses: u8) -> bool {
        let known = self.0 & 0xff;
        known <= 1 + misses as u16 && self.0 >> 8 <= Self::AGES && (known > 1 || self.0 < Self::AGE)
    }

    #[inline]
    pub(super) const fn is_unknown(self) -> bool {
        self.0 == 0
    }

    #[inline]
    pub(super) const fn is_marked(self) -> bool {
        self.0 & 0xff > 1
    }

    /// After an update that saw through it.
    #[inline]
    pub(super) const fn missed(self) -> Self {
        match self.0 & 0xff {
            0..=2 => Self::FREE,
            _ => Self(self.0 - 1),
        }
    }

    /// `steps` of time later.
    pub(super) const fn aged(self, steps: u16) -> Self {
        if !self.is_marked() {
            return self;
        }
        let later = self.0 + steps * Self::AGE;
        if later >> 8 > Self::AGES { Self::UNKNOWN } else { Self(later) }
    }
}

/// What the beams of an update did to a cell.
pub(super) mod note {
    pub(in super::super) const NONE: i16 = 0;
    pub(in super::super) const PASSED: i16 = 1;
    pub(in super::super) const HIT: i16 = 2;
}

/// Takes the notes, by the insertion that the mapping grids have: evidence that is not negative is itself the note.
#[derive(Debug, Clone, Copy)]
pub(super) struct Notes;

impl CellUpdate for Notes {
    type Value = i16;

    #[inline]
    fn free(self, value: i16, _: i16) -> i16 {
        value | note::PASSED
    }

    #[inline]
    fn free_times(self, value: i16, count: i16, _: i16) -> i16 {
        value | i16::from(count > 0)
    }

    #[inline]
    fn hit(self, value: i16, by: i16) -> i16 {
        value | by
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misses_clear_and_time_forgets() {
        let mark = Mark::hit(3);
        assert!(mark.missed().is_marked() && mark.missed().missed().is_marked());
        assert_eq!(mark.missed().missed().missed(), Mark::FREE);
        assert_eq!((Mark::UNKNOWN.missed(), Mark::FREE.missed()), (Mark::FREE, Mark::FREE));
        let old = mark.aged(Mark::AGES);
        assert!(old.is_marked() && old.missed().is_marked() && old.aged(1).is_unknown());
        assert_eq!((Mark::FREE.aged(99), Mark::hit(200).aged(99)), (Mark::FREE, Mark::UNKNOWN));
    }
}
