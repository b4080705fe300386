//! All that can be reached from the start, cell by cell: for searches that know less than that when they find nothing.

use super::{heuristic::Zero, limits::Limits, search::Workspace, space::GridSpace, step::Step};

/// A flood from the start, made when it is asked for.
#[derive(Debug, Clone, Default)]
pub(super) struct Flood {
    workspace: Option<Box<Workspace<Step>>>,
    is_current: bool,
}

impl Flood {
    /// What was reached belongs to an earlier query.
    pub(super) const fn forget(&mut self) {
        self.is_current = false;
    }

    /// Reaches all that can be reached from `start`; how many nodes were expanded.
    pub(super) fn fill(&mut self, space: &GridSpace, start: u32, limits: &mut Limits<'_>) -> u64 {
        self.is_current = true;
        let workspace = self.workspace.get_or_insert_default();
        if space.is_weighted() {
            workspace.search(&space.weighted(), &Zero, start, |_| false, limits).expansions
        } else {
            workspace.search(&space.uniform(), &Zero, start, |_| false, limits).expansions
        }
    }

    /// What was reached for this query, if it was asked for.
    pub(super) fn current(&self) -> Option<&Workspace<Step>> {
        self.workspace.as_deref().filter(|_| self.is_current)
    }
}
