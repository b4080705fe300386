//! Pure pursuit: drive the arc that leads to a point ahead.
//!
//! Coulter, *Implementation of the pure pursuit path tracking algorithm*, 1992: with the goal point at `(x, y)` in the
//! vehicle's frame and at the distance `l`, the arc through it has the curvature `2 y / l²`. Aiming at a point ahead cuts bends;
//! so the arc is drawn in the path's own coordinates, arc length and distance, in which the path is a straight line, and added
//! to the path's curvature where the vehicle will be:
//!
//! ```text
//! κ = κ_path + 2 (-y cos e - L sin e) / (L² + y²)          near the path  y'' + 2 v/L y' + 2 (v/L)² y = 0
//! ```
//!
//! with the distance `y`, the heading error `e` and the look-ahead `L`: a damping of 0.7 at any speed. On a straight line that is
//! Coulter's law. The look-ahead grows with the speed within bounds and goes on beyond the path's end, so that it does not
//! shrink to nothing at the goal (the oscillation that Nav2's users report); it is never shorter than the vehicle's yaw
//! acceleration can follow. The speed is regulated by curvature and by the distance to the goal, in the follower, as in
//! Macenski et al., *Regulated pure pursuit for robot path tracking*, 2023.

use super::{
    follower::{Follower, FollowerParams},
    steering::{Steering, SteeringInput},
};
use agv_core::{
    Error, check,
    geometry::{Twist2, small_angle},
    roles::TrackError,
};

/// Parameters of [`PurePursuit`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PurePursuitParams {
    /// Look-ahead per speed, in seconds.
    pub look_ahead_time: f64,
    /// Least look-ahead, in metres along the path.
    pub look_ahead_min: f64,
    /// Greatest look-ahead, in metres along the path.
    pub look_ahead_max: f64,
    /// What all trackers share.
    pub follower: FollowerParams,
}

impl Default for PurePursuitParams {
    /// Somewhat shorter than Nav2's 1.5 s and 0.3 to 0.9 m at its 0.5 m/s: an AGV in an aisle must not cut corners, and
    /// below 0.4 m its yaw acceleration would not follow.
    fn default() -> Self {
        Self { look_ahead_time: 0.7, look_ahead_min: 0.4, look_ahead_max: 1.2, follower: FollowerParams::default() }
    }
}

/// The steering law of [`PurePursuit`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PurePursuitSteering {
    params: PurePursuitParams,
}

/// The pure pursuit tracker.
pub type PurePursuit = Follower<PurePursuitSteering>;

impl PurePursuit {
    /// A tracker from its parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: PurePursuitParams) -> Result<Self, Error> {
        check::non_negative("look_ahead_time", params.look_ahead_time)?;
        check::positive("look_ahead_min", params.look_ahead_min)?;
        check::finite("look_ahead_max", params.look_ahead_max)?;
        check::in_range("look_ahead_max", params.look_ahead_max, params.look_ahead_min, f64::MAX)?;
        Self::with_steering(params.follower, PurePursuitSteering { params })
    }
}

impl Steering for PurePursuitSteering {
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError> {
        let p = &self.params;
        let ahead = (p.look_ahead_time * input.speed).clamp(p.look_ahead_min, p.look_ahead_max);
        let ahead = steerable_look_ahead(input, ahead).min(p.look_ahead_max);
        let predicted = input.predicted()?;
        let (error, heading_error) = (predicted.cross_track, predicted.heading_error);
        if let Some(facing) = input.facing {
            // Any way is open to it: the one to the point.
            return input.sideways(facing, &predicted, -(error / ahead).atan());
        }
        // The point lies at (ahead, 0) along the path, the vehicle at (0, error).
        let (sin, cos) = small_angle::sin_cos(heading_error);
        let aside = -error * cos - ahead * sin;
        let curvature = 2.0 * aside / (ahead * ahead + error * error);
        Ok(Twist2::new(input.speed, 0.0, input.speed * (predicted.curvature + curvature)))
    }

    fn reset(&mut self) {}
}

/// Least look-ahead at which the vehicle's turning acceleration suffices to come back to the path without swinging.
///
/// Near the path pure pursuit is an oscillator of frequency `√2 v / l`; an offset `y` then asks for `2√2 v² y / l³` of
/// turning acceleration, and a heading error `e` for `2√2 v² e / l²`.
fn steerable_look_ahead(input: &SteeringInput<'_>, least: f64) -> f64 {
    let (pull, turning) = (2.0 * std::f64::consts::SQRT_2 * input.speed * input.speed, input.turning_acceleration());
    let (cube, square) = (pull * input.projection.cross_track.abs(), pull * input.heading_error.abs());
    // Roots and divisions are slow, and seldom needed.
    let ahead = if cube > least * least * least * turning { (cube / turning).cbrt() } else { least };
    if square > ahead * ahead * turning { (square / turning).sqrt() } else { ahead }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = PurePursuitParams::default();
        for (name, params) in [
            ("look_ahead_time", PurePursuitParams { look_ahead_time: f64::NAN, ..good }),
            ("look_ahead_min", PurePursuitParams { look_ahead_min: 0.0, ..good }),
            ("look_ahead_max", PurePursuitParams { look_ahead_max: 0.1, ..good }),
            ("look_ahead_max", PurePursuitParams { look_ahead_max: f64::INFINITY, ..good }),
        ] {
            assert!(PurePursuit::new(params).unwrap_err().to_string().starts_with(name), "{name}");
        }
        let follower = FollowerParams { turn_in_place: 4.0, ..FollowerParams::default() };
        assert!(PurePursuit::new(PurePursuitParams { follower, ..good }).is_err());
    }
}
