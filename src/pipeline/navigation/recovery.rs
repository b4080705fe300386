//! What to do where neither planner knows a way: small motions that are checked, and another look.

use super::{
    NavigationRequest, contact,
    manoeuvre::Manoeuvre,
    search::{Found, Search},
};
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2, Twist2, wrap_angle},
    grid::Footprint,
    kinematics::Motion,
    path::Path,
};

/// A recovery behaviour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Recovery {
    /// Stands while the surroundings are forgotten and seen anew.
    LookAgain,
    /// Drives straight pieces, turns on the spot and tight arcs that a search found, to a place ahead on the path.
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
    /// Way to back off, in metres.
    back: f64,
    /// Seconds since it began.
    time: f64,
    /// The search for a manoeuvre, as long as it takes, and what is done if it finds none.
    search: Option<Search>,
    otherwise: Recovery,
    /// Seconds of the search.
    sought: f64,
    manoeuvre: Manoeuvre,
}

/// Longest a behaviour takes, in seconds; a manoeuvre of many pieces may take longer.
const LONGEST: f64 = 3.0;
const LONGEST_MANOEUVRE: f64 = 15.0;
const LONGEST_SEARCH: f64 = 10.0;
/// How long it may take to come to rest after that, in seconds: then it ends, whatever the estimate says.
const OVERTIME: f64 = 2.0;
/// How long a vehicle stands to look again, in seconds: some scans.
const LOOK: f64 = 0.3;
/// Least way back, in metres.
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
    pub(super) fn new(before: u32, request: &NavigationRequest<'_>, path: &Path, look_again: bool) -> Self {
        let steers = request.limits.steering.is_some();
        let otherwise = match before % 8 {
            // Forgetting what was seen loses what lies behind: the last resort.
            7 if look_again => Recovery::LookAgain,
            0 | 1 | 4 | 5 if !steers => Recovery::Rotate,
            _ => Recovery::BackOff,
        };
        let start = request.state.map_from_base;
        // Where the path is half a metre on, or the first look if there is none: all around, a third of a turn each time.
        let ahead = path.points().iter().map(|point| point.pose.translation() - start.translation());
        let heading =
            ahead.skip_while(|way| way.norm() < 0.5).map(|way| way.y.atan2(way.x)).next().unwrap_or(start.yaw() + 2.0);
        let search = if before.is_multiple_of(2) { Search::new(request, path) } else { None };
        // A vehicle that steers needs way to get beside what stands before it: each time more.
        let back = if steers { BACK * f64::from(1 + before % 8) } else { BACK };
        Self { heading, back, ..Self::searching(request, search, otherwise) }
    }

    /// The way out of a contact: one that leads on along the path if there is one, else to more room.
    pub(super) fn escape(request: &NavigationRequest<'_>, path: &Path) -> Self {
        Self::searching(request, Search::new(request, path), Recovery::Escape)
    }

    fn searching(request: &NavigationRequest<'_>, search: Option<Search>, otherwise: Recovery) -> Self {
        let kind = if search.is_some() { Recovery::Manoeuvre } else { otherwise };
        let start = request.state.map_from_base;
        Self {
            kind,
            otherwise,
            start,
            heading: 0.0,
            back: BACK,
            time: 0.0,
            search,
            sought: 0.0,
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
        let rest = limits.brake(&now, dt)?;
        // Within this cycle: an estimate of a vehicle at rest is never quite zero.
        let stands = rest.twist == Twist2::ZERO;
        if let Some(search) = &mut self.search {
            self.sought += dt;
            let is_over = self.sought > LONGEST_SEARCH;
            if !stands && !is_over {
                return Ok(Some(rest));
            }
            search.stay_with(&request.state.map_from_base);
            match search.go_on(request, footprint)? {
                Found::NotYet if !is_over => return Ok(Some(rest)),
                Found::Way(manoeuvre) => self.manoeuvre = manoeuvre,
                Found::NotYet | Found::NoWay => self.kind = self.otherwise,
            }
            self.search = None;
            self.start = request.state.map_from_base;
        }
        self.time += dt;
        let longest = match self.kind {
            Recovery::Manoeuvre => LONGEST_MANOEUVRE,
            Recovery::BackOff => LONGEST + self.back / SPEED,
            _ => LONGEST,
        };
        if self.time > longest + if stands { 0.0 } else { OVERTIME } {
            return Ok(None);
        }
        let wish = match self.kind {
            // The next look may show a way.
            Recovery::Escape => match creep(request, footprint)? {
                Some(wish) => wish,
                None if self.time > LOOK => Twist2::ZERO,
                None => return Ok(Some(rest)),
            },
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
                if back >= self.back { Twist2::ZERO } else { Twist2::new(-SPEED, 0.0, 0.0) }
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
        let in_the_way = !contact::may_pass(request, footprint, &request.state.map_from_base, &twist, stop)?
            || request.obstacles.iter().any(|obstacle| {
                let distance = obstacle.distance_after(0.0, &request.state.map_from_base.translation());
                distance < footprint.circumscribed_radius() + 0.2
            });
        if in_the_way {
            // Out of a contact there is nothing else to do than to wait.
            return Ok((!stands || self.kind == Recovery::Escape).then_some(rest));
        }
        Ok(Some(motion))
    }
}

/// The slow motion that gains most room; standing once nothing is near, none if no motion gains any.
fn creep(request: &NavigationRequest<'_>, footprint: &Footprint) -> Result<Option<Twist2>, Error> {
    let here = request.state.map_from_base;
    if !request.map.obstacles().collides_within(footprint, &here, CLEAR)? {
        return Ok(Some(Twist2::ZERO));
    }
    let backs = request.limits.twist.reverse_speed > 0.0;
    let before = contact::room(request, footprint, &here);
    let mut best = (GAIN, None);
    for vx in [-SPEED, 0.0, SPEED].into_iter().filter(|&vx| backs || vx >= 0.0) {
        // A vehicle that steers has its arcs, and no turn on the spot.
        let most = if request.limits.steering.is_some() { vx * request.limits.max_curvature() } else { TURN_RATE };
        for share in [-1.0, -0.5, 0.0, 0.5, 1.0] {
            let twist = Twist2::new(vx, 0.0, share * most);
            for looks in (1..=LOOKS).map(|look| look as f64) {
                let duration = looks * CREEP;
                if !contact::may_pass(request, footprint, &here, &twist, duration)? {
                    break;
                }
                // The later it is gained, the more it must be.
                let room = contact::room(request, footprint, &(here * twist.integrate(duration)));
                let gain = (room - before) / looks;
                if gain > best.0 {
                    best = (gain, Some(twist));
                }
            }
        }
    }
    Ok(best.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        grid::{CellState, Costmap, Grid, GridLayout, LocalMap, LocalMapParams},
        kinematics::{MotionLimits, SteeringLimits, TwistLimits},
        nalgebra::Vector2,
        roles::VehicleState,
    };

    /// Touched at the nose from the left and behind from the right: no straight way gains room, an arc to the right does.
    #[test]
    fn a_vehicle_that_steers_creeps_out_of_a_contact_on_either_side() {
        let layout = GridLayout::new(80, 80, 0.05, Se2::new(-2.0, -2.0, 0.0)).unwrap();
        let mut seen = Grid::filled(layout, CellState::Free);
        for touched in [Vector2::new(0.7, 0.19), Vector2::new(-0.1, -0.19)] {
            seen.set(layout.cell_at(&touched).unwrap(), CellState::Occupied);
        }
        let map = LocalMap::new(&Costmap::from_map(&seen), LocalMapParams::default()).unwrap();
        let footprint = Footprint::rectangle(-0.3, 0.9, 0.4).unwrap();
        let state = VehicleState::new(Se2::default(), Twist2::ZERO);
        let turning = MotionLimits::from(TwistLimits::default());
        let steering = SteeringLimits { wheelbase: 0.6, max_angle: 0.5, max_rate: 1.0 };
        for limits in [turning, MotionLimits { steering: Some(steering), ..turning }] {
            let request = NavigationRequest { state, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
            let twist = creep(&request, &footprint).unwrap().unwrap();
            assert!(twist.yaw_rate < 0.0, "{twist:?}");
            assert!(
                limits.steering.is_none() || twist.yaw_rate.abs() <= twist.vx.abs() * limits.max_curvature() + 1e-12
            );
        }
    }
}
