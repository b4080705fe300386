//! Trackers are stored with all that later updates depend on.

use super::{ObstacleTracker, Track, TrackerParams, Views};
use agv_core::{Error, grid::Grid, time::Stamp};

#[derive(serde::Serialize, serde::Deserialize)]
struct Stored {
    params: TrackerParams,
    explained: Option<Grid<f32>>,
    tracks: Vec<Track>,
    next_id: u64,
    now: Option<Stamp>,
    views: Views,
}

impl Stored {
    /// What a tracker makes sure of by itself: identities rise and are never given again, and nothing was seen in the future.
    fn check(&self) -> Result<(), Error> {
        let Some(now) = self.now else {
            return if self.tracks.is_empty() { Ok(()) } else { Err(Error::Empty { name: "time of the tracks" }) };
        };
        let mut least = 0;
        for track in &self.tracks {
            track.check(now)?;
            let id = track.id.0;
            if id < least || id >= self.next_id {
                let (min, max) = (least as f64, self.next_id as f64);
                return Err(Error::OutOfRange { name: "track id", value: id as f64, min, max });
            }
            least = id.saturating_add(1);
        }
        self.views.check(now)
    }
}

impl serde::Serialize for ObstacleTracker {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let stored = Stored {
            params: self.params,
            explained: self.explained.clone(),
            tracks: self.tracks.clone(),
            next_id: self.next_id,
            now: self.now,
            views: self.views.clone(),
        };
        stored.serialize(serializer)
    }
}

impl<'de> serde::Deserialize<'de> for ObstacleTracker {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Stored::deserialize(deserializer)?.try_into().map_err(serde::de::Error::custom)
    }
}

impl TryFrom<Stored> for ObstacleTracker {
    type Error = Error;

    fn try_from(stored: Stored) -> Result<Self, Error> {
        let mut tracker = Self::new(stored.params)?;
        stored.check()?;
        tracker.obstacles.extend(stored.tracks.iter().filter(|track| track.moving).map(Track::obstacle));
        tracker.explained = stored.explained;
        tracker.tracks = stored.tracks;
        tracker.next_id = stored.next_id;
        tracker.now = stored.now;
        tracker.views = stored.views;
        Ok(tracker)
    }
}
