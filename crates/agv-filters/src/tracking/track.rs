//! One thing that is followed.

use super::{ConstantVelocity, Outline, TrackerParams};
use crate::kalman::{Gate, KalmanFilter, LinearMeasurement};
#[cfg(feature = "serde")]
use agv_core::{Error, check};
use agv_core::{
    obstacle::{Hull, MovingObstacle, ObstacleId},
    time::Stamp,
};
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector2, Vector4};

/// Points of a surface at some time.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Trace {
    stamp: Stamp,
    points: [Vector2<f64>; Self::POINTS],
    len: usize,
}

impl Trace {
    const POINTS: usize = 8;

    fn of(points: &[Vector2<f64>], stamp: Stamp) -> Self {
        let mut trace = Self { stamp, points: [Vector2::zeros(); Self::POINTS], len: 0 };
        let stride = points.len().div_ceil(Self::POINTS).max(1);
        for (slot, point) in trace.points.iter_mut().zip(points.iter().step_by(stride)) {
            *slot = *point;
            trace.len += 1;
        }
        trace
    }

    pub(super) fn points(&self) -> &[Vector2<f64>] {
        self.points.get(..self.len).unwrap_or_default()
    }
}

/// What is known of a thing.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Track {
    pub(super) id: ObstacleId,
    pub(super) filter: KalmanFilter<4>,
    /// Mean and variance of the radius.
    pub(super) radius: (f64, f64),
    hull: Option<Hull>,
    pub(super) hits: u32,
    /// When it was seen last.
    pub(super) seen: Stamp,
    /// Seconds for which it was not where it should be in sight.
    pub(super) absent: f64,
    /// How surely it moves: grows with evidence, falls without.
    score: u32,
    pub(super) moving: bool,
    /// Where its surface was a while ago, and more recently.
    traces: [Trace; 2],
}

/// Least standard deviation of a radius, as a share of the scatter of points: things are no perfect discs, the less the more
/// their points scatter.
const RADIUS_SHARE: f64 = 0.5;

/// Score from which on something moves, and the most that it may have.
const MOVES: u32 = 5;
const MOST_SCORE: u32 = 20;

/// Accepts the stamp of what was stored at `now`.
#[cfg(feature = "serde")]
pub(super) fn not_after(stamp: Stamp, now: Stamp) -> Result<(), Error> {
    let (earlier_ns, later_ns) = (stamp.nanoseconds(), now.nanoseconds());
    if stamp <= now { Ok(()) } else { Err(Error::TimeBackwards { earlier_ns, later_ns }) }
}

impl Track {
    pub(super) fn new(
        id: ObstacleId,
        outline: &Outline,
        points: &[Vector2<f64>],
        now: Stamp,
        params: &TrackerParams,
    ) -> Option<Self> {
        let state = Vector4::new(outline.center.x, outline.center.y, 0.0, 0.0);
        let mut covariance = Matrix4::identity() * params.initial_speed_sigma.powi(2);
        covariance.fixed_view_mut::<2, 2>(0, 0).copy_from(&outline.covariance);
        let trace = Trace::of(points, now);
        Some(Self {
            id,
            filter: KalmanFilter::new(state, covariance).ok()?,
            radius: (outline.radius, outline.radius_variance.max((RADIUS_SHARE * params.surface_sigma).powi(2))),
            hull: outline.hull,
            hits: 1,
            seen: now,
            absent: 0.0,
            score: 0,
            moving: false,
            traces: [trace; 2],
        })
    }

    /// Accepts a stored track that updates up to `now` could have left.
    #[cfg(feature = "serde")]
    pub(super) fn check(&self, now: Stamp) -> Result<(), Error> {
        check::non_negative("track radius (m)", self.radius.0)?;
        check::positive("variance of a track's radius (m²)", self.radius.1)?;
        check::non_negative("absence of a track (s)", self.absent)?;
        check::in_range("score of a track", f64::from(self.score), 0.0, f64::from(MOST_SCORE))?;
        for trace in &self.traces {
            check::in_range("points of a trace", trace.len as f64, 0.0, Trace::POINTS as f64)?;
            check::all_finite("points of a trace", trace.points.iter().flat_map(|point| point.iter()))?;
        }
        for stamp in [self.seen, self.traces[0].stamp, self.traces[1].stamp] {
            not_after(stamp, now)?;
        }
        Ok(())
    }

    pub(super) fn position(&self) -> Vector2<f64> {
        self.filter.state().xy()
    }

    pub(super) fn velocity(&self) -> Vector2<f64> {
        Vector2::new(self.filter.state()[2], self.filter.state()[3])
    }

    /// Moves it on; says whether its numbers are still some.
    pub(super) fn predict(&mut self, model: ConstantVelocity, dt: f64) -> bool {
        self.filter.predict(&model, &(), dt).is_ok()
    }

    /// Squared Mahalanobis distance of an outline, of place and size together; infinite if it is not comparable.
    pub(super) fn distance(&self, outline: &Outline) -> f64 {
        let away = outline.center - self.position();
        let spread = self.filter.covariance().fixed_view::<2, 2>(0, 0) + outline.covariance;
        // Far more than any gate: not worth an inverse.
        if away.norm_squared() > 100.0 * spread.trace() {
            return f64::INFINITY;
        }
        let size = outline.radius - self.radius.0;
        // What turns, or is seen from another side, changes its width.
        let slack = if outline.hull.is_some() || self.hull.is_some() { 0.25 * self.radius.0 + 0.05 } else { 0.02 };
        let size = size * size / (self.radius.1 + outline.radius_variance + slack * slack);
        spread.try_inverse().map_or(f64::INFINITY, |inverse| away.dot(&(inverse * away)) + size)
    }

    /// Takes in what was seen of it; says whether its numbers are still some.
    pub(super) fn update(
        &mut self,
        outline: &Outline,
        points: &[Vector2<f64>],
        now: Stamp,
        params: &TrackerParams,
    ) -> bool {
        let Ok(reading) = LinearMeasurement::new(Matrix2x4::identity(), outline.covariance) else { return false };
        if self.filter.update(&reading, &outline.center, &Gate::OPEN).is_err() {
            return false;
        }
        self.radius = (outline.radius, outline.radius_variance.max((RADIUS_SHARE * params.surface_sigma).powi(2)));
        self.hull = outline.hull;
        self.hits = self.hits.saturating_add(1);
        (self.seen, self.absent) = (now, 0.0);
        // A trace is from a third to two thirds of the memory old.
        if now - self.traces[1].stamp >= params.memory / 3.0 {
            self.traces = [self.traces[1], Trace::of(points, now)];
        }
        true
    }

    /// Where its surface was a while ago.
    pub(super) const fn trace(&self) -> &Trace {
        &self.traces[0]
    }

    /// Whether the velocity is one: of at least `least` metres per second, and of a normalised square beyond `limit`.
    pub(super) fn has_speed(&self, least: f64, limit: f64) -> bool {
        let velocity = self.velocity();
        let covariance: Matrix2<f64> = self.filter.covariance().fixed_view::<2, 2>(2, 2).into_owned();
        velocity.norm() >= least
            && covariance.try_inverse().is_some_and(|inverse| velocity.dot(&(inverse * velocity)) > limit)
    }

    /// Takes in whether there was evidence that it moves.
    pub(super) fn judge(&mut self, evidence: bool, confirm_hits: u32) {
        self.score = if evidence { (self.score + 2).min(MOST_SCORE) } else { self.score.saturating_sub(1) };
        self.moving = self.hits >= confirm_hits && if self.moving { self.score > 0 } else { self.score >= MOVES };
    }

    /// As planners see it.
    pub(super) fn obstacle(&self) -> MovingObstacle {
        MovingObstacle {
            id: self.id,
            position: self.position(),
            velocity: self.velocity(),
            radius: if self.hull.is_some() { 0.0 } else { self.radius.0 },
            hull: self.hull.unwrap_or(Hull::POINT),
        }
    }
}
