//! Getting out of the way of what moves.
//!
//! Local planners take care that the vehicle runs into nobody: it comes to rest before. Whoever comes on then runs into the vehicle. So
//! a command counts as safe here if after it there is a course that keeps clear of what moves for the time of foresight, and not
//! only a way to brake (inevitable collision states: Fraichard and Asama, *Inevitable collision states, a step towards safer
//! robots?*, 2004; looked at with a few courses: Martinez-Gomez and Fraichard, 2009). Where there is none, the vehicle takes the
//! best course itself:
//!
//! ```text
//! cost = 100 (1 - t_contact / T) + 5 max over t (1 - gap / (0.1 + 0.25 t))² / (1 + t) + distance from the path ahead after T
//! ```
//!
//! in metres of way. `T` is the foresight. A course is a heading to turn to and a speed to drive at, both as fast as the limits allow. What the obstacles will do
//! is less and less known: the gap that is asked for grows with time. Of the map nothing is touched: on the course, nor by braking on it.

use super::{NavigationRequest, contact};
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2, Twist2, wrap_angle},
    grid::Footprint,
    kinematics::{Motion, approach, stopping_speed},
    nalgebra::Vector2,
    obstacle::MovingObstacle,
};

/// A heading of the map, in radians, and velocities in the base frame to drive at, in metres per second.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Course {
    heading: f64,
    forward: f64,
    lateral: f64,
}

/// What becomes of a course.
#[derive(Debug, Clone, Copy)]
struct Outlook {
    /// Seconds until it touches something, at most the foresight.
    clear_for: f64,
    /// How near it comes to what moves: zero where it keeps all the room that is asked for, one and more where it touches.
    nearness: f64,
    /// Where it ends.
    end: Vector2<f64>,
}

/// Finds ways to keep clear of what moves.
#[derive(Debug, Clone, Default)]
pub(super) struct Evasion {
    /// The course that is being taken, or that was found to be clear last.
    course: Option<Course>,
    /// What may come near within the foresight.
    near: Vec<MovingObstacle>,
    /// Courses, and what they cost.
    courses: Vec<Course>,
    costs: Vec<(f64, usize)>,
}

/// Step of the look ahead, in seconds.
const STEP: f64 = 0.1;
/// Angles to turn by, in radians.
const TURNS: [f64; 9] = [0.0, 0.35, -0.35, 0.8, -0.8, 1.4, -1.4, 2.2, -2.2];
/// Speeds, as shares of the greatest one ahead.
const SPEEDS: [f64; 3] = [1.0, 0.6, 0.25];
/// Gap that counts as touching, in metres.
const TOUCH: f64 = 0.03;
/// Gap that is asked for, in metres, and how fast it grows, in metres per second.
const GAP: f64 = 0.1;
const GROWTH: f64 = 0.25;
/// Nearness below which a course counts as clear: half of the room is left now, and less of it later, when little is known.
const CLEAR: f64 = 0.25;
/// What a contact costs at once, and coming near, in metres of way.
const CONTACT: f64 = 100.0;
const NEARNESS: f64 = 5.0;

impl Evasion {
    pub(super) fn reset(&mut self) {
        self.course = None;
    }

    /// The motion to take instead of `planned`; none if that leaves a course that is clear for `foresight` seconds, or all
    /// others are worse. `target` is a place on the path ahead.
    pub(super) fn instead_of(
        &mut self,
        planned: &Motion,
        request: &NavigationRequest<'_>,
        footprint: &Footprint,
        target: &Vector2<f64>,
        foresight: f64,
    ) -> Result<Option<Motion>, Error> {
        let here = request.state.map_from_base;
        let fastest = request.limits.twist.forward_speed.max(request.state.twist.speed());
        self.near.clear();
        self.near.extend(request.obstacles.iter().filter(|obstacle| {
            let reach = (fastest + obstacle.velocity.norm()) * foresight + footprint.circumscribed_radius() + 1.0;
            (obstacle.position - here.translation()).norm() - obstacle.circumscribed_radius() < reach
        }));
        if self.near.is_empty() || request.map.collides(footprint, &here)? {
            self.course = None;
            return Ok(None);
        }
        let mut look = Look { request, footprint, near: &self.near, foresight, touch: TOUCH };
        // Who is nearer already must not keep the vehicle from leaving.
        look.touch = TOUCH.min(look.exact_gap(&here, 0.0) - 1e-3);
        let after = here * planned.twist.integrate(request.dt);
        let is_clear = |course: &Course| -> Result<bool, Error> {
            let outlook = look.along(&after, planned, request.dt, course)?;
            Ok(outlook.clear_for >= foresight && outlook.nearness < CLEAR)
        };
        if look.way_is_clear(planned) {
            // The one that was clear before most likely still is.
            for course in self.course.into_iter().chain(courses(request, target)) {
                if is_clear(&course)? {
                    self.course = Some(course);
                    return Ok(None);
                }
            }
        }
        self.courses.clear();
        self.courses.extend(self.course.into_iter().chain(courses(request, target)));
        self.costs.clear();
        let now = request.state.motion();
        for (index, course) in self.courses.iter().enumerate() {
            let outlook = look.along(&here, &now, 0.0, course)?;
            let cost = CONTACT * (1.0 - outlook.clear_for / foresight)
                + NEARNESS * outlook.nearness
                + (outlook.end - target).norm();
            self.costs.push((cost, index));
        }
        // Of equals the first.
        self.costs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for course in self.costs.iter().filter_map(|&(_, index)| self.courses.get(index)) {
            let motion = course.step(request, &here, &now, request.dt);
            if look.can_brake(&motion)? {
                self.course = Some(*course);
                return Ok(Some(motion));
            }
        }
        Ok(None)
    }
}

/// The courses that are looked at: standing first, then ahead, to the sides and back.
fn courses(request: &NavigationRequest<'_>, target: &Vector2<f64>) -> impl Iterator<Item = Course> {
    let here = request.state.map_from_base;
    let limits = request.limits.twist;
    let steers = request.limits.steering.is_some();
    let way = target - here.translation();
    let towards = if way.norm() > 0.1 { way.y.atan2(way.x) } else { here.yaw() };
    let standing = Course { heading: here.yaw(), forward: 0.0, lateral: 0.0 };
    let driving = SPEEDS.into_iter().flat_map(move |share| {
        let forward = share * limits.forward_speed;
        let headings = TURNS.into_iter().map(move |turn| here.yaw() + turn).chain(std::iter::once(towards));
        headings.map(move |heading| Course { heading, forward, lateral: 0.0 })
    });
    let backing = TURNS.into_iter().map(move |turn| Course {
        heading: here.yaw() + turn,
        forward: -limits.reverse_speed,
        lateral: 0.0,
    });
    let sideways = [1.0, -1.0].into_iter().map(move |side| Course {
        heading: here.yaw(),
        forward: 0.0,
        lateral: side * limits.lateral_speed,
    });
    let slides = request.limits.is_holonomic();
    let backs = limits.reverse_speed > 0.0;
    std::iter::once(standing)
        .chain(driving)
        .chain(backing.filter(move |_| backs))
        .chain(sideways.filter(move |_| slides))
        .filter(move |course| !steers || course.forward != 0.0 || course.heading == here.yaw())
}

impl Course {
    /// The motion of the next `dt` seconds towards the course.
    fn step(&self, request: &NavigationRequest<'_>, pose: &Se2, now: &Motion, dt: f64) -> Motion {
        let (limits, twist) = (request.limits, now.twist);
        let turn = wrap_angle(self.heading - pose.yaw());
        let (up, down) = (limits.twist.acceleration, limits.twist.deceleration);
        let mut yaw_rate = stopping_speed(turn.abs(), limits.twist.yaw_acceleration, dt).min(limits.twist.yaw_rate);
        if limits.steering.is_some() {
            // Its wheels turn while it drives: the bend is as narrow as the speed of the turn that is left allows.
            yaw_rate = yaw_rate.min(turn.abs() / dt);
        }
        let yaw_rate = yaw_rate.copysign(turn);
        let target = if limits.steering.is_some() {
            Twist2::new(approach(twist.vx, self.forward, up, down, dt), 0.0, yaw_rate)
        } else {
            let change = limits.twist.yaw_acceleration;
            Twist2::new(
                approach(twist.vx, self.forward, up, down, dt),
                approach(twist.vy, self.lateral, up, down, dt),
                approach(twist.yaw_rate, yaw_rate, change, change, dt),
            )
        };
        limits.step_checked(now, &target.into(), dt)
    }
}

/// A look ahead.
struct Look<'a> {
    request: &'a NavigationRequest<'a>,
    footprint: &'a Footprint,
    near: &'a [MovingObstacle],
    foresight: f64,
    /// Gap that counts as touching, in metres.
    touch: f64,
}

impl Look<'_> {
    /// What becomes of a course from a pose and a motion `begin` seconds from now.
    fn along(&self, pose: &Se2, motion: &Motion, begin: f64, course: &Course) -> Result<Outlook, Error> {
        let (mut pose, mut motion, mut time) = (*pose, *motion, begin);
        let mut nearness = 0.0_f64;
        while time < self.foresight {
            motion = course.step(self.request, &pose, &motion, STEP);
            let gap = self.gap(&pose, &motion.twist, time);
            let missing = (1.0 - gap / (GAP + GROWTH * time)).max(0.0);
            nearness = nearness.max(missing * missing / (1.0 + time));
            if gap < self.touch || self.touches_map(&pose, &motion.twist, STEP)? {
                return Ok(Outlook { clear_for: time, nearness, end: pose.translation() });
            }
            pose = pose.compose(&motion.twist.integrate(STEP));
            time += STEP;
        }
        Ok(Outlook { clear_for: self.foresight, nearness, end: pose.translation() })
    }

    /// Least gap to what moves in a step, in metres: from the circle around the vehicle, or where that touches from its outline.
    fn gap(&self, pose: &Se2, twist: &Twist2, time: f64) -> f64 {
        let (from, to) = (pose.translation(), pose.compose(&twist.integrate(STEP)).translation());
        let mut least = f64::INFINITY;
        for obstacle in self.near {
            let (before, after) = (from - obstacle.position_after(time), to - obstacle.position_after(time + STEP));
            let along = after - before;
            let square = along.norm_squared();
            let share = if square > 0.0 { (-before.dot(&along) / square).clamp(0.0, 1.0) } else { 0.0 };
            let round = (before + along * share).norm()
                - obstacle.circumscribed_radius()
                - self.footprint.circumscribed_radius();
            if round >= least {
                continue;
            }
            let gap = if round > TOUCH {
                round
            } else {
                let at = share * STEP;
                obstacle.gap_after(time + at, self.footprint, &pose.compose(&twist.integrate(at)))
            };
            least = least.min(gap);
        }
        least
    }

    fn touches_map(&self, pose: &Se2, twist: &Twist2, dt: f64) -> Result<bool, Error> {
        let reach = self.footprint.circumscribed_radius() + twist.speed() * dt;
        let room = self.request.map.distance_at(&pose.translation()).map_or(0.0, |(distance, _)| distance);
        // A cell more, as distances are between centres of cells.
        if room > reach + 2.0 * self.request.map.layout().resolution() {
            return Ok(false);
        }
        // As closely as the guard looks: what that lets pass must not be closed here.
        let obstacles = self.request.map.obstacles();
        Ok(obstacles.collides_along_within(self.footprint, pose, twist, dt, contact::MARGIN)?)
    }

    /// Whether nothing that moves is touched now, nor at the next cycle.
    fn way_is_clear(&self, motion: &Motion) -> bool {
        let (here, dt) = (self.request.state.map_from_base, self.request.dt);
        let end = here * motion.twist.integrate(dt);
        self.exact_gap(&here, 0.0) > self.touch && self.exact_gap(&end, dt) > self.touch
    }

    /// Gap between the outline and what moves, in metres.
    fn exact_gap(&self, pose: &Se2, time: f64) -> f64 {
        let gaps = self.near.iter().map(|obstacle| obstacle.gap_after(time, self.footprint, pose));
        gaps.fold(f64::INFINITY, f64::min)
    }

    /// Whether nothing of the map is touched by a motion, nor by braking after it.
    fn can_brake(&self, motion: &Motion) -> Result<bool, Error> {
        let (limits, dt) = (self.request.limits, self.request.dt);
        let (mut pose, mut motion) = (self.request.state.map_from_base, *motion);
        for _ in 0..1000 {
            if motion.twist == Twist2::ZERO {
                return Ok(true);
            }
            if self.touches_map(&pose, &motion.twist, dt)? {
                return Ok(false);
            }
            pose = pose.compose(&motion.twist.integrate(dt));
            motion = limits.step_checked(&motion, &Motion::REST, dt);
        }
        Ok(false)
    }
}
