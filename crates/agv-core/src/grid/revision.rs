//! Which state of which value: what lets a consumer see in O(1) that nothing has changed.

use super::Cell;
use std::sync::Arc;

/// A state of a value that is written now and then. Equal revisions are the same state of the same value; a value keeps its
/// identity when it is moved, and a clone gets one of its own.
#[derive(Debug, Clone)]
pub struct Revision {
    /// The value's identity: while anybody remembers it, no other value has it.
    owner: Arc<()>,
    count: u64,
}

impl PartialEq for Revision {
    fn eq(&self, other: &Self) -> bool {
        self.count == other.count && Arc::ptr_eq(&self.owner, &other.owner)
    }
}

impl Eq for Revision {}

/// Cells from one corner to another, both included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CellRect {
    /// Least column and row.
    pub min: Cell,
    /// Greatest column and row.
    pub max: Cell,
}

impl CellRect {
    /// All cells of a grid of this size.
    pub const fn whole(width: usize, height: usize) -> Self {
        Self { min: Cell::new(0, 0), max: Cell::new(width as i32 - 1, height as i32 - 1) }
    }

    /// Number of cells.
    pub const fn len(&self) -> usize {
        let (width, height) = (self.max.x - self.min.x + 1, self.max.y - self.min.y + 1);
        if width <= 0 || height <= 0 { 0 } else { width as usize * height as usize }
    }

    /// Whether there are none.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether a cell is one of them.
    pub const fn contains(&self, cell: Cell) -> bool {
        cell.x >= self.min.x && cell.x <= self.max.x && cell.y >= self.min.y && cell.y <= self.max.y
    }

    const fn one(cell: Cell) -> Self {
        Self { min: cell, max: cell }
    }

    /// The least rectangle that holds both.
    #[must_use]
    pub fn joined(self, other: Self) -> Self {
        Self {
            min: Cell::new(self.min.x.min(other.min.x), self.min.y.min(other.min.y)),
            max: Cell::new(self.max.x.max(other.max.x), self.max.y.max(other.max.y)),
        }
    }
}

/// What was written since a revision.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Written {
    Nothing,
    Cells(CellRect),
    All,
}

/// The past of a grid, as far as it is told: kept by what writes it, so that who reads it can ask where it has changed since
/// it last looked.
///
/// ```
/// use agv_core::grid::{Cell, CellRect, History};
///
/// let (whole, mut history) = (CellRect::whole(40, 30), History::default());
/// let seen = history.revision().clone();
/// assert_eq!(history.changed_since(&seen, whole), None);
/// history.cell_changed(Cell::new(3, 4));
/// history.cell_changed(Cell::new(5, 2));
/// let rect = CellRect { min: Cell::new(3, 2), max: Cell::new(5, 4) };
/// assert_eq!(history.changed_since(&seen, whole), Some(rect));
/// ```
#[derive(Debug)]
pub struct History {
    revision: Revision,
    /// Count at which `written` began.
    since: u64,
    written: Written,
}

impl Default for History {
    fn default() -> Self {
        Self { revision: Revision { owner: Arc::new(()), count: 0 }, since: 0, written: Written::Nothing }
    }
}

impl Clone for History {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl History {
    /// The state that it is in.
    pub const fn revision(&self) -> &Revision {
        &self.revision
    }

    /// A cell was written.
    pub fn cell_changed(&mut self, cell: Cell) {
        self.cells_changed(CellRect::one(cell));
    }

    /// Cells of a rectangle were written.
    pub fn cells_changed(&mut self, cells: CellRect) {
        self.revision.count += 1;
        self.written = match self.written {
            Written::Nothing => Written::Cells(cells),
            Written::Cells(rect) => Written::Cells(rect.joined(cells)),
            Written::All => Written::All,
        };
    }

    /// All cells were written, or the grid is another one.
    pub const fn all_changed(&mut self) {
        self.revision.count += 1;
        self.written = Written::All;
    }

    /// Begins a new rectangle of changes; revisions from before it are answered with all cells.
    pub const fn settle(&mut self) {
        self.since = self.revision.count;
        self.written = Written::Nothing;
    }

    /// A rectangle that holds all cells written since `seen`; none if there are none; `whole` if that is not known.
    pub fn changed_since(&self, seen: &Revision, whole: CellRect) -> Option<CellRect> {
        if *seen == self.revision {
            return None;
        }
        let known = Arc::ptr_eq(&seen.owner, &self.revision.owner) && seen.count >= self.since;
        match self.written {
            Written::Cells(rect) if known => Some(rect),
            _ => Some(whole),
        }
    }
}
