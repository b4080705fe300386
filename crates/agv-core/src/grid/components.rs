//! Which cells can reach which: the connected components of a grid.
//!
//! One pass over the rows gives each free cell the label of a neighbour that was seen before it and joins the labels that
//! meet there (Rosenfeld and Pfaltz 1966), a second pass writes the final numbers: no stack, whatever the map's shape.

use super::{Cell, Connectivity, CornerRule, GridLayout};
use nalgebra::Vector2;

/// A label per cell; two cells are joined by a path if and only if their labels are equal.
///
/// Components are numbered from zero by their first cell in storage order.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Components, Connectivity, CornerRule, Grid, GridLayout};
///
/// let states = [CellState::Free, CellState::Free, CellState::Occupied, CellState::Free].to_vec();
/// let map = Grid::new(GridLayout::new(4, 1, 1.0, Se2::default())?, states)?;
/// let mut components = Components::default();
/// components.compute(map.layout(), (Connectivity::Eight, CornerRule::Never), |i| map.values()[i] == CellState::Free);
///
/// assert_eq!(components.count(), 2);
/// assert!(components.are_joined(Cell::new(0, 0), Cell::new(1, 0)));
/// assert!(!components.are_joined(Cell::new(1, 0), Cell::new(3, 0)));
/// assert_eq!(components.label(Cell::new(2, 0)), None);
/// assert_eq!(components.largest(), Some(0));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Components {
    layout: Option<GridLayout>,
    /// Zero for blocked cells, else one more than the component's number.
    labels: Vec<u32>,
    /// During the first pass, for each label one that is joined with it and no greater; its root is the least of all.
    parents: Vec<u32>,
    sizes: Vec<u32>,
}

impl Components {
    /// Labels the cells whose index `is_free` accepts; time is linear in the cells, and maps no larger than an earlier one
    /// allocate nothing.
    ///
    /// The pair says which steps join cells; of the corner rules only [`CornerRule::Free`] joins more than edges do.
    pub fn compute(
        &mut self,
        layout: &GridLayout,
        (connectivity, rule): (Connectivity, CornerRule),
        is_free: impl Fn(usize) -> bool,
    ) {
        self.clear();
        self.layout = Some(*layout);
        self.labels.resize(layout.len(), 0);
        // No two neighbours begin a label: this is enough for any map of the size, so that later ones allocate nothing.
        self.parents.reserve(layout.len() / 2 + 2);
        self.sizes.reserve(layout.len() / 2 + 2);
        // Label zero is that of blocked cells.
        self.parents.push(0);
        let (width, corners) = (layout.width(), connectivity.joins_corners(rule));
        for y in 0..layout.height() {
            let (before, rest) = self.labels.split_at_mut(y * width);
            let below = before.get(before.len().saturating_sub(width)..).unwrap_or_default();
            let below_at = |x: usize| below.get(x).copied().unwrap_or(0);
            let mut left = 0;
            for (x, slot) in rest.iter_mut().take(width).enumerate() {
                if !is_free(y * width + x) {
                    left = 0;
                    continue;
                }
                let mut label = join(&mut self.parents, left, below_at(x));
                if corners {
                    label = join(&mut self.parents, label, below_at(x.wrapping_sub(1)));
                    label = join(&mut self.parents, label, below_at(x + 1));
                }
                if label == 0 {
                    label = self.parents.len() as u32;
                    self.parents.push(label);
                }
                *slot = label;
                left = label;
            }
        }
        self.number();
    }

    /// Turns the labels of the first pass into numbers without gaps, and counts.
    fn number(&mut self) {
        // A label's root is no greater than itself, so it has its number already.
        for label in 1..self.parents.len() {
            let parent = self.parents[label] as usize;
            self.parents[label] = if parent == label {
                self.sizes.push(0);
                self.sizes.len() as u32
            } else {
                self.parents[parent]
            };
        }
        for label in self.labels.iter_mut().filter(|label| **label != 0) {
            *label = self.parents[*label as usize];
            self.sizes[*label as usize - 1] += 1;
        }
    }

    /// Forgets all cells; keeps the memory.
    pub fn clear(&mut self) {
        self.layout = None;
        self.labels.clear();
        self.parents.clear();
        self.sizes.clear();
    }

    /// Number of components.
    pub fn count(&self) -> usize {
        self.sizes.len()
    }

    /// Component of a cell; none for blocked cells and outside the grid.
    #[inline]
    pub fn label(&self, cell: Cell) -> Option<u32> {
        self.label_at(self.layout.as_ref()?.index(cell)?)
    }

    /// Component of the cell that is stored at `index`; none for blocked cells and beyond the grid.
    #[inline]
    pub fn label_at(&self, index: usize) -> Option<u32> {
        self.labels.get(index).and_then(|label| label.checked_sub(1))
    }

    /// Cells of a component; zero if there is no such component.
    pub fn size(&self, label: u32) -> u32 {
        self.sizes.get(label as usize).copied().unwrap_or(0)
    }

    /// The component with the most cells, the first of them if there are several; none if no cell is free.
    pub fn largest(&self) -> Option<u32> {
        let most = self.sizes.iter().max()?;
        self.sizes.iter().position(|size| size == most).map(|label| label as u32)
    }

    /// Component of the free cell nearest to a map point, within `reach` metres (see [`GridLayout::nearest_cell`]).
    pub fn nearest(&self, point: &Vector2<f64>, reach: f64) -> Option<u32> {
        let nearest = self.layout.as_ref()?.nearest_cell(point, reach, |cell| self.label(cell).is_some())?;
        self.label(nearest)
    }

    /// Whether a path joins the two cells.
    #[inline]
    pub fn are_joined(&self, a: Cell, b: Cell) -> bool {
        self.label(a).is_some_and(|label| self.label(b) == Some(label))
    }
}

/// Joins two labels and returns the root of both; zero joins with nothing.
#[inline]
fn join(parents: &mut [u32], a: u32, b: u32) -> u32 {
    if a == b || b == 0 {
        return a;
    }
    if a == 0 {
        return b;
    }
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b) as usize] = a.min(b);
    a.min(b)
}

/// The least label joined with this one; halves the path to it on the way.
#[inline]
fn root(parents: &mut [u32], mut label: u32) -> u32 {
    while parents[label as usize] != label {
        let grandparent = parents[parents[label as usize] as usize];
        parents[label as usize] = grandparent;
        label = grandparent;
    }
    label
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Se2;
    use proptest::prelude::*;

    /// What can be reached from `start`, by a fixed point over the rules in words.
    fn reached(free: &[bool], layout: &GridLayout, steps: (Connectivity, CornerRule), start: usize) -> Vec<bool> {
        let is_free = |x, y| layout.index(Cell::new(x, y)).is_some_and(|i| free[i]);
        let joined = |a: Cell, b: Cell| {
            let sides = usize::from(is_free(a.x, b.y)) + usize::from(is_free(b.x, a.y));
            let needed = [2, 1, 0][steps.1 as usize];
            let diagonal = steps.0 == Connectivity::Eight && sides >= needed;
            (a.x - b.x).abs().max((a.y - b.y).abs()) == 1 && (a.x == b.x || a.y == b.y || diagonal)
        };
        let mut seen = vec![false; free.len()];
        seen[start] = true;
        while let Some(next) = (0..free.len()).find(|&i| {
            free[i] && !seen[i] && (0..free.len()).any(|j| seen[j] && joined(layout.cell(i), layout.cell(j)))
        }) {
            seen[next] = true;
        }
        seen
    }

    proptest! {
        #[test]
        fn joined_is_what_can_be_reached(
            free in proptest::collection::vec(prop::bool::weighted(0.55), 63),
            four in any::<bool>(),
            rule in prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)],
        ) {
            let layout = GridLayout::new(9, 7, 1.0, Se2::default()).unwrap();
            let steps = (if four { Connectivity::Four } else { Connectivity::Eight }, rule);
            let mut components = Components::default();
            // What an earlier map left is forgotten.
            components.compute(&GridLayout::new(30, 4, 1.0, Se2::default()).unwrap(), steps, |i| i % 3 != 0);
            components.compute(&layout, steps, |i| free[i]);
            let mut first_cells = 0;
            for a in 0..63 {
                if !free[a] {
                    prop_assert_eq!(components.label_at(a), None);
                    continue;
                }
                let seen = reached(&free, &layout, steps, a);
                let label = components.label_at(a).unwrap();
                prop_assert_eq!(components.size(label) as usize, seen.iter().filter(|&&s| s).count());
                for (b, &is_seen) in seen.iter().enumerate() {
                    prop_assert_eq!(components.are_joined(layout.cell(a), layout.cell(b)), is_seen);
                }
                if seen.iter().position(|&s| s) == Some(a) {
                    prop_assert_eq!(label, first_cells);
                    first_cells += 1;
                }
            }
            prop_assert_eq!(components.count(), first_cells as usize);
            let sizes: Vec<u32> = (0..first_cells).map(|label| components.size(label)).collect();
            prop_assert_eq!(components.largest().map(|l| components.size(l)), sizes.iter().max().copied());
        }
    }

    #[test]
    fn the_nearest_component_is_found_from_walls_and_outside() {
        let layout = GridLayout::new(5, 1, 1.0, Se2::default()).unwrap();
        let mut components = Components::default();
        components.compute(&layout, Default::default(), |i| i != 2 && i != 3);
        assert_eq!(components.nearest(&Vector2::new(2.4, 0.5), 1.0), Some(0));
        assert_eq!(components.nearest(&Vector2::new(3.1, 0.5), 1.5), Some(1));
        assert_eq!(components.nearest(&Vector2::new(9.0, 0.5), f64::INFINITY), Some(1));
        assert_eq!(components.nearest(&Vector2::new(3.0, 0.5), 0.4), None);
    }

    #[test]
    fn without_cells_there_are_no_components() {
        let mut components = Components::default();
        let layout = GridLayout::new(3, 2, 1.0, Se2::default()).unwrap();
        for blocked in [false, true] {
            if blocked {
                components.compute(&layout, Default::default(), |_| false);
            }
            assert_eq!((components.count(), components.largest(), components.label_at(0)), (0, None, None));
            assert_eq!((components.size(0), components.nearest(&Vector2::zeros(), 9.0)), (0, None));
            assert!(!components.are_joined(Cell::new(0, 0), Cell::new(0, 0)));
        }
    }
}
