//! What the odometry read lately, by time.

use super::MotionPiece;
use agv_core::{Error, check, time::Stamp};
use nalgebra::Vector3;
use std::collections::VecDeque;

/// Most readings that are kept: the history of the default parameters at a kilohertz.
pub(super) const MOST: usize = 2048;

/// Time over which a velocity is a mean, in seconds: stamps of logs jitter by some milliseconds.
pub(super) const WINDOW: f64 = 0.1;

/// A reading and the time that it covers.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Reading {
    pub(super) start: Stamp,
    /// After the start.
    pub(super) end: Stamp,
    pub(super) piece: MotionPiece,
}

/// Readings one after the other, oldest first.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "VecDeque<Reading>", into = "VecDeque<Reading>")
)]
pub(super) struct History {
    readings: VecDeque<Reading>,
}

impl History {
    pub(super) fn new() -> Self {
        // One more comes before the oldest goes.
        Self { readings: VecDeque::with_capacity(MOST + 1) }
    }

    pub(super) fn clear(&mut self) {
        self.readings.clear();
    }

    /// End of the oldest reading if it must go, for there are too many.
    pub(super) fn overdue(&self) -> Option<Stamp> {
        (self.readings.len() > MOST).then(|| self.readings.front().map(|reading| reading.end)).flatten()
    }

    /// End of the last reading.
    pub(super) fn end(&self) -> Option<Stamp> {
        self.readings.back().map(|reading| reading.end)
    }

    /// Adds a reading. Time that the log tells twice, or backwards, passes in a nanosecond: no motion is lost.
    pub(super) fn push(&mut self, start: Stamp, end: Stamp, piece: MotionPiece) {
        let start = start.max(self.end().unwrap_or(start));
        let end = end.max(Stamp::from_nanoseconds(start.nanoseconds().saturating_add(1)));
        self.readings.push_back(Reading { start, end, piece });
    }

    /// Takes the last reading back.
    pub(super) fn pop(&mut self) {
        self.readings.pop_back();
    }

    /// Forgets what ended by `time`.
    pub(super) fn forget(&mut self, time: Stamp) {
        // The last one is kept for its velocity.
        while self.readings.len() > 1 && self.readings.front().is_some_and(|reading| reading.end <= time) {
            self.readings.pop_front();
        }
    }

    /// What was read from `from` until `to`, in order, each with its seconds.
    pub(super) fn between(&self, from: Stamp, to: Stamp) -> impl Iterator<Item = (MotionPiece, f64)> + '_ {
        let first = self.readings.partition_point(|reading| reading.end <= from);
        self.readings.range(first..).take_while(move |reading| reading.start < to).map(move |reading| {
            let dt = reading.end.min(to) - reading.start.max(from);
            (reading.piece.share(dt / (reading.end - reading.start)), dt)
        })
    }

    /// Mean velocities that the odometry read about `time`, or at the nearer end.
    pub(super) fn velocity(&self, time: Stamp) -> Vector3<f64> {
        let (Some(first), Some(last)) = (self.readings.front(), self.readings.back()) else { return Vector3::zeros() };
        // The window lies within what is known, as far as it is long enough.
        let from = (time + -0.5 * WINDOW).min(last.end + -WINDOW).max(first.start);
        let (sum, covered) = self
            .between(from, from + WINDOW)
            .fold((Vector3::zeros(), 0.0), |(sum, covered), (piece, dt)| (sum + piece.read, covered + dt));
        sum / f64::max(covered, 0.5 * WINDOW)
    }
}

impl TryFrom<VecDeque<Reading>> for History {
    type Error = Error;

    fn try_from(stored: VecDeque<Reading>) -> Result<Self, Error> {
        if stored.len() > MOST {
            return Err(Error::TooMany { name: "history", len: stored.len(), max: MOST });
        }
        let mut history = Self::new();
        let mut known = None;
        for reading in stored {
            check::all_finite("odometry", reading.piece.read.iter())?;
            check::covariance("odometry covariance", &reading.piece.covariance)?;
            if reading.end <= reading.start || known.is_some_and(|known| reading.start < known) {
                let earlier = known.unwrap_or(reading.start).max(reading.start);
                return Err(Error::TimeBackwards {
                    earlier_ns: earlier.nanoseconds(),
                    later_ns: reading.end.nanoseconds(),
                });
            }
            known = Some(reading.end);
            history.readings.push_back(reading);
        }
        Ok(history)
    }
}

impl From<History> for VecDeque<Reading> {
    fn from(history: History) -> Self {
        history.readings
    }
}
