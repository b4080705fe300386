//! File formats, command line, plots and progress bars of the examples: all I/O of the repository lives here.
//!
//! # Overview
//! Every reader takes a path (gzip is recognised by content, and `path.gz` is tried where `path` is missing) or an
//! [`Input`] already in memory, and gives the types of `agv-core`. What is wrong with a file is said with its name, the
//! line or byte, and the reason, by [`Error`]; a size that a header claims is never believed before the bytes are there.
//!
//! | users have | module |
//! |---|---|
//! | scan logs: CARMEN, CSV, `SCAN` text | [`log`] |
//! | ROS maps (PGM or PNG with YAML) | [`map`] |
//! | MovingAI maps and scenarios | [`movingai`] |
//! | UTIAS landmark sightings (MRCLAM) | [`mrclam`] |
//! | landmark drives: Victoria Park, Plaza, MRPT | [`landmark_log`] |
//! | trajectories: TUM, KITTI | [`trajectory`] |
//! | Kümmerle's relations | [`relations`] |
//! | pose graphs of g2o, and generated ones | [`g2o`], [`graphs`] |
//! | reference poses of pairs of clouds | [`pairs`] |
//! | worlds for local planners: BARN, `DynaBARN`, MRPB | [`localplan`] |
//! | clouds: PLY, PCD, KITTI and raw binary | [`cloud`] |
//!
//! [`cli`], [`progress`] and [`timing`] are what an example shows on the terminal, [`plot`] draws its pictures.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod cli;
pub mod cloud;
mod error;
mod fields;
pub mod g2o;
pub mod graphs;
pub mod input;
pub mod landmark_log;
pub mod localplan;
pub mod log;
pub mod map;
pub mod movingai;
pub mod mrclam;
pub mod pairs;
pub mod plot;
pub mod progress;
pub mod relations;
mod table;
pub mod timing;
pub mod trajectory;

#[cfg(test)]
mod testing;

pub use error::{Error, judge, run};
pub use input::Input;
