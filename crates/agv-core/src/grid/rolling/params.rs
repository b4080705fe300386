//! What a rolling costmap is to be.

use crate::{
    Error, check,
    grid::{Footprint, InflationParams},
};

/// Parameters of a [`RollingCostmap`](super::RollingCostmap).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RollingParams {
    /// Cells of the window along x.
    pub width: usize,
    /// Cells of the window along y.
    pub height: usize,
    /// Edge of a cell, in metres.
    pub resolution: f64,
    /// Greatest range at which a hit is marked, in metres; none for all. A beam that ends farther off clears all the same.
    pub mark_range: Option<f64>,
    /// Greatest range up to which a beam that marks nothing clears, in metres; none for all of it.
    pub clear_range: Option<f64>,
    /// Whether a beam without a return clears, up to the scanner's `range_max`; if not, it says nothing.
    pub no_return_clears: bool,
    /// How many updates in a row must see through a mark, without one that hits it, until it is cleared; from 1 to 200.
    ///
    /// One forgets soonest, but the face of a round pole flickers: the beams beside the one that hit it an update ago pass the
    /// corner of its cell. Each more lets a moving obstacle's trail stand for one update longer.
    pub misses_to_clear: u8,
    /// Time after which a mark that nothing hit again becomes unknown, to a sixteenth of it, in seconds; none for never.
    pub forget_after: Option<f64>,
    /// Whether cells of which nothing is known stay [`cost::UNKNOWN`](super::super::cost::UNKNOWN); if not, they are free.
    pub keep_unknown: bool,
    /// Costs around obstacles; none for a map of obstacles alone, as [`LocalMap`](super::super::LocalMap)s need.
    pub inflation: Option<InflationParams>,
}

impl Default for RollingParams {
    /// Nav2's local costmap grown to what a vehicle of 2 m/s sees and needs: 10 m by 10 m of 0.05 m cells around it, all hits
    /// marked, and its inflation. A mark is cleared by the second update that sees through it, which keeps poles of 0.15 m from
    /// flickering, and forgotten after 30 s without a look at it.
    fn default() -> Self {
        Self {
            width: 200,
            height: 200,
            resolution: 0.05,
            mark_range: None,
            clear_range: None,
            no_return_clears: true,
            misses_to_clear: 2,
            forget_after: Some(30.0),
            keep_unknown: true,
            inflation: Some(InflationParams::default()),
        }
    }
}

impl RollingParams {
    /// The defaults with the inflation that the vehicle needs.
    pub fn for_footprint(footprint: &Footprint) -> Self {
        Self { inflation: Some(InflationParams::for_footprint(footprint)), ..Self::default() }
    }

    /// Checks what neither the layout nor the inflation checks.
    pub(super) fn validate(&self) -> Result<(), Error> {
        for (name, range) in
            [("mark_range", self.mark_range), ("clear_range", self.clear_range), ("forget_after", self.forget_after)]
        {
            if let Some(value) = range {
                check::positive(name, value)?;
            }
        }
        check::in_range("misses_to_clear", f64::from(self.misses_to_clear), 1.0, 200.0).map(|_| ())
    }
}
