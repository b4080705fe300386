//! When a search gives up, and what it tells at its end.

/// When a search gives up.
pub struct Limits<'a> {
    /// Most nodes to expand.
    pub budget: u64,
    /// Asked every [`Limits::CANCEL_INTERVAL`] expansions; `true` stops the search.
    pub cancel: Option<&'a mut dyn FnMut() -> bool>,
}

impl Limits<'_> {
    /// Expansions between two questions to `cancel`: some 25 µs of A*, longer for searches whose expansions do more.
    pub const CANCEL_INTERVAL: u64 = 1024;

    /// No limits.
    pub const fn none() -> Self {
        Self { budget: u64::MAX, cancel: None }
    }

    /// The same callback, and any number of expansions.
    pub fn without_budget(&mut self) -> Limits<'_> {
        Limits {
            budget: u64::MAX,
            cancel: self.cancel.as_mut().map(|cancel| &mut **cancel as &mut dyn FnMut() -> bool),
        }
    }

    /// Expansions after which the limits are to be looked at again.
    pub fn next_pause(&self, expansions: u64) -> u64 {
        let interval = if self.cancel.is_some() { Limits::CANCEL_INTERVAL } else { u64::MAX };
        self.budget.min(expansions.saturating_add(interval))
    }

    /// Why the search has to stop after so many expansions, if it has to; asks `cancel`.
    #[cold]
    pub fn stopped(&mut self, expansions: u64) -> Option<SearchEnd> {
        if expansions >= self.budget {
            return Some(SearchEnd::Budget);
        }
        self.cancel.as_mut().is_some_and(|cancel| cancel()).then_some(SearchEnd::Cancelled)
    }
}

/// Why a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SearchEnd {
    /// A goal was reached, at least cost where the algorithm is optimal.
    Goal {
        /// The goal.
        node: u32,
        /// Cost of the way to it.
        cost: u32,
    },
    /// Every node that can be reached was expanded.
    Exhausted,
    /// The budget ran out, or costs left the range of the integers (above four million straight steps).
    Budget,
    /// The callback asked to stop.
    Cancelled,
}

/// What a search did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SearchResult {
    /// Why it ended.
    pub end: SearchEnd,
    /// Nodes that were expanded.
    pub expansions: u64,
    /// The expanded node that the heuristic holds nearest to the goal; the start if nothing was expanded.
    pub nearest: u32,
}
