//! Whatever claims `serde` comes back from a text with the same bits, and a spoilt text is refused.
//!
//! A type is added by a line in the table of its subject.

mod clouds;
mod frames;
mod gaussian;
mod grids;
mod localization;
mod mapping;
mod params;
mod sensors;
mod slam;
mod states;
mod table;
mod tuning;

#[path = "../scenes/mod.rs"]
mod scenes;
