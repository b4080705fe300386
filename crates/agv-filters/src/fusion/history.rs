//! Measurements of the recent past in order of time, each with the belief that followed from it.
//!
//! A measurement that comes late finds its place, and all that came after it is done again: the belief is then the one that it
//! would be if everything had come in order: to the bit, since equal stamps have an order of their own, but for the rounding of a
//! prediction that the anchor of a late motion splits. Nothing is allocated after construction; a late measurement costs as much as all that are newer than it.

use super::{FusionOutcome, linearize::SAME_MOMENT, measurement::Reading, state::State};
use agv_core::time::Stamp;
use std::collections::VecDeque;

/// What happens at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) enum Happening {
    /// The belief as it was given.
    Begin,
    /// A measurement.
    Measured(Reading),
    /// The anchor is dropped, for a motion that began here.
    Anchor(u8),
}

/// Order of what happens: by time, then by kind, then by source, however it came.
type Key = (Stamp, u8, u8);

/// A happening with its time and source.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Event {
    pub(super) stamp: Stamp,
    pub(super) source: u8,
    pub(super) happening: Happening,
    pub(super) outcome: Option<FusionOutcome>,
}

impl Event {
    pub(super) const fn new(stamp: Stamp, source: u8, happening: Happening) -> Self {
        Self { stamp, source, happening, outcome: None }
    }

    const fn key(&self) -> Key {
        let rank = match self.happening {
            Happening::Begin => 0,
            Happening::Measured(_) => 1,
            Happening::Anchor(_) => 2,
        };
        (self.stamp, rank, self.source)
    }
}

/// Why an event finds no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoPlace {
    TooOld,
    Duplicate,
}

/// Events and the states after each of them; never empty.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct History {
    events: VecDeque<Event>,
    states: VecDeque<State>,
}

impl History {
    /// A history that begins with a state, with room for `capacity` events.
    pub(super) fn new(state: &State, capacity: usize) -> Self {
        // A motion may bring an anchor beside itself before the oldest are dropped.
        let room = capacity + 3;
        let mut history = Self { events: VecDeque::with_capacity(room), states: VecDeque::with_capacity(room) };
        history.restart(state);
        history
    }

    /// Forgets everything but a state.
    pub(super) fn restart(&mut self, state: &State) {
        self.events.clear();
        self.states.clear();
        self.events.push_back(Event::new(state.stamp, 0, Happening::Begin));
        self.states.push_back(*state);
    }

    /// Time of the newest event.
    pub(super) fn latest(&self) -> Stamp {
        self.events.back().map_or(Stamp::default(), |event| event.stamp)
    }

    /// The state after everything.
    pub(super) fn newest(&self) -> Option<&State> {
        self.states.back()
    }

    /// The state after all that happened up to a time; none before the history.
    pub(super) fn at(&self, stamp: Stamp) -> Option<&State> {
        let next = self.events.partition_point(|event| event.stamp <= stamp);
        self.states.get(next.checked_sub(1)?)
    }

    /// The state just before what has this place.
    pub(super) fn before(&self, place: usize) -> Option<&State> {
        self.states.get(place.checked_sub(1)?)
    }

    /// The place that an event would have.
    pub(super) fn place(&self, event: &Event) -> Result<usize, NoPlace> {
        let key = event.key();
        let place = self.events.partition_point(|known| known.key() < key);
        match self.events.get(place) {
            Some(known) if known.key() == key => Err(NoPlace::Duplicate),
            _ if place == 0 => Err(NoPlace::TooOld),
            _ => Ok(place),
        }
    }

    /// Puts an event to its place; what follows must be [`replay`](Self::replay)ed.
    pub(super) fn insert(&mut self, place: usize, event: Event) {
        self.events.insert(place, event);
        if let Some(state) = self.states.back().copied() {
            self.states.push_back(state);
        }
    }

    /// Takes out the anchor just before an event's place if it is of the same source and, but for the rounding of stamps, of the same
    /// time: the event, a motion, drops its own.
    pub(super) fn take_anchor(&mut self, place: usize, event: &Event, slot: u8) -> bool {
        let is_same = |known: &Event| {
            known.happening == Happening::Anchor(slot)
                && known.source == event.source
                && event.stamp - known.stamp <= SAME_MOMENT
        };
        let Some(before) = place.checked_sub(1) else { return false };
        // The oldest event holds the state of all that came before.
        let found = before > 0 && self.events.get(before).is_some_and(is_same);
        if found {
            self.events.remove(before);
            self.states.remove(before);
        }
        found
    }

    /// Does everything from a place on again.
    pub(super) fn replay(&mut self, from: usize, mut step: impl FnMut(&mut State, &mut Event)) {
        // The state of an event that has just been put to the end is the one before it.
        let appended = from + 1 == self.events.len();
        let from = from.clamp(1, self.events.len());
        for (place, event) in (from..).zip(self.events.range_mut(from..)) {
            let mut pair = self.states.range_mut(place - 1..=place);
            if let (Some(before), Some(state)) = (pair.next(), pair.next()) {
                if !appended {
                    *state = *before;
                }
                step(state, event);
            }
        }
    }

    /// What became of the event at a place.
    pub(super) fn outcome(&self, place: usize) -> Option<FusionOutcome> {
        self.events.get(place).and_then(|event| event.outcome)
    }

    /// Drops what is older than `duration` seconds or beyond `capacity`.
    pub(super) fn trim(&mut self, duration: f64, capacity: usize) {
        let latest = self.latest();
        // The state of the oldest event stands for all that came before.
        while self.events.len() > 1
            && (self.events.len() > capacity || self.events.get(1).is_some_and(|next| latest - next.stamp > duration))
        {
            self.events.pop_front();
            self.states.pop_front();
        }
    }

    /// Checks a history that was stored.
    #[cfg(feature = "serde")]
    pub(super) fn validate(&self) -> Result<(), agv_core::Error> {
        agv_core::check::at_least("history", self.events.len(), 1)?;
        agv_core::check::length("states of the history", self.states.len(), self.events.len())?;
        for (before, after) in self.events.iter().zip(self.events.iter().skip(1)) {
            if after.key() <= before.key() {
                let (earlier_ns, later_ns) = (before.stamp.nanoseconds(), after.stamp.nanoseconds());
                return Err(agv_core::Error::TimeBackwards { earlier_ns, later_ns });
            }
        }
        for event in &self.events {
            if let Happening::Anchor(slot) = event.happening {
                agv_core::check::in_range("slot", f64::from(slot), 0.0, super::state::MAX_ANCHORS as f64 - 1.0)?;
            }
        }
        self.states.iter().try_for_each(State::validate)
    }

    /// Makes room for as many events as a fresh history has.
    #[cfg(feature = "serde")]
    pub(super) fn reserve(&mut self, capacity: usize) {
        let room = capacity + 3;
        self.events.reserve(room.saturating_sub(self.events.len()));
        self.states.reserve(room.saturating_sub(self.states.len()));
    }
}
