//! Obstacles that follow key frames, again and again.
//!
//! Between two key frames an obstacle moves in a straight line at constant speed; from the last one to the end of the
//! period it stands; then it starts over at the first (it jumps there). This is the stated reading of the `DynaBARN`
//! worlds (`data/localplan/README.md`).

use crate::Error;
use agv_core::{check, obstacle::MovingObstacle};
use nalgebra::Vector2;

/// Where an obstacle is at a time of its period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeyFrame {
    /// Time since the start of the period, in seconds.
    pub time: f64,
    /// Centre in the map frame, in metres.
    pub position: Vector2<f64>,
}

/// A disc that follows its key frames with a period.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_sim::{KeyFrame, MovingDisc};
///
/// let frame = |time, x| KeyFrame { time, position: Vector2::new(x, 0.0) };
/// let disc = MovingDisc::new(0.5, 10.0, vec![frame(0.0, 0.0), frame(4.0, 8.0), frame(10.0, 0.0)])?;
/// let now = disc.at(13.0)?; // three seconds into the second round
/// assert_eq!((now.position.x, now.velocity.x, now.radius), (6.0, 2.0, 0.5));
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MovingDisc {
    radius: f64,
    period: f64,
    frames: Vec<KeyFrame>,
}

impl MovingDisc {
    /// A disc of `radius` metres that repeats `frames` every `period` seconds.
    ///
    /// # Errors
    /// A radius or period that is not finite and positive, no frames, a frame that is not finite, times that do not
    /// increase, or times outside the period.
    pub fn new(radius: f64, period: f64, frames: Vec<KeyFrame>) -> Result<Self, Error> {
        check::positive("obstacle radius", radius)?;
        check::positive("period", period)?;
        check::at_least("key frames", frames.len(), 1)?;
        let mut previous = f64::NEG_INFINITY;
        for (index, frame) in frames.iter().enumerate() {
            check::all_finite("key frame position", frame.position.iter())?;
            check::in_range("key frame time", frame.time, 0.0, period)?;
            if frame.time <= previous {
                return Err(Error::NotIncreasing { name: "key frame time", index, value: frame.time });
            }
            previous = frame.time;
        }
        Ok(Self { radius, period, frames })
    }

    /// Position and velocity `time` seconds after the start, which may be negative. O(log frames).
    ///
    /// # Errors
    /// A time that is not finite.
    pub fn at(&self, time: f64) -> Result<MovingObstacle, Error> {
        check::finite("time", time)?;
        let time = time.rem_euclid(self.period);
        let next = self.frames.partition_point(|frame| frame.time <= time);
        let before = next.checked_sub(1).and_then(|i| self.frames.get(i));
        let (position, velocity) = match (before, self.frames.get(next)) {
            (Some(a), Some(b)) => {
                let velocity = (b.position - a.position) / (b.time - a.time);
                (a.position + velocity * (time - a.time), velocity)
            }
            (Some(only), None) | (None, Some(only)) => (only.position, Vector2::zeros()),
            (None, None) => (Vector2::zeros(), Vector2::zeros()),
        };
        Ok(MovingObstacle::new(position, velocity, self.radius)?)
    }

    /// Radius, in metres.
    pub const fn radius(&self) -> f64 {
        self.radius
    }

    /// Duration of a round, in seconds.
    pub const fn period(&self) -> f64 {
        self.period
    }
}

/// All moving discs of a world.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MovingDiscs {
    discs: Vec<MovingDisc>,
}

impl MovingDiscs {
    /// A set of discs; it may be empty.
    pub const fn new(discs: Vec<MovingDisc>) -> Self {
        Self { discs }
    }

    /// The discs.
    pub fn discs(&self) -> &[MovingDisc] {
        &self.discs
    }

    /// The states `time` seconds after the start, in the order of the discs, into a buffer that is reused. Put them in
    /// the way of sensors and vehicles with [`Populated`](crate::Populated). A time that is not finite gives none.
    pub fn states_into(&self, time: f64, states: &mut Vec<MovingObstacle>) {
        states.clear();
        states.extend(self.discs.iter().filter_map(|disc| disc.at(time).ok()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Body, PlanarWorld, Populated, Shape, World2d};
    use agv_core::geometry::Se2;
    use proptest::prelude::*;

    fn frame(time: f64, x: f64, y: f64) -> KeyFrame {
        KeyFrame { time, position: Vector2::new(x, y) }
    }

    fn square() -> MovingDisc {
        MovingDisc::new(0.5, 9.0, vec![frame(0.0, 0.0, 0.0), frame(2.0, 2.0, 0.0), frame(5.0, 2.0, 3.0)]).unwrap()
    }

    proptest! {
        #[test]
        fn motion_repeats_and_velocity_is_its_slope(time in 0.01..4.9_f64, rounds in -3_i32..4) {
            let disc = square();
            let (now, again) = (disc.at(time).unwrap(), disc.at(time + 9.0 * f64::from(rounds)).unwrap());
            prop_assert!((now.position - again.position).norm() < 1e-9);
            if (time - 2.0).abs() > 1e-3 {
                let h = 1e-5;
                let slope = (disc.at(time + h).unwrap().position - disc.at(time - h).unwrap().position) / (2.0 * h);
                prop_assert!((slope - now.velocity).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn key_frames_are_met_and_the_end_is_a_rest() {
        let disc = square();
        assert_eq!(disc.at(2.0).unwrap().position, Vector2::new(2.0, 0.0));
        assert_eq!(disc.at(5.0).unwrap(), disc.at(8.9).unwrap());
        assert_eq!(disc.at(9.0).unwrap().position, Vector2::zeros());
        assert_eq!(MovingDisc::new(0.5, 1.0, vec![frame(0.5, 1.0, 1.0)]).unwrap().at(0.2).unwrap().position.x, 1.0);
    }

    #[test]
    fn moving_discs_are_seen_and_touched() {
        let world = World2d::new(Shape::room(Vector2::new(-9.0, -9.0), Vector2::new(9.0, 9.0)).to_vec()).unwrap();
        let mut obstacles = Vec::new();
        MovingDiscs::new(vec![square()]).states_into(1.0, &mut obstacles);
        let populated = Populated { world: &world, obstacles: &obstacles };
        assert_eq!(populated.cast(&Vector2::new(-3.0, 0.0), &Vector2::x(), 30.0), Some(3.5));
        assert_eq!(populated.cast(&Vector2::new(-3.0, 0.0), &-Vector2::x(), 30.0), Some(6.0));
        assert!(populated.touches(&Body::circle(0.2).unwrap(), &Se2::new(1.6, 0.0, 0.0)));
        assert!(!populated.touches(&Body::circle(0.2).unwrap(), &Se2::new(1.8, 0.0, 0.0)));
        assert_eq!(populated.clearance(&Body::circle(0.2).unwrap(), &Se2::new(3.0, 0.0, 0.0), 9.0), 1.3);
    }

    #[test]
    fn bad_key_frames_are_refused() {
        let one = || vec![frame(0.0, 0.0, 0.0)];
        assert!(MovingDisc::new(0.0, 1.0, one()).is_err());
        assert!(MovingDisc::new(1.0, f64::NAN, one()).is_err());
        assert!(MovingDisc::new(1.0, 1.0, vec![]).is_err());
        assert!(MovingDisc::new(1.0, 1.0, vec![frame(2.0, 0.0, 0.0)]).is_err());
        assert!(MovingDisc::new(1.0, 1.0, vec![frame(0.0, f64::NAN, 0.0)]).is_err());
        let repeated = MovingDisc::new(1.0, 1.0, vec![frame(0.5, 0.0, 0.0), frame(0.5, 1.0, 0.0)]);
        assert_eq!(repeated, Err(Error::NotIncreasing { name: "key frame time", index: 1, value: 0.5 }));
        assert!(square().at(f64::NAN).is_err());
    }
}
