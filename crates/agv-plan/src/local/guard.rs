//! The guard: a command passes if, after it, the vehicle can still brake to rest without touching anything.
//!
//! ```text
//! command for dt | brake ... brake | rest
//!     way free       way free
//! ```
//!
//! Whoever starts with a way to brake, and issues only commands that the guard lets pass, or [`Guard::brake`], always has one: what
//! was looked at behind the last command is what braking now does. At rest the vehicle may be run into, but it runs into
//! nobody ("passive safety"; Bouraine, Fraichard and Salhi, *Provably safe navigation for mobile robots with limited
//! field-of-views*, 2012). That holds for a vehicle that does what it is told, for cycles of one length, and obstacles that are where
//! they are said to be.
//!
//! There are two ways to brake: on the arc that is being driven, all components in one proportion, which leads around whatever the arc
//! leads around; and as hard as the limits allow, each component by itself, which is the shorter one where turning stops later than
//! driving, and runs straight on where it stops earlier. The arc is enough if it is free. Leaving it takes room besides, the more
//! the faster the vehicle is: the turn that was given up is not had back when the next look at the obstacle shows it a little nearer.

use super::{
    check_request,
    moving::{Stretch, touches},
};
use crate::Error;
use agv_core::{
    check,
    geometry::{LieGroup, Twist2},
    grid::Footprint,
    kinematics::{Motion, MotionLimits},
    roles::{BlockReason, LocalPlanError, LocalPlanRequest},
};

/// Parameters of a [`Guard`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GuardParams {
    /// Tolerance of the look, in cells of the map, from 1/256 to 1: what passes an obstacle nearer than that may count as touching it.
    /// No distance is kept by it. Near obstacles the time goes with its inverse.
    pub margin: f64,
}

impl Default for GuardParams {
    /// A sixteenth of a cell: some millimetres, as narrow as passages are worth.
    fn default() -> Self {
        Self { margin: 1.0 / 16.0 }
    }
}

/// What the guard says of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Verdict {
    /// It may be done.
    Clear,
    /// It may not, because of this.
    Blocked(BlockReason),
}

impl Verdict {
    /// Whether the command may be done.
    pub const fn is_clear(self) -> bool {
        matches!(self, Self::Clear)
    }
}

/// Lets no command pass that breaks a limit or leaves no way to brake; shared by all local planners.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams, cost};
/// use agv_core::kinematics::MotionLimits;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_core::roles::{BlockReason, LocalPlanRequest, VehicleState};
/// use agv_plan::local::{Guard, GuardParams, Verdict};
///
/// // 1 m/s, braking at 0.5 m/s²: a metre until rest. A wall stands 1.4 m ahead of the nose.
/// let mut map = Grid::filled(GridLayout::new(100, 40, 0.05, Se2::default())?, CellState::Free);
/// (0..40).for_each(|y| drop(map.set(Cell::new(68, y), CellState::Occupied)));
/// let map = LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default())?;
/// let path = Path::from_positions(&[Vector2::new(1.0, 1.0), Vector2::new(4.0, 1.0)])?;
/// let (ahead, limits) = (Twist2::new(1.0, 0.0, 0.0), MotionLimits::default());
/// let at = |x: f64| LocalPlanRequest {
///     state: VehicleState::new(Se2::new(x, 1.0, 0.0), ahead),
///     path: &path,
///     map: &map,
///     obstacles: &[],
///     limits: &limits,
///     dt: 0.1,
/// };
/// let guard = Guard::new(Footprint::rectangle(-0.5, 1.0, 0.6)?, GuardParams::default())?;
/// assert_eq!(guard.check(&at(1.0), &ahead.into())?, Verdict::Clear);
/// assert_eq!(guard.check(&at(1.4), &ahead.into())?, Verdict::Blocked(BlockReason::Obstacle));
/// assert!(guard.check(&at(1.4), &guard.brake(&at(1.4))?)?.is_clear());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Guard {
    footprint: Footprint,
    params: GuardParams,
}

/// A way to come to rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Brake {
    /// All components in one proportion.
    Arc,
    /// Each as hard as it may.
    Hard,
}

/// Least margin, in cells, that a map is asked for.
const LEAST_MARGIN: f64 = 1.0 / 256.0;

/// By how many seconds of driving what is known of obstacles may be wrong: times the speed it is the room that leaving the arc
/// needs, and that is left at its end: odometry that is 1 % wrong stops as far off. A cell of 5 cm at 1.7 m/s.
const DOUBT: f64 = 0.03;

/// How far the vehicle goes between two looks that measure a contact, in cells.
const LOOKS: f64 = 0.25;

/// Most cycles of braking that are looked at: a vehicle that takes longer is held to break its limits.
const MOST_CYCLES: usize = 1 << 14;

impl Guard {
    /// The guard of a vehicle.
    ///
    /// # Errors
    /// A margin that is out of its range.
    pub fn new(footprint: Footprint, params: GuardParams) -> Result<Self, Error> {
        check::in_range("margin", params.margin, LEAST_MARGIN, 1.0)?;
        Ok(Self { footprint, params })
    }

    /// The parameters.
    pub const fn params(&self) -> &GuardParams {
        &self.params
    }

    /// The vehicle's outline.
    pub const fn footprint(&self) -> &Footprint {
        &self.footprint
    }

    /// Takes another outline, as when a load is taken up.
    pub fn set_footprint(&mut self, footprint: Footprint) {
        self.footprint = footprint;
    }

    /// Whether the vehicle touches an obstacle of the map as it stands.
    ///
    /// # Errors
    /// A pose that is not finite, or far off the map.
    pub fn touches(&self, request: &LocalPlanRequest<'_>) -> Result<bool, LocalPlanError> {
        Ok(request.map.collides(&self.footprint, &request.state.map_from_base)?)
    }

    /// Whether the vehicle may do `motion` until the next cycle: it breaks no limit, and neither on the way nor while braking
    /// afterwards does the vehicle touch anything of the map, nor an obstacle that moves where that is then; at the end of its arc 30 ms of
    /// driving are left to spare.
    ///
    /// # Errors
    /// A request or motion that is not finite, an empty path, or a motion too long to be looked at.
    pub fn check(&self, request: &LocalPlanRequest<'_>, motion: &Motion) -> Result<Verdict, LocalPlanError> {
        check_request(request)?;
        let twist = motion.twist;
        check::all_finite("motion", [twist.vx, twist.vy, twist.yaw_rate].iter().chain(motion.steering.iter()))?;
        self.check_trusted(request, motion)
    }

    /// [`check`](Self::check) of a request that was checked, and a finite motion.
    pub(crate) fn check_trusted(
        &self,
        request: &LocalPlanRequest<'_>,
        motion: &Motion,
    ) -> Result<Verdict, LocalPlanError> {
        if !request.limits.allows_step(&request.state.motion(), motion, request.dt) {
            return Ok(Verdict::Blocked(BlockReason::Limits));
        }
        let on_arc = self.sweep(request, motion, Brake::Arc, self.params.margin, DOUBT)?;
        if on_arc.is_clear() || !is_bent(&motion.twist) {
            return Ok(on_arc);
        }
        let hard = self.sweep(request, motion, Brake::Hard, self.params.margin, 0.0)?;
        // What is promised here, `brake` must find with the room it asks for.
        let room = room(request, &motion.twist) + LOOKS;
        if hard.is_clear() && self.contact_speed(request, motion, Brake::Hard, room)? > 0.0 {
            return Ok(on_arc);
        }
        // What waits for an obstacle to pass is told from what is closed for good.
        Ok(if hard == Verdict::Blocked(BlockReason::Obstacle) { on_arc } else { hard })
    }

    /// The command that begins to brake: on the present arc if that is free until rest, else as hard as allowed if that is, with room
    /// to spare that grows with the speed (none if the arc meets an obstacle that moves); else one that touches nothing of the map as
    /// it is. If there is none either, on the arc, unless braking hard touches something at less than half of the arc's speed.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    pub fn brake(&self, request: &LocalPlanRequest<'_>) -> Result<Motion, LocalPlanError> {
        check_request(request)?;
        let current = request.state.motion();
        let brakes =
            [Brake::Arc, Brake::Hard].map(|brake| (brake, brake_step(request.limits, &current, request.dt, brake)));
        let room = room(request, &current.twist);
        let (mut waiting, mut scarcely) = (None, None);
        for (brake, motion) in &brakes {
            // What passed a check before must not fail now because it is looked at in other places: as closely as can be.
            match self.sweep(request, motion, *brake, LEAST_MARGIN, 0.0)? {
                Verdict::Clear
                    if *brake == Brake::Arc
                        || waiting.is_some()
                        || self.contact_speed(request, motion, *brake, room)? == 0.0 =>
                {
                    return Ok(*motion);
                }
                Verdict::Clear => scarcely = Some(*motion),
                Verdict::Blocked(BlockReason::Obstacle) => {}
                Verdict::Blocked(_) => {
                    waiting.get_or_insert(*motion);
                }
            }
        }
        if let Some(motion) = waiting.or(scarcely) {
            return Ok(motion);
        }
        let [(arc, on_arc), (hard, hardest)] = brakes;
        let at_hardest = self.contact_speed(request, &hardest, hard, room)?;
        let leave = at_hardest < 0.5 * self.contact_speed(request, &on_arc, arc, room)?;
        Ok(if leave { hardest } else { on_arc })
    }

    /// Speed of the vehicle's fastest point, in metres per second, where its outline, grown by `margin` cells, first touches
    /// something of the map while it brakes, looked at every quarter of a cell; zero if it does not.
    fn contact_speed(
        &self,
        request: &LocalPlanRequest<'_>,
        motion: &Motion,
        brake: Brake,
        margin: f64,
    ) -> Result<f64, LocalPlanError> {
        let &LocalPlanRequest { limits, dt, map, .. } = request;
        let obstacles = map.obstacles();
        let (mut pose, mut motion) = (request.state.map_from_base, *motion);
        for _ in 0..MOST_CYCLES {
            if motion.twist == Twist2::ZERO {
                break;
            }
            let reach = motion.twist.speed() + motion.twist.yaw_rate.abs() * self.footprint.circumscribed_radius();
            let samples = (reach * dt / (LOOKS * map.layout().resolution())).ceil().clamp(1.0, 1e4) as usize;
            for i in 0..=samples {
                let at = pose.compose(&motion.twist.integrate(dt * i as f64 / samples as f64));
                if obstacles.collides_within(&self.footprint, &at, margin)? {
                    return Ok(reach);
                }
            }
            pose = pose.compose(&motion.twist.integrate(dt));
            motion = brake_step(limits, &motion, dt, brake);
        }
        Ok(0.0)
    }

    /// Looks at a motion and at what braking in one way makes of it, and at so many seconds more at the speed of its last arc: all of
    /// them on one that is kept until rest.
    fn sweep(
        &self,
        request: &LocalPlanRequest<'_>,
        motion: &Motion,
        brake: Brake,
        margin: f64,
        spare: f64,
    ) -> Result<Verdict, LocalPlanError> {
        // Standing is always safe enough.
        if motion.twist == Twist2::ZERO {
            return Ok(Verdict::Clear);
        }
        let &LocalPlanRequest { limits, dt, .. } = request;
        let obstacles = request.map.obstacles();
        // Cycles of one arc are looked at as one, as if it were driven at the speed of its first cycle for less time.
        let (mut pose, mut twist, mut duration) = (request.state.map_from_base, motion.twist, dt);
        let mut next = *motion;
        for _ in 0..MOST_CYCLES {
            next = brake_step(limits, &next, dt, brake);
            if let Some(share) = multiple(&next.twist, &twist) {
                duration += share * dt;
            } else {
                if obstacles.collides_along_within(&self.footprint, &pose, &twist, duration, margin)? {
                    return Ok(Verdict::Blocked(BlockReason::Obstacle));
                }
                pose = pose.compose(&twist.integrate(duration));
                (twist, duration) = (next.twist, dt);
            }
            if next.twist == Twist2::ZERO {
                duration += spare;
                let blocked = obstacles.collides_along_within(&self.footprint, &pose, &twist, duration, margin)?;
                return Ok(if blocked {
                    Verdict::Blocked(BlockReason::Obstacle)
                } else if self.touches_moving(request, motion, brake) {
                    Verdict::Blocked(BlockReason::MovingObstacle)
                } else {
                    Verdict::Clear
                });
            }
        }
        Ok(Verdict::Blocked(BlockReason::Limits))
    }

    /// Whether the vehicle touches an obstacle that moves before it rests.
    fn touches_moving(&self, request: &LocalPlanRequest<'_>, motion: &Motion, brake: Brake) -> bool {
        let &LocalPlanRequest { obstacles, limits, dt, .. } = request;
        if obstacles.is_empty() {
            return false;
        }
        let (mut motion, mut map_from_base, mut begin) = (*motion, request.state.map_from_base, 0.0);
        while motion.twist != Twist2::ZERO {
            let stretch = Stretch { map_from_base, twist: motion.twist, begin, duration: dt };
            if obstacles.iter().any(|obstacle| touches(&self.footprint, obstacle, &stretch)) {
                return true;
            }
            map_from_base = map_from_base.compose(&motion.twist.integrate(dt));
            begin += dt;
            motion = brake_step(limits, &motion, dt, brake);
        }
        false
    }
}

/// Room that leaving the arc needs at this speed, in cells.
fn room(request: &LocalPlanRequest<'_>, twist: &Twist2) -> f64 {
    DOUBT * twist.speed() / request.map.layout().resolution()
}

/// The first cycle of braking from a motion.
fn brake_step(limits: &MotionLimits, current: &Motion, dt: f64, brake: Brake) -> Motion {
    let target = match brake {
        Brake::Hard => Motion::REST,
        Brake::Arc => {
            let twist = current.twist;
            let turn = if limits.steering.is_some() { f64::INFINITY } else { limits.twist.yaw_acceleration };
            let drive = limits.twist.deceleration;
            // What is left of each component, at the least; zero of one that is zero.
            let left = |component: f64, rate: f64| (1.0 - rate * dt / component.abs()).max(0.0);
            let share = left(twist.vx, drive).max(left(twist.vy, drive)).max(left(twist.yaw_rate, turn));
            let twist = Twist2::new(share * twist.vx, share * twist.vy, share * twist.yaw_rate);
            Motion { twist, steering: current.steering }
        }
    };
    limits.step_checked(current, &target, dt)
}

/// How many times of `base` a twist is, if it is a multiple, and no negative one.
fn multiple(twist: &Twist2, base: &Twist2) -> Option<f64> {
    let square = base.vx * base.vx + base.vy * base.vy + base.yaw_rate * base.yaw_rate;
    let along = twist.vx * base.vx + twist.vy * base.vy + twist.yaw_rate * base.yaw_rate;
    let share = if square > 0.0 { along / square } else { 0.0 };
    let same = |a: f64, b: f64| (a - share * b).abs() <= SAME_ARC;
    let proportional = same(twist.vx, base.vx) && same(twist.vy, base.vy) && same(twist.yaw_rate, base.yaw_rate);
    (share >= 0.0 && proportional).then_some(share)
}

/// Rounding of twists on one arc, in m/s and rad/s.
const SAME_ARC: f64 = 1e-9;

/// Whether the two ways to brake differ.
fn is_bent(twist: &Twist2) -> bool {
    [twist.vx, twist.vy, twist.yaw_rate].iter().filter(|&&component| component != 0.0).count() > 1
}

#[cfg(test)]
mod tests;
