//! For the cells around some points, which of these is nearest: a look-up that is made by stamping each point onto its surroundings.

use super::squares::room_of;
use agv_core::grid::GridLayout;
use nalgebra::Vector2;

/// Where no point is near.
pub(super) const NOTHING: u32 = u32::MAX;

/// For each cell which point is nearest to its centre, or [`NOTHING`], and its squared distance.
#[derive(Debug, Clone, Default)]
pub(super) struct Nearest {
    pub(super) index: Vec<u32>,
    pub(super) squared: Vec<f32>,
}

impl Nearest {
    /// Bytes of its memory.
    pub(super) const fn memory(&self) -> usize {
        room_of(&self.index) + room_of(&self.squared)
    }

    /// The points nearest to the cells of a grid, whose axes are the map's; nothing beyond `reach`.
    pub(super) fn renewed(mut self, points: &[Vector2<f64>], layout: &GridLayout, reach: f64) -> Self {
        self.index.clear();
        self.index.resize(layout.len(), NOTHING);
        self.squared.clear();
        self.squared.resize(layout.len(), (reach * reach) as f32);
        self.stamp(points, layout, reach);
        self
    }

    fn stamp(&mut self, points: &[Vector2<f64>], layout: &GridLayout, reach: f64) {
        let (resolution, least) = (layout.resolution(), layout.map_from_grid().translation());
        let around = (reach / resolution).ceil() as i32;
        let clipped = |middle: i32, most: usize| (middle - around).max(0)..(middle + around + 1).min(most as i32);
        // Squared offsets of the columns, in square metres.
        let mut aside = vec![0.0_f32; 2 * around as usize + 1];
        for (index, point) in (0_u32..).zip(points) {
            let place = (point - least) / resolution;
            let middle = place.map(|v| v.floor() as i32);
            let off = |cell: i32, place: f64| (((f64::from(cell) + 0.5 - place) * resolution) as f32).powi(2);
            let columns = clipped(middle.x, layout.width());
            if columns.is_empty() {
                continue;
            }
            aside.clear();
            aside.extend(columns.clone().map(|x| off(x, place.x)));
            for y in clipped(middle.y, layout.height()) {
                let above = off(y, place.y);
                let row = y as usize * layout.width() + columns.start as usize;
                let row = row..row + aside.len();
                // By masks and without branches, so that several cells go at once.
                for ((least, nearest), aside) in
                    self.squared[row.clone()].iter_mut().zip(&mut self.index[row]).zip(&aside)
                {
                    let distance = aside + above;
                    let nearer = u32::from(distance < *least).wrapping_neg();
                    *nearest = (index & nearer) | (*nearest & !nearer);
                    *least = if distance < *least { distance } else { *least };
                }
            }
        }
    }
}
