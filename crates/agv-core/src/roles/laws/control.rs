//! Laws of [`Controller`] and [`PathTracker`].

use super::{LawViolation, NOT_FINITE, ensure};
use crate::{
    geometry::{LieGroup, Se2, Twist2},
    kinematics::{MotionLimits, TwistLimits},
    path::Path,
    roles::{Controller, PathTracker, TrackError, TrackStatus, VehicleState},
};
use nalgebra::Vector2;

/// Checks a controller: refusals change nothing, and `reset` forgets.
///
/// # Errors
/// The first law that was broken.
pub fn controller(player: &mut dyn Controller) -> Result<(), LawViolation> {
    const ROLE: &str = "Controller";
    let run = |player: &mut dyn Controller, disturb: bool| -> Vec<Option<u64>> {
        player.reset();
        (0..20)
            .map(|k| {
                if disturb {
                    for value in NOT_FINITE {
                        let _ = player.update(value, 0.0, 0.01);
                        let _ = player.update(1.0, value, 0.01);
                        let _ = player.update(1.0, 0.0, value);
                    }
                }
                player.update(1.0, 0.05 * f64::from(k), 0.01).ok().map(f64::to_bits)
            })
            .collect()
    };
    let clean = run(player, false);
    ensure(ROLE, "good values are taken", clean.iter().all(Option::is_some))?;
    ensure(ROLE, "reset forgets the past", run(player, false) == clean)?;
    for value in NOT_FINITE {
        let refused = player.update(value, 0.0, 0.01).is_err()
            && player.update(1.0, value, 0.01).is_err()
            && player.update(1.0, 0.0, value).is_err();
        ensure(ROLE, "a value that is not finite is refused", refused)?;
    }
    let stands = player.update(1.0, 0.0, 0.0).is_err() && player.update(1.0, 0.0, -0.01).is_err();
    ensure(ROLE, "a dt that is not positive is refused", stands)?;
    ensure(ROLE, "a refused value changes nothing", run(player, true) == clean)
}

/// Checks a path tracker that was just built: an ideal vehicle at the start of `path` arrives within all limits at once, and not
/// before its end: when the tracker says so, the vehicle is at rest, vehicle and remaining path are within `tolerance` metres of
/// the end, and the heading is within `heading_tolerance` radians of the last one of the path.
///
/// [`vehicles`](super::vehicles) has limits to try it with.
///
/// # Errors
/// The first law that was broken.
pub fn path_tracker(
    player: &mut dyn PathTracker,
    path: &Path,
    limits: &MotionLimits,
    dt: f64,
    tolerance: f64,
    heading_tolerance: f64,
) -> Result<(), LawViolation> {
    const ROLE: &str = "PathTracker";
    let start = path.points().first().map(|p| p.pose).unwrap_or_default();
    let steering = limits.steering.map(|_| 0.0);
    let mut state = VehicleState { steering, ..VehicleState::new(start, Twist2::ZERO) };
    let early = player.command(&state, limits, dt);
    ensure(ROLE, "a command without a path is refused", early == Err(TrackError::NoPath))?;
    let point = Path::from_positions(&[Vector2::zeros(); 3]).unwrap_or_default();
    let refused =
        player.set_path(&Path::new()) == Err(TrackError::NoPath) && player.set_path(&point) == Err(TrackError::NoPath);
    ensure(ROLE, "a path without two distinct poses is refused", refused)?;
    ensure(ROLE, "a good path is taken", player.set_path(path).is_ok())?;

    for value in NOT_FINITE {
        let nowhere = VehicleState { map_from_base: Se2::new(0.0, value, 0.0), ..state };
        let flying = VehicleState { twist: Twist2::new(0.0, 0.0, value), ..state };
        let bent = VehicleState { steering: Some(value), ..state };
        let boundless = MotionLimits { twist: TwistLimits { acceleration: value, ..limits.twist }, ..*limits };
        let refused = player.command(&nowhere, limits, dt).is_err()
            && player.command(&flying, limits, dt).is_err()
            && player.command(&bent, limits, dt).is_err()
            && player.command(&state, &boundless, dt).is_err()
            && player.command(&state, limits, value).is_err();
        ensure(ROLE, "a value that is not finite is refused", refused)?;
    }
    let stands = player.command(&state, limits, 0.0).is_err() && player.command(&state, limits, -dt).is_err();
    ensure(ROLE, "a dt that is not positive is refused", stands)?;

    // Ten times as long as the path takes at full speed, and a minute for turning and braking.
    let cycles = ((10.0 * path.length() / limits.twist.forward_speed.max(0.01) + 60.0) / dt).ceil() as usize;
    for _ in 0..cycles {
        let Ok(command) = player.command(&state, limits, dt) else {
            return ensure(ROLE, "a good state is taken", false);
        };
        let within = limits.allows_step(&state.motion(), &command.motion, dt);
        ensure(ROLE, "a command respects every limit", within)?;
        let sane =
            command.cross_track_error.is_finite() && command.heading_error.is_finite() && command.remaining >= 0.0;
        ensure(ROLE, "the errors that are reported are finite", sane)?;
        state = state.after(&command.motion, dt);
        if command.status == TrackStatus::Arrived {
            let end = path.points().last().map_or(start, |end| end.pose);
            let end_from_base = end.inverse().compose(&state.map_from_base);
            let at_end = end_from_base.translation().norm() <= tolerance;
            ensure(ROLE, "a vehicle that arrived is at the end of the path", at_end)?;
            ensure(ROLE, "nothing remains of the path of one that arrived", command.remaining <= tolerance)?;
            let headed = end_from_base.yaw().abs() <= heading_tolerance;
            ensure(ROLE, "a vehicle that arrived has the heading of the end", headed)?;
            return ensure(ROLE, "a vehicle that arrived is at rest", state.twist == Twist2::ZERO);
        }
    }
    ensure(ROLE, "an ideal vehicle arrives", false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{check, kinematics::Motion, roles::TrackCommand};

    /// Refuses what it must, and says that it arrived without moving.
    struct Idler {
        remaining: Option<f64>,
        admits: bool,
    }

    impl PathTracker for Idler {
        fn set_path(&mut self, path: &Path) -> Result<(), TrackError> {
            if path.length() <= 0.0 && !path.is_turn(1) {
                return Err(TrackError::NoPath);
            }
            self.remaining = Some(path.length());
            Ok(())
        }

        fn command(
            &mut self,
            state: &VehicleState,
            limits: &MotionLimits,
            dt: f64,
        ) -> Result<TrackCommand, TrackError> {
            let remaining = self.remaining.ok_or(TrackError::NoPath)?;
            check::positive("dt", dt)?;
            limits.validate()?;
            if !state.is_finite() {
                check::finite("state", f64::NAN)?;
            }
            let remaining = if self.admits { remaining } else { 0.0 };
            let status = TrackStatus::Arrived;
            Ok(TrackCommand { motion: Motion::REST, status, cross_track_error: 0.0, heading_error: 0.0, remaining })
        }
    }

    #[test]
    fn a_tracker_that_arrives_early_is_caught() {
        let verdict = |points: [Vector2<f64>; 3], admits| {
            let path = Path::from_positions(&points).unwrap();
            path_tracker(&mut Idler { remaining: None, admits }, &path, &MotionLimits::default(), 0.05, 0.05, 0.05)
        };
        let far = [0.0, 1.0, 2.0].map(|x| Vector2::new(x, 0.0));
        assert_eq!(verdict(far, false).unwrap_err().law, "a vehicle that arrived is at the end of the path");
        // A turn on the spot has no length, so only the heading tells.
        let mut turn = Path::from_positions(&[Vector2::zeros()]).unwrap();
        turn.push_turn(1.0).unwrap();
        let idle = &mut Idler { remaining: None, admits: false };
        let headless = path_tracker(idle, &turn, &MotionLimits::default(), 0.05, 0.05, 0.05);
        assert_eq!(headless.unwrap_err().law, "a vehicle that arrived has the heading of the end");
        // A round trip ends where it starts, so only what remains tells.
        let round = [0.0, 1.0, 0.0].map(|x| Vector2::new(x, 0.0));
        assert_eq!(verdict(round, true).unwrap_err().law, "nothing remains of the path of one that arrived");
    }
}
