//! The planner: propose, roll out, score, average, and take what the guard lets pass.

use super::{
    MppiParams,
    block::{BLOCK, Block},
    proposal::{Control, Plan, Proposal},
};
use crate::{
    Error,
    local::{
        Drive, Guard, NavigationField, Reference, Task, Trajectories, Verdict, Window, check_request,
        critics::{self, Critic, Scene, Spread},
        lead, trajectories,
    },
};
use agv_core::{
    compute::{Par, Seed},
    geometry::Twist2,
    kinematics::Motion,
    roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner},
};

/// Model predictive path integral control; plays [`LocalPlanner`].
///
/// It needs no inflation: the map's lethal cells are what it keeps away from. Its samples come from streams of its seed that are keyed
/// by cycle and block of samples, so that a run can be replayed bit for bit, on any number of threads.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams};
/// use agv_core::kinematics::MotionLimits;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_core::roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState};
/// use agv_plan::mppi::{Mppi, MppiParams};
///
/// // A pallet stands on the path.
/// let mut map = Grid::filled(GridLayout::new(160, 80, 0.05, Se2::default())?, CellState::Free);
/// (36..46).for_each(|y| (70..80).for_each(|x| drop(map.set(Cell::new(x, y), CellState::Occupied))));
/// let map = LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default())?;
/// let path = Path::from_positions(&[Vector2::new(1.0, 2.0), Vector2::new(7.0, 2.0)])?;
/// let limits = MotionLimits::default();
/// let mut mppi = Mppi::new(MppiParams::for_footprint(&Footprint::rectangle(-0.3, 0.3, 0.4)?), Seed(7))?;
/// let mut state = VehicleState::new(Se2::new(1.0, 2.0, 0.0), Twist2::ZERO);
/// for _ in 0..300 {
///     let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
///     let command = mppi.command(request)?;
///     state = state.after(&command.motion, 0.1);
///     if command.status == LocalPlanStatus::Arrived {
///         break;
///     }
/// }
/// assert!((state.map_from_base.translation() - Vector2::new(7.0, 2.0)).norm() < 0.2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Mppi {
    params: MppiParams,
    seed: Seed,
    par: Par,
    /// Cycles of sampling, which key the noise.
    cycle: u64,
    guard: Guard,
    reference: Reference,
    field: NavigationField,
    blocks: Vec<Block>,
    /// The mean of the samples.
    mean: Block,
    sums: Vec<[f64; 3]>,
    plan: Plan,
    spreads: Vec<Spread>,
    /// Cost, block and place of samples, the best first.
    order: Vec<(f32, u32, u32)>,
    /// Commands that the guard refused in this cycle.
    refused: Vec<Motion>,
    /// Why they were refused: for somebody who may pass, if that goes for one of them.
    reason: BlockReason,
    /// What was aimed at last.
    last: Twist2,
    progress: lead::Patience,
}

impl Mppi {
    /// The planner with the [standard](critics::standard) critics.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: MppiParams, seed: Seed) -> Result<Self, Error> {
        Self::with_critics(params, seed, critics::standard)
    }

    /// The planner with critics of one's own: `critics` is called once for each block of samples.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn with_critics(params: MppiParams, seed: Seed, critics: impl Fn() -> Vec<Critic>) -> Result<Self, Error> {
        params.validate()?;
        let count = params.samples.div_ceil(BLOCK);
        let of = |i: usize| Block::new(i * BLOCK, BLOCK.min(params.samples - i * BLOCK), critics());
        let mean = Block::new(0, 1, critics());
        Ok(Self {
            seed,
            par: Par::Seq,
            cycle: 0,
            guard: Guard::new(params.footprint.clone(), params.guard)?,
            reference: Reference::new(params.reference)?,
            field: NavigationField::new(params.field)?,
            blocks: (0..count).map(of).collect(),
            spreads: vec![Spread::NONE; critics().len()],
            mean,
            sums: vec![[0.0; 3]; params.steps],
            plan: Plan::default(),
            order: Vec::with_capacity(params.samples),
            refused: Vec::with_capacity(lead::MOST_CHECKED),
            reason: BlockReason::Obstacle,
            last: Twist2::ZERO,
            progress: lead::Patience::default(),
            params,
        })
    }

    /// Spreads the samples over threads; the bits of the commands do not depend on it.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// The parameters.
    pub const fn params(&self) -> &MppiParams {
        &self.params
    }

    /// The samples of the last cycle, in blocks, and what they cost: infinity for those that were ruled out.
    pub fn samples(&self) -> impl Iterator<Item = (&Trajectories, &[f32])> {
        self.blocks.iter().map(|block| (&block.batch, block.costs.as_slice()))
    }

    /// The distances to the target, and the way to it, of the last cycle.
    pub const fn field(&self) -> &NavigationField {
        &self.field
    }

    /// Forgets the path and all that was planned on it; the noise goes on.
    pub fn reset(&mut self) {
        self.reference.reset();
        self.field.forget();
        self.rest();
    }

    /// The next plan begins anew.
    fn rest(&mut self) {
        self.last = Twist2::ZERO;
        self.plan.controls.clear();
    }

    fn drive(&mut self, request: &LocalPlanRequest<'_>, drive: &Drive) -> Result<LocalCommand, LocalPlanError> {
        let position = request.state.map_from_base.translation();
        self.field.set_map(request.map, self.params.footprint.inscribed_radius());
        let ahead = self.params.look_ahead;
        let Some(target) = lead::aim(&mut self.field, self.reference.course(), drive, &position, ahead) else {
            return self.blocked(request, BlockReason::Obstacle);
        };
        self.field.trace(&position);
        if self.progress.look(drive.remaining) > self.params.patience {
            return self.blocked(request, BlockReason::Limits);
        }
        let scene = Scene {
            request,
            drive,
            course: self.reference.course(),
            field: &self.field,
            key_node: lead::key_node(self.reference.course(), drive).unwrap_or(target),
            target,
            last: self.last,
        };
        let Self { params, plan, blocks, mean, spreads, sums, .. } = self;
        let (ranges, sigmas) = reach(request, drive, params);
        let now = trajectories::now(&request.state, request.limits);
        plan.move_on(request.dt / step_of(params), params.steps, now);
        let proposal = Proposal { plan, params, ranges, sigmas };
        let (seed, cycle) = (self.seed, self.cycle);
        self.par.for_each_chunk(blocks.as_mut_slice(), 1, |index, blocks| {
            for block in blocks {
                block.sample(request, &proposal, &mut seed.stream(cycle, index as u64));
                block.assess(&scene);
            }
        });
        self.cycle += 1;
        let mut best = sum_up(blocks, spreads);
        // Who stands may look more closely: what only seems to touch may be free.
        let relaxed = best.is_none() && request.state.twist == Twist2::ZERO;
        if relaxed {
            self.par.for_each_chunk(blocks.as_mut_slice(), 1, |_, blocks| {
                for block in blocks {
                    block.batch.relax(request.map, lead::RELAXED);
                    block.assess(&scene);
                }
            });
            best = sum_up(blocks, spreads);
        }
        // Who could go on but for somebody waits.
        let waits = blocks.iter().any(|block| block.is_free.0) && !blocks.iter().any(|block| block.is_free.1);
        let reason = if waits { BlockReason::MovingObstacle } else { BlockReason::Obstacle };
        let Some((least, ..)) = best else { return self.blocked(request, reason) };
        average(blocks, least, params.temperature, sums);
        plan.controls.clear();
        plan.controls.extend(sums.iter().map(|sum| sum.map(|value| value as f32)));
        let proposal = Proposal { plan, params, ranges, sigmas };
        mean.follow(request, &proposal, &plan.controls);
        if relaxed {
            mean.batch.relax(request.map, lead::RELAXED);
        }
        mean.assess(&scene);
        mean.sum_up(spreads);
        let cost = mean.costs.first().copied().unwrap_or(f32::INFINITY);
        let prefers_mean = cost.is_finite() && f64::from(cost - least) <= params.temperature;
        self.reason = reason;
        self.choose(request, prefers_mean)
    }

    /// Begins the mean if that is preferred, or the best sample that the guard lets pass.
    fn choose(&mut self, request: &LocalPlanRequest<'_>, prefers_mean: bool) -> Result<LocalCommand, LocalPlanError> {
        self.refused.clear();
        if prefers_mean && let Some(command) = self.take(request, None, 0)? {
            return Ok(command);
        }
        self.order.clear();
        for (b, block) in self.blocks.iter().enumerate() {
            let finite = block.costs.iter().enumerate().filter(|(_, cost)| cost.is_finite());
            self.order.extend(finite.map(|(i, &cost)| (cost, b as u32, i as u32)));
        }
        self.order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        for k in 0..self.order.len() {
            let (_, block, sample) = self.order[k];
            if self.refused.len() >= lead::MOST_CHECKED {
                break;
            }
            if let Some(command) = self.take(request, Some(block as usize), sample as usize)? {
                return Ok(command);
            }
        }
        self.blocked(request, self.reason)
    }

    /// Takes a sample of a block, or the mean, if the guard lets its beginning pass.
    fn take(
        &mut self,
        request: &LocalPlanRequest<'_>,
        block: Option<usize>,
        sample: usize,
    ) -> Result<Option<LocalCommand>, LocalPlanError> {
        let batch = &block.and_then(|i| self.blocks.get(i)).unwrap_or(&self.mean).batch;
        // Of the step at whose end the next cycle begins.
        let step = (request.dt / step_of(&self.params) - 1e-6).ceil().clamp(1.0, self.params.steps as f64) as usize;
        let motion = lead::command_towards(request, batch.control(sample, step - 1).map(f64::from));
        // Different samples often begin alike.
        if self.refused.contains(&motion) {
            return Ok(None);
        }
        match self.guard.check_trusted(request, &motion)? {
            Verdict::Clear => {
                self.last = batch.target_twist(sample, request.limits.steering.is_some());
                self.plan.controls.clear();
                self.plan
                    .controls
                    .extend((0..self.params.steps).map(|step| -> Control { batch.control(sample, step) }));
                let status = if lead::stays(request, &motion) {
                    LocalPlanStatus::Blocked(lead::standing_reason(request, self.params.look_ahead, self.reason))
                } else {
                    self.progress.spend(request.dt);
                    LocalPlanStatus::Following
                };
                Ok(Some(LocalCommand { motion, status }))
            }
            Verdict::Blocked(because) => {
                if self.reason != BlockReason::MovingObstacle {
                    self.reason = because;
                }
                self.refused.push(motion);
                Ok(None)
            }
        }
    }

    fn blocked(&mut self, request: &LocalPlanRequest<'_>, reason: BlockReason) -> Result<LocalCommand, LocalPlanError> {
        self.rest();
        lead::blocked(&self.guard, request, reason)
    }

    /// A cycle; one that fails may leave half a plan.
    fn cycle(&mut self, request: &LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        check_request(request)?;
        if self.guard.touches(request)? {
            self.rest();
            let motion = self.guard.brake(request)?;
            return Ok(LocalCommand { motion, status: LocalPlanStatus::InCollision });
        }
        let task = self.reference.update_trusted(request);
        if self.reference.is_new() {
            self.progress = lead::Patience::default();
        }
        match task {
            Task::Drive(drive) => self.drive(request, &drive),
            Task::Turn(error) => {
                self.rest();
                lead::turn(&self.guard, request, error)
            }
            Task::Arrive => {
                self.rest();
                let motion = self.guard.brake(request)?;
                Ok(LocalCommand { motion, status: LocalPlanStatus::Arrived })
            }
            Task::OffPath => self.blocked(request, BlockReason::OffPath),
        }
    }
}

impl LocalPlanner for Mppi {
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        let command = self.cycle(&request);
        // A plan that was moved on or averaged, but not begun, is none.
        if command.is_err() {
            self.rest();
        }
        command
    }
}

/// Duration of a step, in seconds.
fn step_of(params: &MppiParams) -> f64 {
    params.horizon / params.steps as f64
}

/// Ranges of the components, and how much noise each gets.
fn reach(request: &LocalPlanRequest<'_>, drive: &Drive, params: &MppiParams) -> ([(f32, f32); 3], Control) {
    let (limits, motion) = (request.limits, request.state.motion());
    let cap = lead::speed_cap(request, drive, params.stopping_share);
    let window = Window::new(&motion, limits, params.horizon, drive.gear, cap);
    let ranges = [window.forward, window.lateral, window.turn].map(|(low, high)| (low as f32, high as f32));
    let twist = &limits.twist;
    let most_turn = if limits.steering.is_some() { limits.max_curvature() } else { twist.yaw_rate };
    let lateral = if limits.is_holonomic() { twist.lateral_speed } else { 0.0 };
    let sigmas = [
        params.speed_noise * twist.forward_speed.max(twist.reverse_speed),
        params.speed_noise * lateral,
        params.turn_noise * most_turn,
    ];
    (ranges, sigmas.map(|sigma| sigma as f32))
}

/// Puts together what the critics said of all samples; cost, block and place of the best, if any is possible.
fn sum_up(blocks: &mut [Block], spreads: &mut [Spread]) -> Option<(f32, usize, usize)> {
    spreads.fill(Spread::NONE);
    for block in &*blocks {
        block.spread(spreads);
    }
    for block in &mut *blocks {
        block.sum_up(spreads);
    }
    let best = blocks.iter().enumerate().filter_map(|(b, block)| block.best().map(|(cost, i)| (cost, b, i)));
    best.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// The mean of all samples by their weights.
fn average(blocks: &mut [Block], least: f32, temperature: f64, sums: &mut [[f64; 3]]) {
    sums.fill([0.0; 3]);
    let total: f64 = blocks.iter_mut().map(|block| block.add_weighted(least, temperature, sums)).sum();
    // The best weighs one.
    sums.iter_mut().flatten().for_each(|sum| *sum /= total.max(1.0));
}

#[cfg(test)]
mod tests;
