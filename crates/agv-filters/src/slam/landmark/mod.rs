//! Simultaneous localisation and mapping with landmarks: reflectors, tubes, trees, radio beacons.
//!
//! [`LandmarkSlam`] is an extended Kalman filter over the pose and the places of all landmarks, with errors in the group of both, so that it
//! does not learn what cannot be observed ([`SlamErrors`]). Sightings tell range and bearing, a place, or a range alone
//! ([`LandmarkReading`]); which landmark they are of is known, or found ([`Association`]).
//!
//! [`LandmarkGraphSlam`] puts a graph of all poses and landmarks behind the filter ([`LandmarkGraph`], [`LandmarkGraphSolver`]), for the best map
//! of a whole drive.
//!
//! | a sighting | becomes |
//! |---|---|
//! | of a landmark that it names, or that is the only one to explain it | a correction |
//! | that no landmark explains by far | a new landmark, believed after some more |
//! | between the two, or of several landmarks about as likely | nothing |
//! | of range alone, by name | kept, until all ranges of the landmark tell where it is |

mod association;
#[cfg(feature = "serde")]
mod checkpoint;
mod correction;
mod filter;
mod graph;
#[cfg(feature = "serde")]
mod graph_checkpoint;
mod graph_slam;
mod growth;
mod joint;
mod params;
mod problem;
mod ranging;
mod reading;
mod results;
mod solver;
mod state;

pub use filter::LandmarkSlam;
pub use graph::{GraphLandmark, LandmarkGraph, Tie};
pub use graph_slam::{LandmarkGraphSlam, LandmarkGraphSlamParams};
pub use params::{Association, LandmarkSlamParams, RangeStart, SensorView, SlamErrors, WayNoise};
pub use reading::{LandmarkReading, LandmarkSighting};
pub use results::{LandmarkKey, LandmarkUpdate, MappedLandmark, SightingOutcome};
pub use solver::LandmarkGraphSolver;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_hard;
