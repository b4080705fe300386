//! What to do where neither planner knows a way: small motions that are checked, and another look.

use super::{NavigationRequest, manoeuvre::Manoeuvre};
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2, Twist2, wrap_angle},
    grid::Footprint,
    kinematics::Motion,
    nalgebra::Vector2,
    path::Path,
};

/// A recovery behaviour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Recovery {
    /// Stands while the surroundings are forgotten and seen anew.
    LookAgain,
    /// Drives straight pieces and turns on the spot that a search found, to a place ahead on the path.
    Manoeuvre,
    /// Turns on the spot to where the path leads.
    Rotate,
    /// Drives back a little, as far as that is free.
    BackOff,
    /// Creeps to where there is more room, out of a place in which the outline touches something.
    Escape,
}

/// A behaviour that is under way.
#[derive(Debug, Clone)]
pub(super) struct Behaviour {
    kind: Recovery,
    start: Se2,
    /// Heading to turn to, in radians.
    heading: f64,
    /// Seconds since it began.
    time: f64,
    /// Least room that a way out may leave, in metres.
    floor: f64,
    manoeuvre: Manoeuvre,
}

/// Longest a behaviour takes, in seconds; a manoeuvre of many pieces may take longer.
const LONGEST: f64 = 3.0;
const LONGEST_MANOEUVRE: f64 = 15.0;
/// How long it may take to come to rest after that, in seconds: then it ends, whatever the estimate says.
const OVERTIME: f64 = 2.0;
/// How long a vehicle stands to look again, in seconds: some scans.
const LOOK: f64 = 0.3;
/// Way back, in metres.
const BACK: f64 = 0.3;
/// Speed of a recovery, in metres per second and radians per second.
const SPEED: f64 = 0.3;
const TURN_RATE: f64 = 1.0;
/// How far ahead a way out is looked at, in steps and seconds of each: past the corner of what is touched.
const LOOKS: usize = 6;
const CREEP: f64 = 0.3;
/// Room around the outline at which a way out of a contact ends, in cells: marks come and go by one cell as the scanner's noise has it.
const CLEAR: f64 = 1.0;
/// Least room that a way out gains, in metres.
const GAIN: f64 = 1e-3;

impl Behaviour {
    /// The behaviour that follows `before` others without progress; where a manoeuvre is due and none is found, the one after it.
    pub(super) fn new(
        before: u32,
        request: &NavigationRequest<'_>,
        footprint: &Footprint,
        path: &Path,
    ) -> Result<Self, Error> {
        let manoeuvre = if before.is_multiple_of(2) { Manoeuvre::find(request, footprint, path)? } else { None };
        // Forgetting what was seen loses what lies behind: the last resort.
        let kind = match before % 8 {
            7 => Recovery::LookAgain,
            0 | 2 | 4 | 6 if manoeuvre.is_some() => Recovery::Manoeuvre,
            0 | 1 | 4 | 5 => Recovery::Rotate,
            _ => Recovery::BackOff,
        };
        let start = request.state.map_from_base;
        // Where the path is half a metre on, or the first look if there is none: all around, a third of a turn each time.
        let ahead = path.points().iter().map(|point| point.pose.translation() - start.translation());
        let heading =
            ahead.skip_while(|way| way.norm() < 0.5).map(|way| way.y.atan2(way.x)).next().unwrap_or(start.yaw() + 2.0);
        Ok(Self { kind, start, heading, time: 0.0, floor: 0.0, manoeuvre: manoeuvre.unwrap_or_default() })
    }

    /// The way out of a contact.
    pub(super) fn escape(request: &NavigationRequest<'_>, footprint: &Footprint) -> Self {
        let start = request.state.map_from_base;
        Self {
            kind: Recovery::Escape,
            start,
            heading: 0.0,
            time: 0.0,
            // On the way some may be lost, within what cells can tell.
            floor: room(request, footprint, &start) - 0.2 * request.map.layout().resolution(),
            manoeuvre: Manoeuvre::default(),
        }
    }

    pub(super) const fn kind(&self) -> Recovery {
        self.kind
    }

    /// Whether the caller should forget the surroundings now.
    pub(super) fn forgets_map(&self) -> bool {
        self.kind == Recovery::LookAgain && self.time == 0.0
    }

    /// The next motion; none when it is done.
    pub(super) fn motion(
        &mut self,
        request: &NavigationRequest<'_>,
        footprint: &Footprint,
    ) -> Result<Option<Motion>, Error> {
        let (now, dt, limits) = (request.state.motion(), request.dt, request.limits);
        self.time += dt;
        let rest = limits.brake(&now, dt)?;
        // Within this cycle: an estimate of a vehicle at rest is never quite zero.
        let stands = rest.twist == Twist2::ZERO;
        let longest = if self.kind == Recovery::Manoeuvre { LONGEST_MANOEUVRE } else { LONGEST };
        if self.time > longest + if stands { 0.0 } else { OVERTIME } {
            return Ok(None);
        }
        let wish = match self.kind {
            Recovery::Escape => return self.creep(request, footprint, &rest),
            Recovery::LookAgain if self.time > LOOK => return Ok(None),
            Recovery::LookAgain => Twist2::ZERO,
            Recovery::Manoeuvre => match self.manoeuvre.wish(request, stands) {
                // Standing between two pieces is no end.
                Some(wish) if wish == Twist2::ZERO && self.time <= longest => return Ok(Some(rest)),
                Some(wish) => wish,
                None => Twist2::ZERO,
            },
            Recovery::Rotate => {
                let error = wrap_angle(self.heading - request.state.map_from_base.yaw());
                if error.abs() < 0.1 || limits.steering.is_some() {
                    Twist2::ZERO
                } else {
                    Twist2::new(0.0, 0.0, error.signum() * TURN_RATE.min(2.0 * error.abs()))
                }
            }
            Recovery::BackOff => {
                let back = -self.start.between(&request.state.map_from_base).x();
                if back >= BACK { Twist2::ZERO } else { Twist2::new(-SPEED, 0.0, 0.0) }
            }
        };
        if wish == Twist2::ZERO || self.time > longest {
            let is_done = stands && self.kind != Recovery::LookAgain;
            return Ok((!is_done).then_some(rest));
        }
        let motion = limits.step(&now, &wish.into(), dt)?;
        // Far enough ahead to stop.
        let twist = motion.twist;
        let stop =
            dt + (twist.vx.abs() / limits.twist.deceleration).max(twist.yaw_rate.abs() / limits.twist.yaw_acceleration);
        let in_the_way = request.map.collides_along(footprint, &request.state.map_from_base, &twist, stop)?
            || request.obstacles.iter().any(|obstacle| {
                let distance = obstacle.distance_after(0.0, &request.state.map_from_base.translation());
                distance < footprint.circumscribed_radius() + 0.2
            });
        if in_the_way {
            return Ok((!stands).then_some(rest));
        }
        Ok(Some(motion))
    }

    /// The slow motion that gains most room and loses hardly any on the way; none once nothing is near, or no motion gains any.
    fn creep(
        &self,
        request: &NavigationRequest<'_>,
        footprint: &Footprint,
        rest: &Motion,
    ) -> Result<Option<Motion>, Error> {
        let (here, now, dt) = (request.state.map_from_base, request.state.motion(), request.dt);
        let is_over = self.time > LONGEST || !request.map.obstacles().collides_within(footprint, &here, CLEAR)?;
        let before = room(request, footprint, &here);
        let mut best = (GAIN, None);
        for vx in [-SPEED, 0.0, SPEED] {
            for yaw_rate in [-TURN_RATE, 0.0, TURN_RATE] {
                let turns = yaw_rate == 0.0 || request.limits.steering.is_none();
                let twist = Twist2::new(vx, 0.0, yaw_rate);
                if !turns {
                    continue;
                }
                let after = |k: usize| room(request, footprint, &(here * twist.integrate(CREEP * k as f64)));
                // The later it is gained, the more it must be.
                let gains = (1..=LOOKS).map(|k| (after(k), k as f64)).take_while(|&(room, _)| room > self.floor);
                let gain = gains.map(|(room, k)| (room - before) / k).fold(0.0, f64::max);
                if gain > best.0 {
                    best = (gain, Some(twist));
                }
            }
        }
        match best.1.filter(|_| !is_over) {
            Some(twist) => Ok(Some(request.limits.step(&now, &twist.into(), dt)?)),
            None if rest.twist == Twist2::ZERO => Ok(None),
            None => Ok(Some(*rest)),
        }
    }
}

/// Least distance of the outline from an obstacle's centre, in metres.
fn room(request: &NavigationRequest<'_>, footprint: &Footprint, pose: &Se2) -> f64 {
    const PIECES: usize = 4;
    let distance = |point: &Vector2<f64>| request.map.distance_at(&(*pose * *point)).map_or(f64::INFINITY, |(d, _)| d);
    let circles = footprint.circles().map(|(x, radius)| distance(&Vector2::new(x, 0.0)) - radius);
    let vertices = footprint.vertices().unwrap_or_default();
    let edges = vertices.iter().zip(vertices.iter().cycle().skip(1));
    let outline = edges.flat_map(|(a, b)| (0..PIECES).map(move |k| a + (b - a) * (k as f64 / PIECES as f64)));
    outline.map(|point| distance(&point)).chain(circles).fold(f64::INFINITY, f64::min)
}
