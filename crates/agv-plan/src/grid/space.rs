//! A costmap as a graph: cells that may be entered, joined to their neighbours.

use super::{
    masks::{Pruning, row_masks},
    step::{DIAGONAL, STRAIGHT, Step},
};
use crate::Error;
use agv_core::{
    check,
    grid::{Cell, CellRect, Connectivity, CornerRule, Costmap, GridLayout, History, Revision, cost},
};

/// What a planner makes of cells that nobody has observed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum UnknownCells {
    /// They may not be entered.
    #[default]
    Blocked,
    /// They may be entered as if they had this cost of the scale of [`cost`]; from [`cost::INSCRIBED`] on they are
    /// blocked after all.
    AtCost(u8),
}

/// How a costmap becomes a graph.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GridParams {
    /// Which neighbours a cell has.
    pub connectivity: Connectivity,
    /// Whether diagonal steps may pass the corners of blocked cells.
    pub corner_rule: CornerRule,
    /// What to make of unknown cells.
    pub unknown: UnknownCells,
    /// How much dearer than a free cell the dearest one is, without unit, from 0 to [`GridParams::MAX_COST_WEIGHT`]. A step
    /// of length l between cells of costs a and b costs `l (1 + cost_weight (a + b) / 2 / 252)` metres; at zero, the
    /// default, costs only decide where the vehicle may go, and the shortest path is found. Nav2's Smac planner has 2.
    pub cost_weight: f64,
}

impl GridParams {
    /// Greatest [`cost_weight`](Self::cost_weight); the keys of the search are integers within a bounded window.
    pub const MAX_COST_WEIGHT: f64 = 50.0;
}

/// The graph of a costmap: a mask of open neighbours per cell.
///
/// Node `y * width + x` is cell `(x, y)`, as in the costmap's storage. [`update`](Self::update) asks the costmap what was
/// written since it was seen last, compares that part and derives again only the rows that changed: the same map costs
/// nothing, an equal one a comparison of bytes (some 30 ns per thousand cells), so that a planner may be handed a costmap
/// with every query.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
/// use agv_plan::grid::{GridParams, GridSpace, Step};
///
/// let mut map = Grid::filled(GridLayout::new(3, 2, 1.0, Se2::default())?, CellState::Free);
/// map.set(Cell::new(1, 0), CellState::Occupied);
/// let mut space = GridSpace::new(GridParams::default())?;
/// space.update(&Costmap::from_map(&map));
/// // From the lower left only the way up is open: the diagonal would cut the corner.
/// assert_eq!(space.mask(0), Step::NORTH.bit());
/// # Ok::<(), agv_plan::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct GridSpace {
    params: GridParams,
    layout: Option<GridLayout>,
    /// State of the costmap that was seen last.
    seen: Option<Revision>,
    /// The costmap as it was seen last.
    costs: Vec<u8>,
    masks: Vec<u8>,
    passable: [bool; 256],
    /// Cost of a straight and a diagonal step between two cells of this cost.
    step_costs: Box<[[u32; 2]; 256]>,
    canonical: Pruning,
    reverse_only: Pruning,
    /// Three padded rows of passable cells.
    rows: [Vec<u8>; 3],
    history: History,
}

impl GridSpace {
    /// A graph without cells, to be filled by [`update`](Self::update).
    ///
    /// # Errors
    /// A cost weight that is not in `[0, MAX_COST_WEIGHT]`.
    pub fn new(params: GridParams) -> Result<Self, Error> {
        check::in_range("cost_weight", params.cost_weight, 0.0, GridParams::MAX_COST_WEIGHT)?;
        let seen_as = |value: u8| match params.unknown {
            UnknownCells::AtCost(stand_in) if value == cost::UNKNOWN => stand_in,
            _ => value,
        };
        let (mut passable, mut step_costs) = ([false; 256], Box::new([[0; 2]; 256]));
        for value in 0..=u8::MAX {
            let seen = seen_as(value);
            passable[value as usize] = seen <= cost::MAX_NON_OBSTACLE;
            let factor = 1.0 + params.cost_weight * f64::from(seen) / f64::from(cost::MAX_NON_OBSTACLE);
            let scaled = |base: u32| (f64::from(base) * factor).round() as u32;
            step_costs[value as usize] = [scaled(STRAIGHT), scaled(DIAGONAL)];
        }
        Ok(Self {
            params,
            layout: None,
            seen: None,
            costs: Vec::new(),
            masks: Vec::new(),
            passable,
            step_costs,
            canonical: Pruning::canonical(params.connectivity, params.corner_rule),
            reverse_only: Pruning::reverse_only(),
            rows: Default::default(),
            history: History::default(),
        })
    }

    /// Parameters it was made with.
    pub const fn params(&self) -> &GridParams {
        &self.params
    }

    /// Layout of the costmap it knows; none before the first [`update`](Self::update).
    pub const fn layout(&self) -> Option<&GridLayout> {
        self.layout.as_ref()
    }

    /// Takes a costmap and returns how many rows changed since the last one (all of them for a map of another size).
    pub fn update(&mut self, costmap: &Costmap) -> usize {
        let layout = *costmap.layout();
        let (width, height) = (layout.width(), layout.height());
        let same_size = self.layout.is_some_and(|l| l.width() == width && l.height() == height);
        self.layout = Some(layout);
        let seen = self.seen.replace(costmap.revision().clone()).filter(|_| same_size);
        let whole = CellRect::whole(width, height);
        let Some(written) = seen.map_or(Some(whole), |seen| costmap.changed_since(&seen)) else { return 0 };
        if !same_size {
            self.masks.clear();
            self.masks.resize(layout.len(), 0);
            self.costs.clear();
            self.costs.resize(layout.len(), cost::LETHAL);
        }
        let (first, last) = (written.min.y as usize, written.max.y as usize);
        // Row y's masks see the rows beside it: they are derived when the next row is known, if one of the three changed.
        let (mut changed, mut window) = (0, [!same_size; 3]);
        let mut touched: Option<CellRect> = None;
        for y in first..=(last + 2).min(height) {
            let cells = if y <= last && y < height { self.copy_row(y, width, costmap) } else { None };
            touched = match (touched, cells) {
                (Some(rect), Some(cells)) => Some(rect.joined(cells)),
                (rect, cells) => rect.or(cells),
            };
            let now = y < height && (cells.is_some() || !same_size);
            changed += usize::from(now);
            window = [window[1], window[2], now];
            if y > 0 && window.contains(&true) {
                self.derive_row(y - 1, width, height);
            }
        }
        if !same_size {
            self.history.all_changed();
        } else if let Some(CellRect { min, max }) = touched {
            // Steps from and to the cells beside those that changed may be others.
            let min = Cell::new((min.x - 1).max(0), (min.y - 1).max(0));
            let max = Cell::new((max.x + 1).min(whole.max.x), (max.y + 1).min(whole.max.y));
            self.history.settle();
            self.history.cells_changed(CellRect { min, max });
        }
        changed
    }

    /// Copies row `y` and says which of its cells differed.
    fn copy_row(&mut self, y: usize, width: usize, costmap: &Costmap) -> Option<CellRect> {
        let cells = y * width..(y + 1) * width;
        let (old, new) = (&mut self.costs[cells.clone()], &costmap.costs()[cells]);
        if *old == *new {
            return None;
        }
        let differs = |(a, b): (&u8, &u8)| a != b;
        let first = old.iter().zip(new).position(differs)?;
        let last = old.iter().zip(new).rposition(differs)?;
        old.copy_from_slice(new);
        Some(CellRect { min: Cell::new(first as i32, y as i32), max: Cell::new(last as i32, y as i32) })
    }

    /// Which state of which space this is: equal revisions have equal cells.
    pub const fn revision(&self) -> &Revision {
        self.history.revision()
    }

    /// A rectangle that holds all cells whose costs or steps changed since `seen`; none if there are none. All cells if more
    /// than one [`update`](Self::update) that found changes lies between.
    pub fn changed_since(&self, seen: &Revision) -> Option<CellRect> {
        let layout = self.layout.as_ref()?;
        self.history.changed_since(seen, CellRect::whole(layout.width(), layout.height()))
    }

    /// As [`changed_since`](Self::changed_since) the state that was seen last, which is from now on the current one; all
    /// cells if none was seen.
    pub(super) fn follow(&self, seen: &mut Option<Revision>) -> Option<CellRect> {
        match seen.replace(self.revision().clone()) {
            Some(seen) => self.changed_since(&seen),
            None => self.layout.as_ref().map(|layout| CellRect::whole(layout.width(), layout.height())),
        }
    }

    /// Masks of row `y` from the costs.
    fn derive_row(&mut self, y: usize, width: usize, height: usize) {
        let lines = [y.checked_sub(1), Some(y), Some(y + 1).filter(|&above| above < height)];
        for (padded, line) in self.rows.iter_mut().zip(lines) {
            padded.clear();
            padded.resize(width + 2, 0);
            if let Some(line) = line {
                let costs = &self.costs[line * width..(line + 1) * width];
                for (slot, &value) in padded[1..].iter_mut().zip(costs) {
                    *slot = u8::from(self.passable[value as usize]);
                }
            }
        }
        let [below, row, above] = &self.rows;
        let masks = &mut self.masks[y * width..(y + 1) * width];
        row_masks(below, row, above, self.params.connectivity, self.params.corner_rule, masks);
    }

    /// Node of a cell, if it belongs to the map.
    #[inline]
    pub fn node(&self, cell: Cell) -> Option<u32> {
        self.layout.as_ref()?.index(cell).map(|index| index as u32)
    }

    /// Cell of a node; (0, 0) before the first [`update`](Self::update).
    #[inline]
    pub fn cell(&self, node: u32) -> Cell {
        self.layout.as_ref().map_or_else(Cell::default, |layout| layout.cell(node as usize))
    }

    /// Open neighbours of a node, a bit per [`Step`]; zero outside the map.
    #[inline]
    pub fn mask(&self, node: u32) -> u8 {
        self.masks.get(node as usize).copied().unwrap_or(0)
    }

    /// Whether the vehicle's centre may stand in the node's cell.
    #[inline]
    pub fn is_passable(&self, node: u32) -> bool {
        self.costs.get(node as usize).is_some_and(|&c| self.passable[c as usize])
    }

    /// Whether cells differ in cost, so that [`weighted`](Self::weighted) is the view to search.
    pub fn is_weighted(&self) -> bool {
        self.params.cost_weight > 0.0
    }

    /// Number of cells; zero before the first [`update`](Self::update).
    pub const fn len(&self) -> usize {
        self.masks.len()
    }

    /// Whether there are no cells yet.
    pub const fn is_empty(&self) -> bool {
        self.masks.is_empty()
    }

    pub(super) const fn canonical(&self) -> &Pruning {
        &self.canonical
    }

    pub(super) const fn reverse_only(&self) -> &Pruning {
        &self.reverse_only
    }

    /// Masks of all nodes.
    pub(crate) fn masks(&self) -> &[u8] {
        &self.masks
    }

    pub(super) fn costs(&self) -> &[u8] {
        &self.costs
    }

    pub(super) fn step_costs(&self) -> &[[u32; 2]; 256] {
        &self.step_costs
    }

    /// How the node's number changes by each step, modulo 2^32.
    pub(crate) fn strides(&self) -> [u32; 8] {
        let width = self.layout.map_or(0, |l| l.width() as u32);
        Step::ALL.map(|step| (step.dx() as u32).wrapping_add((step.dy() as u32).wrapping_mul(width)))
    }

    /// Cost of the way along `nodes`, in cells: its length, from exact counts of straight and diagonal steps where it runs
    /// along them, and weighted by the cells' costs where the parameters say so (then each node is a neighbour of the last).
    pub fn path_cost(&self, nodes: &[u32]) -> f64 {
        let (mut straight, mut diagonal) = (0_u64, 0_u64);
        let mut extra = 0.0;
        let weight = self.params.cost_weight / f64::from(cost::MAX_NON_OBSTACLE);
        let mut ahead = nodes.first().map_or_else(Cell::default, |&node| self.cell(node));
        for pair in nodes.windows(2) {
            let (a, b) = (ahead, self.cell(pair[1]));
            ahead = b;
            let (dx, dy) = (a.x.abs_diff(b.x), a.y.abs_diff(b.y));
            if dx == dy {
                diagonal += u64::from(dx);
            } else if dx.min(dy) == 0 {
                straight += u64::from(dx.max(dy));
            } else {
                extra += f64::from(dx).hypot(f64::from(dy));
            }
            if self.is_weighted() {
                let length = f64::from(dx).hypot(f64::from(dy));
                extra += length * weight * 0.5 * (self.seen_cost(pair[0]) + self.seen_cost(pair[1]));
            }
        }
        straight as f64 + diagonal as f64 * std::f64::consts::SQRT_2 + extra
    }

    /// Cost of a cell as the search sees it.
    fn seen_cost(&self, node: u32) -> f64 {
        match (self.costs.get(node as usize), self.params.unknown) {
            (Some(&cost::UNKNOWN), UnknownCells::AtCost(stand_in)) => f64::from(stand_in),
            (Some(&value), _) => f64::from(value),
            (None, _) => 0.0,
        }
    }
}
