//! The motion between scans, by the scans: what wheels say, made better, or in their place.
//!
//! A scan is matched with the last few that were taken in, in the window around where the odometry says that it was taken. What the
//! match says is weighed against the odometry by the information of both, so that along a corridor the wheels count and across it
//! the walls.

use crate::matching::{CorrelativeMatcher, CorrelativeParams};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2},
    roles::{AlignmentError, ScanMatcher, TargetScan},
    sensors::LaserScan,
};
use nalgebra::Matrix3;
use std::collections::VecDeque;

/// Scans that a new one is matched with.
const KEPT: usize = 4;

/// Scan matching ahead of the particles.
#[derive(Debug, Clone)]
pub(super) struct ScanOdometry {
    matcher: CorrelativeMatcher,
    /// The last scans, the oldest first, and where they were taken, in a frame of their own.
    recent: VecDeque<(Se2, LaserScan)>,
}

impl ScanOdometry {
    pub(super) fn new(params: CorrelativeParams) -> Result<Self, Error> {
        Ok(Self { matcher: CorrelativeMatcher::new(params)?, recent: VecDeque::with_capacity(KEPT) })
    }

    /// The motion from the last scan that was taken in to this one, better than the `guess`; none if the scan does not match.
    pub(super) fn motion(
        &mut self,
        scan: &LaserScan,
        guess: &Se2,
        guess_information: &Matrix3<f64>,
    ) -> Result<Option<Se2>, Error> {
        let Some((last, _)) = self.recent.back() else { return Ok(None) };
        let guessed = *last * *guess;
        let found = match self.matcher.match_scan(scan, &guessed) {
            Ok(found) => found,
            Err(AlignmentError::Invalid(error)) => return Err(error),
            Err(_) => return Ok(None),
        };
        if !found.converged() {
            return Ok(None);
        }
        let information = found.observed_information();
        let off = guessed.between(&found.target_from_source).log();
        let Some(factor) = (information + guess_information).cholesky() else { return Ok(None) };
        let pose = guessed.plus(&factor.solve(&(information * off)));
        Ok(pose.is_finite().then(|| last.between(&pose)))
    }

    /// Takes a scan in, `motion` after the last one.
    pub(super) fn take_in(&mut self, scan: &LaserScan, motion: &Se2) {
        let pose = self.recent.back().map_or_else(Se2::identity, |(last, _)| *last * *motion);
        if self.recent.len() == KEPT {
            self.recent.pop_front();
        }
        self.recent.push_back((pose, scan.clone()));
        // Poses stay small, so that no rounding gathers over a long run.
        let back = pose.inverse();
        self.recent.iter_mut().for_each(|(pose, _)| *pose = back * *pose);
        self.retarget();
    }

    fn retarget(&mut self) {
        let target: Vec<_> =
            self.recent.iter().map(|(pose, scan)| TargetScan { target_from_base: *pose, scan }).collect();
        // Scans too few or too far apart to be one target leave the last one, which the next scan then does not match.
        if self.matcher.set_target(&target).is_err() {
            self.recent.clear();
        }
    }

    /// Bytes of the scans and of the target.
    pub(super) fn memory(&self) -> usize {
        let scans: usize = self.recent.iter().map(|(_, scan)| size_of_val(scan.ranges())).sum();
        scans + self.recent.capacity() * size_of::<(Se2, LaserScan)>() + self.matcher.memory()
    }

    /// Forgets all scans.
    pub(super) fn clear(&mut self) {
        self.recent.clear();
    }

    /// The last scans, the oldest first, and where they were taken: all that later motions depend on.
    #[cfg(feature = "serde")]
    pub(super) fn recent(&self) -> Vec<(Se2, LaserScan)> {
        self.recent.iter().cloned().collect()
    }

    /// Goes on from scans that were [`recent`](Self::recent).
    #[cfg(feature = "serde")]
    pub(super) fn restore(&mut self, recent: &[(Se2, LaserScan)]) {
        self.recent = recent.iter().rev().take(KEPT).rev().cloned().collect();
        self.retarget();
    }
}
