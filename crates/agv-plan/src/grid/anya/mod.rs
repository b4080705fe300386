//! Shortest ways at any angle, exactly: Anya (Harabor, Grastien, Öz and Aksakalli 2016) in whole numbers.
//!
//! A taut string around obstacles that are made of cells bends at the corners of single cells only. From a root, the start
//! or such a corner, the search follows cones of sight from row to row and cuts them at runs of free cells; where a cone
//! meets a corner, a string may bend round it, and the corner is the next root. Cones and corners wait in one open list, by
//!
//! ```text
//! f = g(root) + min over the cone's interval I of |root p| + |p goal|,  p in I
//! ```
//!
//! with the goal mirrored at the interval's line if it lies on the root's side: no way through the interval is shorter, so the
//! first way that comes out of the list is the shortest. A cone is a root and two rays through corners, all whole numbers:
//! what is seen is decided without rounding.

mod planner;
mod ray;
mod runs;
mod search;

pub use planner::Anya;
