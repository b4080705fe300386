//! Rolling costmaps are stored with all that later updates depend on.

use super::{Below, Mark, RollingCostmap, RollingParams, layout_at};
use crate::{
    Error, check,
    grid::{CellState, Footprint, Grid, Traversal},
    time::Stamp,
};

#[derive(serde::Serialize, serde::Deserialize)]
struct Stored {
    params: RollingParams,
    footprint: Option<Footprint>,
    static_map: Option<Grid<CellState>>,
    corner: (i64, i64),
    marks: Vec<Mark>,
    now: Option<Stamp>,
    pending: f64,
}

impl serde::Serialize for RollingCostmap {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let stored = Stored {
            params: self.params,
            footprint: self.footprint.clone(),
            static_map: self.below.as_ref().map(|below| below.map.clone()),
            corner: self.corner,
            marks: self.marks.values().to_vec(),
            now: self.now,
            pending: self.pending,
        };
        stored.serialize(serializer)
    }
}

impl<'de> serde::Deserialize<'de> for RollingCostmap {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Stored::deserialize(deserializer)?.try_into().map_err(serde::de::Error::custom)
    }
}

impl TryFrom<Stored> for RollingCostmap {
    type Error = Error;

    fn try_from(stored: Stored) -> Result<Self, Error> {
        let mut rolling = Self::new(stored.params)?;
        rolling.footprint = stored.footprint;
        for (name, corner) in [("corner x", stored.corner.0), ("corner y", stored.corner.1)] {
            check::in_range(name, corner as f64, -Traversal::MAX_COORDINATE, Traversal::MAX_COORDINATE)?;
        }
        for mark in &stored.marks {
            check::in_range("mark", f64::from(u8::from(mark.is_valid(stored.params.misses_to_clear))), 1.0, 1.0)?;
        }
        let RollingParams { width, height, resolution, .. } = stored.params;
        let layout = layout_at(stored.corner, width, height, resolution);
        rolling.marks = Grid::new(layout, stored.marks)?;
        rolling.states.reshape(layout, CellState::Unknown);
        rolling.corner = stored.corner;
        rolling.pending = check::non_negative("pending", stored.pending)?;
        rolling.now = stored.now;
        rolling.below = stored.static_map.map(|map| Below::new(map, &layout));
        rolling.settle()?;
        rolling.write_costs()?;
        Ok(rolling)
    }
}
