//! The papers' experiments as the examples run them, on a few seeds, at the bounds that were set for them: who breaks
//! one of the parts sees it here, long before a hundred seeds are run again. `docs/experiments.md` has the figures.

mod codes;
mod fusion;
mod kidnaps;
mod landmarks;
mod loops;
mod places;
mod scan_matchers;
