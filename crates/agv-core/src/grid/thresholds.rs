//! Free, occupied, unknown: the thresholds and the bytes of ROS's map_server.
//!
//! A map image holds a byte `v` per cell, dark where something stands: `p_occ = (255 - v) / 255`, or `v / 255` if it is
//! negated. What a byte means depends on the mode (`nav2_map_server`, `map_io.cpp`):
//!
//! ```text
//! trinary   p_occ > occupied_thresh: occupied    p_occ < free_thresh: free    else unknown
//! scale     the same, but what lies between is a percentage (p_occ - free_thresh) / (occupied_thresh - free_thresh)
//! raw       a byte up to 100 is the percentage itself, any other unknown; thresholds and negation do not apply
//! ```

use super::{CellState, Grid, inverse_model::log_odds};
use crate::{Error, check};

/// How the bytes of a map image are read and written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum MapMode {
    /// Free, occupied or unknown.
    #[default]
    Trinary,
    /// Percentages between free and occupied; unknown is kept in an alpha channel, which bytes do not have.
    Scale,
    /// The byte is the percentage, 255 is unknown.
    Raw,
}

/// Occupancy in percent, as a ROS `OccupancyGrid` message has it; none is unknown (its -1).
pub type OccupancyPercent = Option<u8>;

/// When a cell counts as free or as occupied.
///
/// ```
/// use agv_core::grid::{CellState, MapMode, OccupancyThresholds};
///
/// let thresholds = OccupancyThresholds::default();
/// let states = [0, 205, 254].map(|byte| thresholds.state_of_byte(byte, false));
/// assert_eq!(states, [CellState::Occupied, CellState::Unknown, CellState::Free]);
/// assert_eq!(thresholds.percent_of_byte(128, false, MapMode::Scale), Some(67));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawThresholds"))]
pub struct OccupancyThresholds {
    occupied: f64,
    free: f64,
    #[cfg_attr(feature = "serde", serde(skip))]
    occupied_log_odds: f64,
    #[cfg_attr(feature = "serde", serde(skip))]
    free_log_odds: f64,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawThresholds {
    occupied: f64,
    free: f64,
}

#[cfg(feature = "serde")]
impl TryFrom<RawThresholds> for OccupancyThresholds {
    type Error = Error;

    fn try_from(raw: RawThresholds) -> Result<Self, Error> {
        Self::new(raw.occupied, raw.free)
    }
}

impl Default for OccupancyThresholds {
    /// 0.65 and 0.196: map_server's, by which its unknown byte 205 is (just) unknown.
    fn default() -> Self {
        Self::of(0.65, 0.196)
    }
}

impl OccupancyThresholds {
    /// Bytes that ROS's `map_saver` writes for free, unknown and occupied.
    pub const TRINARY_BYTES: [u8; 3] = [254, 205, 0];

    /// A cell is occupied above the probability `occupied` and free below `free`.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] unless `0 <= free < occupied <= 1`.
    pub fn new(occupied: f64, free: f64) -> Result<Self, Error> {
        check::in_range("occupied_thresh", occupied, 0.0, 1.0)?;
        check::in_range("free_thresh", free, 0.0, occupied.next_down())?;
        Ok(Self::of(occupied, free))
    }

    fn of(occupied: f64, free: f64) -> Self {
        Self { occupied, free, occupied_log_odds: log_odds(occupied), free_log_odds: log_odds(free) }
    }

    /// Probability above which a cell is occupied.
    pub const fn occupied(&self) -> f64 {
        self.occupied
    }

    /// Probability below which a cell is free.
    pub const fn free(&self) -> f64 {
        self.free
    }

    /// State of a cell that is occupied with probability `p`; unknown for NaN.
    #[inline]
    pub fn state(&self, p: f64) -> CellState {
        Self::classify(p, self.occupied, self.free)
    }

    /// State of a cell by its log-odds; unknown for NaN.
    #[inline]
    pub fn state_of_log_odds(&self, log_odds: f64) -> CellState {
        Self::classify(log_odds, self.occupied_log_odds, self.free_log_odds)
    }

    #[inline]
    fn classify(value: f64, occupied: f64, free: f64) -> CellState {
        if value > occupied {
            CellState::Occupied
        } else if value < free {
            CellState::Free
        } else {
            CellState::Unknown
        }
    }

    /// Probability of occupancy that a byte of an image stands for.
    #[inline]
    pub fn probability_of_byte(byte: u8, negate: bool) -> f64 {
        f64::from(if negate { byte } else { 255 - byte }) / 255.0
    }

    /// State of a byte of a trinary image.
    #[inline]
    pub fn state_of_byte(&self, byte: u8, negate: bool) -> CellState {
        self.state(Self::probability_of_byte(byte, negate))
    }

    /// Percentage of a byte of an image without alpha channel.
    pub fn percent_of_byte(&self, byte: u8, negate: bool, mode: MapMode) -> OccupancyPercent {
        if mode == MapMode::Raw {
            return (byte <= 100).then_some(byte);
        }
        let p = Self::probability_of_byte(byte, negate);
        match (self.state(p), mode) {
            (CellState::Occupied, _) => Some(100),
            (CellState::Free, _) => Some(0),
            (CellState::Unknown, MapMode::Scale) => {
                let ratio = (p - self.free) / (self.occupied - self.free);
                Some((ratio * 100.0).round_ties_even() as u8)
            }
            (CellState::Unknown, _) => None,
        }
    }

    /// Byte that `map_saver` writes for a percentage (above 100 counts as unknown), not negated.
    ///
    /// Trinary compares the percentage with the thresholds, inclusively. Scale needs an alpha channel for unknown
    /// cells; without it they are written as 205.
    pub fn byte_of_percent(&self, percent: OccupancyPercent, mode: MapMode) -> u8 {
        let [free, unknown, occupied] = Self::TRINARY_BYTES;
        let percent = percent.filter(|&p| p <= 100);
        match (mode, percent) {
            (MapMode::Raw, percent) => percent.unwrap_or(255),
            (_, None) => unknown,
            (MapMode::Scale, Some(p)) => ((100.0 - f64::from(p)) * 2.55).round() as u8,
            (MapMode::Trinary, Some(p)) => match f64::from(p) / 100.0 {
                p if p <= self.free => free,
                p if p >= self.occupied => occupied,
                _ => unknown,
            },
        }
    }

    /// Byte of a state in a trinary image.
    pub const fn byte_of_state(state: CellState, negate: bool) -> u8 {
        let [free, unknown, occupied] = Self::TRINARY_BYTES;
        match (state, negate) {
            (CellState::Free, false) => free,
            (CellState::Unknown, false) => unknown,
            (CellState::Occupied, false) => occupied,
            (CellState::Free, true) => 255 - free,
            (CellState::Unknown, true) => 255 - unknown,
            (CellState::Occupied, true) => 255 - occupied,
        }
    }

    /// The map of an image's bytes, given row by row from the lower-left as a grid is (an image begins at its top).
    pub fn states_of_bytes(&self, bytes: &Grid<u8>, negate: bool) -> Grid<CellState> {
        bytes.map(|&byte| self.state_of_byte(byte, negate))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_thresholds_are_named() {
        let nan = f64::NAN;
        for (name, occupied, free) in [
            ("occupied_thresh", nan, 0.2),
            ("occupied_thresh", 1.1, 0.2),
            ("free_thresh", 0.65, nan),
            ("free_thresh", 0.65, -0.1),
            ("free_thresh", 0.65, 0.65),
            ("free_thresh", 0.0, 0.0),
        ] {
            let error = OccupancyThresholds::new(occupied, free).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
    }

    /// Values of `map_server`'s formulas, computed by hand for its default thresholds.
    #[test]
    fn bytes_mean_what_map_server_says() {
        let t = OccupancyThresholds::default();
        // 205: (255 - 205) / 255 = 0.19608, not below 0.196. 206: 0.19216. 89: 0.65098. 90: 0.64706.
        for (byte, negate, state) in [
            (0, false, CellState::Occupied),
            (89, false, CellState::Occupied),
            (90, false, CellState::Unknown),
            (205, false, CellState::Unknown),
            (206, false, CellState::Free),
            (254, false, CellState::Free),
            (255, true, CellState::Occupied),
            (0, true, CellState::Free),
            (50, true, CellState::Unknown),
        ] {
            assert_eq!(t.state_of_byte(byte, negate), state, "{byte} {negate}");
        }
        // (0.49804 - 0.196) / 0.454 = 0.6653
        assert_eq!(t.percent_of_byte(128, false, MapMode::Scale), Some(67));
        assert_eq!(t.percent_of_byte(128, false, MapMode::Trinary), None);
        assert_eq!(t.percent_of_byte(100, true, MapMode::Raw), Some(100));
        assert_eq!(t.percent_of_byte(101, false, MapMode::Raw), None);
    }

    #[test]
    fn writing_and_reading_returns_the_same() {
        let t = OccupancyThresholds::default();
        for state in [CellState::Free, CellState::Unknown, CellState::Occupied] {
            for negate in [false, true] {
                assert_eq!(t.state_of_byte(OccupancyThresholds::byte_of_state(state, negate), negate), state);
            }
        }
        for percent in [Some(0), Some(57), Some(100), None] {
            let raw = t.byte_of_percent(percent, MapMode::Raw);
            assert_eq!(t.percent_of_byte(raw, false, MapMode::Raw), percent);
        }
        for percent in [Some(0), Some(100), None] {
            let byte = t.byte_of_percent(percent, MapMode::Trinary);
            assert_eq!(t.percent_of_byte(byte, false, MapMode::Trinary), percent);
        }
        assert_eq!(t.byte_of_percent(Some(200), MapMode::Trinary), 205);
        // A scale that spans everything is its own inverse.
        let all = OccupancyThresholds::new(1.0, 0.0).unwrap();
        for percent in 0..=100 {
            let byte = all.byte_of_percent(Some(percent), MapMode::Scale);
            assert_eq!(all.percent_of_byte(byte, false, MapMode::Scale), Some(percent));
        }
    }

    #[test]
    fn log_odds_and_probability_agree() {
        let t = OccupancyThresholds::default();
        for p in
            (1..1000).map(|i| f64::from(i) / 1000.0).filter(|p| (p - 0.65).abs() > 1e-9 && (p - 0.196).abs() > 1e-9)
        {
            assert_eq!(t.state(p), t.state_of_log_odds(log_odds(p)));
        }
        assert_eq!(t.state(f64::NAN), CellState::Unknown);
    }
}
