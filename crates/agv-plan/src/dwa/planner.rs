//! The planner: sample, roll out, score, and take the best that the guard lets pass.

use super::DwaParams;
use crate::{
    Error,
    local::{
        Drive, Guard, NavigationField, Reference, Task, Trajectories, Verdict, check_request,
        critics::{self, Critic, Scene, score},
        lead,
    },
};
use agv_core::{
    geometry::Twist2,
    kinematics::Motion,
    roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner},
};
use nalgebra::Vector2;

/// The dynamic window approach; plays [`LocalPlanner`].
///
/// It needs no inflation: the map's lethal cells are what it keeps away from.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams};
/// use agv_core::kinematics::MotionLimits;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_core::roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState};
/// use agv_plan::dwa::{Dwa, DwaParams};
///
/// // A pallet stands on the path.
/// let mut map = Grid::filled(GridLayout::new(160, 80, 0.05, Se2::default())?, CellState::Free);
/// (36..46).for_each(|y| (70..80).for_each(|x| drop(map.set(Cell::new(x, y), CellState::Occupied))));
/// let map = LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default())?;
/// let path = Path::from_positions(&[Vector2::new(1.0, 2.0), Vector2::new(7.0, 2.0)])?;
/// let limits = MotionLimits::default();
/// let mut dwa = Dwa::new(DwaParams::for_footprint(&Footprint::rectangle(-0.3, 0.3, 0.4)?))?;
/// let mut state = VehicleState::new(Se2::new(1.0, 2.0, 0.0), Twist2::ZERO);
/// for _ in 0..300 {
///     let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
///     let command = dwa.command(request)?;
///     state = state.after(&command.motion, 0.1);
///     if command.status == LocalPlanStatus::Arrived {
///         break;
///     }
/// }
/// assert!((state.map_from_base.translation() - Vector2::new(7.0, 2.0)).norm() < 0.2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Dwa {
    pub(super) params: DwaParams,
    guard: Guard,
    pub(super) reference: Reference,
    pub(super) field: NavigationField,
    pub(super) batch: Trajectories,
    critics: Vec<Critic>,
    totals: Vec<f32>,
    scratch: Vec<f32>,
    order: Vec<u32>,
    /// Commands that the guard refused in this cycle.
    refused: Vec<Motion>,
    /// Why they were refused: for somebody who may pass, if that goes for one of them.
    reason: BlockReason,
    /// Why no trajectory is free, if none is.
    closed: BlockReason,
    pub(super) speeds: Vec<f64>,
    pub(super) turns: Vec<f64>,
    /// What was aimed at last.
    last: Twist2,
    progress: lead::Patience,
}

impl Dwa {
    /// The planner with the [standard](critics::standard) critics.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: DwaParams) -> Result<Self, Error> {
        Self::with_critics(params, critics::standard())
    }

    /// The planner with critics of one's own.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn with_critics(params: DwaParams, critics: Vec<Critic>) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            guard: Guard::new(params.footprint.clone(), params.guard)?,
            reference: Reference::new(params.reference)?,
            field: NavigationField::new(params.field)?,
            batch: Trajectories::default(),
            critics,
            totals: Vec::new(),
            scratch: Vec::new(),
            order: Vec::new(),
            refused: Vec::with_capacity(lead::MOST_CHECKED),
            reason: BlockReason::Obstacle,
            closed: BlockReason::Obstacle,
            speeds: Vec::new(),
            turns: Vec::new(),
            last: Twist2::ZERO,
            progress: lead::Patience::default(),
            params,
        })
    }

    /// The parameters.
    pub const fn params(&self) -> &DwaParams {
        &self.params
    }

    /// The trajectories of the last cycle.
    pub const fn trajectories(&self) -> &Trajectories {
        &self.batch
    }

    /// What they cost, in the same order; infinite for those that were ruled out.
    pub fn costs(&self) -> &[f32] {
        &self.totals
    }

    /// The distances to the target, and the way to it, of the last cycle.
    pub const fn field(&self) -> &NavigationField {
        &self.field
    }

    /// Forgets the path and all that was chosen on it.
    pub fn reset(&mut self) {
        self.reference.reset();
        self.field.forget();
        self.last = Twist2::ZERO;
    }

    fn drive(&mut self, request: &LocalPlanRequest<'_>, drive: &Drive) -> Result<LocalCommand, LocalPlanError> {
        let pose = request.state.map_from_base;
        let position = pose.translation();
        self.field.set_map(request.map, self.params.footprint.inscribed_radius());
        let ahead = self.params.look_ahead;
        let Some(target) = lead::aim(&mut self.field, self.reference.course(), drive, &position, ahead) else {
            self.last = Twist2::ZERO;
            return lead::blocked(&self.guard, request, BlockReason::Obstacle);
        };
        self.field.trace(&position);
        if self.progress.look(drive.remaining) > self.params.patience {
            return lead::blocked(&self.guard, request, BlockReason::Limits);
        }
        self.sample(request, drive);
        self.batch.roll_out(&request.state, request.limits, request.map, &self.params.footprint);
        let was_free = self.batch.free().iter().any(|&free| free > 0);
        self.batch.meet(request.obstacles);
        // Who could go on but for somebody waits.
        let closed = was_free && self.batch.free().iter().all(|&free| free == 0);
        self.closed = if closed { BlockReason::MovingObstacle } else { BlockReason::Obstacle };
        self.judge(request, drive, target);
        if let Some(command) = self.best(request)? {
            return Ok(command);
        }
        // Who stands may look more closely: what only seems to touch may be free.
        if request.state.twist == Twist2::ZERO {
            self.batch.relax(request.map, lead::RELAXED);
            self.judge(request, drive, target);
            if let Some(command) = self.best(request)? {
                return Ok(command);
            }
        }
        self.last = Twist2::ZERO;
        lead::blocked(&self.guard, request, self.reason)
    }

    /// Lets the critics score the batch.
    fn judge(&mut self, request: &LocalPlanRequest<'_>, drive: &Drive, target: Vector2<f64>) {
        let scene = Scene {
            request,
            drive,
            course: self.reference.course(),
            field: &self.field,
            key_node: lead::key_node(self.reference.course(), drive).unwrap_or(target),
            target,
            last: self.last,
        };
        score(&mut self.critics, &self.batch, &scene, &mut self.totals, &mut self.scratch);
    }

    /// The best command that the guard lets pass, if any.
    fn best(&mut self, request: &LocalPlanRequest<'_>) -> Result<Option<LocalCommand>, LocalPlanError> {
        let totals = &self.totals;
        self.order.clear();
        self.order.extend((0..totals.len() as u32).filter(|&i| totals[i as usize].is_finite()));
        let by_cost = |a: &u32, b: &u32| totals[*a as usize].total_cmp(&totals[*b as usize]).then(a.cmp(b));
        self.order.sort_unstable_by(by_cost);
        self.refused.clear();
        self.reason = self.closed;
        for k in 0..self.order.len() {
            let i = self.order[k] as usize;
            let motion = lead::command_towards(request, self.batch.target(i).map(f64::from));
            // Different aims often begin alike.
            if self.refused.contains(&motion) {
                continue;
            }
            if self.refused.len() >= lead::MOST_CHECKED {
                break;
            }
            match self.guard.check_trusted(request, &motion)? {
                Verdict::Clear => {
                    self.last = self.batch.target_twist(i, request.limits.steering.is_some());
                    let status = if lead::stays(request, &motion) {
                        let reach = self.params.look_ahead;
                        LocalPlanStatus::Blocked(lead::standing_reason(request, reach, self.reason))
                    } else {
                        self.progress.spend(request.dt);
                        LocalPlanStatus::Following
                    };
                    return Ok(Some(LocalCommand { motion, status }));
                }
                Verdict::Blocked(because) => {
                    if self.reason != BlockReason::MovingObstacle {
                        self.reason = because;
                    }
                    self.refused.push(motion);
                }
            }
        }
        Ok(None)
    }
}

impl LocalPlanner for Dwa {
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        check_request(&request)?;
        if self.guard.touches(&request)? {
            self.last = Twist2::ZERO;
            let motion = self.guard.brake(&request)?;
            return Ok(LocalCommand { motion, status: LocalPlanStatus::InCollision });
        }
        let task = self.reference.update_trusted(&request);
        if self.reference.is_new() {
            self.progress = lead::Patience::default();
        }
        match task {
            Task::Drive(drive) => self.drive(&request, &drive),
            Task::Turn(error) => {
                self.last = Twist2::ZERO;
                lead::turn(&self.guard, &request, error)
            }
            Task::Arrive => {
                let motion = self.guard.brake(&request)?;
                Ok(LocalCommand { motion, status: LocalPlanStatus::Arrived })
            }
            Task::OffPath => lead::blocked(&self.guard, &request, BlockReason::OffPath),
        }
    }
}

#[cfg(test)]
mod tests;
