//! Many trajectories at once, as structure of arrays: what a sampling planner rolls out and its critics score.
//!
//! All are in a local frame, metres from the vehicle along the axes of the map's grid, in `f32`: small numbers, eight to a register.
//! A step is the exact arc of its twist, `θ = ω dt` entering by the series of `sin θ / θ` and `(1 - cos θ) / θ`, good for `|θ| <= 1`. The velocities follow
//! ramps: each component goes from what it is to its target as fast as the limits allow, so that what is rolled out is what the
//! vehicle would do; a target within one step of the present velocity gives a plain arc.
//!
//! The way of each is looked up in the distance field, under every circle that covers the footprint: the coordinates and indices
//! are computed in loops that vectorise, the look-up is scalar. The price does not depend on how many obstacles there are.

mod kernel;

use agv_core::{
    geometry::{LieGroup, Se2, Twist2},
    grid::{Cell, Footprint, LocalMap},
    kinematics::MotionLimits,
    obstacle::{Hull, MovingObstacle},
    roles::VehicleState,
};
use kernel::{GridFrame, Ramps, advance, count_free, place};
use nalgebra::Vector2;
use pulp::Arch;

/// A batch of trajectories of equal duration; entry `step * stride + i` of an array belongs to trajectory `i` after `step + 1` steps.
#[derive(Debug, Clone, Default)]
pub struct Trajectories {
    len: usize,
    stride: usize,
    steps: usize,
    dt: f64,
    map_from_local: Se2,
    /// What is aimed at: forward and sideways speed, and yaw rate, or curvature for a vehicle that steers.
    targets: [Vec<f32>; 3],
    /// Present velocities of the roll-out.
    velocities: [Vec<f32>; 3],
    pub(crate) x: Vec<f32>,
    pub(crate) y: Vec<f32>,
    pub(crate) cos: Vec<f32>,
    pub(crate) sin: Vec<f32>,
    pub(crate) clearance: Vec<f32>,
    free: Vec<u32>,
    index: Vec<u32>,
    circles: Vec<[f32; 3]>,
    /// Cosine and sine of the heading at the beginning.
    heading: (f32, f32),
    /// What the processor can do; the bits do not depend on it.
    arch: Arch,
    /// Clearance below which a trajectory is not free: none, or that of where the vehicle stands if the circles and cells claim that it
    /// touches something already. The guard is exact.
    limit: f32,
}

/// How much deeper in what looks like an obstacle a trajectory may lead than where the vehicle stands, in cells: the circles and cells of the
/// look-up claim more than the vehicle and the obstacles have.
const SLACK: f32 = 0.25;

/// Trajectories are padded to whole registers.
const LANES: usize = 16;

impl Trajectories {
    /// Number of trajectories.
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Number of steps of each.
    pub const fn steps(&self) -> usize {
        self.steps
    }

    /// Duration of a step, in seconds.
    pub const fn dt(&self) -> f64 {
        self.dt
    }

    /// Distance between the entries of two steps in the arrays.
    pub const fn stride(&self) -> usize {
        self.stride
    }

    /// The frame of all positions: origin at the vehicle, axes of the map's grid.
    pub const fn map_from_local(&self) -> &Se2 {
        &self.map_from_local
    }

    /// A point of the map in the local frame.
    pub fn to_local(&self, point: &Vector2<f64>) -> Vector2<f32> {
        self.map_from_local.inverse().act(point).cast()
    }

    /// Positions and directions of the noses after a step (from 0), of all trajectories.
    pub fn at_step(&self, step: usize) -> StepView<'_> {
        let range = step * self.stride..step * self.stride + self.len;
        StepView {
            x: self.x.get(range.clone()).unwrap_or_default(),
            y: self.y.get(range.clone()).unwrap_or_default(),
            cos: self.cos.get(range.clone()).unwrap_or_default(),
            sin: self.sin.get(range.clone()).unwrap_or_default(),
            clearance: self.clearance.get(range).unwrap_or_default(),
        }
    }

    /// Steps of each trajectory before the vehicle would touch something; [`steps`](Self::steps) for one that is free.
    pub fn free(&self) -> &[u32] {
        self.free.get(..self.len).unwrap_or_default()
    }

    /// What trajectory `i` aims at: forward and sideways speed, and yaw rate (curvature for a vehicle that steers).
    pub fn target(&self, i: usize) -> [f32; 3] {
        let at = |k: usize| self.targets.get(k).and_then(|t| t.get(i)).copied().unwrap_or(0.0);
        [at(0), at(1), at(2)]
    }

    /// Begins a batch of `steps` steps of `dt` seconds.
    pub fn begin(&mut self, state: &VehicleState, map: &LocalMap, steps: usize, dt: f64) {
        let rotation = map.layout().map_from_grid().rotation();
        self.map_from_local = Se2::from_parts(state.map_from_base.translation(), rotation);
        (self.steps, self.dt, self.len) = (steps, dt, 0);
        self.targets.iter_mut().for_each(Vec::clear);
    }

    /// Adds a trajectory by what it aims at.
    pub fn push(&mut self, target: [f32; 3]) {
        for (all, value) in self.targets.iter_mut().zip(target) {
            all.push(value);
        }
        self.len += 1;
    }

    /// Rolls all out from the vehicle's state, and looks up how clear they are.
    pub fn roll_out(&mut self, state: &VehicleState, limits: &MotionLimits, map: &LocalMap, footprint: &Footprint) {
        self.stride = self.len.next_multiple_of(LANES);
        let (stride, cells) = (self.stride, self.stride * self.steps);
        for array in [&mut self.x, &mut self.y, &mut self.cos, &mut self.sin, &mut self.clearance] {
            array.resize(cells, 0.0);
        }
        self.targets.iter_mut().for_each(|target| target.resize(stride, 0.0));
        self.free.clear();
        self.free.resize(stride, 0);
        self.index.resize(stride, 0);
        self.circles.clear();
        let of_circle = |(center, radius): (Vector2<f64>, f64)| [center.x as f32, center.y as f32, radius as f32];
        self.circles.extend(footprint.covering_circles().map(of_circle));
        self.move_all(state, limits);
        self.look_up(map);
    }

    fn move_all(&mut self, state: &VehicleState, limits: &MotionLimits) {
        let ramps = Ramps::new(limits);
        let twist = state.twist;
        let turn = match &limits.steering {
            Some(steering) => {
                let read = if twist.vx == 0.0 { 0.0 } else { twist.yaw_rate / twist.vx };
                state.steering.map_or(read, |angle| steering.curvature(angle))
            }
            None => twist.yaw_rate,
        };
        for (velocity, now) in self.velocities.iter_mut().zip([twist.vx, twist.vy, turn]) {
            velocity.clear();
            velocity.resize(self.stride, now as f32);
        }
        let heading = self.map_from_local.rotation().inverse().compose(&state.map_from_base.rotation());
        self.heading = (heading.cos() as f32, heading.sin() as f32);
        let (stride, dt) = (self.stride, self.dt as f32);
        let [vx, vy, turn] = &mut self.velocities;
        let [target_vx, target_vy, target_turn] = &self.targets;
        for step in 0..self.steps {
            let at = step * stride;
            let (x_before, x) = self.x.split_at_mut(at);
            let (y_before, y) = self.y.split_at_mut(at);
            let (cos_before, cos) = self.cos.split_at_mut(at);
            let (sin_before, sin) = self.sin.split_at_mut(at);
            let before = at.saturating_sub(stride);
            let (x, y, cos, sin) = (&mut x[..stride], &mut y[..stride], &mut cos[..stride], &mut sin[..stride]);
            if step == 0 {
                x.fill(0.0);
                y.fill(0.0);
                cos.fill(heading.cos() as f32);
                sin.fill(heading.sin() as f32);
            } else {
                x.copy_from_slice(&x_before[before..]);
                y.copy_from_slice(&y_before[before..]);
                cos.copy_from_slice(&cos_before[before..]);
                sin.copy_from_slice(&sin_before[before..]);
            }
            let (vx, vy, turn) = (&mut vx[..stride], &mut vy[..stride], &mut turn[..stride]);
            let (target_vx, target_vy) = (&target_vx[..stride], &target_vy[..stride]);
            let target_turn = &target_turn[..stride];
            let arrays = (vx, vy, turn);
            let targets = (target_vx, target_vy, target_turn);
            self.arch.dispatch(
                #[inline(always)]
                || advance(arrays, targets, (x, y), (cos, sin), &ramps, dt),
            );
        }
    }

    fn look_up(&mut self, map: &LocalMap) {
        let layout = map.layout();
        let per_metre = (1.0 / layout.resolution()) as f32;
        let origin = layout.to_grid(&self.map_from_local.translation()).cast::<f32>();
        let (width, height) = (layout.width() as f32, layout.height() as f32);
        let (columns, outside) = (layout.width() as i32, layout.len() as u32);
        let frame = GridFrame { origin, per_metre, width, height, columns, outside };
        // An obstacle reaches half a cell farther than its centre.
        let half = (0.5 * layout.resolution()) as f32;
        let (stride, steps) = (self.stride, self.steps);
        let (field, beyond) = (map.obstacles().distance().values(), beyond(map));
        for step in 0..steps {
            let at = step * stride..(step + 1) * stride;
            let (x, y) = (&self.x[at.clone()], &self.y[at.clone()]);
            let (cos, sin) = (&self.cos[at.clone()], &self.sin[at.clone()]);
            let clearance = &mut self.clearance[at];
            let index = &mut self.index[..stride];
            clearance.fill(f32::MAX);
            for &[ahead, left, radius] in &self.circles {
                self.arch.dispatch(
                    #[inline(always)]
                    || place(index, (x, y), (cos, sin), (ahead, left), &frame),
                );
                let reach = radius + half;
                for (clearance, &index) in clearance.iter_mut().zip(&*index) {
                    let distance = field.get(index as usize).copied().unwrap_or(beyond);
                    *clearance = clearance.min(distance - reach);
                }
            }
        }
        let present = self.clearance_here(map, origin);
        self.limit = present.min(0.0) - SLACK * layout.resolution() as f32;
        self.count_free();
    }

    /// Clearance of the vehicle where it is, as it is looked up for the trajectories.
    fn clearance_here(&self, map: &LocalMap, origin: Vector2<f32>) -> f32 {
        let layout = map.layout();
        let (per_metre, half) = ((1.0 / layout.resolution()) as f32, (0.5 * layout.resolution()) as f32);
        let (cos, sin) = self.heading;
        let (field, beyond) = (map.obstacles().distance().values(), beyond(map));
        let of_circle = |&[ahead, left, radius]: &[f32; 3]| {
            let column = (cos * ahead - sin * left) * per_metre + origin.x;
            let row = (sin * ahead + cos * left) * per_metre + origin.y;
            let index = layout.index(Cell::new(column.floor() as i32, row.floor() as i32)).unwrap_or(layout.len());
            field.get(index).copied().unwrap_or(beyond) - radius - half
        };
        self.circles.iter().map(of_circle).fold(f32::MAX, f32::min)
    }

    /// Lets the trajectories come `cells` cells of the map nearer to obstacles before they count as blocked.
    pub(crate) fn relax(&mut self, map: &LocalMap, cells: f32) {
        self.limit -= cells * map.layout().resolution() as f32;
        self.count_free();
    }

    fn count_free(&mut self) {
        self.free.fill(0);
        let limit = self.limit;
        let (free, clearance) = (self.free.as_mut_slice(), self.clearance.as_slice());
        self.arch.dispatch(
            #[inline(always)]
            || count_free(free, clearance, limit),
        );
    }

    /// Takes in the obstacles that move: each step is compared with where they are at its time.
    pub fn meet(&mut self, obstacles: &[MovingObstacle]) {
        if obstacles.is_empty() {
            return;
        }
        let stride = self.stride;
        for obstacle in obstacles {
            let velocity: Vector2<f32> = self.map_from_local.rotation().inverse().act(&obstacle.velocity).cast();
            let position = self.to_local(&obstacle.position);
            let vertices = obstacle.hull.vertices();
            if vertices.len() > 2 {
                self.meet_inside(obstacle);
            }
            let pairs = vertices.iter().zip(vertices.iter().cycle().skip(1)).take(if vertices.len() == 2 {
                1
            } else {
                usize::MAX
            });
            for (from, to) in pairs {
                let turned = |v: &Vector2<f64>| self.map_from_local.rotation().inverse().act(v).cast::<f32>();
                let (from, along) = (turned(from), turned(&(to - from)));
                let per_square = if along.norm_squared() > 0.0 { 1.0 / along.norm_squared() } else { 0.0 };
                for step in 0..self.steps {
                    let begin = position + from + velocity * ((step + 1) as f32 * self.dt as f32);
                    let at = step * stride..(step + 1) * stride;
                    let (x, y) = (&self.x[at.clone()], &self.y[at.clone()]);
                    let (cos, sin) = (&self.cos[at.clone()], &self.sin[at.clone()]);
                    let clearance = &mut self.clearance[at];
                    for &[ahead, left, radius] in &self.circles {
                        let reach = radius + obstacle.radius as f32;
                        for i in 0..stride {
                            let dx = x[i] + cos[i] * ahead - sin[i] * left - begin.x;
                            let dy = y[i] + sin[i] * ahead + cos[i] * left - begin.y;
                            let share = ((dx * along.x + dy * along.y) * per_square).clamp(0.0, 1.0);
                            let (dx, dy) = (dx - share * along.x, dy - share * along.y);
                            clearance[i] = clearance[i].min((dx * dx + dy * dy).sqrt() - reach);
                        }
                    }
                }
            }
        }
        self.count_free();
    }

    /// Takes in who is within the outline of an obstacle, left of all its edges: as deep as the nearest of them is far.
    fn meet_inside(&mut self, obstacle: &MovingObstacle) {
        let rotation = self.map_from_local.rotation().inverse();
        let velocity: Vector2<f32> = rotation.act(&obstacle.velocity).cast();
        let position = self.to_local(&obstacle.position);
        let vertices = obstacle.hull.vertices();
        // A point of each edge, and the way to its left.
        let mut edges = [(Vector2::<f32>::zeros(), Vector2::<f32>::zeros()); Hull::MAX_VERTICES];
        for (edge, (from, to)) in edges.iter_mut().zip(vertices.iter().zip(vertices.iter().cycle().skip(1))) {
            let along = (to - from) / (to - from).norm();
            *edge = (rotation.act(from).cast(), rotation.act(&Vector2::new(-along.y, along.x)).cast());
        }
        let edges = &edges[..vertices.len()];
        for step in 0..self.steps {
            let origin = position + velocity * ((step + 1) as f32 * self.dt as f32);
            for i in step * self.stride..(step + 1) * self.stride {
                for &[ahead, left, radius] in &self.circles {
                    let dx = self.x[i] + self.cos[i] * ahead - self.sin[i] * left - origin.x;
                    let dy = self.y[i] + self.sin[i] * ahead + self.cos[i] * left - origin.y;
                    let to_left = edges.iter().map(|(from, left)| (dx - from.x) * left.x + (dy - from.y) * left.y);
                    let depth = to_left.fold(f32::INFINITY, f32::min);
                    if depth > 0.0 {
                        self.clearance[i] = self.clearance[i].min(-depth - radius - obstacle.radius as f32);
                    }
                }
            }
        }
    }

    /// Twist that trajectory `i` aims at.
    pub(crate) fn target_twist(&self, i: usize, steers: bool) -> Twist2 {
        let [vx, vy, turn] = self.target(i).map(f64::from);
        Twist2::new(vx, vy, if steers { turn * vx } else { turn })
    }
}

/// Distance to the nearest obstacle of what lies off the map.
fn beyond(map: &LocalMap) -> f32 {
    if map.obstacles().params().outside_is_obstacle { 0.0 } else { f32::MAX }
}

/// One step of all trajectories.
#[derive(Debug, Clone, Copy)]
pub struct StepView<'a> {
    /// Position along the local x axis, in metres.
    pub x: &'a [f32],
    /// Position along the local y axis, in metres.
    pub y: &'a [f32],
    /// Cosine of the heading in the local frame.
    pub cos: &'a [f32],
    /// Sine of the heading in the local frame.
    pub sin: &'a [f32],
    /// Distance of the footprint from the nearest obstacle, in metres, about; negative where it touches one.
    pub clearance: &'a [f32],
}

#[cfg(test)]
mod tests;
