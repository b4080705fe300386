//! Whether a vehicle gets on: it does while it leaves places behind, and does not come back to them again and again.

use agv_core::{geometry::Se2, nalgebra::Vector2};

/// The place that was left behind last, all that were, and the time since the vehicle got on.
#[derive(Debug, Clone)]
pub(super) struct Progress {
    anchor: Option<Se2>,
    /// Where the vehicle was, and how often it came there; the last [`REMEMBERED`] places.
    places: Vec<(Vector2<f64>, u32)>,
    standing: f64,
}

/// So often may a vehicle come to a place: on the way into a dead end, out of it, and once more.
const VISITS: u32 = 3;

/// Places that are remembered.
const REMEMBERED: usize = 64;

impl Progress {
    /// Before the first pose.
    pub(super) fn new() -> Self {
        Self { anchor: None, places: Vec::with_capacity(REMEMBERED), standing: 0.0 }
    }

    /// Begins anew.
    pub(super) fn reset(&mut self) {
        (self.anchor, self.standing) = (None, 0.0);
        self.places.clear();
    }

    /// Takes the pose after `dt` seconds, and says whether the vehicle has come `distance` metres farther, to a place where it has
    /// not been too often.
    pub(super) fn update(&mut self, here: &Se2, dt: f64, distance: f64) -> bool {
        self.standing += dt;
        let here_is_far = |anchor: &Se2| (here.translation() - anchor.translation()).norm() >= distance;
        if !self.anchor.as_ref().is_none_or(here_is_far) {
            return false;
        }
        let moved_on = self.anchor.replace(*here).is_some();
        if self.visit(here.translation(), distance) > VISITS {
            return false;
        }
        self.standing = 0.0;
        moved_on
    }

    /// Counts a visit of a place, and all that are nearer to it than `distance` metres as the same.
    fn visit(&mut self, place: Vector2<f64>, distance: f64) -> u32 {
        if let Some((_, visits)) = self.places.iter_mut().find(|(known, _)| (known - place).norm() < distance) {
            *visits += 1;
            return *visits;
        }
        if self.places.len() == REMEMBERED {
            self.places.remove(0);
        }
        self.places.push((place, 1));
        1
    }

    /// Takes back `dt` seconds that were spent waiting.
    pub(super) fn pause(&mut self, dt: f64) {
        self.standing = (self.standing - dt).max(0.0);
    }

    /// Seconds since the last progress.
    pub(super) const fn standing(&self) -> f64 {
        self.standing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(progress: &mut Progress, from: f64, to: f64) -> u32 {
        let steps = ((to - from).abs() / 0.05).round();
        let x = |i: f64| from + (to - from) * i / steps;
        (1..=steps as u32).map(|i| u32::from(progress.update(&Se2::new(x(f64::from(i)), 0.0, 0.0), 0.1, 0.3))).sum()
    }

    #[test]
    fn driving_on_is_progress_and_standing_is_none() {
        let mut progress = Progress::new();
        assert!(drive(&mut progress, 0.0, 30.0) >= 80);
        assert!(progress.standing() < 1.0);
        for _ in 0..50 {
            progress.update(&Se2::new(30.0, 0.0, 0.0), 0.1, 0.3);
        }
        assert!(progress.standing() >= 5.0);
        progress.pause(1.0);
        assert!(progress.standing() < 5.0);
    }

    #[test]
    fn out_of_a_dead_end_is_progress_and_to_and_fro_is_none() {
        let mut progress = Progress::new();
        drive(&mut progress, 0.0, 5.0);
        assert!(drive(&mut progress, 5.0, 0.0) >= 10);
        progress.reset();
        for _ in 0..4 {
            drive(&mut progress, 0.0, 0.8);
            drive(&mut progress, 0.8, 0.0);
        }
        let before = progress.standing();
        assert_eq!(drive(&mut progress, 0.0, 0.8) + drive(&mut progress, 0.8, 0.0), 0);
        assert!(progress.standing() > before + 3.0);
        assert!(drive(&mut progress, 0.0, 3.0) > 0);
    }
}
